//! MATLAB `.mat` (version 5): a struct for each characteristic, as Simulink's look-up blocks want it.
//!
//! `bp_x`, `bp_y`, `table` (bp_x along the rows, which is column-major the order x fastest), `unit`.

use dynocal_files::measurement::mat::MatValue;
use dynocal_files::measurement::mat5;
use dynocal_numerics::registry::MemberDoc;

use crate::characteristic::{Characteristic, identifier};
use crate::format::{Export, Holds, OutFile};
use crate::package::Package;

/// Row of the table of exports.
pub const EXPORT: Export = Export {
    doc: MemberDoc { name: "mat", what: "MATLAB .mat version 5, one struct a characteristic", params: &[] },
    holds: &[Holds::Characteristics],
    ecu_names: false,
    write: |package, _| {
        Ok(vec![OutFile {
            name: format!("{}.mat", identifier(&package.name)),
            bytes: mat5::encode(&variables(package)),
        }])
    },
    read: None,
};

fn variables(package: &Package) -> Vec<(String, MatValue)> {
    let mut out: Vec<(String, MatValue)> = package
        .characteristics
        .iter()
        .map(|c| (dynocal_files::measurement::mat::identifier(&c.name), structure(c)))
        .collect();
    out.push(("provenance".into(), MatValue::Text(package.provenance.lines().join("; "))));
    out
}

fn structure(c: &Characteristic) -> MatValue {
    let mut fields = Vec::new();
    for (axis, letter) in c.axes.iter().zip(["x", "y"]) {
        fields.push((format!("bp_{letter}"), MatValue::vector(&axis.points)));
        fields.push((format!("bp_{letter}_unit"), MatValue::Text(axis.unit.clone())));
        fields.push((format!("bp_{letter}_input"), MatValue::Text(axis.input.clone())));
    }
    let mut dims: Vec<usize> = c.axes.iter().map(|a| a.points.len()).collect();
    if dims.is_empty() {
        dims.push(c.values.len());
    }
    dims.resize(dims.len().max(2), 1);
    fields.push(("table".into(), MatValue::Numbers { dims, values: c.values.clone() }));
    fields.push(("unit".into(), MatValue::Text(c.unit.clone())));
    fields.push(("description".into(), MatValue::Text(c.description.clone())));
    MatValue::Struct(fields)
}
