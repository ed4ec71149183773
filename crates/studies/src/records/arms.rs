//! Engines and arms.

use toml::{Table, Value};

/// A plant with the spec of its calibration.
pub(super) struct Engine {
    pub(super) name: &'static str,
    pub(super) what: &'static str,
    pub(super) spec: &'static str,
    pub(super) fuelling: Option<&'static str>,
    /// Keys of the plant.
    plant: &'static str,
}

pub(super) static ENGINES: [Engine; 3] = [
    Engine {
        name: "thesis",
        what: "engine of the thesis, real bed",
        spec: include_str!("../../../../examples/gtdi/calibrate.toml"),
        fuelling: None,
        plant: "bed = { real = true }",
    },
    Engine {
        name: "pfi_1_6l",
        what: "port injection with fuel by measured states, real bed",
        spec: include_str!("../../../../examples/pfi_1_6l/calibrate.toml"),
        fuelling: Some(include_str!("../../../../examples/pfi_1_6l/fuelling.toml")),
        plant: "",
    },
    Engine {
        name: "noisy",
        what: "engine of the thesis, ideal bed with white noise of 5 Nm and 0.05",
        spec: include_str!("../../../../examples/gtdi/calibrate.toml"),
        fuelling: None,
        plant: "torque_noise_nm = 5.0\nlambda_noise = 0.05",
    },
];

/// How records are made and how large models may be.
pub(super) struct Arm {
    pub(super) name: &'static str,
    pub(super) what: &'static str,
    records: i64,
    signal: &'static str,
    doublings: i64,
    /// Criterion and model of a further record.
    pub(super) design: Option<(&'static str, &'static str)>,
}

/// Records of random levels are the rival; their numbers make its curve.
pub(super) const RANDOM: [&str; 5] = ["random-1", "random-2", "random-3", "random-4", "random-6"];

const fn arm(
    name: &'static str,
    what: &'static str,
    records: i64,
    signal: &'static str,
    doublings: i64,
) -> Arm {
    Arm { name, what, records, signal, doublings, design: None }
}

const fn designed(name: &'static str, what: &'static str, design: (&'static str, &'static str)) -> Arm {
    Arm { name, what, records: 2, signal: "aprbs", doublings: 0, design: Some(design) }
}

pub(super) static ARMS: [Arm; 17] = [
    arm("random-1", "one record of random levels", 1, "aprbs", 0),
    arm("random-2", "two records of random levels", 2, "aprbs", 0),
    arm("random-3", "three records of random levels", 3, "aprbs", 0),
    arm("random-4", "four records of random levels", 4, "aprbs", 0),
    arm("random-6", "six records of random levels", 6, "aprbs", 0),
    arm("chosen-2", "two records of levels that tell most", 2, "informative", 0),
    arm("chosen-3", "three records of levels that tell most", 3, "informative", 0),
    arm("chosen-4", "four records of levels that tell most", 4, "informative", 0),
    arm("richer-2", "two records of random levels, models of twice the terms compete", 2, "aprbs", 1),
    arm("richer-3", "three records of random levels, models of twice the terms compete", 3, "aprbs", 1),
    arm("richer-4", "four records of random levels, models of twice the terms compete", 4, "aprbs", 1),
    arm(
        "both-2",
        "two records of levels that tell most, models of twice the terms compete",
        2,
        "informative",
        1,
    ),
    arm(
        "both-3",
        "three records of levels that tell most, models of twice the terms compete",
        3,
        "informative",
        1,
    ),
    designed("design-d", "two records of random levels, one D-optimal for the models", ("d", "chosen")),
    designed("design-i", "two records of random levels, one I-optimal for the models", ("i", "chosen")),
    designed(
        "design-i-richest",
        "two records of random levels, one I-optimal for the richest models",
        ("i", "richest"),
    ),
    designed("design-auto", "two records of random levels, one as the lack of fit asks", ("auto", "chosen")),
];

impl Arm {
    /// Whether it is part of a reduced study.
    pub(super) fn counts(&self, reduced: bool) -> bool {
        !reduced || ["random-1", "random-2", "chosen-2", "design-auto"].contains(&self.name)
    }
}

/// A table of `parent`, made where it is not there.
fn table<'a>(parent: &'a mut Table, name: &str) -> Option<&'a mut Table> {
    parent.entry(name).or_insert_with(|| Value::Table(Table::new())).as_table_mut()
}

impl Engine {
    /// All that its arms run.
    pub(super) fn texts(&self, reduced: bool) -> Vec<Result<String, String>> {
        ARMS.iter().filter(|a| a.counts(reduced)).map(|a| self.text(a, reduced, None)).collect()
    }

    /// The spec of an arm; `model` is the fuelling that another arm has identified.
    pub(super) fn text(&self, arm: &Arm, reduced: bool, model: Option<&str>) -> Result<String, String> {
        let mut spec: Table = self.spec.parse().map_err(|e: toml::de::Error| e.to_string())?;
        let plant: Table = self.plant.parse().map_err(|e: toml::de::Error| e.to_string())?;
        let missing = || "a table of the spec is none".to_string();
        table(&mut spec, "plant").ok_or_else(missing)?.extend(plant);
        let excite = table(&mut spec, "excite").ok_or_else(missing)?;
        excite.insert("signal".into(), arm.signal.into());
        excite.insert("identification_records".into(), arm.records.into());
        excite.insert("validation_records".into(), 5.into());
        if reduced {
            excite.insert("record_s".into(), 18.0.into());
            excite.insert("validation_records".into(), 2.into());
        }
        let identify = table(&mut spec, "identify").ok_or_else(missing)?;
        identify.insert("doublings".into(), arm.doublings.into());
        if reduced {
            identify.insert("terms".into(), 8.into());
        }
        let design = table(&mut spec, "design").ok_or_else(missing)?;
        design.insert("enabled".into(), arm.design.is_some().into());
        if reduced {
            design.insert("record_s".into(), 18.0.into());
        }
        if let Some((criterion, of)) = arm.design {
            design.insert("criterion".into(), criterion.into());
            design.insert("model".into(), of.into());
        }
        if let (Some(file), Some(_)) = (model, self.fuelling) {
            let fuelling = table(&mut spec, "fuelling").ok_or_else(missing)?;
            fuelling.remove("spec");
            fuelling.insert("file".into(), file.into());
            fuelling.insert(
                "channels".into(),
                Table::from_iter([("coolant".to_string(), Value::from("coolant"))]).into(),
            );
        }
        toml::to_string(&spec).map_err(|e| e.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_jobs::calibrate::job;

    #[test]
    fn every_arm_is_a_spec() {
        for engine in &ENGINES {
            for arm in &ARMS {
                for model in [None, Some("random-1/fuelling.json")] {
                    let text = engine.text(arm, false, model).unwrap();
                    let campaign = job::parse("calibrate.toml", &text, None, None)
                        .unwrap_or_else(|e| panic!("{e}\n{text}"));
                    assert_eq!(campaign.spec.excite.identification_records as i64, arm.records);
                    assert_eq!(campaign.spec.design.enabled, arm.design.is_some());
                }
            }
        }
        assert!(RANDOM.iter().all(|r| ARMS.iter().any(|a| a.name == *r)));
    }
}
