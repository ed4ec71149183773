//! Gains of the loops that go with what their inputs do.
//!
//! ```text
//! g(x) = |du/dy|(x) / median of it over the cells that hold an optimum, 1 at least
//! ```
//!
//! Gains are taken to suit most of the map. Where a demand hardly answers its input (a throttle that is nearly open) the same gains make its loop so
//! much slower: points do not come to rest, and lines lag behind all the way back from there. What the maps of the inputs know of their slopes makes it
//! as fast as in most cells. Where an input does more than in most of them the gains stay what they are: no loop is made faster than it is somewhere
//! already. What loops do to each other is not looked at: it goes with the slope of the input, as the loop does itself.

use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::grid::{Cell, CellState};
use dynocal_calib::steady::layout::Layout;

use super::drive::Drive;
use super::error::MapError;

/// Largest factor: scatter of the demand moves the input by as much more, and a map that errs is steep somewhere.
const MOST: f64 = 8.0;
/// Share of itself, or of its range, by which a demand is moved to see what its input does.
const SHARE: f64 = 0.01;
/// Least slope of an input over its demand, both as shares: what flows goes with at most the square of an opening.
const STEEP: f64 = 0.5;

/// Slopes of the inputs in most cells.
pub(super) struct Schedule {
    /// Median of |du/dy| over the cells, by loop; none where the demand is no factor or the slope is not known.
    typical: Vec<Option<f64>>,
}

impl Schedule {
    /// From the cells that hold an optimum.
    ///
    /// # Errors
    /// As of [`Drive::say`].
    pub(super) fn of(
        layout: &Layout,
        setting: &Setting,
        drives: &[Drive],
        cells: &[Cell],
    ) -> Result<Self, MapError> {
        let at: Vec<Vec<f64>> =
            cells.iter().filter(|c| c.state == CellState::Optimal).map(|c| c.optimum.x.clone()).collect();
        let one = |(l, d): (usize, &Drive)| {
            let mut all = steepness(layout, setting, (l, d), &at)?;
            all.retain(|s| s.is_finite() && *s > 0.0);
            all.sort_by(f64::total_cmp);
            Ok(all.get(all.len() / 2).copied())
        };
        let typical = drives.iter().enumerate().map(one).collect::<Result<_, MapError>>()?;
        Ok(Self { typical })
    }

    /// Factors of the gains at some settings: of each loop at each of them; nothing where none is raised.
    ///
    /// # Errors
    /// As of [`Drive::say`].
    pub(super) fn at(
        &self,
        layout: &Layout,
        setting: &Setting,
        drives: &[Drive],
        at: &[Vec<f64>],
    ) -> Result<Vec<Vec<f64>>, MapError> {
        let one = |((l, d), typical): ((usize, &Drive), &Option<f64>)| {
            let Some(typical) = typical else { return Ok(vec![1.0; at.len()]) };
            let factor = |s: f64| if s.is_finite() { (s / typical).clamp(1.0, MOST) } else { 1.0 };
            Ok(steepness(layout, setting, (l, d), at)?.into_iter().map(factor).collect())
        };
        let all: Vec<Vec<f64>> =
            drives.iter().enumerate().zip(&self.typical).map(one).collect::<Result<_, MapError>>()?;
        let raised = all.iter().flatten().any(|g| *g != 1.0);
        Ok(if raised { all } else { Vec::new() })
    }
}

/// |du/dy| of the input of loop `l` over its demand, by central differences; nothing where that is no factor, or where the map is not relative.
fn steepness(
    layout: &Layout,
    setting: &Setting,
    (l, drive): (usize, &Drive),
    at: &[Vec<f64>],
) -> Result<Vec<f64>, MapError> {
    let Some(k) = layout.demand_factor(l).filter(|_| drive.relative) else { return Ok(Vec::new()) };
    let f = &layout.factors[k];
    let step = SHARE * (f.upper - f.lower);
    let say = |by: f64| {
        let mut moved = at.to_vec();
        moved.iter_mut().for_each(|x| x[k] += by);
        drive.say(layout, setting, &moved)
    };
    Ok(say(step)?.iter().zip(&say(-step)?).map(|(more, less)| ((more - less) / (2.0 * step)).abs()).collect())
}

/// What a share of its demand is in shares of the input of loop `l`, d log u / d log y, as the map says: an error of the input counts by what it
/// does to what the input has to hold. A throttle that is nearly open may be anywhere. 1 where the demand is no factor, or where the map is
/// not relative.
///
/// # Errors
/// As of [`Drive::at`].
pub(super) fn slopes(
    layout: &Layout,
    setting: &Setting,
    l: usize,
    drive: &Drive,
    factors: &[Vec<f64>],
) -> Result<Vec<f64>, MapError> {
    let place = layout.demand_factor(l);
    let Some(k) = place.filter(|_| drive.relative) else { return Ok(vec![1.0; factors.len()]) };
    let say = |share: f64| {
        let mut moved = factors.to_vec();
        moved.iter_mut().for_each(|x| x[k] *= 1.0 + share);
        drive.say(layout, setting, &moved)
    };
    let span = (1.0 + SHARE).ln() - (1.0 - SHARE).ln();
    let slopes: Vec<f64> =
        say(SHARE)?.iter().zip(&say(-SHARE)?).map(|(more, less)| (more.ln() - less.ln()) / span).collect();
    // An input goes one way with its demand: where a model is flat, its slope has that of most.
    let way = slopes.iter().filter(|s| s.is_finite()).map(|s| s.signum()).sum::<f64>();
    let one = |s: &f64| if s.is_finite() { s.abs().max(STEEP).copysign(way) } else { 1.0 };
    Ok(slopes.iter().map(one).collect())
}

#[cfg(test)]
mod tests {
    use super::super::drive;
    use super::super::spec::MapSpec;
    use super::*;
    use dynocal_calib::problem::CalibrationProblem;
    use dynocal_calib::steady::day::{DayPoint, Purpose};
    use dynocal_calib::steady::layout::{Factor, FactorKind, ResponseChannel, ResponseSource};
    use dynocal_calib::steady::station::SteadyPoint;
    use dynocal_ident::model::response::{Ask, Prediction, Response};
    use dynocal_ident::pi::PiGains;
    use dynocal_ident::plan::PlanLoop;
    use dynocal_numerics::interval::Interval;
    use dynocal_numerics::status::Status;
    use dynocal_numerics::watch::Watch;

    /// A response of which nothing is asked here.
    struct Nothing;

    impl Response for Nothing {
        fn dim(&self) -> usize {
            1
        }
        fn predict(&self, _: &[f64], _: Ask, out: &mut Prediction) {
            out.mean = 0.0;
        }
        fn describe(&self) -> String {
            String::new()
        }
    }

    /// u = 2 exp(y / 30): du/dy goes with u.
    #[test]
    fn gains_are_raised_where_the_demand_hardly_answers() {
        let problem = CalibrationProblem::thesis();
        let (input, demand) = (problem.inputs[0].clone(), problem.demands[0].clone());
        let factor =
            |name: &str, kind| Factor { name: name.into(), unit: "Nm".into(), lower: 5.0, upper: 92.0, kind };
        let response = ResponseChannel {
            name: input.name.clone(),
            unit: input.unit.clone(),
            source: ResponseSource::Driven(0),
            lower: None,
            upper: None,
            weight: 0.0,
            slow: false,
        };
        let mut layout = Layout {
            loops: vec![PlanLoop::closed(&demand.output, &input.name, PiGains { ki: 1.0, kp: 1.0 })],
            factors: vec![factor(&demand.output, FactorKind::Demand(0))],
            axes: 1,
            held: std::collections::BTreeMap::new(),
            responses: vec![response],
            sample_time_s: 0.1,
            problem,
        };
        let point = |y: f64| DayPoint {
            purpose: Purpose::Plan,
            point: SteadyPoint {
                asked: vec![y],
                factors: vec![y],
                responses: vec![2.0 * (y / 30.0).exp()],
                errors: vec![0.0],
                usable: true,
                note: String::new(),
                touched: Vec::new(),
                saturated: Vec::new(),
                at_s: 0.0,
                used_s: 0.0,
            },
        };
        let points: Vec<DayPoint> = (0..60).map(|k| point(5.0 + 1.5 * f64::from(k))).collect();
        let spec = MapSpec::default();
        let watch = Watch::silent();
        let drives: Vec<_> =
            drive::learn(&layout, &points, &spec, watch).unwrap().into_iter().flatten().collect();
        let setting = Setting {
            models: vec![&Nothing],
            weights: vec![0.0],
            sides: Vec::new(),
            z: 0.0,
            caution: 0.0,
            ranges: vec![Interval::new(5.0, 92.0)],
            axes: 1,
        };
        let cell = |y: f64| {
            let optimum = setting.judge(&[y], Status::Converged, None);
            Cell { at: vec![y], state: CellState::Optimal, best: optimum.objective, optimum }
        };
        let cells: Vec<Cell> = [10.0, 20.0, 30.0, 50.0, 70.0, 80.0, 90.0].map(cell).into();
        let schedule = Schedule::of(&layout, &setting, &drives, &cells).unwrap();
        let at = [10.0, 50.0, 75.0, 90.0].map(|y| vec![y]);
        let found = schedule.at(&layout, &setting, &drives, &at).unwrap();
        for (g, expected) in found[0].iter().zip([1.0, 1.0, (25.0f64 / 30.0).exp(), (40.0f64 / 30.0).exp()]) {
            assert!((g / expected - 1.0).abs() < 0.1, "{found:?}");
        }
        // Where none is raised, and where the demand is held, nothing is scheduled.
        assert!(schedule.at(&layout, &setting, &drives, &at[..1]).unwrap().is_empty());
        layout.factors[0].kind = FactorKind::Given(0);
        assert!(schedule.at(&layout, &setting, &drives, &at).unwrap().is_empty());
        let none = Schedule::of(&layout, &setting, &drives, &cells).unwrap();
        assert!(none.at(&layout, &setting, &drives, &at).unwrap().is_empty());
    }
}
