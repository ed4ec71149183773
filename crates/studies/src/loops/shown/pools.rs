//! What a design for one structure loses where another one is right, and a design for all of them.

use dynocal_design::criterion::criterion;
use dynocal_design::search::DesignOptions;
use dynocal_ident::model::Model;
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::engine::{Engine, OUTPUT};
use super::signals::Kind;
use dynocal_calib::loops::LoopError;
use dynocal_calib::loops::plan::{Aim, Structure, know, problem, terms};
use dynocal_calib::loops::pool::Pool;

/// Efficiencies over seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Efficiencies {
    /// Criterion.
    pub criterion: String,
    /// Names of the structures.
    pub structures: Vec<String>,
    /// Per seed, per record (one design for each structure, then the one for the pool), per structure.
    pub seeds: Vec<Vec<Vec<f64>>>,
}

impl Efficiencies {
    /// Least efficiency over the structures of record `i`, per seed.
    pub fn worst(&self, i: usize) -> Vec<f64> {
        self.seeds.iter().map(|s| s[i].iter().copied().fold(f64::INFINITY, f64::min)).collect()
    }

    /// Mean over seeds of the efficiency of record `i` for structure `j`.
    pub fn mean(&self, i: usize, j: usize) -> f64 {
        self.seeds.iter().map(|s| s[i][j]).sum::<f64>() / self.seeds.len() as f64
    }
}

/// Identifies the structures from a short random record of every seed and designs for each and for all.
///
/// # Errors
/// [`LoopError`].
pub fn efficiencies(
    engine: &Engine,
    models: &[(&str, &dyn Model)],
    criterion_name: &str,
    first_seed: u64,
    seeds: u64,
    evaluations: usize,
) -> Result<Efficiencies, LoopError> {
    let objective = Kind::Udrn.record(&engine.bed, 200, &mut Rng64::stream(first_seed, 6 << 40))?;
    let structures: Vec<Structure> = models.iter().map(|(_, model)| Structure::new(OUTPUT, *model)).collect();
    let one = |k: u64| -> Result<Vec<Vec<f64>>, LoopError> {
        let seed = first_seed + k;
        let u = Kind::Udrn.record(&engine.bed, 100, &mut Rng64::stream(seed, (6 << 40) + 1))?;
        let records = [engine.measure(true, (6 << 40) + seed, "initial", &u)?];
        let known = know(&engine.bed, &structures, &records)?;
        let search = DesignOptions { seed, evaluations, ..DesignOptions::default() };
        let aim = Aim {
            criterion: criterion_name.into(),
            keys: toml::Table::new(),
            objective: objective.clone(),
            adds: false,
            search,
            robust: None,
        };
        let c = criterion(&aim.criterion, &aim.keys)?;
        let posed = problem(&engine.bed, 100, terms(&structures, &known, &aim, c.as_ref(), &[]));
        let pool = Pool::new(&posed, &aim.search, &|| false)?;
        let together = pool.design(&posed, &aim.search, &|| false)?.u;
        pool.alone.iter().chain([&together]).map(|u| pool.efficiencies(&posed, u)).collect()
    };
    let all: Result<Vec<_>, LoopError> = (0..seeds).into_par_iter().map(one).collect();
    Ok(Efficiencies {
        criterion: criterion_name.into(),
        structures: models.iter().map(|m| m.0.to_string()).collect(),
        seeds: all?,
    })
}
