//! `dynocal compare`: two map files beside each other.

use std::path::Path;

use assert_cmd::Command;
use dynocal_files::atomic;

fn compared(folder: &Path, args: &[&str]) -> (i32, String, String) {
    let out = Command::cargo_bin("dynocal")
        .unwrap()
        .current_dir(folder)
        .arg("compare")
        .args(args)
        .output()
        .unwrap();
    let text = |b: Vec<u8>| String::from_utf8(b).unwrap();
    (out.status.code().unwrap(), text(out.stdout), text(out.stderr))
}

const DCM: &str = "KONSERVIERUNG_FORMAT 2.0\r\n\r\n\
    KENNLINIE PEDAL 3\r\n  EINHEIT_X \"%\"\r\n  EINHEIT_W \"Nm\"\r\n  ST/X 0.0 50.0 100.0\r\n  WERT 0.0 80.0 200.0\r\nEND\r\n\r\n\
    FESTWERT KP\r\n  EINHEIT_W \"-\"\r\n  WERT 0.5\r\nEND\r\n";

#[test]
fn differences_are_shown_with_their_place() {
    let tmp = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| atomic::write(&tmp.path().join(name), text.as_bytes()).unwrap();
    put("ecu.dcm", DCM);
    put("new.dcm", &DCM.replace("WERT 0.0 80.0 200.0", "WERT 0.0 95.0 200.0").replace("KP", "KI"));
    let (code, out, _) = compared(tmp.path(), &["ecu.dcm", "ecu.dcm"]);
    assert_eq!((code, out.as_str()), (0, "2 of 2 characteristics that both have are equal\n"));
    let (code, out, _) = compared(tmp.path(), &["ecu.dcm", "new.dcm"]);
    assert_eq!(code, 0);
    for part in
        ["0 of 1 characteristics", "PEDAL", "15.0000", "only in the first: KP", "only in the second: KI"]
    {
        assert!(out.contains(part), "no `{part}` in\n{out}");
    }
    let (_, json, _) = compared(tmp.path(), &["ecu.dcm", "new.dcm", "--json"]);
    let found: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(found["both"][0]["largest"]["at"][0].as_f64(), Some(50.0));
    // Plain CSV maps of one table each, whatever they are called.
    put("a.csv", "x,0,10\n0,1,2\n1,3,4\n");
    put("b.csv", "x,0,10\n0,1,2\n1,3,5\n");
    let (_, out, _) = compared(tmp.path(), &["a.csv", "b.csv"]);
    assert!(out.contains("10, 1") && out.contains("called `a` and `b`"), "{out}");
    let (code, _, err) = compared(tmp.path(), &["ecu.dcm", "nowhere.dcm"]);
    assert!(code == 2 && err.contains("nowhere.dcm"), "{err}");
}
