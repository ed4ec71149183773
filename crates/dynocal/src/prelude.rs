//! The names that most programs need: `use dynocal::prelude::*`.

pub use dynocal_design::problem::DesignProblem;
pub use dynocal_design::search::{DesignOptions, design};
pub use dynocal_files::dataset::read_table;
pub use dynocal_files::run_folder::RunFolder;
pub use dynocal_ident::data::{Channel, Dataset, Role};
pub use dynocal_ident::estimate::{Estimator, estimator};
pub use dynocal_ident::experiment::{Experiment, experiments};
pub use dynocal_ident::model::poly::PolyNarx;
pub use dynocal_ident::model::{Model, Run};
pub use dynocal_ident::plant::Plant;
pub use dynocal_ident::signal::{Signal, signal};
pub use dynocal_jobs::place::Overrides;
pub use dynocal_numerics::rng::Rng64;
pub use dynocal_numerics::status::Status;
pub use dynocal_numerics::watch::Watch;
pub use dynocal_plant::plants::PlantSpec;
pub use dynocal_report::{Report, Section, render};
