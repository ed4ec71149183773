//! Neural NARX: layers of neurons over lagged inputs and outputs.
//!
//! ```text
//! y(t) = c_y + r_y f(z(t)),   f(z) = w' a_K + b ( + d' z ),   a_k = s(W_k a_(k-1) + b_k),   a_0 = z
//! z(t) = [ (u_i(t-l) - c_i)/r_i for each input i and each of its lags l,   (y(t-1) - c_y)/r_y .. (y(t-ny) - c_y)/r_y ]
//! ```
//!
//! with centre c and half range r of each channel: minimum to maximum becomes -1 to 1, or mean and standard deviation
//! become 0 and 1. Parameters, in scaled units: W_1 (row by row), b_1, .., W_K, b_K, w, b, and d where there is a direct
//! (linear) path. With bounded neurons and no direct path the free run is bounded, whatever the weights.
//!
//! Reference: thesis section 7.2.2; O. Nelles, Nonlinear System Identification (2001), chapters 11 and 17.

mod activation;
mod adjoint;
mod mean;
mod network;
mod run;
pub(super) mod spec;

use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

pub use activation::Activation;
pub(super) use mean::FORM as MEAN_FORM;
pub use mean::MeanOfNetworks;

use super::poly::StructureError;
use crate::experiment::Experiment;
use network::{MAX_NEURONS, MAX_WIDTH, Network};

/// What makes up a network beside its channels and their scales.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Neurons of each hidden layer.
    pub hidden: Vec<usize>,
    /// What each neuron computes.
    pub activation: Activation,
    /// Whether a linear path leads from all regressors to the output.
    pub direct: bool,
    /// First and last lag of each input, in samples.
    pub input_lags: Vec<[usize; 2]>,
    /// Lags of the output: 1 to this.
    pub output_lags: usize,
}

/// A neural NARX structure with the user's channel names and ranges.
///
/// ```
/// use dynocal_ident::model::neural::NeuralNarx;
/// use dynocal_ident::model::{Model, Run};
///
/// let net = NeuralNarx::new(&["u"], "y", 1, 1, 1)?; // one neuron, u(t-1) and y(t-1), no scaling
/// let run = Run { u: &[0.5, 1.0, 0.0], y: &[0.1; 3], start: 1 };
/// let mut y = [0.0; 3];
/// // W1 = [1, 2], b1 = 0.5, w = 3, b = -1
/// net.simulate(&[1.0, 2.0, 0.5, 3.0, -1.0], &run, &mut y);
/// let y1 = 3.0 * (0.5_f64 + 2.0 * 0.1 + 0.5).tanh() - 1.0;
/// assert!((y[1] - y1).abs() < 1e-15);
/// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
/// ```
///
/// Two layers, a direct path, and the input without delay:
///
/// ```
/// use dynocal_ident::model::Model;
/// use dynocal_ident::model::neural::{Activation, Layout, NeuralNarx};
///
/// let layout = Layout {
///     hidden: vec![8, 4],
///     activation: Activation::Softplus,
///     direct: true,
///     input_lags: vec![[0, 2]],
///     output_lags: 2,
/// };
/// let net = NeuralNarx::with_layout(&["u"], "y", layout)?;
/// // (5 + 1) 8 + (8 + 1) 4 + (4 + 1) weights, and 5 of the direct path
/// assert_eq!(net.n_params(), 94);
/// let text = serde_json::to_string(&net).unwrap();
/// assert_eq!(serde_json::from_str::<NeuralNarx>(&text).unwrap(), net);
/// # Ok::<(), dynocal_ident::model::poly::StructureError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "NeuralText", try_from = "NeuralText")]
pub struct NeuralNarx {
    inputs: Vec<String>,
    output: String,
    layout: Layout,
    input_scales: Vec<Scale>,
    output_scale: Scale,
    /// (input, lag) of each entry of z before the outputs.
    window: Vec<(usize, usize)>,
    network: Network,
}

/// The stored form.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NeuralText {
    inputs: Vec<String>,
    output: String,
    hidden: Vec<usize>,
    activation: Activation,
    direct: bool,
    input_lags: Vec<[usize; 2]>,
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

/// What of a record becomes -1 and 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scaling {
    /// Least and greatest value.
    #[default]
    Range,
    /// Mean minus and plus one standard deviation.
    Standard,
}

impl NeuralNarx {
    /// A network with one layer of `hidden` tanh neurons over the lags `1..=input_lags` of every input and
    /// `1..=output_lags` of the output, without scaling (all ranges [-1, 1]).
    ///
    /// # Errors
    /// As [`NeuralNarx::with_layout`].
    pub fn new(
        inputs: &[&str],
        output: &str,
        hidden: usize,
        input_lags: usize,
        output_lags: usize,
    ) -> Result<Self, StructureError> {
        let layout = Layout {
            hidden: vec![hidden],
            activation: Activation::Tanh,
            direct: false,
            input_lags: vec![[1, input_lags]; inputs.len()],
            output_lags,
        };
        Self::with_layout(inputs, output, layout)
    }

    /// A network of any layout, without scaling (all ranges [-1, 1]). An input whose first lag is above its last is
    /// not read.
    ///
    /// # Errors
    /// [`StructureError`]: lags that do not belong to the inputs one to one, no layer, a layer without neuron, no
    /// regressor, or more of them than the model can hold.
    pub fn with_layout(inputs: &[&str], output: &str, layout: Layout) -> Result<Self, StructureError> {
        let inputs: Vec<String> = inputs.iter().map(|s| s.to_string()).collect();
        let m = inputs.len();
        if layout.input_lags.len() != m {
            let found = layout.input_lags.len();
            return Err(StructureError::Orders { output: output.into(), found, expected: m, inputs });
        }
        let fault = |what, found, least: usize, most: usize| StructureError::Range {
            text: format!("network of `{output}`"),
            what,
            found,
            expected: format!("{least} to {most}"),
        };
        if layout.hidden.is_empty() {
            return Err(fault("number of hidden layers", 0, 1, MAX_NEURONS));
        }
        let neurons = layout.hidden.iter().fold(0, |sum: usize, n| sum.saturating_add(*n));
        if neurons > MAX_NEURONS || layout.hidden.contains(&0) {
            let found = if layout.hidden.contains(&0) { 0 } else { neurons };
            return Err(fault("number of neurons", found, 1, MAX_NEURONS));
        }
        let count = |[first, last]: &[usize; 2]| (last + 1).saturating_sub(*first);
        let lag = layout.input_lags.iter().map(|l| l[1]).chain([layout.output_lags]).max().unwrap_or(0);
        if lag > MAX_LAG {
            return Err(fault("lag", lag, 0, MAX_LAG));
        }
        let width = layout.input_lags.iter().map(count).sum::<usize>() + layout.output_lags;
        if width == 0 {
            return Err(StructureError::Empty { output: output.into() });
        }
        if width > MAX_WIDTH {
            return Err(fault("number of lagged values", width, 1, MAX_WIDTH));
        }
        let window =
            (0..m).flat_map(|i| (layout.input_lags[i][0]..=layout.input_lags[i][1]).map(move |l| (i, l)));
        let window = window.collect();
        let network = Network::new(width, &layout.hidden, layout.activation, layout.direct);
        let unit = Scale::new([-1.0, 1.0]);
        let (output, input_scales) = (output.into(), vec![unit; m]);
        Ok(Self { inputs, output, layout, input_scales, output_scale: unit, window, network })
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
        self.scaled_by(Scaling::Range, data)
    }

    /// The same network with scales from all records together; missing values (NaN) are left out.
    ///
    /// # Errors
    /// As [`NeuralNarx::with_ranges`].
    pub fn scaled_by(self, scaling: Scaling, data: &[Experiment]) -> Result<Self, StructureError> {
        let m = self.inputs.len();
        let over = |values: &mut dyn Iterator<Item = f64>| limits(scaling, values);
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

    /// Layers, activation, lags.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Entries of z.
    fn width(&self) -> usize {
        self.network.width
    }

    /// Random weights that leave the neurons in their sloping range: every row of W and w uniform with the variance
    /// of one over its length. The direct path is left out.
    pub fn random_start(&self, rng: &mut Rng64) -> Vec<f64> {
        let mut theta = Vec::with_capacity(self.network.params);
        let mut uniform = |n: usize, count: usize, theta: &mut Vec<f64>| {
            let limit = (3.0 / n as f64).sqrt();
            theta.extend((0..count).map(|_| rng.uniform_in(-limit, limit)));
        };
        for (inputs, neurons) in self.network.layers() {
            uniform(inputs, inputs * neurons, &mut theta);
            uniform(inputs, neurons, &mut theta);
        }
        let top = self.network.output_weights().len();
        uniform(top, top, &mut theta);
        theta.resize(self.network.params, 0.0);
        theta
    }
}

/// Longest lag: what a record could still hold several times.
const MAX_LAG: usize = 10_000;

/// What of the values becomes -1 and 1; [-1, 1] itself where there are none.
fn limits(scaling: Scaling, values: &mut dyn Iterator<Item = f64>) -> [f64; 2] {
    let (mut n, mut mean, mut squares) = (0.0, 0.0, 0.0);
    let mut range = [f64::INFINITY, f64::NEG_INFINITY];
    for v in values.filter(|v| v.is_finite()) {
        range = [range[0].min(v), range[1].max(v)];
        // Welford's recursion: no cancellation for channels far from zero.
        n += 1.0;
        let step = v - mean;
        mean += step / n;
        squares += step * (v - mean);
    }
    let deviation = (squares / n).sqrt();
    match scaling {
        _ if n == 0.0 => [-1.0, 1.0],
        Scaling::Range => range,
        Scaling::Standard => [mean - deviation, mean + deviation],
    }
}

impl From<NeuralNarx> for NeuralText {
    fn from(n: NeuralNarx) -> Self {
        let input_ranges = n.input_scales.iter().map(|s| s.limits).collect();
        Self {
            inputs: n.inputs,
            output: n.output,
            hidden: n.layout.hidden,
            activation: n.layout.activation,
            direct: n.layout.direct,
            input_lags: n.layout.input_lags,
            output_lags: n.layout.output_lags,
            input_ranges,
            output_range: n.output_scale.limits,
        }
    }
}

impl TryFrom<NeuralText> for NeuralNarx {
    type Error = StructureError;

    fn try_from(t: NeuralText) -> Result<Self, StructureError> {
        let inputs: Vec<&str> = t.inputs.iter().map(String::as_str).collect();
        let layout = Layout {
            hidden: t.hidden,
            activation: t.activation,
            direct: t.direct,
            input_lags: t.input_lags,
            output_lags: t.output_lags,
        };
        Self::with_layout(&inputs, &t.output, layout)?.with_ranges(&t.input_ranges, t.output_range)
    }
}
