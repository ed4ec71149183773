//! What conjugate gradients have learned of a matrix, for the next equations with nearly the same one.
//!
//! Directions p with `y = H p` make the matrix near that of the step the right one on what they span, by the update of limited memory
//! (J. L. Morales, J. Nocedal, Automatic preconditioning by limited memory quasi-Newton updating, SIAM J. Optim. 10 (2000), 1079-1096).

use dynocal_numerics::linalg::{axpy, dot};

/// Most directions that are kept.
const MOST: usize = 128;

/// Directions with what the matrix makes of them, the oldest first.
#[derive(Default)]
pub(in super::super) struct Pairs {
    list: Vec<Pair>,
}

struct Pair {
    p: Vec<f64>,
    y: Vec<f64>,
    curvature: f64,
}

impl Pairs {
    /// The directions so far, beyond which new ones are kept for later.
    pub(super) fn len(&self) -> usize {
        self.list.len()
    }

    /// Keeps a direction.
    pub(super) fn push(&mut self, p: &[f64], y: &[f64], curvature: f64) {
        self.list.push(Pair { p: p.to_vec(), y: y.to_vec(), curvature });
    }

    /// Lets the oldest go.
    pub(super) fn trim(&mut self) {
        let over = self.list.len().saturating_sub(MOST);
        self.list.drain(..over);
    }

    /// Solves with the matrix that `near` solves with, made right on the first `count` directions, over the cells that move.
    pub(super) fn solve<E>(
        &self,
        count: usize,
        r: &[f64],
        moves: &[bool],
        near: impl Fn(&[f64]) -> Result<Vec<f64>, E>,
    ) -> Result<Vec<f64>, E> {
        let mut q = r.to_vec();
        let list = &self.list[..count.min(self.list.len())];
        let mut shares = vec![0.0; list.len()];
        for (pair, share) in list.iter().zip(&mut shares).rev() {
            *share = dot(&pair.p, &q) / pair.curvature;
            axpy(-*share, &pair.y, &mut q);
        }
        let masked =
            |v: &mut [f64]| v.iter_mut().zip(moves).filter(|(_, m)| !**m).for_each(|(v, _)| *v = 0.0);
        masked(&mut q);
        let mut z = near(&q)?;
        for (pair, share) in list.iter().zip(shares) {
            let back = dot(&pair.y, &z) / pair.curvature;
            axpy(share - back, &pair.p, &mut z);
        }
        masked(&mut z);
        Ok(z)
    }
}
