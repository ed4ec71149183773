//! The filter: pairs (violation, barrier value) that a trial point must not be dominated by.
//!
//! Constants and rules: Waechter and Biegler, Mathematical Programming 106 (2006), 25-57, sections 2.3 and 3.

/// Margins of sufficient decrease.
pub(super) const GAMMA_THETA: f64 = 1e-5;
pub(super) const GAMMA_PHI: f64 = 1e-8;
/// Switching condition: `alpha (-dphi)^S_PHI > theta^S_THETA`.
const S_PHI: f64 = 2.3;
const S_THETA: f64 = 1.1;
/// Armijo constant.
const ETA_PHI: f64 = 1e-8;
const GAMMA_ALPHA: f64 = 0.05;

/// How a trial was accepted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Accepted {
    /// By the Armijo condition on the barrier function: the filter stays as it is.
    Descent,
    /// By sufficient decrease of either measure: the filter grows.
    Either,
}

/// Violation, barrier value and slope of the barrier function along the step at the current point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Here {
    pub(super) theta: f64,
    pub(super) phi: f64,
    pub(super) slope: f64,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Filter {
    entries: Vec<(f64, f64)>,
    theta_max: f64,
    theta_min: f64,
}

impl Filter {
    pub(super) fn new(theta0: f64) -> Self {
        Self { entries: Vec::new(), theta_max: 1e4 * theta0.max(1.0), theta_min: 1e-4 * theta0.max(1.0) }
    }

    pub(super) fn clear(&mut self) {
        self.entries.clear();
    }

    /// Whether (theta, phi) is outside of the forbidden region.
    pub(super) fn allows(&self, theta: f64, phi: f64) -> bool {
        theta <= self.theta_max && self.entries.iter().all(|&(t, p)| theta < t || less(phi, p, p))
    }

    /// Forbids what is not sufficiently better than (theta, phi).
    pub(super) fn add(&mut self, theta: f64, phi: f64) {
        let entry = ((1.0 - GAMMA_THETA) * theta, phi - GAMMA_PHI * theta);
        self.entries.retain(|&(t, p)| t < entry.0 || p < entry.1);
        self.entries.push(entry);
    }

    fn switching(&self, here: &Here, alpha: f64) -> bool {
        here.theta <= self.theta_min
            && here.slope < 0.0
            && alpha * (-here.slope).powf(S_PHI) > here.theta.powf(S_THETA)
    }

    /// Tests a trial at step length `alpha`.
    pub(super) fn test(&self, here: &Here, alpha: f64, theta: f64, phi: f64) -> Option<Accepted> {
        if !(theta.is_finite() && phi.is_finite() && self.allows(theta, phi)) {
            return None;
        }
        let armijo = less(phi - here.phi, ETA_PHI * alpha * here.slope, here.phi);
        if self.switching(here, alpha) {
            return armijo.then_some(Accepted::Descent);
        }
        let better = theta <= (1.0 - GAMMA_THETA) * here.theta
            || less(phi - here.phi, -GAMMA_PHI * here.theta, here.phi);
        better.then_some(Accepted::Either)
    }

    /// Step length below which the search gives up and restores feasibility (eq. 23 of the paper).
    pub(super) fn least_step(&self, here: &Here) -> f64 {
        let mut least = GAMMA_THETA;
        if here.slope < 0.0 {
            least = least.min(GAMMA_PHI * here.theta / -here.slope);
            if here.theta <= self.theta_min {
                least = least.min(here.theta.powf(S_THETA) / (-here.slope).powf(S_PHI));
            }
        }
        GAMMA_ALPHA * least
    }
}

/// `a <= b` up to the rounding of a quantity of size `scale`.
fn less(a: f64, b: f64, scale: f64) -> bool {
    a - b <= 10.0 * f64::EPSILON * scale.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dominated_point_is_refused_and_a_better_one_taken() {
        let mut filter = Filter::new(1.0);
        filter.add(1.0, 10.0);
        assert!(!filter.allows(1.0, 10.0));
        assert!(!filter.allows(2.0, 11.0));
        assert!(filter.allows(0.5, 20.0));
        assert!(filter.allows(2.0, 5.0));
        assert!(!filter.allows(1e5, -1e9), "beyond the largest violation");
    }

    #[test]
    fn near_feasibility_descent_of_the_barrier_function_is_required() {
        let filter = Filter::new(1.0);
        let here = Here { theta: 1e-9, phi: 1.0, slope: -1.0 };
        assert_eq!(filter.test(&here, 1.0, 0.0, 1.5), None);
        assert_eq!(filter.test(&here, 1.0, 1e-8, 0.5), Some(Accepted::Descent));
        let far = Here { theta: 0.9, phi: 1.0, slope: -1e-3 };
        assert_eq!(filter.test(&far, 1.0, 0.1, 1.5), Some(Accepted::Either));
    }
}
