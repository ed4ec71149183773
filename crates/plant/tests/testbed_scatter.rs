//! Cycles that scatter: their coefficient of variation of IMEP as stated, as the bed reads it, and with dilution.

use dynocal_ident::plant::{Causality, Plant, variable_index};
use dynocal_plant::bed::{BedSettings, EngineBed};
use dynocal_plant::combustion::flame_slowness;
use dynocal_plant::deviations::Scatter;
use dynocal_plant::params::EngineParams;
use dynocal_plant::testbed::settings::{BedOptions, RealEngine};

const START: [f64; 4] = [16.754, 18.95, 15.85, 2000.0];

fn bed(options: BedOptions) -> EngineBed {
    EngineBed::new(&EngineParams::thesis(), BedSettings { options, ..BedSettings::default() }).unwrap()
}

fn outputs(b: &EngineBed) -> Vec<f64> {
    vec![0.0; b.variables().iter().filter(|v| v.causality == Causality::Output).count()]
}

/// Coefficient of variation of the gross IMEP of one cylinder over `n` cycles.
fn imep_cov(b: &mut EngineBed, cylinder: usize, n: usize) -> f64 {
    let mut y = outputs(b);
    let work: Vec<f64> = (0..n)
        .map(|_| {
            b.step_angle(&START, 720.0, &mut y).unwrap();
            b.engine().cycle_log()[cylinder].gross_work_j
        })
        .collect();
    let mean = work.iter().sum::<f64>() / n as f64;
    (work.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / n as f64).sqrt() / mean
}

#[test]
fn burn_scatter_gives_the_stated_cov_of_imep() {
    let real = |heat, burn| BedOptions {
        engine: RealEngine { scatter: Scatter { heat, burn, dilution: 0.0 }, ..RealEngine::default() },
        ..BedOptions::default()
    };
    assert!(imep_cov(&mut bed(real(0.0, 0.0)), 0, 50) < 1e-3, "without scatter cycles repeat");
    let n = 600;
    for heat in [0.015, 0.03] {
        let mut b = bed(real(heat, 0.0));
        b.reset(1);
        let cov = imep_cov(&mut b, 1, n);
        // Gross work is the heat's work less a nearly constant compression loss, so COV is a little above `heat`;
        // standard error of a COV from n cycles is 1/sqrt(2n) = 3 %.
        assert!((cov / heat - 1.0).abs() < 0.2, "{heat}: {cov}");
    }
    // The duration alone moves the work by its square only, at the best spark.
    let mut b = bed(real(0.0, 0.05));
    b.reset(1);
    let cov = imep_cov(&mut b, 1, n);
    assert!(cov > 1e-4 && cov < 0.01, "{cov}");
}

/// `cov_imep` is what the cycles themselves show, cylinder by cylinder, and a ramp of load is no variation.
#[test]
fn cov_of_imep_is_read_from_the_cycles() {
    let engine = RealEngine {
        scatter: Scatter { heat: 0.02, burn: 0.0, dilution: 0.0 },
        fuel_imbalance: 0.04,
        ..RealEngine::default()
    };
    let options = BedOptions { engine, outputs: vec!["cov_imep".into()], ..BedOptions::default() };
    let mut b = bed(options);
    b.reset(1);
    let mut y = outputs(&b);
    let at = variable_index(&b, Causality::Output, "cov_imep").unwrap();
    let read = |b: &mut EngineBed, y: &mut [f64], n: usize, by_deg: f64| {
        let mut input = START;
        let (mut sum, mut work) = (0.0, Vec::new());
        for k in 0..n {
            input[2] = START[2] + by_deg * k as f64 / n as f64;
            b.step_angle(&input, 720.0, y).unwrap();
            sum += y[at] / n as f64;
            work.push(b.engine().cycle_log().map(|c| c.gross_work_j));
        }
        (sum, work)
    };
    read(&mut b, &mut y, 200, 0.0);
    let (shown, work) = read(&mut b, &mut y, 600, 0.0);
    let of = |c: usize| {
        let mean = work.iter().map(|w| w[c]).sum::<f64>() / work.len() as f64;
        work.iter().map(|w| (w[c] / mean - 1.0).powi(2)).sum::<f64>() / work.len() as f64
    };
    let counted = 100.0 * (0.25 * (0..4).map(of).sum::<f64>()).sqrt();
    // Of 2400 cycles on either side: standard error of each 1.4 to 2 %.
    assert!((shown / counted - 1.0).abs() < 0.06, "{shown} %, counted {counted} %");
    let (ramp, _) = read(&mut b, &mut y, 600, 2.0);
    assert!((ramp / shown - 1.0).abs() < 0.15, "{shown} % at rest, {ramp} % on a ramp");
}

/// A coefficient of variation that nothing makes is refused as an output and as a limit, with what it needs.
#[test]
fn cov_of_imep_asks_for_scatter() {
    let without = BedOptions { outputs: vec!["cov_imep".into()], ..BedOptions::default() };
    let settings = BedSettings { options: without, ..BedSettings::default() };
    let said =
        EngineBed::new(&EngineParams::thesis(), settings).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(said.contains("`cov_imep`") && said.contains("engine.scatter"), "{said}");
}

/// With `dilution` the scatter grows with the slowness of the flame.
#[test]
fn dilution_widens_the_scatter() {
    assert!((flame_slowness(1.0, 0.1) - 1.0).abs() < 1e-12);
    let s = Scatter { heat: 0.01, burn: 0.04, dilution: 1.5 };
    let wide = s.of_charge(1.0, 0.2);
    // By hand: S(0.1) = 0.6502, S(0.2) = 0.4034; (0.6502 / 0.4034)^1.5 = 2.046.
    assert!((wide.heat - 0.02046).abs() < 2e-4 && (wide.burn - 4.0 * wide.heat).abs() < 1e-12, "{wide:?}");
    assert!(s.of_charge(1.4, 0.1).heat > s.of_charge(1.2, 0.1).heat);
    assert!(s.of_charge(3.0, 0.5).heat <= 0.06 + 1e-12, "within its bound");
    let even = Scatter { dilution: 0.0, ..s };
    assert_eq!(even.of_charge(1.4, 0.3), even);
    let cov = |dilution| {
        let engine =
            RealEngine { scatter: Scatter { heat: 0.01, burn: 0.0, dilution }, ..RealEngine::default() };
        let mut b = bed(BedOptions { engine, ..BedOptions::default() });
        b.reset(1);
        let cov = imep_cov(&mut b, 0, 400);
        (cov, b.engine().cycle_log()[0])
    };
    let ((plain, _), (wider, last)) = (cov(0.0), cov(1.5));
    let expected = flame_slowness(last.lambda, last.residual).powf(1.5);
    // The same random numbers in both: the ratio is the scatter's.
    assert!((wider / plain / expected - 1.0).abs() < 0.03, "{plain} to {wider}, expected {expected}");
}
