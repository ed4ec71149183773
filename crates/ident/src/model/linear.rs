//! Linear polynomial models with a noise model: ARX, ARMAX, OE, Box-Jenkins, FIR with ARMA noise, ARMA.
//!
//! ```text
//! A(q) y(t) = sum_i B_i(q) / F_i(q) u_i(t) + C(q) / D(q) e(t)
//!
//! A = 1 + a_1 q^-1 + .. + a_na q^-na        C, D, F_i alike
//! B_i = b_i,0 q^-nk_i + .. + b_i,nb-1 q^-(nk_i + nb_i - 1)
//! ```
//!
//! Each input has its own orders and delay; A, C and D are common. The parameters stand in the order
//! `A, B_1 .. B_m, C, D, F_1 .. F_m` without the leading ones.
//!
//! These models are a form of their own: their one-step prediction remembers more than lagged inputs and
//! outputs, which is what [`crate::model::Model`] promises. What drives everything after the estimation is the
//! deterministic part, and that is a NARX model: [`LinearModel::deterministic`].
//!
//! Reference: L. Ljung, System Identification, 2nd ed. (1999), sections 4.2 and 10.3; thesis eqs. (2.10), (2.17).

mod errors;
pub(crate) mod filter;
mod kept;
mod predict;
pub(super) mod structures;

use serde::{Deserialize, Serialize};

pub use errors::PredictionErrors;
pub(crate) use errors::Unknown;

use super::poly::{PolyNarx, Regressor, StructureError};
use filter::{multiply, stable};

/// Orders of one input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputOrders {
    /// Number of coefficients of B.
    pub nb: usize,
    /// Order of F.
    #[serde(default)]
    pub nf: usize,
    /// Delay in samples: the first coefficient of B multiplies u(t - nk).
    #[serde(default = "one")]
    pub nk: usize,
}

fn one() -> usize {
    1
}

/// A linear structure with the user's channel names; see the [module](self) for the equation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearModel {
    /// Names of the inputs, in the order of the columns of `u`; none for a time series.
    pub inputs: Vec<String>,
    /// Name of the output.
    pub output: String,
    /// Order of A.
    #[serde(default)]
    pub na: usize,
    /// Orders of each input.
    pub orders: Vec<InputOrders>,
    /// Order of C.
    #[serde(default)]
    pub nc: usize,
    /// Order of D.
    #[serde(default)]
    pub nd: usize,
}

/// The polynomials of a model for given parameters, leading ones included; `B_i` begins with its `nk_i` zeros.
#[derive(Clone, Debug, PartialEq)]
pub struct Polynomials {
    /// A, from 1.
    pub a: Vec<f64>,
    /// B of each input, from q^0.
    pub b: Vec<Vec<f64>>,
    /// C, from 1.
    pub c: Vec<f64>,
    /// D, from 1.
    pub d: Vec<f64>,
    /// F of each input, from 1.
    pub f: Vec<Vec<f64>>,
}

/// Highest order, and longest delay in samples.
const MOST_ORDER: usize = 1000;

impl LinearModel {
    /// ARX: `A y = sum B_i u_i + e` (thesis eq. 2.10 without constant).
    pub fn arx(inputs: &[&str], output: &str, na: usize, nb: usize, nk: usize) -> Self {
        Self::alike(inputs, output, na, InputOrders { nb, nf: 0, nk }, 0, 0)
    }

    /// ARMAX: `A y = sum B_i u_i + C e`.
    pub fn armax(inputs: &[&str], output: &str, na: usize, nb: usize, nc: usize, nk: usize) -> Self {
        Self::alike(inputs, output, na, InputOrders { nb, nf: 0, nk }, nc, 0)
    }

    /// Output error: `y = sum B_i/F_i u_i + e`.
    pub fn oe(inputs: &[&str], output: &str, nb: usize, nf: usize, nk: usize) -> Self {
        Self::alike(inputs, output, 0, InputOrders { nb, nf, nk }, 0, 0)
    }

    /// Box-Jenkins: `y = sum B_i/F_i u_i + C/D e`. With `nf = 0` it is FIR with ARMA noise.
    pub fn bj(inputs: &[&str], output: &str, nb: usize, nc: usize, nd: usize, nf: usize, nk: usize) -> Self {
        Self::alike(inputs, output, 0, InputOrders { nb, nf, nk }, nc, nd)
    }

    /// Time series `y = C/D e` without inputs.
    pub fn arma(output: &str, nc: usize, nd: usize) -> Self {
        Self::alike(&[], output, 0, InputOrders { nb: 0, nf: 0, nk: 0 }, nc, nd)
    }

    /// All inputs with the same orders.
    fn alike(inputs: &[&str], output: &str, na: usize, orders: InputOrders, nc: usize, nd: usize) -> Self {
        let names = inputs.iter().map(|s| s.to_string()).collect();
        Self { inputs: names, output: output.into(), na, orders: vec![orders; inputs.len()], nc, nd }
    }

    /// Checks that there are orders for each input and something to estimate.
    ///
    /// # Errors
    /// [`StructureError`] naming what does not fit.
    pub fn check(&self) -> Result<(), StructureError> {
        if self.orders.len() != self.inputs.len() {
            return Err(StructureError::Orders {
                output: self.output.clone(),
                found: self.orders.len(),
                expected: self.inputs.len(),
                inputs: self.inputs.clone(),
            });
        }
        let orders = self.orders.iter().flat_map(|o| [("nb", o.nb), ("nf", o.nf), ("nk", o.nk)]);
        let mut all = orders.chain([("na", self.na), ("nc", self.nc), ("nd", self.nd)]);
        if let Some((what, found)) = all.find(|(_, n)| *n > MOST_ORDER) {
            return Err(StructureError::Range {
                text: format!("orders of `{}`", self.output),
                what,
                found,
                expected: format!("at most {MOST_ORDER}"),
            });
        }
        if self.n_params() == 0 {
            return Err(StructureError::Empty { output: self.output.clone() });
        }
        Ok(())
    }

    /// Number of parameters p.
    pub fn n_params(&self) -> usize {
        self.na + self.nc + self.nd + self.orders.iter().map(|o| o.nb + o.nf).sum::<usize>()
    }

    /// Number of inputs m.
    pub fn n_inputs(&self) -> usize {
        self.orders.len()
    }

    /// Longest lag of the equation.
    pub fn max_lag(&self) -> usize {
        let of_inputs = self.orders.iter().map(|o| (o.nk + o.nb).saturating_sub(1).max(o.nf));
        of_inputs.chain([self.na, self.nc, self.nd]).max().unwrap_or(0)
    }

    /// Names of the parameters: `a1`, `b0(inj)`, `c1`, `d1`, `f1(inj)`; the index of b counts from the delay.
    pub fn param_names(&self) -> Vec<String> {
        let common = |letter: &str, n: usize| (1..=n).map(|j| format!("{letter}{j}")).collect::<Vec<_>>();
        let mut names = common("a", self.na);
        for (o, input) in self.orders.iter().zip(&self.inputs) {
            names.extend((0..o.nb).map(|j| format!("b{j}({input})")));
        }
        names.extend(common("c", self.nc));
        names.extend(common("d", self.nd));
        for (o, input) in self.orders.iter().zip(&self.inputs) {
            names.extend((1..=o.nf).map(|j| format!("f{j}({input})")));
        }
        names
    }

    /// The polynomials for `theta` (p).
    pub fn polynomials(&self, theta: &[f64]) -> Polynomials {
        let monic = |n: usize| -> Vec<f64> { (0..=n).map(|j| f64::from(u8::from(j == 0))).collect() };
        let mut p = Polynomials {
            a: monic(self.na),
            b: self.orders.iter().map(|o| vec![0.0; o.nk + o.nb]).collect(),
            c: monic(self.nc),
            d: monic(self.nd),
            f: self.orders.iter().map(|o| monic(o.nf)).collect(),
        };
        self.fill(theta, &mut p);
        p
    }

    /// The same into polynomials of these orders.
    pub(crate) fn fill(&self, theta: &[f64], p: &mut Polynomials) {
        let mut rest = theta;
        let mut take = |into: &mut [f64]| {
            let (head, tail) = rest.split_at(into.len());
            into.copy_from_slice(head);
            rest = tail;
        };
        take(&mut p.a[1..]);
        for (o, b) in self.orders.iter().zip(&mut p.b) {
            take(&mut b[o.nk..]);
        }
        take(&mut p.c[1..]);
        take(&mut p.d[1..]);
        p.f.iter_mut().for_each(|f| take(&mut f[1..]));
    }

    /// Parameters (p) from polynomials: the inverse of [`LinearModel::polynomials`].
    pub fn parameters(&self, p: &Polynomials) -> Vec<f64> {
        let mut theta = p.a[1..].to_vec();
        for (o, b) in self.orders.iter().zip(&p.b) {
            theta.extend_from_slice(&b[o.nk..]);
        }
        theta.extend_from_slice(&p.c[1..]);
        theta.extend_from_slice(&p.d[1..]);
        p.f.iter().for_each(|f| theta.extend_from_slice(&f[1..]));
        theta
    }

    /// The deterministic part `A prod F_j y = sum_i B_i prod_{j != i} F_j u_i` as a NARX model with its parameters;
    /// its free run from rest is the model's response to the inputs.
    ///
    /// ```
    /// use dynocal_ident::model::linear::LinearModel;
    /// use dynocal_ident::model::Model;
    /// // y = (1 + 0.5 q^-1) q^-1 / (1 - 0.8 q^-1) u + e
    /// let oe = LinearModel::oe(&["u"], "y", 2, 1, 1);
    /// let (narx, theta) = oe.deterministic(&[1.0, 0.5, -0.8])?;
    /// let terms: Vec<String> = (0..3).map(|k| narx.param_name(k)).collect();
    /// assert_eq!(terms, ["u(t-1)", "u(t-2)", "y(t-1)"]);
    /// assert_eq!(theta, [1.0, 0.5, 0.8]);
    /// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
    /// ```
    ///
    /// # Errors
    /// [`StructureError`] when there is no input, or the names cannot be written in regressors.
    pub fn deterministic(&self, theta: &[f64]) -> Result<(PolyNarx, Vec<f64>), StructureError> {
        let p = self.polynomials(theta);
        let (mut regressors, mut values) = (Vec::new(), Vec::new());
        for (i, b) in p.b.iter().enumerate() {
            let others = p.f.iter().enumerate().filter(|(j, _)| *j != i);
            let numerator = others.fold(b.clone(), |product, (_, f)| multiply(&product, f));
            for (lag, v) in numerator.iter().enumerate().skip(self.orders[i].nk) {
                regressors.push(Regressor::input(i, lag));
                values.push(*v);
            }
        }
        if !regressors.is_empty() {
            let denominator = p.f.iter().fold(p.a.clone(), |product, f| multiply(&product, f));
            for (lag, v) in denominator.iter().enumerate().skip(1) {
                regressors.push(Regressor::output(lag));
                values.push(-v);
            }
        }
        Ok((PolyNarx::new(self.inputs.clone(), self.output.clone(), regressors)?, values))
    }

    /// Names of the polynomials among C and F that have a root on or outside the unit circle: the prediction then
    /// never forgets its start.
    pub fn unstable_parts(&self, theta: &[f64]) -> Vec<String> {
        let p = self.polynomials(theta);
        let mut found = Vec::new();
        if !stable(&p.c) {
            found.push("C".to_string());
        }
        for (f, input) in p.f.iter().zip(&self.inputs) {
            if !stable(f) {
                found.push(format!("F of {input}"));
            }
        }
        found
    }
}
