//! Steady points: one, a sweep of one input, or without fuel.

mod page;
mod work;

use dynocal_plant::inputs::Inputs;
use dynocal_plant::trace::CylinderTrace;
use serde::Serialize;

pub use page::report;
pub use work::run;

use super::quantities::Point;

/// Which steady points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Spec {
    /// One.
    Point(At),
    /// One input in equal steps, the others held.
    Sweep {
        /// Input that moves.
        input: Input,
        /// First value, in the unit of the input.
        from: f64,
        /// Last value.
        to: f64,
        /// Number of values, 2 to [`MOST_POINTS`].
        points: usize,
        /// Point that the other inputs are of.
        at: At,
    },
    /// Without fuel.
    Motored {
        /// Speed in rpm.
        speed_rpm: f64,
        /// Throttle angle in deg.
        throttle_deg: f64,
    },
}

/// Most points of a sweep.
pub const MOST_POINTS: usize = 1000;

/// A point at given inputs, or settled to a torque.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct At {
    /// Speed in rpm.
    pub speed_rpm: f64,
    /// Brake torque in Nm to settle to; throttle and fuel follow.
    pub torque_nm: Option<f64>,
    /// Lambda to settle to.
    pub lambda: f64,
    /// Fuel in mg per cylinder and cycle, where no torque is asked.
    pub injection_mg: Option<f64>,
    /// Throttle angle in deg, where no torque is asked.
    pub throttle_deg: Option<f64>,
    /// Cams in deg (intake before, exhaust after gas-exchange dead centre), wastegate and recirculation valve in mm, where no torque is asked.
    pub intake_cam_deg: Option<f64>,
    /// See above.
    pub exhaust_cam_deg: Option<f64>,
    /// See above.
    pub wastegate_mm: Option<f64>,
    /// See above.
    pub egr_mm: Option<f64>,
    /// Spark advance in deg before firing dead centre; with a torque and without this, the spark of least fuel.
    pub spark_deg: Option<f64>,
}

/// An input that can be swept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Input {
    /// Speed in rpm.
    Speed,
    /// Throttle angle in deg.
    Throttle,
    /// Spark advance in deg.
    Spark,
    /// Fuel in mg per cylinder and cycle.
    Injection,
    /// Intake cam in deg.
    IntakeCam,
    /// Exhaust cam in deg.
    ExhaustCam,
    /// Wastegate in mm.
    Wastegate,
    /// Recirculation valve in mm.
    Egr,
    /// Shape of combustion.
    WiebeM,
}

impl Input {
    /// Its column in the table of points.
    pub fn name(self) -> &'static str {
        match self {
            Self::Speed => "speed",
            Self::Throttle => "throttle",
            Self::Spark => "spark",
            Self::Injection => "inj",
            Self::IntakeCam => "intake_cam",
            Self::ExhaustCam => "exhaust_cam",
            Self::Wastegate => "wastegate",
            Self::Egr => "egr",
            Self::WiebeM => "wiebe_m",
        }
    }

    fn set(self, u: &mut Inputs, value: f64) {
        *match self {
            Self::Speed => &mut u.speed_rpm,
            Self::Throttle => &mut u.throttle_deg,
            Self::Spark => &mut u.spark_deg,
            Self::Injection => &mut u.injection_mg,
            Self::IntakeCam => &mut u.intake_mop_deg_btdc,
            Self::ExhaustCam => &mut u.exhaust_mop_deg_atdc,
            Self::Wastegate => &mut u.wastegate_mm,
            Self::Egr => &mut u.egr_mm,
            Self::WiebeM => &mut u.wiebe_m,
        } = value;
    }
}

/// What steady points give.
#[derive(Clone, Debug, Serialize)]
pub struct Steady {
    /// The points, in the order of the sweep.
    pub points: Vec<Point>,
    /// Limits that a controller would keep and a point at a torque passes, and a best spark that is none.
    pub warnings: Vec<String>,
    /// First cylinder over one cycle at the last point.
    pub trace: CylinderTrace,
}
