//! Vectors of `f32` for three instruction sets under one trait, so that every algorithm is written once.
//!
//! The functions are `unsafe` because they may only run where their instruction set does; the callers in [`super`] are
//! `#[target_feature]` functions that are entered after run-time detection. Everything is `inline(always)`, so that it compiles with the
//! caller's features.

/// A vector of [`Simd::LANES`] floats.
pub(crate) trait Simd {
    /// The register.
    type V: Copy;
    /// Floats in a register.
    const LANES: usize;

    /// All lanes the same.
    ///
    /// # Safety
    /// The instruction set must be present (as for every function here).
    unsafe fn splat(value: f32) -> Self::V;
    /// # Safety
    /// `from` must be readable for [`Simd::LANES`] floats.
    unsafe fn load(from: *const f32) -> Self::V;
    /// # Safety
    /// `to` must be writable for [`Simd::LANES`] floats.
    unsafe fn store(to: *mut f32, value: Self::V);
    /// `a · b + c`.
    ///
    /// # Safety
    /// The instruction set must be present.
    unsafe fn fma(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// # Safety
    /// The instruction set must be present.
    unsafe fn add(a: Self::V, b: Self::V) -> Self::V;
    /// # Safety
    /// The instruction set must be present.
    unsafe fn sub(a: Self::V, b: Self::V) -> Self::V;
    /// # Safety
    /// The instruction set must be present.
    unsafe fn max(a: Self::V, b: Self::V) -> Self::V;
    /// Where `value > best`: (`value`, `row`), elsewhere (`best`, `best_row`).
    ///
    /// # Safety
    /// The instruction set must be present.
    unsafe fn larger(value: Self::V, best: Self::V, row: Self::V, best_row: Self::V) -> (Self::V, Self::V);
}

/// Portable: four floats that the compiler may map to whatever the target has.
pub(crate) struct Plain;

// SAFETY: the functions use no instruction set beyond the target's own; `load` and `store` need what the trait says.
impl Simd for Plain {
    type V = [f32; 4];
    const LANES: usize = 4;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self::V {
        [value; 4]
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self::V {
        // SAFETY: readable for four floats by the trait's contract.
        unsafe { from.cast::<[f32; 4]>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn store(to: *mut f32, value: Self::V) {
        // SAFETY: writable for four floats by the trait's contract.
        unsafe { to.cast::<[f32; 4]>().write_unaligned(value) }
    }
    #[inline(always)]
    unsafe fn fma(a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        std::array::from_fn(|i| a[i] * b[i] + c[i])
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
    unsafe fn max(a: Self::V, b: Self::V) -> Self::V {
        std::array::from_fn(|i| if a[i] > b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    unsafe fn larger(value: Self::V, best: Self::V, row: Self::V, best_row: Self::V) -> (Self::V, Self::V) {
        let wins: [bool; 4] = std::array::from_fn(|i| value[i] > best[i]);
        (
            std::array::from_fn(|i| if wins[i] { value[i] } else { best[i] }),
            std::array::from_fn(|i| if wins[i] { row[i] } else { best_row[i] }),
        )
    }
}

/// AVX2 with FMA.
#[cfg(target_arch = "x86_64")]
pub(crate) struct Avx2;

/// AVX-512 (foundation).
#[cfg(target_arch = "x86_64")]
pub(crate) struct Avx512;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::{Avx2, Avx512, Simd};

    // SAFETY (of the whole block): the trait's contract is that AVX2 and FMA are present and pointers are good for eight floats.
    #[allow(clippy::undocumented_unsafe_blocks, reason = "one contract, stated once above, covers these one-line bodies")]
    impl Simd for Avx2 {
        type V = __m256;
        const LANES: usize = 8;

        #[inline(always)]
        unsafe fn splat(value: f32) -> __m256 {
            unsafe { _mm256_set1_ps(value) }
        }
        #[inline(always)]
        unsafe fn load(from: *const f32) -> __m256 {
            unsafe { _mm256_loadu_ps(from) }
        }
        #[inline(always)]
        unsafe fn store(to: *mut f32, value: __m256) {
            unsafe { _mm256_storeu_ps(to, value) }
        }
        #[inline(always)]
        unsafe fn fma(a: __m256, b: __m256, c: __m256) -> __m256 {
            unsafe { _mm256_fmadd_ps(a, b, c) }
        }
        #[inline(always)]
        unsafe fn add(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_add_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn sub(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_sub_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn max(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_max_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn larger(value: __m256, best: __m256, row: __m256, best_row: __m256) -> (__m256, __m256) {
            unsafe {
                let wins = _mm256_cmp_ps::<_CMP_GT_OQ>(value, best);
                (_mm256_blendv_ps(best, value, wins), _mm256_blendv_ps(best_row, row, wins))
            }
        }
    }

    // SAFETY (of the whole block): the trait's contract is that AVX-512F is present and pointers are good for sixteen floats.
    #[allow(clippy::undocumented_unsafe_blocks, reason = "one contract, stated once above, covers these one-line bodies")]
    impl Simd for Avx512 {
        type V = __m512;
        const LANES: usize = 16;

        #[inline(always)]
        unsafe fn splat(value: f32) -> __m512 {
            unsafe { _mm512_set1_ps(value) }
        }
        #[inline(always)]
        unsafe fn load(from: *const f32) -> __m512 {
            unsafe { _mm512_loadu_ps(from) }
        }
        #[inline(always)]
        unsafe fn store(to: *mut f32, value: __m512) {
            unsafe { _mm512_storeu_ps(to, value) }
        }
        #[inline(always)]
        unsafe fn fma(a: __m512, b: __m512, c: __m512) -> __m512 {
            unsafe { _mm512_fmadd_ps(a, b, c) }
        }
        #[inline(always)]
        unsafe fn add(a: __m512, b: __m512) -> __m512 {
            unsafe { _mm512_add_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn sub(a: __m512, b: __m512) -> __m512 {
            unsafe { _mm512_sub_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn max(a: __m512, b: __m512) -> __m512 {
            unsafe { _mm512_max_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn larger(value: __m512, best: __m512, row: __m512, best_row: __m512) -> (__m512, __m512) {
            unsafe {
                let wins = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(value, best);
                (_mm512_mask_blend_ps(wins, best, value), _mm512_mask_blend_ps(wins, best_row, row))
            }
        }
    }
}
