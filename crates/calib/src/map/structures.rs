//! The table of map structures: how a map is fitted to optimal records, what it asks of its keys, how it is kept in a file.
//!
//! A structure is a file beside this one with a [`MapRow`], and a row of [`MAP_STRUCTURES`].

use std::ops::Deref;
use std::sync::Arc;

use dynocal_files::spec::Faults;
use dynocal_numerics::registry::{self, BuildError, MemberDoc};
use dynocal_numerics::status::Status;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{FeedforwardMap, Ports, Rows, lead_lag, published, structured};

/// All structures.
pub static MAP_STRUCTURES: &[&MapRow] = &[&structured::ROW, &published::ROW, &lead_lag::ROW];

/// One row of the table.
pub struct MapRow {
    /// Name, as a spec has it, one line, keys.
    pub doc: MemberDoc,
    /// Whether the structure is made for these ports.
    pub fits: fn(&Ports) -> bool,
    /// The structure with its keys.
    pub build: fn(&toml::Table) -> Result<Box<dyn MapStructure>, BuildError>,
    /// A map of this structure from what [`FeedforwardMap::stored`] gave.
    pub read: fn(serde_json::Value) -> Result<Arc<dyn FeedforwardMap>, serde_json::Error>,
}

/// A structure with its keys, not yet fitted.
pub trait MapStructure: Send + Sync {
    /// Reports keys that do not go with the ports; `key` is the name of their table.
    fn check(&self, ports: &Ports, key: &str, faults: &mut Faults);

    /// Time constants in s of the filter that the map puts on demand number `k`: what is asked of a record that it shall learn
    /// from.
    fn filter_s(&self, _demand: &str, _k: usize) -> Vec<f64> {
        Vec::new()
    }

    /// Fits the map.
    ///
    /// # Errors
    /// [`MapError`].
    fn fit(&self, task: &FitTask) -> Result<FittedMap, MapError>;
}

/// What a map is fitted to.
pub struct FitTask<'a> {
    /// What it reads and gives.
    pub ports: &'a Ports,
    /// Records.
    pub pairs: &'a [Pairs<'a>],
    /// Seed of everything random.
    pub seed: u64,
    /// Asked often; ends a search with what there is.
    pub interrupt: &'a dyn Fn() -> bool,
}

/// One record of measured pairs: the response that was measured and the actuators that caused it.
pub struct Pairs<'a> {
    /// Measured (or simulated) references, row t measured at instant t.
    pub response: &'a Rows,
    /// Actuators applied from instant t on.
    pub actuators: &'a Rows,
}

/// A fitted map.
pub struct FittedMap {
    /// The map; none where no stable fit was found.
    pub map: Option<StoredMap>,
    /// How well it fits.
    pub scores: Vec<InverseScore>,
}

/// Fit of one actuator by one map on the identification data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InverseScore {
    /// Map.
    pub map: String,
    /// Actuator.
    pub actuator: String,
    /// Estimator.
    pub estimator: String,
    /// R2 of the simulated actuator; none when the free run is unstable or the actuator does not move.
    pub r2: Option<f64>,
    /// How the estimator ended.
    pub status: Status,
}

/// R2 of `y` against the measured `z`; none where `z` does not move or `y` is not finite.
pub fn r2(y: &[f64], z: &[f64]) -> Option<f64> {
    let mean = z.iter().sum::<f64>() / z.len().max(1) as f64;
    let sse: f64 = y.iter().zip(z).map(|(a, b)| (a - b).powi(2)).sum();
    Some(1.0 - sse / z.iter().map(|v| (v - mean).powi(2)).sum::<f64>()).filter(|v| v.is_finite())
}

/// Why a map could not be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapError {
    /// Too few samples.
    #[error("dynamic map: {found} usable samples for {needed} coefficients; record a longer or richer test")]
    TooShort {
        /// Samples.
        found: usize,
        /// Coefficients.
        needed: usize,
    },
    /// The regression failed.
    #[error("dynamic map: {0}")]
    Regression(String),
    /// No stable fit.
    #[error("the map structure `{0}` found no fit that can be run; another one is chosen by `structure`")]
    Unstable(String),
    /// The name or the keys.
    #[error(transparent)]
    Build(#[from] BuildError),
}

/// The row of a name.
///
/// # Errors
/// [`BuildError`] with all names.
pub fn row(name: &str) -> Result<&'static MapRow, BuildError> {
    MAP_STRUCTURES.iter().find(|r| r.doc.name == name).copied().ok_or_else(|| {
        let known: Vec<String> = MAP_STRUCTURES.iter().map(|r| r.doc.name.to_string()).collect();
        let nearest = registry::nearest(name, &known);
        BuildError::UnknownMember { family: "map structure", found: name.into(), nearest, known }
    })
}

/// A map with the name of its structure, as files keep it.
#[derive(Clone)]
pub struct StoredMap(Arc<dyn FeedforwardMap>);

impl StoredMap {
    /// A map to keep.
    pub fn new(map: impl FeedforwardMap + 'static) -> Self {
        Self(Arc::new(map))
    }
}

impl Deref for StoredMap {
    type Target = dyn FeedforwardMap;

    fn deref(&self) -> &Self::Target {
        self.0.as_ref()
    }
}

impl std::fmt::Debug for StoredMap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("StoredMap").field(&self.0.name()).finish()
    }
}

/// Key of the name of the structure in a file. Files of version 2 have none: they hold a structured inverse.
const STRUCTURE: &str = "structure";

impl Serialize for StoredMap {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = self.0.stored().map_err(serde::ser::Error::custom)?;
        if let Some(keys) = map.as_object_mut() {
            keys.insert(STRUCTURE.into(), self.0.structure().into());
        }
        map.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for StoredMap {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        use serde::de::Error;
        let mut map = serde_json::Value::deserialize(deserializer)?;
        let name = map.as_object_mut().and_then(|keys| keys.remove(STRUCTURE));
        let name = name.as_ref().map_or(Some(structured::ROW.doc.name), serde_json::Value::as_str);
        let row = row(name.unwrap_or_default()).map_err(D::Error::custom)?;
        (row.read)(map).map(Self).map_err(D::Error::custom)
    }
}
