//! The generated C is clean under strict flags and gives the bits of the evaluator.

#![allow(clippy::disallowed_methods)] // files of tests are written as they are

mod common;

use std::path::Path;
use std::process::Command;

use dynocal_export::evaluate::{Machine, Real, lookup};
use dynocal_export::format::{Keys, Precision, write};
use dynocal_export::package::{Extrapolation, Package};
use dynocal_export::program::{Input, Op, Output, Program, Shape};
use dynocal_numerics::rng::Rng64;

const FLAGS: [&str; 14] = [
    "-std=c99",
    "-pedantic",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Wfloat-equal",
    "-Wvla",
    "-Wshadow",
    "-Wstrict-prototypes",
    "-Werror",
    "-ffp-contract=off",
    "-O2",
    "-fstack-usage",
];

fn compiler() -> Option<&'static str> {
    let there = Command::new("gcc").arg("--version").output().is_ok();
    if !there {
        println!("SKIPPED READER: no gcc");
    }
    there.then_some("gcc")
}

/// Compiles the export and `main` into a program.
fn build(package: &Package, precision: Precision, main: &str, folder: &Path) -> Option<std::path::PathBuf> {
    let gcc = compiler()?;
    for f in write(package, "c", &Keys { precision }).unwrap() {
        std::fs::write(folder.join(&f.name), &f.bytes).unwrap();
    }
    std::fs::write(folder.join("main.c"), main).unwrap();
    let name = &package.name;
    let done = Command::new(gcc)
        .current_dir(folder)
        .args(FLAGS)
        .args(["-c", &format!("{name}.c"), "-o", "code.o"])
        .output()
        .unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let linked = Command::new(gcc)
        .current_dir(folder)
        .args(["-std=gnu99", "-O2", "-ffp-contract=off", "main.c", "code.o", "-lm", "-o", "main"])
        .output()
        .unwrap();
    assert!(linked.status.success(), "{}", String::from_utf8_lossy(&linked.stderr));
    Some(folder.join("main"))
}

/// Runs the program on numbers and gives what it writes.
fn call(program: &Path, folder: &Path, numbers: &[f64]) -> Vec<f64> {
    let bytes: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
    std::fs::write(folder.join("in.bin"), bytes).unwrap();
    let done = Command::new(program).current_dir(folder).args(["in.bin", "out.bin"]).output().unwrap();
    assert!(done.status.success());
    print!("{}", String::from_utf8_lossy(&done.stdout));
    let out = std::fs::read(folder.join("out.bin")).unwrap();
    out.chunks_exact(8).map(|c| f64::from_le_bytes(c.try_into().unwrap())).collect()
}

/// Reads rows of `width` doubles, writes what `body` puts into `out[]` (`count` values).
fn harness(name: &str, width: usize, count: usize, prepare: &str, body: &str) -> String {
    format!(
        "#include <stdio.h>\n#include \"{name}.h\"\nint main(int argc, char **argv) {{\n    (void)argc;\n\
    FILE *f = fopen(argv[1], \"rb\"), *g = fopen(argv[2], \"wb\");\n    double u[{width}];\n    double y[{count}];\n    {prepare}\n\
    while (fread(u, sizeof(double), {width}, f) == {width}) {{\n        {body}\n        fwrite(y, sizeof(double), {count}, g);\n    }}\n\
    fclose(f); fclose(g);\n    return 0;\n}}\n"
    )
}

fn same(a: f64, b: f64) -> bool {
    a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan())
}

/// 1e5 random points, breakpoints, NaN and infinities; both precisions, both rules for the edges.
fn lookups<R: Real>(precision: Precision, extrapolation: Extrapolation) {
    let mut package = common::maps();
    package.extrapolation = extrapolation;
    let (curve, map) = (package.characteristics[2].clone(), package.characteristics[3].clone());
    let real = format!("{}_real_T", package.name);
    let body = format!(
        "y[0] = (double)THR_CURVE_lookup(({real})u[0]); y[1] = (double)SPK_MAP_lookup(({real})u[1], ({real})u[2]);"
    );
    let tmp = tempfile::tempdir().unwrap();
    let Some(program) = build(&package, precision, &harness(&package.name, 3, 2, "", &body), tmp.path())
    else {
        return;
    };
    let mut rng = Rng64::new(13);
    let odd = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        0.0,
        -0.0,
        50.0,
        100.0,
        800.0,
        5000.0,
        20.0,
        80.0,
        1e300,
    ];
    let mut u = Vec::new();
    for k in 0..100_000 {
        if k % 16 == 0 {
            u.extend([odd[rng.below(12)], odd[rng.below(12)], odd[rng.below(12)]]);
        } else {
            u.extend([
                rng.uniform_in(-20.0, 130.0),
                rng.uniform_in(600.0, 5500.0),
                rng.uniform_in(0.0, 100.0),
            ]);
        }
    }
    let y = call(&program, tmp.path(), &u);
    assert_eq!(y.len(), 200_000);
    for (u, y) in u.chunks(3).zip(y.chunks(2)) {
        let a = lookup(&curve, &[R::from(u[0])], extrapolation).to();
        let b = lookup(&map, &[R::from(u[1]), R::from(u[2])], extrapolation).to();
        assert!(
            same(a, y[0]) && same(b, y[1]),
            "{precision:?} {extrapolation:?} at {u:?}: {y:?}, expected {a} {b}"
        );
        if extrapolation == Extrapolation::Clip {
            assert!(y.iter().all(|x| x.is_finite()), "{u:?}: {y:?}");
        }
    }
}

#[test]
fn lookups_are_bit_equal() {
    for extrapolation in [Extrapolation::Clip, Extrapolation::Linear] {
        lookups::<f64>(Precision::Double, extrapolation);
        lookups::<f32>(Precision::Float, extrapolation);
    }
}

fn program_rows<R: Real>(package: &Package, precision: Precision, bits: bool) {
    let p = package.program.as_ref().unwrap();
    let (m, q) = (p.inputs.len(), p.outputs.len());
    let name = &package.name;
    let prepare = format!("{name}_state_T s; {name}_real_T in[{m}], out[{q}]; {name}_init(&s);");
    let body = format!(
        "for (int k = 0; k < {m}; k++) in[k] = ({name}_real_T)u[k]; {name}_step(&s, in, out); for (int k = 0; k < {q}; k++) y[k] = (double)out[k];"
    );
    // A million steps more, whose time is printed and compared with nothing.
    let timed = format!(
        "clock_t t0 = clock(); volatile double sink = 0.0; for (long k = 0; k < 1000000; k++) {{ {name}_step(&s, in, out); \
         sink = (double)out[0]; }} (void)sink; \
         printf(\"{name} {precision:?}: %.0f ns a step\\n\", 1e3 * (double)(clock() - t0) / CLOCKS_PER_SEC); fclose(f);"
    );
    let main =
        format!("#include <time.h>\n{}", harness(name, m, q, &prepare, &body).replace("fclose(f);", &timed));
    let tmp = tempfile::tempdir().unwrap();
    let Some(program) = build(package, precision, &main, tmp.path()) else {
        return;
    };
    let mut rng = Rng64::new(7);
    let mut u = Vec::new();
    for k in 0..100_000 {
        let t = k as f64 * 0.03;
        u.extend(p.inputs.iter().enumerate().map(|(i, input)| {
            let size = input.start.abs().max(1.0);
            input.start + size * (0.3 * (0.7 * t + i as f64).sin() + 0.2 * rng.uniform_in(-1.0, 1.0))
        }));
    }
    // At the end what is no number, one input after the other: what it leaves in filters and delays stays there.
    for (k, odd) in
        [f64::INFINITY, f64::NEG_INFINITY, f64::NAN, 1e300].into_iter().cycle().take(40 * m).enumerate()
    {
        u.extend(p.inputs.iter().enumerate().map(|(i, input)| if i == k / 40 { odd } else { input.start }));
    }
    let y = call(&program, tmp.path(), &u);
    assert_eq!(y.len(), (100_000 + 40 * m) * q);
    let mut machine = Machine::<R>::new(package).unwrap();
    for (t, (u, y)) in u.chunks(m).zip(y.chunks(q)).enumerate() {
        let inputs: Vec<R> = u.iter().map(|x| R::from(*x)).collect();
        for (a, b) in machine.step(&inputs).into_iter().zip(y) {
            let near = (a.to() - b).abs() <= 1e-12 * (1.0 + b.abs()) || same(a.to(), *b);
            assert!(if bits { same(a.to(), *b) } else { near }, "{precision:?}, sample {t}: {} {b}", a.to());
        }
    }
    let stack = std::fs::read_to_string(tmp.path().join("code.su")).unwrap_or_default();
    let step = stack.lines().find(|l| l.contains("_step")).unwrap_or("").to_string();
    let size = Command::new("size").arg(tmp.path().join("code.o")).output();
    let size = size.map(|o| String::from_utf8_lossy(&o.stdout).into_owned()).unwrap_or_default();
    println!("{name} {precision:?}: stack {step}; {}", size.lines().nth(1).unwrap_or(""));
}

#[test]
fn a_dynamic_map_is_bit_equal_over_a_record() {
    program_rows::<f64>(&common::dynamic_map(), Precision::Double, true);
    program_rows::<f32>(&common::dynamic_map(), Precision::Float, true);
}

/// Distance of two numbers in units of the last place of their type.
fn ulps(a: f64, b: f64, precision: Precision) -> u64 {
    // Bits in the order of the numbers: those below zero run backwards.
    let place = |x: f64| {
        let size = match precision {
            Precision::Double => x.abs().to_bits() as i64,
            Precision::Float => i64::from((x.abs() as f32).to_bits()),
        };
        if x.is_sign_negative() { -size } else { size }
    };
    if same(a, b) { 0 } else { place(a).abs_diff(place(b)) }
}

/// `exp` and `tanh` of the C library and of this program at 1e5 points, at the edges of what they can, at NaN and infinities.
fn functions<R: Real>(precision: Precision) {
    let mut p = Program {
        sample_time_s: 0.03,
        inputs: vec![Input {
            name: "x".into(),
            unit: "-".into(),
            description: String::new(),
            start: 0.0,
            range: None,
        }],
        nodes: Vec::new(),
        outputs: Vec::new(),
    };
    let x = p.push("x", Op::Input(0));
    for (name, shape) in [("exp", Shape::Exp), ("tanh", Shape::Tanh)] {
        let node = p.push(&format!("{name}_x"), Op::Function { of: x, shape });
        p.outputs.push(Output {
            name: format!("{name}_of_x"),
            unit: "-".into(),
            description: String::new(),
            node,
        });
    }
    let package = Package { name: "functions".into(), program: Some(p), ..Default::default() };
    let prepare = "functions_state_T s; functions_real_T in[1], out[2]; functions_init(&s);";
    let body = "in[0] = (functions_real_T)u[0]; functions_step(&s, in, out); y[0] = (double)out[0]; y[1] = (double)out[1];";
    let tmp = tempfile::tempdir().unwrap();
    let Some(program) = build(&package, precision, &harness("functions", 1, 2, prepare, body), tmp.path())
    else {
        return;
    };
    let mut rng = Rng64::new(21);
    let odd = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        0.0,
        -0.0,
        1e-300,
        -1e-30,
        709.7,
        710.0,
        -745.0,
        88.7,
        89.0,
        -104.0,
    ];
    let reach = [1e-6, 1e-2, 1.0, 20.0, 800.0];
    let random = (0..100_000).map(|k| rng.uniform_in(-1.0, 1.0) * reach[k % 5]);
    let u: Vec<f64> = odd.into_iter().chain(random).collect();
    let y = call(&program, tmp.path(), &u);
    let mut machine = Machine::<R>::new(&package).unwrap();
    let mut worst = 0;
    for (u, y) in u.iter().zip(y.chunks(2)) {
        for (a, b) in machine.step(&[R::from(*u)]).into_iter().zip(y) {
            let off = ulps(a.to(), *b, precision);
            assert!(off <= 2, "{precision:?} at {u}: {} {b}, {off} units of the last place", a.to());
            worst = worst.max(off);
        }
    }
    println!("exp and tanh, {precision:?}: at most {worst} units of the last place apart");
}

#[test]
fn exp_and_tanh_are_within_two_units_of_the_last_place() {
    assert_eq!(
        (ulps(1.0, 1.0 + f64::EPSILON, Precision::Double), ulps(-1e-310, 1e-310, Precision::Double) > 2),
        (1, true)
    );
    assert_eq!(ulps(1.0, 1.0 + f32::EPSILON as f64, Precision::Float), 1);
    functions::<f64>(Precision::Double);
    functions::<f32>(Precision::Float);
}

/// Networks call `exp` and `tanh` of two libraries: near, not equal.
#[test]
fn networks_agree() {
    for shape in common::ACTIVATIONS {
        program_rows::<f64>(&common::network(shape), Precision::Double, shape == Shape::Relu);
    }
}

/// The checker, the rules and what it finds are told; nothing is called compliant.
#[test]
fn misra_addon_finds_the_listed_deviations_only() {
    if Command::new("cppcheck").arg("--version").output().is_err() {
        println!("SKIPPED READER: no cppcheck");
        return;
    }
    let package = common::dynamic_map();
    let tmp = tempfile::tempdir().unwrap();
    for f in write(&package, "c", &Keys::default()).unwrap() {
        std::fs::write(tmp.path().join(&f.name), &f.bytes).unwrap();
    }
    let done = Command::new("cppcheck")
        .current_dir(tmp.path())
        .args(["--addon=misra", "--enable=style", "--quiet", "--template={id}", "dyn_map.c"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&done.stderr);
    // 8.7: tables are external on purpose, so that calibration tools find them. 2.5: macros of the header for callers.
    // 15.5 is not among them: every function has one return.
    let listed = ["misra-c2012-8.7", "misra-c2012-2.5", "misra-c2012-8.9", "misra-config", "unusedFunction"];
    let mut found: Vec<&str> =
        text.lines().filter(|l| !l.trim().is_empty() && !listed.contains(&l.trim())).collect();
    found.sort_unstable();
    found.dedup();
    assert!(found.is_empty(), "{found:?}");
}
