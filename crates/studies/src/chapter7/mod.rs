//! Study `chapter7`: the dynamic calibration of thesis chapter 7 on the engine of the thesis, its tables and the figures of its text
//! beside ours.
//!
//! Models as in sections 7.4.3 and 7.4.4 (the tasks of `chapter5`), one campaign of `calibrate` whose map is refined twice by records
//! that it drives itself (section 7.8.2), one more that ends with its optimal records, which the map has not seen, and the optimisation
//! of the identification record by ways of section 7.5, played on the engine without loops.

mod checks;
mod page;
mod work;

use dynocal_jobs::calibrate::spec::CalibrateSpec;
use dynocal_numerics::registry::MemberDoc;
use serde_json::json;

use crate::{Options, Study, StudyError, Surroundings, Task};

pub(super) const STUDY: Study = Study {
    doc: MemberDoc {
        name: "chapter7",
        what: "Dynamic calibration of thesis chapter 7: models, optimal records, inverse maps, refinement, thesis beside ours",
        params: &[],
    },
    tasks,
    reduce: checks::checks,
    sections: page::sections,
};

const CALIBRATION: &str = "calibration";
/// A run so short that its numbers mean nothing.
const SHORTEST: &str = include_str!("../shortest.toml");
/// Beyond the seed of the campaign: that of the one whose optimal records are unseen.
const UNSEEN: u64 = 100;

fn tasks(o: &Options) -> Vec<Task> {
    let spec = if o.reduced { toml::from_str(SHORTEST) } else { Ok(CalibrateSpec::default()) };
    let spec = spec.map(|s| {
        let mut s = CalibrateSpec { seed: o.seed, ..s };
        s.invert.refine = if o.reduced { 1 } else { 2 };
        // The thesis' way from records to a map: terms, refined by records that the map drives.
        s.invert.structure = "structured".into();
        s.invert.rivals = vec!["published_7_18".into()];
        s.invert.at_rest.enabled = false;
        s.design.criterion = "d".into();
        s
    });
    let inputs = spec.as_ref().map_or_else(|e| json!(e.to_string()), |s| json!([s, UNSEEN]));
    let reduced = o.reduced;
    let run = move |around: &Surroundings| {
        let failed = |reason: String| StudyError::Task { what: CALIBRATION.into(), reason };
        let spec = spec.as_ref().map_err(|e| failed(e.to_string()))?;
        let found = work::calibrated(spec, reduced, around)?;
        serde_json::to_value(found).map_err(|e| failed(e.to_string()))
    };
    let mut out = crate::chapter5::section_7_4(o);
    out.push(Task { name: CALIBRATION.into(), inputs, run: Box::new(run) });
    out
}
