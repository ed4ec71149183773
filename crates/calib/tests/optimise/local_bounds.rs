//! Bounds of an input sample by sample.

use super::common::{channel, problem};
use dynocal_calib::optimise::model::OutputModel;
use dynocal_calib::optimise::{OptimiseOptions, bound_channels, optimise_models};
use dynocal_ident::data::{Dataset, Role};
use dynocal_ident::model::poly::PolyNarx;

const N: usize = 40;

/// Heat from two burners, the second one cheaper: it takes what its bound of the sample lets it, the problem's where that is narrower,
/// and may stay where the start has it.
#[test]
fn an_input_keeps_the_bound_of_each_sample() {
    let problem = problem(
        r#"
        inputs = [{ name = "a", unit = "kW", lower = 0.0, upper = 9.0 }, { name = "b", unit = "kW", lower = 0.0, upper = 5.0 }]
        demands = [{ output = "heat", unit = "kW", lower = 0.0, upper = 11.0 }]
        minimise = [{ channel = "a", weight = 2.0 }, { channel = "b", weight = 1.0 }]
        "#,
    );
    let heat = PolyNarx::parse(&["a", "b"], "heat", &["a(t-1)", "b(t-1)"]).unwrap();
    let model = OutputModel::plain("heat", &heat, &[1.0, 1.0], &["a", "b"]);
    let upper: Vec<f64> = (0..N)
        .map(|t| {
            if t < 20 {
                3.0
            } else if t < 30 {
                8.0
            } else {
                0.5
            }
        })
        .collect();
    let [_, name] = bound_channels("b");
    let start = Dataset {
        name: "start".into(),
        sample_time_s: 1.0,
        channels: vec![
            channel("a", "kW", Role::Input, vec![6.0; N]),
            channel("b", "kW", Role::Input, vec![1.0; N]),
            channel("heat", "kW", Role::Output, vec![7.0; N]),
            channel(&name, "kW", Role::Auxiliary, upper),
        ],
        init_samples: 0,
        origin: "test".into(),
    };
    let found = optimise_models(&problem, &[model], &start, &OptimiseOptions::default(), &|| false).unwrap();
    assert!(found.status.is_success());
    let b = found.input("b").unwrap();
    for (t, v) in b.iter().enumerate().take(N - 1).skip(1) {
        let expected = if t < 20 {
            3.0
        } else if t < 30 {
            5.0
        } else {
            1.0
        };
        assert!((v - expected).abs() < 1e-5, "b({t}) = {v}, expected {expected}");
    }
    assert!(found.violation("heat") < 1e-6);
}
