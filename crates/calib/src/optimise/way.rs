//! How a record is gone through: the table of ways.

use super::dynamic::Dynamic;
use super::horizon::Horizon;
use super::segments::{Seam, Segments};
use dynocal_files::spec::Faults;
use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::{Deserialize, Serialize};

/// How a record is gone through: in a spec a table with `name`, a row of [`WAYS`], and its keys.
///
/// ```
/// use dynocal_calib::optimise::Way;
/// #[derive(serde::Deserialize)]
/// struct Spec { way: Way }
/// let spec: Spec = toml::from_str("way = { name = 'segments', length_s = 3.0, seam = 'pinned' }")?;
/// assert!(matches!(spec.way, Way::Segments(s) if s.length_s == 3.0));
/// let wrong = toml::from_str::<Spec>("way = { name = 'segment', length_s = 3.0 }");
/// assert!(wrong.is_err_and(|e| e.message().contains("did you mean `segments`?")));
/// # Ok::<(), toml::de::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "name", rename_all = "snake_case", try_from = "toml::Table")]
pub enum Way {
    /// All samples at once.
    Batch(Batch),
    /// In segments.
    Segments(Segments),
    /// Step by step, with a view of limited length.
    Horizon(Horizon),
    /// Over a grid of what the models remember.
    Dynamic(Dynamic),
}

impl Default for Way {
    fn default() -> Self {
        Self::Batch(Batch::default())
    }
}

/// All samples at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Batch {
    /// Number of starts: the record, and others with single inputs at other levels. The best end is taken.
    pub starts: usize,
}

impl Default for Batch {
    fn default() -> Self {
        Self { starts: 1 }
    }
}

/// All ways.
pub static WAYS: &[Member<Way>] = &[
    Member {
        doc: MemberDoc {
            name: "batch",
            what: "All samples in one program; the only way that knows prices",
            params: &[ParamDoc {
                name: "starts",
                unit: "-",
                default: "1",
                what: "starts: the record, and others with single inputs at other levels; the best end is taken",
            }],
        },
        build: |keys| Ok(Box::new(Way::Batch(registry::keys("batch", keys)?))),
    },
    Member {
        doc: MemberDoc {
            name: "segments",
            what: "The record in pieces (thesis section 7.5.3)",
            params: &[
                ParamDoc { name: "length_s", unit: "s", default: "", what: "length of a segment" },
                ParamDoc {
                    name: "seam",
                    unit: "-",
                    default: "pinned",
                    what: "independent, { smoothed = { width_s } } (both as published: demands are missed at the seams), { look_ahead = { ahead_s } }, or pinned (inputs that act on the next segment stay those of the record)",
                },
            ],
        },
        build: |keys| Ok(Box::new(Way::Segments(registry::keys("segments", keys)?))),
    },
    Member {
        doc: MemberDoc {
            name: "horizon",
            what: "Receding horizon: at every step the next part is optimised and its beginning applied",
            params: &[
                ParamDoc { name: "length_s", unit: "s", default: "", what: "how far a step looks" },
                ParamDoc {
                    name: "step_s",
                    unit: "s",
                    default: "one sample",
                    what: "how much of it is applied",
                },
                ParamDoc {
                    name: "price",
                    unit: "objective",
                    default: "20 x the objective of the record",
                    what: "price of an output's whole range missed for the whole horizon",
                },
                ParamDoc {
                    name: "warm_barrier",
                    unit: "objective",
                    default: "1e-6",
                    what: "barrier parameter that a step begins with: small where the plan before is nearly right",
                },
            ],
        },
        build: |keys| Ok(Box::new(Way::Horizon(registry::keys("horizon", keys)?))),
    },
    Member {
        doc: MemberDoc {
            name: "dynamic",
            what: "Dynamic programming over a grid, for models that remember one or two values; its error is that of the grid",
            params: &[
                ParamDoc {
                    name: "cells",
                    unit: "-",
                    default: "200 of one value, 40 of each of two",
                    what: "cells of the grid along each remembered value",
                },
                ParamDoc {
                    name: "price",
                    unit: "objective",
                    default: "20 x the objective of the record",
                    what: "price of an output's whole range missed for the whole record",
                },
            ],
        },
        build: |keys| Ok(Box::new(Way::Dynamic(registry::keys("dynamic", keys)?))),
    },
];

impl TryFrom<toml::Table> for Way {
    type Error = BuildError;

    fn try_from(mut keys: toml::Table) -> Result<Self, BuildError> {
        let name = match keys.remove("name") {
            Some(toml::Value::String(name)) => name,
            other => {
                let found = other.map_or("nothing".into(), |v| v.to_string());
                let known = WAYS.iter().map(|w| w.doc.name).collect::<Vec<_>>().join(", ");
                let message = format!("found {found} as its name, expected one of {known}");
                return Err(BuildError::Keys { member: "way".into(), message });
            }
        };
        Ok(*registry::build("way", WAYS, &name, &keys)?)
    }
}

/// Most starts of a batch.
const MOST_STARTS: f64 = 1000.0;

impl Way {
    /// Checks its keys; `key` is that of the way in its file.
    pub fn check(&self, key: &str, faults: &mut Faults) {
        let of = |field: &str| format!("{key}.{field}");
        match self {
            Self::Batch(b) => faults.range(&of("starts"), b.starts as f64, 1.0, MOST_STARTS, "starts"),
            Self::Segments(s) => {
                faults.positive(&of("length_s"), s.length_s, "s");
                match s.seam {
                    Seam::Smoothed { width_s } => {
                        faults.positive(&of("seam.smoothed.width_s"), width_s, "s");
                    }
                    Seam::LookAhead { ahead_s } => {
                        faults.range(&of("seam.look_ahead.ahead_s"), ahead_s, 0.0, MOST_S, "s");
                    }
                    Seam::Independent | Seam::Pinned => {}
                }
            }
            Self::Horizon(h) => {
                faults.positive(&of("length_s"), h.length_s, "s");
                if let Some(step) = h.step_s
                    && !(step > 0.0 && step <= h.length_s)
                {
                    faults.push(
                        &of("step_s"),
                        step,
                        format!("above 0 and at most length_s = {} s", h.length_s),
                    );
                }
                if let Some(price) = h.price {
                    faults.positive(&of("price"), price, "objective unit");
                }
                faults.positive(&of("warm_barrier"), h.warm_barrier, "objective unit");
            }
            Self::Dynamic(d) => {
                if let Some(cells) = d.cells {
                    faults.range(&of("cells"), cells as f64, 2.0, MOST_CELLS, "cells");
                }
                if let Some(price) = d.price {
                    faults.positive(&of("price"), price, "objective unit");
                }
            }
        }
    }
}

/// Most cells along one remembered value.
const MOST_CELLS: f64 = 10_000.0;

/// Longest time in s that a key may ask for.
pub(super) const MOST_S: f64 = 1e5;
