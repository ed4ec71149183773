//! Maps of the inputs that loops drive.
//!
//! While points are measured the loops hold the demands, so that an input that a loop drives is a response. In its map it has to hold
//! the demand alone, and what counts there is its relative error: a throttle of 8 deg that is 1 deg off is another load, one of 50 deg
//! is not.
//!
//! ```text
//! log u = g(log q_1, .., log q_m)    q: the factors, or the channels that the spec names (`models.over`)
//! ```
//!
//! A channel that is not positive everywhere stands as it is. Points at which the loop stood at an end of its range are left out: what was
//! reached there does not depend on the input any more. Channels that are responses are taken as measured to learn from, and as their
//! models expect them in the cells: `g` may then have fewer inputs than there are factors (the angle of a throttle follows from the
//! mass that flows, the pressures on either side, and nothing else).
//!
//! What lines along the maps show ([`super::sweep`]) moves the demand at which the model is asked, and not its input: behind a throttle that is
//! nearly open the same share of torque is a tenth of the opening or all of it.

use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::day::{DayPoint, Purpose};
use dynocal_calib::steady::grid::{Cell, CellState};
use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::station::SteadyPoint;
use dynocal_calib::steady::trim::{Trim, Way};
use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::model::response::{Ask, Points, Prediction, Response, ResponseModel};
use dynocal_numerics::watch::Watch;
use serde::Serialize;

use super::budget::fewest;
use super::choose::{Chosen, choose};
use super::error::MapError;
use super::learn::kinds;
use super::shown::{Shown, by_cell};
use super::spec::{Errors, MapSpec};

/// The map of an input that a loop drives, as a model of it.
#[derive(Clone, Debug, Serialize)]
pub struct Drive {
    /// Input.
    pub input: String,
    /// Unit.
    pub unit: String,
    /// Channels that it follows from.
    pub over: Vec<String>,
    /// How it was chosen.
    pub choice: String,
    /// Points that it was learnt from.
    pub points: usize,
    /// RMS error on points that had no part in learning and choosing: as a share of the input where [`Drive::relative`], else in its unit.
    pub error: f64,
    /// Whether it is the logarithm that was learnt.
    pub relative: bool,
    /// Standard deviation over the points of what was learnt: of the input, or of its logarithm.
    pub spread: f64,
    /// Factor by which its standard deviations are widened, so that held-out points lie in their intervals.
    pub widen: f64,
    /// What sweeps along the maps changed; none where there were none.
    pub trimmed: Option<Trimmed>,
    /// RMS of what the verification took there less what the map says, by what it does to the demand: as a share of it where
    /// [`Drive::relative`]; none before there is one.
    pub verified: Option<f64>,
    /// Which channels are learnt over by their logarithms.
    logs: Vec<bool>,
    /// The model.
    #[serde(skip)]
    model: ResponseModel,
}

/// A map that was trimmed by what was measured along it ([`super::sweep`]); shares where the map is relative, else in the unit of the input.
#[derive(Clone, Debug, Serialize)]
pub struct Trimmed {
    /// RMS of what the input in the map missed along the lines before.
    pub before: f64,
    /// Scatter of the input in a window about the trimmed map and the lag of its way: what the map does not follow, and noise.
    pub scatter: f64,
    /// Standard deviation of the input about the trimmed map: the scatter, and between the lines what a line differs from those beside it (`between`, by the median slope of the
    /// map over its demand).
    pub deviation: f64,
    /// The scatter by what it does to the demand: as a share of it where the map is relative.
    pub held: f64,
    /// RMS of what a line differs from what the lines beside it say of it, counted as [`Trimmed::held`]; none with fewer than three lines.
    pub between: Option<f64>,
    /// Share by which the demand was above what the trimmed map says for its input, the lag of the way taken out, in the mean of the windows next to each cell, the
    /// last axis fastest; none where no window counts. It is what smoothing leaves of the lines that the map was trimmed by. Empty where the trim is no share of a
    /// demand. By the slope of the map: much too large where the demand hardly answers.
    pub cells: Vec<Option<f64>>,
    #[serde(skip)]
    trim: Trim,
    /// The factor of the demand, where the trim is a share of it; else it adds to what is learnt.
    #[serde(skip)]
    pub(super) demand: Option<usize>,
}

/// What a loop set in a window along the maps.
pub(super) struct Set<'a> {
    /// Axes, and the way along the first of them.
    pub(super) at: &'a [f64],
    pub(super) way: Way,
    /// The input, and what its map says there before and after it was trimmed.
    pub(super) input: f64,
    pub(super) said: [f64; 2],
    /// d log u / d log y of the trimmed map.
    pub(super) slope: f64,
    /// Weight of its error in the demand.
    pub(super) weight: f64,
}

/// A value with the half width of one standard deviation of a measurement about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Driven {
    /// Value in the unit of the input; not a number where a channel has no logarithm.
    pub value: f64,
    /// Standard deviation of a measurement about it.
    pub deviation: f64,
}

/// Models of all inputs that loops drive, in the order of the loops: over each set of channels, that with the least error on points first.
///
/// # Errors
/// [`MapError`] where no candidate can be learnt.
pub(super) fn learn(
    layout: &Layout,
    points: &[DayPoint],
    spec: &MapSpec,
    watch: Watch,
) -> Result<Vec<Vec<Drive>>, MapError> {
    let one = |(l, k): (usize, usize)| {
        if watch.interrupted() {
            return Err(MapError::Interrupted);
        }
        let input = &layout.problem.inputs[k];
        watch.note(&format!("map of {}", input.name));
        let used = roomy(points, &input.name, fewest(spec));
        let columns = channels(layout, &used);
        let y: Vec<f64> = used.iter().map(|p| p.responses[l]).collect();
        let mut sets = vec![layout.factor_names()];
        sets.extend(spec.models.over.get(&input.name).cloned());
        let (mut all, mut why): (Vec<Drive>, MapError) = (Vec::new(), MapError::Interrupted);
        for over in sets {
            match drive(layout, &columns, over, &y, (&input.name, &input.unit), spec, watch) {
                Ok(found) => all.push(found),
                // One set that can be learnt over is enough; channels that are not there are a fault of the spec.
                Err(e @ MapError::Over { .. }) => return Err(e),
                Err(e) => why = e,
            }
        }
        all.sort_by(|a, b| a.error.total_cmp(&b.error));
        if all.is_empty() { Err(why) } else { Ok(all) }
    };
    layout.driven().into_iter().enumerate().map(one).collect()
}

/// Usable points at which the loop of `input` had room; all usable ones where that are fewer than `fewest`.
fn roomy<'a>(points: &'a [DayPoint], input: &str, fewest: usize) -> Vec<&'a SteadyPoint> {
    let usable = points.iter().filter(|p| p.purpose != Purpose::Verify && p.point.usable).map(|p| &p.point);
    let room: Vec<&SteadyPoint> =
        usable.clone().filter(|p| !p.saturated.iter().any(|s| s == input)).collect();
    if room.len() >= fewest { room } else { usable.collect() }
}

/// Factors, demands and given channels that are held, and responses of points, as a record.
fn channels(layout: &Layout, points: &[&SteadyPoint]) -> Dataset {
    let rows: Vec<(&[f64], &[f64])> = points.iter().map(|p| (&p.factors[..], &p.responses[..])).collect();
    record(layout, &rows)
}

/// Factors and responses of rows, demands and given channels that are held, as a record.
pub(super) fn record(layout: &Layout, rows: &[(&[f64], &[f64])]) -> Dataset {
    let channel = |name: &str, unit: &str, values: Vec<f64>| Channel {
        name: name.into(),
        unit: unit.into(),
        role: Role::Auxiliary,
        values,
    };
    let factors = layout.factors.iter().enumerate();
    let factors = factors.map(|(k, f)| channel(&f.name, &f.unit, rows.iter().map(|r| r.0[k]).collect()));
    let responses = layout.responses.iter().enumerate();
    let responses = responses.map(|(k, r)| channel(&r.name, &r.unit, rows.iter().map(|r| r.1[k]).collect()));
    let held = layout
        .held
        .iter()
        .map(|(name, v)| channel(name, layout.problem.unit(name).unwrap_or("-"), vec![*v; rows.len()]));
    Dataset {
        name: "points".into(),
        sample_time_s: 1.0,
        channels: factors.chain(responses).chain(held).collect(),
        init_samples: 0,
        origin: "steady points".into(),
    }
}

/// Columns of the channels `over`.
fn columns(layout: &Layout, record: &Dataset, over: &[String]) -> Result<Vec<Vec<f64>>, MapError> {
    let one = |name: &String| {
        layout
            .problem
            .values(name, record)
            .map_err(|e| MapError::Over { channel: name.clone(), why: e.to_string() })
    };
    over.iter().map(one).collect()
}

/// The best of the candidates over one set of channels.
fn drive(
    layout: &Layout,
    record: &Dataset,
    over: Vec<String>,
    y: &[f64],
    (input, unit): (&str, &str),
    spec: &MapSpec,
    watch: Watch,
) -> Result<Drive, MapError> {
    let columns = columns(layout, record, &over)?;
    let positive = |v: &[f64]| v.iter().all(|v| *v > 0.0);
    let logs: Vec<bool> = columns.iter().map(|c| positive(c)).collect();
    let relative = positive(y);
    let of = |log: bool, v: f64| if log { v.ln() } else { v };
    let row = |i: usize| columns.iter().zip(&logs).map(move |(c, log)| of(*log, c[i]));
    let points = Points {
        inputs: over.clone(),
        output: input.into(),
        x: (0..y.len()).flat_map(row).collect(),
        y: y.iter().map(|v| of(relative, *v)).collect(),
    };
    // What is learnt is a logarithm already where the input is positive.
    let mut models = spec.models.clone();
    models.candidates.retain(|c| !relative || c.get("transform").is_none());
    let kinds = kinds(if models.candidates.is_empty() { &spec.models } else { &models })?;
    let Chosen { learnt, rmse, widen, words, .. } =
        choose(&kinds, Errors::Absolute, &points, spec.models.folds, true, watch.interrupt)
            .map_err(|source| MapError::Learn { response: input.into(), source })?;
    Ok(Drive {
        input: input.into(),
        unit: unit.into(),
        over,
        choice: words,
        points: y.len(),
        error: rmse,
        relative,
        spread: spread(&points.y),
        widen,
        trimmed: None,
        verified: None,
        logs,
        model: learnt.model,
    })
}

fn spread(y: &[f64]) -> f64 {
    let n = y.len() as f64;
    let mean = y.iter().sum::<f64>() / n;
    (y.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt()
}

/// Error of an input, as a share of it, from which on a map does not hold a demand alone. The flow through a throttle goes with a power
/// of its angle between 1 and 2, and the load with the flow.
const ROUGH: f64 = 0.05;
/// The same where there is no share, of the spread of the input.
const ROUGH_OF_SPREAD: f64 = 0.2;

impl Drive {
    /// Whether the map holds its demand under a controller only.
    pub fn rough(&self) -> bool {
        self.missing() > if self.relative { ROUGH } else { ROUGH_OF_SPREAD * self.spread }
    }

    /// Its error: between the lines that were swept, where there are three, else on points that had no part in it; or, where that is
    /// larger, the scatter along the lines, which a map that is smooth does not follow, or what the verification found: lines do not
    /// show what all of them have in common.
    fn missing(&self) -> f64 {
        let swept = self.trimmed.as_ref();
        let told = swept.and_then(|t| t.between).unwrap_or(self.error);
        let scattered = swept.map_or(0.0, |t| t.held);
        self.verified.unwrap_or(0.0).max(told).max(scattered)
    }

    /// What lines say of it: how far one is from what those beside it say, else the scatter along them, by what it does to the demand; none where there
    /// are none.
    fn along(&self) -> Option<f64> {
        self.trimmed.as_ref().map(|t| t.between.unwrap_or(t.held)).filter(|v| v.is_finite())
    }

    /// Takes the place of `first`, which errs less on points, where it errs less along the lines: they go where the maps lie, and are many times as
    /// many windows as there are points.
    pub(super) fn rather_than(self, first: &mut Drive) {
        let Some((own, other)) = self.along().zip(first.along()).filter(|(own, other)| own < other) else {
            return;
        };
        let choice = format!(
            "{} Taken rather than over {}: lines say less against it ({} and {}, by what it does to the demand).",
            self.choice,
            first.over.join(", "),
            self.in_words(own),
            self.in_words(other)
        );
        *first = Self { choice, ..self };
    }

    /// Takes the place of the map that was learnt without `points` of the lines, where less is left along them. What is said of its error stays that of
    /// the other: lines that it was learnt from are no test of it. What is left in each cell is its own.
    pub(super) fn in_place_of(self, before: &mut Self, points: usize) {
        let (Some(new), Some(old)) = (self.trimmed, &before.trimmed) else { return };
        if new.held.is_nan() || new.held >= old.held {
            return;
        }
        let trimmed = Some(Trimmed { between: old.between, before: old.before, ..new });
        let choice = format!(
            "{} Learnt again with {points} points of lines, over {}: {}",
            before.choice,
            self.over.join(", "),
            self.choice
        );
        let Self { error, points, .. } = *before;
        *before = Self { trimmed, choice, error, points, ..self };
    }

    /// Takes what the loops set at the verification points less what the map says, by what it does to the demand.
    pub(super) fn verify(&mut self, missed: &[f64]) {
        let rms = (missed.iter().map(|m| m * m).sum::<f64>() / missed.len() as f64).sqrt();
        self.verified = Some(rms).filter(|v| v.is_finite());
    }

    /// Its error with its unit, in words.
    pub fn missed(&self) -> String {
        self.in_words(self.missing())
    }

    fn in_words(&self, error: f64) -> String {
        let error = if self.relative { 100.0 * error } else { error };
        format!("{} {}", dynocal_report::significant(error, 2), if self.relative { "%" } else { &self.unit })
    }

    /// How far `measured` is from `expected`, in what is learnt: logarithms where the map is relative.
    pub(super) fn missed_by(&self, measured: f64, expected: f64) -> f64 {
        if self.relative { measured.ln() - expected.ln() } else { measured - expected }
    }

    /// Takes what was measured along the maps; `between`: what a line differs from its neighbours.
    pub(super) fn take(&mut self, trim: Trim, demand: Option<usize>, between: Option<f64>) {
        let (scatter, held) = (trim.rest, trim.scatter);
        let (before, deviation, cells) = (0.0, scatter, Vec::new());
        self.trimmed = Some(Trimmed { before, scatter, deviation, held, between, cells, trim, demand });
    }

    /// What the map missed before it was trimmed, and what is left, in its input and in the demand of each cell of the `axes`.
    pub(super) fn compare(&mut self, axes: &[Vec<f64>], windows: &[Set]) {
        let rms = |of: &dyn Fn(&Set) -> f64| {
            let each = windows.iter().map(of).filter(|v| v.is_finite());
            let (sum, n) = each.fold((0.0, 0.0), |(sum, n), v| (sum + v * v, n + 1.0));
            f64::sqrt(sum / f64::max(n, 1.0))
        };
        let Some(t) = &self.trimmed else { return };
        let before = rms(&|w| self.missed_by(w.said[1], w.said[0]));
        // More of the demand by the lag is less of the input that holds it.
        let left = |w: &Set| {
            let lag = w.way.developed(t.trim.choice.tau_s) * t.trim.lag_at(w.at);
            self.missed_by(w.input, w.said[1]) + if t.demand.is_some() { w.slope * lag } else { -lag }
        };
        let scatter = if t.demand.is_some() { rms(&left) } else { t.scatter };
        // Between the lines it is known as well as a line is told by those beside it.
        let mut slopes: Vec<f64> = windows.iter().map(|w| w.slope.abs()).filter(|s| s.is_finite()).collect();
        slopes.sort_by(f64::total_cmp);
        let slope =
            if t.demand.is_some() { slopes.get(slopes.len() / 2).copied().unwrap_or(1.0) } else { 1.0 };
        let between = t.between.filter(|b| b.is_finite()).map_or(0.0, |b| b * slope);
        let deviation = scatter.hypot(between);
        // More of the input is less of the demand that it stands for; of another input nothing is known in shares of a demand.
        let shown: Vec<Shown> = windows.iter().map(|w| (w.at, -left(w) / w.slope, w.weight)).collect();
        let cells = if t.demand.is_some() { by_cell(axes, &shown) } else { Vec::new() };
        if let Some(t) = &mut self.trimmed {
            (t.before, t.scatter, t.deviation, t.cells) = (before, scatter, deviation, cells);
        }
    }

    /// What the trim is at the axes `at`; 0 where there is none.
    pub(super) fn trim_at(&self, at: &[f64]) -> f64 {
        self.trimmed.as_ref().map_or(0.0, |t| t.trim.at(at))
    }

    /// Factors at which the model is asked for its input at `x`.
    fn asked(&self, layout: &Layout, x: &[f64]) -> Vec<f64> {
        let mut x = x.to_vec();
        if let Some(k) = self.trimmed.as_ref().and_then(|t| t.demand) {
            x[k] *= (-self.trim_at(&x[..layout.axes])).exp();
        }
        x
    }

    /// Values at factors, all responses being as the models expect them there.
    ///
    /// # Errors
    /// [`MapError::Over`] where a channel does not follow from factors and responses.
    pub(super) fn at(
        &self,
        layout: &Layout,
        setting: &Setting,
        factors: &[&[f64]],
    ) -> Result<Vec<Driven>, MapError> {
        let asked: Vec<Vec<f64>> = factors.iter().map(|x| self.asked(layout, x)).collect();
        let expected: Vec<Vec<f64>> = asked.iter().map(|x| expected(layout, setting, x)).collect();
        let rows: Vec<(&[f64], &[f64])> =
            asked.iter().zip(&expected).map(|(x, e)| (&x[..], &e[..])).collect();
        let columns = columns(layout, &record(layout, &rows), &self.over)?;
        let mut at = Prediction::new(self.over.len());
        let one = |i: usize| {
            let of = |(c, log): (&Vec<f64>, &bool)| if *log { c[i].ln() } else { c[i] };
            let x: Vec<f64> = columns.iter().zip(&self.logs).map(of).collect();
            self.model.predict(&x, Ask::Variance, &mut at);
            let (mean, deviation) = match &self.trimmed {
                Some(t) if t.demand.is_some() => (at.mean, t.deviation),
                Some(t) => (at.mean + t.trim.at(&factors[i][..layout.axes]), t.deviation),
                None => (at.mean, self.widen * at.measured_std()),
            };
            match self.relative {
                true => Driven { value: mean.exp(), deviation: deviation * mean.exp() },
                false => Driven { value: mean, deviation },
            }
        };
        Ok((0..factors.len()).map(one).collect())
    }

    /// The values alone.
    ///
    /// # Errors
    /// As of [`Drive::at`].
    pub(super) fn say(
        &self,
        layout: &Layout,
        setting: &Setting,
        factors: &[Vec<f64>],
    ) -> Result<Vec<f64>, MapError> {
        let factors: Vec<&[f64]> = factors.iter().map(|x| &x[..]).collect();
        Ok(self.at(layout, setting, &factors)?.into_iter().map(|v| v.value).collect())
    }

    /// In words for reports: what it follows from and how well.
    pub fn words(&self) -> String {
        let learnt = format!(
            "`{}` over {}: {} rms on points that had no part in it ({} points)",
            self.input,
            self.over.join(", "),
            self.in_words(self.error),
            self.points
        );
        let Some(t) = &self.trimmed else { return learnt };
        let between = t.between.map_or(String::new(), |b| {
            format!("; a line differs from what the lines beside it say of it by {} rms", self.in_words(b))
        });
        format!(
            "{learnt}. Along the maps it missed {} rms and was trimmed by what was measured there; what is left scatters by {}, by what it does to the demand {}{between}",
            self.in_words(t.before),
            self.in_words(t.scatter),
            self.in_words(t.held)
        )
    }
}

/// What the models expect of all responses; no number for one that is slow.
fn expected(layout: &Layout, setting: &Setting, factors: &[f64]) -> Vec<f64> {
    let mut at = Prediction::new(factors.len());
    let one = |m: &&dyn Response| {
        m.predict(factors, Ask::Mean, &mut at);
        at.mean
    };
    // Behind those of the responses there may be others.
    let modelled = layout.responses.iter().filter(|r| !r.slow).count();
    let known = setting.models[..modelled].iter().map(one);
    known.chain(std::iter::repeat(f64::NAN)).take(layout.responses.len()).collect()
}

/// Puts the values of driven inputs into the cells, in place of what the models of the day expect over the factors. A cell in which a
/// channel has no logarithm keeps what it has, and so does one that is filled: models say nothing there.
///
/// # Errors
/// As of [`Drive::at`].
pub(super) fn fill(
    drives: &[Drive],
    layout: &Layout,
    setting: &Setting,
    cells: &mut [Cell],
) -> Result<(), MapError> {
    let factors: Vec<&[f64]> = cells.iter().map(|c| &c.optimum.x[..]).collect();
    let found: Vec<Vec<Driven>> =
        drives.iter().map(|d| d.at(layout, setting, &factors)).collect::<Result<_, _>>()?;
    for (l, values) in found.into_iter().enumerate() {
        let known = |(c, v): &(&mut Cell, Driven)| v.value.is_finite() && c.state != CellState::Filled;
        for (c, v) in cells.iter_mut().zip(values).filter(known) {
            c.optimum.responses[l] = v.value;
            c.optimum.deviations[l] = v.deviation;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
