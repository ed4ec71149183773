//! `dynocal calibrate` takes records in every format that is written, and those of a bed as well.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use dynocal_export::evaluate::{Machine, Real};
use dynocal_export::format::{Keys, Precision, write};
use dynocal_export::package::Package;
use dynocal_files::atomic;
use dynocal_files::measurement::FORMATS;
use dynocal_files::table::Table;

fn dynocal(folder: &Path, args: &[&str]) -> Output {
    Command::cargo_bin("dynocal").unwrap().current_dir(folder).args(args).output().unwrap()
}

fn done(folder: &Path, args: &[&str]) -> String {
    let out = dynocal(folder, args);
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(0), "{args:?}: {said}");
    said
}

fn shortest() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../studies/src/shortest.toml");
    std::fs::read_to_string(path).unwrap()
}

/// A step of a run as its folder keeps it.
fn record(folder: &Path, run: &str, name: &str) -> String {
    let path = folder.join(run).join("steps/01-excite").join(format!("{name}.csv"));
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// All columns of `first` are in `given`, each value to single precision.
fn same_to_single_precision(given: &str, first: &str) {
    let columns = |text: &str| -> BTreeMap<String, Vec<f64>> {
        let mut lines = text.lines();
        let names: Vec<&str> = lines.next().unwrap().split(',').collect();
        let rows: Vec<Vec<f64>> = lines.map(|l| l.split(',').map(|v| v.parse().unwrap()).collect()).collect();
        let column = |c: usize| rows.iter().map(|r| r[c]).collect();
        names.iter().enumerate().map(|(c, n)| (n.to_string(), column(c))).collect()
    };
    let (given, first) = (columns(given), columns(first));
    for (name, values) in &first {
        let single = given.get(name).unwrap_or_else(|| panic!("no {name}"));
        assert_eq!(single.len(), values.len(), "{name}");
        for (a, b) in single.iter().zip(values) {
            assert!((a - b).abs() <= 1e-6 * b.abs().max(1e-3), "{name}: {a} {b}");
        }
    }
}

#[test]
fn given_records_come_in_every_format() {
    let tmp = tempfile::tempdir().unwrap();
    atomic::write(&tmp.path().join("spec.toml"), shortest().as_bytes()).unwrap();
    done(tmp.path(), &["calibrate", "spec.toml", "--until", "excite", "--out", "first"]);
    let names = ["ident01", "ident02", "val01"];
    let mut tried = Vec::new();
    for format in FORMATS.iter().filter(|f| f.write.is_some()) {
        let ending = format.endings[0];
        let given = |k: usize| format!("{}{ending}", names[k]);
        for (k, name) in names.iter().enumerate() {
            let from = format!("first/steps/01-excite/{name}.csv");
            done(tmp.path(), &["convert", &from, &given(k), "--quiet"]);
        }
        let files = format!(
            "identification_files = ['{}', '{}']\nvalidation_files = ['{}']\n",
            given(0),
            given(1),
            given(2)
        );
        let spec = shortest().replacen("[excite]\n", &format!("[excite]\n{files}"), 1);
        atomic::write(&tmp.path().join("given.toml"), spec.as_bytes()).unwrap();
        let out = format!("run-{}", format.doc.name);
        done(tmp.path(), &["calibrate", "given.toml", "--until", "excite", "--out", &out]);
        for name in names {
            let (given, first) = (record(tmp.path(), &out, name), record(tmp.path(), "first", name));
            // A log of an open ECU holds single precision, and a clock of its own among its fields.
            if ending == ".mlg" {
                same_to_single_precision(&given, &first);
            } else {
                assert_eq!(given, first, "{ending}");
            }
        }
        tried.push(format.doc.name);
    }
    assert!(["csv", "parquet", "mdf4", "mat5"].iter().all(|f| tried.contains(f)), "{tried:?}");
}

/// The bed's records may be MDF; two records of one plan are refused.
#[test]
fn a_bed_hands_back_mdf() {
    let tmp = tempfile::tempdir().unwrap();
    // Given gains: there is nothing to be found on the plant first.
    let loops = r#"
[[loops]]
output = "torque"
input = "throttle"
gains = { ki = 0.3, kp = 0.2 }

[[loops]]
output = "lambda"
input = "inj"
gains = { ki = -40.0, kp = -8.0 }
"#;
    atomic::write(&tmp.path().join("spec.toml"), format!("{}{loops}", shortest()).as_bytes()).unwrap();
    done(tmp.path(), &["calibrate", "spec.toml", "--until", "excite", "--out", "first"]);
    let bed = format!("{}{loops}\n[plant]\nname = \"bed\"\n", shortest());
    atomic::write(&tmp.path().join("bed.toml"), bed.as_bytes()).unwrap();
    let calibrate = ["calibrate", "bed.toml", "--until", "excite", "--out", "bed"];
    let measured: PathBuf = tmp.path().join("bed/measured");
    for name in ["ident01", "ident02", "val01"] {
        let waits = dynocal(tmp.path(), &calibrate);
        let said = String::from_utf8(waits.stderr).unwrap();
        assert_eq!(waits.status.code(), Some(1), "{said}");
        assert!(said.contains("to be run on the bed"), "{said}");
        std::fs::create_dir_all(&measured).unwrap();
        let from = format!("first/steps/01-excite/{name}.csv");
        done(tmp.path(), &["convert", &from, &format!("bed/measured/{name}.mf4"), "--quiet"]);
    }
    done(tmp.path(), &calibrate);
    for name in ["ident01", "ident02", "val01"] {
        assert_eq!(record(tmp.path(), "bed", name), record(tmp.path(), "first", name), "{name}");
    }
    done(tmp.path(), &["convert", "bed/measured/ident01.mf4", "bed/measured/ident01.csv", "--quiet"]);
    let two = dynocal(tmp.path(), &calibrate);
    let said = String::from_utf8(two.stderr).unwrap();
    assert!(said.contains("ident01.csv` and `") && said.contains("leave one"), "{said}");
}

/// `[export]` waits for the map, and what leaves is what the run holds.
#[test]
fn the_map_leaves_as_the_spec_asks() {
    let tmp = tempfile::tempdir().unwrap();
    let spec = format!(
        "{}\n[export]\nto = [\"dcm\", \"c\", \"json\", \"fmu2\", \"fmu3\"]\nengine = true\n",
        shortest()
    );
    atomic::write(&tmp.path().join("spec.toml"), spec.as_bytes()).unwrap();
    let said = done(tmp.path(), &["calibrate", "spec.toml", "--until", "excite", "--out", "run"]);
    assert!(said.contains("nothing leaves before the step invert"), "{said}");
    let out = dynocal(tmp.path(), &["calibrate", "spec.toml", "--out", "run"]);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.code().unwrap() < 2, "{said}");
    // The step before is taken over: what leaves is no input of any step.
    assert!(said.contains("excite: taken from the earlier run"), "{said}");
    let files: Vec<&str> = said.lines().filter_map(|l| l.strip_prefix("exported ")).collect();
    let dcm: Vec<&&str> = files.iter().filter(|f| f.ends_with(".dcm")).collect();
    assert!(!dcm.is_empty() && files.iter().any(|f| f.ends_with(".c")), "{said}");
    for file in dcm {
        let out = dynocal(tmp.path(), &["compare", file, "run", "--json"]);
        let text = String::from_utf8(out.stdout).unwrap();
        let found: serde_json::Value = serde_json::from_str(&text).unwrap();
        let both = found["both"].as_array().unwrap();
        assert!(!both.is_empty() && found["only_first"].as_array().unwrap().is_empty(), "{text}");
        assert!(both.iter().all(|d| d["differing"] == 0 && d["points"].as_u64() > Some(0)), "{text}");
    }
    let json = files.iter().find(|f| f.ends_with("dynamic_map.json")).unwrap();
    let bytes = std::fs::read(tmp.path().join(json)).unwrap();
    let package = dynocal_export::format::read(json, &bytes).unwrap();
    let record = validated(tmp.path());
    let columns = dynocal_files::dataset::read_table(&record, None).unwrap();
    the_c_gives_the_bits::<f64>(tmp.path(), &package, Precision::Double, &columns);
    the_c_gives_the_bits::<f32>(tmp.path(), &package, Precision::Float, &columns);
    the_map_drives_the_engine(tmp.path(), &files);
}

/// The record of the dynamic map in the comparison of the maps.
fn validated(folder: &Path) -> PathBuf {
    std::fs::read_dir(folder.join("run/steps/06-validate"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .find(|p| p.file_name().unwrap().to_string_lossy().starts_with("dynamic_map_random"))
        .unwrap()
}

/// The C of the dynamic map over the whole validation record, and then with NaN and infinities: the bits of the evaluator.
fn the_c_gives_the_bits<R: Real>(folder: &Path, package: &Package, precision: Precision, record: &Table) {
    if std::process::Command::new("gcc").arg("--version").output().is_err() {
        println!("SKIPPED READER: no gcc");
        return;
    }
    let tmp = tempfile::tempdir_in(folder).unwrap();
    let program = package.program.as_ref().unwrap();
    let (m, q, name) = (program.inputs.len(), program.outputs.len(), &package.name);
    for f in write(package, "c", &Keys { precision }).unwrap() {
        atomic::write(&tmp.path().join(&f.name), &f.bytes).unwrap();
    }
    let main = format!(
        "#include <stdio.h>\n#include \"{name}.h\"\nint main(void) {{\n{name}_state_T s; {name}_real_T in[{m}], out[{q}];\n\
         double u[{m}]; {name}_init(&s);\nFILE *f = fopen(\"in.bin\", \"rb\"), *g = fopen(\"out.bin\", \"wb\");\n\
         while (fread(u, sizeof u, 1, f) == 1) {{\nfor (int k = 0; k < {m}; k++) in[k] = ({name}_real_T)u[k];\n\
         {name}_step(&s, in, out);\nfor (int k = 0; k < {q}; k++) {{ double y = (double)out[k]; fwrite(&y, sizeof y, 1, g); }}\n\
         }}\nfclose(f); fclose(g); return 0;\n}}\n"
    );
    atomic::write(&tmp.path().join("main.c"), main.as_bytes()).unwrap();
    let gcc = ["-std=c99", "-O2", "-ffp-contract=off", "-o", "main", "main.c", &format!("{name}.c"), "-lm"];
    let built = std::process::Command::new("gcc").args(gcc).current_dir(tmp.path()).output().unwrap();
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let rows = record.rows();
    let values = |input: &str| -> Vec<f64> {
        let demanded = format!("{input}_demand");
        let column = if record.column(&demanded).is_ok() { &demanded } else { input };
        record.numbers(column, 0, rows).unwrap().to_vec()
    };
    let columns: Vec<Vec<f64>> = program.inputs.iter().map(|i| values(&i.name)).collect();
    let mut u: Vec<f64> = (0..rows).flat_map(|t| columns.iter().map(move |c| c[t])).collect();
    // Then one odd input after the other; what it leaves behind in filters stays.
    for (k, odd) in [f64::INFINITY, f64::NEG_INFINITY, f64::NAN].into_iter().cycle().take(3 * m).enumerate() {
        let mut row: Vec<f64> = columns.iter().map(|c| c[0]).collect();
        row[k / 3] = odd;
        u.extend(row);
    }
    let bytes: Vec<u8> = u.iter().flat_map(|x| x.to_le_bytes()).collect();
    atomic::write(&tmp.path().join("in.bin"), &bytes).unwrap();
    let ran = std::process::Command::new(tmp.path().join("main")).current_dir(tmp.path()).status().unwrap();
    assert!(ran.success());
    let out = std::fs::read(tmp.path().join("out.bin")).unwrap();
    assert_eq!(out.len(), 8 * q * (rows + 3 * m));
    let mut machine = Machine::<R>::new(package).unwrap();
    for (t, (u, y)) in u.chunks(m).zip(out.chunks(8 * q)).enumerate() {
        let inputs: Vec<R> = u.iter().map(|x| R::from(*x)).collect();
        for (want, y) in machine.step(&inputs).into_iter().zip(y.chunks(8)) {
            let y = f64::from_le_bytes(y.try_into().unwrap());
            let want = want.to();
            let same = want.to_bits() == y.to_bits() || (want.is_nan() && y.is_nan());
            assert!(same, "{precision:?}, row {t}: {y} {want} at {u:?}");
        }
    }
    println!("{name} {precision:?}: {rows} rows of the validation record and {} odd ones, bit-equal", 3 * m);
}

/// The FMU of the dynamic map drives the FMU of the engine: the record of the comparison of the maps, which began after 4 s at its
/// first row.
fn the_map_drives_the_engine(folder: &Path, files: &[&str]) {
    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target"), PathBuf::from);
    let python = std::env::var_os("DYNOCAL_READERS_PYTHON")
        .map_or_else(|| target.join("readers/bin/python"), PathBuf::from);
    let run = |args: &[&str]| std::process::Command::new(&python).args(args).current_dir(folder).output();
    if !run(&["-c", "import fmpy"]).is_ok_and(|o| o.status.success()) {
        println!("SKIPPED READER: no Python with fmpy (run scripts/readers.sh)");
        return;
    }
    let readers = Path::new(env!("CARGO_MANIFEST_DIR")).join("../engine_fmu/tests/readers");
    let script = std::fs::canonicalize(readers.join("check_drive.py")).unwrap();
    let record = validated(folder);
    for version in ["fmi2", "fmi3"] {
        let unit = |name: &str| {
            let ending = format!("{name}_{version}.fmu");
            files
                .iter()
                .find(|f| f.ends_with(&ending))
                .unwrap_or_else(|| panic!("{ending}: {files:?}"))
                .to_string()
        };
        let lead = (4.0f64 / 0.03).ceil() as usize;
        let out = run(&[
            &script.display().to_string(),
            &unit("dynamic_map"),
            &unit("dynocal_engine"),
            &record.display().to_string(),
            &lead.to_string(),
        ])
        .unwrap();
        let said = String::from_utf8_lossy(&out.stdout);
        assert!(out.status.success(), "{said}{}", String::from_utf8_lossy(&out.stderr));
        print!("{said}");
    }
}
