//! The engine in a car: road load, gears, launch, driver, drive cycles (thesis section 3.7).
//!
//! ```text
//! F_r = A + B v + C v^2                        (3.2)
//! T_w = T_e G_b G,  w_w = w_e / (G_b G)        (3.3), (3.4)
//! J dw_w/dt = T_w - T_brake - F_r R            (3.5)
//! ```
//!
//! Eq. (3.5) is printed with `C w^3 R^2`; (3.2) and the dimensions ask for `C w^2 R^3`, which is what is used.

mod car;
mod cycle;
mod drive;
mod driver;
mod follow;

pub use car::{Car, CarState, LoadUnits, RoadLoad};
pub use cycle::{CycleError, DriveCycle};
pub use drive::{DriveLog, DriveOptions, Power, PowerSource, Tolerance, drive};
pub use driver::{Command, Driver};
pub use follow::{EngineInCar, GridController, IdealTorque, MapController, SteadyGrid};
