//! RVL, which packs depth without loss by runs and differences: A. D. Wilson, "Fast Lossless Depth Image Compression", ISS 2017.
//!
//! A picture is a run of pixels without readings, then one of pixels with them, by turns, each after its length; a reading is its difference from
//! the one before, with the sign in the lowest bit. Numbers are written in nibbles of three bits, the lowest first, whose fourth bit says that
//! more follow; eight nibbles, from the highest down, are a 32-bit little-endian word.

/// Bits of a number at most: runs are no longer than a picture, and differences have 17 bits.
const MOST_BITS: u32 = 30;

/// Why bytes are no picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RvlError {
    /// They end early.
    #[error("it ends after {got} of {expected} pixels")]
    Short {
        /// Pixels of the picture.
        expected: usize,
        /// Pixels that there are.
        got: usize,
    },
    /// A run goes past the picture's end.
    #[error("a run of {run} pixels begins with {left} left")]
    Run {
        /// Its length.
        run: u32,
        /// Pixels that are missing.
        left: usize,
    },
    /// A number is too long, or a difference leads out of 16 bits.
    #[error("pixel {at} is no 16-bit count")]
    Number {
        /// The pixel.
        at: usize,
    },
}

/// The counts of a picture of so many pixels; what follows the last of them does not matter.
///
/// # Errors
/// [`RvlError`] for what no encoder writes.
pub fn unpack(packed: &[u8], pixels: usize) -> Result<Vec<u16>, RvlError> {
    let mut nibbles = Nibbles { words: packed.as_chunks().0.iter(), word: 0, left: 0 };
    let mut counts = Vec::with_capacity(pixels);
    let mut previous = 0u16;
    while counts.len() < pixels {
        let empty = nibbles.run(&counts, pixels)?;
        counts.resize(counts.len() + empty, 0);
        for _ in 0..nibbles.run(&counts, pixels)? {
            let folded = nibbles.number().map_err(|cause| cause.at(&counts, pixels))?;
            let difference = (folded >> 1) as i32 ^ -((folded & 1) as i32);
            let count = i32::from(previous) + difference;
            previous = u16::try_from(count).map_err(|_| RvlError::Number { at: counts.len() })?;
            counts.push(previous);
        }
    }
    Ok(counts)
}

/// Why there is no number.
enum Cause {
    Ended,
    Long,
}

impl Cause {
    fn at(self, counts: &[u16], pixels: usize) -> RvlError {
        match self {
            Self::Ended => RvlError::Short { expected: pixels, got: counts.len() },
            Self::Long => RvlError::Number { at: counts.len() },
        }
    }
}

struct Nibbles<'a> {
    words: std::slice::Iter<'a, [u8; 4]>,
    /// The nibbles of the word that are left, from the highest down.
    word: u32,
    left: u32,
}

impl Nibbles<'_> {
    fn number(&mut self) -> Result<u32, Cause> {
        let (mut number, mut bits) = (0, 0);
        loop {
            if self.left == 0 {
                self.word = u32::from_le_bytes(*self.words.next().ok_or(Cause::Ended)?);
                self.left = 8;
            }
            let nibble = self.word >> 28;
            (self.word, self.left) = (self.word << 4, self.left - 1);
            number |= (nibble & 7) << bits;
            bits += 3;
            match nibble & 8 {
                0 => return Ok(number),
                _ if bits < MOST_BITS => {}
                _ => return Err(Cause::Long),
            }
        }
    }

    /// The length of a run that fits into what is left.
    fn run(&mut self, counts: &[u16], pixels: usize) -> Result<usize, RvlError> {
        let run = self.number().map_err(|cause| cause.at(counts, pixels))?;
        let left = pixels - counts.len();
        if run as usize <= left { Ok(run as usize) } else { Err(RvlError::Run { run, left }) }
    }
}

/// The same the other way, as cameras' drivers do it.
#[cfg(test)]
pub(super) fn pack(counts: &[u16]) -> Vec<u8> {
    let mut nibbles = Vec::new();
    let mut put = |mut number: u32| {
        while number > 7 {
            nibbles.push((number & 7) | 8);
            number >>= 3;
        }
        nibbles.push(number);
    };
    let (mut rest, mut previous) = (counts, 0);
    while !rest.is_empty() {
        let empty = rest.iter().take_while(|count| **count == 0).count();
        let full = rest[empty..].iter().take_while(|count| **count != 0).count();
        put(empty as u32);
        put(full as u32);
        for count in &rest[empty..empty + full] {
            let difference = i32::from(*count) - previous;
            put(((difference << 1) ^ (difference >> 31)) as u32);
            previous = i32::from(*count);
        }
        rest = &rest[empty + full..];
    }
    nibbles.chunks(8).flat_map(|word| word.iter().enumerate().fold(0, |all, (i, n)| all | (n << (28 - 4 * i))).to_le_bytes()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_worked_out_by_hand_are_read_and_written() {
        // Two empty pixels, then two: +5 is 10, in nibbles 2 with more to come and 1; +1 is 2. Then one empty, one of −4, which is 7.
        let (counts, bytes) = ([0, 0, 5, 6, 0, 2], [0x17, 0x21, 0xa1, 0x22]);
        assert_eq!(unpack(&bytes, 6), Ok(counts.to_vec()));
        assert_eq!(pack(&counts), bytes);
    }

    #[test]
    fn every_picture_comes_back() {
        let mut state = 7u32;
        let mut drawn = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state >> 8
        };
        let noisy: Vec<u16> = (0..5000).map(|i| if i % 700 < 90 { 0 } else { (900 + i / 3 + drawn() % 40) as u16 }).collect();
        let wild: Vec<u16> = (0..5000).map(|_| if drawn().is_multiple_of(3) { 0 } else { drawn() as u16 }).collect();
        for counts in [vec![], vec![0; 307_200], vec![65_535; 9], vec![65_535, 1, 65_535, 0, 1], noisy, wild] {
            let packed = pack(&counts);
            assert_eq!(unpack(&packed, counts.len()), Ok(counts));
        }
    }

    #[test]
    fn what_no_encoder_writes_is_refused() {
        let packed = pack(&[1000; 40]);
        assert_eq!(unpack(&packed[..4], 40), Err(RvlError::Short { expected: 40, got: 2 }));
        assert_eq!(unpack(&packed, 39), Err(RvlError::Run { run: 40, left: 39 }));
        assert_eq!(unpack(&[0xff; 8], 10), Err(RvlError::Number { at: 0 }));
        // No empty pixel, one of −1.
        assert_eq!(unpack(&[0, 0, 0x10, 0x01], 1), Err(RvlError::Number { at: 0 }));
        assert_eq!(unpack(&[], 1), Err(RvlError::Short { expected: 1, got: 0 }));
        // Runs of nothing lead nowhere, and end with the bytes.
        assert_eq!(unpack(&[0; 4000], 1), Err(RvlError::Short { expected: 1, got: 0 }));
    }
}
