//! The static map of a network and its derivatives, in scaled units.
//!
//! ```text
//! a0 = z,   x_k = W_k a_(k-1) + b_k,   a_k = s(x_k)   for the hidden layers k = 1..K
//! f(z) = w' a_K + b  ( + d' z  with a direct path )
//! ```
//!
//! Parameters in this order: W_1 (row by row), b_1, .., W_K, b_K, w, b, d.

use dynocal_numerics::linalg::{axpy, dot};

use super::activation::Activation;

/// Most neurons of all hidden layers together, so that the passes need no allocation.
pub(super) const MAX_NEURONS: usize = 128;
/// Most entries of z.
pub(super) const MAX_WIDTH: usize = 256;

/// One hidden layer: where its parameters and its neurons stand.
#[derive(Clone, Debug, PartialEq)]
struct Hidden {
    inputs: usize,
    neurons: usize,
    weights: usize,
    offsets: usize,
    /// First neuron in the list of all.
    first: usize,
}

/// Sizes and places of all parameters.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Network {
    pub(super) width: usize,
    activation: Activation,
    hidden: Vec<Hidden>,
    output: usize,
    pub(super) offset: usize,
    direct: Option<usize>,
    pub(super) params: usize,
}

/// What one sample leaves for the derivatives.
pub(super) struct Pass {
    /// Regressors (the first `width` entries).
    pub(super) z: [f64; MAX_WIDTH],
    /// Values and slopes of all neurons.
    value: [f64; MAX_NEURONS],
    slope: [f64; MAX_NEURONS],
    /// df/dx of all neurons, after [`Network::backward`].
    delta: [f64; MAX_NEURONS],
}

impl Pass {
    pub(super) fn new() -> Self {
        Self {
            z: [0.0; MAX_WIDTH],
            value: [0.0; MAX_NEURONS],
            slope: [0.0; MAX_NEURONS],
            delta: [0.0; MAX_NEURONS],
        }
    }
}

/// Scratch of [`Network::tangent_adjoint`].
pub(super) struct Tangent {
    /// Tangents of sums and values, adjoints of both.
    sum: [f64; MAX_NEURONS],
    value: [f64; MAX_NEURONS],
    value_bar: [f64; MAX_NEURONS],
    tangent_bar: [f64; MAX_NEURONS],
}

impl Tangent {
    pub(super) fn new() -> Self {
        let zeros = [0.0; MAX_NEURONS];
        Self { sum: zeros, value: zeros, value_bar: zeros, tangent_bar: zeros }
    }
}

/// Compiled once for each width of vectors.
struct Hessian<'a> {
    network: &'a Network,
    theta: &'a [f64],
    pass: &'a Pass,
    units: &'a [f64],
    hess: &'a mut [f64],
}

impl pulp::WithSimd for Hessian<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        self.network.hessian_wide(self.theta, self.pass, self.units, self.hess);
    }
}

impl Network {
    pub(super) fn new(width: usize, layers: &[usize], activation: Activation, direct: bool) -> Self {
        let (mut at, mut inputs, mut first, mut hidden) = (0, width, 0, Vec::new());
        for &neurons in layers {
            let (weights, offsets) = (at, at + inputs * neurons);
            hidden.push(Hidden { inputs, neurons, weights, offsets, first });
            at = offsets + neurons;
            first += neurons;
            inputs = neurons;
        }
        let (output, offset) = (at, at + inputs);
        let direct = direct.then_some(offset + 1);
        let params = offset + 1 + if direct.is_some() { width } else { 0 };
        Self { width, activation, hidden, output, offset, direct, params }
    }

    /// Neurons of the last layer: entries of w.
    fn last(&self) -> usize {
        self.offset - self.output
    }

    /// (number of inputs, number of neurons) of each hidden layer.
    pub(super) fn layers(&self) -> impl Iterator<Item = (usize, usize)> {
        self.hidden.iter().map(|l| (l.inputs, l.neurons))
    }

    /// Places of the parameters of the linear path: b and d; `None` without one.
    pub(super) fn linear_path(&self) -> Option<std::ops::Range<usize>> {
        self.direct.map(|_| self.offset..self.params)
    }

    /// Places of w.
    pub(super) fn output_weights(&self) -> std::ops::Range<usize> {
        self.output..self.offset
    }

    /// Where parameter `k` stands, in words; `z_name` names an entry of z.
    pub(super) fn param_name(&self, k: usize, z_name: &dyn Fn(usize) -> String) -> String {
        let many = self.hidden.len() > 1;
        for (i, l) in self.hidden.iter().enumerate() {
            let neuron = |j: usize| {
                if many { format!("layer {} neuron {}", i + 1, j + 1) } else { format!("neuron {}", j + 1) }
            };
            if k < l.offsets {
                let (j, place) = ((k - l.weights) / l.inputs, (k - l.weights) % l.inputs);
                let input = if i == 0 { z_name(place) } else { format!("neuron {}", place + 1) };
                return format!("{}: {input}", neuron(j));
            }
            if k < l.offsets + l.neurons {
                return format!("{}: offset", neuron(k - l.offsets));
            }
        }
        match k {
            k if k < self.offset => format!("output of neuron {}", k - self.output + 1),
            k if k == self.offset => "offset".into(),
            k => format!("direct: {}", z_name(k - self.offset - 1)),
        }
    }

    /// f(z); leaves values and slopes in `pass`.
    pub(super) fn forward(&self, theta: &[f64], pass: &mut Pass) -> f64 {
        for l in &self.hidden {
            let (done, now) = pass.value.split_at_mut(l.first);
            let before = if l.first == 0 { &pass.z[..l.inputs] } else { &done[l.first - l.inputs..] };
            let rows = theta[l.weights..l.offsets].chunks_exact(l.inputs);
            for (j, (row, offset)) in rows.zip(&theta[l.offsets..]).take(l.neurons).enumerate() {
                (now[j], pass.slope[l.first + j]) = self.activation.value_slope(offset + dot(row, before));
            }
        }
        let sum = theta[self.offset] + dot(&theta[self.output..self.offset], self.top(pass));
        match self.direct {
            Some(d) => sum + dot(&theta[d..], &pass.z[..self.width]),
            None => sum,
        }
    }

    /// Values of the last hidden layer.
    fn top<'a>(&self, pass: &'a Pass) -> &'a [f64] {
        let first = self.hidden.last().map_or(0, |l| l.first);
        &pass.value[first..first + self.last()]
    }

    /// df/dx of every neuron at the sample of the last [`Network::forward`].
    pub(super) fn backward(&self, theta: &[f64], pass: &mut Pass) {
        let mut above: Option<&Hidden> = None;
        for l in self.hidden.iter().rev() {
            let (now, later) = pass.delta[l.first..].split_at_mut(l.neurons);
            match above {
                None => now.copy_from_slice(&theta[self.output..self.offset]),
                Some(next) => {
                    now.fill(0.0);
                    let rows = theta[next.weights..next.offsets].chunks_exact(next.inputs);
                    for (row, delta) in rows.zip(&*later) {
                        axpy(*delta, row, now);
                    }
                }
            }
            for (d, s) in now.iter_mut().zip(&pass.slope[l.first..]) {
                *d *= s;
            }
            above = Some(l);
        }
    }

    /// `row = gain df/dtheta` (p), after [`Network::backward`].
    pub(super) fn gradient(&self, pass: &Pass, gain: f64, row: &mut [f64]) {
        for l in &self.hidden {
            let before = self.inputs_of(l, pass);
            let delta = &pass.delta[l.first..l.first + l.neurons];
            for (row, d) in row[l.weights..l.offsets].chunks_exact_mut(l.inputs).zip(delta) {
                let g = gain * d;
                row.iter_mut().zip(before).for_each(|(v, a)| *v = g * a);
            }
            row[l.offsets..].iter_mut().zip(delta).for_each(|(v, d)| *v = gain * d);
        }
        row[self.output..].iter_mut().zip(self.top(pass)).for_each(|(v, a)| *v = gain * a);
        row[self.offset] = gain;
        if let Some(d) = self.direct {
            row[d..].iter_mut().zip(&pass.z).for_each(|(v, z)| *v = gain * z);
        }
    }

    fn inputs_of<'a>(&self, l: &Hidden, pass: &'a Pass) -> &'a [f64] {
        if l.first == 0 { &pass.z[..l.inputs] } else { &pass.value[l.first - l.inputs..l.first] }
    }

    /// df/dz of one entry of z, after [`Network::backward`].
    pub(super) fn slope_of(&self, theta: &[f64], pass: &Pass, place: usize) -> f64 {
        let direct = self.direct.map_or(0.0, |d| theta[d + place]);
        let Some(l) = self.hidden.first() else { return direct };
        let rows = theta[l.weights..l.offsets].chunks_exact(l.inputs);
        direct + rows.zip(&pass.delta).map(|(row, d)| row[place] * d).sum::<f64>()
    }

    /// df/dz of the first entries of z into `out`, after [`Network::backward`].
    pub(super) fn input_slopes(&self, theta: &[f64], pass: &Pass, out: &mut [f64]) {
        match self.direct {
            Some(d) => out.copy_from_slice(&theta[d..d + out.len()]),
            None => out.fill(0.0),
        }
        let Some(l) = self.hidden.first() else { return };
        for (row, d) in theta[l.weights..l.offsets].chunks_exact(l.inputs).zip(&pass.delta) {
            axpy(*d, &row[..out.len()], out);
        }
    }

    /// Adds to `z_bar` the gradient with respect to z of
    ///
    /// ```text
    /// y_bar f + D,   D = (df/dtheta)' theta_dot + (df/dz)' z_dot
    /// ```
    ///
    /// by differentiating D's own evaluation backwards:
    ///
    /// ```text
    /// xdot_k = Wdot_k a_(k-1) + bdot_k + W_k adot_(k-1),   adot_k = s' xdot_k,   D = wdot'a_K + w'adot_K + ddot'z + d'z_dot
    /// X_k = A_k s' + C_k s'' xdot_k,   Y_k = C_k s'        adjoints of x_k and xdot_k, A of a, C of adot
    /// A_(k-1) = W_k'X_k + Wdot_k'Y_k,   C_(k-1) = W_k'Y_k,   A_K = y_bar w + wdot,   C_K = w
    /// ```
    ///
    /// An empty `theta_dot` stands for zero (then `z_dot` is ignored). After [`Network::forward`].
    pub(super) fn tangent_adjoint(
        &self,
        theta: &[f64],
        pass: &Pass,
        theta_dot: &[f64],
        z_dot: &[f64],
        y_bar: f64,
        work: &mut Tangent,
        z_bar: &mut [f64],
    ) {
        let with_tangent = !theta_dot.is_empty();
        if with_tangent {
            self.tangent(theta, pass, theta_dot, z_dot, work);
        }
        let top = self.hidden.last().map_or(0, |l| l.first);
        for (j, w) in theta[self.output..self.offset].iter().enumerate() {
            let dot = if with_tangent { theta_dot[self.output + j] } else { 0.0 };
            work.value_bar[top + j] = y_bar * w + dot;
            work.tangent_bar[top + j] = *w;
        }
        for (i, l) in self.hidden.iter().enumerate().rev() {
            if i > 0 {
                work.value_bar[l.first - l.inputs..l.first].fill(0.0);
                work.tangent_bar[l.first - l.inputs..l.first].fill(0.0);
            }
            for j in 0..l.neurons {
                let n = l.first + j;
                let row = &theta[l.weights + j * l.inputs..l.weights + (j + 1) * l.inputs];
                let (slope, tangent_bar) = (pass.slope[n], work.tangent_bar[n]);
                let mut x_bar = work.value_bar[n] * slope;
                if with_tangent {
                    let curvature = self.activation.curvature(pass.value[n], slope);
                    x_bar += tangent_bar * curvature * work.sum[n];
                }
                let before = if i > 0 {
                    axpy(tangent_bar * slope, row, &mut work.tangent_bar[l.first - l.inputs..l.first]);
                    &mut work.value_bar[l.first - l.inputs..l.first]
                } else {
                    &mut *z_bar
                };
                axpy(x_bar, row, before);
                if with_tangent {
                    let row_dot = &theta_dot[l.weights + j * l.inputs..l.weights + (j + 1) * l.inputs];
                    axpy(tangent_bar * slope, row_dot, before);
                }
            }
        }
        if let Some(d) = self.direct {
            axpy(y_bar, &theta[d..d + self.width], z_bar);
            if with_tangent {
                axpy(1.0, &theta_dot[d..d + self.width], z_bar);
            }
        }
    }

    /// Tangents of all neurons for the direction (`theta_dot`, `z_dot`).
    fn tangent(&self, theta: &[f64], pass: &Pass, theta_dot: &[f64], z_dot: &[f64], work: &mut Tangent) {
        for l in &self.hidden {
            let before = self.inputs_of(l, pass);
            for j in 0..l.neurons {
                let row = l.weights + j * l.inputs..l.weights + (j + 1) * l.inputs;
                let moved =
                    if l.first == 0 { &z_dot[..l.inputs] } else { &work.value[l.first - l.inputs..l.first] };
                let sum =
                    dot(&theta_dot[row.clone()], before) + theta_dot[l.offsets + j] + dot(&theta[row], moved);
                work.sum[l.first + j] = sum;
                work.value[l.first + j] = pass.slope[l.first + j] * sum;
            }
        }
    }

    /// The Hessian of f with respect to the first entries of z into `hess` (n x n), entry a in units of `units[a]`, after
    /// [`Network::backward`]:
    ///
    /// ```text
    /// H = sum_k sum_j (df/da_kj) s'' (dx_kj/dz) (dx_kj/dz)'
    /// ```
    pub(super) fn hessian(&self, theta: &[f64], pass: &Pass, units: &[f64], hess: &mut [f64]) {
        pulp::Arch::new().dispatch(Hessian { network: self, theta, pass, units, hess });
    }

    #[inline(always)]
    fn hessian_wide(&self, theta: &[f64], pass: &Pass, units: &[f64], hess: &mut [f64]) {
        let n = units.len();
        hess[..n * n].fill(0.0);
        // dx/dz of the present layer (neurons x n); of the first it is W_1 itself.
        let mut slopes: Vec<f64> = Vec::new();
        for (i, l) in self.hidden.iter().enumerate() {
            let rows = theta[l.weights..l.offsets].chunks_exact(l.inputs);
            let mut now = vec![0.0; l.neurons * n];
            for (row, out) in rows.zip(now.chunks_exact_mut(n.max(1))) {
                if i == 0 {
                    out.iter_mut().zip(row).zip(units).for_each(|((v, w), unit)| *v = w * unit);
                    continue;
                }
                for (m, w) in row.iter().enumerate() {
                    let slope = pass.slope[l.first - l.inputs + m];
                    axpy(w * slope, &slopes[m * n..(m + 1) * n], out);
                }
            }
            for (j, x) in now.chunks_exact(n.max(1)).enumerate() {
                let at = l.first + j;
                let Some(value_bar) = self.value_bar(theta, pass, i, j) else { continue };
                let weight = value_bar * self.activation.curvature(pass.value[at], pass.slope[at]);
                for (a, xa) in x.iter().enumerate() {
                    let factor = weight * xa;
                    let row = &mut hess[a * n..a * n + a + 1];
                    row.iter_mut().zip(x).for_each(|(h, v)| *h += factor * v);
                }
            }
            slopes = now;
        }
        for a in 0..n {
            for b in 0..a {
                hess[b * n + a] = hess[a * n + b];
            }
        }
    }

    /// df/da of neuron j in layer i.
    fn value_bar(&self, theta: &[f64], pass: &Pass, i: usize, j: usize) -> Option<f64> {
        match self.hidden.get(i + 1) {
            None => theta.get(self.output + j).copied(),
            Some(next) => {
                let rows = theta[next.weights..next.offsets].chunks_exact(next.inputs);
                Some(rows.zip(&pass.delta[next.first..]).map(|(row, d)| row[j] * d).sum())
            }
        }
    }
}
