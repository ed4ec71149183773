//! A report with every kind of block, filled by formulas: the fixture for looking at the page.
//!
//!     cargo run --release -p dynocal-deliver --example demo > demo.html

use dynocal_report::{
    Axis, Bars, Block, Check, Column, Details, HeatMap, KeyValue, Panel, Report, Role, Section, Series,
    Table, TimePlot, XyPlot, XySeries, render,
};

const TS_S: f64 = 0.03;
const N: usize = 2000;

fn main() -> Result<(), dynocal_report::RenderError> {
    let report = Report::new("Dynamic calibration of a gasoline engine")
        .subtitle("Demonstration page: every curve is a formula, no engine was run")
        .fact("Spec", "examples/gtdi/calibrate.toml")
        .fact("Seed", 1_usize)
        .fact("Sample time", "0.03 s")
        .fact("Bed time", "412 s")
        .warning("The lambda model is valid from 1000 to 3000 rpm only; 14 samples of the validation record lie outside.")
        .warning("Validation record 3: spark touched its upper limit for 0.42 s.")
        .check(check("fit-torque", "Free-run R2 of torque", ">= 99", 99.34, "%", true).note("mean of 3 unseen records"))
        .check(check("fit-lambda", "Free-run R2 of lambda", ">= 96", 97.8, "%", true).note("mean of 3 unseen records"))
        .check(check("offset-torque", "Worst steady offset of the delivered map", "<= 1.5", 1.83, "Nm", false))
        .check(check("spike", "Lambda spike on 30/70 Nm steps", "<= 0.10", 0.041, "", true).note("static map: 0.288"))
        .check(Check::new("share", "Share of the saving a perfect spark gives").measured(71.2).unit("%"))
        .section(identification())
        .section(calibration())
        .section(maps())
        .section(odd_data())
        .section(appendix());
    print!("{}", render(&report)?);
    Ok(())
}

fn check(id: &str, what: &str, asked: &str, measured: f64, unit: &str, holds: bool) -> Check {
    Check::new(id, what).asked(asked).measured(measured).unit(unit).holds(holds)
}

/// A random-looking staircase: `hold` samples per level, levels from a fixed quadratic residue sequence.
fn staircase(hold: usize, shift: usize, low: f64, high: f64) -> Vec<f64> {
    let level = |k: usize| ((k * k * 7 + 3 * k + shift) % 11) as f64 / 10.0;
    (0..N).map(|k| low + (high - low) * level((k + 37 * shift) / hold)).collect()
}

/// First-order lag with time constant `tau` in samples.
fn lag(u: &[f64], tau: f64) -> Vec<f64> {
    let mut y = u.first().copied().unwrap_or(0.0);
    let mut step = |v: &f64| {
        let now = y;
        y += (v - y) / tau;
        now
    };
    u.iter().map(&mut step).collect()
}

fn wave(amplitude: f64, omega: f64) -> impl Fn(usize) -> f64 {
    move |k| amplitude * (omega * k as f64).sin()
}

fn add(u: &[f64], f: impl Fn(usize) -> f64) -> Vec<f64> {
    u.iter().enumerate().map(|(k, v)| v + f(k)).collect()
}

fn identification() -> Section {
    let demand = staircase(100, 1, 20.0, 80.0);
    let torque = add(&lag(&demand, 9.0), wave(0.8, 1.7));
    let spark = staircase(100, 4, 8.0, 34.0);
    let injection: Vec<f64> = torque.iter().map(|t| 4.0 + 0.17 * t).collect();
    let speed =
        add(&vec![2000.0; N], |k| 900.0 * (2.0 / std::f64::consts::PI) * (0.012 * k as f64).sin().asin());
    let lambda: Vec<f64> =
        (0..N).map(|k| 1.0 + 0.0016 * (demand[k] - torque[k]) + wave(0.003, 0.9)(k)).collect();
    let lambda_hat = add(&lag(&lambda, 1.6), wave(0.002, 0.4));
    Section::new("Identification")
        .text("Both models run free from the measured initial values over records that they have not seen.\nR2 is the share of the output's variance that the model explains.")
        .key_values(vec![
            KeyValue::new("Samples per record", N, ""),
            KeyValue::new("Sample time", TS_S, "s"),
            KeyValue::new("Regressors torque / lambda", "14 / 19", ""),
            KeyValue::new("Estimator", "simulation error, Levenberg-Marquardt", ""),
            KeyValue::new("Condition number", 4.31e7, ""),
            KeyValue::new("Final cost", 0.501210980607983, "Nm²"),
        ])
        .block(
            Table::new(vec![
                Column::text("Structure"),
                Column::text("Estimator"),
                Column::number("Parameters", ""),
                Column::number("R2 torque", "%").digits(4),
                Column::number("R2 lambda", "%").digits(4),
                Column::number("RMSE torque", "Nm").digits(3),
            ])
            .caption("Free-run fit, mean of validation records 1 to 3")
            .row(["published (7.8)".into(), "prediction error".into(), 11_usize.into(), 97.1.into(), 88.42.into(), 2.31.into()])
            .row(["published (7.8)".into(), "simulation error".into(), 11_usize.into(), 98.9.into(), 93.17.into(), 1.42.into()])
            .stressed_row(["selected".into(), "simulation error".into(), 14_usize.into(), 99.34.into(), 97.8.into(), 1.08.into()])
            .row(["selected, no cross terms".into(), "prediction error".into(), 12_usize.into(), f64::NAN.into(), None::<f64>.into(), 3.2e-9.into()]),
        )
        .block(
            TimePlot::sampled("Validation record 1: measured over simulated", TS_S, N)
                .panel(
                    Panel::new("Torque", "Nm")
                        .series(Series::new("demand", demand.clone()).role(Role::Demand).held())
                        .measured(torque.clone())
                        .simulated(add(&torque, wave(1.1, 0.31))),
                )
                .panel(Panel::new("Lambda", "").measured(lambda).simulated(lambda_hat).level("lower", 0.9).level("upper", 1.1))
                .panel(Panel::new("Injected mass", "mg").measured(injection))
                .panel(Panel::new("Spark advance", "°CA").held("spark", spark))
                .panel(Panel::new("Engine speed", "rpm").line("speed", speed))
                .mark(30.0, "second half")
                .caption("Record of seed 11, 60 s, closed loop on torque and lambda."),
        )
        .heading("Residuals")
        .columns(vec![parity(&torque), autocorrelation()])
}

fn parity(torque: &[f64]) -> Block {
    let simulated = add(torque, wave(1.4, 0.77));
    let diagonal =
        XySeries { line: true, ..XySeries::new("equal", [15.0, 85.0], [15.0, 85.0]).role(Role::Limit) };
    XyPlot::new(
        "Simulated against measured",
        Axis::new("Measured torque", "Nm"),
        Axis::new("Simulated torque", "Nm"),
    )
    .points("samples", torque.to_vec(), simulated)
    .series(diagonal)
    .into()
}

fn autocorrelation() -> Block {
    let lag: Vec<f64> = (0..26).map(f64::from).collect();
    let bound = |sign: f64| XySeries {
        line: true,
        ..XySeries::new("95 % bound", [0.0, 25.0], [sign * 0.044; 2]).role(Role::Limit)
    };
    let value: Vec<f64> =
        lag.iter().map(|l| (-0.7 * l).exp() * (1.3 * l).cos() + 0.02 * (2.2 * l).sin()).collect();
    let plot = XyPlot::new(
        "Autocorrelation of the residual",
        Axis::new("Lag", "samples"),
        Axis::new("Correlation", ""),
    );
    let curve = XySeries { line: true, points: true, ..XySeries::new("torque residual", lag, value) };
    plot.series(curve).series(bound(1.0)).series(XySeries { label: String::new(), ..bound(-1.0) }).into()
}

fn calibration() -> Section {
    let demand: Vec<f64> = (0..600).map(|k| if (k / 100) % 2 == 0 { 30.0 } else { 70.0 }).collect();
    let ours: Vec<f64> = lag(&demand, 5.0);
    let rival: Vec<f64> = lag(&demand, 9.0);
    let lambda =
        |gain: f64| (0..600).map(|k| 1.0 + gain * (demand[k] - rival[k]) / 40.0).collect::<Vec<f64>>();
    Section::new("Validation on the engine")
        .text("Steps between 30 and 70 Nm at 2000 rpm with the three maps.")
        .block(
            TimePlot::sampled("Steps 30/70 Nm", TS_S, 600)
                .panel(
                    Panel::new("Torque", "Nm")
                        .demand(demand.clone())
                        .line("dynamic map", ours)
                        .line("static map", rival.clone()),
                )
                .panel(
                    Panel::new("Lambda", "")
                        .line("dynamic map", lambda(0.04))
                        .line("static map", lambda(0.29))
                        .line("static map with lag", lambda(-0.09))
                        .level("asked", 1.1),
                ),
        )
        .columns(vec![
            Bars::new(
                "Lambda spike",
                Axis::new("Largest |lambda - 1|", ""),
                ["dynamic map", "static map", "static map with lag"],
            )
            .series("up 30 to 70 Nm", [0.041, 0.288, 0.092])
            .series("down 70 to 30 Nm", [0.038, 0.263, 0.105])
            .level("asked at most", 0.10)
            .into(),
            Bars::new(
                "Fuel against the best-spark map",
                Axis::new("Difference", "%"),
                ["promised", "measured, pass 1", "measured, pass 2"],
            )
            .series("fuel", [-2.4, -1.1, -2.2])
            .caption("Measured with a small PI controller that holds the promised torque and lambda.")
            .into(),
        ])
}

fn maps() -> Section {
    let speed: Vec<f64> = (0..9).map(|i| 1000.0 + 250.0 * f64::from(i)).collect();
    let torque: Vec<f64> = (0..7).map(|j| 20.0 + 10.0 * f64::from(j)).collect();
    let over = |f: &dyn Fn(f64, f64) -> f64| {
        torque.iter().flat_map(|t| speed.iter().map(move |n| f(*n, *t))).collect::<Vec<f64>>()
    };
    let x = || (Axis::new("Speed", "rpm"), speed.clone());
    let y = || (Axis::new("Torque", "Nm"), torque.clone());
    let spark =
        over(&|n, t| 14.0 + 0.009 * (n - 1000.0) - 0.0022 * (t - 20.0).powi(2) + 12.0 * (-t / 60.0).exp());
    let offset = over(&|n, t| 0.9 * (n / 380.0).sin() * ((t - 15.0) / 14.0).cos());
    let visited: Vec<f64> = (0..60).map(|k| f64::from(k * k % 61) / 61.0).collect();
    Section::new("Maps")
        .columns(vec![
            HeatMap::new("Spark advance of the static part", x(), y(), (Axis::new("Spark", "°CA"), spark))
                .contours()
                .overlay(
                    "visited points",
                    visited.iter().map(|v| 1000.0 + 2000.0 * v).collect::<Vec<_>>(),
                    visited.iter().rev().map(|v| 20.0 + 60.0 * v).collect::<Vec<_>>(),
                )
                .caption("Contours follow the bilinear interpolation that the map uses.")
                .into(),
            HeatMap::new("Steady torque offset", x(), y(), (Axis::new("Offset", "Nm"), offset))
                .diverging()
                .cell_values()
                .into(),
        ])
        .block(curves(&speed))
}

fn curves(speed: &[f64]) -> XyPlot {
    let mut plot = XyPlot::new(
        "Fuel over spark",
        Axis::new("Spark advance", "°CA"),
        Axis::new("Fuel per torque work", "g/kWh"),
    );
    for n in speed.iter().step_by(2) {
        let spark: Vec<f64> = (0..27).map(|k| 8.0 + f64::from(k)).collect();
        let best = 16.0 + (n - 1000.0) * 0.007;
        let fuel: Vec<f64> =
            spark.iter().map(|s| 290.0 + (n - 2000.0) * 0.006 + 0.12 * (s - best) * (s - best)).collect();
        plot = plot.line(format!("{n} rpm"), spark, fuel);
    }
    plot.caption("One curve per speed at 50 Nm.")
}

/// What a run that went wrong hands over: the page must show it, not fall over it.
fn odd_data() -> Section {
    let mut diverging: Vec<f64> = (0..200).map(|k| 1.02_f64.powi(5 * k)).collect();
    diverging.extend([f64::INFINITY; 50]);
    let gaps: Vec<f64> = (0..250).map(|k| if k % 50 < 10 { f64::NAN } else { f64::from(k).sqrt() }).collect();
    let axis = || Axis::new("Speed", "rpm");
    Section::new("Odd data")
        .block(
            TimePlot::sampled("Diverging, constant, interrupted and empty lines", TS_S, 250)
                .panel(Panel::new("Diverging", "Nm").simulated(diverging.clone()))
                .panel(Panel::new("The same, range fixed", "Nm").simulated(diverging).range(0.0, 100.0))
                .panel(
                    Panel::new("Constant", "Nm").line("constant", vec![1e-9; 250]).line("interrupted", gaps),
                )
                .panel(Panel::new("Nothing finite", "Nm").line("empty", vec![f64::NAN; 250])),
        )
        .columns(vec![
            TimePlot::new("One sample", [3.0]).panel(Panel::new("Torque", "Nm").line("torque", [5.0])).into(),
            XyPlot::new("No finite point", axis(), axis()).points("none", [f64::NAN], [1.0]).into(),
            HeatMap::new(
                "One cell",
                (axis(), vec![1000.0]),
                (axis(), vec![1.0]),
                (Axis::new("Fuel", "mg"), vec![7.0]),
            )
            .cell_values()
            .into(),
            HeatMap::new(
                "Holes",
                (axis(), vec![1.0, 2.0, 4.0]),
                (axis(), vec![1.0, 2.0]),
                (Axis::new("Fuel", "mg"), vec![1.0, f64::NAN, 3.0, 4.0, 5.0, 6.0]),
            )
            .contours()
            .into(),
            Bars::new(
                "Zero, missing, both signs",
                Axis::new("Gain", "%"),
                ["a rather long name of a category that is cut at the end of the line", "missing", "below"],
            )
            .series("gain", [0.0, f64::NAN, -3.0])
            .series("rival", [2.0, 1.0, 0.5])
            .into(),
            Bars::new("All zero", Axis::new("Gain", "%"), ["a"]).series("gain", [0.0]).into(),
        ])
}

fn appendix() -> Section {
    let long: Vec<f64> =
        (0..50_000).map(|k| (k as f64 * 1e-3).sin() + if k == 31_234 { 2.0 } else { 0.0 }).collect();
    Section::new("Appendix")
        .block(
            Details::new("Spec as understood")
                .block(Block::Code { caption: "calibrate.toml".into(), text: "[excite]\nduration_s = 60.0\nhold_s = 3.0 # < 4 & > 2\nlevels = 5\n\n[identify]\nestimator = \"sem\"".into() }),
        )
        .block(
            Details::new("A long record").block(
                TimePlot::sampled("Cylinder pressure", 0.001, long.len()).panel(Panel::new("Pressure", "bar").line("cylinder 1", long)),
            ),
        )
        .code("Reproduce", "cargo run --release -- calibrate examples/gtdi/calibrate.toml --seed 1")
}
