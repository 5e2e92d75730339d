//! What a vector can do, and the vector that every machine has.

/// Operations on a vector of [`Lanes::COUNT`] floats.
///
/// The functions are `unsafe` because they may only run where their instruction set is present; all of them are `inline(always)`, so that
/// they are compiled with their caller's features.
#[allow(
    clippy::missing_safety_doc,
    reason = "one contract for all: the instruction set must be present; pointers are good for COUNT floats"
)]
pub trait Lanes {
    /// The register.
    type V: Copy;
    /// Floats in a register; a divisor of 16.
    const COUNT: usize;
    /// How many registers there are.
    const REGISTERS: usize;

    /// All lanes the same.
    unsafe fn splat(value: f32) -> Self::V;
    /// Lanes from memory, unaligned.
    unsafe fn load(from: *const f32) -> Self::V;
    /// Lanes to memory, unaligned.
    unsafe fn store(to: *mut f32, value: Self::V);
    /// `a + b`.
    unsafe fn add(a: Self::V, b: Self::V) -> Self::V;
    /// `a − b`.
    unsafe fn sub(a: Self::V, b: Self::V) -> Self::V;
    /// `a · b`.
    unsafe fn mul(a: Self::V, b: Self::V) -> Self::V;
    /// `a · b + c`.
    unsafe fn fma(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// The larger.
    unsafe fn max(a: Self::V, b: Self::V) -> Self::V;
    /// The smaller.
    unsafe fn min(a: Self::V, b: Self::V) -> Self::V;
    /// Without the sign.
    unsafe fn abs(a: Self::V) -> Self::V;
    /// The square root.
    unsafe fn sqrt(a: Self::V) -> Self::V;
    /// Where `value > best`: (`value`, `row`), elsewhere (`best`, `best_row`).
    unsafe fn larger(value: Self::V, best: Self::V, row: Self::V, best_row: Self::V) -> (Self::V, Self::V);
    /// The integer part of numbers from 0 to 2³¹.
    unsafe fn truncate(a: Self::V) -> Self::V;
    /// Bit `k` is set where lane `k` of `a` is less than that of `b`.
    unsafe fn less(a: Self::V, b: Self::V) -> u32;
    /// The numbers at the integer indices `at`, which must lie within what `from` points to.
    unsafe fn gather(from: *const f32, at: Self::V) -> Self::V;
    /// The smallest lane.
    unsafe fn smallest(a: Self::V) -> f32;
    /// The largest lane.
    unsafe fn largest(a: Self::V) -> f32;
}

/// Four floats that the compiler maps to whatever the target has.
#[derive(Debug)]
pub struct Plain;

// SAFETY (of the whole block): no instruction set beyond the target's own is used; pointers are good by the trait's contract.
#[allow(clippy::undocumented_unsafe_blocks, reason = "one contract, stated once above, covers these one-line bodies")]
impl Lanes for Plain {
    type V = [f32; 4];
    const COUNT: usize = 4;
    const REGISTERS: usize = 16;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self::V {
        [value; 4]
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self::V {
        unsafe { from.cast::<[f32; 4]>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn store(to: *mut f32, value: Self::V) {
        unsafe { to.cast::<[f32; 4]>().write_unaligned(value) }
    }
    #[inline(always)]
    unsafe fn add(a: Self::V, b: Self::V) -> Self::V {
        std::array::from_fn(|i| a[i] + b[i])
    }
    #[inline(always)]
    unsafe fn sub(a: Self::V, b: Self::V) -> Self::V {
        std::array::from_fn(|i| a[i] - b[i])
    }
    #[inline(always)]
    unsafe fn mul(a: Self::V, b: Self::V) -> Self::V {
        std::array::from_fn(|i| a[i] * b[i])
    }
    #[inline(always)]
    unsafe fn fma(a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        std::array::from_fn(|i| a[i] * b[i] + c[i])
    }
    #[inline(always)]
    unsafe fn max(a: Self::V, b: Self::V) -> Self::V {
        std::array::from_fn(|i| if a[i] > b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    unsafe fn min(a: Self::V, b: Self::V) -> Self::V {
        std::array::from_fn(|i| if a[i] < b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    unsafe fn abs(a: Self::V) -> Self::V {
        a.map(f32::abs)
    }
    #[inline(always)]
    unsafe fn sqrt(a: Self::V) -> Self::V {
        a.map(f32::sqrt)
    }
    #[inline(always)]
    unsafe fn larger(value: Self::V, best: Self::V, row: Self::V, best_row: Self::V) -> (Self::V, Self::V) {
        let wins: [bool; 4] = std::array::from_fn(|i| value[i] > best[i]);
        (
            std::array::from_fn(|i| if wins[i] { value[i] } else { best[i] }),
            std::array::from_fn(|i| if wins[i] { row[i] } else { best_row[i] }),
        )
    }
    #[inline(always)]
    unsafe fn truncate(a: Self::V) -> Self::V {
        a.map(|v| v as i32 as f32)
    }
    #[inline(always)]
    unsafe fn less(a: Self::V, b: Self::V) -> u32 {
        (0..4).map(|i| u32::from(a[i] < b[i]) << i).sum()
    }
    #[inline(always)]
    unsafe fn gather(from: *const f32, at: Self::V) -> Self::V {
        at.map(|index| unsafe { *from.add(index as usize) })
    }
    #[inline(always)]
    unsafe fn smallest(a: Self::V) -> f32 {
        a[0].min(a[1]).min(a[2].min(a[3]))
    }
    #[inline(always)]
    unsafe fn largest(a: Self::V) -> f32 {
        a[0].max(a[1]).max(a[2].max(a[3]))
    }
}
