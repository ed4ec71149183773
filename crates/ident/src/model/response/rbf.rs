//! Radial basis functions on some of the points, over a linear part, chosen stepwise by PRESS.
//!
//! ```text
//! f(z) = b0 + b'z + sum_k w_k exp(-|z - c_k|^2 / (2 r^2))
//! ```
//!
//! Source: S. Chen, C. F. N. Cowan, P. M. Grant, Orthogonal least squares learning algorithm for radial basis function
//! networks, IEEE Trans. Neural Networks 2 (1991); here the steps are judged by PRESS.

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::{Deserialize, Serialize};

use super::bands::{self, Refit};
use super::features::{self, Coefficients, Features};
use super::formula::{Part, Product};
use super::gp::Kernel;
use super::points::counted;
use super::stepwise::{LeastSquares, Pool, stepwise};
use super::{Ask, Learn, Learnt, Points, Prediction, Response, ResponseError, ResponseModel, Scaling};

pub(super) const MEMBER: Member<dyn Learn> = Member {
    doc: MemberDoc {
        name: "rbf",
        what: "radial basis functions on points, over a linear part, chosen stepwise by PRESS",
        params: &[
            ParamDoc {
                name: "widths",
                unit: "std",
                default: "[0.7, 1.2, 2, 3.5, 6]",
                what: "widths that are tried, in standard deviations of the inputs",
            },
            ParamDoc {
                name: "most",
                unit: "-",
                default: "0",
                what: "most functions; 0: a third of the points, at most 150",
            },
            ParamDoc {
                name: "candidates",
                unit: "-",
                default: "300",
                what: "most points that may carry a function",
            },
        ],
    },
    build: |keys| Ok(Box::new(registry::keys::<Rbf>("rbf", keys)?)),
};

/// Keys of a network of radial basis functions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rbf {
    /// Widths that are tried, in standard deviations of the inputs.
    pub widths: Vec<f64>,
    /// Most functions; 0 for a third of the points, at most 150.
    pub most: usize,
    /// Most points that may carry a function.
    pub candidates: usize,
}

impl Default for Rbf {
    fn default() -> Self {
        Self { widths: vec![0.7, 1.2, 2.0, 3.5, 6.0], most: 0, candidates: 300 }
    }
}

/// Radial basis functions that were learnt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RbfModel {
    scaling: Scaling,
    functions: Functions,
    coefficients: Coefficients,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Functions {
    d: usize,
    /// Inputs of the linear part.
    linear: Vec<usize>,
    /// Centres, row by row (d each), scaled.
    centres: Vec<f64>,
    width: f64,
}

impl Learn for Rbf {
    fn learn(&self, points: &Points, interrupt: &dyn Fn() -> bool) -> Result<Learnt, ResponseError> {
        let d = points.dim();
        points.check(d + 4, "radial basis functions")?;
        if self.widths.is_empty() || self.widths.iter().any(|w| !(*w > 0.0 && w.is_finite())) {
            let (found, expected) = (format!("{:?}", self.widths), "one or more positive numbers".into());
            return Err(ResponseError::Key { model: "rbf", key: "widths", found, expected });
        }
        let scaling = Scaling::of(points);
        let (z, y) = (scaling.inputs(points), scaling.outputs(points));
        let none = || ResponseError::NoStart { model: "rbf", output: points.output.clone() };
        let (fit, functions) = self.best(&z, &y, d, interrupt).ok_or_else(none)?;
        let plain = fit.coefficients(&y).ok_or_else(none)?;
        let refit = |_: usize, z: &[f64], y: &[f64]| {
            let (fit, functions) = self.best(z, y, d, &|| false)?;
            let coefficients = fit.coefficients(y)?;
            Some(Refit { features: Box::new(functions), noise: coefficients.noise, coefficients })
        };
        let bands = bands::calibrate(plain.noise, (&z, &y), &refit, interrupt);
        let coefficients = bands.of(plain);
        let left_out = fit.left_out(scaling.output_std);
        let model = RbfModel { scaling, functions, coefficients };
        let mut notes = points.notes();
        notes.push(format!("{} of `{}`", model.describe(), points.output));
        notes.extend(bands.note());
        Ok(Learnt::new(ResponseModel::Rbf(model), left_out, notes))
    }
}

impl Rbf {
    /// Functions of the width with the least PRESS.
    fn best(
        &self,
        z: &[f64],
        y: &[f64],
        d: usize,
        interrupt: &dyn Fn() -> bool,
    ) -> Option<(LeastSquares, Functions)> {
        let mut best: Option<(LeastSquares, Functions)> = None;
        for width in &self.widths {
            if let Some(found) = self.fit(z, y, d, *width, interrupt)
                && best.as_ref().is_none_or(|(b, _)| found.0.press() < b.press())
            {
                best = Some(found);
            }
        }
        best
    }

    /// Functions of one width, chosen by PRESS.
    fn fit(
        &self,
        z: &[f64],
        y: &[f64],
        d: usize,
        width: f64,
        interrupt: &dyn Fn() -> bool,
    ) -> Option<(LeastSquares, Functions)> {
        let n = y.len();
        let carriers = spread_out(z, d, self.candidates.max(1));
        let most = 1 + d + if self.most == 0 { (n / 3).min(150) } else { self.most };
        let centre = |c: usize| &z[c * d..(c + 1) * d];
        let mut columns = vec![vec![1.0; n]];
        columns.extend((0..d).map(|j| z.iter().skip(j).step_by(d).copied().collect::<Vec<f64>>()));
        columns.extend(
            carriers
                .iter()
                .map(|c| z.chunks_exact(d).map(|z| gauss(z, centre(*c), width)).collect::<Vec<f64>>()),
        );
        let pool = Pool { columns: &columns, allowed: &|_, _| true, always: &[0], most };
        let fit = stepwise(&pool, y, interrupt)?;
        let linear = fit.columns.iter().filter(|k| (1..=d).contains(*k)).map(|k| k - 1).collect();
        let centres =
            fit.columns.iter().filter(|k| **k > d).flat_map(|k| centre(carriers[k - d - 1]).to_vec());
        let functions = Functions { d, linear, centres: centres.collect(), width };
        Some((fit, functions))
    }
}

/// At most `count` rows that lie far from each other: each next one is the farthest from those before.
pub(super) fn spread_out(z: &[f64], d: usize, count: usize) -> Vec<usize> {
    let n = z.len() / d;
    if n <= count {
        return (0..n).collect();
    }
    let distance = |a: usize, b: usize| -> f64 {
        z[a * d..(a + 1) * d].iter().zip(&z[b * d..(b + 1) * d]).map(|(x, y)| (x - y).powi(2)).sum()
    };
    // The first is the one nearest to the middle (z has mean zero).
    let size = |i: usize| -> f64 { z[i * d..(i + 1) * d].iter().map(|v| v * v).sum() };
    let first = (0..n).min_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(0);
    let mut chosen = vec![first];
    let mut nearest: Vec<f64> = (0..n).map(|i| distance(i, first)).collect();
    while chosen.len() < count {
        let next = (0..n).max_by(|a, b| nearest[*a].total_cmp(&nearest[*b]).then(b.cmp(a))).unwrap_or(0);
        if nearest[next] == 0.0 {
            break;
        }
        chosen.push(next);
        (0..n).for_each(|i| nearest[i] = nearest[i].min(distance(i, next)));
    }
    chosen
}

fn gauss(z: &[f64], centre: &[f64], width: f64) -> f64 {
    let r2: f64 = z.iter().zip(centre).map(|(a, b)| (a - b).powi(2)).sum();
    (-0.5 * r2 / (width * width)).exp()
}

impl RbfModel {
    /// Scaling of inputs and output.
    pub(super) fn scaling(&self) -> &Scaling {
        &self.scaling
    }

    /// Summands of the mean of the scaled output.
    pub(super) fn parts(&self) -> Vec<Part> {
        let f = &self.functions;
        let (linear, weights) = self.coefficients.values.split_at(1 + f.linear.len());
        let slopes = f.linear.iter().zip(&linear[1..]).map(|(j, c)| Product::new(*c, f.d, &[*j]));
        let products = std::iter::once(Product::new(linear[0], f.d, &[])).chain(slopes).collect();
        let kernels = Part::Kernels {
            kernel: Kernel::SquaredExponential,
            inverse_squares: vec![1.0 / (f.width * f.width); f.d],
            centres: f.centres.clone(),
            weights: weights.to_vec(),
        };
        vec![Part::Polynomial(products), kernels]
    }
}

impl Response for RbfModel {
    fn dim(&self) -> usize {
        self.functions.d
    }

    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction) {
        features::predict(&self.functions, &self.coefficients, &self.scaling, x, ask, out);
    }

    fn describe(&self) -> String {
        let functions = self.functions.centres.len() / self.functions.d;
        if functions == 0 {
            let linear = counted(self.functions.linear.len(), "input");
            return format!("no radial basis function, a constant and {linear}");
        }
        format!("{} of width {:?}", counted(functions, "radial basis function"), self.functions.width)
    }
}

impl Features for Functions {
    fn count(&self) -> usize {
        1 + self.linear.len() + self.centres.len() / self.d
    }

    fn values(&self, z: &[f64], c: &mut [f64], jacobian: &mut [f64]) {
        let (p, first) = (self.count(), 1 + self.linear.len());
        let (inverse, with) = (1.0 / (self.width * self.width), !jacobian.is_empty());
        jacobian.fill(0.0);
        c[0] = 1.0;
        for (k, j) in self.linear.iter().enumerate() {
            c[1 + k] = z[*j];
            if with {
                jacobian[j * p + 1 + k] = 1.0;
            }
        }
        for (k, centre) in self.centres.chunks_exact(self.d).enumerate() {
            c[first + k] = gauss(z, centre, self.width);
            if with {
                for j in 0..self.d {
                    jacobian[j * p + first + k] = -(z[j] - centre[j]) * inverse * c[first + k];
                }
            }
        }
    }

    fn curvature(&self, z: &[f64], w: &[f64], hessian: &mut [f64]) {
        let (d, inverse) = (self.d, 1.0 / (self.width * self.width));
        for (centre, w) in self.centres.chunks_exact(d).zip(&w[1 + self.linear.len()..]) {
            let value = w * gauss(z, centre, self.width);
            for j in 0..d {
                for l in 0..d {
                    let own = if j == l { inverse } else { 0.0 };
                    let cross = (z[j] - centre[j]) * (z[l] - centre[l]) * inverse * inverse;
                    hessian[j * d + l] += value * (cross - own);
                }
            }
        }
    }
}
