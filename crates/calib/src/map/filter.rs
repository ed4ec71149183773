//! The filter of a demand: first-order lags in a row, so that what is asked for is a response that the plant can give.

/// First-order lag, exact for a held input: `x+ = x + (1 - exp(-dt/tau)) (u - x)`.
#[derive(Clone, Copy, Debug)]
pub struct FirstOrder {
    state: f64,
}

impl FirstOrder {
    /// Lag at rest at `start`.
    pub fn new(start: f64) -> Self {
        Self { state: start }
    }

    /// Output after `u` is held for `dt_s`; `tau_s` may change from call to call.
    pub fn step(&mut self, u: f64, dt_s: f64, tau_s: f64) -> f64 {
        let gain = if tau_s > 0.0 { 1.0 - (-dt_s / tau_s).exp() } else { 1.0 };
        self.state += gain * (u - self.state);
        self.state
    }
}

/// A demand through lags with the time constants `tau_s` in a row, at rest at its first value; no lag: the demand.
pub fn filtered(demand: &[f64], tau_s: &[f64], sample_time_s: f64) -> Vec<f64> {
    let Some(&start) = demand.first() else { return Vec::new() };
    let mut lags: Vec<(FirstOrder, f64)> = tau_s.iter().map(|tau| (FirstOrder::new(start), *tau)).collect();
    demand
        .iter()
        .map(|&d| lags.iter_mut().fold(d, |x, (lag, tau)| lag.step(x, sample_time_s, *tau)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_order_lag_has_the_exact_step_response() {
        let mut lag = FirstOrder::new(0.0);
        let mut y = 0.0;
        for _ in 0..10 {
            y = lag.step(1.0, 0.03, 0.12);
        }
        let exact = 1.0 - (-0.3f64 / 0.12).exp();
        assert!((y - exact).abs() < 1e-14);
    }

    #[test]
    fn a_filtered_demand_has_unit_gain_and_no_overshoot() {
        let step: Vec<f64> = (0..400).map(|t| if t < 10 { 30.0 } else { 70.0 }).collect();
        let y = filtered(&step, &[0.12, 0.15], 0.03);
        assert_eq!(y[9], 30.0);
        assert!((y[399] - 70.0).abs() < 1e-9);
        assert!(y.windows(2).all(|w| w[1] >= w[0]));
        assert_eq!(filtered(&step, &[], 0.03), step);
    }
}
