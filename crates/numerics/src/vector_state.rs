//! Leaves the processor's vector registers as ordinary code expects them.
//!
//! The matrix kernels behind [`crate::linalg`] and [`crate::nlp`] are hand-written for wide vectors and return with
//! the upper halves of the registers in use. On many processors every ordinary floating-point instruction then waits
//! for them: the engine model ran eight times slower on a thread that had formed one Gram matrix before. A function
//! that is compiled for wide vectors and uses them clears the upper halves when it returns; this is one.

use std::hint::black_box;

/// Clears the upper halves of the vector registers, where the processor has any. Costs a few nanoseconds.
#[inline(never)]
pub(crate) fn clear() {
    pulp::Arch::new().dispatch(Touch);
}

struct Touch;

impl pulp::WithSimd for Touch {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        // Something the compiler cannot leave out and can only do in the widest registers of `S`.
        black_box(simd.add_f64s(black_box(simd.splat_f64s(1.0)), simd.splat_f64s(2.0)));
    }
}
