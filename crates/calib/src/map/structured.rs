//! The structured inverse: a static part plus window differences that vanish in steady state.
//!
//! With references r (leading demand T, further demands L, operating channels N), for every actuator
//!
//! ```text
//! u(t) = static(r(t)) + sum_r sum_k [r(t+k) - r(t)] g_rk(r(t)),     static, g: linear in their coefficients
//! ```
//!
//! (terms: [`terms::terms`]). It is fitted by least squares; it has no recursion, so it is stable for every bounded
//! reference. The differences are zero in steady state, so dynamics never spoil the static accuracy.

mod ridge;
pub mod terms;

use super::filter::filtered;
use super::structures::{
    FitTask, FittedMap, InverseScore, MapError, MapRow, MapStructure, Pairs, StoredMap, r2,
};
use super::{FeedforwardMap, MapForm, Ports, Rows, SteadyPoint, anchor};
use dynocal_files::spec::Faults;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::linalg;
use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use terms::{Scale, Term};

/// Row of the table.
pub(super) const ROW: MapRow = MapRow {
    doc: MemberDoc {
        name: "structured",
        what: "a static part plus window differences of the demands, which vanish in steady state; no recursion",
        params: &[
            ParamDoc {
                name: "look_ahead",
                unit: "samples",
                default: "4",
                what: "future end of the windows: the map answers that much later",
            },
            ParamDoc {
                name: "offsets",
                unit: "samples",
                default: "{}",
                what: "offsets of the windows by reference, where they are not those of its role",
            },
            ParamDoc {
                name: "filter_s",
                unit: "s",
                default: "{}",
                what: "time constants of the filters of a demand, by its name",
            },
            ParamDoc {
                name: "ridge",
                unit: "-",
                default: "chosen",
                what: "weight on squared coefficients per sample; without it the records choose one for each actuator, stretches of them left out in turn",
            },
            ParamDoc {
                name: "steady_weight",
                unit: "-",
                default: "11",
                what: "weight of samples at which the demands are nearly at rest",
            },
            ParamDoc {
                name: "steady_share",
                unit: "-",
                default: "0.0165",
                what: "change of a demand over its window, as a share of its largest value, that counts as rest",
            },
        ],
    },
    fits: |_| true,
    build: |keys| Ok(Box::new(registry::keys::<StructuredShape>("structured", keys)?)),
    read: |map| Ok(Arc::new(serde_json::from_value::<StructuredMap>(map)?)),
};

/// Farthest past sample that the map may look at.
const MEMORY: i32 = 60;

/// Shape of the structured inverse.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StructuredShape {
    /// Samples of look-ahead: the future end of the window.
    pub look_ahead: usize,
    /// Offsets in samples (positive: ahead) of the windows by reference name; a reference that is not named has the
    /// offsets of its role ([`StructuredShape::LEAD`], [`StructuredShape::FURTHER`], [`StructuredShape::GIVEN`]).
    pub offsets: BTreeMap<String, Vec<i32>>,
    /// Time constants in s of the filter of each demand, by name; the leading demand has [`StructuredShape::FILTER_S`]
    /// where it is not named, others none.
    pub filter_s: BTreeMap<String, Vec<f64>>,
    /// Ridge per sample (regressors are scaled to the order of one); none: chosen for each actuator by what is predicted of
    /// stretches of the records that are left out.
    pub ridge: Option<f64>,
    /// Weight of quasi-steady samples (others: 1).
    pub steady_weight: f64,
    /// A sample is quasi-steady when every demand changes over its window by less than this share of its largest value.
    pub steady_share: f64,
}

impl Default for StructuredShape {
    fn default() -> Self {
        Self {
            look_ahead: 4,
            offsets: BTreeMap::new(),
            filter_s: BTreeMap::new(),
            ridge: None,
            steady_weight: 11.0,
            steady_share: 0.0165,
        }
    }
}

impl StructuredShape {
    /// Offsets of the leading demand.
    pub const LEAD: [i32; 6] = [4, 3, 2, 1, -2, -6];
    /// Offsets of a further demand.
    pub const FURTHER: [i32; 3] = [4, 2, -2];
    /// Offsets of a given channel, which is measured: nobody knows what comes.
    pub const GIVEN: [i32; 1] = [-3];
    /// Time constants in s of the filter of the leading demand.
    pub const FILTER_S: [f64; 2] = [0.12, 0.15];

    /// Offsets of a reference; `role` 0: leading demand, 1: further demand, 2: given.
    pub fn offsets_of(&self, name: &str, role: usize) -> &[i32] {
        match (self.offsets.get(name), role) {
            (Some(own), _) => own,
            (None, 0) => &Self::LEAD,
            (None, 1) => &Self::FURTHER,
            (None, _) => &Self::GIVEN,
        }
    }

    /// Time constants of the filter of demand number `k`, in s.
    pub fn filter_of(&self, name: &str, k: usize) -> &[f64] {
        match (self.filter_s.get(name), k) {
            (Some(own), _) => own,
            (None, 0) => &Self::FILTER_S,
            (None, _) => &[],
        }
    }
}

/// A fitted structured inverse.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StructuredMap {
    /// What it reads and gives.
    pub ports: Ports,
    /// Samples of look-ahead.
    pub look_ahead: usize,
    /// Time constants in s of the filter of each demand.
    pub filter_s: Vec<Vec<f64>>,
    /// Scales of the references.
    pub scales: Vec<Scale>,
    /// Terms.
    pub terms: Vec<Term>,
    /// Coefficients of each actuator, in the order of the terms.
    pub coefficients: Vec<Vec<f64>>,
    /// Range of each reference in the data; references outside are clamped to it.
    pub region: Vec<Interval>,
}

impl MapStructure for StructuredShape {
    fn check(&self, ports: &Ports, key: &str, faults: &mut Faults) {
        let name = |part: &str| format!("{key}.{part}");
        self.ridge.iter().for_each(|r| faults.range(&name("ridge"), *r, 0.0, 1.0, "-"));
        faults.range(&name("steady_weight"), self.steady_weight, 0.0, 1e6, "-");
        faults.range(&name("steady_share"), self.steady_share, 0.0, 1.0, "-");
        for (demand, lags) in &self.filter_s {
            lags.iter().for_each(|s| faults.range(&name(&format!("filter_s.{demand}")), *s, 0.0, 60.0, "s"));
        }
        if self.look_ahead > MEMORY as usize {
            faults.push(&name("look_ahead"), self.look_ahead, format!("at most {MEMORY} samples"));
        }
        let demands = ports.demands.len();
        let known = |part: &str, found: Vec<&String>, known: Vec<String>, faults: &mut Faults| {
            for unknown in found.into_iter().filter(|f| !known.contains(f)) {
                faults.unknown(&name(part), unknown, &known);
            }
        };
        known("offsets", self.offsets.keys().collect(), ports.reference_names(), faults);
        let of_demands = ports.reference_names()[..demands].to_vec();
        known("filter_s", self.filter_s.keys().collect(), of_demands, faults);
        for (k, port) in ports.references().enumerate() {
            let role = if k < demands { k.min(1) } else { 2 };
            for offset in self.offsets_of(&port.name, role) {
                // The window of a demand ends where the newest demand is, that of a measured channel at its present value.
                let most = if role < 2 { self.look_ahead as i32 } else { -1 };
                if *offset > most || *offset < -MEMORY || *offset == 0 {
                    let part = name(&format!("offsets.{}", port.name));
                    faults.push(&part, offset, format!("from -{MEMORY} to {most} samples, not 0"));
                }
            }
        }
    }

    fn filter_s(&self, demand: &str, k: usize) -> Vec<f64> {
        self.filter_of(demand, k).to_vec()
    }

    fn fit(&self, task: &FitTask) -> Result<FittedMap, MapError> {
        let map = StructuredMap::fit(self, task.ports, task.pairs)?;
        let scores = map.scores(task.pairs);
        Ok(FittedMap { map: Some(StoredMap::new(map)), scores })
    }
}

/// Largest offset back and ahead of the terms.
fn reach(terms: &[Term]) -> (usize, usize) {
    let all = || terms.iter().filter_map(|t| t.difference).map(|d| d.offset);
    let farthest = |k: Option<i32>| k.unwrap_or(0).max(0) as usize;
    (farthest(all().map(|k| -k).max()), farthest(all().max()))
}

impl StructuredMap {
    /// Fits the inverse by weighted, ridged least squares on measured pairs.
    ///
    /// # Errors
    /// [`MapError`] when there are fewer samples than coefficients or the regression fails.
    pub fn fit(shape: &StructuredShape, ports: &Ports, data: &[Pairs]) -> Result<Self, MapError> {
        let spans = data.iter().map(|p| p.response.spans()).reduce(|a, b| {
            a.into_iter().zip(b).map(|(x, y)| x.including(y.lower).including(y.upper)).collect::<Vec<_>>()
        });
        let spans = spans.unwrap_or_default();
        if spans.len() != ports.n_references() {
            return Err(MapError::TooShort { found: 0, needed: 1 });
        }
        let scales: Vec<Scale> = spans.iter().map(|s| Scale::of_range(*s)).collect();
        let terms = terms::terms(ports, &scales, shape);
        let (p, actuators) = (terms.len(), ports.actuators.len());
        let (back, ahead) = reach(&terms);
        let steady: Vec<f64> = spans
            .iter()
            .take(ports.demands.len())
            .map(|s| shape.steady_share * s.lower.abs().max(s.upper.abs()))
            .collect();
        let (mut x, mut y, mut row) = (Vec::new(), vec![Vec::new(); actuators], Vec::new());
        let mut used = Rows::new(ports.n_references());
        for pairs in data {
            let r = pairs.response;
            for t in back..r.len().saturating_sub(ahead) {
                let at = |c: usize, k: i32| r.row((t as i64 + i64::from(k)) as usize)[c];
                terms::values(&terms, &scales, at, &mut row);
                let quiet = quasi_steady(r, t - back, t + ahead, &steady);
                let weight = if quiet { shape.steady_weight.sqrt() } else { 1.0 };
                x.extend(row.iter().map(|v| v * weight));
                for (c, y) in y.iter_mut().enumerate() {
                    y.push(pairs.actuators.row(t)[c] * weight);
                }
                used.push(r.row(t));
            }
        }
        let n = used.len();
        let rows: Vec<usize> =
            data.iter().map(|d| d.response.len().saturating_sub(ahead).saturating_sub(back)).collect();
        if n < p {
            return Err(MapError::TooShort { found: n, needed: p });
        }
        let refused = |e: linalg::LinalgError| MapError::Regression(e.to_string());
        let ridges = match shape.ridge {
            Some(ridge) => vec![ridge; actuators],
            None => ridge::chosen(&x, p, &y, &rows).map_err(refused)?,
        };
        let coefficients = y
            .iter()
            .zip(ridges)
            .map(|(y, ridge)| {
                let fit = linalg::least_squares(&x, n, p, y, ridge * n as f64);
                fit.map(|f| f.x).map_err(refused)
            })
            .collect::<Result<_, _>>()?;
        let demands = ports.demands.iter().enumerate();
        Ok(Self {
            ports: ports.clone(),
            look_ahead: shape.look_ahead,
            filter_s: demands.map(|(k, d)| shape.filter_of(&d.name, k).to_vec()).collect(),
            scales,
            terms,
            coefficients,
            region: used.spans(),
        })
    }

    /// How well each actuator is given on the records, their ends with held references included.
    fn scores(&self, data: &[Pairs]) -> Vec<InverseScore> {
        let width = self.ports.actuators.len();
        let mut u = vec![0.0; width];
        let mut columns = vec![(Vec::new(), Vec::new()); width];
        for pairs in data {
            for t in 0..pairs.response.len() {
                self.at(pairs.response, t, &mut u);
                for (c, (y, z)) in columns.iter_mut().enumerate() {
                    y.push(u[c]);
                    z.push(pairs.actuators.row(t)[c]);
                }
            }
        }
        let score = |(port, (y, z)): (&super::ActuatorPort, (Vec<f64>, Vec<f64>))| InverseScore {
            map: "structured inverse".into(),
            actuator: port.name.clone(),
            estimator: "least squares".into(),
            r2: r2(&y, &z),
            status: Status::Converged,
        };
        self.ports.actuators.iter().zip(columns).map(score).collect()
    }

    /// Names of the coefficients.
    pub fn term_names(&self) -> Vec<String> {
        self.terms.iter().map(|t| t.name(&self.ports)).collect()
    }

    /// Reference `c` moved to the nearest value of the region.
    fn inside(&self, c: usize, value: f64) -> f64 {
        self.region[c].clamp(value)
    }

    /// Actuators from the values of the terms.
    fn combine(&self, row: &[f64], u: &mut [f64]) {
        for (v, c) in u.iter_mut().zip(&self.coefficients) {
            *v = row.iter().zip(c).map(|(a, b)| a * b).sum();
        }
        self.ports.clamp(u);
    }

    /// Actuators at sample t of a reference record (clamped at both ends of the record and to the region).
    pub fn at(&self, reference: &Rows, t: usize, u: &mut [f64]) {
        let last = reference.len() as i64 - 1;
        let mut row = Vec::with_capacity(self.terms.len());
        let at = |c: usize, k: i32| {
            let i = (t as i64 + i64::from(k)).clamp(0, last) as usize;
            self.inside(c, reference.row(i)[c])
        };
        terms::values(&self.terms, &self.scales, at, &mut row);
        self.combine(&row, u);
    }
}

/// Whether no demand moves by more than `steady` over the rows `from..=to`.
fn quasi_steady(r: &Rows, from: usize, to: usize, steady: &[f64]) -> bool {
    steady.iter().enumerate().all(|(c, most)| {
        let window = (from..=to).map(|t| r.row(t)[c]);
        let (lo, hi) = window.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        hi - lo < *most
    })
}

impl FeedforwardMap for StructuredMap {
    fn name(&self) -> &str {
        "structured map"
    }

    fn ports(&self) -> &Ports {
        &self.ports
    }

    fn drive(&self, reference: &Rows, sample_time_s: f64) -> Rows {
        let demands = self.ports.demands.len();
        let filtered: Vec<Vec<f64>> =
            (0..demands).map(|c| filtered(&reference.column(c), &self.filter_s[c], sample_time_s)).collect();
        let mut row = Vec::with_capacity(self.terms.len());
        let mut out = Rows::from_values(
            self.ports.actuators.len(),
            vec![0.0; reference.len() * self.ports.actuators.len()],
        );
        for t in 0..reference.len() {
            let now = t as i64;
            let at = |c: usize, k: i32| {
                let value = if c < demands {
                    // Online the newest demand is the far end of the window, so everything is `look_ahead` late.
                    filtered[c][(now + i64::from(k) - self.look_ahead as i64).clamp(0, now) as usize]
                } else {
                    // What is given is measured, not demanded: the map's centre uses the present one.
                    reference.row((now + i64::from(k)).clamp(0, now) as usize)[c]
                };
                self.inside(c, value)
            };
            terms::values(&self.terms, &self.scales, at, &mut row);
            self.combine(&row, out.row_mut(t));
        }
        out
    }

    fn steady(&self, reference: &[f64]) -> Vec<f64> {
        let mut u = vec![0.0; self.coefficients.len()];
        self.at(&Rows::from_values(reference.len(), reference.to_vec()), 0, &mut u);
        u
    }

    fn structure(&self) -> &'static str {
        ROW.doc.name
    }

    fn stored(&self) -> Result<serde_json::Value, serde_json::Error> {
        serde_json::to_value(self)
    }

    fn form(&self) -> MapForm<'_> {
        MapForm::Terms(self)
    }

    fn anchored(&self, points: &[SteadyPoint]) -> Option<StoredMap> {
        let own = anchor::at_rest(&self.terms, self.ports.demands.len());
        let terms: Vec<Term> = own.iter().map(|k| self.terms[*k].clone()).collect();
        let moved = anchor::correction(&terms, &self.scales, points, |r| self.steady(r))?;
        let mut map = self.clone();
        for (c, delta) in map.coefficients.iter_mut().zip(moved.coefficients) {
            own.iter().zip(delta).for_each(|(k, d)| c[*k] += d);
        }
        Some(StoredMap::new(map))
    }

    fn latency_s(&self, sample_time_s: f64) -> f64 {
        self.look_ahead as f64 * sample_time_s
    }
}

#[cfg(test)]
mod tests;
