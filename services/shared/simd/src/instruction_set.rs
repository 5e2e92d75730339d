//! Which instruction set the machine has, and entering code that was compiled for it.

use crate::lanes::{Lanes, Plain};
#[cfg(target_arch = "x86_64")]
use crate::x86::{Avx2, Avx512};

/// The instruction sets that algorithms are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SimdLevel {
    /// Sixteen floats at once, fused multiply-add: AVX-512 F, BW, DQ and VL (Intel since Skylake-X, AMD since Zen 4).
    Avx512,
    /// Eight floats at once, fused multiply-add: AVX2 and FMA.
    Avx2,
    /// Four floats at once, with what the compilation target always has; multiplies and adds separately.
    Plain,
}

/// An instruction set that this machine has. Only detection makes a value, so holding one is the permission to run its instructions.
///
/// ```compile_fail
/// let set = repose_simd::InstructionSet(repose_simd::SimdLevel::Avx512); // the field is private
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct InstructionSet(SimdLevel);

/// An algorithm over vectors of any width.
pub trait Work {
    /// Its result.
    type Output;

    /// The algorithm. Implementations must be `#[inline(always)]`, and so must be what they call with `L`: only then are they compiled with
    /// the instruction set. Closures are not, and must not use `L`.
    ///
    /// # Safety
    /// The instruction set of `L` must be present. [`InstructionSet::run`] sees to it.
    unsafe fn run<L: Lanes>(self) -> Self::Output;
}

impl InstructionSet {
    /// The widest instruction set of this machine.
    pub fn detect() -> Self {
        Self::available()[0]
    }

    /// All instruction sets of this machine, widest first; [`SimdLevel::Plain`] is always the last.
    pub fn available() -> Vec<Self> {
        [SimdLevel::Avx512, SimdLevel::Avx2, SimdLevel::Plain].into_iter().filter(|family| is_present(*family)).map(Self).collect()
    }

    /// Which it is.
    pub fn family(self) -> SimdLevel {
        self.0
    }

    /// Runs an algorithm compiled for this instruction set.
    #[inline]
    pub fn run<W: Work>(self, work: W) -> W::Output {
        // SAFETY: values are made by `available` only, which detected every feature that the entered function enables.
        unsafe {
            match self.0 {
                #[cfg(target_arch = "x86_64")]
                SimdLevel::Avx512 => run_avx512(work),
                #[cfg(target_arch = "x86_64")]
                SimdLevel::Avx2 => run_avx2(work),
                _ => work.run::<Plain>(),
            }
        }
    }
}

fn is_present(family: SimdLevel) -> bool {
    match family {
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx512 => {
            is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
                && is_present(SimdLevel::Avx2)
        }
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
        SimdLevel::Plain => true,
        #[cfg(not(target_arch = "x86_64"))]
        _ => false,
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
fn run_avx512<W: Work>(work: W) -> W::Output {
    // SAFETY: this function's features are those of `Avx512`.
    unsafe { work.run::<Avx512>() }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn run_avx2<W: Work>(work: W) -> W::Output {
    // SAFETY: this function's features are those of `Avx2`.
    unsafe { work.run::<Avx2>() }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Every operation of [`Lanes`] on one set of operands: lane by lane, then what reduces.
    struct Everything<'a> {
        a: &'a [f32; 16],
        b: &'a [f32; 16],
        table: &'a [f32; 16],
    }

    impl Work for Everything<'_> {
        type Output = (Vec<[f32; 16]>, u32, f32, f32);

        #[inline(always)]
        unsafe fn run<L: Lanes>(self) -> Self::Output {
            let mut rows = vec![[0.0; 16]; 11];
            let (mut less, mut smallest, mut largest) = (0, f32::INFINITY, f32::NEG_INFINITY);
            for i in (0..16).step_by(L::COUNT) {
                // SAFETY: the set is present, every vector lies in its row, and indices into the table are brought below 16.
                unsafe {
                    let (a, b) = (L::load(self.a.as_ptr().add(i)), L::load(self.b.as_ptr().add(i)));
                    let size = L::abs(a);
                    let index = L::min(size, L::splat(15.0));
                    let (winner, row) = L::larger(a, b, L::splat(1.0), L::splat(2.0));
                    let results = [
                        L::add(a, b),
                        L::sub(a, b),
                        L::mul(a, b),
                        L::fma(a, b, a),
                        L::max(a, b),
                        L::min(a, b),
                        L::sqrt(size),
                        L::truncate(size),
                        L::gather(self.table.as_ptr(), L::truncate(index)),
                        winner,
                        row,
                    ];
                    for (row, result) in rows.iter_mut().zip(results) {
                        L::store(row.as_mut_ptr().add(i), result);
                    }
                    less |= L::less(a, b) << i;
                    (smallest, largest) = (smallest.min(L::smallest(a)), largest.max(L::largest(a)));
                }
            }
            (rows, less, smallest, largest)
        }
    }

    proptest! {
        #[test]
        fn every_operation_agrees_with_scalar_arithmetic_on_every_set(
            a in prop::array::uniform16(-20.0..20.0f32), b in prop::array::uniform16(-20.0..20.0f32),
        ) {
            let table: [f32; 16] = std::array::from_fn(|i| 100.0 + i as f32);
            for set in InstructionSet::available() {
                let (rows, less, smallest, largest) = set.run(Everything { a: &a, b: &b, table: &table });
                for i in 0..16 {
                    let (x, y) = (a[i], b[i]);
                    let index = x.abs().min(15.0) as usize;
                    let winner = if x > y { (x, 1.0) } else { (y, 2.0) };
                    let exact = [
                        (0, x + y), (1, x - y), (2, x * y), (4, x.max(y)), (5, x.min(y)), (6, x.abs().sqrt()),
                        (7, x.abs().trunc()), (8, table[index]), (9, winner.0), (10, winner.1),
                    ];
                    for (row, expected) in exact {
                        prop_assert_eq!(rows[row][i], expected, "{:?}, row {}", set, row);
                    }
                    prop_assert!((rows[3][i] - (x * y + x)).abs() <= 1e-4);
                    prop_assert_eq!(less >> i & 1 == 1, x < y);
                }
                prop_assert_eq!(smallest, a.iter().copied().fold(f32::INFINITY, f32::min));
                prop_assert_eq!(largest, a.iter().copied().fold(f32::NEG_INFINITY, f32::max));
            }
        }
    }

    #[test]
    fn the_plain_set_is_always_there_and_the_widest_comes_first() {
        let all = InstructionSet::available();
        assert_eq!(all.last().map(|set| set.family()), Some(SimdLevel::Plain));
        assert_eq!(InstructionSet::detect(), all[0]);
    }
}
