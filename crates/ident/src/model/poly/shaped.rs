//! Terms with functions, compiled: value and exact first and second derivatives.
//!
//! Every factor of such a term, plain ones included, is `g_f(z_f)^q_f` with an affine z_f, so that
//!
//! ```text
//! phi = prod_f h_f,  h_f = g_f^q_f
//! dphi/dr_i         = c_fi h_f' prod_{e != f} h_e
//! d2phi/dr_i dr_j   = c_fi c_fj h_f'' prod_{e != f} h_e             both read by f
//!                   = c_fi c_ej h_f' h_e' prod_{d != e, f} h_d      read by two factors
//! ```

use super::function::Shape;
use super::program::power;
use super::regressor::{Regressor, Source};

/// Where a value is read.
#[derive(Clone, Copy, Debug)]
pub(super) enum Place {
    /// Position in the input window of a sample, and in the list of (input, lag) pairs.
    Input { shift: usize, window: usize },
    /// `y(t - lag)` and the position of the lag in the list of output lags.
    Output { lag: usize, slot: usize },
}

#[derive(Clone, Copy, Debug)]
struct Read {
    place: Place,
    gain: f64,
}

#[derive(Clone, Debug)]
struct Factor {
    /// `None`: the argument itself.
    shape: Option<Shape>,
    reads: Vec<Read>,
    offset: f64,
    power: u32,
}

/// One term with functions.
#[derive(Clone, Debug)]
pub(super) struct ShapedTerm {
    /// Number of its parameter.
    pub(super) k: usize,
    factors: Vec<Factor>,
}

impl ShapedTerm {
    pub(super) fn new(k: usize, regressor: &Regressor, place: impl Fn(Source, usize) -> Place) -> Self {
        let plain = regressor.factors().iter().map(|f| Factor {
            shape: None,
            reads: vec![Read { place: place(f.source, f.lag), gain: 1.0 }],
            offset: 0.0,
            power: f.power,
        });
        let functions = regressor.functions().iter().map(|f| Factor {
            shape: Some(f.shape),
            reads: f
                .reads
                .iter()
                .map(|r| Read { place: place(r.source, r.lag), gain: r.gain.get() })
                .collect(),
            offset: f.offset.get(),
            power: f.power,
        });
        Self { k, factors: plain.chain(functions).collect() }
    }

    /// phi(t) from the input window of sample t and the outputs before it.
    pub(super) fn value(&self, window: &[f64], y: &[f64], t: usize) -> f64 {
        self.factors.iter().fold(1.0, |x, f| x * f.value(window, y, t))
    }

    /// Calls `add(read, dphi/dread)` for every read.
    pub(super) fn gradient(&self, window: &[f64], y: &[f64], t: usize, mut add: impl FnMut(Place, f64)) {
        for (i, f) in self.factors.iter().enumerate() {
            let slope = f.derivatives(window, y, t).1 * self.except(&[i], window, y, t);
            f.reads.iter().for_each(|r| add(r.place, r.gain * slope));
        }
    }

    /// Calls `add(read, other read, d2phi/dread dother)` for every ordered pair of reads.
    pub(super) fn hessian(
        &self,
        window: &[f64],
        y: &[f64],
        t: usize,
        mut add: impl FnMut(Place, Place, f64),
    ) {
        for (i, f) in self.factors.iter().enumerate() {
            let (_, slope, curvature) = f.derivatives(window, y, t);
            for (j, e) in self.factors.iter().enumerate() {
                let second = if i == j {
                    curvature * self.except(&[i], window, y, t)
                } else {
                    slope * e.derivatives(window, y, t).1 * self.except(&[i, j], window, y, t)
                };
                for a in &f.reads {
                    e.reads.iter().for_each(|b| add(a.place, b.place, a.gain * b.gain * second));
                }
            }
        }
    }

    /// Product of the factors that are not in `skip`.
    fn except(&self, skip: &[usize], window: &[f64], y: &[f64], t: usize) -> f64 {
        let kept = self.factors.iter().enumerate().filter(|(i, _)| !skip.contains(i));
        kept.fold(1.0, |x, (_, f)| x * f.value(window, y, t))
    }
}

impl Factor {
    fn argument(&self, window: &[f64], y: &[f64], t: usize) -> f64 {
        self.reads.iter().fold(self.offset, |z, r| {
            z + r.gain
                * match r.place {
                    Place::Input { shift, .. } => window[shift],
                    Place::Output { lag, .. } => y[t - lag],
                }
        })
    }

    /// h = g^q at the present argument.
    fn value(&self, window: &[f64], y: &[f64], t: usize) -> f64 {
        let z = self.argument(window, y, t);
        power(self.shape.map_or(z, |s| s.value(z)), self.power)
    }

    /// (h, h', h'') of h = g^q at the present argument.
    fn derivatives(&self, window: &[f64], y: &[f64], t: usize) -> (f64, f64, f64) {
        let z = self.argument(window, y, t);
        let (g, g1, g2) = self.shape.map_or((z, 1.0, 0.0), |s| s.derivatives(z));
        let n = f64::from(self.power);
        if self.power == 1 {
            return (g, g1, g2);
        }
        let (below, twice) = (power(g, self.power - 1), power(g, self.power - 2));
        (power(g, self.power), n * below * g1, n * (n - 1.0) * twice * g1 * g1 + n * below * g2)
    }
}
