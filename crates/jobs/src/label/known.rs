//! A fuel table that is known, because the log carries its tune, from the look-ups in the log: what the ECU's arithmetic cut is an
//! interval, and one table must explain them all.

use std::path::Path;

use dynocal_export::tune::msq::Tune;
use dynocal_label::error::LabelError;
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::{Options, Problem, Verdict, fit};
use dynocal_label::rows::Rows;
use dynocal_label::truncated::{self, Cut};
use serde::{Deserialize, Serialize};

use super::channels;
use super::result::LabelJobError;

/// What the ECU's whole numbers cut off.
const CUT: Cut = Cut { step: 1.0, slack: 0.0 };
/// Farthest that a look-up may lie outside of its interval by rounding here.
const ROUNDING: f64 = 1e-6;
/// Half width of a cell, in counts, up to which it counts as determined.
const HALF_COUNT: f64 = 0.5;
/// Weight of the roughness: what holds cells without samples, and nothing else.
const FAINT: f64 = 1e-9;

/// What came back.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Known {
    /// Look-ups.
    pub samples: usize,
    /// Of these, what the tune in the log explains, and what the table that was found explains.
    pub by_tune: usize,
    /// See `by_tune`.
    pub by_found: usize,
    /// Cells that are determined to half a count.
    pub determined: usize,
    /// Of these, within one count of the tune.
    pub near: usize,
    /// Of the others, those of which the log rules the tune out: no table with its value there explains all look-ups.
    pub ruled_out: usize,
}

/// Look-ups of a log as rows.
struct LookUps {
    label: Label,
    tune: Vec<f64>,
    rows: Rows,
    cut: Vec<f64>,
}

fn look_ups(path: &Path) -> Result<LookUps, LabelJobError> {
    let (log, tune) = channels::log(path, None, &mut Vec::new())?;
    let tune: Tune = tune.ok_or_else(|| LabelJobError::NoTune { file: path.display().to_string() })?;
    let of = |name: &str| tune.constant(name).map(|c| c.values.clone());
    let table = of("veTable")?;
    let axes = vec![Axis::new("RPM", "rpm", &of("rpmBins")?), Axis::new("load", "kPa", &of("fuelLoadBins")?)];
    // Of the table nothing is known before.
    let label = Label::new("veTable", "%", axes, &vec![50.0; table.len()]);
    let (mut rows, mut cut) = (Rows::default(), Vec::new());
    for k in (0..log.ve.len()).filter(|k| log.ve[*k] > 0.0 && log.speed_rpm[*k] > 0.0) {
        rows.start();
        truncated::enter_eight_bits(&label, &mut rows, 0, &[log.speed_rpm[k], log.load[k]]);
        cut.push(log.ve[k]);
    }
    Ok(LookUps { label, tune: table, rows, cut })
}

impl LookUps {
    /// Look-ups that a table explains.
    fn explained(&self, table: &[f64]) -> usize {
        let off = |k: &usize| self.rows.times(*k, table) - self.cut[*k];
        (0..self.cut.len()).filter(|k| (-ROUNDING..1.0 + ROUNDING).contains(&off(k))).count()
    }

    /// Whether no table with the tune's value at a cell explains all look-ups.
    fn rules_out(&self, cell: usize) -> Result<bool, LabelError> {
        let mut label = self.label.clone();
        label.base[cell] = self.tune[cell];
        label.locked[cell] = true;
        match truncated::fit(&label, &self.rows, &self.cut, CUT) {
            Ok(table) => Ok(self.explained(&table) < self.cut.len()),
            Err(LabelError::Contradiction { .. }) => Ok(true),
            Err(e) => Err(e),
        }
    }
}

/// The fuel table of the log at `path` from its look-ups, and how it compares with the tune that the log carries.
///
/// # Errors
/// [`LabelJobError`]: files, a log without tune, look-ups that no table explains.
pub fn compare(path: &Path) -> Result<Known, LabelJobError> {
    let l = look_ups(path)?;
    let found = truncated::fit(&l.label, &l.rows, &l.cut, CUT)?;
    let middle: Vec<f64> = l.cut.iter().map(|c| c + 0.5).collect();
    let problem = Problem::new(std::slice::from_ref(&l.label), &l.rows, &middle);
    let plain = fit(&problem, &Options { smooth: Some(FAINT), ..Options::default() })?;
    let told = |k: &usize| plain.verdicts[*k] == Verdict::Determined && plain.half_width[*k] < HALF_COUNT;
    let told: Vec<usize> = (0..l.tune.len()).filter(told).collect();
    let (near, far): (Vec<usize>, Vec<usize>) =
        told.iter().partition(|k| (found[**k] - l.tune[**k]).abs() <= 1.0);
    let mut ruled_out = 0;
    for k in far {
        ruled_out += usize::from(l.rules_out(k)?);
    }
    Ok(Known {
        samples: l.cut.len(),
        by_tune: l.explained(&l.tune),
        by_found: l.explained(&found),
        determined: told.len(),
        near: near.len(),
        ruled_out,
    })
}
