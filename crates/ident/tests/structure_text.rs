//! The text form of regressors: what is read, what is printed, what is refused and how.

use dynocal_ident::model::Model;
use dynocal_ident::model::poly::{PolyNarx, StructureError};

fn parse(regressor: &str) -> Result<PolyNarx, StructureError> {
    PolyNarx::parse(&["inj", "spark", "1/speed"], "torque", &[regressor])
}

#[test]
fn text_is_read_and_printed_in_one_canonical_form() {
    for (written, printed) in [
        ("1", "1"),
        (" inj( t - 1 ) * spark(t-3)^2 ", "inj(t-1)*spark(t-3)^2"),
        ("spark(t-3)*inj(t-1)*spark(t-3)", "inj(t-1)*spark(t-3)^2"),
        ("torque(t-1)", "torque(t-1)"),
        ("1/speed(t)^2*torque(t-2)", "1/speed(t)^2*torque(t-2)"),
    ] {
        assert_eq!(parse(written).unwrap().param_name(0), printed);
    }
}

#[test]
fn faults_are_named() {
    let message = |r: &str| parse(r).unwrap_err().to_string();
    assert_eq!(
        message("sprak(t-1)"),
        "regressor `sprak(t-1)`: no channel `sprak` (did you mean `spark`?); channels are: inj, spark, 1/speed, torque"
    );
    assert_eq!(message("torque(t)"), "regressor `torque(t)`: found lag 0, expected 1 to 10000 samples");
    assert!(message("inj(t+1)").contains("expected `t` or `t-lag`"));
    assert!(message("inj").contains("found `inj`"));
    assert!(message("inj(t-1").contains("expected a closing `)`"));
    assert!(message("inj(t-1)^0").contains("expected a power"));
    assert!(message("inj(t-1)**spark(t)").contains("found ``"));
    assert!(message("inj(t-1)^9*spark(t)^9").contains("found degree 18, expected at most 12"));
    assert!(message("inj(t-99999)").contains("found lag 99999"));
}

#[test]
fn functions_are_read_and_printed_in_one_canonical_form() {
    for (written, printed) in [
        ("sqrt(torque(t-1))", "sqrt(torque(t-1))"),
        ("tanh( 2e3*torque(t-1)-2000 * torque(t-2) )^2", "tanh(2000*torque(t-1) - 2000*torque(t-2))^2"),
        ("pos(-inj(t)+ 0.5 -1/speed(t))", "pos(-inj(t) - 1/speed(t) + 0.5)"),
        ("abs(1 - spark(t-3))*inj(t)*abs(-spark(t-3)+1)", "inj(t)*abs(-spark(t-3) + 1)^2"),
        ("exp(inj(t) + inj(t) - 3e-9)", "exp(2*inj(t) - 3e-9)"),
    ] {
        let model = parse(written).unwrap();
        assert_eq!(model.param_name(0), printed);
        let json = serde_json::to_string(&model).unwrap();
        assert_eq!(serde_json::from_str::<PolyNarx>(&json).unwrap(), model, "{json}");
    }
    let message = |r: &str| parse(r).unwrap_err().to_string();
    assert!(message("tan(inj(t))").contains("expected one of abs, cos, exp, pos, sin, sqrt, tanh"));
    assert!(message("abs(2*ing(t))").contains("did you mean `inj`?"));
    assert!(message("abs(inj(t) spark(t))").contains("expected `+` or `-`"));
    assert!(message("abs(inj(t) - inj(t))").contains("at least one lagged channel"));
    assert!(message("sqrt(inj(t-1)").contains("regressor `sqrt(inj(t-1)`"));
    assert!(message("sqrt(torque(t))").contains("found lag 0, expected 1"));
}

#[test]
fn duplicates_empty_models_and_bad_names_are_refused() {
    let twice = PolyNarx::parse(&["a", "b"], "y", &["1", "a(t)*b(t)", "b(t)*a(t)"]).unwrap_err();
    assert_eq!(twice.to_string(), "regressor `a(t)*b(t)` is listed twice (places 2 and 3)");
    assert!(matches!(PolyNarx::parse::<&str, &str>(&["a"], "y", &[]), Err(StructureError::Empty { .. })));
    assert!(matches!(PolyNarx::parse(&["a", "a"], "y", &["1"]), Err(StructureError::Name { .. })));
    assert!(matches!(PolyNarx::parse(&["a(t)"], "y", &["1"]), Err(StructureError::Name { .. })));
}

#[test]
fn toml_and_json_hold_the_text_form() {
    let model = PolyNarx::arx(&["u".into(), "v".into()], "y", 2, 2, 1, true).unwrap();
    let toml = toml::to_string(&model).unwrap();
    assert!(toml.contains("\"u(t-1)\"") && toml.contains("\"y(t-2)\""), "{toml}");
    assert_eq!(toml::from_str::<PolyNarx>(&toml).unwrap(), model);
    let json = serde_json::to_string(&model).unwrap().replace("v(t-1)", "w(t-1)");
    assert!(serde_json::from_str::<PolyNarx>(&json).unwrap_err().to_string().contains("no channel `w`"));
}
