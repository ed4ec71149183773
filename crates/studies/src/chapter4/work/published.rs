//! Numbers that others found: the thesis, and an independent implementation of the same readings.

pub mod tables;

use super::Output;
use super::source::{DesignCriterion, Source};

const D: Source = Source::Design(DesignCriterion::D);
const AI: Source = Source::Design(DesignCriterion::Ai);

/// Free-run R2 in percent of torque models on noisy PRBS, APRBS and UDRN signals.
#[derive(Clone, Copy, Debug)]
pub struct R2 {
    /// Noise variance in Nm^2.
    pub noise_variance: f64,
    /// Identification signals.
    pub source: Source,
    /// Tables 4.14 (40), 4.11 (80; D from Table 4.17) and 4.15 (160).
    pub thesis: Option<[f64; 3]>,
    /// Mean and standard error over populations (100 signals, 20 designs; 40 validation signals) of an independent
    /// implementation. The error counts the identification signals.
    pub reference: [(f64, f64); 3],
}

/// Tables 4.11, 4.14 and 4.15.
pub const R2_TORQUE: &[R2] = &[
    R2 {
        noise_variance: 40.0,
        source: Source::Aprbs,
        thesis: Some([84.13, 76.89, 65.69]),
        reference: [(83.507, 0.302), (74.674, 0.237), (65.785, 0.238)],
    },
    R2 {
        noise_variance: 40.0,
        source: Source::Udrn,
        thesis: Some([76.13, 71.46, 62.60]),
        reference: [(75.835, 0.664), (69.115, 0.469), (61.674, 0.387)],
    },
    R2 {
        noise_variance: 40.0,
        source: D,
        thesis: None,
        reference: [(89.068, 0.183), (77.528, 0.534), (67.042, 1.064)],
    },
    R2 {
        noise_variance: 40.0,
        source: AI,
        thesis: Some([88.24, 80.04, 68.39]),
        reference: [(88.258, 0.279), (77.791, 0.308), (68.386, 0.450)],
    },
    R2 {
        noise_variance: 40.0,
        source: Source::Prbs,
        thesis: Some([-249.36, -636.69, -1198.01]),
        reference: [(88.988, 0.105), (61.572, 0.682), (34.456, 1.536)],
    },
    R2 {
        noise_variance: 80.0,
        source: Source::Aprbs,
        thesis: Some([72.06, 61.49, 47.55]),
        reference: [(70.124, 0.609), (57.287, 0.451), (46.545, 0.399)],
    },
    R2 {
        noise_variance: 80.0,
        source: Source::Udrn,
        thesis: Some([57.36, 51.84, 42.08]),
        reference: [(55.761, 1.160), (48.129, 0.775), (40.501, 0.600)],
    },
    R2 {
        noise_variance: 80.0,
        source: D,
        thesis: Some([76.54, 64.00, 48.14]),
        reference: [(79.982, 0.311), (63.406, 0.592), (49.273, 1.095)],
    },
    R2 {
        noise_variance: 80.0,
        source: AI,
        thesis: Some([78.73, 66.49, 51.65]),
        reference: [(78.732, 0.428), (63.022, 0.565), (51.317, 0.610)],
    },
    R2 {
        noise_variance: 80.0,
        source: Source::Prbs,
        thesis: Some([-449.75, -887.39, -1417.50]),
        reference: [(79.621, 0.181), (49.288, 0.765), (23.955, 1.554)],
    },
    R2 {
        noise_variance: 160.0,
        source: Source::Aprbs,
        thesis: Some([52.60, 40.67, 27.64]),
        reference: [(45.717, 1.125), (33.804, 0.666), (24.918, 0.528)],
    },
    R2 {
        noise_variance: 160.0,
        source: Source::Udrn,
        thesis: Some([27.37, 25.41, 19.56]),
        reference: [(26.578, 1.875), (22.264, 1.166), (17.395, 0.854)],
    },
    R2 {
        noise_variance: 160.0,
        source: D,
        thesis: None,
        reference: [(64.878, 0.589), (41.327, 1.518), (25.336, 2.588)],
    },
    R2 {
        noise_variance: 160.0,
        source: AI,
        thesis: Some([63.41, 48.18, 33.21]),
        reference: [(63.770, 0.566), (43.804, 0.581), (30.281, 1.143)],
    },
    R2 {
        noise_variance: 160.0,
        source: Source::Prbs,
        thesis: Some([-205.15, -456.58, -701.50]),
        reference: [(64.079, 0.354), (34.276, 0.904), (14.105, 1.627)],
    },
];

/// Objective values, torque model in the box (4.16).
#[derive(Clone, Copy, Debug)]
pub struct Objective {
    /// Criterion.
    pub criterion: DesignCriterion,
    /// Best value in the thesis (pattern search, 50 000 evaluations).
    pub thesis: Option<f64>,
    /// Median of ten single starts that a design tool must reach: CasADi with IPOPT.
    pub median_of_ten: f64,
    /// Best of its ten starts (five for G).
    pub best_of_ten: f64,
    /// Best known.
    pub best_known: f64,
}

const fn objective(
    criterion: DesignCriterion,
    thesis: Option<f64>,
    median_of_ten: f64,
    best_of_ten: f64,
    best_known: f64,
) -> Objective {
    Objective { criterion, thesis, median_of_ten, best_of_ten, best_known }
}

/// Tables 4.3, 4.6 and 4.9.
pub const OBJECTIVES: &[Objective] = &[
    objective(DesignCriterion::D, Some(-431.68), -436.2, -436.89, -438.720),
    objective(DesignCriterion::A, Some(1671.8), 899.0, 849.0, 729.78),
    objective(DesignCriterion::Wa, None, 1.954e5, 1.886e5, 1.7461e5),
    objective(DesignCriterion::I, Some(1536.7), 984.0, 963.5, 908.18),
    objective(DesignCriterion::G, Some(27.37), 13.23, 13.11, 12.737),
    objective(DesignCriterion::Ai, Some(4.33e5), 2.138e5, 2.045e5, 1.946e5),
];

/// A criterion of the signals of a kind (torque model).
#[derive(Clone, Copy, Debug)]
pub struct Criterion {
    /// Kind.
    pub source: Source,
    /// Criterion.
    pub criterion: DesignCriterion,
    /// One signal of the thesis.
    pub thesis: f64,
}

const fn criterion(source: Source, criterion: DesignCriterion, thesis: f64) -> Criterion {
    Criterion { source, criterion, thesis }
}

/// Table 4.9, and J_D and J_A of Tables 4.6 and 4.16.
pub const CRITERIA: &[Criterion] = &[
    criterion(Source::Prbs, DesignCriterion::G, 3.58e13),
    criterion(Source::Prbs, DesignCriterion::I, 1.31e15),
    criterion(Source::Prbs, DesignCriterion::Ai, 3.76e17),
    criterion(Source::Aprbs, DesignCriterion::G, 34.66),
    criterion(Source::Aprbs, DesignCriterion::I, 1830.0),
    criterion(Source::Aprbs, DesignCriterion::Ai, 6.86e5),
    criterion(Source::Udrn, DesignCriterion::D, -401.42),
    criterion(Source::Udrn, DesignCriterion::A, 9460.7),
    criterion(Source::Udrn, DesignCriterion::G, 133.37),
    criterion(Source::Udrn, DesignCriterion::I, 4225.6),
    criterion(Source::Udrn, DesignCriterion::Ai, 1.8109e6),
    criterion(Source::Design(DesignCriterion::G), DesignCriterion::G, 27.37),
    criterion(Source::Design(DesignCriterion::G), DesignCriterion::I, 1727.5),
    criterion(Source::Design(DesignCriterion::G), DesignCriterion::Ai, 4.56e5),
    criterion(Source::Design(DesignCriterion::I), DesignCriterion::G, 31.35),
    criterion(Source::Design(DesignCriterion::I), DesignCriterion::I, 1536.7),
    criterion(Source::Design(DesignCriterion::I), DesignCriterion::Ai, 5.64e5),
    criterion(AI, DesignCriterion::G, 39.61),
    criterion(AI, DesignCriterion::I, 1749.6),
    criterion(AI, DesignCriterion::Ai, 4.33e5),
    criterion(Source::Design(DesignCriterion::A), DesignCriterion::D, -410.87),
    criterion(Source::Design(DesignCriterion::A), DesignCriterion::A, 3271.1),
    criterion(D, DesignCriterion::D, -431.68),
    criterion(D, DesignCriterion::A, 4852.7),
];

/// Parameter error and R2 of models of both outputs (noise variance 80 Nm^2 and 0.04).
#[derive(Clone, Copy, Debug)]
pub struct Mimo {
    /// Model.
    pub output: Output,
    /// Identification signals.
    pub source: Source,
    /// Mean relative error of the parameters: thesis, independent implementation.
    pub error: (f64, f64),
    /// R2 in percent on PRBS, APRBS and UDRN: thesis.
    pub thesis: [f64; 3],
    /// The same of the independent implementation (10 signals, 5 draws of the noise each).
    pub reference: [f64; 3],
}

const fn mimo(
    output: Output,
    source: Source,
    error: (f64, f64),
    thesis: [f64; 3],
    reference: [f64; 3],
) -> Mimo {
    Mimo { output, source, error, thesis, reference }
}

/// Tables 4.17 and 4.18.
pub const MIMO: &[Mimo] = &{
    use Output::{Lambda, Torque};
    const D2: Source = Source::Composite(DesignCriterion::D);
    const AI2: Source = Source::Composite(DesignCriterion::Ai);
    [
        mimo(Torque, D2, (2.08, 1.79), [76.54, 64.00, 48.14], [80.2, 62.4, 50.7]),
        mimo(Torque, AI2, (2.76, 2.17), [77.80, 65.85, 50.50], [78.0, 61.3, 51.8]),
        mimo(Torque, Source::Prbs, (2.45, 2.11), [-449.75, -892.30, -1416.0], [79.4, 49.0, 28.8]),
        mimo(Torque, Source::Aprbs, (2.24, 2.73), [72.09, 61.63, 47.54], [69.8, 55.9, 47.8]),
        mimo(Torque, Source::Udrn, (4.50, 4.01), [57.36, 52.00, 42.08], [58.0, 47.0, 42.2]),
        mimo(Lambda, D2, (0.31, 0.35), [85.82, 75.10, 59.24], [90.4, 78.1, 63.0]),
        mimo(Lambda, AI2, (0.34, 0.37), [86.64, 76.63, 61.76], [89.4, 80.0, 67.8]),
        mimo(Lambda, Source::Prbs, (2.40, 0.73), [-6210.0, -11732.0, -13961.0], [90.3, 55.7, 27.6]),
        mimo(Lambda, Source::Aprbs, (0.54, 0.58), [82.75, 73.95, 59.81], [85.1, 77.3, 65.7]),
        mimo(Lambda, Source::Udrn, (0.59, 0.87), [72.68, 67.05, 55.81], [77.3, 72.6, 62.5]),
    ]
};

/// Example 1: best known J_A without and with zeros before the record, and of the thesis (UDRN, optimal).
pub const FIR_BEST: [f64; 2] = [3.093_434_343_434_343_4e-4, 3.061_865_432_666_912_5e-4];
/// Sums of the columns of Table 4.2.
pub const FIR_THESIS: [f64; 2] = [8.51e-4, 3.25e-4];
