//! Lines of the finished maps on the bed: the inputs that loops drive are measured where the maps will be used.
//!
//! Models of six factors miss an input that a loop drives by some percent, and its map has to hold the demand alone. But the map
//! stands on a surface of two axes, and the loops find its values by themselves while the bed goes along it:
//!
//! ```text
//! r = log u - log g(q)      u: input as measured, g(q): what its model expects there ([`super::drive`])
//! u_map = g(q) exp(trim)    trim: r over the axes of the maps, there and back averaged ([`dynocal_calib::steady::trim`])
//! ```
//!
//! Free inputs follow the maps as an ECU will interpolate them. A line ends where a limit is touched, and goes through cells that hold an
//! optimum only.

use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::day::Drift;
use dynocal_calib::steady::grid::{Cell, CellState, corners, interpolate};
use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::station::{Leg, SweepRow};
use dynocal_calib::steady::trim::{Trim, finer};
use dynocal_ident::model::response::{Ask, Prediction};
use dynocal_numerics::watch::Watch;
use serde::Serialize;

use super::bench::Bench;
use super::drive::Drive;
use super::error::MapError;
use super::spec::{MapSpec, SweepSpec};

/// What the sweeps were.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Sweeps {
    /// Lines that were planned.
    pub planned: usize,
    /// Lines that were gone to their end.
    pub whole: usize,
    /// Windows that were measured.
    pub rows: usize,
    /// Bed time in s.
    pub bed_s: f64,
    /// Lines that ended early, in words.
    pub notes: Vec<String>,
}

/// Maps that are gone along.
pub(super) struct Lines<'a> {
    pub(super) spec: &'a MapSpec,
    pub(super) layout: &'a Layout,
    pub(super) setting: &'a Setting<'a>,
    pub(super) axes: &'a [Vec<f64>],
    pub(super) cells: &'a [Cell],
    pub(super) drift: &'a [Drift],
}

/// A line: factors at its nodes along the first axis.
struct Line {
    /// Value of the other axis; none where there is none.
    other: Option<f64>,
    nodes: Vec<Vec<f64>>,
}

/// Bed time that the sweeps of a spec take, about.
pub(super) fn expected_s(spec: &MapSpec, axes: &[Vec<f64>]) -> f64 {
    let Some(s) = &spec.bed.sweep else { return 0.0 };
    let lines = axes.get(1).map_or(1, |a| (a.len() - 1) * (s.between + 1) + 1);
    // There and back, and to the next line with its rest.
    lines as f64 * (2.0 * s.pass_s + 0.5 * spec.bed.approach.ramp_s + 3.0 * spec.bed.approach.window_s)
}

impl Lines<'_> {
    /// Goes along all lines until `bed_s` is used up, and trims the maps of the driven inputs; nothing where the spec asks for none or
    /// the bed cannot.
    ///
    /// # Errors
    /// [`MapError`].
    pub(super) fn run(
        &self,
        bench: &mut dyn Bench,
        drives: &mut [Drive],
        bed_s: f64,
        watch: Watch,
    ) -> Result<Option<Sweeps>, MapError> {
        let Some(spec) = &self.spec.bed.sweep else { return Ok(None) };
        let lines = self.lines(spec);
        watch.note(&format!("{} lines of the maps on the bed", lines.len()));
        let begun_s = bench.used_s();
        let mut sweeps = Sweeps { planned: lines.len(), ..Sweeps::default() };
        let mut rows: Vec<(usize, SweepRow)> = Vec::new();
        for (k, line) in lines.iter().enumerate() {
            if bench.used_s() >= bed_s {
                sweeps
                    .notes
                    .push(format!("{} lines were left out: the bed time was used up", lines.len() - k));
                break;
            }
            watch.fraction(k as f64 / lines.len() as f64);
            let (from, legs) = self.path(line, bench.stands_at(), spec.pass_s);
            let Some(swept) = bench.sweep(&from, &legs, watch)? else { return Ok(None) };
            match &swept.touched {
                Some(t) => sweeps.notes.push(format!("{} ended early: {}", self.named(line), t.words)),
                None => sweeps.whole += 1,
            }
            rows.extend(swept.rows.into_iter().map(|r| (k, r)));
        }
        sweeps.rows = rows.len();
        sweeps.bed_s = bench.used_s() - begun_s;
        let knots: Vec<Vec<f64>> = self.knots(spec);
        for (l, d) in drives.iter_mut().enumerate() {
            self.trim(l, d, &rows, &knots)?;
        }
        Ok(Some(sweeps))
    }

    fn knots(&self, spec: &SweepSpec) -> Vec<Vec<f64>> {
        let one = |(k, a): (usize, &Vec<f64>)| {
            finer(std::slice::from_ref(a), if k == 0 { 1 } else { spec.between })
        };
        self.axes.iter().enumerate().flat_map(one).collect()
    }

    fn named(&self, line: &Line) -> String {
        let f = self.layout.factors.get(1);
        match line.other.zip(f) {
            Some((v, f)) => format!("the line at {} {v:.0} {}", f.name, f.unit),
            None => "the line".into(),
        }
    }

    /// Lines along the first axis, each as long as all cells around it hold an optimum.
    fn lines(&self, spec: &SweepSpec) -> Vec<Line> {
        let others: Vec<Option<f64>> = match self.axes.get(1) {
            Some(a) => finer(std::slice::from_ref(a), spec.between)[0].iter().map(|v| Some(*v)).collect(),
            None => vec![None],
        };
        let line = |other: Option<f64>| {
            let place = |t: &f64| -> Vec<f64> { [*t].into_iter().chain(other).collect() };
            let held = |at: &Vec<f64>| {
                corners(self.axes, at).iter().all(|(k, _)| self.cells[*k].state == CellState::Optimal)
            };
            let all: Vec<Vec<f64>> = self.axes[0].iter().map(place).collect();
            let longest = all.split(|at| !held(at)).max_by_key(|run| run.len()).unwrap_or(&[]);
            let nodes = longest.iter().map(|at| interpolate(self.axes, self.cells, at)).collect();
            Line { other, nodes }
        };
        others.into_iter().map(line).filter(|l| l.nodes.len() > 1).collect()
    }

    /// There and back, beginning at the nearer end.
    fn path(&self, line: &Line, now: &[f64], pass_s: f64) -> (Vec<f64>, Vec<Leg>) {
        let mut nodes: Vec<&Vec<f64>> = line.nodes.iter().collect();
        let far = |x: &[f64]| (x[0] - now[0]).abs();
        if far(nodes[nodes.len() - 1]) < far(nodes[0]) {
            nodes.reverse();
        }
        let axis = &self.axes[0];
        let whole = axis[axis.len() - 1] - axis[0];
        let there: Vec<Leg> = nodes
            .windows(2)
            .map(|w| Leg { to: w[1].clone(), seconds: pass_s * (w[1][0] - w[0][0]).abs() / whole })
            .collect();
        let back = nodes.windows(2).rev().zip(there.iter().rev());
        let back = back.map(|(w, leg)| Leg { to: w[0].clone(), seconds: leg.seconds }).collect::<Vec<_>>();
        (nodes[0].clone(), there.into_iter().chain(back).collect())
    }

    /// Learns the trim of the input of loop `l` from rows with room.
    fn trim(
        &self,
        l: usize,
        drive: &mut Drive,
        rows: &[(usize, SweepRow)],
        knots: &[Vec<f64>],
    ) -> Result<(), MapError> {
        let (n, drift) = (self.layout.axes, self.drift.get(l).filter(|d| d.corrected));
        let used: Vec<&(usize, SweepRow)> = rows.iter().filter(|r| !r.1.at_end[l]).collect();
        let expected: Vec<Vec<f64>> = used.iter().map(|r| expected(self.setting, &r.1.factors)).collect();
        let asked: Vec<(&[f64], &[f64])> =
            used.iter().zip(&expected).map(|(r, e)| (&r.1.factors[..], &e[..])).collect();
        let model = drive.at(self.layout, &asked)?;
        let (mut at, mut missed, mut of) = (Vec::new(), Vec::new(), Vec::new());
        for ((line, row), model) in used.into_iter().zip(model) {
            let gone = drift.map_or(0.0, |d| d.per_hour / 3600.0 * (row.at_s - d.mean_s));
            let r = drive.missed_by(row.responses[l] - gone, model.value);
            if r.is_finite() {
                at.push(row.factors[..n].to_vec());
                missed.push(r);
                of.push(*line);
            }
        }
        let Some(trim) = Trim::learn(knots, &at, &missed) else { return Ok(()) };
        let error = between(&trim, &at, &missed, &of);
        let before = (missed.iter().map(|r| r * r).sum::<f64>() / missed.len() as f64).sqrt();
        drive.take(trim, before, error);
        Ok(())
    }
}

/// How far each line is from what the others say of it, where there are others on both sides: rms of the trims at its knots.
fn between(trim: &Trim, at: &[Vec<f64>], r: &[f64], line: &[usize]) -> Option<f64> {
    let last = *line.iter().max()?;
    let (mut sum, mut n) = (0.0, 0.0);
    for held in 1..last {
        let rest: Vec<usize> = (0..at.len()).filter(|i| line[*i] != held).collect();
        let (z, y): (Vec<Vec<f64>>, Vec<f64>) = rest.iter().map(|i| (at[*i].clone(), r[*i])).unzip();
        let Some(without) = Trim::with_lambda(&trim.axes, &z, &y, trim.lambda) else { continue };
        for (z, _) in at.iter().zip(line).filter(|(_, l)| **l == held) {
            sum += (without.at(z) - trim.at(z)).powi(2);
            n += 1.0;
        }
    }
    (n > 0.0).then(|| (sum / n).sqrt())
}

/// What the models expect of all responses.
pub(super) fn expected(setting: &Setting, factors: &[f64]) -> Vec<f64> {
    let mut at = Prediction::new(factors.len());
    let one = |m: &&dyn dynocal_ident::model::response::Response| {
        m.predict(factors, Ask::Mean, &mut at);
        at.mean
    };
    setting.models.iter().map(one).collect()
}
