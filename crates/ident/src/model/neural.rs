//! Neural NARX: one hidden layer of tanh neurons over lagged inputs and outputs.
//!
//! ```text
//! y(t) = c_y + r_y ( w2' tanh(W1 z(t) + b1) + b2 )
//! z(t) = [ (u_i(t-1) - c_i)/r_i .. (u_i(t-nu) - c_i)/r_i  for each input i,  (y(t-1) - c_y)/r_y .. (y(t-ny) - c_y)/r_y ]
//! ```
//!
//! with centre c and half range r of each channel (min-max scaling to [-1, 1]). Parameters: W1 (h x q row-major),
//! b1 (h), w2 (h), b2, in scaled units; q = m nu + ny. The free run is bounded by construction, whatever the weights.
//!
//! Reference: thesis section 7.2.2; O. Nelles, Nonlinear System Identification (2001), chapters 11 and 17.

mod adjoint;
mod run;

use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

use super::poly::StructureError;
use crate::experiment::Experiment;

/// Most neurons, so that the forward pass needs no allocation.
const MAX_HIDDEN: usize = 64;
/// Most entries of z.
const MAX_WIDTH: usize = 256;

/// A neural NARX structure with the user's channel names and ranges.
///
/// ```
/// use dynocal_ident::model::neural::NeuralNarx;
/// use dynocal_ident::model::{Model, Run};
///
/// let net = NeuralNarx::new(&["u"], "y", 1, 1, 1)?; // one neuron, u(t-1) and y(t-1), no scaling
/// let run = Run { u: &[0.5, 1.0, 0.0], y: &[0.1; 3], start: 1 };
/// let mut y = [0.0; 3];
/// // W1 = [1, 2], b1 = 0.5, w2 = 3, b2 = -1
/// net.simulate(&[1.0, 2.0, 0.5, 3.0, -1.0], &run, &mut y);
/// let y1 = 3.0 * (0.5_f64 + 2.0 * 0.1 + 0.5).tanh() - 1.0;
/// assert!((y[1] - y1).abs() < 1e-15);
/// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "NeuralText", try_from = "NeuralText")]
pub struct NeuralNarx {
    inputs: Vec<String>,
    output: String,
    hidden: usize,
    input_lags: usize,
    output_lags: usize,
    input_scales: Vec<Scale>,
    output_scale: Scale,
    /// (input, lag) of each entry of z before the outputs.
    window: Vec<(usize, usize)>,
}

/// The stored form.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NeuralText {
    inputs: Vec<String>,
    output: String,
    hidden: usize,
    input_lags: usize,
    output_lags: usize,
    input_ranges: Vec<[f64; 2]>,
    output_range: [f64; 2],
}

/// Range of a channel: its limits, and centre and half width as computed from them once.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Scale {
    limits: [f64; 2],
    centre: f64,
    half: f64,
}

impl Scale {
    fn new(limits: [f64; 2]) -> Self {
        let [lo, hi] = limits;
        // A channel that does not move in the record keeps its unit.
        let half = if hi > lo { 0.5 * (hi - lo) } else { 1.0 };
        Self { limits, centre: 0.5 * (lo + hi), half }
    }

    fn scaled(&self, v: f64) -> f64 {
        (v - self.centre) / self.half
    }
}

impl NeuralNarx {
    /// A network of `hidden` neurons over the lags `1..=input_lags` of every input and `1..=output_lags` of the output,
    /// without scaling (all ranges [-1, 1]).
    ///
    /// # Errors
    /// [`StructureError`]: no neuron, no regressor, or more of them than the model can hold.
    pub fn new(
        inputs: &[&str],
        output: &str,
        hidden: usize,
        input_lags: usize,
        output_lags: usize,
    ) -> Result<Self, StructureError> {
        let inputs: Vec<String> = inputs.iter().map(|s| s.to_string()).collect();
        let (m, unit) = (inputs.len(), Scale::new([-1.0, 1.0]));
        let width = m * input_lags + output_lags;
        if width == 0 {
            return Err(StructureError::Empty { output: output.into() });
        }
        let fault = |what, found, most| StructureError::Range {
            text: format!("network of `{output}`"),
            what,
            found,
            expected: format!("1 to {most}"),
        };
        if hidden == 0 || hidden > MAX_HIDDEN {
            return Err(fault("number of neurons", hidden, MAX_HIDDEN));
        }
        if width > MAX_WIDTH {
            return Err(fault("number of lagged values", width, MAX_WIDTH));
        }
        let window = (0..m).flat_map(|i| (1..=input_lags).map(move |lag| (i, lag))).collect();
        let (output, input_scales) = (output.into(), vec![unit; m]);
        Ok(Self { inputs, output, hidden, input_lags, output_lags, input_scales, output_scale: unit, window })
    }

    /// The same network with the ranges of its channels: `[lowest, highest]` of each input, and of the output.
    ///
    /// # Errors
    /// [`StructureError::Orders`] when there is not one range per input.
    pub fn with_ranges(mut self, inputs: &[[f64; 2]], output: [f64; 2]) -> Result<Self, StructureError> {
        if inputs.len() != self.inputs.len() {
            return Err(StructureError::Orders {
                output: self.output.clone(),
                found: inputs.len(),
                expected: self.inputs.len(),
                inputs: self.inputs.clone(),
            });
        }
        self.input_scales = inputs.iter().map(|r| Scale::new(*r)).collect();
        self.output_scale = Scale::new(output);
        Ok(self)
    }

    /// The same network scaled to the least and greatest values of all records together.
    ///
    /// # Errors
    /// As [`NeuralNarx::with_ranges`].
    pub fn scaled_to(self, data: &[Experiment]) -> Result<Self, StructureError> {
        let m = self.inputs.len();
        let over = |values: &mut dyn Iterator<Item = f64>| -> [f64; 2] {
            let range = values.fold([f64::INFINITY, f64::NEG_INFINITY], |[lo, hi], v| [lo.min(v), hi.max(v)]);
            if range[0] <= range[1] { range } else { [-1.0, 1.0] }
        };
        let inputs: Vec<[f64; 2]> = (0..m)
            .map(|i| over(&mut data.iter().flat_map(|e| e.u.iter().skip(i).step_by(m).copied())))
            .collect();
        let output = over(&mut data.iter().flat_map(|e| e.y.iter().copied()));
        self.with_ranges(&inputs, output)
    }

    /// `[lowest, highest]` of each input, and of the output.
    pub fn ranges(&self) -> (Vec<[f64; 2]>, [f64; 2]) {
        (self.input_scales.iter().map(|s| s.limits).collect(), self.output_scale.limits)
    }

    /// Half of the output's range: errors in the unit of the output divided by it are errors in scaled units.
    pub fn output_half_range(&self) -> f64 {
        self.output_scale.half
    }

    /// Number of neurons h.
    pub fn hidden(&self) -> usize {
        self.hidden
    }

    /// Entries of z: q.
    fn width(&self) -> usize {
        self.window.len() + self.output_lags
    }

    /// Random weights that leave the neurons in their sloping range: every row of W1 and w2 uniform with the variance
    /// of one over its length.
    fn draw(&self, rng: &mut Rng64) -> Vec<f64> {
        let (h, q) = (self.hidden, self.width());
        let mut uniform = |n: usize| {
            let limit = (3.0 / n as f64).sqrt();
            rng.uniform_in(-limit, limit)
        };
        let mut theta: Vec<f64> = (0..h * q).map(|_| uniform(q)).collect();
        theta.extend((0..h).map(|_| uniform(q)));
        theta.extend((0..h).map(|_| uniform(h)));
        theta.push(0.0);
        theta
    }
}

impl From<NeuralNarx> for NeuralText {
    fn from(n: NeuralNarx) -> Self {
        let input_ranges = n.input_scales.iter().map(|s| s.limits).collect();
        Self {
            inputs: n.inputs,
            output: n.output,
            hidden: n.hidden,
            input_lags: n.input_lags,
            output_lags: n.output_lags,
            input_ranges,
            output_range: n.output_scale.limits,
        }
    }
}

impl TryFrom<NeuralText> for NeuralNarx {
    type Error = StructureError;

    fn try_from(t: NeuralText) -> Result<Self, StructureError> {
        let inputs: Vec<&str> = t.inputs.iter().map(String::as_str).collect();
        Self::new(&inputs, &t.output, t.hidden, t.input_lags, t.output_lags)?
            .with_ranges(&t.input_ranges, t.output_range)
    }
}
