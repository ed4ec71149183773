//! What came out of a fit, in words.

use dynocal_label::graph::{FittedAxis, Graph};
use dynocal_label::linear::{Fit, Verdict};
use dynocal_label::ve::judge::{Decision, NEEDED};

use super::judge::{Judged, LEAST};

/// What there is to say something of.
pub(super) struct Came<'a> {
    pub(super) converged: bool,
    pub(super) judged: &'a Judged,
    /// Labels that lie on a bound where they must not.
    pub(super) bounds: &'a [String],
    pub(super) rows: &'a [(String, String, f64, f64)],
    pub(super) unseen_rms: [f64; 2],
    pub(super) samples: [usize; 2],
    pub(super) full: Option<f64>,
    pub(super) fit: &'a Fit,
    /// Whether the loss is Huber's.
    pub(super) robust: bool,
}

/// The verdict, most important first.
pub(super) fn verdict(c: &Came) -> Vec<String> {
    let mut out = vec![decided(c), numbers(c), cells(c.fit)];
    if let Some(full) = c.full {
        out.push(format!(
            "Breakpoints were taken away and placed anew: with all of them the later samples are left by {full:.4}, with those that stay by {:.4}.",
            c.unseen_rms[1]
        ));
    }
    out
}

fn decided(c: &Came) -> String {
    let j = c.judged;
    let counts = format!("({:.1} standard errors, {:.1} would count)", j.improvement, j.needed);
    if !c.converged {
        return "The search has not converged: the labels must not be used. No file is written.".into();
    }
    if !c.bounds.is_empty() {
        return format!(
            "The labels must not be used: the fit ends with {}. What is found there is the bound and not the system. No file is written.",
            c.bounds.join(", ")
        );
    }
    match j.decision {
        Decision::Change => format!(
            "The labels may be used: they explain the samples that they were not fitted to better than the base (the gain is {:.1} times its standard error).",
            j.improvement
        ),
        Decision::Refuse => format!(
            "The labels are refused: they explain the samples that they were not fitted to worse than the base {counts}. No file is written."
        ),
        Decision::Keep if j.facts < LEAST => format!(
            "Leave the labels as they are: the samples that judge are worth {:.1} independent measurements, {LEAST:.0} are needed at least. No file is written.",
            j.facts
        ),
        Decision::Keep if j.noise => {
            "Leave the labels as they are: the samples that were fitted do not show that the base is wrong (a true one would be improved as much by fitting its noise). No file is written.".into()
        }
        Decision::Keep => format!(
            "Leave the labels as they are: on samples that they were not fitted to no difference between them and the base can be shown {counts}. No file is written."
        ),
    }
}

fn numbers(c: &Came) -> String {
    // One row is told in the unit of its channel, without its weight.
    let (what, before, after) = match c.rows {
        [(_, channel, before, after)] => (format!("`{channel}` is"), *before, *after),
        _ => ("the weighted sum of all rows is".into(), c.unseen_rms[0], c.unseen_rms[1]),
    };
    let mean = if c.robust {
        "root of the mean of Huber's loss, in which outliers count less"
    } else {
        "root mean square"
    };
    let few = if c.judged.facts < NEEDED { ", which is few" } else { "" };
    format!(
        "On {} later samples (worth {:.1} independent measurements{few}) {what} left by {before:.4} ({mean}) with the base and by {after:.4} with the fitted labels; {} samples were fitted.",
        c.samples[1], c.judged.facts, c.samples[0]
    )
}

/// How many cells have which verdict.
fn cells(fit: &Fit) -> String {
    let count = |v: Verdict| fit.verdicts.iter().filter(|x| **x == v).count();
    let mut out = format!(
        "Of {} cells, {} are determined by the data, {} are pulled by their neighbours, {} are untouched (no sample depends on them)",
        fit.verdicts.len(),
        count(Verdict::Determined),
        count(Verdict::Pulled),
        count(Verdict::Untouched)
    );
    for (verdict, word) in [(Verdict::Locked, "locked"), (Verdict::Open, "open (only together with others)")]
    {
        if count(verdict) > 0 {
            out.push_str(&format!(", {} are {word}", count(verdict)));
        }
    }
    out.push('.');
    out
}

/// Warnings: what was left out, what is open, what a limit holds.
pub(super) fn warnings(
    graph: &Graph,
    axes: &[FittedAxis],
    fit: &Fit,
    extrapolates: bool,
    notes: Vec<String>,
) -> Vec<String> {
    let mut out = Vec::new();
    let label_of = |cell: usize| {
        let mut from = 0;
        graph.labels.iter().find_map(|l| {
            let own = (from..from + l.len()).contains(&cell).then(|| (l.name.as_str(), cell - from));
            from += l.len();
            own
        })
    };
    for k in 0..fit.open.len() {
        let mut names: Vec<&str> = Vec::new();
        let mut first = 0;
        for (name, cell) in fit.open.cells(k).into_iter().filter_map(label_of) {
            if !names.contains(&name) {
                if names.is_empty() {
                    first = cell;
                }
                names.push(name);
            }
        }
        let Some(name) = names.first() else { continue };
        out.push(format!(
            "{} {} open: a change of cells together changes nothing that was measured (as a constant that one summand has and another not, or a factor); lock a cell (`locked = [{first}]` of `{name}`) or give it a `base_weight`; what they compute together is known",
            names.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", "),
            if names.len() == 1 { "is" } else { "are" }
        ));
    }
    let crossing = |h: &String| {
        let name = &axes
            .iter()
            .map(|a| &graph.labels[a.label])
            .find(|l| h.starts_with(&format!("`{}`:", l.name)))?
            .name;
        let rest = h.rsplit("gradient").next().unwrap_or("");
        Some(format!(
            "two of the {name} stand at the least distance that they may have:{}",
            rest.replace("along", "of")
        ))
    };
    let word = |h: &String| crossing(h).unwrap_or_else(|| format!("the fit is held by a limit: {h}"));
    let mut held: Vec<String> = fit.held.iter().map(word).collect();
    held.sort();
    held.dedup();
    out.extend(held);
    out.extend(fit.broken.iter().map(|what| format!("a limit is broken by values that stay (locked cells, or cells without data at their base): {what}")));
    if !extrapolates {
        out.extend(gone(graph, fit));
    }
    out.extend(notes);
    out
}

/// Labels that the search has led to where no sample depends on them: what is known is that they are no further back.
fn gone(graph: &Graph, fit: &Fit) -> Vec<String> {
    let (mut out, mut from) = (Vec::new(), 0);
    for l in &graph.labels {
        let own = (0..l.len())
            .filter(|k| fit.verdicts[from + k] == Verdict::Untouched && fit.exact[from + k] != l.base[*k]);
        let cells: Vec<usize> = own.collect();
        // Where gradients or curvature are limited, cells without data follow the others.
        if let (Some(k), false) = (cells.first(), l.is_shaped()) {
            let unit = if l.unit == "-" { String::new() } else { format!(" {}", l.unit) };
            let which = match cells.len() {
                1 if l.len() == 1 => {
                    format!("`{}` went from {} to {:.6}{unit}", l.name, l.base[*k], fit.exact[from + k])
                }
                1 => format!(
                    "a cell of `{}` went from {} to {:.6}{unit}",
                    l.name,
                    l.base[*k],
                    fit.exact[from + k]
                ),
                n => format!("{n} cells of `{}` went to values", l.name),
            };
            out.push(format!(
                "{which}, where no sample depends on what it is any more (a lag or delay of none, a bound that nothing reaches): the base explains the samples worse, but how far to go beyond they do not say"
            ));
        }
        from += l.len();
    }
    out
}
