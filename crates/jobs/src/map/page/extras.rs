//! Sections of the page beside the maps: loops of the inputs, edits, inverse maps.

use dynocal_report::{
    Axis, Block, Cell as TableCell, Column, HeatMap, Section, Table, XyPlot, XySeries, capital, significant,
};

use crate::map::cells::objective_unit;
use crate::map::inverse::Inverse;
use crate::map::loops::InputLoop;
use crate::map::result::Mapped;

/// Those that there is something to say in.
pub(super) fn sections(found: &Mapped) -> Vec<Section> {
    [input_loops(found), edits(found), inverses(found)].into_iter().flatten().collect()
}

/// What is minimised over each free input: the spark sweep of a bed, on the models.
fn input_loops(found: &Mapped) -> Option<Section> {
    let mut names: Vec<(&str, &str)> =
        found.loops.iter().map(|l| (l.input.as_str(), l.unit.as_str())).collect();
    names.dedup();
    if names.is_empty() {
        return None;
    }
    let blocks: Vec<Block> = names.iter().map(|(name, unit)| input_loop(found, name, unit).into()).collect();
    let section = Section::new("Loops of the inputs").text(
        "What is minimised over one input, everything else as it stands in the map, at cells that are spread over the maps: as the models expect it, as lines where all limits are kept with the asked probability, as grey dots where one is broken.",
    );
    Some(blocks.chunks(2).fold(section, |s, pair| s.columns(pair.to_vec())))
}

fn input_loop(found: &Mapped, name: &str, unit: &str) -> XyPlot {
    let title = format!("Change of what is minimised over {name}");
    let mut plot = XyPlot::new(title, Axis::new(capital(name), unit), Axis::new("change", "%"));
    let all: Vec<&InputLoop> = found.loops.iter().filter(|l| l.input == name).collect();
    let (mut broken, mut set) = ((Vec::new(), Vec::new()), (Vec::new(), Vec::new()));
    for l in all {
        let at: Vec<String> =
            found.axes.iter().zip(&l.at).map(|(a, v)| format!("{} {}", significant(*v, 4), a.unit)).collect();
        let kept = |k: &usize| l.kept[*k];
        let (x, y): (Vec<f64>, Vec<f64>) =
            (0..l.x.len()).filter(kept).map(|k| (l.x[k], 100.0 * l.change[k])).unzip();
        plot = plot.line(at.join(", "), x, y);
        for k in (0..l.x.len()).filter(|k| !l.kept[*k]) {
            broken.0.push(l.x[k]);
            broken.1.push(100.0 * l.change[k]);
        }
        set.0.push(l.set);
        set.1.push(0.0);
    }
    plot = plot.points("the maps", set.0, set.1);
    if broken.0.is_empty() {
        return plot;
    }
    plot.series(XySeries { points: true, ..XySeries::new("a limit is broken", broken.0, broken.1) })
}

/// Cells that are held as edited.
fn edits(found: &Mapped) -> Option<Section> {
    if found.edits.is_empty() {
        return None;
    }
    let mut head: Vec<Column> =
        found.axes.iter().map(|a| Column::number(capital(&a.name), a.unit.as_str()).digits(4)).collect();
    head.push(Column::text("Edit"));
    head.push(Column::number("Costs", objective_unit(found)).digits(2));
    head.push(Column::text("Limits that it breaks"));
    let table = found.edits.iter().fold(Table::new(head), |table, e| {
        let mut row: Vec<TableCell> = e.at.iter().map(|v| (*v).into()).collect();
        row.extend([e.words().into(), e.costs.into(), e.broken().into()]);
        if e.passed.is_empty() { table.row(row) } else { table.stressed_row(row) }
    });
    Some(Section::new("Edits").text("Cells that stand in the maps as a user has edited them. What they cost and break is what the models expect, limits with the uncertainty counted in.").block(table))
}

/// Inverse maps of the inputs that loops drive.
fn inverses(found: &Mapped) -> Option<Section> {
    let mut section = Section::new("Inverse maps");
    let mut any = false;
    for i in &found.inverses {
        any = true;
        let several: Vec<String> = i.several.iter().map(|v| significant(*v, 4)).collect();
        let more = match several.is_empty() {
            true => String::new(),
            false => format!(
                " At {} {} {} the map does not go one way, and the lower {} is given.",
                i.given,
                several.join(", "),
                i.given_unit,
                i.output
            ),
        };
        section = section.text(format!(
            "{} from {}: where the map goes one way it gives back the {} to within {} {}.{more}",
            capital(&i.output),
            i.input,
            i.output,
            significant(i.error, 2),
            i.output_unit
        ));
        section = section.block(inverse(i));
    }
    any.then_some(section)
}

fn inverse(i: &Inverse) -> Block {
    let axis = |name: &str, unit: &str| Axis::new(capital(name), unit);
    let title = format!("{} from {}", capital(&i.output), i.input);
    let z = (Axis::new(i.output.as_str(), i.output_unit.as_str()), i.values.clone());
    if i.givens.len() < 2 {
        return XyPlot::new(title, axis(&i.input, &i.input_unit), z.0)
            .line(i.output.as_str(), i.inputs.clone(), z.1)
            .into();
    }
    let (x, y) = (axis(&i.given, &i.given_unit), axis(&i.input, &i.input_unit));
    HeatMap::new(title, (x, i.givens.clone()), (y, i.inputs.clone()), z).contours().into()
}
