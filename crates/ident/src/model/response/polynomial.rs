//! Polynomials whose terms are chosen stepwise by PRESS.
//!
//! Terms are products of scaled inputs up to a degree. Heredity decides what may stand beside what: under the strong form
//! `a^2*b` asks for `a*b` and `a^2`, under the weak form for one of them.
//!
//! Sources: G. E. P. Box, N. R. Draper, Response Surfaces, Mixtures, and Ridge Analyses (2007); J. L. Peixoto, Hierarchical
//! variable selection in polynomial regression models, Am. Stat. 41 (1987), 311-313.

pub mod influence;

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use serde::{Deserialize, Serialize};

use super::features::{self, Coefficients, Features};
use super::formula::{Formula, Part, Product};
use super::points::counted;
use super::stepwise::{LeastSquares, Pool, stepwise};
use super::transform::{Transform, box_cox};
use super::{
    Ask, Learn, Learnt, LeftOut, Points, Prediction, Response, ResponseError, ResponseModel, Scaling,
};
use influence::Influence;

pub(super) const MEMBER: Member<dyn Learn> = Member {
    doc: MemberDoc {
        name: "stepwise_polynomial",
        what: "polynomial with terms chosen stepwise by PRESS",
        params: &[
            ParamDoc { name: "degree", unit: "-", default: "3", what: "highest degree of a product" },
            ParamDoc {
                name: "heredity",
                unit: "-",
                default: "\"strong\"",
                what: "strong: a product asks for all products of one degree less; weak: for one of them; none",
            },
            ParamDoc {
                name: "stepwise",
                unit: "-",
                default: "true",
                what: "false: all terms up to the degree",
            },
            ParamDoc {
                name: "most_terms",
                unit: "-",
                default: "0",
                what: "most terms; 0: half as many as points",
            },
            ParamDoc {
                name: "transform",
                unit: "-",
                default: "\"none\"",
                what: "of the output: none, log, box_cox (power from the likelihood) or logit",
            },
            ParamDoc { name: "low", unit: "output", default: "0", what: "lower limit of the logit" },
            ParamDoc { name: "high", unit: "output", default: "1", what: "upper limit of the logit" },
        ],
    },
    build: |keys| Ok(Box::new(registry::keys::<Polynomial>("stepwise_polynomial", keys)?)),
};

/// What a product asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Heredity {
    /// All products of one degree less.
    #[default]
    Strong,
    /// One of them.
    Weak,
    /// Nothing.
    None,
}

/// Which transform of the output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TransformChoice {
    /// None.
    #[default]
    None,
    /// Logarithm.
    Log,
    /// Power from the likelihood, in steps of 0.1 from -2 to 2.
    BoxCox,
    /// Logit between `low` and `high`.
    Logit,
}

/// Keys of a polynomial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Polynomial {
    /// Highest degree of a product.
    pub degree: usize,
    /// What a product asks for.
    pub heredity: Heredity,
    /// Whether terms are chosen.
    pub stepwise: bool,
    /// Most terms; 0 for half as many as points.
    pub most_terms: usize,
    /// Transform of the output.
    pub transform: TransformChoice,
    /// Lower limit of the logit.
    pub low: f64,
    /// Upper limit of the logit.
    pub high: f64,
}

impl Default for Polynomial {
    fn default() -> Self {
        Self {
            degree: 3,
            heredity: Heredity::Strong,
            stepwise: true,
            most_terms: 0,
            transform: TransformChoice::None,
            low: 0.0,
            high: 1.0,
        }
    }
}

/// A polynomial that was learnt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolynomialModel {
    scaling: Scaling,
    terms: Terms,
    coefficients: Coefficients,
    transform: Transform,
    /// Leverage and studentised residuals of the points.
    pub influence: Influence,
}

/// Exponents of each input, term by term.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Terms(Vec<Vec<u32>>);

impl Learn for Polynomial {
    fn learn(&self, points: &Points, interrupt: &dyn Fn() -> bool) -> Result<Learnt, ResponseError> {
        let (n, d) = (points.len(), points.dim());
        points.check(d + 3, "a polynomial")?;
        if self.degree == 0 {
            let (found, expected) = ("0".into(), "at least 1".into());
            return Err(ResponseError::Key { model: "stepwise_polynomial", key: "degree", found, expected });
        }
        let terms = all_terms(d, self.degree);
        let inputs = Scaling::of(points).inputs(points);
        let columns: Vec<Vec<f64>> =
            terms.iter().map(|t| inputs.chunks_exact(d).map(|z| product(t, z)).collect()).collect();
        let transform = self.transform(points, &columns, &terms)?;
        let scaling = Scaling::of(&Points { y: transform.apply(&points.y)?, ..points.clone() });
        let y = scaling.outputs(&Points { y: transform.apply(&points.y)?, ..points.clone() });
        let too_few = |found: usize, expected: usize| {
            let (output, inputs, what) = (points.output.clone(), d, "a polynomial".into());
            ResponseError::Points(super::PointsError::TooFew { output, found, expected, inputs, what })
        };
        let fit = if self.stepwise {
            let allowed = |k: usize, inside: &[bool]| self.allowed(&terms, k, inside);
            let most = if self.most_terms == 0 { n / 2 } else { self.most_terms };
            let pool = Pool { columns: &columns, allowed: &allowed, always: &[0], most };
            stepwise(&pool, &y, interrupt)
        } else {
            let all: Vec<usize> = (0..terms.len()).collect();
            (n > terms.len() + 1).then(|| LeastSquares::of(&columns, &all, &y)).flatten()
        };
        let fit = fit.ok_or_else(|| too_few(n, terms.len() + 2))?;
        let coefficients = fit.coefficients(&y).ok_or_else(|| too_few(n, fit.columns.len() + 2))?;
        let kept = Terms(fit.columns.iter().map(|k| terms[*k].clone()).collect());
        let left_out = self.left_out(&fit, &scaling, &y, transform, points);
        let influence = Influence::of(&fit.residuals, &fit.leverage, fit.columns.len());
        let mut notes = points.notes();
        notes.push(format!(
            "polynomial of `{}`: {} of {} terms up to degree {}",
            points.output,
            kept.0.len(),
            terms.len(),
            self.degree
        ));
        notes.extend(influence.notes(&points.output));
        let model = PolynomialModel { scaling, terms: kept, coefficients, transform, influence };
        Ok(Learnt::new(ResponseModel::Polynomial(model), left_out, notes))
    }
}

impl Polynomial {
    /// Heredity: whether term `k` may stand beside those that are inside.
    fn allowed(&self, terms: &[Vec<u32>], k: usize, inside: &[bool]) -> bool {
        let parents = (0..terms[k].len()).filter(|j| terms[k][*j] > 0).map(|j| {
            let mut parent = terms[k].clone();
            parent[j] -= 1;
            terms.iter().position(|t| *t == parent).is_some_and(|p| inside[p])
        });
        let parents: Vec<bool> = parents.collect();
        match self.heredity {
            Heredity::None => true,
            Heredity::Strong => parents.iter().all(|p| *p),
            Heredity::Weak => parents.is_empty() || parents.iter().any(|p| *p),
        }
    }

    /// The transform with its numbers; the power by the likelihood of the polynomial of second degree (of first degree
    /// where there are too few points).
    fn transform(
        &self,
        points: &Points,
        columns: &[Vec<f64>],
        terms: &[Vec<u32>],
    ) -> Result<Transform, ResponseError> {
        match self.transform {
            TransformChoice::None => Ok(Transform::None),
            TransformChoice::Log => Ok(Transform::BoxCox { power: 0.0 }),
            TransformChoice::Logit => Ok(Transform::Logit { low: self.low, high: self.high }),
            TransformChoice::BoxCox => {
                // Refuses outputs that have no logarithm.
                Transform::BoxCox { power: 0.0 }.apply(&points.y)?;
                let n = points.len();
                let up_to = |most: u32| -> Vec<usize> {
                    (0..terms.len()).filter(|k| terms[*k].iter().sum::<u32>() <= most).collect()
                };
                let chosen = if n > 2 * up_to(2).len() { up_to(2) } else { up_to(1) };
                let logs: f64 = points.y.iter().map(|y| y.ln()).sum();
                let value = |power: f64| {
                    let y: Vec<f64> = points.y.iter().map(|y| box_cox(*y, power)).collect();
                    let squares = LeastSquares::of(columns, &chosen, &y)
                        .map(|fit| fit.residuals.iter().map(|e| e * e).sum::<f64>());
                    squares.map_or(f64::NEG_INFINITY, |s| {
                        -0.5 * n as f64 * (s / n as f64).ln() + (power - 1.0) * logs
                    })
                };
                let powers = (-20..=20).map(|k| f64::from(k) / 10.0);
                let best = powers.max_by(|a, b| value(*a).total_cmp(&value(*b)));
                Ok(Transform::BoxCox { power: best.unwrap_or(1.0) })
            }
        }
    }

    /// Left-out residuals in the unit of the output.
    fn left_out(
        &self,
        fit: &LeastSquares,
        scaling: &Scaling,
        y: &[f64],
        transform: Transform,
        points: &Points,
    ) -> LeftOut {
        let unit = scaling.output_std;
        let mut left = fit.left_out(unit);
        if transform != Transform::None {
            for i in 0..y.len() {
                let predicted = scaling.output_mean + unit * y[i] - left.residuals[i];
                let [back, slope, ..] = transform.inverse(predicted);
                left.residuals[i] = points.y[i] - back;
                left.variance[i] *= slope * slope;
            }
        }
        left
    }
}

impl PolynomialModel {
    /// Terms in the names of the inputs, each a product of scaled inputs `(x - mean) / std`.
    pub fn terms(&self, inputs: &[String]) -> Vec<String> {
        let power = |name: &String, e: u32| match e {
            0 => None,
            1 => Some(name.clone()),
            e => Some(format!("{name}^{e}")),
        };
        let term = |t: &Vec<u32>| {
            let factors: Vec<String> = inputs.iter().zip(t).filter_map(|(n, e)| power(n, *e)).collect();
            if factors.is_empty() { "1".into() } else { factors.join("*") }
        };
        self.terms.0.iter().map(term).collect()
    }

    /// Its mean.
    pub(super) fn formula(&self) -> Formula {
        let product =
            |(exponents, c): (&Vec<u32>, &f64)| Product { coefficient: *c, exponents: exponents.clone() };
        let products = self.terms.0.iter().zip(&self.coefficients.values).map(product).collect();
        let (scaling, transform) = (self.scaling.clone(), self.transform);
        Formula { scaling, parts: vec![Part::Polynomial(products)], transform, share: 1.0 }
    }

    /// Transform of the output.
    pub fn transform(&self) -> Transform {
        self.transform
    }
}

impl Response for PolynomialModel {
    fn dim(&self) -> usize {
        self.scaling.mean.len()
    }

    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction) {
        // The transform of a Hessian needs the variance, that of a gradient the value: all are there.
        features::predict(&self.terms, &self.coefficients, &self.scaling, x, ask, out);
        self.transform.back(ask, out);
    }

    fn describe(&self) -> String {
        let degree = self.terms.0.iter().map(|t| t.iter().sum::<u32>()).max().unwrap_or(0);
        format!("polynomial with {} up to degree {degree}", counted(self.terms.0.len(), "term"))
    }
}

impl Features for Terms {
    fn count(&self) -> usize {
        self.0.len()
    }

    fn values(&self, z: &[f64], c: &mut [f64], jacobian: &mut [f64]) {
        let p = self.0.len();
        for (k, term) in self.0.iter().enumerate() {
            c[k] = product(term, z);
            if !jacobian.is_empty() {
                for j in 0..z.len() {
                    jacobian[j * p + k] = derivative(term, z, &[j]);
                }
            }
        }
    }

    fn curvature(&self, z: &[f64], w: &[f64], hessian: &mut [f64]) {
        let d = z.len();
        for (term, w) in self.0.iter().zip(w) {
            for j in 0..d {
                for l in 0..d {
                    hessian[j * d + l] += w * derivative(term, z, &[j, l]);
                }
            }
        }
    }
}

fn product(term: &[u32], z: &[f64]) -> f64 {
    term.iter().zip(z).map(|(e, z)| z.powi(*e as i32)).product()
}

/// Derivative of a product with respect to each input named in `by`.
fn derivative(term: &[u32], z: &[f64], by: &[usize]) -> f64 {
    term.iter().zip(z).enumerate().fold(1.0, |value, (i, (e, z))| {
        let times = by.iter().filter(|j| **j == i).count() as u32;
        if times > *e {
            return 0.0;
        }
        let factor: u32 = (0..times).map(|k| e - k).product();
        value * f64::from(factor) * z.powi((e - times) as i32)
    })
}

/// All exponents of d inputs up to a degree, the constant first, by degree.
fn all_terms(d: usize, degree: usize) -> Vec<Vec<u32>> {
    let mut terms = vec![vec![0; d]];
    let mut last = terms.clone();
    for _ in 0..degree {
        let mut next: Vec<Vec<u32>> = Vec::new();
        for term in &last {
            // Only inputs from the last one on, so that each product comes once.
            let from = term.iter().rposition(|e| *e > 0).unwrap_or(0);
            for j in from..d {
                let mut longer = term.clone();
                longer[j] += 1;
                next.push(longer);
            }
        }
        terms.extend(next.iter().cloned());
        last = next;
    }
    terms
}
