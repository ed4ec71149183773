//! Zero-phase Butterworth filters: second-order sections run forward and backward.
//!
//! ```text
//! |H(f)|^2 = 1 / (1 + r^(2 n)),   total gain forward and backward = |H|^2 (1/2 at the edges), phase 0
//! low pass     r = w / w_c                     w = tan(pi f dt)
//! high pass    r = w_c / w
//! band pass    r = (w^2 - w_1 w_2) / (w (w_2 - w_1))
//! band stop    r = w (w_2 - w_1) / (w^2 - w_1 w_2)
//! ```
//!
//! Both ends are continued by their odd mirror image for as long as the filter remembers, and every section starts in
//! the steady state of the first value. (F. Gustafsson, IEEE Trans. Signal Process. 44 (1996) 988-992, on the ends;
//! A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 3rd ed., section 7.1, on the design.)

use std::f64::consts::{PI, TAU};

use dynocal_numerics::fft::Complex;
use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::common::{DRIVEN, change, chosen, complete, fault, key_fault, positive, uniform};
use super::{Effect, Outcome, PrepareError, Step};
use crate::data::Dataset;

const NAME: &str = "filter";

pub(super) const MEMBER: Member<dyn Step> = Member {
    doc: MemberDoc {
        name: NAME,
        what: "zero-phase Butterworth filter, the same for inputs and outputs",
        params: &[
            ParamDoc { name: "pass", unit: "-", default: "", what: "low, high, band, or stop (a band)" },
            ParamDoc { name: "edge_hz", unit: "Hz", default: "", what: "edge of a low or high pass" },
            ParamDoc {
                name: "edges_hz",
                unit: "Hz",
                default: "",
                what: "the two edges of a band, where the gain (forward and backward) is 1/2",
            },
            ParamDoc {
                name: "order",
                unit: "-",
                default: "4",
                what: "order of the low-pass prototype, 1 to 12",
            },
            ParamDoc {
                name: "channels",
                unit: "-",
                default: "inputs and outputs",
                what: "channels that are filtered",
            },
        ],
    },
    build: |keys| {
        let step: Filter = registry::keys(NAME, keys)?;
        step.band()?;
        Ok(Box::new(step))
    },
};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Pass {
    Low,
    High,
    Band,
    Stop,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Filter {
    pass: Pass,
    edge_hz: Option<f64>,
    edges_hz: Option<[f64; 2]>,
    #[serde(default = "four")]
    order: usize,
    channels: Option<Vec<String>>,
}

fn four() -> usize {
    4
}

/// What passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Band {
    /// Below an edge in Hz.
    Low(f64),
    /// Above an edge in Hz.
    High(f64),
    /// Between two edges in Hz.
    Pass(f64, f64),
    /// Outside two edges in Hz.
    Stop(f64, f64),
}

impl Filter {
    fn band(&self) -> Result<Band, BuildError> {
        if !(1..=12).contains(&self.order) {
            return Err(key_fault(NAME, format!("found order = {}, expected 1 to 12", self.order)));
        }
        match (self.pass, self.edge_hz, self.edges_hz) {
            (Pass::Low | Pass::High, Some(f), None) => {
                positive(NAME, "edge_hz", f)?;
                Ok(if self.pass == Pass::Low { Band::Low(f) } else { Band::High(f) })
            }
            (Pass::Band | Pass::Stop, None, Some([a, b])) => {
                positive(NAME, "edges_hz", a)?;
                positive(NAME, "edges_hz", b)?;
                if a >= b {
                    let message = format!("found edges_hz = [{a}, {b}], expected the lower one first");
                    return Err(key_fault(NAME, message));
                }
                Ok(if self.pass == Pass::Band { Band::Pass(a, b) } else { Band::Stop(a, b) })
            }
            _ => {
                let message =
                    "expected `edge_hz` for pass = \"low\" or \"high\", `edges_hz` for \"band\" or \"stop\"";
                Err(key_fault(NAME, message.into()))
            }
        }
    }
}

impl Step for Filter {
    fn apply(&self, records: Vec<Dataset>) -> Result<Outcome, PrepareError> {
        let mut outcome = Outcome::default();
        for mut record in records {
            let dt_s = uniform(NAME, &record)?;
            let built = self.band().map_err(|e| fault(NAME, &record, e.to_string()))?;
            let filter =
                ZeroPhase::butterworth(built, self.order, dt_s).map_err(|m| fault(NAME, &record, m))?;
            let channels = chosen(&record, self.channels.as_deref(), DRIVEN)?;
            for &c in &channels {
                let values = complete(NAME, &record, c)?;
                let out = filter.apply(values).map_err(|m| fault(NAME, &record, m))?;
                record.channels[c].values = out;
                let effect = Effect::Filtered { filter: self.words() };
                outcome.changes.push(change(&record, Some(c), effect));
            }
            if chosen(&record, None, DRIVEN)?.iter().any(|c| !channels.contains(c)) {
                outcome.remarks.push(format!(
                    "{}: not all inputs and outputs go through the filter, so a model of them contains the filter",
                    record.name
                ));
            }
            outcome.records.push(record);
        }
        Ok(outcome)
    }
}

impl Filter {
    fn words(&self) -> String {
        let (name, edges) = match (self.pass, self.edge_hz, self.edges_hz) {
            (Pass::Low, Some(f), _) => ("low pass", format!("{f} Hz")),
            (Pass::High, Some(f), _) => ("high pass", format!("{f} Hz")),
            (Pass::Band, _, Some([a, b])) => ("band pass", format!("{a} to {b} Hz")),
            (_, _, Some([a, b])) => ("band stop", format!("{a} to {b} Hz")),
            _ => ("filter", String::new()),
        };
        format!("Butterworth {name} of order {}, {edges}, forward and backward", self.order)
    }
}

/// Second-order section `(b0 + b1 z^-1 + b2 z^-2) / (1 + a1 z^-1 + a2 z^-2)`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Section {
    b: [f64; 3],
    a: [f64; 2],
}

impl Section {
    fn at(&self, z: Complex<f64>) -> Complex<f64> {
        let w = z.inv();
        (w * (w * self.b[2] + self.b[1]) + self.b[0]) / (w * (w * self.a[1] + self.a[0]) + 1.0)
    }

    /// Gain one at `z`.
    fn normalised(mut self, z: Complex<f64>) -> Self {
        let gain = self.at(z).norm();
        self.b.iter_mut().for_each(|b| *b /= gain);
        self
    }

    /// One pass in place, transposed direct form, from the steady state of the constant `x[0]`.
    fn run(&self, x: &mut [f64]) {
        let ([b0, b1, b2], [a1, a2]) = (self.b, self.a);
        let steady = x[0] * (b0 + b1 + b2) / (1.0 + a1 + a2);
        let mut s2 = b2 * x[0] - a2 * steady;
        let mut s1 = b1 * x[0] - a1 * steady + s2;
        for v in x.iter_mut() {
            let y = b0 * *v + s1;
            s1 = b1 * *v - a1 * y + s2;
            s2 = b2 * *v - a2 * y;
            *v = y;
        }
    }
}

/// A filter that runs forward and backward.
///
/// ```
/// use dynocal_ident::prepare::filter::{Band, ZeroPhase};
/// let filter = ZeroPhase::butterworth(Band::Low(2.0), 4, 0.01)?;
/// // Straight lines pass a low pass unchanged, to the ends.
/// let line: Vec<f64> = (0..500).map(|t| 3.0 + 0.1 * f64::from(t)).collect();
/// let out = filter.apply(&line)?;
/// assert!(out.iter().zip(&line).all(|(a, b)| (a - b).abs() < 1e-9));
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct ZeroPhase {
    sections: Vec<Section>,
    /// Samples after which the slowest pole has decayed to 1e-10.
    memory: usize,
}

impl ZeroPhase {
    /// Butterworth filter of `order` (of the low-pass prototype), samples `dt_s` apart, by the bilinear transform with
    /// its edges kept.
    ///
    /// # Errors
    /// An edge that is not between zero and half the sample rate, in words.
    pub fn butterworth(band: Band, order: usize, dt_s: f64) -> Result<Self, String> {
        let edges = match band {
            Band::Low(f) | Band::High(f) => vec![f],
            Band::Pass(a, b) | Band::Stop(a, b) => vec![a, b],
        };
        if let Some(f) = edges.iter().find(|f| !(**f > 0.0 && **f < 0.5 / dt_s)) {
            return Err(format!(
                "found an edge of {f} Hz, expected more than 0 and less than half the sample rate ({} Hz)",
                0.5 / dt_s
            ));
        }
        let w: Vec<f64> = edges.iter().map(|f| (PI * f * dt_s).tan()).collect();
        let sections = sections(band, order, &w);
        let radius = sections.iter().map(Section::radius).fold(0.0, f64::max);
        Ok(Self { sections, memory: (1e-10f64.ln() / radius.ln()).ceil() as usize })
    }

    /// Gain forward and backward at `f_hz` for samples `dt_s` apart.
    pub fn gain(&self, f_hz: f64, dt_s: f64) -> f64 {
        let z = Complex::from_polar(1.0, TAU * f_hz * dt_s);
        self.sections.iter().map(|s| s.at(z).norm_sqr()).product()
    }

    /// The filtered samples, as many as given.
    ///
    /// # Errors
    /// A record that is shorter than three times the number of coefficients, in words.
    pub fn apply(&self, x: &[f64]) -> Result<Vec<f64>, String> {
        let (n, least) = (x.len(), 6 * self.sections.len() + 1);
        if n <= least {
            return Err(format!("{n} samples are too few for the filter, at least {} are needed", least + 1));
        }
        let pad = self.memory.clamp(least, n - 1);
        let mut work = Vec::with_capacity(n + 2 * pad);
        work.extend((1..=pad).rev().map(|k| 2.0 * x[0] - x[k]));
        work.extend_from_slice(x);
        work.extend((1..=pad).map(|k| 2.0 * x[n - 1] - x[n - 1 - k]));
        for _ in 0..2 {
            self.sections.iter().for_each(|s| s.run(&mut work));
            work.reverse();
        }
        Ok(work[pad..pad + n].to_vec())
    }
}

impl Section {
    /// Largest modulus of its poles.
    fn radius(&self) -> f64 {
        let [a1, a2] = self.a;
        let root = Complex::new(0.25 * a1 * a1 - a2, 0.0).sqrt();
        (root - 0.5 * a1).norm().max((root + 0.5 * a1).norm())
    }
}

/// Poles of the prototype to those of the band, to the z plane, two by two.
fn sections(band: Band, order: usize, w: &[f64]) -> Vec<Section> {
    let one = Complex::new(1.0, 0.0);
    let to_z = |s: Complex<f64>| (one + s) / (one - s);
    let mut poles = Vec::new();
    for k in 0..order {
        let p = Complex::from_polar(1.0, PI * (2 * k + order + 1) as f64 / (2 * order) as f64);
        match band {
            Band::Low(_) => poles.push(to_z(p * w[0])),
            Band::High(_) => poles.push(to_z(p.inv() * w[0])),
            Band::Pass(..) | Band::Stop(..) => {
                // s^2 - q s + w1 w2 = 0 with q = p (w2 - w1), for a stop 1/p in place of p.
                let half = if matches!(band, Band::Pass(..)) { p } else { p.inv() } * (0.5 * (w[1] - w[0]));
                let root = (half * half - w[0] * w[1]).sqrt();
                poles.extend([to_z(half + root), to_z(half - root)]);
            }
        }
    }
    // Zeros of a section, and where the gain is one.
    let (zeros, unit) = match band {
        Band::Low(_) => ([1.0, 2.0, 1.0], one),
        Band::High(_) => ([1.0, -2.0, 1.0], -one),
        Band::Pass(..) => ([1.0, 0.0, -1.0], to_z(Complex::new(0.0, (w[0] * w[1]).sqrt()))),
        Band::Stop(..) => {
            let centre = to_z(Complex::new(0.0, (w[0] * w[1]).sqrt()));
            ([1.0, -2.0 * centre.re, 1.0], one)
        }
    };
    let section = |a| Section { b: zeros, a }.normalised(unit);
    let pairs = poles.iter().filter(|p| p.im > 1e-14).map(|p| section([-2.0 * p.re, p.norm_sqr()]));
    let mut out: Vec<Section> = pairs.collect();
    let mut real: Vec<f64> = poles.iter().filter(|p| p.im.abs() <= 1e-14).map(|p| p.re).collect();
    real.sort_by(f64::total_cmp);
    for two in real.chunks(2) {
        out.push(match two {
            [p, q] => section([-(p + q), p * q]),
            _ => {
                // One real pole with one zero: at -1 for a low pass, at +1 for a high pass.
                let b = [1.0, zeros[1] / 2.0, 0.0];
                Section { b, a: [-two[0], 0.0] }.normalised(unit)
            }
        });
    }
    out
}
