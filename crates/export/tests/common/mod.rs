//! A package with one member of every kind, and the tools that tests call.
#![allow(dead_code)]

use std::path::{Path, PathBuf};
use std::process::Command;

use dynocal_export::characteristic::{Axis, Characteristic};
use dynocal_export::package::{Package, Provenance, ValidRange};
use dynocal_export::program::{Factor, Input, Layer, Op, Output, Program, Shape, Start, Tau, Term};

/// Activations of networks that leave in every format.
pub(crate) const ACTIVATIONS: [Shape; 7] = [
    Shape::Tanh,
    Shape::Sigmoid,
    Shape::Relu,
    Shape::Softplus,
    Shape::Asinh,
    Shape::Matern32,
    Shape::Matern52,
];

/// Axis, shared where its name is in capitals.
pub(crate) fn axis(name: &str, unit: &str, input: &str, points: &[f64]) -> Axis {
    let shared = name.ends_with("_AXIS");
    Axis {
        name: name.into(),
        description: format!("{input} axis"),
        unit: unit.into(),
        input: input.into(),
        points: points.to_vec(),
        shared,
    }
}

fn characteristic(name: &str, unit: &str, axes: Vec<Axis>, values: &[f64]) -> Characteristic {
    Characteristic {
        name: name.into(),
        description: format!("{name} \"of\" a <test> & more"),
        unit: unit.into(),
        axes,
        values: values.to_vec(),
        limits: None,
    }
}

/// Scalar, block, curve, map with own axes (rows longer than six), two maps and a curve on shared axes.
pub(crate) fn maps() -> Package {
    let speed = || axis("SPD_AXIS", "rpm", "speed", &[1000.0, 2000.0, 4000.0]);
    let torque = || axis("TRQ_AXIS", "Nm", "torque", &[50.0, 150.0]);
    let long = [800.0, 1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 4000.0, 5000.0];
    let spark: Vec<f64> = (0..24).map(|k| 20.0 + f64::from(k * k % 17) / 3.0).collect();
    Package {
        name: "DYN_MAP".into(),
        description: "Maps of a test".into(),
        provenance: Provenance {
            run: "runs/test".into(),
            spec_digest: "0123456789abcdef".into(),
            version: "0.1.0".into(),
            data_digest: "fedcba9876543210".into(),
            file: "dynamic_map.json".into(),
            file_digest: "00112233".into(),
            validity: vec![ValidRange {
                channel: "speed".into(),
                unit: "rpm".into(),
                lower: 1000.0,
                upper: 4000.0,
            }],
        },
        characteristics: vec![
            characteristic("LAM_KP", "-", vec![], &[0.1 + 0.2]),
            characteristic("INJ_COEF", "-", vec![], &[0.75, -0.25, 1e-7, 1.5, -3e20, 1.0 / 3.0, 7.0, 8.0]),
            characteristic(
                "THR_CURVE",
                "deg",
                vec![axis("THR_x", "Nm", "torque", &[0.0, 50.0, 100.0])],
                &[2.0, 8.5, 17.0],
            ),
            characteristic(
                "SPK_MAP",
                "°",
                vec![
                    axis("SPK_x", "rpm", "speed", &long),
                    axis("SPK_y", "Nm", "torque", &[20.0, 50.0, 80.0]),
                ],
                &spark,
            ),
            characteristic("INJ_MAP", "mg", vec![speed(), torque()], &[12.5, 12.0, 13.25, 31.0, 30.5, 33.0]),
            characteristic("AIR_MAP", "kg/h", vec![speed(), torque()], &[1.0, 2.0, 3.0, -4.0, 5.0, 1e-9]),
        ],
        ..Default::default()
    }
}

fn input(name: &str, unit: &str, start: f64) -> Input {
    Input {
        name: name.into(),
        unit: unit.into(),
        description: format!("{name} of a test"),
        start,
        range: None,
    }
}

fn term(coefficient: f64, factors: &[(usize, u32)]) -> Term {
    Term {
        coefficient,
        factors: factors.iter().map(|(node, power)| Factor { node: *node, power: *power }).collect(),
    }
}

/// A program with every kind of node whose functions are exact: filters with fixed constants, delays, differences,
/// clamps, polynomial with recursion, look-ups on shared axes.
pub(crate) fn dynamic_map() -> Package {
    let mut package = maps();
    package.name = "dyn_map".into();
    let mut p = Program {
        sample_time_s: 0.03,
        inputs: vec![input("torque", "Nm", 60.0), input("lambda", "-", 1.0), input("speed", "rpm", 2000.0)],
        nodes: Vec::new(),
        outputs: Vec::new(),
    };
    let torque = p.push("torque", Op::Input(0));
    let lambda = p.push("lambda", Op::Input(1));
    let speed = p.push("speed", Op::Input(2));
    let lag_1 = p.push("torque_lag_1", Op::Lag { of: torque, tau: Tau::Fixed(0.12) });
    let lag_2 = p.push("torque_lag_2", Op::Lag { of: lag_1, tau: Tau::Fixed(0.15) });
    let held = p.push("torque_held", Op::Clamp { of: lag_2, lower: 20.0, upper: 150.0 });
    let t = p.push("T", Op::Scale { of: held, gain: 1.0 / 50.0, offset: 0.0 });
    let n = p.push("N", Op::Scale { of: speed, gain: 1.0 / 2000.0, offset: 0.0 });
    let i = p.push("inverse_N", Op::Reciprocal { of: speed, numerator: 2000.0 });
    let l = p.push("L", Op::Scale { of: lambda, gain: 10.0, offset: -10.0 });
    let back = p.push("T_4", Op::Delay { of: t, samples: 4, start: Start::First });
    let more = p.push("T_7", Op::Delay { of: t, samples: 7, start: Start::First });
    let d = p.push("dT", Op::Difference { a: t, b: back });
    let e = p.push("dT2", Op::Difference { a: back, b: more });
    let last = p.push("inj_1", Op::Delay { of: 15, samples: 1, start: Start::Value(10.0) });
    let terms = vec![
        term(2.5, &[]),
        term(3.3, &[(t, 1)]),
        term(-0.7, &[(t, 2), (n, 1)]),
        term(0.11, &[(t, 3)]),
        term(1.7, &[(d, 1), (i, 1)]),
        term(-0.9, &[(e, 1), (l, 1)]),
        term(0.35, &[(last, 1)]),
    ];
    let inj = p.push("inj", Op::Polynomial { terms });
    let limited = p.push("inj_limited", Op::Clamp { of: inj, lower: 4.0, upper: 45.0 });
    let spark = p.push("spark", Op::Lookup { characteristic: "SPK_MAP".into(), inputs: vec![speed, held] });
    let base = p.push("base", Op::Lookup { characteristic: "INJ_MAP".into(), inputs: vec![speed, held] });
    let air = p.push("air", Op::Lookup { characteristic: "AIR_MAP".into(), inputs: vec![speed, held] });
    let throttle = p.push("throttle", Op::Lookup { characteristic: "THR_CURVE".into(), inputs: vec![lag_2] });
    let sum = p.push("mixture", Op::Difference { a: base, b: air });
    let output = |name: &str, unit: &str, node| Output {
        name: name.into(),
        unit: unit.into(),
        description: String::new(),
        node,
    };
    p.outputs = vec![
        output("inj", "mg", limited),
        output("sa", "deg", spark),
        output("thr", "deg", throttle),
        output("mix", "-", sum),
    ];
    package.program = Some(p);
    package
}

/// A neural NARX model: scaled regressors, one hidden layer of tanh, linear output, own output fed back.
pub(crate) fn network(activation: Shape) -> Package {
    let mut p = Program {
        sample_time_s: 0.03,
        inputs: vec![input("u", "mg", 0.0), input("v", "deg", 0.0)],
        nodes: Vec::new(),
        outputs: Vec::new(),
    };
    let u = p.push("u", Op::Input(0));
    let v = p.push("v", Op::Input(1));
    let u1 = p.push("u_1", Op::Delay { of: u, samples: 1, start: Start::Value(0.0) });
    let v2 = p.push("v_2", Op::Delay { of: v, samples: 2, start: Start::Value(0.0) });
    let y1 = p.push("y_1", Op::Delay { of: 8, samples: 1, start: Start::Value(0.0) });
    let su = p.push("su", Op::Scale { of: u1, gain: 0.5, offset: 0.1 });
    let sv = p.push("sv", Op::Scale { of: v2, gain: -0.25, offset: 0.0 });
    let layers = vec![
        Layer {
            weights: vec![0.3, -0.2, 0.5, 0.1, 0.9, -0.4, -0.6, 0.25, 0.35],
            offsets: vec![0.05, -0.1, 0.2],
            activation,
        },
        Layer { weights: vec![0.7, -0.3, 0.4], offsets: vec![0.02], activation: Shape::Linear },
    ];
    let net = p.push("net", Op::Network { inputs: vec![su, sv, y1], layers });
    let y = p.push("y", Op::Scale { of: net, gain: 1.5, offset: 0.25 });
    p.outputs = vec![Output { name: "out".into(), unit: "Nm".into(), description: String::new(), node: y }];
    Package { name: "net".into(), description: "A network".into(), program: Some(p), ..Default::default() }
}

/// Folder of the readers' virtual environment.
fn readers() -> PathBuf {
    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target"), PathBuf::from);
    target.join("readers")
}

/// Python with the readers, if it is there and has `modules`; says SKIPPED where not.
pub(crate) fn python(modules: &[&str]) -> Option<PathBuf> {
    let python = std::env::var_os("DYNOCAL_READERS_PYTHON")
        .map_or_else(|| readers().join("bin/python"), PathBuf::from);
    let code = modules.iter().map(|m| format!("import {m}")).collect::<Vec<_>>().join("\n");
    let there = Command::new(&python).args(["-c", &code]).output().is_ok_and(|o| o.status.success());
    if !there {
        println!("SKIPPED READER: no Python with {} (run scripts/readers.sh)", modules.join(", "));
    }
    there.then_some(python)
}

/// Folder with ASAM's schema of CDF 2.0; says SKIPPED where it is not there.
pub(crate) fn cdf_schema() -> Option<PathBuf> {
    let folder = readers().join("cdf");
    if folder.join("cdf_v2.0.0.sl.xsd").is_file() {
        return Some(folder);
    }
    println!("SKIPPED READER: ASAM's schema of CDF 2.0 is not there (run scripts/readers.sh)");
    None
}

/// Runs a check of `tests/readers` and gives what it printed; fails with its messages.
pub(crate) fn run(python: &Path, script: &str, arguments: &[&Path]) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers").join(script);
    // Tools that come with a package, as CMake with FMPy, lie beside the interpreter.
    let beside = python.parent().map(Path::to_path_buf);
    let usual = std::env::var_os("PATH").unwrap_or_default();
    let search = std::env::join_paths(beside.into_iter().chain(std::env::split_paths(&usual))).unwrap();
    let mut command = Command::new("timeout");
    command.env("PATH", search).arg("300").arg(python).arg(path).args(arguments);
    let out = command.output().unwrap();
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(out.status.success(), "{script}: {text}{}", String::from_utf8_lossy(&out.stderr));
    print!("{text}");
    text
}

/// Writes the files of an export into `folder` and gives the path of the first.
pub(crate) fn save(package: &Package, format: &str, folder: &Path) -> PathBuf {
    let keys = dynocal_export::format::Keys::default();
    let files =
        dynocal_export::format::write(package, format, &keys).unwrap_or_else(|e| panic!("{format}: {e}"));
    for f in &files {
        std::fs::write(folder.join(&f.name), &f.bytes).unwrap();
    }
    folder.join(&files[0].name)
}
