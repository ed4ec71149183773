//! The dense front of [`super::frontal`]: partial factorisation with threshold pivoting.

/// Largest entry of L is 1 over this.
const THRESHOLD: f64 = 1e-4;
/// What is smaller than this times the largest original entry of its row is zero to rounding.
const ZERO: f64 = 10.0 * f64::EPSILON;
/// Share of a 2x2 determinant that must survive its subtraction.
const DETERMINANT: f64 = 1e-10;

/// One eliminated column's part of D^-1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pivot {
    /// Diagonal entry of D^-1.
    pub(super) inverse: f64,
    /// Off-diagonal entry of the 2x2 block that begins here.
    pub(super) off: f64,
    /// Whether a 2x2 block begins here.
    pub(super) pair: bool,
    /// Sign of one eigenvalue of D.
    pub(super) positive: bool,
}

/// Lower triangle by columns of length `most`; the first `summed` rows and columns are complete.
pub(super) struct Front {
    pub(super) most: usize,
    pub(super) width: usize,
    pub(super) summed: usize,
    /// Eliminated columns, the first ones.
    pub(super) done: usize,
    pub(super) a: Vec<f64>,
    /// L D of the eliminated columns, by columns of length `most`.
    ld: Vec<f64>,
    /// Position of each row in the chain.
    pub(super) index: Vec<usize>,
}

impl Front {
    pub(super) fn new(most: usize) -> Self {
        Self {
            most,
            width: 0,
            summed: 0,
            done: 0,
            a: vec![0.0; most * most],
            ld: vec![0.0; most * most],
            index: vec![0; most],
        }
    }

    pub(super) fn empty(&mut self) {
        (self.width, self.summed, self.done) = (0, 0, 0);
    }

    #[inline(always)]
    pub(super) fn start(&mut self, width: usize, summed: usize) {
        (self.width, self.summed, self.done) = (width, summed, 0);
        for j in 0..width {
            self.a[j * self.most + j..j * self.most + width].fill(0.0);
        }
    }

    /// Column `j` from the diagonal on.
    #[inline(always)]
    pub(super) fn column(&self, j: usize) -> &[f64] {
        &self.a[j * self.most + j..j * self.most + self.width]
    }

    /// Entry of the symmetric matrix.
    #[inline(always)]
    fn at(&self, i: usize, j: usize) -> f64 {
        self.a[i.min(j) * self.most + i.max(j)]
    }

    /// Largest |entry| of column `c` over the rows not eliminated, `c` and `but` left out; with the row where the
    /// largest over the fully summed ones stands.
    #[inline(always)]
    fn largest(&self, c: usize, but: usize) -> (f64, f64, usize) {
        let (mut best, mut at) = (0.0f64, c);
        for j in self.done..self.summed {
            let v = if j == c || j == but { 0.0 } else { self.at(c, j).abs() };
            if v > best {
                (best, at) = (v, j);
            }
        }
        let below = &self.a[c * self.most + self.summed..c * self.most + self.width];
        let larger = |m: f64, v: f64| if v > m { v } else { m };
        let all = below.iter().fold(best, |m, v| larger(m, v.abs()));
        (all, best, at)
    }

    /// Eliminates all fully summed columns that find a stable pivot, then updates the rest.
    #[inline(always)]
    pub(super) fn eliminate(&mut self, size: &[f64], pivots: &mut Vec<Pivot>) {
        let mut candidate = 0;
        let mut refused = 0;
        while self.done < self.summed && refused < self.summed - self.done {
            candidate = if candidate < self.summed { candidate.max(self.done) } else { self.done };
            if self.try_pivot(candidate, size, pivots) {
                refused = 0;
                candidate = self.done;
            } else {
                refused += 1;
                candidate += 1;
            }
        }
        self.update_rest();
    }

    /// Eliminates column `c`, alone or with its largest partner, when that is stable.
    #[inline(always)]
    fn try_pivot(&mut self, c: usize, size: &[f64], pivots: &mut Vec<Pivot>) -> bool {
        let (all, best, partner) = self.largest(c, c);
        let d = self.at(c, c);
        let zero = ZERO * size[self.index[c]];
        if d.abs() > zero && d.abs() >= THRESHOLD * all {
            self.swap(self.done, c);
            self.eliminate_one(d);
            pivots.push(Pivot { inverse: 1.0 / d, off: 0.0, pair: false, positive: d > 0.0 });
            return true;
        }
        if best <= zero {
            return false;
        }
        let (e, o) = (self.at(partner, partner), self.at(c, partner));
        let det = d * e - o * o;
        if det.abs() < DETERMINANT * (o * o).max((d * e).abs()) || det == 0.0 {
            return false;
        }
        let (gc, _, _) = self.largest(c, partner);
        let (gp, _, _) = self.largest(partner, c);
        let most = det.abs() / THRESHOLD;
        if e.abs() * gc + o.abs() * gp > most || o.abs() * gc + d.abs() * gp > most {
            return false;
        }
        let first = self.done;
        self.swap(first, c);
        self.swap(first + 1, if partner == first { c } else { partner });
        let inverse = [e / det, -o / det, d / det];
        self.eliminate_two(&inverse);
        let one = if det < 0.0 { true } else { d > 0.0 };
        let other = if det < 0.0 { false } else { one };
        pivots.push(Pivot { inverse: inverse[0], off: inverse[1], pair: true, positive: one });
        pivots.push(Pivot { inverse: inverse[2], off: 0.0, pair: false, positive: other });
        true
    }

    /// Exchanges rows and columns `p <= q`.
    #[inline(always)]
    fn swap(&mut self, p: usize, q: usize) {
        if p == q {
            return;
        }
        let m = self.most;
        self.index.swap(p, q);
        self.a.swap(p * m + p, q * m + q);
        for j in 0..p {
            self.a.swap(j * m + p, j * m + q);
        }
        for j in p + 1..q {
            self.a.swap(p * m + j, j * m + q);
        }
        for i in q + 1..self.width {
            self.a.swap(p * m + i, q * m + i);
        }
    }

    #[inline(always)]
    fn eliminate_one(&mut self, d: f64) {
        let (k, m, f) = (self.done, self.most, self.width);
        let (left, right) = self.a.split_at_mut((k + 1) * m);
        let l = &mut left[k * m..k * m + f];
        let w = &mut self.ld[k * m..k * m + f];
        w[k + 1..].copy_from_slice(&l[k + 1..]);
        let inverse = 1.0 / d;
        l[k + 1..].iter_mut().for_each(|v| *v *= inverse);
        for j in k + 1..self.summed {
            let v = w[j];
            if v != 0.0 {
                let from = (j - k - 1) * m;
                right[from + j..from + f].iter_mut().zip(&l[j..]).for_each(|(a, l)| *a -= v * l);
            }
        }
        self.done += 1;
    }

    #[inline(always)]
    fn eliminate_two(&mut self, inverse: &[f64; 3]) {
        let (k, m, f) = (self.done, self.most, self.width);
        let (left, right) = self.a.split_at_mut((k + 2) * m);
        let (l0, l1) = left[k * m..].split_at_mut(m);
        let (l0, l1) = (&mut l0[..f], &mut l1[..f]);
        let (w0, w1) = self.ld[k * m..(k + 2) * m].split_at_mut(m);
        let (w0, w1) = (&mut w0[..f], &mut w1[..f]);
        w0[k + 2..].copy_from_slice(&l0[k + 2..]);
        w1[k + 2..].copy_from_slice(&l1[k + 2..]);
        // L is the identity within the block.
        l0[k + 1] = 0.0;
        for i in k + 2..f {
            l0[i] = inverse[0] * w0[i] + inverse[1] * w1[i];
            l1[i] = inverse[1] * w0[i] + inverse[2] * w1[i];
        }
        for j in k + 2..self.summed {
            let (v0, v1) = (w0[j], w1[j]);
            let from = (j - k - 2) * m;
            let column = &mut right[from + j..from + f];
            for ((a, l0), l1) in column.iter_mut().zip(&l0[j..]).zip(&l1[j..]) {
                *a -= v0 * l0 + v1 * l1;
            }
        }
        self.done += 2;
    }

    /// Takes all eliminated columns off the part that is not fully summed, four at a time.
    #[inline(always)]
    fn update_rest(&mut self) {
        let (m, f) = (self.most, self.width);
        let (left, right) = self.a.split_at_mut(self.summed * m);
        for j in self.summed..f {
            let from = (j - self.summed) * m;
            let column = &mut right[from + j..from + f];
            let len = column.len();
            let mut k = 0;
            while k + 4 <= self.done {
                let l = |q: usize| &left[(k + q) * m + j..(k + q) * m + j + len];
                let w: [f64; 4] = std::array::from_fn(|q| self.ld[(k + q) * m + j]);
                let (l0, l1, l2, l3) = (l(0), l(1), l(2), l(3));
                for i in 0..len {
                    column[i] -= (w[0] * l0[i] + w[1] * l1[i]) + (w[2] * l2[i] + w[3] * l3[i]);
                }
                k += 4;
            }
            while k < self.done {
                let v = self.ld[k * m + j];
                let l = &left[k * m + j..k * m + j + len];
                column.iter_mut().zip(l).for_each(|(a, l)| *a -= v * l);
                k += 1;
            }
        }
    }
}
