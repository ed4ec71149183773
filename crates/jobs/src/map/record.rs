//! Values of a record of a bed that nothing there can have.

use dynocal_calib::steady::layout::Layout;
use dynocal_files::table::Table;
use dynocal_ident::data::Dataset;

use super::error::MapError;

/// Values beyond this size are faults of a record: no channel of a bed has them in any unit.
const LARGEST: f64 = 1e12;

/// Refuses values that no channel of a bed has.
fn in_size(table: &Table, all: &Dataset) -> Result<(), MapError> {
    for c in &all.channels {
        if let Some(row) = c.values.iter().position(|v| v.abs() > LARGEST) {
            return Err(MapError::Record(format!(
                "{}, {}, column `{}`: found {:e}, expected a number below {LARGEST:e} in size",
                table.file,
                table.place(row),
                c.name,
                c.values[row]
            )));
        }
    }
    Ok(())
}

/// How far beyond its range, as a share of it, an input that a loop drives may stand in a record: the loop of a bed that has it keeps it within.
const BEYOND: f64 = 0.1;
/// The same of a demanded output: what a bed measured where it could not hold a demand is learnt from, and no demand is missed by more than all of them.
const MISSED: f64 = 1.0;

/// Refuses values that no channel of a bed has, of driven inputs that no loop of the spec sets, and of demanded outputs far off all demands: one broken number would be
/// taken for what the engine does.
///
/// # Errors
/// [`MapError::Record`] with file, line and column.
pub(super) fn believable(table: &Table, all: &Dataset, layout: &Layout) -> Result<(), MapError> {
    in_size(table, all)?;
    let p = &layout.problem;
    let driven = layout.driven().into_iter().map(|k| &p.inputs[k]);
    let driven = driven.map(|i| (&i.name, &i.unit, [i.lower, i.upper], BEYOND));
    let demands = p.demands.iter().map(|d| (&d.output, &d.unit, [d.lower, d.upper], MISSED));
    for (name, unit, [lower, upper], share) in driven.chain(demands) {
        let Some(c) = all.channels.iter().find(|c| c.name == *name) else { continue };
        let room = share * (upper - lower);
        if let Some(row) = c.values.iter().position(|v| *v < lower - room || *v > upper + room) {
            return Err(MapError::Record(format!(
                "{}, {}, column `{name}`: found {}, expected {lower} to {upper} {unit} as the spec has it",
                table.file,
                table.place(row),
                c.values[row]
            )));
        }
    }
    Ok(())
}
