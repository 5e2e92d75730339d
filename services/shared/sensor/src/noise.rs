//! Noise that neighbours share: patches that overlap see some of the same picture, so that their errors correlate.
//!
//! White noise averaged over the patch has the correlation of overlapping patches (it falls linearly to zero at one patch's width). Every white
//! value is a hash of the picture's seed and its own place: the noise of a pixel depends on nothing else, whoever computes it.

/// The independent random streams of a pixel.
#[derive(Debug, Clone, Copy)]
pub(crate) enum NoiseStream {
    White = 1,
    Patch = 2,
    Pixel = 3,
}

/// 64 random bits of a place in a stream (the finaliser of SplitMix64).
pub(crate) fn bits(seed: u64, stream: NoiseStream, place: usize) -> u64 {
    let mut x = seed ^ (stream as u64).wrapping_mul(0xd605_1d86_99d7_57c3) ^ (place as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// The four 16-bit numbers of a hash, each uniform over 0 to 1.
pub(crate) fn shares(bits: u64) -> [f32; 4] {
    std::array::from_fn(|k| ((bits >> (16 * k)) & 0xffff) as f32 / 65_536.0)
}

/// About a standard normal from two uniform numbers: a triangle, whose tails end at 2.45 standard deviations.
pub(crate) fn triangular(a: f32, b: f32) -> f32 {
    const SCALE: f32 = 2.449_489_8;
    (a + b - 1.0) * SCALE
}

/// Sum of the four 16-bit numbers of a hash, centred: close to normal, exact in integers.
fn white(bits: u64) -> i32 {
    let halves = (bits & 0x0000_ffff_0000_ffff) + ((bits >> 16) & 0x0000_ffff_0000_ffff);
    ((halves & 0xffff_ffff) + (halves >> 32)) as i32 - 131_070
}

/// Noise with mean 0 and variance 1, `[height, width]`, averaged over a square of `window` pixels (odd).
pub(crate) fn correlated(width: usize, height: usize, window: usize, seed: u64) -> Vec<f32> {
    // The variance of `white` is four times that of a number uniform over 0 to 65,535.
    const WHITE_DEVIATION: f32 = 37_837.23;
    let margin = window - 1;
    let stride = width + margin;
    let mut row = vec![0i32; stride];
    // Sums along rows, then along columns by adding the row that enters the square and taking off the one that leaves it.
    let mut sums = vec![0i32; width * (height + margin)];
    for (v, sums) in sums.chunks_exact_mut(width).enumerate() {
        for (u, value) in row.iter_mut().enumerate() {
            *value = white(bits(seed, NoiseStream::White, v * stride + u));
        }
        let mut sum: i32 = row[..margin].iter().sum();
        for (u, out) in sums.iter_mut().enumerate() {
            sum += row[u + margin];
            *out = sum;
            sum -= row[u];
        }
    }
    let scale = 1.0 / (WHITE_DEVIATION * window as f32);
    let mut columns = vec![0i32; width];
    for row in sums[..margin * width].chunks_exact(width) {
        columns.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
    let mut noise = Vec::with_capacity(width * height);
    for v in 0..height {
        let (leaving, entering) = (&sums[v * width..(v + 1) * width], &sums[(v + margin) * width..(v + margin + 1) * width]);
        for ((sum, entering), leaving) in columns.iter_mut().zip(entering).zip(leaving) {
            *sum += entering;
            noise.push(*sum as f32 * scale);
            *sum -= leaving;
        }
    }
    noise
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_variance_one_and_correlates_within_the_window_only() {
        let (width, height) = (320, 240);
        for window in [1, 5] {
            let noise = correlated(width, height, window, 7);
            let together = |shift: usize| {
                let pairs = noise.chunks_exact(width).flat_map(|row| row.iter().zip(&row[shift..]));
                pairs.map(|(a, b)| a * b).sum::<f32>() / ((width - shift) * height) as f32
            };
            assert!((together(0) - 1.0).abs() < 0.04, "variance {}", together(0));
            let expected = (1.0 - 2.0 / window as f32).max(0.0);
            assert!((together(2) - expected).abs() < 0.05, "window {window}: {} instead of {expected}", together(2));
            assert!(together(window + 1).abs() < 0.04);
        }
    }

    #[test]
    fn uniform_numbers_are_uniform() {
        let n = 20_000;
        let mean: f32 = (0..n).flat_map(|i| shares(bits(3, NoiseStream::Pixel, i))).sum::<f32>() / (4 * n) as f32;
        let spread: f32 =
            (0..n).map(|i| shares(bits(3, NoiseStream::Pixel, i))).map(|s| triangular(s[0], s[1]).powi(2)).sum::<f32>() / n as f32;
        assert!((mean - 0.5).abs() < 0.01 && (spread - 1.0).abs() < 0.03, "{mean} {spread}");
    }
}
