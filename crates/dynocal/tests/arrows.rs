//! Arrows between the crates, read from their `Cargo.toml`: a crate stands on lower floors only.

use std::collections::BTreeMap;
use std::path::Path;

/// Floors of `docs/architecture.md`, from the ground. Crates of one floor do not see each other.
const FLOORS: &[&[&str]] = &[
    &["numerics"],
    &["ident", "label"],
    &["control", "fmu"],
    &["design", "plant", "files"],
    &["calib", "engine-fmu", "export", "report"],
    &["jobs"],
    &["studies", "dynocal"],
    &["cli", "workbench"],
    &["python"],
];

/// Arrows that the floors would allow and that are not wanted, with the reason.
const FORBIDDEN: &[(&str, &str, &str)] = &[
    ("calib", "plant", "a campaign sees a plant only as `&mut dyn Plant`"),
    ("export", "plant", "what is exported does not depend on what was tested"),
    ("report", "", "a report shows finished results and computes nothing"),
];

type Crates = BTreeMap<String, Vec<String>>;

/// Every crate of the workspace with the crates of ours that it stands on (not those of its tests).
fn crates() -> Crates {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut out = Crates::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let Ok(text) = std::fs::read_to_string(entry.unwrap().path().join("Cargo.toml")) else { continue };
        let manifest: toml::Table = toml::from_str(&text).unwrap();
        let name = short(manifest["package"]["name"].as_str().unwrap());
        let seen = |key: &str| {
            let table = manifest.get(key).and_then(|d| d.as_table()).into_iter().flatten();
            table.map(|(name, _)| name.clone()).filter(|n| n.starts_with("dynocal")).map(|n| short(&n))
        };
        out.insert(name, seen("dependencies").chain(seen("build-dependencies")).collect());
    }
    out
}

fn short(name: &str) -> String {
    name.strip_prefix("dynocal-").unwrap_or(name).to_string()
}

/// Everything that is wrong with the arrows, in words.
fn faults(crates: &Crates) -> Vec<String> {
    let floor = |name: &str| FLOORS.iter().position(|f| f.contains(&name));
    let mut out = Vec::new();
    for (name, seen) in crates {
        let Some(own) = floor(name) else {
            out.push(format!(
                "the crate `{name}` has no floor: give it one here and in docs/architecture.md"
            ));
            continue;
        };
        for other in seen {
            if floor(other).is_none_or(|f| f >= own) {
                out.push(format!("`{name}` stands on `{other}`, which is not below it"));
            }
            for (_, _, why) in FORBIDDEN.iter().filter(|f| f.0 == name && (f.1 == other || f.1.is_empty())) {
                out.push(format!("`{name}` stands on `{other}`: {why}"));
            }
        }
    }
    out
}

#[test]
fn crates_stand_on_lower_floors() {
    let crates = crates();
    assert!(crates.len() >= 10 && crates["jobs"].contains(&"calib".to_string()), "{crates:?}");
    let faults = faults(&crates);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn an_arrow_that_points_up_is_found() {
    let of = |name: &str, seen: &[&str]| {
        faults(&Crates::from([(name.into(), seen.iter().map(|s| (*s).to_string()).collect())])).len()
    };
    assert_eq!(of("design", &["ident", "numerics"]), 0);
    assert_eq!(of("design", &["plant"]), 1);
    assert_eq!(of("numerics", &["ident"]), 1);
    assert_eq!(of("calib", &["plant", "design"]), 1);
    assert_eq!(of("report", &["ident"]), 1);
    assert_eq!(of("attic", &["ident"]), 1);
    assert_eq!(of("jobs", &["studies"]), 1);
}
