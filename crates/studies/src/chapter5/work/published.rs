//! Numbers of thesis chapter 5 and section 7.4, and of an independent implementation of the same readings.

use super::searches::Method;

/// A row of Table 5.1 (with least squares, simulated, from the text) beside an independent implementation.
#[derive(Clone, Copy, Debug)]
pub struct Search {
    /// Method.
    pub method: Method,
    /// Mean squared simulation error, thesis.
    pub thesis_mse: Option<f64>,
    /// Its time in s.
    pub thesis_time_s: Option<f64>,
    /// Reference: mean squared simulation error on the stored record.
    pub reference_mse: f64,
    /// Reference: evaluations it took.
    pub reference_evaluations: usize,
    /// Evaluations that ours may take: those of the reference where a method does not end by itself.
    pub budget: usize,
    /// What ours must reach: the reference where that is exact (least squares, the unique optimum), else its rounded
    /// result, of the pattern search the worse of two.
    pub asked: f64,
}

/// Table 5.1.
pub const SEARCHES: [Search; 5] = [
    Search {
        method: Method::LeastSquares,
        thesis_mse: Some(0.97),
        thesis_time_s: None,
        reference_mse: 0.5561114021022748,
        reference_evaluations: 1,
        budget: 1,
        asked: 0.5561114021022748,
    },
    Search {
        method: Method::PatternSearch,
        thesis_mse: Some(0.76),
        thesis_time_s: Some(46.0),
        reference_mse: 0.5268056528030198,
        reference_evaluations: 24_010,
        budget: 24_000,
        asked: 0.5345988982852033,
    },
    Search {
        method: Method::LineSearch,
        thesis_mse: Some(0.93),
        thesis_time_s: Some(2.0),
        reference_mse: 0.5012109809187021,
        reference_evaluations: 5_223,
        budget: 6_000,
        asked: 0.50122,
    },
    Search {
        method: Method::NelderMead,
        thesis_mse: Some(0.51),
        thesis_time_s: Some(21.0),
        reference_mse: 0.503366886320861,
        reference_evaluations: 2_400,
        budget: 2_400,
        asked: 0.5034,
    },
    Search {
        method: Method::LevenbergMarquardt,
        thesis_mse: None,
        thesis_time_s: None,
        reference_mse: 0.501210980607983,
        reference_evaluations: 9,
        budget: 200,
        asked: 0.501210980607983,
    },
];

/// MSE and R2 in percent of a table beside an independent implementation.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Thesis.
    pub thesis: Option<(f64, f64)>,
    /// Reference.
    pub reference: Option<(f64, f64)>,
}

/// Table 5.2, least squares.
pub const TABLE_5_2_PEM: Row =
    Row { thesis: Some((1.14, 90.83)), reference: Some((0.5800107225030803, 93.91770986297807)) };
/// Table 5.2, simulation error.
pub const TABLE_5_2_SEM: Row =
    Row { thesis: Some((0.53, 95.67)), reference: Some((0.497792541408933, 94.73252973177514)) };
/// The true parameters on unseen records.
pub const TABLE_5_2_TRUE: Row =
    Row { thesis: None, reference: Some((0.4923647586733706, 94.793_740_162_428_5)) };
/// One-step prediction on the identification record (section 5.3).
pub const ONE_STEP: Row =
    Row { thesis: Some((0.62, 92.62)), reference: Some((0.5837968957849703, 90.43247306144633)) };

/// Parameters of (5.3) by prediction error, eq. (5.6).
pub const THETA_5_6: [f64; 12] =
    [-1.65, 15.8, -53.77, 34.14, 0.021, -0.0041, 0.017, -0.011, 0.24, 0.24, 0.17, 0.21];
/// Parameters of (5.3) by simulation error, eq. (5.11).
pub const THETA_5_11: [f64; 12] =
    [-5.16, 21.04, -54.10, 32.06, 0.031, -0.0044, 0.019, -0.011, -0.13, 0.28, 0.29, 0.36];

/// Parameters and fit of one engine model, both estimators.
#[derive(Clone, Copy, Debug)]
pub struct EngineModel {
    /// Table of the parameters, and of the fit on the identification record.
    pub tables: (&'static str, &'static str),
    /// Parameters by prediction error, order of the regressors.
    pub theta_pem: &'static [f64],
    /// Parameters by simulation error.
    pub theta_sem: &'static [f64],
    /// MSE and R2 in percent on the identification record, free run: prediction error, simulation error.
    pub identification: [(f64, f64); 2],
    /// Mean MSE and R2 in percent over ten unseen records.
    pub unseen: [Option<(f64, f64)>; 2],
}

/// Torque model (5.13).
pub const TORQUE_5_13: EngineModel = EngineModel {
    tables: ("Table 5.3", "Table 5.4"),
    theta_pem: &[-4.5, 4.56, -5.19, 0.94, 0.067, 1.14, -0.73, 0.87],
    theta_sem: &[-2.57, -6.46, 14.76, -8.2, 0.046, -0.043, 0.36, 0.92],
    identification: [(113.97, 77.78), (76.08, 83.72)],
    unseen: [Some((154.97, 73.68)), Some((115.90, 79.62))],
};

/// Lambda model (5.14).
pub const LAMBDA_5_14: EngineModel = EngineModel {
    tables: ("Table 5.5", "Table 5.6"),
    theta_pem: &[0.41, 0.6, -0.6, 0.0017, 0.0046, 0.58, -0.0001, -7.29e-5],
    theta_sem: &[0.49, 0.77, -0.77, 0.000_88, 0.0058, 0.46, -0.000_56, -0.0002],
    identification: [(0.0174, 97.68), (0.0144, 97.7)],
    unseen: [Some((0.0155, 97.15)), Some((0.0131, 97.39))],
};

/// Torque model of (7.8) with (7.9) and (7.10).
pub const TORQUE_7_8: EngineModel = EngineModel {
    tables: ("Eqs. (7.9), (7.10)", "Tables 7.3, 7.4"),
    theta_pem: &[
        -8.91, 1.86, 0.58, -1.34, 1.06, 0.18, 0.61, 0.88, -0.0087, 0.72, -0.02, 2.96e-4, -0.0244, -0.0068,
        -0.0177, -1.69e-4,
    ],
    theta_sem: &[
        -21.33, 1.43, 0.60, -1.09, 1.38, -0.37, 0.62, 0.88, -0.0016, 0.77, -0.02, 3.96e-4, -0.0202, -0.0092,
        -0.0132, -2.36e-5,
    ],
    identification: [(157.42, 84.56), (125.68, 87.99)],
    unseen: [None, Some((150.95, 85.26))],
};

/// Lambda model of (7.8); its numbers are printed with the output before the speed and are put right here.
pub const LAMBDA_7_8: EngineModel = EngineModel {
    tables: ("Eqs. (7.9), (7.10)", "Tables 7.3, 7.4"),
    theta_pem: &[0.61, 0.091, -0.10, -1.07e-4, 0.0083, -1.87e-4, 0.82],
    theta_sem: &[0.51, 0.15, -0.16, -3.18e-4, 0.012, -6.96e-5, 0.64],
    identification: [(0.0431, 82.02), (0.0247, 89.70)],
    unseen: [None, Some((0.0277, 86.65))],
};

/// The same structures on the stored engine records of the reference data: free-run MSE on the identification record
/// by prediction and by simulation error.
pub const REFERENCE_7_8: [(f64, f64); 2] = [
    (31.268_972_433_088_14, 13.781_077_218_798_88),
    (0.004_232_792_724_751_107, 0.003_210_359_251_488_556_4),
];

/// A row of Table 7.1.
#[derive(Clone, Copy, Debug)]
pub struct LayerSize {
    /// Neurons of the hidden layer.
    pub hidden: usize,
    /// MSE of torque: training, validation, test (in this order as read; the columns carry no names in the text).
    pub mse: [f64; 3],
}

/// Table 7.1.
pub const TABLE_7_1: [LayerSize; 4] = [
    LayerSize { hidden: 5, mse: [25.58, 51.70, 31.15] },
    LayerSize { hidden: 10, mse: [20.45, 39.01, 27.76] },
    LayerSize { hidden: 20, mse: [20.32, 41.97, 27.10] },
    LayerSize { hidden: 30, mse: [19.31, 35.84, 28.75] },
];

/// Fit of a network, with that of the polynomial beside it.
#[derive(Clone, Copy, Debug)]
pub struct NetworkRow {
    /// MSE.
    pub mse: f64,
    /// R2 in percent.
    pub r2: f64,
    /// MSE of the polynomial by simulation error.
    pub polynomial_mse: f64,
}

/// Table 7.2 (polynomials: Table 7.4) on the identification record: torque, lambda.
pub const TABLE_7_2: [NetworkRow; 2] = [
    NetworkRow { mse: 92.86, r2: 91.13, polynomial_mse: 125.68 },
    NetworkRow { mse: 0.0251, r2: 89.52, polynomial_mse: 0.0247 },
];

/// Table 7.5, means over ten unseen records: torque, lambda.
pub const TABLE_7_5: [NetworkRow; 2] = [
    NetworkRow { mse: 47.11, r2: 95.41, polynomial_mse: 150.95 },
    NetworkRow { mse: 0.0254, r2: 88.27, polynomial_mse: 0.0277 },
];
