//! Vectors of `f32` on the widest instruction set of the machine, with every algorithm written once.
//!
//! An algorithm is a [`Work`]: a struct of its operands and one generic function over [`Lanes`]. [`InstructionSet::run`] compiles it for
//! each instruction set and enters the right one. Only detection makes an [`InstructionSet`], so a program cannot reach instructions that
//! the machine lacks.
//!
//! ```
//! use repose_simd::{InstructionSet, Lanes, Work};
//!
//! /// The dot product of two rows of the same length, a multiple of 16.
//! struct Dot<'a>(&'a [f32], &'a [f32]);
//!
//! impl Work for Dot<'_> {
//!     type Output = f32;
//!
//!     #[inline(always)]
//!     unsafe fn run<L: Lanes>(self) -> f32 {
//!         assert!(self.0.len() == self.1.len() && self.0.len() % 16 == 0);
//!         let mut lanes = [0.0; 16];
//!         // SAFETY: `InstructionSet::run` enters this with the instruction set present; every vector lies in both rows.
//!         unsafe {
//!             let mut sum = L::splat(0.0);
//!             for i in (0..self.0.len()).step_by(L::COUNT) {
//!                 sum = L::fma(L::load(self.0.as_ptr().add(i)), L::load(self.1.as_ptr().add(i)), sum);
//!             }
//!             L::store(lanes.as_mut_ptr(), sum);
//!         }
//!         lanes.iter().sum()
//!     }
//! }
//!
//! for set in InstructionSet::available() {
//!     assert_eq!(set.run(Dot(&[2.0; 32], &[0.5; 32])), 32.0);
//! }
//! ```
//!
//! Results of different instruction sets differ in their last bits: [`Plain`] multiplies and adds in two roundings, the others in one.
//! `pulp` offers the same dispatch, but its portable trait has neither gather nor truncation, which the grid look-up of collision checking
//! is made of, and no indexed maximum for the backward pass of the networks.

mod instruction_set;
mod lanes;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use instruction_set::{InstructionSet, SimdLevel, Work};
pub use lanes::{Lanes, Plain};
#[cfg(target_arch = "x86_64")]
pub use x86::{Avx2, Avx512};
