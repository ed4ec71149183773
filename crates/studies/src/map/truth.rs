//! The engine itself: the bed of a spec without scatter from cycle to cycle, held where the maps are asked, and searched directly.

use std::collections::BTreeMap;

use dynocal_calib::map::FeedforwardMap;
use dynocal_calib::steady::cell::Setting;
use dynocal_calib::steady::grid::{CellState, corners, interpolate};
use dynocal_calib::steady::hold::{HoldSpec, hold};
use dynocal_calib::steady::layout::{FactorKind, ResponseChannel};
use dynocal_calib::steady::station::{ApproachSpec, Station, SteadyPoint};
use dynocal_design::points::{Sobol, short_ways};
use dynocal_ident::model::response::{Ask, Prediction, Response};
use dynocal_ident::plan::{Plan, PlanChannel};
use dynocal_ident::plant::{Causality, Plant, PlantState};
use dynocal_jobs::map::Mapped;
use dynocal_jobs::map::spec::MapSpec;
use dynocal_numerics::watch::Watch;
use dynocal_plant::plants;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::search::{Ground, cost, search};

/// The maps at an unseen operating point.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Held {
    pub(super) at: Vec<f64>,
    /// Demanded torque.
    pub(super) torque: f64,
    /// Torque with the maps alone.
    pub(super) open_torque: f64,
    /// How far each limit is passed; negative is room.
    pub(super) passed: BTreeMap<String, f64>,
    /// What is minimised, at the demanded torque.
    pub(super) fuel: f64,
    /// Whether it came to rest.
    pub(super) settled: bool,
    pub(super) note: String,
}

/// A setting at an operating point, waited for longer than the settings of a search.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Confirmed {
    /// Free inputs.
    pub(super) x: Vec<f64>,
    /// What is minimised.
    pub(super) fuel: f64,
    /// Most that a limit is passed, in shares of its size; negative is room.
    pub(super) over: f64,
    /// The limit that is passed most, or has least room.
    pub(super) limit: String,
    /// What the models of the day expect to be minimised there, and its standard deviation.
    pub(super) expected: [f64; 2],
}

/// A direct search at an operating point, and where the maps lose against it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Best {
    pub(super) at: Vec<f64>,
    /// The setting of the maps.
    pub(super) map: Confirmed,
    /// The optimum of the same models at this very point: neither interpolated nor smoothed.
    pub(super) own: Confirmed,
    /// The same without caution and room for what the models do not know.
    pub(super) bold: Confirmed,
    /// The least that was found, limits kept.
    pub(super) best: Confirmed,
    /// Settings that were held.
    pub(super) tried: usize,
}

impl Best {
    /// What the maps take above the best in percent.
    pub(super) fn above(&self) -> f64 {
        100.0 * (self.map.fuel / self.best.fuel - 1.0)
    }
}

/// The engine and the maps.
pub(super) struct Truth<'a> {
    spec: &'a MapSpec,
    found: &'a Mapped,
    axes: Vec<Vec<f64>>,
    watch: Watch<'a>,
}

/// Where an engine stands: its state, the factors, the inputs that loops drive.
type Stand = (PlantState, Vec<f64>, Vec<f64>);

/// The engine without scatter.
struct Quiet<'a> {
    plant: Box<dyn Plant>,
    found: &'a Mapped,
    approach: ApproachSpec,
    /// Where it stands: factors, driven inputs.
    now: (Vec<f64>, Vec<f64>),
    watch: Watch<'a>,
}

/// Place of a name.
fn place_of(names: &[String], name: &str) -> Option<usize> {
    names.iter().position(|n| n == name)
}

/// Seed of the unseen points: the same for all days.
const PLACES: u64 = 20_000;
/// Averaging time of a setting of the search in s, and by how much longer windows and averages are where one is confirmed.
const AVERAGE_S: f64 = 2.0;
const LONGER: f64 = 3.0;
/// Wait with the maps alone in s.
const OPEN_S: f64 = 10.0;
/// How long an unseen point is held before it is judged, in s: the oil is a minute and more behind, and warmer oil turns more easily.
pub(super) const WARM_S: f64 = 150.0;

impl<'a> Quiet<'a> {
    fn new(spec: &MapSpec, found: &'a Mapped, watch: Watch<'a>) -> Result<Self, String> {
        let mut plant = spec.plant.clone();
        // Unequal cylinders, lags and heat stay as they are; only what differs from cycle to cycle goes.
        let quiet: toml::Table =
            toml::from_str("scatter = { heat = 0.0, burn = 0.0 }").map_err(|e| e.to_string())?;
        match plant.bed.get_mut("engine").and_then(|e| e.as_table_mut()) {
            Some(engine) => engine.extend(quiet),
            None => drop(plant.bed.insert("engine".into(), toml::Value::Table(quiet))),
        }
        let make = plants::find(&plant.name).and_then(|p| p.make).ok_or("no plant")?;
        let mut plant = make(&plant, false).map_err(|e| e.to_string())?;
        plant.reset(1);
        let layout = &found.layout;
        let start = |name: &str| {
            let v = plant.variables().iter().find(|v| v.causality == Causality::Input && v.name == name);
            v.map_or(f64::NAN, |v| v.start)
        };
        let input = |k: usize| {
            let i = &layout.problem.inputs[k];
            start(&i.name).clamp(i.lower, i.upper)
        };
        let first = layout.factors.iter().zip(layout.centre()).map(|(f, centre)| match f.kind {
            FactorKind::Free(k) => input(k).clamp(f.lower, f.upper),
            _ => centre,
        });
        let now = (first.collect(), layout.driven().into_iter().map(input).collect());
        let approach = ApproachSpec { settle_s: 60.0, average_s: AVERAGE_S, ..spec.bed.approach.clone() };
        Ok(Self { plant, found, approach, now, watch })
    }

    fn stand(&self) -> Stand {
        (self.plant.save(), self.now.0.clone(), self.now.1.clone())
    }

    fn go_on(&mut self, (plant, at, driven): &Stand) -> Result<(), String> {
        self.plant.restore(plant).map_err(|e| e.to_string())?;
        self.now = (at.clone(), driven.clone());
        Ok(())
    }

    /// Where the inputs of the loops are expected at `x`: they move as the models of the day do, so that the loops have only the rest to do.
    fn ahead(&self, x: &[f64]) -> Vec<f64> {
        let layout = &self.found.layout;
        let mut at = Prediction::new(x.len());
        let mut mean = |l: usize, x: &[f64]| {
            self.found.models[l].model.predict(x, Ask::Mean, &mut at);
            at.mean
        };
        let one = |(l, k): (usize, usize)| {
            let i = &layout.problem.inputs[k];
            (self.now.1[l] + mean(l, x) - mean(l, &self.now.0)).clamp(i.lower, i.upper)
        };
        layout.driven().into_iter().enumerate().map(one).collect()
    }

    /// Holds the factors `x` with the loops closed; limits are read, not kept.
    fn measure(&mut self, x: &[f64], approach: &ApproachSpec) -> Result<SteadyPoint, String> {
        let layout = &self.found.layout;
        let (watch, ahead) = (self.watch, self.ahead(x));
        let interrupt = || watch.interrupted();
        let everything = |_: &str| f64::INFINITY;
        let now = self.now.clone();
        let mut station = Station::new(self.plant.as_mut(), layout, approach, &everything, now, &interrupt);
        let point = station.measure(x, None, &ahead, &[]).map_err(|e| e.to_string())?;
        let driven = (0..layout.loops.len()).map(|k| point.responses[k]).collect();
        self.now = (x.to_vec(), driven);
        Ok(point)
    }

    /// What is minimised, at the demanded axes: what a loop still misses is taken out with the slope of the models.
    fn fuel(&self, point: &SteadyPoint, x: &[f64]) -> f64 {
        let (d, layout) = (x.len(), &self.found.layout);
        let mut at = Prediction::new(d);
        let mut sum = 0.0;
        for ((r, m), value) in layout.responses.iter().zip(&self.found.models).zip(&point.responses) {
            if r.weight == 0.0 {
                continue;
            }
            m.model.predict(x, Ask::Gradient, &mut at);
            let missing: f64 = (0..layout.axes).map(|i| at.gradient[i] * (x[i] - point.factors[i])).sum();
            sum += r.weight * (value + missing);
        }
        sum
    }

    /// The first demand with the maps alone, no loop closed.
    fn open(&mut self, x: &[f64]) -> Result<f64, String> {
        let found = self.found;
        let layout = &found.layout;
        let demand = |name: &str| place_of(&layout.problem.demand_names(), name).map(|k| layout.demand(k, x));
        let given = |name: &str| place_of(&layout.problem.given_names(), name).map(|k| layout.given(k, x));
        let ports = &found.map.ports;
        let reference =
            ports.demands.iter().map(|p| demand(&p.name)).chain(ports.given.iter().map(|p| given(&p.name)));
        let reference: Vec<f64> = reference.map(|v| v.unwrap_or(f64::NAN)).collect();
        let values = found.map.steady(&reference);
        let p = &layout.problem;
        let spec = HoldSpec { settle_s: 2.0 * OPEN_S, window_s: OPEN_S, average_s: 2.0 };
        let n = spec.samples(layout.sample_time_s);
        let inputs =
            p.inputs.iter().enumerate().map(|(k, i)| {
                PlanChannel::free(&i.name, &i.unit, vec![values[k]; n]).within(i.lower, i.upper)
            });
        let given = p
            .given
            .iter()
            .enumerate()
            .map(|(k, g)| PlanChannel::free(&g.name, &g.unit, vec![layout.given(k, x); n]));
        let mut plan = Plan::open_loop("maps", layout.sample_time_s, inputs.chain(given).collect());
        plan.outputs = vec![p.demands[0].output.clone()];
        let held = hold(self.plant.as_mut(), &spec, &plan, &[]).map_err(|e| e.to_string())?;
        Ok(held.outputs[0])
    }
}

/// How far each limited response passes its limits, and the size of the limit.
fn passed(responses: &[ResponseChannel], values: &[f64]) -> Vec<(String, f64, f64)> {
    let one = |(r, v): (&ResponseChannel, &f64)| {
        let above = r.upper.map(|u| (v - u, u.abs()));
        let below = r.lower.map(|l| (l - v, l.abs()));
        let worst = [above, below].into_iter().flatten().max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((r.name.clone(), worst.0, worst.1.max(1e-9)))
    };
    responses.iter().zip(values).filter_map(one).collect()
}

impl<'a> Truth<'a> {
    pub(super) fn new(spec: &'a MapSpec, found: &'a Mapped, watch: Watch<'a>) -> Self {
        let axes = found.axes.iter().map(|a| a.points.clone()).collect();
        Self { spec, found, axes, watch }
    }

    /// The maps at so many unseen points, and at so many of them the best of a direct search.
    pub(super) fn judge(&self, unseen: usize, searched: usize) -> Result<(Vec<Held>, Vec<Best>), String> {
        let mut engine = Quiet::new(self.spec, self.found, self.watch)?;
        let places = self.places(unseen, &engine.now.0);
        let searched = searched.min(places.len());
        // Spread over the unseen points.
        let chosen: Vec<usize> = (0..searched).map(|k| k * places.len() / searched).collect();
        let (mut held, mut stands) = (Vec::new(), Vec::new());
        for (k, at) in places.iter().enumerate() {
            held.push(self.held(&mut engine, at)?);
            if chosen.contains(&k) {
                stands.push((at, engine.stand()));
            }
        }
        // Each search goes on from where the maps were held, whatever the others do.
        let best = stands.par_iter().map(|(at, stand)| self.best(at, stand)).collect::<Result<_, _>>()?;
        Ok((held, best))
    }

    /// Points between cells that hold an optimum, in an order of short ways.
    fn places(&self, count: usize, now: &[f64]) -> Vec<Vec<f64>> {
        let (n, found) = (self.axes.len(), self.found);
        let Some(mut sequence) = Sobol::new(n, PLACES) else { return Vec::new() };
        let mut places = Vec::new();
        for _ in 0..200 * count {
            if places.len() == count {
                break;
            }
            let unit = sequence.next_point();
            let place = |(a, u): (&Vec<f64>, f64)| a[0] + u * (a[a.len() - 1] - a[0]);
            let at: Vec<f64> = self.axes.iter().zip(unit).map(place).collect();
            if corners(&self.axes, &at).iter().all(|(k, _)| found.cells[*k].state == CellState::Optimal) {
                places.push(at);
            }
        }
        let unit = |at: &Vec<f64>| -> Vec<f64> {
            let full = interpolate(&self.axes, &found.cells, at);
            found.layout.to_unit(&full)
        };
        let all: Vec<Vec<f64>> = places.iter().map(unit).collect();
        let order = short_ways(&all, &found.layout.to_unit(now));
        order.into_iter().map(|k| places[k].clone()).collect()
    }

    /// The maps at the axes `at`, everything nearly as warm as it stays there; the engine then stands where the loops held it.
    fn held(&self, engine: &mut Quiet, at: &[f64]) -> Result<Held, String> {
        let x = interpolate(&self.axes, &self.found.cells, at);
        let approach = engine.approach.clone();
        engine.measure(&x, &ApproachSpec { average_s: WARM_S, ..approach.clone() })?;
        let point = engine.measure(&x, &approach)?;
        let passed = passed(&self.found.layout.responses, &point.responses);
        let fuel = engine.fuel(&point, &x);
        let stand = engine.stand();
        let open_torque = engine.open(&x)?;
        engine.go_on(&stand)?;
        Ok(Held {
            at: at.to_vec(),
            torque: at[0],
            open_torque,
            passed: passed.into_iter().map(|(name, by, _)| (name, by)).collect(),
            fuel,
            settled: point.usable,
            note: point.note,
        })
    }

    /// Direct search, and what the settings that the models call best take on the engine.
    fn best(&self, at: &[f64], stand: &Stand) -> Result<Best, String> {
        let mut engine = Quiet::new(self.spec, self.found, self.watch)?;
        engine.go_on(stand)?;
        let layout = &self.found.layout;
        let map = interpolate(&self.axes, &self.found.cells, at);
        let setting = self.found.setting(self.spec);
        let bold = Setting { z: 0.0, caution: 0.0, ..self.found.setting(self.spec) };
        let optimum = |s: &Setting| {
            let starts = self.spec.optimise.starts;
            s.optimise(at, starts, std::slice::from_ref(&map), self.spec.seed, self.watch.interrupt).x
        };
        let (own, bold) = (optimum(&setting), optimum(&bold));
        let mut place = Place { engine, at };
        let unit = |x: &Vec<f64>| layout.to_unit(x)[at.len()..].to_vec();
        let starts = [unit(&map), unit(&own), unit(&bold)];
        let found = search(&mut place, &starts)?;
        let tried = found.as_ref().map_or(starts.len(), |f| f.tried);
        let best = found.map_or(starts[0].clone(), |f| f.u);
        let mut confirmed = Vec::new();
        for u in starts.iter().chain([&best]) {
            confirmed.push(place.confirm(u, &setting)?);
        }
        // Waited for longer, one of the others may be the best after all.
        let of = |c: &Confirmed| if c.fuel.is_finite() { cost(&[c.fuel, c.over]) } else { f64::INFINITY };
        let least = confirmed.iter().rev().min_by(|a, b| of(a).total_cmp(&of(b))).cloned();
        let mut all = confirmed.into_iter();
        match (all.next(), all.next(), all.next(), least) {
            (Some(map), Some(own), Some(bold), Some(best)) => {
                Ok(Best { at: at.to_vec(), map, own, bold, best, tried })
            }
            _ => Err("no setting was confirmed".into()),
        }
    }
}

/// The free inputs of one operating point.
struct Place<'a> {
    engine: Quiet<'a>,
    at: &'a [f64],
}

impl Place<'_> {
    fn factors(&self, u: &[f64]) -> Vec<f64> {
        let free = &self.engine.found.layout.factors[self.at.len()..];
        let x = free.iter().zip(u).map(|(f, u)| f.lower + u * (f.upper - f.lower));
        self.at.iter().copied().chain(x).collect()
    }

    /// Holds a setting once more, with longer windows and averages.
    fn confirm(&mut self, u: &[f64], setting: &Setting) -> Result<Confirmed, String> {
        let x = self.factors(u);
        let a = self.engine.approach.clone();
        let longer = ApproachSpec { window_s: LONGER * a.window_s, average_s: LONGER * a.average_s, ..a };
        let point = self.engine.measure(&x, &longer)?;
        let expected = setting.judge(&x, dynocal_numerics::status::Status::Stalled, None);
        let passed = passed(&self.engine.found.layout.responses, &point.responses);
        let worst = passed.into_iter().map(|(name, by, size)| (name, by / size));
        let (limit, over) = worst.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((String::new(), 0.0));
        Ok(Confirmed {
            fuel: self.engine.fuel(&point, &x),
            x: x[self.at.len()..].to_vec(),
            over,
            limit,
            expected: [expected.objective, expected.objective_deviation],
        })
    }
}

impl Ground for Place<'_> {
    fn hold(&mut self, u: &[f64]) -> Result<Option<Vec<f64>>, String> {
        let x = self.factors(u);
        let approach = self.engine.approach.clone();
        let point = self.engine.measure(&x, &approach)?;
        if !point.usable {
            return Ok(None);
        }
        let over = passed(&self.engine.found.layout.responses, &point.responses);
        let over = over.into_iter().map(|(_, by, size)| by / size);
        Ok(Some(std::iter::once(self.engine.fuel(&point, &x)).chain(over).collect()))
    }

    fn expected(&self, u: &[f64]) -> Vec<f64> {
        let (x, layout) = (self.factors(u), &self.engine.found.layout);
        let mut at = Prediction::new(x.len());
        let models = self.engine.found.models.iter();
        let means = models.map(|m| {
            m.model.predict(&x, Ask::Mean, &mut at);
            at.mean
        });
        let means: Vec<f64> = means.collect();
        let fuel = layout.responses.iter().zip(&means).map(|(r, v)| r.weight * v).sum();
        let over = passed(&layout.responses, &means).into_iter().map(|(_, by, size)| by / size);
        std::iter::once(fuel).chain(over).collect()
    }
}
