//! The design in the reference space: its gradient against central differences.

use dynocal_calib::map::start::StartRule;
use dynocal_calib::map::{MapLimits, Reference};
use dynocal_design::channel::Channel;
use dynocal_design::criterion::criterion;
use dynocal_design::problem::{Convention, DesignProblem, Evaluator, Term};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_jobs::calibrate::reference_design::{ReferenceLayout, ReferenceObjective, model_inputs};
use dynocal_jobs::calibrate::spec::DesignSpec;
use dynocal_numerics::optim::Objective;
use dynocal_numerics::rng::Rng64;

fn rule(rng: &mut Rng64) -> StartRule {
    let records: Vec<_> = (0..2)
        .map(|_| {
            (0..400)
                .map(|_| {
                    let r = Reference {
                        torque_nm: rng.uniform_in(10.0, 90.0),
                        lambda: rng.uniform_in(0.9, 1.1),
                        speed_rpm: rng.uniform_in(1000.0, 3000.0),
                    };
                    let spark = rng.uniform_in(5.0, 30.0);
                    let inj = 4.0 + 0.18 * r.torque_nm / r.lambda;
                    (r, [inj, spark, 3.0 + 0.1 * r.torque_nm * r.speed_rpm / 2000.0])
                })
                .unzip()
        })
        .collect();
    StartRule::fit(&records, MapLimits { lower: [1.0, 5.0, 0.0], upper: [30.0, 30.0, 60.0] })
        .expect("fit")
        .without_look_ahead()
}

#[test]
fn gradient_agrees_with_central_differences() {
    let mut rng = Rng64::new(11);
    let rule = rule(&mut rng);
    let spec = DesignSpec { hold_s: 0.3, ramp_s: 0.09, speed_point_s: 0.6, ..DesignSpec::default() };
    let n = 120;
    let layout = ReferenceLayout::new(&spec, n, 0.03);
    let names = ["inj", "spark", "throttle", "speed", "cycle"];
    let regressors = [
        "1",
        "inj(t-1)",
        "spark(t-1)",
        "throttle(t-2)",
        "inj(t-1)*cycle(t-1)",
        "throttle(t-1)*cycle(t-1)",
        "spark(t-1)^2",
        "speed(t-1)",
        "torque(t-1)",
    ];
    let model = PolyNarx::parse(&names, "torque", &regressors).expect("structure");
    let theta = [-8.0, 2.0, 0.4, 0.6, 1.0, 3.0, -0.008, -0.001, 0.8];
    for name in ["d", "ai"] {
        let c = criterion(name, &toml::Table::new()).expect("criterion");
        let (lower, upper) = layout.bounds(&spec);
        let z: Vec<f64> = lower.iter().map(|_| rng.uniform_in(0.1, 0.9)).collect();
        let x: Vec<f64> = z.iter().zip(lower.iter().zip(&upper)).map(|(z, (a, b))| a + z * (b - a)).collect();
        let objective = model_inputs(&rule, &layout.reference(&x));
        let mut term = Term::new("torque", &model, &theta, 4.0, c.as_ref());
        term.initial_output = 40.0;
        term.objective_signal = &objective;
        let problem = DesignProblem {
            channels: names.map(|n| Channel::free(n, -1e9, 1e9)).to_vec(),
            n_samples: n,
            convention: Convention::Trim,
            start: 0,
            terms: vec![term],
        };
        let evaluator = Evaluator::new(&problem).expect("evaluator");
        let mut f = ReferenceObjective::new(&layout, &rule, evaluator, (lower, upper));
        let mut gradient = vec![0.0; z.len()];
        f.value_gradient(&z, &mut gradient);
        let scale = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        assert!(scale > 0.0);
        for k in 0..z.len() {
            let h = 1e-5;
            let (mut up, mut down) = (z.clone(), z.clone());
            up[k] += h;
            down[k] -= h;
            let slope = (f.value_gradient(&up, &mut []) - f.value_gradient(&down, &mut [])) / (2.0 * h);
            assert!((slope - gradient[k]).abs() < 1e-6 * scale, "{name} {k}: {slope} {}", gradient[k]);
        }
    }
}

/// Amplitudes are in the box and no sample moves faster than the ramps allow.
#[test]
fn any_record_of_the_layout_respects_amplitude_and_rate() {
    let spec = DesignSpec::default();
    let (n, dt) = (2000, 0.03);
    let layout = ReferenceLayout::new(&spec, n, dt);
    let (lower, upper) = layout.bounds(&spec);
    let mut rng = Rng64::new(3);
    let x: Vec<f64> =
        lower.iter().zip(&upper).map(|(a, b)| if rng.uniform() < 0.5 { *a } else { *b }).collect();
    let r = layout.reference(&x);
    let ranges = [spec.torque_nm, spec.lambda, spec.spark_deg, spec.speed_rpm];
    let times = [spec.ramp_s, spec.ramp_s, spec.ramp_s, spec.speed_point_s];
    for c in 0..4 {
        let (lo, hi) = ranges[c];
        assert!(r.iter().all(|v| v[c] >= lo - 1e-9 && v[c] <= hi + 1e-9));
        let steepest = r.windows(2).map(|w| (w[1][c] - w[0][c]).abs()).fold(0.0, f64::max);
        assert!(steepest <= (hi - lo) / times[c] * dt * (1.0 + 1e-9), "{c}: {steepest}");
    }
}
