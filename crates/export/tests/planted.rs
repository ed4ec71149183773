//! Faults that were planted in files: each is noticed, with its line where there is one.

#![allow(clippy::disallowed_methods)] // files of tests are written as they are

mod common;

use dynocal_export::format::{Keys, read, write};
use dynocal_numerics::interval::Interval;

/// Replaces the first `from` in the export of the test's maps.
fn planted(format: &str, from: &str, to: &str) -> (String, Vec<u8>) {
    let file = write(&common::maps(), format, &Keys::default()).unwrap().remove(0);
    let text = String::from_utf8(file.bytes).unwrap();
    assert!(text.contains(from), "{format}: `{from}` is not in the file");
    (file.name, text.replacen(from, to, 1).into_bytes())
}

fn refused(format: &str, fault: &str, from: &str, to: &str, says: &str) {
    let (name, bytes) = planted(format, from, to);
    match read(&name, &bytes) {
        Ok(_) => panic!("{format}, {fault}: was read"),
        Err(e) => assert!(e.to_string().contains(says), "{format}, {fault}: {e}"),
    }
}

#[test]
fn dcm() {
    let cases = [
        (
            "short row",
            "  WERT 12.5 12.0 13.25\r\n",
            "  WERT 12.5 12.0\r\n",
            "found 2 values before a row, expected 3",
        ),
        ("missing END", "END\r\n\r\nKENNLINIE", "\r\n\r\nKENNLINIE", "is END missing?"),
        ("no END at all", "END\r\n\r\nGRUPPENKENNFELD AIR_MAP", "\r\n", ""),
        (
            "decimal comma",
            "12.5 12.0",
            "12,5 12.0",
            "found `12,5`, expected a finite number with a decimal point",
        ),
        ("equal points", "ST/X 0.0 50.0 100.0", "ST/X 0.0 50.0 50.0", "goes from 50 to 50"),
        (
            "version",
            "KONSERVIERUNG_FORMAT 2.0",
            "KONSERVIERUNG_FORMAT 9.9",
            "line 8: found version 9.9, expected 2.x",
        ),
        ("NaN", "WERT 2.0 8.5", "WERT NaN 8.5", "found `NaN`"),
        ("unknown keyword", "  EINHEIT_W \"mg\"", "  EINHEIT_Q \"mg\"", "unknown keyword `EINHEIT_Q`"),
        ("unknown object", "KENNLINIE THR", "KENNKURVE THR", "unknown keyword `KENNKURVE`"),
        ("dangling axis", "*SSTX SPD_AXIS", "*SSTX SPD_AXES", "no STUETZSTELLENVERTEILUNG"),
        ("count", "KENNLINIE THR_CURVE 3", "KENNLINIE THR_CURVE 4", "found 3 ST/X values, expected 4"),
    ];
    for (fault, from, to, says) in cases {
        refused("dcm", fault, from, to, says);
    }
}

/// Not faults: a byte-order mark, Windows-1252 with a degree sign, numbers split in another way.
#[test]
fn dcm_in_other_hands() {
    let (name, plain) = planted("dcm", "EINHEIT_W \"deg\"", "EINHEIT_W \"deg\"");
    let want = read(&name, &plain).unwrap();
    let mut marked = b"\xef\xbb\xbf".to_vec();
    marked.extend(&plain);
    assert_eq!(read(&name, &marked).unwrap().characteristics, want.characteristics);
    let latin = String::from_utf8(plain.clone()).unwrap();
    let at = latin.find("\"deg\"").unwrap();
    let mut bytes = plain.clone();
    bytes.splice(at + 1..at + 4, [0xb0]);
    let read_latin = read(&name, &bytes).unwrap();
    assert!(read_latin.provenance.run.contains("Windows1252"), "{}", read_latin.provenance.run);
    assert!(read_latin.characteristics.iter().any(|c| c.unit == "°" || c.axes.iter().any(|a| a.unit == "°")));
    let split =
        String::from_utf8(plain).unwrap().replace("WERT 12.5 12.0 13.25", "WERT 12.5\r\n  WERT 12.0 13.25");
    assert_eq!(read(&name, split.as_bytes()).unwrap().characteristics, want.characteristics);
}

/// What an ECU's data set has beside maps: variants, functions, names of structures, text, truth values, hexadecimal numbers.
#[test]
fn dcm_of_an_ecu() {
    let text = "* INCA\nKONSERVIERUNG_FORMAT 2.0\nMODULKOPF MODUL \"x\"\nFUNKTIONEN\n  FKT Ign \"1.2\" \"Ignition\"\nEND\n\
        VARIANTENKODIERUNG\n  KRITERIUM Gear Hand Auto\nEND\nFESTWERT SW\n  WERT true\nEND\nFESTWERT HEX\n  WERT 0x1F\nEND\n\
        FESTWERT Name\n  TEXT \"abc\"\nEND\nTEXTSTRING Ts\n  TEXT \"hello\"\nEND\nKENNLINIE Words 2\n  ST_TX/X \"low\" \"high\"\n  WERT 1.0 2.0\nEND\n\
        FESTWERTEBLOCK Blk 2 @ 2\n  WERT 1.0 2.0\n  WERT 3.0 4.0\nEND\nKENNFELD Ign.tab[0] 2 2\n  DISPLAYNAME tab\n  VAR Gear=Hand\n\
        \tST/X\t1000.0\t2000.0\n  ST/Y 10.0\n  WERT 1.0 2.0\n  ST/Y 20.0\n  WERT 3.0 4.0\nEND\n";
    let package = read("ecu.dcm", text.as_bytes()).unwrap();
    let values = |name: &str| {
        let c = package.characteristics.iter().find(|c| c.name == name);
        c.unwrap_or_else(|| panic!("no `{name}`")).values.clone()
    };
    assert_eq!((values("SW"), values("HEX")), (vec![1.0], vec![31.0]));
    assert_eq!((values("Blk"), values("Ign.tab[0]")), (vec![1.0, 2.0, 3.0, 4.0], vec![1.0, 2.0, 3.0, 4.0]));
    assert_eq!(package.characteristics.len(), 4);
    let words = ["Name", "Ts", "Words"].map(|name| format!("`{name}`: it holds words"));
    assert_eq!(package.left_out, words);
    // What an ECU calls its maps comes back from the formats of ECUs, and becomes an identifier in code.
    for format in ["dcm", "cdfx", "json"] {
        let file = write(&package, format, &Keys::default()).unwrap().remove(0);
        let back = read(&file.name, &file.bytes).unwrap_or_else(|e| panic!("{format}: {e}"));
        assert!(back.characteristics.iter().any(|c| c.name == "Ign.tab[0]"), "{format}");
    }
    for format in ["c", "python", "simulink", "a2l"] {
        let files = write(&package, format, &Keys::default()).unwrap();
        let text: String = files.iter().map(|f| String::from_utf8_lossy(&f.bytes).into_owned()).collect();
        assert!(text.contains("Ign_tab_0_") && !text.contains("Ign.tab"), "{format}");
    }
}

#[test]
fn cdfx() {
    let map = "<VG><V>12.5</V><V>12.0</V><V>13.25</V></VG><VG><V>31.0</V><V>30.5</V><V>33.0</V></VG>";
    let turned =
        "<VG><V>12.5</V><V>31.0</V></VG><VG><V>12.0</V><V>30.5</V></VG><VG><V>13.25</V><V>33.0</V></VG>";
    let cases = [
        (
            "foreign element",
            "<CATEGORY>MAP</CATEGORY>",
            "<CATEGORY>MAP</CATEGORY><PRICE>1</PRICE>",
            "<PRICE>",
        ),
        (
            "unknown category",
            "<CATEGORY>MAP</CATEGORY>",
            "<CATEGORY>MOP</CATEGORY>",
            "found the category `MOP`",
        ),
        ("dangling axis", "<SW-INSTANCE-REF>SPD_AXIS", "<SW-INSTANCE-REF>SPD", "refers to the axis `SPD`"),
        ("transposed map", map, turned, "found 3 groups of 2 values, expected 2 of 3"),
        ("text in V", "<V>12.5</V>", "<V>twelve</V>", "found `twelve` in V"),
        ("decimal comma", "<V>12.5</V>", "<V>12,5</V>", "found `12,5` in V"),
        ("broken XML", "</SW-VALUES-PHYS>", "</SW-VALUE>", "line"),
    ];
    for (fault, from, to, says) in cases {
        refused("cdfx", fault, from, to, says);
    }
}

#[test]
fn a2l() {
    let file = write(&common::maps(), "a2l", &Keys::default()).unwrap().remove(0);
    let text = String::from_utf8(file.bytes).unwrap();
    let cases = [
        ("dangling axis", "AXIS_PTS_REF SPD_AXIS_points", "AXIS_PTS_REF SPD", "SPD"),
        (
            "axis length",
            "NO_INPUT_QUANTITY DYN_MAP_CM_3 3",
            "NO_INPUT_QUANTITY DYN_MAP_CM_3 5",
            "asks for 5 points",
        ),
        ("missing number", " 0x0 DYN_MAP_RL_VALUES 0 ", " 0x0 DYN_MAP_RL_VALUES ", ""),
    ];
    assert!(dynocal_export::format::a2l::read("x.a2l", text.as_bytes()).is_ok());
    for (fault, from, to, says) in cases {
        let from = if text.contains(from) { from.to_string() } else { axis_line(&text) };
        let to = if fault == "axis length" { from.replacen(" 3 ", " 5 ", 1) } else { to.to_string() };
        let broken = text.replacen(&from, &to, 1);
        assert_ne!(broken, text, "{fault}");
        let e = dynocal_export::format::a2l::read("x.a2l", broken.as_bytes());
        let e = e.err().unwrap_or_else(|| panic!("{fault}: was read")).to_string();
        assert!(e.contains(says), "{fault}: {e}");
    }
}

/// The description of an axis of three points.
fn axis_line(text: &str) -> String {
    text.lines().find(|l| l.contains("/begin AXIS_DESCR") && l.contains(" 3 ")).unwrap().to_string()
}

/// A map whose limits an ECU states takes them; what does not fit is told.
#[test]
fn limits_of_an_ecu() {
    let mut package = common::maps();
    let file = write(&package, "a2l", &Keys::default()).unwrap().remove(0);
    let mut entries = dynocal_export::format::a2l::read("x.a2l", &file.bytes).unwrap();
    for e in &mut entries {
        e.limits = Interval::new(0.0, 32.0);
    }
    let notes = dynocal_export::format::a2l::adopt(&mut package, &entries);
    assert_eq!(package.characteristics[4].limits, Some(Interval::new(0.0, 32.0)));
    assert!(notes.iter().any(|n| n == "`INJ_MAP`: 1 values outside 0 to 32"), "{notes:?}");
}

/// What is written comes back equal, in every format that is read.
#[test]
fn round_trips() {
    let package = common::maps();
    for format in ["dcm", "cdfx", "json", "csv"] {
        for file in write(&package, format, &Keys::default()).unwrap() {
            let back = read(&file.name, &file.bytes).unwrap_or_else(|e| panic!("{format}: {e}"));
            for c in &back.characteristics {
                let want = package.characteristics.iter().find(|w| w.name == c.name).unwrap();
                assert_eq!(c.values, want.values, "{format} {}", c.name);
                let points = |c: &dynocal_export::characteristic::Characteristic| {
                    c.axes.iter().map(|a| (a.points.clone(), a.shared)).collect::<Vec<_>>()
                };
                assert_eq!(points(c), points(want), "{format} {}", c.name);
            }
        }
    }
    let whole = common::dynamic_map();
    let file = write(&whole, "json", &Keys::default()).unwrap().remove(0);
    assert_eq!(read(&file.name, &file.bytes).unwrap(), whole);
}

/// Forms that contradict themselves are refused before anything is written.
#[test]
fn faulty_forms() {
    let mut a = common::maps();
    a.characteristics[4].values.pop();
    let mut b = common::maps();
    b.characteristics[4].axes[0].points[1] = 1000.0;
    let mut c = common::maps();
    c.characteristics[5].axes[0].points[2] = 5000.0;
    let mut d = common::maps();
    d.characteristics[0].name = "LAM KP".into();
    let mut e = common::maps();
    (e.characteristics[0].name, e.characteristics[1].name) = ("A.B".into(), "A_B".into());
    for (package, says) in [
        (a, "`INJ_MAP`: found 5 values, expected 6 (3 x 2)"),
        (b, "`SPD_AXIS`: found the axis points 1000 and 1000"),
        (c, "two shared axes of this name"),
        (d, "letters, digits, underscores"),
    ] {
        let e = write(&package, "dcm", &Keys::default()).unwrap_err().to_string();
        assert!(e.contains(says), "{e}");
    }
    let twice = write(&e, "c", &Keys::default()).unwrap_err().to_string();
    assert!(twice.contains("found this name twice"), "{twice}");
    let e = write(&common::maps(), "cdfxx", &Keys::default()).unwrap_err().to_string();
    assert!(e.contains("did you mean `cdfx`?"), "{e}");
    let e = write(&common::maps(), "fmu2", &Keys::default()).unwrap_err().to_string();
    assert!(e.contains("it holds programs, which the package has not"), "{e}");
}
