//! A test signal designed in the reference space.
//!
//! Variables are the held levels of demanded torque, demanded lambda and spark and the points of a speed profile.
//! They are linear in the reference record (levels joined by ramps, speed by straight lines), a static rule turns the
//! reference into fuel and throttle, and the criterion comes from the models' exact sensitivities:
//!
//! ```text
//! x  --linear-->  r(t) = (T, lambda, SA, N)  --rule-->  u(t) = (INJ, SA, throttle, N, 120/N)  -->  S  -->  J
//! dJ/dx = (dr/dx)' (du/dr)' dJ/du,     dJ/du by the adjoint of the sensitivity recursion
//! ```
//!
//! Amplitudes are the box of x; rates follow from the ramp and the distance of the speed points. On the bed the
//! reference is run through the loops, so that lambda stays where it was asked to be.

use super::spec::DesignSpec;
use dynocal_calib::engine_model::cycle_s;
use dynocal_calib::map::Reference;
use dynocal_calib::map::start::StartRule;
use dynocal_design::problem::Evaluator;
use dynocal_numerics::optim::Objective;

/// Number of references: torque, lambda, spark, speed.
const R: usize = 4;
/// Number of model inputs: INJ, spark, throttle, speed, cycle.
const M: usize = 5;

/// Weights of up to two variables in one sample of one reference.
type Weights = [(usize, f64); 2];

/// How variables make up a reference record.
pub struct ReferenceLayout {
    n_samples: usize,
    variables: usize,
    /// Per sample and reference.
    weights: Vec<[Weights; R]>,
    /// Reference that each variable belongs to.
    owner: Vec<usize>,
}

impl ReferenceLayout {
    /// Layout for a record of `n_samples`.
    pub fn new(spec: &DesignSpec, n_samples: usize, sample_time_s: f64) -> Self {
        let samples = |s: f64| (s / sample_time_s).round().max(1.0) as usize;
        let (hold, ramp, point) = (samples(spec.hold_s), samples(spec.ramp_s), samples(spec.speed_point_s));
        let levels = n_samples.div_ceil(hold);
        let points = (n_samples - 1).div_ceil(point) + 1;
        let weights = (0..n_samples)
            .map(|t| {
                let (k, into) = (t / hold, t % hold);
                let part = ((into + 1) as f64 / ramp as f64).min(1.0);
                let level = |channel: usize| {
                    let at = channel * levels + k;
                    if k == 0 { [(at, 1.0), (at, 0.0)] } else { [(at, part), (at - 1, 1.0 - part)] }
                };
                let (j, a) = (t / point, (t % point) as f64 / point as f64);
                let next = (j + 1).min(points - 1);
                let speed = [(3 * levels + j, 1.0 - a), (3 * levels + next, a)];
                [level(0), level(1), level(2), speed]
            })
            .collect();
        let owner = (0..3 * levels + points).map(|v| (v / levels).min(3)).collect();
        Self { n_samples, variables: 3 * levels + points, weights, owner }
    }

    /// Number of variables.
    pub fn variables(&self) -> usize {
        self.variables
    }

    /// Box of the variables.
    pub fn bounds(&self, spec: &DesignSpec) -> (Vec<f64>, Vec<f64>) {
        let ranges = [spec.torque_nm, spec.lambda, spec.spark_deg, spec.speed_rpm];
        self.owner.iter().map(|&c| ranges[c]).unzip()
    }

    /// The reference record of `x`: per sample torque, lambda, spark, speed.
    pub fn reference(&self, x: &[f64]) -> Vec<[f64; R]> {
        let value = |w: &Weights| w[0].1 * x[w[0].0] + w[1].1 * x[w[1].0];
        self.weights.iter().map(|w| std::array::from_fn(|c| value(&w[c]))).collect()
    }

    /// Transpose of [`ReferenceLayout::reference`]: adds up the gradient in the variables.
    fn back(&self, r_bar: &[[f64; R]], x_bar: &mut [f64]) {
        x_bar.fill(0.0);
        for (w, bar) in self.weights.iter().zip(r_bar) {
            for c in 0..R {
                for (variable, weight) in w[c] {
                    x_bar[variable] += weight * bar[c];
                }
            }
        }
    }
}

/// Model inputs (N x 5) of a reference record through the static rule.
pub fn model_inputs(rule: &StartRule, reference: &[[f64; R]]) -> Vec<f64> {
    let (points, spark): (Vec<Reference>, Vec<f64>) = reference
        .iter()
        .map(|r| (Reference { torque_nm: r[0], lambda: r[1], speed_rpm: r[3] }, r[2]))
        .unzip();
    rule.drive(&points, &spark)
        .iter()
        .zip(reference)
        .flat_map(|(u, r)| [u[0], u[1], u[2], r[3], cycle_s(r[3])])
        .collect()
}

/// The criterion over the scaled variables (each from 0 to 1), for a bounded optimiser.
pub struct ReferenceObjective<'a, 'p> {
    /// Layout.
    pub layout: &'a ReferenceLayout,
    /// Static rule.
    pub rule: &'a StartRule,
    /// Criterion and its gradient in the inputs.
    pub evaluator: Evaluator<'p>,
    /// Box of the variables.
    pub bounds: (Vec<f64>, Vec<f64>),
    u_bar: Vec<f64>,
    r_bar: Vec<[f64; R]>,
}

/// Order of the p-norms with which E and G are searched.
const SHARPNESS: f64 = 30.0;

impl<'a, 'p> ReferenceObjective<'a, 'p> {
    /// Objective with its buffers.
    pub fn new(
        layout: &'a ReferenceLayout,
        rule: &'a StartRule,
        evaluator: Evaluator<'p>,
        bounds: (Vec<f64>, Vec<f64>),
    ) -> Self {
        let n = layout.n_samples;
        Self { layout, rule, evaluator, bounds, u_bar: vec![0.0; n * M], r_bar: vec![[0.0; R]; n] }
    }

    /// Variables in their units from scaled ones.
    pub fn unscaled(&self, z: &[f64]) -> Vec<f64> {
        let (lower, upper) = &self.bounds;
        z.iter().zip(lower.iter().zip(upper)).map(|(z, (a, b))| a + z * (b - a)).collect()
    }
}

impl Objective for ReferenceObjective<'_, '_> {
    fn n(&self) -> usize {
        self.layout.variables()
    }

    fn value_gradient(&mut self, z: &[f64], grad: &mut [f64]) -> f64 {
        let reference = self.layout.reference(&self.unscaled(z));
        let u = model_inputs(self.rule, &reference);
        let value = self.evaluator.value_gradient(&u, SHARPNESS, &mut self.u_bar);
        if grad.is_empty() {
            return value;
        }
        for ((bar, r), u_bar) in self.r_bar.iter_mut().zip(&reference).zip(self.u_bar.chunks_exact(M)) {
            let point = Reference { torque_nm: r[0], lambda: r[1], speed_rpm: r[3] };
            let [inj, throttle] = self.rule.derivatives(&point, r[2]);
            // d(120/N)/dN = -(120/N)/N
            let speed = u_bar[3] - u_bar[4] * cycle_s(r[3]) / r[3];
            let through = |j: usize| u_bar[0] * inj[j] + u_bar[2] * throttle[j];
            *bar = [through(0), through(1), u_bar[1] + through(3), speed + through(2)];
        }
        self.layout.back(&self.r_bar, grad);
        for (g, (a, b)) in grad.iter_mut().zip(self.bounds.0.iter().zip(&self.bounds.1)) {
            *g *= b - a;
        }
        value
    }
}
