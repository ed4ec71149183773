//! The mean of a response model as nodes: scaled coordinates, polynomials, kernels as the neurons of one layer, and the tree of a
//! local model as sigmoids and products.

use dynocal_export::program::{Factor, Layer, NodeId, Op, Shape, Term};
use dynocal_ident::model::Model;
use dynocal_ident::model::poly::Source;
use dynocal_ident::model::response::form::ResponseForm;
use dynocal_ident::model::response::formula::{Formula, Part, Product};
use dynocal_ident::model::response::gp::Kernel;
use dynocal_ident::model::response::local_linear::Tree;
use dynocal_ident::model::response::transform::Transform;
use dynocal_ident::model::response::warp::{Warp, WarpChoice};

use super::model::{Growing, ModelFault};

impl Growing<'_> {
    /// The node of the structure's output.
    ///
    /// # Errors
    /// [`ModelFault::Unfit`]: nothing was learnt, or an output that is a power other than the logarithm.
    pub(super) fn response(&mut self, m: &ResponseForm) -> Result<NodeId, ModelFault> {
        let output = self.stored.output.name.clone();
        let unfit = |reason: String| ModelFault::Unfit { output: output.clone(), reason };
        let Some(model) = m.response() else { return Err(unfit("it has not been learnt".into())) };
        let of_inputs = m.window().iter().map(|(i, lag)| (Source::Input(*i), *lag));
        let reads_of: Vec<_> =
            of_inputs.chain((1..=m.output_lag()).map(|lag| (Source::Output, lag))).collect();
        let formulas = model.formulas();
        // A channel that no part reads does not enter.
        let used = |j: usize| formulas.iter().any(|f| f.parts.iter().any(|p| reads(p, j)));
        let mut x = Vec::new();
        for (j, (source, lag)) in reads_of.into_iter().enumerate() {
            x.push(if used(j) { self.read(source, lag) } else { NodeId::MAX });
        }
        if let [only] = formulas.as_slice() {
            return self.formula(only, "", &x).map_err(unfit);
        }
        let mut terms = Vec::new();
        for (k, f) in formulas.iter().enumerate() {
            let node = self.formula(f, &format!("m{}_", k + 1), &x).map_err(unfit)?;
            terms.push(Term { coefficient: f.share, factors: vec![Factor { node, power: 1 }] });
        }
        Ok(self.build.node(&format!("{output}_computed"), Op::Polynomial { terms }))
    }

    /// One formula; names of its nodes begin with `prefix`.
    fn formula(&mut self, f: &Formula, prefix: &str, x: &[NodeId]) -> Result<NodeId, String> {
        let mut z = Vec::new();
        for (j, of) in x.iter().enumerate() {
            let (gain, offset) = (1.0 / f.scaling.std[j], -f.scaling.mean[j] / f.scaling.std[j]);
            // What no part reads would be a node without use.
            let read = f.parts.iter().any(|p| reads(p, j));
            if !read {
                z.push(NodeId::MAX);
                continue;
            }
            let of = self.warped(&f.scaling.warp, j, *of, prefix);
            z.push(self.build.node(&format!("{prefix}z_{}", j + 1), Op::Scale { of, gain, offset }));
        }
        let mut terms = Vec::new();
        for part in &f.parts {
            match part {
                Part::Polynomial(products) => terms.extend(products.iter().map(|p| term(p, &z))),
                Part::Kernels { kernel, inverse_squares, centres, weights } if !weights.is_empty() => {
                    let node = self.kernels(*kernel, inverse_squares, centres, weights, prefix, &z);
                    terms.push(Term { coefficient: 1.0, factors: vec![Factor { node, power: 1 }] });
                }
                Part::Kernels { .. } => {}
                Part::Local { tree, models } => terms.extend(self.local(tree, models, prefix, &z)),
            }
        }
        let of = self.build.node(&format!("{prefix}sum"), Op::Polynomial { terms });
        let (gain, offset) = (f.scaling.output_std, f.scaling.output_mean);
        let name = format!("{prefix}{}_computed", self.stored.output.name);
        let scale = |of, gain, offset| Op::Scale { of, gain, offset };
        match f.transform {
            Transform::None => Ok(self.build.node(&name, scale(of, gain, offset))),
            Transform::BoxCox { power: 0.0 } => {
                let of = self.build.node(&format!("{prefix}logarithm"), scale(of, gain, offset));
                Ok(self.build.node(&name, Op::Function { of, shape: Shape::Exp }))
            }
            Transform::Logit { low, high } => {
                let of = self.build.node(&format!("{prefix}logit"), scale(of, gain, offset));
                let op = Op::Function { of, shape: Shape::Sigmoid };
                let of = self.build.node(&format!("{prefix}share"), op);
                Ok(self.build.node(&name, scale(of, high - low, low)))
            }
            Transform::BoxCox { power } => Err(format!(
                "it was learnt for the power {power} of its output; exported are outputs as measured, `transform = \"log\"` and \
                 `transform = \"logit\"`"
            )),
        }
    }

    /// w of input `j`, by the formulas of [`Warp`]; a root far below zero is less exact in 32 bits (1e-5 of it at 100 times its scale), where no
    /// point was.
    fn warped(&mut self, warp: &Warp, j: usize, of: NodeId, prefix: &str) -> NodeId {
        let c = warp.scales.get(j).copied().unwrap_or(0.0);
        let name = |what: &str| format!("{prefix}{what}_{}", j + 1);
        let term = |coefficient, node, power| Term { coefficient, factors: vec![Factor { node, power }] };
        match warp.choice {
            _ if c == 0.0 => of,
            WarpChoice::None => of,
            WarpChoice::Sqrt => {
                let constant = Term { coefficient: 4.0 * c * c, factors: Vec::new() };
                let op = Op::Polynomial { terms: vec![constant, term(1.0, of, 2)] };
                let square = self.build.node(&name("square"), op);
                let size = self.build.node(&name("size"), Op::Function { of: square, shape: Shape::Sqrt });
                let op = Op::Polynomial { terms: vec![term(0.5, of, 1), term(0.5, size, 1)] };
                let middle = self.build.node(&name("middle"), op);
                self.build.node(&name("root"), Op::Function { of: middle, shape: Shape::Sqrt })
            }
            WarpChoice::Asinh => {
                let op = Op::Scale { of, gain: 1.0 / c, offset: 0.0 };
                let ratio = self.build.node(&name("ratio"), op);
                self.build.node(&name("asinh"), Op::Function { of: ratio, shape: Shape::Asinh })
            }
        }
    }

    /// `sum_k w_k k(r_k^2)` as a network of one layer over z and `sum q_j z_j^2`:
    /// `r_k^2 = sum q_j z_j^2 - 2 sum q_j c_kj z_j + sum q_j c_kj^2`.
    fn kernels(
        &mut self,
        kernel: Kernel,
        inverse_squares: &[f64],
        centres: &[f64],
        weights: &[f64],
        prefix: &str,
        z: &[NodeId],
    ) -> NodeId {
        let d = z.len();
        let square = |(node, q): (&NodeId, &f64)| Term {
            coefficient: *q,
            factors: vec![Factor { node: *node, power: 2 }],
        };
        let terms = z.iter().zip(inverse_squares).map(square).collect();
        let size = self.build.node(&format!("{prefix}size"), Op::Polynomial { terms });
        // The exponential takes -r^2/2.
        let (unit, activation) = match kernel {
            Kernel::SquaredExponential => (-0.5, Shape::Exp),
            Kernel::Matern32 => (1.0, Shape::Matern32),
            Kernel::Matern52 => (1.0, Shape::Matern52),
        };
        let mut first = Layer { weights: Vec::new(), offsets: Vec::new(), activation };
        for centre in centres.chunks_exact(d) {
            let pairs = || inverse_squares.iter().zip(centre);
            first.weights.extend(pairs().map(|(q, c)| -2.0 * unit * q * c));
            first.weights.push(unit);
            first.offsets.push(unit * pairs().map(|(q, c)| q * c * c).sum::<f64>());
        }
        let last = Layer { weights: weights.to_vec(), offsets: vec![0.0], activation: Shape::Linear };
        let inputs = z.iter().copied().chain([size]).collect();
        self.build.node(&format!("{prefix}kernels"), Op::Network { inputs, layers: vec![first, last] })
    }

    /// Validity times local model of every leaf.
    fn local(&mut self, tree: &Tree, models: &[Vec<Product>], prefix: &str, z: &[NodeId]) -> Vec<Term> {
        let mut sides = Vec::new();
        for (k, split) in tree.splits.iter().enumerate() {
            let constant = Term { coefficient: split.offset, factors: Vec::new() };
            let slope = |(node, v): (&NodeId, &f64)| Term {
                coefficient: *v,
                factors: vec![Factor { node: *node, power: 1 }],
            };
            let terms = std::iter::once(constant).chain(z.iter().zip(&split.normal).map(slope)).collect();
            let of = self.build.node(&format!("{prefix}split_{}", k + 1), Op::Polynomial { terms });
            let op = Op::Function { of, shape: Shape::Sigmoid };
            let psi = self.build.node(&format!("{prefix}psi_{}", k + 1), op);
            let rest = Op::Scale { of: psi, gain: -1.0, offset: 1.0 };
            sides.push([psi, self.build.node(&format!("{prefix}rest_{}", k + 1), rest)]);
        }
        let mut out = Vec::new();
        for (l, (leaf, model)) in tree.leaves.iter().zip(models).enumerate() {
            let terms = model.iter().map(|p| term(p, z)).collect();
            let local = self.build.node(&format!("{prefix}local_{}", l + 1), Op::Polynomial { terms });
            let side =
                |(split, side): &(usize, bool)| Factor { node: sides[*split][usize::from(!*side)], power: 1 };
            let factors = leaf.path.iter().map(side).chain([Factor { node: local, power: 1 }]).collect();
            out.push(Term { coefficient: 1.0, factors });
        }
        out
    }
}

/// Whether a part reads coordinate `j`.
fn reads(part: &Part, j: usize) -> bool {
    match part {
        Part::Polynomial(products) => products.iter().any(|p| p.exponents[j] > 0),
        Part::Kernels { weights, .. } => !weights.is_empty(),
        Part::Local { .. } => true,
    }
}

fn term(p: &Product, z: &[NodeId]) -> Term {
    let powers = z.iter().zip(&p.exponents).filter(|(_, e)| **e > 0);
    Term {
        coefficient: p.coefficient,
        factors: powers.map(|(node, e)| Factor { node: *node, power: *e }).collect(),
    }
}
