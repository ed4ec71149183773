//! Limits under a wrong structure, pools of structures, robust design, one record for two outputs.

use crate::loops::shown::engine::Engine;
use crate::loops::shown::known::{Known, RobustSeed, RobustSize};
use crate::loops::shown::mimo::{self, Errors, For};
use crate::loops::shown::paired::Paired;
use crate::loops::shown::pools::{Efficiencies, efficiencies};
use crate::loops::shown::violations::{Observed, Setup, observe};
use dynocal_numerics::interval::Interval;
use dynocal_report::{Cell, Column, Report, Section, Table};
use serde_json::json;

use super::super::asked::Asked;
use super::{Check, Options, Task, TaskResult, built, check, mean, plant, result, seeds, task};

const LIMITS: &str = "limits";
const POOLS: &str = "pools";
const ROBUST: &str = "robust";
const OUTPUTS: &str = "two-outputs";
/// Noise of the known system.
pub(super) const KNOWN_NOISE: f64 = 0.3;
/// Criteria of the pools.
const CRITERIA: [&str; 2] = ["d", "i"];
/// What robust designs make small.
const RISKS: [&str; 3] = ["nominal", "mean", "worst share"];

fn setup(o: &Options) -> Setup {
    Setup {
        seed: o.seed,
        seeds: seeds(o, 20),
        samples: if o.reduced { 40 } else { 100 },
        rounds: if o.reduced { 1 } else { 3 },
        limits_nm: Interval::new(-23.0, 0.0),
        rate: 0.05,
        caution: 2.0,
        first_box: 0.6,
        evaluations: if o.reduced { 200 } else { 1500 },
    }
}

pub(super) fn tasks(o: &Options) -> Vec<Task> {
    let setup = setup(o);
    let (seed, count, evaluations) = (o.seed, seeds(o, 20), if o.reduced { 100 } else { 1000 });
    let robust = RobustSize {
        seed,
        seeds: count,
        initial: 60,
        samples: 60,
        draws: if o.reduced { 4 } else { 16 },
        fresh: if o.reduced { 4 } else { 30 },
        share: 0.2,
        evaluations: if o.reduced { 60 } else { 500 },
    };
    let outputs = mimo::Size {
        seed,
        seeds: count,
        initial: 60,
        samples: if o.reduced { 20 } else { 100 },
        unseen: if o.reduced { 1 } else { 4 },
        evaluations,
    };
    vec![
        task(LIMITS, json!({ "setup": setup, "noise": super::NOISE }), move |around| {
            let engine = Engine::new(&plant)?;
            let (affine, quadratic) = (built(engine.affine())?, built(engine.quadratic())?);
            Ok([
                observe(&engine, "affine (4.52)", &affine, setup, around.watch.interrupt)?,
                observe(&engine, "quadratic NARX", &quadratic, setup, around.watch.interrupt)?,
            ])
        }),
        task(
            POOLS,
            json!({ "seed": seed, "seeds": count, "evaluations": evaluations, "noise": super::NOISE }),
            move |_| {
                let engine = Engine::new(&plant)?;
                let models =
                    [built(engine.affine())?, built(engine.quadratic())?, built(engine.doubted_quadratic())?];
                let named: [(&str, &dyn dynocal_ident::model::Model); 3] =
                    [("affine", &models[0]), ("quadratic NARX", &models[1]), ("cubic NARX", &models[2])];
                CRITERIA
                    .into_iter()
                    .map(|c| efficiencies(&engine, &named, c, seed, count, evaluations))
                    .collect::<Result<Vec<_>, _>>()
            },
        ),
        task(ROBUST, json!({ "size": robust, "noise": KNOWN_NOISE }), move |_| {
            built(Known::new(KNOWN_NOISE))?.robust(robust)
        }),
        task(OUTPUTS, json!({ "size": outputs, "noise": super::NOISE }), move |around| {
            mimo::compare(&plant, outputs, around.watch.interrupt)
        }),
    ]
}

/// Share of `part` in `whole`; none of nothing.
fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

/// Least efficiency of the pool's design, and the best of that among designs for one structure, per seed.
fn worst(e: &Efficiencies) -> (Vec<f64>, Vec<f64>) {
    let n = e.structures.len();
    let alone: Vec<Vec<f64>> = (0..n).map(|i| e.worst(i)).collect();
    let best = (0..e.seeds.len()).map(|k| alone.iter().map(|a| a[k]).fold(0.0, f64::max)).collect();
    (e.worst(n), best)
}

fn of(all: &[Errors], what: For, output: usize) -> Option<&[f64]> {
    all.iter().find(|e| e.of == what).map(|e| e.mse[output].as_slice())
}

fn text(p: &Paired) -> String {
    format!("mean {:.4} [{:.4}, {:.4}], {} of {}", p.mean, p.low, p.high, p.greater, p.n)
}

pub(super) fn checks(results: &[TaskResult]) -> Vec<Check> {
    let mut checks = Vec::new();
    let limits: Option<[Observed; 2]> = result(results, LIMITS);
    for (i, id) in ["affine", "nonlinear"].into_iter().enumerate() {
        let found = limits.as_ref().map(|l| &l[i]);
        let last = found.and_then(|f| f.rounds.last());
        let rounds = found.map_or(String::new(), |f| {
            let each = f
                .rounds
                .iter()
                .map(|r| format!("{:.3}", share(r.at_limit_beyond, r.at_limit).unwrap_or(0.0)));
            format!("round by round: {}", each.collect::<Vec<_>>().join(", "))
        });
        checks.push(check(
            format!("limits-{id}"),
            "Share of samples beyond a limit, among those predicted to be at one, last round; stated 0.05",
            Asked::AtMost(0.05),
            last.and_then(|r| share(r.at_limit_beyond, r.at_limit)),
            "",
            rounds,
        ));
    }
    let pools: Option<Vec<Efficiencies>> = result(results, POOLS);
    for (i, c) in CRITERIA.into_iter().enumerate() {
        let pair = pools.as_ref().and_then(|p| p.get(i)).map(worst);
        let paired = pair.and_then(|(pool, one)| Paired::of(&pool, &one));
        checks.push(check(
            format!("pool-{c}"),
            format!(
                "{}: least efficiency over the structures, pool less best design for one, lower end of 95 %",
                c.to_uppercase()
            ),
            Asked::Above(0.0),
            paired.as_ref().map(|p| p.low),
            "",
            paired.as_ref().map(text).unwrap_or_default(),
        ));
    }
    let robust: Option<Vec<RobustSeed>> = result(results, ROBUST);
    for (i, id) in [(1, "mean"), (2, "worst-share")] {
        let column = |k: usize| robust.as_ref().map(|r| r.iter().map(|s| s.worst[k]).collect::<Vec<_>>());
        let paired = column(0).zip(column(i)).and_then(|(a, b)| Paired::of(&a, &b));
        checks.push(check(
            format!("robust-{id}"),
            format!("Worst loss over fresh draws, nominal less robust ({}), lower end of 95 %", RISKS[i]),
            Asked::Above(0.0),
            paired.as_ref().map(|p| p.low),
            "",
            paired.as_ref().map(text).unwrap_or_default(),
        ));
    }
    let outputs: Option<Vec<Errors>> = result(results, OUTPUTS);
    for (i, (id, other)) in [("torque", For::Lambda), ("lambda", For::Torque)].into_iter().enumerate() {
        let all = outputs.as_deref();
        let paired = all.and_then(|a| Paired::ratios(of(a, other, i)?, of(a, For::Both, i)?));
        // Lambda does not read the spark: a design for it alone leaves torque out, not the other way round.
        let (asked, end) = if i == 0 { (Asked::Above(0.0), "lower") } else { (Asked::AtLeast(0.0), "upper") };
        let measured = paired.as_ref().map(|p| if i == 0 { p.low } else { p.high });
        checks.push(check(
            format!("two-outputs-{id}"),
            format!("Error of {id}: ln of {} over composite, {end} end of 95 %", other.name()),
            asked,
            measured,
            "",
            paired.as_ref().map(text).unwrap_or_default(),
        ));
    }
    checks
}

pub(super) fn sections(report: Report, results: &[TaskResult]) -> Report {
    report
        .section(limits_section(result(results, LIMITS)))
        .section(pools_section(result(results, POOLS)))
        .section(robust_section(result(results, ROBUST)))
        .section(outputs_section(result(results, OUTPUTS)))
}

fn limits_section(found: Option<[Observed; 2]>) -> Section {
    let mut table = Table::new(vec![
        Column::text("Structure"),
        Column::number("Round", "").digits(2),
        Column::number("Margin", "Nm").digits(3),
        Column::number("Beyond, all samples", "%").digits(3),
        Column::number("At a limit", "samples").digits(5),
        Column::number("Beyond, of these", "%").digits(3),
        Column::number("Farthest", "Nm").digits(3),
        Column::number("Designs not within their limits", "").digits(2),
    ])
    .caption("Torque limits -23 to 0 Nm, stated rate 5 %; measured with sensor noise");
    for o in found.iter().flatten() {
        for (k, r) in o.rounds.iter().enumerate() {
            table = table.row(vec![
                o.structure.as_str().into(),
                (k as f64 + 1.0).into(),
                r.margin_nm.into(),
                share(r.beyond, r.samples).map(|s| 100.0 * s).into(),
                (r.at_limit as f64).into(),
                share(r.at_limit_beyond, r.at_limit).map(|s| 100.0 * s).into(),
                r.worst_nm.into(),
                Cell::from(r.infeasible as f64),
            ]);
        }
    }
    Section::new("Limits under a wrong structure").id("limits").text(
        "The first record keeps to the middle 60 % of the box; D-designs then go up to the limits. Margins are conformal quantiles of the errors on held-out blocks near each limit, doubled in the first round. Both structures are wrong for the engine. In the first rounds a design leaves the region that the margins were learned in, and the rate is not promised there.",
    ).block(table)
}

fn pools_section(found: Option<Vec<Efficiencies>>) -> Section {
    let mut section = Section::new("Pools of structures").id("pools").text(
        "Efficiency of a record of 100 samples for a structure, against the best record found for that structure alone; structures at estimates from a UDRN record of 100 samples each seed. 0: the record cannot tell the parameters.",
    );
    for e in found.iter().flatten() {
        let mut columns = vec![Column::text("Record")];
        columns.extend(e.structures.iter().map(|s| Column::number(format!("Efficiency: {s}"), "").digits(3)));
        columns.push(Column::number("Least, mean over seeds", "").digits(3));
        let mut table = Table::new(columns).caption(format!("Criterion {}", e.criterion.to_uppercase()));
        let n = e.structures.len();
        for i in 0..=n {
            let name = e.structures.get(i).map_or("design for all".into(), |s| format!("design for {s}"));
            let mut row: Vec<Cell> = vec![name.into()];
            row.extend((0..n).map(|j| Cell::from(e.mean(i, j))));
            row.push(mean(&e.worst(i)).into());
            table = table.row(row);
        }
        section = section.block(table);
    }
    section
}

fn robust_section(found: Option<Vec<RobustSeed>>) -> Section {
    let mut table = Table::new(vec![
        Column::text("Design"),
        Column::number("Worst loss, mean over seeds", "").digits(3),
        Column::number("Mean loss", "").digits(3),
    ])
    .caption("Loss: minus the logarithm of the D-efficiency, per parameter, at fresh draws of the posterior");
    if let Some(seeds) = &found {
        for (i, name) in RISKS.into_iter().enumerate() {
            let column = |f: fn(&RobustSeed) -> &[f64; 3]| seeds.iter().map(|s| f(s)[i]).collect::<Vec<_>>();
            table = table.row(vec![
                name.into(),
                mean(&column(|s| &s.worst)).into(),
                Cell::from(mean(&column(|s| &s.mean))),
            ]);
        }
    }
    Section::new("Robust design").id("robust").text(
        "Known system of first order whose pole moves from 0.35 to 0.85 with its inputs, so that what a record tells depends on the parameters. Each seed: 60 noisy random samples, their estimate with its covariance, designs of 60 samples for the estimate (nominal), for the mean loss over draws, and for the worst fifth of them; judged on other draws.",
    ).block(table)
}

fn outputs_section(found: Option<Vec<Errors>>) -> Section {
    let mut table = Table::new(vec![
        Column::text("Record"),
        Column::number("MSE of torque", "Nm2").digits(3),
        Column::number("MSE of lambda, times 10^4", "").digits(3),
    ])
    .caption("Free run on unseen random records without noise, mean over seeds");
    for e in found.iter().flatten() {
        table =
            table.row(vec![e.of.name().into(), mean(&e.mse[0]).into(), Cell::from(1e4 * mean(&e.mse[1]))]);
    }
    Section::new("One record for two outputs").id("two-outputs").text(
        "Fuel, spark, throttle and speed move about 2000 rpm and 30 Nm; quadratic NARX of torque and lambda, lambda without spark. I-designs of 100 samples after 60 random ones; the composite weighs each criterion with its value for a random record (4.54 in relative form).",
    ).block(table)
}
