//! Models of the thesis with their printed parameters, shared by documentation, tests and benches.

use super::poly::{PolyNarx, StructureError};

/// A structure with parameters and where they were printed.
#[derive(Clone, Debug)]
pub struct LiteratureModel {
    /// Structure.
    pub model: PolyNarx,
    /// Parameters; empty where the source gives a structure only.
    pub theta: Vec<f64>,
    /// Variance of the white measurement noise; 0 where none is given.
    pub noise_variance: f64,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Equation.
    pub source: &'static str,
}

/// Torque model of eq. (4.17): inputs fuel pulse width `fpw`, air bleed valve `abv` (fraction) and `speed`.
///
/// Regressor 17 is printed twice; it is counted once. theta23 is 0.15, as under the equation.
pub fn torque_4_17() -> LiteratureModel {
    let regressors = [
        "1",
        "fpw(t)",
        "fpw(t)*abv(t-10)",
        "fpw(t)*speed(t)",
        "fpw(t)*speed(t-3)",
        "fpw(t-10)*abv(t-10)",
        "fpw(t-10)*speed(t-9)",
        "fpw(t-10)^2",
        "abv(t-10)^2",
        "abv(t-10)*speed(t-9)",
        "speed(t)^2",
        "speed(t-2)*speed(t-4)",
        "abv(t-10)*speed(t)",
        "fpw(t-10)",
        "speed(t)*speed(t-5)",
        "speed(t-1)*speed(t-10)",
        "abv(t-10)*speed(t-5)",
        "speed(t-2)*speed(t-9)",
        "speed(t-2)*speed(t-6)",
        "fpw(t-6)*abv(t-7)",
        "fpw(t-6)*fpw(t-10)",
        "fpw(t-6)*fpw(t)",
        "torque(t-10)",
    ];
    let theta = vec![
        64.17, -0.025, 0.062, -4.06e-7, 2.73e-6, -0.0069, 8.5e-7, 1.54e-6, -327.7, 0.0016, -1.52e-5,
        -4.22e-8, 0.069, -0.014, -1.56e-6, -2.25e-6, 0.029, 5.67e-7, 6.4e-7, 0.0021, 8.71e-7, -1.36e-6, 0.15,
    ];
    LiteratureModel {
        model: known(&["fpw", "abv", "speed"], "torque", &regressors),
        theta,
        noise_variance: 80.0,
        sample_time_s: 0.1,
        source: "eq. (4.17)",
    }
}

/// Lambda model of eq. (4.53), same inputs as [`torque_4_17`].
///
/// Regressor 15 is printed u3(t)u3(t)u3(t-7) and read as u3(t)u3(t-7): the cubic gives lambda in the thousands.
pub fn lambda_4_53() -> LiteratureModel {
    let regressors = [
        "1",
        "abv(t-10)^2",
        "fpw(t-10)*speed(t-10)",
        "fpw(t)*speed(t-7)",
        "abv(t-10)*speed(t)",
        "fpw(t-10)*abv(t-10)",
        "fpw(t)*speed(t-10)",
        "fpw(t)^2",
        "fpw(t-10)",
        "speed(t)",
        "speed(t)^2",
        "fpw(t-10)^2",
        "abv(t-10)*speed(t-7)",
        "speed(t-10)",
        "speed(t)*speed(t-7)",
        "fpw(t)*fpw(t-10)",
        "fpw(t)*abv(t-10)",
        "speed(t-7)^2",
        "abv(t-10)",
        "speed(t-4)",
        "speed(t)*speed(t-4)",
    ];
    let theta = vec![
        5.69, 10.75, 1.86e-7, 1.75e-8, 0.0046, 0.00031, -2.37e-7, 5.05e-8, -0.00066, 0.0031, -1.28e-6,
        2.27e-8, 0.003, -8.69e-5, -1.37e-6, -1.50e-8, -0.0002, 3.22e-7, -23.36, -0.00023, 3.18e-7,
    ];
    LiteratureModel {
        model: known(&["fpw", "abv", "speed"], "lambda", &regressors),
        theta,
        noise_variance: 0.04,
        sample_time_s: 0.1,
        source: "eq. (4.53)",
    }
}

/// Linear torque model of eqs. (5.3) and (5.4); `abv` is a fraction. Noise variance as in the reference data.
pub fn torque_5_3() -> LiteratureModel {
    let regressors = [
        "1",
        "abv(t-5)",
        "abv(t-6)",
        "abv(t-7)",
        "spark(t-1)",
        "speed(t-5)",
        "speed(t-6)",
        "speed(t-7)",
        "torque(t-1)",
        "torque(t-2)",
        "torque(t-3)",
        "torque(t-4)",
    ];
    let theta = vec![-5.11, 14.27, -50.82, 35.74, 0.028, -0.025, 0.043, -0.015, 0.20, 0.30, 0.040, 0.25];
    LiteratureModel {
        model: known(&["abv", "spark", "speed"], "torque", &regressors),
        theta,
        noise_variance: 0.5,
        sample_time_s: 0.1,
        source: "eqs. (5.3), (5.4)",
    }
}

/// Torque model of eq. (7.8) with the simulation-error parameters of eq. (7.10); inputs in mg, deg, deg, rpm.
pub fn torque_7_8() -> LiteratureModel {
    let regressors = [
        "1",
        "inj(t-1)",
        "inj(t-2)",
        "inj(t-3)",
        "spark(t-1)",
        "spark(t-2)",
        "throttle(t-1)",
        "throttle(t-2)",
        "speed(t-1)",
        "torque(t-1)",
        "inj(t-1)*spark(t-1)",
        "inj(t-1)*throttle(t-1)",
        "spark(t-1)^2",
        "spark(t-1)*throttle(t-1)",
        "throttle(t-2)^2",
        "throttle(t-2)^3",
    ];
    let theta = vec![
        -21.33, 1.43, 0.60, -1.09, 1.38, -0.37, 0.62, 0.88, -0.0016, 0.77, -0.02, 3.96e-4, -0.0202, -0.0092,
        -0.0132, -2.36e-5,
    ];
    LiteratureModel {
        model: known(&["inj", "spark", "throttle", "speed"], "torque", &regressors),
        theta,
        noise_variance: 0.0,
        sample_time_s: 0.03,
        source: "eqs. (7.8), (7.10)",
    }
}

/// Lambda model of eq. (7.8) with the simulation-error parameters of eq. (7.10).
///
/// The equation lists `speed(t-1)` before `lambda(t-1)`, the numbers of (7.9) and (7.10) come the other way round
/// (0.82 and 0.64 are output coefficients). The order here is that of the equation, the numbers are put right.
pub fn lambda_7_8() -> LiteratureModel {
    let regressors =
        ["1", "inj(t-1)", "inj(t-2)", "spark(t-1)", "throttle(t-3)", "speed(t-1)", "lambda(t-1)"];
    LiteratureModel {
        model: known(&["inj", "spark", "throttle", "speed"], "lambda", &regressors),
        theta: vec![0.51, 0.15, -0.16, -3.18e-4, 0.012, -6.96e-5, 0.64],
        noise_variance: 0.0,
        sample_time_s: 0.03,
        source: "eqs. (7.8), (7.10)",
    }
}

/// Inverse models of eq. (7.18): injection, spark and throttle from torque, lambda and speed (structures only).
pub fn inverse_7_18() -> [LiteratureModel; 3] {
    let inputs = ["torque", "lambda", "speed"];
    let inj = [
        "1",
        "torque(t-3)",
        "inj(t-1)",
        "torque(t-2)*lambda(t-3)",
        "lambda(t-3)*inj(t-1)",
        "speed(t-3)*inj(t-1)",
    ];
    let spark =
        ["1", "spark(t-1)", "torque(t-3)*spark(t-1)", "torque(t-2)*speed(t-1)", "lambda(t-1)*spark(t-1)"];
    let throttle = [
        "torque(t-1)",
        "torque(t-2)",
        "lambda(t-1)",
        "lambda(t-2)",
        "lambda(t-3)",
        "lambda(t-4)",
        "speed(t-1)",
        "speed(t-2)",
    ];
    let of = |output, regressors: &[&str]| LiteratureModel {
        model: known(&inputs, output, regressors),
        theta: Vec::new(),
        noise_variance: 0.0,
        sample_time_s: 0.03,
        source: "eq. (7.18)",
    };
    [of("inj", &inj), of("spark", &spark), of("throttle", &throttle)]
}

/// A structure that is written in this file: a fault in it is ours.
fn known(inputs: &[&str], output: &str, regressors: &[&str]) -> PolyNarx {
    let model: Result<PolyNarx, StructureError> = PolyNarx::parse(inputs, output, regressors);
    model.expect("literature structures are well formed")
}
