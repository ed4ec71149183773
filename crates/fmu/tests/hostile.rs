//! Archives that are broken, foreign or made to harm: each is refused with the file's name and what is wrong, none ends the program.

#![allow(clippy::disallowed_methods)] // broken files are written as they are

mod common;

use std::path::Path;

use common::{Entry, entries, made, pack};
use dynocal_fmu::{Description, FmuPlant, FmuSettings};
use dynocal_numerics::rng::Rng64;

const XML: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="unit" guid="{1}">
  <CoSimulation modelIdentifier="unit" canSerializeFMUstate="true"/>
  <TypeDefinitions><SimpleType name="share"><Real unit="%" min="0" max="100"/></SimpleType></TypeDefinitions>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="1" causality="input"><Real declaredType="share" start="2"/></ScalarVariable>
    <ScalarVariable name="y" valueReference="2" causality="output"><Real unit="Nm"/></ScalarVariable>
    <ScalarVariable name="gear" valueReference="3" causality="output"><Integer/></ScalarVariable>
  </ModelVariables>
</fmiModelDescription>"#;

fn refused(path: &Path, bytes: &[u8]) -> String {
    std::fs::write(path, bytes).unwrap();
    let e = FmuPlant::open(path, &FmuSettings::default()).err().expect("refused").to_string();
    assert!(e.contains("hostile.fmu"), "the message names no file: {e}");
    e
}

fn only(xml: &str) -> Vec<u8> {
    pack(&[("modelDescription.xml".into(), xml.into())])
}

#[test]
fn declared_types_give_units_and_limits() {
    let about = Description::parse("x.fmu", XML).unwrap();
    let u = &about.variables[0];
    assert_eq!((u.unit.as_str(), u.min, u.max, u.start), ("%", Some(0.0), Some(100.0), Some(2.0)));
    assert_eq!(about.variables[1].unit, "Nm");
    assert!(about.notes == ["`gear` is no floating-point scalar and is left out"], "{:?}", about.notes);
}

#[test]
fn faulty_descriptions_are_refused_with_their_line() {
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("hostile.fmu");
    let deep = format!("{}{}", "<a>".repeat(200_000), "</a>".repeat(200_000));
    let table = [
        ("fmiVersion=\"2.0\"", "fmiVersion=\"1.0\"", "line 2: found fmiVersion 1.0, expected 2.0 or 3.0"),
        ("guid=\"{1}\"", "", "line 2: <fmiModelDescription> has no `guid`"),
        ("CoSimulation", "ModelExchange", "no <CoSimulation>"),
        (
            "modelIdentifier=\"unit\"",
            "modelIdentifier=\"../unit\"",
            "line 3: found the model identifier `../unit`",
        ),
        ("start=\"2\"", "start=\"two\"", "line 6: found start=\"two\", expected a finite number"),
        ("max=\"100\"", "max=\"inf\"", "line 4: found max=\"inf\", expected a finite number"),
        ("max=\"100\"", "max=\"-1\"", "line 6: `u`: found min 0 above max -1"),
        ("declaredType=\"share\"", "declaredType=\"shore\"", "found no type `shore`"),
        ("valueReference=\"2\"", "valueReference=\"-2\"", "line 7: `y`: found the value reference `-2`"),
        ("name=\"y\"", "name=\"u\"", "line 7: found the variable `u` twice"),
        ("causality=\"output\"", "causality=\"local\"", "found no floating-point output"),
        ("  <ModelVariables>", "  <ModelVariables", "modelDescription.xml, line"),
        (
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>",
            "<!DOCTYPE a [<!ENTITY b \"c\">]>",
            "modelDescription.xml, line",
        ),
        ("<ModelVariables>", &deep, "modelDescription.xml"),
    ];
    for (from, to, part) in table {
        let xml = XML.replace(from, to);
        assert_ne!(xml, XML, "{from}");
        let e = refused(&path, &only(&xml));
        assert!(e.contains(part), "{part}: {}", e.chars().take(300).collect::<String>());
    }
    // Cut anywhere, it is no description any more.
    for n in (0..XML.len() - 1).step_by(7) {
        assert!(refused(&path, &only(&XML[..n])).contains("modelDescription.xml"), "{n}");
    }
    let e = refused(&path, &only(XML));
    assert!(e.contains("no binary for this platform") && e.contains("sources only"), "{e}");
}

#[test]
fn faulty_archives_are_refused() {
    let tmp = tempfile::tempdir().unwrap();
    let path = tmp.path().join("hostile.fmu");
    assert!(refused(&path, b"hello").contains("is no FMU (a zip archive)"));
    assert!(refused(&path, b"").contains("is no FMU (a zip archive)"));
    assert!(refused(&path, &pack(&[("readme".into(), b"x".to_vec())])).contains("modelDescription.xml"));
    let latin = pack(&[("modelDescription.xml".into(), XML.replace("Nm", "\u{1}").into_bytes())]);
    assert!(refused(&path, &latin).contains("modelDescription.xml"));
    let e = refused(&path, &pack(&[("modelDescription.xml".into(), vec![b'<', 0xe9])]));
    assert!(e.contains("is no UTF-8 text"), "{e}");
    // 65 MB of blanks in 65 kB.
    let e = refused(&path, &pack(&[("modelDescription.xml".into(), vec![b' '; 65 << 20])]));
    assert!(e.contains("holds more than 67108864 bytes"), "{e}");
    let whole = pack(&[("modelDescription.xml".into(), XML.into()), ("resources/a".into(), vec![7; 4000])]);
    for n in (0..whole.len() - 1).step_by(31) {
        refused(&path, &whole[..n]);
    }
}

/// With a binary that fits the platform.
#[test]
fn faulty_units_are_refused() {
    let tmp = tempfile::tempdir().unwrap();
    let Some(paths) = made(tmp.path()) else { return };
    let path = tmp.path().join("hostile.fmu");
    let (two, three) = (entries(&paths[0]), entries(&paths[1]));
    let is_binary = |e: &&Entry| e.0.starts_with("binaries/");
    let with = |change: &dyn Fn(&mut Entry)| {
        let mut all = two.clone();
        all.iter_mut().for_each(change);
        pack(&all)
    };
    let xml = |from: &'static str, to: &'static str| {
        with(&move |e: &mut Entry| {
            if e.0 == "modelDescription.xml" {
                e.1 = String::from_utf8(e.1.clone()).unwrap().replace(from, to).into_bytes();
            }
        })
    };
    let e = refused(&path, &xml("000000000001}", "000000000009}"));
    assert!(e.contains("fmi2Instantiate gave no instance: does the guid"), "{e}");
    let e = refused(&path, &xml("modelIdentifier=\"InjMap\"", "modelIdentifier=\"Other\""));
    assert!(
        e.contains("no binary for this platform (binaries/linux64/Other.so); the archive has: binaries/"),
        "{e}"
    );
    // A promise that the binary does not keep: the state comes back by making the steps again.
    std::fs::write(&path, xml("canSerializeFMUstate=\"false\"", "canSerializeFMUstate=\"true\"")).unwrap();
    let mut plant = FmuPlant::open(&path, &FmuSettings::default()).unwrap();
    use dynocal_ident::plant::{Plant, PlantState};
    let (state, mut y, mut again) = (plant.save(), [0.0], [0.0]);
    plant.step(&[1500.0, 80.0], 0.1, &mut y).unwrap();
    plant.restore(&state).unwrap();
    plant.step(&[1500.0, 80.0], 0.1, &mut again).unwrap();
    assert_eq!(y, again);
    assert!(
        plant.restore(&PlantState(vec![0.0, 1.0])).is_err() && plant.restore(&PlantState(vec![])).is_err()
    );
    // Another interface under this description, no library at all, half a library.
    let other = three.iter().find(is_binary).unwrap().1.clone();
    let swap = |bytes: Vec<u8>| {
        with(&move |e: &mut Entry| {
            if e.0.starts_with("binaries/") {
                e.1 = bytes.clone();
            }
        })
    };
    let e = refused(&path, &swap(other));
    assert!(e.contains("fmi2Instantiate"), "{e}");
    let e = refused(&path, &swap(b"no library".to_vec()));
    assert!(e.contains("InjMap.so"), "{e}");
    refused(&path, &swap(Vec::new()));
    let half = &two.iter().find(is_binary).unwrap().1;
    for n in [half.len() / 2, half.len() / 10, 70, 50] {
        let e = refused(&path, &swap(half[..n].to_vec()));
        assert!(!cfg!(target_os = "linux") || e.contains("its binary is cut"), "{n}: {e}");
    }
    // Out of the folder, and a bomb: 1.1 GB of zeros in 1 MB.
    let mut outside = two.clone();
    outside.push(("resources/../../../outside".into(), b"x".to_vec()));
    let e = refused(&path, &pack(&outside));
    assert!(e.contains("would lie outside the archive"), "{e}");
    let mut bomb = two.clone();
    bomb.push(("resources/zeros".into(), vec![0; (1 << 30) + 1]));
    let bytes = pack(&bomb);
    drop(bomb);
    let e = refused(&path, &bytes);
    assert!(e.contains("`resources/zeros`: the archive unpacks to more than 1073741824 bytes"), "{e}");
}

#[test]
fn no_mutant_panics_or_takes_long() {
    let tmp = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    let path = tmp.path().join("hostile.fmu");
    let archive = pack(&[("modelDescription.xml".into(), XML.into()), ("resources/a".into(), vec![7; 200])]);
    let busy_s = || {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        text.split_whitespace().next()?.parse::<f64>().ok().map(|ns| ns * 1e-9)
    };
    let mut rng = Rng64::stream(20_261_122, 13);
    let (mut slowest, mut faulty) = (0.0f64, 0);
    for k in 0..40_000 {
        let original = if k % 2 == 0 { archive.as_slice() } else { XML.as_bytes() };
        let mut bytes = original.to_vec();
        for _ in 0..=rng.below(4) {
            let at = rng.below(bytes.len().max(1)).min(bytes.len().saturating_sub(1));
            match rng.below(4) {
                0 if !bytes.is_empty() => bytes[at] ^= 1 << rng.below(8),
                1 => bytes.truncate(at),
                2 => drop(bytes.splice(at..at, *b"99999999999")),
                _ => drop(bytes.drain(at..(at + rng.below(16)).min(bytes.len()))),
            }
        }
        let start = busy_s();
        if k % 2 == 0 {
            // There is no binary in it: every mutant is refused.
            refused(&path, &bytes);
        } else if let Ok(text) = std::str::from_utf8(&bytes) {
            faulty += usize::from(Description::parse("hostile.fmu", text).is_err());
        }
        slowest = slowest.max(busy_s().zip(start).map_or(0.0, |(b, a)| b - a));
    }
    println!("40000 mutants, {faulty} faulty descriptions, slowest {:.0} ms", slowest * 1e3);
    assert!(faulty > 0 && slowest < 1.0, "{faulty}, {slowest}");
}
