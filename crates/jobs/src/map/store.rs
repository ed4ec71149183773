//! The run folder of a steady calibration.

use std::path::Path;

use dynocal_files::run_folder::RunFolder;
use dynocal_files::{FilesError, atomic, csv_io, json};
use dynocal_ident::data::{Channel, Dataset, Role};

use super::error::MapError;
use super::job::Job;
use super::journal;
use super::page;
use super::result::Mapped;

/// Folder of the maps, where `dynocal export RUN` finds them.
const STEP: &str = "steps/01-map";

/// Writes points, envelope, models, maps, the page and the summary.
///
/// # Errors
/// [`MapError::Files`], [`MapError::Page`].
pub fn write(folder: &RunFolder, job: &Job, mut found: Mapped) -> Result<Mapped, MapError> {
    let root = folder.path();
    let step = root.join(STEP);
    std::fs::create_dir_all(&step)
        .map_err(|e| FilesError::Write { path: step.display().to_string(), reason: e.to_string() })?;
    let mut files = vec!["report.html".to_string()];
    let mut named = |name: String| -> std::path::PathBuf {
        files.push(name.clone());
        root.join(name)
    };
    csv_io::write_dataset(&named("points.csv".into()), &table(&found))?;
    json::write_versioned(
        &named("points.json".into()),
        "dynocal/steady-points",
        1,
        &Body { points: &found.points },
    )?;
    json::write_versioned(&named("envelope.json".into()), "dynocal/envelope", 1, &found.envelope)?;
    for m in &found.models {
        let name = format!("response-{}.json", file_name(&m.response));
        json::write_versioned(&named(name), "dynocal/response", 1, &m.model)?;
    }
    json::write_versioned(&named(format!("{STEP}/static_map.json")), "dynocal/static-map", 2, &found.map)?;
    for i in &found.inverses {
        let name = format!("inverse-{}.csv", file_name(&i.input));
        atomic::write(&named(name), i.csv().as_bytes())?;
    }
    if root.join(journal::FILE).is_file() {
        files.push(journal::FILE.into());
    }
    found.files = files;
    page::write(&found, job, Path::new(root))?;
    folder.write_summary(&found)?;
    Ok(found)
}

/// Takes the results of an earlier run away, where there are some.
pub(super) fn forget(root: &Path) {
    let mut names: Vec<String> =
        ["summary.json", "report.html", "envelope.json", "points.csv", "points.json"]
            .map(String::from)
            .into();
    names.push(format!("{STEP}/static_map.json"));
    let written = std::fs::read_dir(root).into_iter().flatten().flatten();
    let of_a_response = |n: &String| {
        n.starts_with("response-") && n.ends_with(".json") || n.starts_with("inverse-") && n.ends_with(".csv")
    };
    names.extend(written.map(|f| f.file_name().to_string_lossy().into_owned()).filter(of_a_response));
    for name in names {
        // What is not there needs no removal.
        let _ = std::fs::remove_file(root.join(name));
    }
}

#[derive(serde::Serialize)]
struct Body<'a> {
    points: &'a [dynocal_calib::steady::day::DayPoint],
}

/// Channels may be called what files may not.
fn file_name(channel: &str) -> String {
    channel.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}

/// The points of the day as a table: factors and responses as measured, one row a point, those without a measurement left out.
fn table(found: &Mapped) -> Dataset {
    let rows: Vec<_> =
        found.points.iter().filter(|p| p.point.factors.iter().all(|v| v.is_finite())).collect();
    let layout = &found.layout;
    let channel = |name: &str, unit: &str, role, values: Vec<f64>| Channel {
        name: name.into(),
        unit: unit.into(),
        role,
        values,
    };
    let factors = layout.factors.iter().enumerate().map(|(k, f)| {
        channel(&f.name, &f.unit, Role::Input, rows.iter().map(|p| p.point.factors[k]).collect())
    });
    let responses = layout.responses.iter().enumerate().map(|(k, r)| {
        channel(&r.name, &r.unit, Role::Output, rows.iter().map(|p| p.point.responses[k]).collect())
    });
    let usable = rows.iter().map(|p| f64::from(u8::from(p.point.usable))).collect();
    let bed = rows.iter().map(|p| p.point.at_s).collect();
    let more =
        [channel("usable", "-", Role::Auxiliary, usable), channel("bed_time", "s", Role::Auxiliary, bed)];
    Dataset {
        name: "points".into(),
        sample_time_s: 1.0,
        channels: factors.chain(responses).chain(more).collect(),
        init_samples: 0,
        origin: "steady points".into(),
    }
}
