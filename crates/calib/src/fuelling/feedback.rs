//! The lambda loop of a production ECU, for any way of fuelling.

use super::Timing;
use super::policy::Sensed;
use serde::{Deserialize, Serialize};

/// Most of the integral of the feedback.
const MOST_TRIM: f64 = 0.25;

/// Lambda feedback, proportional and integral by internal model control of a lag (that of mixing and sensor) behind a delay (D. E. Rivera,
/// M. Morari, S. Skogestad, Ind. Eng. Chem. Process Des. Dev. 25, 1986).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Feedback {
    /// What the sensor shows late.
    pub timing: Timing,
    /// Time constant of the closed loop in s.
    pub closed_s: f64,
}

/// What the loop remembers.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FeedbackState {
    integral: f64,
}

impl FeedbackState {
    /// What the fuel is multiplied by at a demanded lambda and a flow of air; it stays where it is while the
    /// sensor shows nothing.
    pub(super) fn factor(
        &mut self,
        by: Option<Feedback>,
        y: &Sensed,
        (lambda, flow): (f64, f64),
        dt_s: f64,
    ) -> f64 {
        let (Some(Feedback { timing, closed_s }), Some(shown)) = (by, y.lambda) else {
            return 1.0 + self.integral;
        };
        let error = shown / lambda - 1.0;
        let per_s = 1.0 / (closed_s + timing.delay_s(y.speed_rpm, flow));
        self.integral = (self.integral + per_s * error * dt_s).clamp(-MOST_TRIM, MOST_TRIM);
        1.0 + self.integral + per_s * timing.lag_s(flow) * error
    }
}
