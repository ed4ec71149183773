//! What watches a plan of a station: limits on the way, and rest at its end.

use dynocal_ident::plan::Plan;
use dynocal_ident::plant::LimitEvent;
use dynocal_ident::play::{Course, PlayError, Reason, Stop, Watchdog};

use super::{Guard, RESOLUTION};

/// Batches of a window, and quantile 0.975 of Student's t for the difference of two windows (8 degrees of freedom) and 0.99 for
/// the mean of one (4 degrees of freedom).
const BATCHES: usize = 5;
const DOUBT: f64 = 2.306;
const NEAR: f64 = 3.747;
/// Share of its range within which an input stands at an end.
const AT_END: f64 = 0.005;

/// Mean of a window, and its variance from the means of batches: samples of a bed are not independent (lags of sensors, loops),
/// those of batches nearly are.
struct Batches {
    mean: f64,
    variance_of_mean: f64,
}

impl Batches {
    fn of(values: &[f64]) -> Self {
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        let size = values.len().div_ceil(BATCHES).max(1);
        let means: Vec<f64> = values.chunks(size).map(|b| b.iter().sum::<f64>() / b.len() as f64).collect();
        let n = means.len() as f64;
        let squares: f64 = means.iter().map(|m| (m - mean).powi(2)).sum();
        Self { mean, variance_of_mean: squares / (n - 1.0).max(1.0) / n }
    }
}

/// Watches limits on the way and ends the plan when everything rests.
pub(super) struct Watching<'a> {
    guards: &'a [Guard],
    tolerances: &'a [(f64, f64)],
    plan: &'a Plan,
    /// Columns of guards and demands, and of the inputs that loops drive.
    places: Vec<usize>,
    demands: Vec<usize>,
    driven: Vec<usize>,
    window: usize,
    ramp: usize,
    pub(super) watched_from: usize,
    more: usize,
    pub(super) left: Option<usize>,
    pub(super) saturated: Vec<bool>,
    /// Outputs that did not rest when it was tested last.
    pub(super) restless: Vec<String>,
}

impl<'a> Watching<'a> {
    /// A watch over `plan` whose way takes `ramp` samples, and whose average takes `more`; limits are watched from the first window on.
    pub(super) fn new(
        (guards, tolerances): (&'a [Guard], &'a [(f64, f64)]),
        plan: &'a Plan,
        ramp: usize,
        window: usize,
        more: usize,
    ) -> Self {
        Self {
            guards,
            tolerances,
            plan,
            places: Vec::new(),
            demands: Vec::new(),
            driven: Vec::new(),
            window,
            ramp,
            watched_from: window,
            more,
            left: None,
            saturated: vec![false; plan.loops.len()],
            restless: Vec::new(),
        }
    }
}

impl Watching<'_> {
    /// The last window of an output and the one before.
    fn windows(&self, course: &Course, place: usize) -> (Batches, Batches) {
        let n = course.rows();
        let of = |end: usize| {
            let values: Vec<f64> = (end + 1 - self.window..=end).map(|t| course.output(t)[place]).collect();
            Batches::of(&values)
        };
        (of(n - self.window), of(n))
    }

    fn still(before: &Batches, now: &Batches, resolution: f64) -> bool {
        let doubt = DOUBT * (before.variance_of_mean + now.variance_of_mean).sqrt();
        (now.mean - before.mean).abs() <= resolution.max(doubt)
    }

    fn at_rest(&mut self, course: &Course) -> bool {
        self.restless.clear();
        for (k, place) in self.demands.iter().enumerate() {
            let (before, now) = self.windows(course, *place);
            let (resolution, _) = self.tolerances[k];
            let near = (2.0 * resolution).max(NEAR * now.variance_of_mean.sqrt());
            let demand = self.plan.demands[k].values.last().copied().unwrap_or(f64::NAN);
            self.saturated[k] = self.stands_at_an_end(course, k);
            let there = (now.mean - demand).abs() <= near || self.saturated[k];
            if !(there && Self::still(&before, &now, resolution)) {
                self.restless.push(self.plan.demands[k].output.clone());
            }
        }
        for (g, place) in self.guards.iter().zip(&self.places) {
            let (before, now) = self.windows(course, *place);
            // Without a limit its own size says what counts as none.
            let resolution = if g.resolution > 0.0 { g.resolution } else { RESOLUTION * now.mean.abs() };
            if !Self::still(&before, &now, resolution) {
                self.restless.push(g.output.clone());
            }
        }
        self.restless.is_empty()
    }

    /// Whether the input of the loop of demand `k` was at an end of its range all through the last window, or as near to it in the mean as a controller comes that is pushed off
    /// and on by the noise of its output.
    fn stands_at_an_end(&self, course: &Course, k: usize) -> bool {
        let (place, n) = (self.driven[k], course.rows());
        let c = &self.plan.channels[place];
        // Where an end is infinite there is none to stand at.
        let near = Some(AT_END * (c.upper - c.lower)).filter(|n| n.is_finite()).unwrap_or(0.0);
        let all = (n - self.window..n).map(|t| course.input(t)[place].max(c.lower).min(c.upper));
        let mean = all.sum::<f64>() / self.window as f64;
        mean <= c.lower + near || mean >= c.upper - near
    }
}

impl Watchdog for Watching<'_> {
    fn prepare(&mut self, plan: &Plan, course: &Course) -> Result<usize, PlayError> {
        let place = |output: &str| {
            course.outputs.iter().position(|o| o == output).ok_or_else(|| PlayError::Model {
                output: output.into(),
                reason: format!("there is no such output; outputs are: {}", course.outputs.join(", ")),
            })
        };
        self.places = self.guards.iter().map(|g| place(&g.output)).collect::<Result<_, _>>()?;
        self.demands = plan.demands.iter().map(|d| place(&d.output)).collect::<Result<_, _>>()?;
        let driver = |output: &str| {
            let l = plan.loops.iter().find(|l| l.output == output)?;
            plan.channels.iter().position(|c| c.name == l.input)
        };
        self.driven = plan.demands.iter().map(|d| driver(&d.output).unwrap_or(0)).collect();
        Ok(0)
    }

    fn after(&mut self, course: &Course, _events: &[LimitEvent]) -> Option<Stop> {
        let t = course.rows() - course.before;
        if t >= self.watched_from {
            for (g, place) in self.guards.iter().zip(&self.places) {
                let mean = self.windows_now(course, *place);
                if !(g.lower..=g.upper).contains(&mean) {
                    let limit = if mean < g.lower { g.lower } else { g.upper };
                    return Some(Stop::new(&g.output, Reason::Measured { value: mean, limit }));
                }
            }
        }
        let since = t.saturating_sub(self.ramp);
        // Windows do not overlap: the test is made once in each.
        let tested = since >= 2 * self.window && since.is_multiple_of(self.window);
        self.left = match self.left {
            Some(left) => Some(left.saturating_sub(1)),
            None => (tested && self.at_rest(course)).then_some(self.more),
        };
        (self.left == Some(0)).then(|| Stop::new("", Reason::Still))
    }
}

impl Watching<'_> {
    /// Mean of an output over the last window.
    fn windows_now(&self, course: &Course, place: usize) -> f64 {
        let n = course.rows();
        let from = n + 1 - self.window.min(n);
        (from..=n).map(|t| course.output(t)[place]).sum::<f64>() / (n + 1 - from) as f64
    }
}
