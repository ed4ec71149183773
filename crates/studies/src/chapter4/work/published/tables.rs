//! Tables that only the thesis printed, and what an independent implementation found of some of them.

use super::super::constrained::{Kind, Limits};
use super::super::source::{DesignCriterion, Source};

/// One parameter of Tables 4.4, 4.5 and 4.7. "Bound" is the square root of the diagonal of M^-1.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Estimate from the UDRN signal and its bound b1.
    pub udrn: (f64, f64),
    /// Estimate, bound b2 and b2 / b1 of the A-optimal signal (Table 4.4).
    pub a: (f64, f64, f64),
    /// The same of the weighted A-optimal signal (Table 4.5).
    pub wa: (f64, f64, f64),
    /// The same of the D-optimal signal (Table 4.7).
    pub d: (f64, f64, f64),
}

impl Parameter {
    /// Estimate, bound and ratio of a criterion that has a table.
    pub fn of(&self, criterion: DesignCriterion) -> Option<(f64, f64, f64)> {
        match criterion {
            DesignCriterion::A => Some(self.a),
            DesignCriterion::Wa => Some(self.wa),
            DesignCriterion::D => Some(self.d),
            _ => None,
        }
    }
}

const fn parameter(
    estimate: f64,
    bound: f64,
    a: (f64, f64, f64),
    wa: (f64, f64, f64),
    d: (f64, f64, f64),
) -> Parameter {
    Parameter { udrn: (estimate, bound), a, wa, d }
}

/// Tables 4.4, 4.5 and 4.7: one row per parameter of eq. (4.17).
pub const PARAMETERS: [Parameter; 23] = [
    parameter(77.27, 23.16, (45.03, 16.46, 0.71), (88.12, 14.15, 0.61), (64.35, 18.44, 0.80)),
    parameter(-0.034, 0.0056, (-0.0133, 0.0095, 1.70), (-0.031, 0.0047, 0.84), (-0.0211, 0.0047, 0.84)),
    parameter(0.070, 0.0099, (0.0364, 0.0167, 1.69), (0.070, 0.0091, 0.92), (0.0571, 0.0083, 0.84)),
    parameter(
        1.31e-6,
        2.39e-6,
        (7.90e-7, 2.06e-6, 0.86),
        (4.32e-7, 1.47e-6, 0.62),
        (-2.19e-6, 9.79e-7, 0.41),
    ),
    parameter(2.82e-6, 7.41e-7, (2.31e-6, 7.97e-7, 1.08), (3.35e-6, 7.29e-7, 0.98), (2.74e-6, 4.49e-7, 0.61)),
    parameter(-0.0034, 0.0093, (0.0103, 0.0163, 1.75), (0.0062, 0.0091, 0.98), (-0.0109, 0.0086, 0.92)),
    parameter(
        2.42e-6,
        1.85e-6,
        (-1.01e-7, 1.95e-6, 1.05),
        (2.97e-6, 1.51e-6, 0.82),
        (2.24e-6, 1.03e-6, 0.56),
    ),
    parameter(
        1.63e-6,
        6.32e-7,
        (6.887e-7, 8.81e-7, 1.39),
        (1.61e-6, 6.51e-7, 1.03),
        (1.91e-6, 8.25e-7, 1.31),
    ),
    parameter(-135.99, 94.47, (-247.13, 54.77, 0.58), (-319.57, 57.31, 0.61), (-233.33, 67.18, 0.71)),
    parameter(-0.027, 0.0167, (0.0103, 0.0185, 1.10), (-0.019, 0.011, 0.66), (-0.0051, 0.01, 0.60)),
    parameter(
        -1.24e-5,
        7.07e-6,
        (-2.09e-5, 1.15e-5, 1.62),
        (-1.36e-5, 4.70e-6, 0.66),
        (-6.60e-6, 5.92e-6, 0.84),
    ),
    parameter(
        3.89e-7,
        1.69e-6,
        (-4.26e-7, 2.26e-6, 1.34),
        (-3.55e-9, 1.56e-6, 0.92),
        (2.10e-6, 1.16e-6, 0.69),
    ),
    parameter(-0.0127, 0.041, (0.064, 0.0523, 1.27), (0.049, 0.026, 0.63), (0.0326, 0.0317, 0.77)),
    parameter(-0.0156, 0.0074, (-0.013, 0.0115, 1.55), (-0.023, 0.0064, 0.86), (-0.016, 0.008, 1.08)),
    parameter(
        1.40e-5,
        8.20e-6,
        (8.54e-6, 9.82e-6, 1.20),
        (1.49e-7, 4.38e-6, 0.53),
        (-2.78e-6, 3.66e-6, 0.45),
    ),
    parameter(
        -3.63e-6,
        1.61e-6,
        (-1.72e-6, 1.73e-6, 1.07),
        (-3.58e-6, 1.41e-6, 0.87),
        (-1.88e-6, 9.31e-7, 0.58),
    ),
    parameter(-0.004, 0.0241, (-0.0068, 0.0321, 1.33), (0.021, 0.012, 0.50), (0.032, 0.0116, 0.48)),
    parameter(
        7.53e-6,
        2.99e-6,
        (-3.25e-7, 4.19e-6, 1.40),
        (1.61e-6, 2.55e-6, 0.85),
        (-2.12e-6, 1.87e-6, 0.62),
    ),
    parameter(
        -2.35e-6,
        1.89e-6,
        (1.29e-7, 2.24e-6, 1.19),
        (7.80e-7, 1.65e-6, 0.87),
        (-1.06e-6, 1.19e-6, 0.63),
    ),
    parameter(0.0017, 0.0016, (0.0039, 0.0027, 0.96), (0.0015, 0.0026, 1.62), (0.001, 0.0023, 1.44)),
    parameter(4.20e-7, 3.98e-7, (8.34e-7, 4.09e-7, 1.03), (9.48e-7, 3.87e-7, 0.97), (7.02e-7, 2.19e-7, 0.55)),
    parameter(
        -1.24e-6,
        3.69e-7,
        (-1.56e-6, 3.72e-7, 1.01),
        (-1.35e-6, 3.78e-7, 1.02),
        (-1.22e-6, 2.30e-7, 0.62),
    ),
    parameter(0.0928, 0.0727, (0.0863, 0.0983, 1.35), (0.14, 0.073, 1.00), (0.0754, 0.0554, 0.76)),
];

/// Mean of b2 / b1 in per cent that the text states for A, WA and D; its Table 4.5 averages 84.2, not 81.37.
pub const MEAN_RATIO: [(DesignCriterion, f64); 3] =
    [(DesignCriterion::A, 122.73), (DesignCriterion::Wa, 81.37), (DesignCriterion::D, 74.39)];

/// Table 4.3: `J_A` of a UDRN signal and of the optimal signal.
pub const TABLE_4_3: [f64; 2] = [4944.02, 1671.8];

/// Table 4.2: variances of the three parameters of Example 1, UDRN and optimal.
pub const TABLE_4_2: [[f64; 3]; 2] = [[0.000282, 0.000284, 0.000285], [0.000108, 0.000109, 0.000108]];

/// Table 4.8: e at the initial state and after each iteration, and the same of an independent implementation (mean of
/// 20 runs) with pooled and with fresh data.
pub const TABLE_4_8: [f64; 6] = [2.63, 1.11, 0.8, 0.68, 0.53, 0.5];
/// Pooled data.
pub const ITERATION_POOLED: [f64; 6] = [2.08, 2.01, 1.14, 0.89, 0.85, 0.69];
/// Fresh data.
pub const ITERATION_FRESH: [f64; 6] = [2.08, 2.01, 1.36, 1.68, 1.73, 1.72];

/// Table 4.10: mean correlation coefficients of u1, u2 and u3.
pub const TABLE_4_10: [(Source, [f64; 3]); 6] = [
    (Source::Prbs, [0.091, 0.092, 0.103]),
    (Source::Aprbs, [0.079, 0.097, 0.086]),
    (Source::Udrn, [0.082, 0.091, 0.097]),
    (Source::Design(DesignCriterion::I), [0.097, 0.082, 0.094]),
    (Source::Design(DesignCriterion::G), [0.132, 0.100, 0.087]),
    (Source::Design(DesignCriterion::Ai), [0.098, 0.081, 0.095]),
];

/// Columns U_G, U_I and U_AI of Tables 4.14 (noise variance 40), 4.11 (80) and 4.15 (160). In Table 4.15 the last two
/// columns of M_APRBS and M_UDRN are swapped in print (every other row has U_I 12 to 14 points above U_AI) and stand the
/// right way round here.
pub const R2_DESIGNED: [(f64, Source, [f64; 3]); 18] = {
    const G: Source = Source::Design(DesignCriterion::G);
    const I: Source = Source::Design(DesignCriterion::I);
    const AI: Source = Source::Design(DesignCriterion::Ai);
    [
        (40.0, Source::Prbs, [-585.38, -222.17, -409.60]),
        (40.0, Source::Aprbs, [78.89, 87.75, 80.38]),
        (40.0, Source::Udrn, [73.55, 83.73, 73.86]),
        (40.0, G, [81.62, 89.88, 83.45]),
        (40.0, I, [80.45, 90.74, 84.16]),
        (40.0, AI, [81.31, 90.51, 84.32]),
        (80.0, Source::Prbs, [-817.37, -388.85, -646.13]),
        (80.0, Source::Aprbs, [64.07, 78.30, 66.58]),
        (80.0, Source::Udrn, [54.38, 70.68, 54.91]),
        (80.0, G, [68.11, 81.38, 70.85]),
        (80.0, I, [67.56, 83.37, 72.35]),
        (80.0, AI, [68.19, 82.75, 72.76]),
        (160.0, Source::Prbs, [-444.11, -182.16, -321.48]),
        (160.0, Source::Aprbs, [43.31, 62.71, 46.31]),
        (160.0, Source::Udrn, [27.65, 49.30, 27.26]),
        (160.0, G, [49.18, 67.34, 52.26]),
        (160.0, I, [49.63, 71.08, 56.42]),
        (160.0, AI, [49.90, 69.93, 55.76]),
    ]
};

/// Columns U_PRBS, U_APRBS and U_UDRN of the rows M_UG and M_UI, which have no reference of another implementation.
pub const R2_OF_DESIGNS: [(f64, Source, [f64; 3]); 6] = [
    (40.0, Source::Design(DesignCriterion::G), [87.60, 79.55, 68.32]),
    (40.0, Source::Design(DesignCriterion::I), [88.64, 79.13, 65.24]),
    (80.0, Source::Design(DesignCriterion::G), [77.37, 65.09, 50.63]),
    (80.0, Source::Design(DesignCriterion::I), [79.84, 65.72, 48.49]),
    (160.0, Source::Design(DesignCriterion::G), [60.80, 45.52, 31.22]),
    (160.0, Source::Design(DesignCriterion::I), [65.51, 47.65, 30.23]),
];

/// A row of Table 4.12 or 4.13 in percent: thesis, and an independent implementation.
#[derive(Clone, Copy, Debug)]
pub struct Constrained {
    /// Table.
    pub limits: Limits,
    /// Identification signals.
    pub kind: Kind,
    /// Thesis, one number per kind of validation signal.
    pub thesis: &'static [f64],
    /// Independent implementation; empty where there is none.
    pub reference: &'static [f64],
    /// Share of the box that it found, and its J_AI.
    pub share_criterion: (Option<f64>, Option<f64>),
}

/// Tables 4.12 and 4.13.
pub const CONSTRAINED: &[Constrained] = &[
    Constrained {
        limits: Limits::Output,
        kind: Kind::Shrunk(Source::Prbs),
        thesis: &[-5.66, -500.05, -472.40, -698.08],
        reference: &[],
        share_criterion: (Some(0.43), None),
    },
    Constrained {
        limits: Limits::Output,
        kind: Kind::Shrunk(Source::Aprbs),
        thesis: &[40.61, 49.61, 45.63, 54.67],
        reference: &[34.4, 29.3, 29.6, -7.7],
        share_criterion: (Some(0.58), Some(2.5e6)),
    },
    Constrained {
        limits: Limits::Output,
        kind: Kind::Shrunk(Source::Udrn),
        thesis: &[29.69, 42.85, 42.83, 38.00],
        reference: &[33.2, 28.9, 29.0, -11.8],
        share_criterion: (Some(0.70), Some(3.2e6)),
    },
    Constrained {
        limits: Limits::Output,
        kind: Kind::Ai,
        thesis: &[48.15, 54.47, 49.54, 72.41],
        reference: &[53.3, 44.9, 44.6, 77.1],
        share_criterion: (None, Some(9.98e4)),
    },
    Constrained {
        limits: Limits::Rate { levels: 9 },
        kind: Kind::Walk,
        thesis: &[-47.68, -32.53],
        reference: &[-17.9, -22.8],
        share_criterion: (None, Some(7.1e6)),
    },
    Constrained {
        limits: Limits::Rate { levels: 9 },
        kind: Kind::Ai,
        thesis: &[19.18, -11.49],
        reference: &[31.1, 51.6],
        share_criterion: (None, Some(8.93e5)),
    },
    Constrained {
        limits: Limits::Rate { levels: 5 },
        kind: Kind::Walk,
        thesis: &[9.23, 5.05],
        reference: &[41.4, 55.2],
        share_criterion: (None, None),
    },
    Constrained {
        limits: Limits::Rate { levels: 5 },
        kind: Kind::Ai,
        thesis: &[32.01, 31.18],
        reference: &[49.8, 66.6],
        share_criterion: (None, None),
    },
];

/// Table 4.16: weights of torque and lambda, D and AI.
pub const TABLE_4_16: [[f64; 2]; 2] = [[477.91, 802.84], [3945.2, 3621.8]];
