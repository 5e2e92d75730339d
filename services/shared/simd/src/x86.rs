//! AVX2 and AVX-512.

use std::arch::x86_64::*;

use crate::lanes::Lanes;

/// AVX2 with FMA.
#[derive(Debug)]
pub struct Avx2;

/// AVX-512: foundation, byte and word, double and quad word, vector length.
#[derive(Debug)]
pub struct Avx512;

// SAFETY (of the whole block): the trait's contract is that AVX2 and FMA are present and pointers are good.
#[allow(clippy::undocumented_unsafe_blocks, reason = "one contract, stated once above, covers these one-line bodies")]
impl Lanes for Avx2 {
    type V = __m256;
    const COUNT: usize = 8;
    const REGISTERS: usize = 16;

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
    unsafe fn add(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_add_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn sub(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_sub_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn mul(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_mul_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn fma(a: __m256, b: __m256, c: __m256) -> __m256 {
        unsafe { _mm256_fmadd_ps(a, b, c) }
    }
    #[inline(always)]
    unsafe fn max(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_max_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn min(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_min_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn abs(a: __m256) -> __m256 {
        unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), a) }
    }
    #[inline(always)]
    unsafe fn sqrt(a: __m256) -> __m256 {
        unsafe { _mm256_sqrt_ps(a) }
    }
    #[inline(always)]
    unsafe fn larger(value: __m256, best: __m256, row: __m256, best_row: __m256) -> (__m256, __m256) {
        unsafe {
            let wins = _mm256_cmp_ps::<_CMP_GT_OQ>(value, best);
            (_mm256_blendv_ps(best, value, wins), _mm256_blendv_ps(best_row, row, wins))
        }
    }
    #[inline(always)]
    unsafe fn truncate(a: __m256) -> __m256 {
        unsafe { _mm256_cvtepi32_ps(_mm256_cvttps_epi32(a)) }
    }
    #[inline(always)]
    unsafe fn less(a: __m256, b: __m256) -> u32 {
        unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(a, b)) as u32 }
    }
    #[inline(always)]
    unsafe fn gather(from: *const f32, at: __m256) -> __m256 {
        unsafe { _mm256_i32gather_ps::<4>(from, _mm256_cvttps_epi32(at)) }
    }
    #[inline(always)]
    unsafe fn smallest(a: __m256) -> f32 {
        unsafe {
            let four = _mm_min_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps::<1>(a));
            let two = _mm_min_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_min_ss(two, _mm_shuffle_ps::<1>(two, two)))
        }
    }
    #[inline(always)]
    unsafe fn largest(a: __m256) -> f32 {
        unsafe {
            let four = _mm_max_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps::<1>(a));
            let two = _mm_max_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_max_ss(two, _mm_shuffle_ps::<1>(two, two)))
        }
    }
}

// SAFETY (of the whole block): the trait's contract is that AVX-512F and DQ are present and pointers are good.
#[allow(clippy::undocumented_unsafe_blocks, reason = "one contract, stated once above, covers these one-line bodies")]
impl Lanes for Avx512 {
    type V = __m512;
    const COUNT: usize = 16;
    const REGISTERS: usize = 32;

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
    unsafe fn add(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_add_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn sub(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_sub_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn mul(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_mul_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn fma(a: __m512, b: __m512, c: __m512) -> __m512 {
        unsafe { _mm512_fmadd_ps(a, b, c) }
    }
    #[inline(always)]
    unsafe fn max(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_max_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn min(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_min_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn abs(a: __m512) -> __m512 {
        unsafe { _mm512_abs_ps(a) }
    }
    #[inline(always)]
    unsafe fn sqrt(a: __m512) -> __m512 {
        unsafe { _mm512_sqrt_ps(a) }
    }
    #[inline(always)]
    unsafe fn larger(value: __m512, best: __m512, row: __m512, best_row: __m512) -> (__m512, __m512) {
        unsafe {
            let wins = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(value, best);
            (_mm512_mask_blend_ps(wins, best, value), _mm512_mask_blend_ps(wins, best_row, row))
        }
    }
    #[inline(always)]
    unsafe fn truncate(a: __m512) -> __m512 {
        unsafe { _mm512_cvtepi32_ps(_mm512_cvttps_epi32(a)) }
    }
    #[inline(always)]
    unsafe fn less(a: __m512, b: __m512) -> u32 {
        unsafe { u32::from(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b)) }
    }
    #[inline(always)]
    unsafe fn gather(from: *const f32, at: __m512) -> __m512 {
        unsafe { _mm512_i32gather_ps::<4>(_mm512_cvttps_epi32(at), from) }
    }
    #[inline(always)]
    unsafe fn smallest(a: __m512) -> f32 {
        unsafe { Avx2::smallest(_mm256_min_ps(_mm512_castps512_ps256(a), _mm512_extractf32x8_ps::<1>(a))) }
    }
    #[inline(always)]
    unsafe fn largest(a: __m512) -> f32 {
        unsafe { Avx2::largest(_mm256_max_ps(_mm512_castps512_ps256(a), _mm512_extractf32x8_ps::<1>(a))) }
    }
}
