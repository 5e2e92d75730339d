//! Vectors of `f32` for three instruction sets under one trait: many configurations of the arm at once, each algorithm written once.
//!
//! The functions are `unsafe` because they may only run where their instruction set does: callers are `#[target_feature]` functions that are
//! entered after [`InstructionSet::detect`]. Everything is `inline(always)`, so that it compiles with the caller's features.

/// Which instruction set is used. Results of different sets differ in their last bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum InstructionSet {
    /// Sixteen floats at once, fused multiply-add.
    Avx512,
    /// Eight floats at once, fused multiply-add.
    Avx2,
    /// What the target has without asking; separate multiply and add.
    Plain,
}

impl InstructionSet {
    /// The widest that this machine has.
    pub fn detect() -> Self {
        Self::available()[0]
    }

    /// All that this machine has, widest first.
    pub fn available() -> Vec<Self> {
        [Self::Avx512, Self::Avx2, Self::Plain].into_iter().filter(|set| set.is_available()).collect()
    }

    fn is_available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            Self::Plain => true,
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }
}

/// A vector of [`Lanes::COUNT`] floats.
#[allow(
    clippy::missing_safety_doc,
    reason = "one contract for all: the instruction set must be present; pointers are good for COUNT floats"
)]
pub trait Lanes {
    /// The register.
    type V: Copy;
    /// Floats in a register; a divisor of 16.
    const COUNT: usize;

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

/// Portable: four floats that the compiler may map to whatever the target has.
#[derive(Debug)]
pub struct Plain;

/// AVX2 with FMA.
#[cfg(target_arch = "x86_64")]
#[derive(Debug)]
pub struct Avx2;

/// AVX-512 (foundation, double and quad words).
#[cfg(target_arch = "x86_64")]
#[derive(Debug)]
pub struct Avx512;

// SAFETY (of the whole block): no instruction set beyond the target's own is used; pointers are good by the trait's contract.
#[allow(clippy::undocumented_unsafe_blocks, reason = "one contract, stated once above, covers these one-line bodies")]
impl Lanes for Plain {
    type V = [f32; 4];
    const COUNT: usize = 4;

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

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::{Avx2, Avx512, Lanes};

    // SAFETY (of the whole block): the trait's contract is that AVX2 and FMA are present and pointers are good.
    #[allow(clippy::undocumented_unsafe_blocks, reason = "one contract, stated once above, covers these one-line bodies")]
    impl Lanes for Avx2 {
        type V = __m256;
        const COUNT: usize = 8;

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
}
