//! Tunes of open ECUs: read as they are, changed in the named label only.

use std::path::{Path, PathBuf};

use dynocal_export::tune::ini::Definition;
use dynocal_export::tune::msq::Tune;
use dynocal_export::tune::table::TuneTable;
use dynocal_numerics::rng::Rng64;

const SMALL: &str = "<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>\n<msq xmlns=\"http://www.msefi.com/:msq\">\r\n\
<bibliography author=\"B\u{fc}rgi\" tuneComment=\"20 \u{b0}C\"/>\n<versionInfo fileFormat=\"5.0\" nPages=\"1\" signature=\"speeduino 202501\"/>\n\
<page>\n<constant name=\"unit\">\"\u{b0}C\"</constant>\n<constant digits=\"1\" name=\"reqFuel\" units=\"ms\">8.6</constant>\n\
<constant cols=\"3\" digits=\"0\" name=\"veTable\" rows=\"2\" units=\"%\">\n    40.0 41.0 42.0 \n    50.0 51.0 52.0 \n</constant>\n\
<constant cols=\"1\" digits=\"0\" name=\"rpmBins\" rows=\"3\" units=\"RPM\">\n 500.0\n 1000.0\n 2000.0\n</constant>\n</page>\n</msq>\n";

const DEFINITION: &str = "[Constants]\npage = 1\n veTable = array, U08, 0, [2x3], \"%\", 1.0, 0.0, 0.0, 255.0, 0 ; a comment, with commas\n\
reqFuel = scalar, U08, 24, \"ms\", 0.1, 0.0, 0.0, 25.5, 1\n mode = bits, U08, 3, [0:1], \"a\", \"b\"\n#if LAMBDA\n only = scalar, U08, 1, \"-\", 1, 0, 0, 2, 0\n#else\n\
 other = scalar, S16, 1, \"; %\", 0.5, 10, {lo}, {hi}, 0\n#endif\n[TableEditor]\n table = veTable1Tbl, veTable1Map, \"VE, Table\", 2\n xBins = rpmBins, rpm\n\
 yBins = fuelLoadBins, fuelLoad\n zBins = veTable\n[VeAnalyze]\n veAnalyzeMap = veTable1Tbl, afrTable1Tbl, afr, egoCorrection\n";

fn latin(text: &str) -> Vec<u8> {
    text.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect()
}

fn reference(name: &str) -> Option<PathBuf> {
    let dir = std::env::var("DYNOCAL_REFERENCE_DIR").ok();
    if dir.is_none() {
        println!("SKIPPED: DYNOCAL_REFERENCE_DIR is not set");
    }
    dir.map(|d| Path::new(&d).join("data/open_ecu").join(name))
}

/// Bytes that differ, as ranges in the first text, by longest common head and tail of what is between.
fn differing(a: &[u8], b: &[u8]) -> (usize, usize) {
    let head = a.iter().zip(b).take_while(|(x, y)| x == y).count();
    let tail = a[head..].iter().rev().zip(b[head..].iter().rev()).take_while(|(x, y)| x == y).count();
    (head, a.len() - tail)
}

#[test]
fn only_the_named_values_change() {
    let tune = Tune::parse("small.msq", latin(SMALL)).unwrap();
    assert_eq!(tune.signature, "speeduino 202501");
    let c = tune.constant("veTable").unwrap();
    assert_eq!((c.rows, c.columns, c.values.clone()), (2, 3, vec![40.0, 41.0, 42.0, 50.0, 51.0, 52.0]));
    let held = Definition::parse(DEFINITION.as_bytes(), &[]).labels.remove("veTable").unwrap();
    let changed = tune.with("veTable", &[40.0, 41.0, 142.0, 50.0, 51.0, 52.0], Some(&held)).unwrap();
    let wanted = latin(&SMALL.replace("42.0", "142.0"));
    assert_eq!(changed.bytes(), wanted, "the bytes around stay, those of two-byte characters too");
    assert_eq!(tune.with("veTable", &c.values, Some(&held)).unwrap().bytes(), latin(SMALL));
}

#[test]
fn what_the_ecu_cannot_hold_is_refused() {
    let tune = Tune::parse("small.msq", latin(SMALL)).unwrap();
    let definition = Definition::parse(DEFINITION.as_bytes(), &[]);
    let refused = |name: &str, values: &[f64], word: &str| {
        let e = tune.with(name, values, definition.labels.get(name)).unwrap_err().to_string();
        assert!(e.contains(word) && e.contains(name), "{e}");
    };
    refused("veTable", &[40.0, 41.0, 42.5, 50.0, 51.0, 52.0], "whole steps of 1 %");
    refused("veTable", &[40.0, 41.0, 256.0, 50.0, 51.0, 52.0], "0 to 255");
    refused("veTable", &[40.0, 41.0, f64::NAN, 50.0, 51.0, 52.0], "finite");
    refused("veTable", &[40.0], "2 x 3");
    refused("reqFuel", &[8.65], "0.1 ms");
    refused("veTabel", &[8.65], "did you mean `veTable`");
    let e = tune.with("reqFuel", &[8.65], None).unwrap_err().to_string();
    assert!(e.contains("line 7") && e.contains("1 decimals"), "{e}");
}

#[test]
fn the_definition_is_read_where_it_counts() {
    let d = Definition::parse(DEFINITION.as_bytes(), &[]);
    assert!(
        d.labels.contains_key("other") && !d.labels.contains_key("only") && !d.labels.contains_key("mode")
    );
    assert!(Definition::parse(DEFINITION.as_bytes(), &["LAMBDA"]).labels.contains_key("only"));
    let other = &d.labels["other"];
    assert_eq!((other.scale, other.offset, other.unit.as_str(), other.least), (0.5, 10.0, "; %", None));
    assert_eq!(other.range(), (-16_379.0, 16_388.5));
    assert_eq!(d.labels["veTable"].shape, (2, 3));
    assert_eq!(d.tables[0].x, ("rpmBins".into(), "rpm".into()));
    assert_eq!(d.analyse.as_ref().unwrap()[1], "afrTable1Tbl");
}

#[test]
fn the_files_of_a_real_car_are_read_and_changed_in_one_label() {
    let Some(path) = reference("CurrentTune.msq") else { return };
    let original = std::fs::read(&path).unwrap();
    let tune = Tune::read(&path).unwrap();
    let definition =
        Definition::parse(&std::fs::read(reference("mainController.ini").unwrap()).unwrap(), &[]);
    let ve = tune.constant("veTable").unwrap();
    let held = &definition.labels["veTable"];
    assert_eq!(((ve.rows, ve.columns), held.shape), ((16, 16), (16, 16)));
    let table = TuneTable::parse("t", &std::fs::read(reference("Current.table").unwrap()).unwrap()).unwrap();
    assert_eq!(table.x, tune.constant("rpmBins").unwrap().values, "the table has the axes of the tune");
    let values: Vec<f64> = ve.values.iter().map(|v| v + 1.0).collect();
    let changed = tune.with("veTable", &values, Some(held)).unwrap();
    assert_eq!(changed.constant("veTable").unwrap().values, values);
    let (from, to) = differing(&original, changed.bytes());
    let text: String = original[..to].iter().map(|b| char::from(*b)).collect();
    let label = text.rfind("<constant").unwrap();
    assert!(label < from && text[label..from].contains("\"veTable\""), "{}", &text[label..label + 80]);
    assert!(!text[from..].contains("constant"), "one label is touched");
    for (a, b) in tune.constants.iter().zip(&changed.constants).filter(|(a, _)| a.name != "veTable") {
        assert_eq!((&a.name, &a.values), (&b.name, &b.values));
    }
    assert_eq!(tune.options, changed.options);
}

#[test]
fn a_table_comes_back() {
    let table = TuneTable {
        x_name: "rpm".into(),
        x: vec![500.0, 1000.0],
        y_name: "a <b>".into(),
        y: vec![16.0, 26.5, 30.0],
        z: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.5],
    };
    assert_eq!(TuneTable::parse("t", table.text(1).as_bytes()).unwrap(), table);
}

#[test]
fn no_mutant_panics() {
    let table =
        TuneTable { x_name: "r".into(), x: vec![1.0], y_name: "l".into(), y: vec![1.0], z: vec![3.0] };
    let originals = [latin(SMALL), table.text(0).into_bytes(), DEFINITION.as_bytes().to_vec()];
    for (k, original) in originals.iter().enumerate() {
        let mut rng = Rng64::stream(20_261_123, k as u64);
        for _ in 0..20_000 {
            let mut bytes = original.clone();
            for _ in 0..=rng.below(4) {
                let at = rng.below(bytes.len().max(1));
                match rng.below(4) {
                    _ if bytes.is_empty() => break,
                    0 => bytes[at] ^= 1 << rng.below(8),
                    1 => bytes[at] = rng.below(256) as u8,
                    2 => bytes.truncate(at),
                    _ => {
                        let piece = bytes[at..(at + 1 + rng.below(60)).min(bytes.len())].to_vec();
                        bytes.splice(at..at, piece);
                    }
                }
            }
            if let Ok(tune) = Tune::parse("mutant.msq", bytes.clone()) {
                for c in &tune.constants {
                    let other: Vec<f64> = c.values.iter().map(|v| v + 1.0).collect();
                    let _ = tune.with(&c.name, &other, None);
                }
            }
            let _ = TuneTable::parse("mutant.table", &bytes);
            let definition = Definition::parse(&bytes, &["LAMBDA"]);
            definition.labels.values().for_each(|h| drop((h.check(1.0), h.decimals())));
        }
    }
}
