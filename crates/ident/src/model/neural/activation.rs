//! Activation functions of the neurons.

use serde::{Deserialize, Serialize};

/// What a neuron makes of its weighted sum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Activation {
    /// tanh x, between -1 and 1.
    #[default]
    Tanh,
    /// 1 / (1 + exp(-x)), between 0 and 1.
    Sigmoid,
    /// max(x, 0). Its kink has no derivative; the slope there is taken as zero.
    Relu,
    /// log(1 + exp x), a relu without the kink.
    Softplus,
}

impl Activation {
    /// Value and slope at `x`.
    pub(super) fn value_slope(self, x: f64) -> (f64, f64) {
        match self {
            Self::Tanh => {
                // Exact to rounding of one, which is what a sum over neurons needs, in a third of the library's time.
                let e = (-2.0 * x.abs()).exp();
                let a = ((1.0 - e) / (1.0 + e)).copysign(x);
                (a, 1.0 - a * a)
            }
            Self::Sigmoid => {
                let a = sigmoid(x);
                (a, a * (1.0 - a))
            }
            Self::Relu => (x.max(0.0), if x > 0.0 { 1.0 } else { 0.0 }),
            // log(1 + e^x) = max(x, 0) + log(1 + e^-|x|), which cannot overflow.
            Self::Softplus => (x.max(0.0) + (-x.abs()).exp().ln_1p(), sigmoid(x)),
        }
    }

    /// Second derivative, from value and slope.
    pub(super) fn curvature(self, value: f64, slope: f64) -> f64 {
        match self {
            Self::Tanh => -2.0 * value * slope,
            Self::Sigmoid => slope * (1.0 - 2.0 * value),
            Self::Relu => 0.0,
            Self::Softplus => slope * (1.0 - slope),
        }
    }

    /// Whether the values stay within limits, and with them every free run of a network without direct path.
    pub fn is_bounded(self) -> bool {
        matches!(self, Self::Tanh | Self::Sigmoid)
    }
}

fn sigmoid(x: f64) -> f64 {
    let e = (-x.abs()).exp();
    if x >= 0.0 { 1.0 / (1.0 + e) } else { e / (1.0 + e) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_and_curvatures_agree_with_central_differences() {
        let h = 1e-5;
        for kind in [Activation::Tanh, Activation::Sigmoid, Activation::Relu, Activation::Softplus] {
            for x in [-3.0, -0.7, 0.2, 1.9] {
                let (value, slope) = kind.value_slope(x);
                let (up, down) = (kind.value_slope(x + h), kind.value_slope(x - h));
                assert!((slope - (up.0 - down.0) / (2.0 * h)).abs() < 1e-9, "{kind:?} slope at {x}");
                let curvature = kind.curvature(value, slope);
                assert!((curvature - (up.1 - down.1) / (2.0 * h)).abs() < 1e-9, "{kind:?} curvature at {x}");
            }
        }
    }

    #[test]
    fn tanh_is_that_of_the_library_to_rounding() {
        for i in -4000..=4000 {
            let x = f64::from(i) * 0.00511;
            assert!((Activation::Tanh.value_slope(x).0 - x.tanh()).abs() < 3e-16, "{x}");
        }
    }

    #[test]
    fn far_arguments_stay_finite() {
        for kind in [Activation::Tanh, Activation::Sigmoid, Activation::Softplus] {
            for x in [-1e6, 1e6] {
                let (value, slope) = kind.value_slope(x);
                assert!(
                    value.is_finite() && (0.0..=1.0).contains(&slope),
                    "{kind:?} at {x}: {value}, {slope}"
                );
            }
        }
        assert_eq!(Activation::Softplus.value_slope(1e6).0, 1e6);
    }
}
