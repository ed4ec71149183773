//! Linear systems of several inputs and outputs with exact delay, continuous or sampled.

use dynocal_numerics::fft::Complex;
use serde::{Deserialize, Serialize};

use crate::error::ControlError;
use crate::matrix::{C, Matrix};
use crate::poly::{add, degree, multiply, value};

/// What the polynomials are in: s, or `q = z^-1`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Time {
    /// In s.
    Continuous,
    /// In q = z^-1.
    Sampled {
        /// Sample time in s.
        sample_time_s: f64,
    },
}

impl Time {
    /// s or q at an angular frequency in rad/s.
    pub fn variable(self, w_rad_s: f64) -> C {
        match self {
            Self::Continuous => Complex::new(0.0, w_rad_s),
            Self::Sampled { sample_time_s } => Complex::from_polar(1.0, -w_rad_s * sample_time_s),
        }
    }

    /// Highest frequency in rad/s that there is: half of the sampling frequency.
    pub fn nyquist_rad_s(self) -> Option<f64> {
        match self {
            Self::Continuous => None,
            Self::Sampled { sample_time_s } => Some(std::f64::consts::PI / sample_time_s),
        }
    }

    /// Sample time in s.
    pub fn sample_time_s(self) -> Option<f64> {
        match self {
            Self::Continuous => None,
            Self::Sampled { sample_time_s } => Some(sample_time_s),
        }
    }
}

/// `num / den * exp(-s delay_s)`; coefficients ascend in s, or in q = z^-1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Transfer {
    /// Numerator, ascending.
    pub num: Vec<f64>,
    /// Denominator, ascending.
    pub den: Vec<f64>,
    /// Delay in s; of a sampled system any delay too, exact at its frequencies.
    #[serde(default)]
    pub delay_s: f64,
}

impl Transfer {
    /// A gain.
    pub fn gain(k: f64) -> Self {
        Self { num: vec![k], den: vec![1.0], delay_s: 0.0 }
    }

    /// Continuous, as it is written: highest power of s first.
    ///
    /// ```
    /// use dynocal_control::system::Transfer;
    /// // (s + 3) / (s^2 + 2 s) e^(-0.1 s)
    /// let g = Transfer::continuous(&[1.0, 3.0], &[1.0, 2.0, 0.0], 0.1);
    /// assert_eq!(g.den, [0.0, 2.0, 1.0]);
    /// ```
    pub fn continuous(num: &[f64], den: &[f64], delay_s: f64) -> Self {
        let turned = |c: &[f64]| c.iter().rev().copied().collect();
        Self { num: turned(num), den: turned(den), delay_s }
    }

    /// Sampled: `b_0 + b_1 z^-1 + ..` over `1 + a_1 z^-1 + ..`, delays of whole samples are leading zeros of the numerator.
    pub fn sampled(num: &[f64], den: &[f64]) -> Self {
        Self { num: num.to_vec(), den: den.to_vec(), delay_s: 0.0 }
    }

    /// Value at an angular frequency in rad/s.
    pub fn at(&self, time: Time, w_rad_s: f64) -> C {
        let x = time.variable(w_rad_s);
        let rational = if self.num.len() == 1 && self.num[0] == 0.0 {
            return Complex::new(0.0, 0.0);
        } else {
            value(&self.num, x) / value(&self.den, x)
        };
        if self.delay_s == 0.0 {
            rational
        } else {
            rational * Complex::from_polar(1.0, -w_rad_s * self.delay_s)
        }
    }

    /// One after the other.
    pub fn times(&self, other: &Self) -> Self {
        Self {
            num: multiply(&self.num, &other.num),
            den: multiply(&self.den, &other.den),
            delay_s: self.delay_s + other.delay_s,
        }
    }

    /// The same with a factor.
    pub fn scaled(&self, k: f64) -> Self {
        Self { num: self.num.iter().map(|v| v * k).collect(), ..self.clone() }
    }

    /// The same with more delay.
    pub fn delayed(&self, delay_s: f64) -> Self {
        Self { delay_s: self.delay_s + delay_s, ..self.clone() }
    }

    /// Gain at rest; infinite for an integrator, NaN where zero and pole are both at rest.
    pub fn steady_gain(&self, time: Time) -> f64 {
        match time {
            Time::Continuous => self.num[0] / self.den[0],
            Time::Sampled { .. } => self.num.iter().sum::<f64>() / self.den.iter().sum::<f64>(),
        }
    }

    /// Whether it is zero.
    pub fn is_zero(&self) -> bool {
        self.num.iter().all(|v| *v == 0.0)
    }

    fn check(&self, what: &str, time: Time) -> Result<(), ControlError> {
        let all = self.num.iter().chain(&self.den);
        if let Some(v) = all.copied().find(|v| !v.is_finite()) {
            return Err(ControlError::number(format!("a coefficient of {what}"), v, "a finite number"));
        }
        if self.num.is_empty() || self.den.iter().all(|v| *v == 0.0) {
            return Err(ControlError::number(
                format!("the denominator of {what}"),
                0.0,
                "a polynomial that is not zero",
            ));
        }
        if !(self.delay_s >= 0.0 && self.delay_s.is_finite()) {
            return Err(ControlError::number(
                format!("the delay of {what}"),
                self.delay_s,
                "0 or a positive number of seconds",
            ));
        }
        match time {
            Time::Continuous if degree(&self.num) > degree(&self.den) => {
                let found = degree(&self.num) as f64;
                Err(ControlError::number(
                    format!("the degree of the numerator of {what}"),
                    found,
                    "at most that of the denominator",
                ))
            }
            Time::Sampled { .. } if self.den[0] == 0.0 => Err(ControlError::number(
                format!("the first coefficient of the denominator of {what}"),
                0.0,
                "a number other than 0 (it multiplies the present output)",
            )),
            _ => Ok(()),
        }
    }
}

/// A matrix of transfer functions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct System {
    /// Continuous or sampled.
    pub time: Time,
    /// Outputs.
    pub outputs: usize,
    /// Inputs.
    pub inputs: usize,
    /// Channels, row-major: output by input.
    pub channels: Vec<Transfer>,
    /// Polynomials whose roots are the poles, each as often as there are states with it: factors, because the product of
    /// many integrators has no digits left near rest.
    pub poles: Vec<Vec<f64>>,
}

impl System {
    /// A system whose outputs have their own states: the poles are, row by row, those of the different denominators.
    ///
    /// # Errors
    /// [`ControlError`]: shapes, coefficients that are no numbers, more zeros than poles.
    pub fn new(
        time: Time,
        outputs: usize,
        inputs: usize,
        channels: Vec<Transfer>,
    ) -> Result<Self, ControlError> {
        if channels.len() != outputs * inputs || channels.is_empty() {
            let expected = format!("{outputs} x {inputs}");
            return Err(ControlError::shape("channels of a system", channels.len(), expected));
        }
        if let Some(found) = time.sample_time_s().filter(|s| !(*s > 0.0 && s.is_finite())) {
            return Err(ControlError::number("the sample time", found, "a positive number of seconds"));
        }
        for (k, g) in channels.iter().enumerate() {
            g.check(&format!("channel ({}, {})", k / inputs + 1, k % inputs + 1), time)?;
        }
        let mut poles = Vec::new();
        for row in channels.chunks(inputs) {
            for (k, g) in row.iter().enumerate() {
                if !g.is_zero() && !row[..k].iter().any(|o| !o.is_zero() && o.den == g.den) {
                    poles.push(g.den.clone());
                }
            }
        }
        Ok(Self { time, outputs, inputs, channels, poles })
    }

    /// One input and one output.
    ///
    /// # Errors
    /// As of [`System::new`].
    pub fn single(time: Time, channel: Transfer) -> Result<Self, ControlError> {
        Self::new(time, 1, 1, vec![channel])
    }

    /// Each input drives its own output.
    ///
    /// # Errors
    /// As of [`System::new`].
    pub fn diagonal(time: Time, own: &[Transfer]) -> Result<Self, ControlError> {
        let n = own.len();
        let at = |k: usize| if k / n == k % n { own[k / n].clone() } else { Transfer::gain(0.0) };
        Self::new(time, n, n, (0..n * n).map(at).collect())
    }

    /// The same with other poles: where the outputs share states, these are fewer than [`System::new`] takes them for.
    pub fn with_poles(mut self, ascending: &[f64]) -> Self {
        self.poles = vec![ascending.to_vec()];
        self
    }

    /// `x' = A x + B u, y = C x + D u` (matrices row-major, n states), or `x(t+1) = ..` where it is sampled. Transfer functions
    /// by the method of Faddeev and LeVerrier, exact for the few states that there are here.
    ///
    /// # Errors
    /// [`ControlError::Shape`].
    pub fn from_states(
        time: Time,
        a: &[f64],
        b: &[f64],
        c: &[f64],
        d: &[f64],
        n: usize,
    ) -> Result<Self, ControlError> {
        let (m, p) = (b.len() / n.max(1), c.len() / n.max(1));
        if n == 0 || a.len() != n * n || b.len() != n * m || c.len() != p * n || d.len() != p * m {
            let found = format!("{}, {}, {}, {} entries", a.len(), b.len(), c.len(), d.len());
            return Err(ControlError::shape(
                "matrices A, B, C, D",
                found,
                format!("n x n, n x m, p x n, p x m with n = {n}"),
            ));
        }
        // adj(x I - A) = sum_k M_k x^(n-k), det = sum_k c_k x^k.
        let mut coefficients = vec![0.0; n + 1];
        coefficients[n] = 1.0;
        let mut adjugate = Vec::new();
        let mut last = vec![0.0; n * n];
        for k in 1..=n {
            let mut next = product(a, &last, n);
            (0..n).for_each(|i| next[i * n + i] += coefficients[n - k + 1]);
            let am = product(a, &next, n);
            coefficients[n - k] = -(0..n).map(|i| am[i * n + i]).sum::<f64>() / k as f64;
            adjugate.push(next.clone());
            last = next;
        }
        let entry = |o: usize, i: usize| -> Vec<f64> {
            let mut num: Vec<f64> = coefficients.iter().map(|v| v * d[o * m + i]).collect();
            for (k, matrix) in adjugate.iter().enumerate() {
                let mut sum = 0.0;
                for r in 0..n {
                    for s in 0..n {
                        sum += c[o * n + r] * matrix[r * n + s] * b[s * m + i];
                    }
                }
                num[n - 1 - k] += sum;
            }
            num
        };
        // Powers of z become powers of z^-1 by turning both polynomials round.
        let turned = |c: Vec<f64>| match time {
            Time::Continuous => c,
            Time::Sampled { .. } => c.into_iter().rev().collect(),
        };
        let den = turned(coefficients.clone());
        let channel =
            |k: usize| Transfer { num: turned(entry(k / m, k % m)), den: den.clone(), delay_s: 0.0 };
        Ok(Self::new(time, p, m, (0..p * m).map(channel).collect())?.with_poles(&den))
    }

    /// Product of the polynomials of the poles at s or q.
    pub fn poles_at(&self, x: C) -> C {
        self.poles.iter().map(|p| value(p, x)).product()
    }

    /// Number of poles.
    pub fn states(&self) -> usize {
        self.poles.iter().map(|p| degree(p)).sum()
    }

    /// Frequency response at an angular frequency in rad/s.
    pub fn at(&self, w_rad_s: f64) -> Matrix {
        let data = self.channels.iter().map(|g| g.at(self.time, w_rad_s)).collect();
        Matrix { rows: self.outputs, cols: self.inputs, data }
    }

    /// Channel from an input to an output.
    pub fn channel(&self, output: usize, input: usize) -> &Transfer {
        &self.channels[output * self.inputs + input]
    }

    /// Longest delay in s.
    pub fn delay_s(&self) -> f64 {
        self.channels.iter().map(|g| g.delay_s).fold(0.0, f64::max)
    }

    /// The same behind a matrix of gains, `G M` (row-major, inputs by inputs): a static decoupler, a map about its set point.
    ///
    /// # Errors
    /// [`ControlError::Shape`]: another size, or channels of one output that differ in denominator or delay.
    pub fn mixed(&self, gains: &[f64]) -> Result<Self, ControlError> {
        let m = self.inputs;
        if gains.len() != m * m {
            return Err(ControlError::shape("gains before the plant", gains.len(), m * m));
        }
        let mut channels = Vec::with_capacity(self.channels.len());
        for row in self.channels.chunks(m) {
            let used: Vec<&Transfer> = row.iter().filter(|g| !g.is_zero()).collect();
            let first = used.first().copied().unwrap_or(&row[0]);
            if used.iter().any(|g| g.den != first.den || g.delay_s != first.delay_s) {
                let expected = "one denominator and one delay for each output";
                return Err(ControlError::shape(
                    "channels before which gains are mixed",
                    "several",
                    expected,
                ));
            }
            for j in 0..m {
                let own = |i: usize| row[i].num.iter().map(|v| v * gains[i * m + j]).collect::<Vec<f64>>();
                let num = (0..m).fold(vec![0.0], |sum, i| add(&sum, &own(i)));
                channels.push(Transfer { num, den: first.den.clone(), delay_s: first.delay_s });
            }
        }
        let mut out = Self::new(self.time, self.outputs, m, channels)?;
        out.poles.clone_from(&self.poles);
        Ok(out)
    }

    /// The same with output `k` multiplied by a transfer function.
    pub fn after(&self, own: &[Transfer]) -> Result<Self, ControlError> {
        let channels =
            self.channels.iter().enumerate().map(|(k, g)| g.times(&own[k / self.inputs])).collect();
        let mut out = Self::new(self.time, self.outputs, self.inputs, channels)?;
        out.poles = self.poles.iter().cloned().chain(own.iter().map(|g| g.den.clone())).collect();
        Ok(out)
    }

    /// The same with input `k` multiplied by a transfer function.
    pub fn before(&self, own: &[Transfer]) -> Result<Self, ControlError> {
        let channels =
            self.channels.iter().enumerate().map(|(k, g)| g.times(&own[k % self.inputs])).collect();
        let mut out = Self::new(self.time, self.outputs, self.inputs, channels)?;
        out.poles = self.poles.iter().cloned().chain(own.iter().map(|g| g.den.clone())).collect();
        Ok(out)
    }
}

fn product(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    let mut out = vec![0.0; n * n];
    for i in 0..n {
        for k in 0..n {
            for j in 0..n {
                out[i * n + j] += a[i * n + k] * b[k * n + j];
            }
        }
    }
    out
}
