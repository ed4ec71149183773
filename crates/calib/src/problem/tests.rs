use super::*;

fn faults(problem: &CalibrationProblem) -> String {
    let mut faults = Faults::default();
    problem.check("problem", &mut faults);
    format!("{faults:?}")
}

#[test]
fn the_thesis_problem_is_sound_and_keeps_its_text_form() {
    let problem = CalibrationProblem::thesis();
    let mut found = Faults::default();
    problem.check("", &mut found);
    assert!(found.is_empty());
    let text = toml::to_string(&problem).unwrap();
    assert_eq!(toml::from_str::<CalibrationProblem>(&text).unwrap(), problem);
    assert_eq!(problem.unit("fuel"), Some("kg/h"));
}

#[test]
fn every_fault_is_named_at_once() {
    let mut p = CalibrationProblem::thesis();
    p.inputs[0].lower = f64::NAN;
    p.inputs[1].rate_per_s = Some(0.0);
    p.inputs[2].increment_weight = Some(-1.0);
    p.given[0].name = "inj".into();
    p.demands[1].upper = 0.5;
    p.minimise[0].channel = "fule".into();
    p.derive[0].powers.insert("sped".into(), 1);
    let text = faults(&p);
    let keys = [
        "problem.inputs[0].lower",
        "problem.inputs[1].rate_per_s",
        "problem.inputs[2].increment_weight",
        "problem.given[0].name",
        "problem.demands[1].lower",
        "problem.minimise[0].channel",
        "problem.derive[0]",
    ];
    for key in keys {
        assert!(text.contains(key), "{key} is not in {text}");
    }
}

#[test]
fn a_limit_of_a_derived_channel_is_one_of_its_mean() {
    let mut p = CalibrationProblem::thesis();
    let limit = |upper, mean_upper| LimitChannel {
        output: "fuel".into(),
        unit: "kg/h".into(),
        lower: None,
        upper,
        mean_upper,
        soft_weight: None,
    };
    p.limits = vec![limit(None, Some(3.0))];
    assert!(!faults(&p).contains("key"));
    p.limits = vec![limit(Some(4.0), None)];
    assert!(faults(&p).contains("mean_upper"));
}

#[test]
fn derivations_are_put_into_each_other() {
    let mut p = CalibrationProblem::thesis();
    let powers = [("fuel".to_string(), 1), ("torque".to_string(), -1), ("speed".to_string(), -1)];
    let factor = 9549.3;
    let economy = Derived { name: "economy".into(), unit: "kg/kWh".into(), factor, powers: powers.into() };
    p.derive.push(economy);
    let m = p.monomial("economy");
    assert!((m.factor - 1.2e-4 * factor).abs() < 1e-12);
    let mut powers = m.powers;
    powers.sort();
    assert_eq!(powers, [("inj".to_string(), 1), ("torque".to_string(), -1)]);
}
