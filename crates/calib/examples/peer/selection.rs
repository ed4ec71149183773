//! Forward regression over all products of lagged input and output up to a degree.

use crate::{measure, numbers};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::select::frols::{Stop, frols};
use dynocal_ident::select::pool::{PerInput, PoolKeys};
use serde_json::{Value, json};
use std::error::Error;

/// Input: `u`, `y` (N), `lags` of each, `degree`, `terms`. Output: regressors and error reduction ratios in the order of
/// taking, number of candidates, CPU time with the making of the pool.
pub(crate) fn run(input: &Value) -> Result<Value, Box<dyn Error>> {
    let (u, y) = (numbers(input, "u")?, numbers(input, "y")?);
    let number = |key: &str| input[key].as_u64().ok_or(format!("no number `{key}`"));
    let (lags, terms) = (number("lags")? as usize, number("terms")? as usize);
    let keys = PoolKeys {
        ny: lags,
        nu: PerInput::All(lags),
        degree: number("degree")? as u32,
        ..PoolKeys::default()
    };
    let data = [Experiment { name: "record".into(), u, y, init_samples: 0, weights: Vec::new() }];
    let inputs = ["u".to_string()];
    let mut last = None;
    let time = measure(|| {
        last = Some(keys.pool(&inputs, "y").and_then(|pool| frols(pool, &data, Stop::Terms(terms))));
    })?;
    let found = last.ok_or("not selected")??;
    let regressors: Vec<&str> = found.path.iter().map(|s| s.regressor.as_str()).collect();
    let err: Vec<f64> = found.path.iter().map(|s| s.err).collect();
    Ok(json!({"time": time, "regressors": regressors, "err": err, "candidates": found.pool}))
}
