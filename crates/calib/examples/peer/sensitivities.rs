//! Free run and output sensitivities of eq. (4.17).

use crate::{measure, numbers};
use dynocal_ident::model::{Model, Run, literature};
use serde_json::{Value, json};
use std::error::Error;
use std::hint::black_box;

/// Input: `u` (N x 3, row by row). Output: `y` (N), `s` (N x 23), CPU time.
pub(crate) fn run(input: &Value) -> Result<Value, Box<dyn Error>> {
    let u = numbers(input, "u")?;
    let lit = literature::torque_4_17();
    let (n, p) = (u.len() / 3, lit.theta.len());
    let zeros = vec![0.0; n];
    let (mut y, mut s) = (vec![0.0; n], vec![0.0; n * p]);
    let run = Run { u: &u, y: &zeros, start: 10 };
    let time = measure(|| {
        lit.model.sensitivities(black_box(&lit.theta), black_box(&run), &mut y, &mut s);
    })?;
    Ok(json!({"time": time, "y": y, "s": s}))
}
