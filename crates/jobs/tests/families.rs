//! Conformance of every member of every table: it is listed with docs, and its documented keys are those that it takes.

use std::collections::BTreeSet;

use dynocal_jobs::families::{FAMILIES, Family, Refusal};
use dynocal_numerics::registry::{MemberDoc, ParamDoc};

/// A key that nothing has.
const NO_KEY: &str = "no_such_key_of_anything";

/// The keys that a member takes, as its refusal of an unknown one names them; none where it says nothing of keys.
fn taken(refusal: Refusal, name: &str) -> Option<BTreeSet<String>> {
    let keys = toml::Table::from_iter([(NO_KEY.to_string(), toml::Value::Integer(1))]);
    let said = refusal(name, &keys)?;
    let (_, expected) = said.split_once(NO_KEY)?;
    // serde: "unknown field `x`, expected one of `a`, `b`" or "there are no fields".
    Some(expected.split('`').skip(2).step_by(2).map(str::to_string).collect())
}

/// What is wrong with one member, in words.
fn faults(family: &str, refusal: Option<Refusal>, doc: &MemberDoc) -> Vec<String> {
    let mut out = Vec::new();
    let at = format!("{family}/{}", doc.name);
    if doc.name.is_empty() || doc.what.trim().is_empty() {
        out.push(format!("{at}: no name or no description"));
    }
    for p in doc.params {
        if p.name.is_empty() || p.unit.is_empty() || p.what.trim().is_empty() {
            out.push(format!("{at}.{}: without unit or description", p.name));
        }
    }
    let Some(refusal) = refusal else { return out };
    let Some(taken) = taken(refusal, doc.name) else {
        out.push(format!("{at}: takes an unknown key without a word"));
        return out;
    };
    let documented: BTreeSet<String> = doc.params.iter().map(|p| p.name.to_string()).collect();
    for key in taken.difference(&documented) {
        out.push(format!("{at}: the key `{key}` has no documentation"));
    }
    for key in documented.difference(&taken) {
        out.push(format!("{at}: the documented key `{key}` is not taken"));
    }
    out
}

#[test]
fn every_member_of_every_table_is_documented_key_by_key() {
    let mut all = Vec::new();
    for Family { name, docs, refusal, what } in FAMILIES {
        assert!(!what.is_empty(), "{name}");
        let docs = docs();
        let names: BTreeSet<&str> = docs.iter().map(|d| d.name).collect();
        assert!(!docs.is_empty() && names.len() == docs.len(), "{name}: empty, or a name twice");
        all.extend(docs.iter().flat_map(|d| faults(name, *refusal, d)));
    }
    assert!(all.is_empty(), "{}", all.join("\n"));
}

/// The check itself notices what it is there for.
#[test]
fn a_missing_documentation_is_noticed() {
    fn refusal(_: &str, _: &toml::Table) -> Option<String> {
        Some(format!("unknown field `{NO_KEY}`, expected `lo` or `hi`"))
    }
    fn silent(_: &str, _: &toml::Table) -> Option<String> {
        None
    }
    const LO: ParamDoc = ParamDoc { name: "lo", unit: "-", default: "", what: "least value" };
    const HI: ParamDoc = ParamDoc { name: "hi", ..LO };
    const TYPO: ParamDoc = ParamDoc { name: "hii", ..LO };
    let of = |refusal: Refusal, params: &'static [ParamDoc]| {
        faults("signals", Some(refusal), &MemberDoc { name: "a", what: "b", params }).len()
    };
    assert_eq!(of(refusal, &[LO, HI]), 0);
    assert_eq!(of(refusal, &[LO]), 1);
    assert_eq!(of(refusal, &[LO, HI, TYPO]), 1);
    assert_eq!(of(silent, &[LO, HI]), 1);
    assert_eq!(of(refusal, &[LO, ParamDoc { name: "hi", unit: "", ..LO }]), 1);
}

/// The page of `calibrate` has every key of its spec.
#[test]
fn every_key_of_a_calibration_is_on_its_page() {
    fn keys(value: &toml::Value, out: &mut Vec<String>) {
        match value {
            toml::Value::Table(t) => t.iter().for_each(|(k, v)| {
                out.push(k.clone());
                keys(v, out);
            }),
            toml::Value::Array(a) => a.iter().for_each(|v| keys(v, out)),
            _ => {}
        }
    }
    let page = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/calibrate.md");
    let page = std::fs::read_to_string(page).unwrap();
    let mut spec = toml::Table::try_from(dynocal_jobs::calibrate::spec::CalibrateSpec::default()).unwrap();
    // Its channels are those of one problem; its keys are documented beside their type.
    spec.insert("problem".into(), toml::Value::Table(toml::Table::new()));
    let mut all = Vec::new();
    keys(&toml::Value::Table(spec), &mut all);
    // Absent by default.
    all.extend(
        ["gains", "trim", "demand", "given", "given_rate_per_s", "step", "step_given", "record"]
            .map(str::to_string),
    );
    let named = |key: &String| {
        let places = page.split('`').skip(1).step_by(2);
        places.flat_map(|code| code.split(['.', ' ', ','])).any(|word| word == key)
    };
    let missing: Vec<&String> = all.iter().filter(|k| !named(k)).collect();
    assert!(all.len() > 50 && missing.is_empty(), "{missing:?} of {}", all.len());
}
