//! Records from files.

use std::path::Path;

use dynocal_calib::fuelling::TransientRecord;
use dynocal_files::dataset::{ChannelSpec, Layout, Select, Time, datasets, read_table};
use dynocal_files::measurement;
use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::stored::Pieces;
use dynocal_numerics::watch::Watch;
use serde::Serialize;

use super::result::FuellingJobError;
use super::spec::Channels;

/// A record, sample by sample.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Record {
    /// Name.
    pub name: String,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Unit of the injection.
    pub injection_unit: String,
    /// Speed in rpm.
    #[serde(skip)]
    pub speed_rpm: Vec<f64>,
    /// Throttle command in deg.
    #[serde(skip)]
    pub throttle_deg: Vec<f64>,
    /// Injection per cycle as commanded.
    #[serde(skip)]
    pub injection: Vec<f64>,
    /// Manifold pressure in kPa.
    #[serde(skip)]
    pub map_kpa: Vec<f64>,
    /// Lambda that the sensor shows.
    #[serde(skip)]
    pub lambda: Vec<f64>,
    /// Pressure before the throttle in kPa, where it is measured.
    #[serde(skip)]
    pub boost_kpa: Option<Vec<f64>>,
    /// Coolant temperature in degC, where it counts.
    #[serde(skip)]
    pub coolant_c: Option<Vec<f64>>,
    /// Places of intake and exhaust cam in deg, where they count.
    #[serde(skip)]
    pub cams_deg: Option<[Vec<f64>; 2]>,
    /// As it was read from a file.
    #[serde(skip)]
    pub read: Option<Dataset>,
}

impl Record {
    /// As the identification takes it.
    pub fn view(&self, upstream_kpa: f64) -> TransientRecord<'_> {
        TransientRecord {
            sample_time_s: self.sample_time_s,
            speed_rpm: &self.speed_rpm,
            throttle_deg: &self.throttle_deg,
            injection: &self.injection,
            map_kpa: &self.map_kpa,
            lambda: &self.lambda,
            upstream_kpa,
            boost_kpa: self.boost_kpa.as_deref(),
            coolant_c: self.coolant_c.as_deref(),
            cams_deg: self.cams_deg.as_ref().map(|[i, e]| [i.as_slice(), e]),
        }
    }

    /// Length in s.
    pub fn length_s(&self) -> f64 {
        self.speed_rpm.len() as f64 * self.sample_time_s
    }
}

/// Reads the experiments of a file; units are converted where they differ.
///
/// # Errors
/// [`FuellingJobError::Files`], [`FuellingJobError::Data`]: columns, units, time.
pub(super) fn read(file: &Path, names: &Channels, watch: &Watch) -> Result<Vec<Record>, FuellingJobError> {
    watch.note(&format!("reading {}", file.display()));
    let table = read_table(file, None)?;
    table.notes.iter().for_each(|n| watch.note(n));
    let channel = |name: &str, unit: Option<&str>| ChannelSpec {
        column: name.into(),
        name: name.into(),
        unit: unit.map(str::to_string),
        convert: true,
        role: Role::Auxiliary,
    };
    let mut channels = vec![
        channel(&names.speed, Some("rpm")),
        channel(&names.throttle, Some("deg")),
        channel(&names.injection, None),
        channel(&names.map, Some("kPa")),
        channel(&names.lambda, Some("-")),
    ];
    channels.extend(names.boost.as_ref().map(|b| channel(b, Some("kPa"))));
    channels.extend(names.coolant.as_ref().map(|c| channel(c, Some("degC"))));
    channels.extend(names.cams().iter().flatten().map(|c| channel(c, Some("deg"))));
    let column = measurement::time_column(&table).map_or("time".into(), |c| c.name.clone());
    let layout = Layout { channels, time: Time::Column { column, unit: None }, ..Layout::default() };
    let stem = file.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let read = datasets(&table, &layout, &Select::All)?;
    let several = read.len() > 1;
    read.into_iter()
        .map(|d| {
            let of = |name: &str| -> Result<Vec<f64>, FuellingJobError> { Ok(d.values(name)?.to_vec()) };
            Ok(Record {
                name: if several { format!("{stem}-{}", d.name) } else { stem.clone() },
                sample_time_s: d.sample_time_s,
                injection_unit: d.channel(&names.injection)?.unit.clone(),
                speed_rpm: of(&names.speed)?,
                throttle_deg: of(&names.throttle)?,
                injection: of(&names.injection)?,
                map_kpa: of(&names.map)?,
                lambda: of(&names.lambda)?,
                boost_kpa: names.boost.as_deref().map(of).transpose()?,
                coolant_c: names.coolant.as_deref().map(of).transpose()?,
                cams_deg: match names.cams() {
                    Some([i, e]) => Some([of(i)?, of(e)?]),
                    None => None,
                },
                read: Some(d),
            })
        })
        .collect()
}

/// Refuses a record that is to judge and whose pieces the records that identify hold.
pub(super) fn apart(learn: &[Record], judge: &[Record], names: &Channels) -> Result<(), FuellingJobError> {
    let channels = [names.lambda.clone(), names.injection.clone()];
    let learnt: Vec<&Dataset> = learn.iter().filter_map(|r| r.read.as_ref()).collect();
    let known = Pieces::of(&learnt, &channels, false)?;
    for r in judge {
        if r.read.as_ref().is_some_and(|d| known.know(d, &channels, false)) {
            return Err(FuellingJobError::Seen { record: r.name.clone() });
        }
    }
    Ok(())
}
