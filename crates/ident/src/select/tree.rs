//! Moments of all products of a pool without storing the products.
//!
//! ```text
//! m_i = sum_t v(t) phi_i(t),    phi_i = x_a x_b x_c ...,    x: lagged inputs and outputs ("variables")
//! ```
//!
//! A product is its parent (all factors but the last) times one variable. With `v x_c` formed once per variable, the
//! moment of a candidate costs one multiply-add per sample: `m_i = sum_t (x_a x_b)(t) (v x_c)(t)`, and the parent is
//! shared by all candidates that continue it. Samples are taken in blocks that stay in the cache; blocks are summed in
//! chunks whose borders depend on the number of samples only, so that the result is the same for every number of
//! threads. Everything that forward regression needs (norms, products with the output and with the terms taken) is
//! such a moment.

use std::collections::BTreeMap;

use rayon::prelude::*;

/// Samples per block: the weighted variables of a usual pool stay in the first-level cache.
const BLOCK: usize = 128;
/// Least samples and largest number of chunks.
const CHUNK: usize = 8 * BLOCK;
const MAX_CHUNKS: usize = 64;
/// Children that one pass over a parent serves together.
const WIDE: usize = 4;

/// A product that has candidates as continuations: column `slot`, times one variable where it is not kept itself.
#[derive(Clone, Copy, Debug)]
struct Parent {
    slot: usize,
    times: Option<usize>,
    /// Range in [`Tree::children`].
    children: (usize, usize),
    /// Whether the next parent has children by the same variables: then both are served together.
    paired: bool,
}

/// (variable, candidate) of each continuation of a product.
type Children = Vec<(usize, usize)>;

/// The products of a pool, as a tree over their variables.
#[derive(Clone, Debug)]
pub(crate) struct Tree {
    variables: usize,
    candidates: usize,
    /// Products kept for a block: (column, variable). Columns are 0: ones, 1..=V: variables, then these.
    kept: Vec<(usize, usize)>,
    parents: Vec<Parent>,
    children: Children,
    /// The candidate without factors.
    constant: Option<usize>,
}

impl Tree {
    /// The tree of products, each given as its sorted list of variables (below `variables`), powers repeated.
    pub(crate) fn new(variables: usize, products: &[Vec<usize>]) -> Self {
        let mut by_parent: BTreeMap<&[usize], Children> = BTreeMap::new();
        let mut constant = None;
        for (i, p) in products.iter().enumerate() {
            match p.split_last() {
                Some((&last, parent)) => by_parent.entry(parent).or_default().push((last, i)),
                None => constant = Some(i),
            }
        }
        // What parents are made of is kept; prefixes come before what they begin.
        let mut slots: BTreeMap<Vec<usize>, usize> = BTreeMap::new();
        slots.insert(Vec::new(), 0);
        (0..variables).for_each(|v| {
            slots.insert(vec![v], v + 1);
        });
        let mut kept = Vec::new();
        for parent in by_parent.keys() {
            for len in 2..parent.len() {
                if !slots.contains_key(&parent[..len]) {
                    kept.push((slots[&parent[..len - 1]], parent[len - 1]));
                    slots.insert(parent[..len].to_vec(), variables + kept.len());
                }
            }
        }
        let mut order: Vec<(&[usize], Children)> = by_parent.into_iter().collect();
        let by = |c: &[(usize, usize)]| c.iter().map(|c| c.0).collect::<Vec<_>>();
        order.sort_by_cached_key(|(p, c)| (by(c), p.len(), p.to_vec()));
        let (mut parents, mut children) = (Vec::<Parent>::new(), Vec::new());
        for (p, c) in &order {
            let (slot, times) = match (slots.get(*p), p.split_last()) {
                (Some(&slot), _) => (slot, None),
                (None, Some((&last, rest))) => (slots[rest], Some(last)),
                (None, None) => (0, None),
            };
            let from = children.len();
            children.extend_from_slice(c);
            parents.push(Parent { slot, times, children: (from, children.len()), paired: false });
        }
        let mut i = 0;
        while i + 1 < parents.len() {
            parents[i].paired = by(&order[i].1) == by(&order[i + 1].1);
            i += 1 + usize::from(parents[i].paired);
        }
        Self { variables, candidates: products.len(), kept, parents, children, constant }
    }

    /// Moments of all candidates with the weights `v` (n); `columns` holds the variables, n samples each. With
    /// `squared` those of the squared candidates instead.
    pub(crate) fn moments(&self, columns: &[f64], v: &[f64], squared: bool) -> Vec<f64> {
        let n = v.len();
        let chunk = n.div_ceil(MAX_CHUNKS).next_multiple_of(BLOCK).max(CHUNK);
        let arch = pulp::Arch::new();
        let parts: Vec<Vec<f64>> = (0..n.div_ceil(chunk))
            .into_par_iter()
            .map(|c| {
                let samples = (c * chunk, ((c + 1) * chunk).min(n));
                let mut sums = vec![0.0; self.candidates];
                arch.dispatch(Chunk { tree: self, columns, v, squared, samples, sums: &mut sums });
                sums
            })
            .collect();
        let mut total = vec![0.0; self.candidates];
        for part in &parts {
            total.iter_mut().zip(part).for_each(|(t, p)| *t += p);
        }
        total
    }
}

/// One chunk of samples; compiled once for each width of vectors.
struct Chunk<'a> {
    tree: &'a Tree,
    columns: &'a [f64],
    v: &'a [f64],
    squared: bool,
    samples: (usize, usize),
    sums: &'a mut [f64],
}

impl pulp::WithSimd for Chunk<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Tree { variables, kept, parents, children, constant, .. } = self.tree;
        let mut slots = vec![0.0; (1 + variables + kept.len()) * BLOCK];
        slots[..BLOCK].fill(1.0);
        let mut weighted = vec![0.0; variables * BLOCK];
        let mut product = [[0.0; BLOCK]; 2];
        for t in (self.samples.0..self.samples.1).step_by(BLOCK) {
            let v = &self.v[t..(t + BLOCK).min(self.samples.1)];
            if let Some(k) = constant {
                self.sums[*k] += v.iter().sum::<f64>();
            }
            self.load(t, v, &mut slots, &mut weighted);
            for (k, &(slot, variable)) in kept.iter().enumerate() {
                let (old, new) = slots.split_at_mut((1 + variables + k) * BLOCK);
                times(block(old, slot), block(old, variable + 1), &mut new[..BLOCK]);
            }
            let mut i = 0;
            while i < parents.len() {
                let rows = 1 + usize::from(parents[i].paired);
                for (p, out) in parents[i..i + rows].iter().zip(&mut product) {
                    match p.times {
                        Some(variable) => times(block(&slots, p.slot), block(&slots, variable + 1), out),
                        None => out.copy_from_slice(block(&slots, p.slot)),
                    }
                }
                let of = |p: &Parent| &children[p.children.0..p.children.1];
                let (first, second) = (of(&parents[i]), of(&parents[i + rows - 1]));
                if rows == 2 {
                    serve(simd, [&product[0], &product[1]], [first, second], &weighted, self.sums);
                } else {
                    serve(simd, [&product[0]], [first], &weighted, self.sums);
                }
                i += rows;
            }
        }
    }
}

impl Chunk<'_> {
    /// Variables and weighted variables of one block, zero after the last sample.
    #[inline(always)]
    fn load(&self, t: usize, v: &[f64], slots: &mut [f64], weighted: &mut [f64]) {
        let n = self.v.len();
        for k in 0..self.tree.variables {
            let from = &self.columns[k * n + t..k * n + t + v.len()];
            let x = &mut slots[(k + 1) * BLOCK..(k + 2) * BLOCK];
            x[v.len()..].fill(0.0);
            x.iter_mut().zip(from).for_each(|(x, f)| *x = if self.squared { f * f } else { *f });
            let w = &mut weighted[k * BLOCK..(k + 1) * BLOCK];
            w[v.len()..].fill(0.0);
            w.iter_mut().zip(x.iter()).zip(v).for_each(|((w, x), v)| *w = x * v);
        }
    }
}

#[inline(always)]
fn block(columns: &[f64], k: usize) -> &[f64] {
    &columns[k * BLOCK..(k + 1) * BLOCK]
}

#[inline(always)]
fn times(a: &[f64], b: &[f64], out: &mut [f64]) {
    out.iter_mut().zip(a).zip(b).for_each(|((o, a), b)| *o = a * b);
}

/// Adds the moments of all children of R parents whose children have the same variables.
#[inline(always)]
fn serve<S: pulp::Simd, const R: usize>(
    simd: S,
    parents: [&[f64; BLOCK]; R],
    children: [&[(usize, usize)]; R],
    weighted: &[f64],
    sums: &mut [f64],
) {
    let count = children[0].len();
    let mut k = 0;
    while k + WIDE <= count {
        tile::<S, R, WIDE>(simd, parents, children.map(|c| &c[k..]), weighted, sums);
        k += WIDE;
    }
    let rest = children.map(|c| &c[k..]);
    match count - k {
        3 => tile::<S, R, 3>(simd, parents, rest, weighted, sums),
        2 => tile::<S, R, 2>(simd, parents, rest, weighted, sums),
        1 => tile::<S, R, 1>(simd, parents, rest, weighted, sums),
        _ => {}
    }
}

/// R x C sums of products at once: each column is read once for several of them.
#[inline(always)]
fn tile<S: pulp::Simd, const R: usize, const C: usize>(
    simd: S,
    parents: [&[f64; BLOCK]; R],
    children: [&[(usize, usize)]; R],
    weighted: &[f64],
    sums: &mut [f64],
) {
    let p = parents.map(|p| S::as_simd_f64s(p.as_slice()).0);
    let x: [&[S::f64s]; C] = std::array::from_fn(|c| S::as_simd_f64s(block(weighted, children[0][c].0)).0);
    let mut acc = [[simd.splat_f64s(0.0); C]; R];
    for s in 0..BLOCK / S::F64_LANES {
        for c in 0..C {
            let x = x[c][s];
            for r in 0..R {
                acc[r][c] = simd.mul_add_f64s(p[r][s], x, acc[r][c]);
            }
        }
    }
    for r in 0..R {
        for c in 0..C {
            sums[children[r][c].1] += simd.reduce_sum_f64s(acc[r][c]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_numerics::rng::Rng64;

    /// Every multiset of up to `degree` of `v` variables.
    fn all(v: usize, degree: usize) -> Vec<Vec<usize>> {
        let mut out = vec![Vec::new()];
        let mut level = vec![Vec::new()];
        for _ in 0..degree {
            level = level
                .iter()
                .flat_map(|p: &Vec<usize>| {
                    (p.last().copied().unwrap_or(0)..v).map(|x| [p.as_slice(), &[x]].concat())
                })
                .collect();
            out.extend(level.clone());
        }
        out
    }

    fn agrees(products: &[Vec<usize>], variables: usize, n: usize) {
        let mut rng = Rng64::new(n as u64);
        let columns: Vec<f64> = (0..variables * n).map(|_| rng.uniform_in(-1.5, 1.5)).collect();
        let v: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
        let tree = Tree::new(variables, products);
        for power in [1, 2] {
            let moments = tree.moments(&columns, &v, power == 2);
            for (p, m) in products.iter().zip(&moments) {
                let term =
                    |t: usize| p.iter().map(|&x| columns[x * n + t].powi(power)).product::<f64>() * v[t];
                let (sum, size) =
                    (0..n).map(term).fold((0.0, 0.0), |(s, a): (f64, f64), x| (s + x, a + x.abs()));
                assert!((m - sum).abs() <= 1e-14 * size, "{p:?} of {n}: {m} {sum}");
            }
        }
    }

    #[test]
    fn moments_equal_sums_over_products_formed_one_by_one() {
        for n in [1, 127, 128, 129, 1500, 5000] {
            agrees(&all(4, 4), 4, n);
        }
        assert_eq!(all(20, 4).len(), 10_626);
    }

    #[test]
    fn pools_with_gaps_are_served_as_well() {
        // Prefixes that are no candidates themselves, one without siblings, no constant, a pure power.
        let products =
            [vec![0, 1, 2, 3], vec![2, 2, 2, 2, 2], vec![1], vec![0, 3], vec![1, 1, 3], vec![0, 1, 2, 2]];
        agrees(&products, 4, 300);
        agrees(&[vec![]], 0, 200);
    }
}
