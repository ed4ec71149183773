//! The engine itself: the bed of a spec without scatter from cycle to cycle, held where the maps are asked, and searched directly.

use std::collections::BTreeMap;

use dynocal_calib::map::FeedforwardMap;
use dynocal_calib::steady::grid::{CellState, corners, interpolate};
use dynocal_calib::steady::hold::{HoldSpec, hold};
use dynocal_calib::steady::layout::FactorKind;
use dynocal_calib::steady::station::{ApproachSpec, Station, SteadyPoint};
use dynocal_design::points::{Sobol, short_ways};
use dynocal_ident::model::response::{Ask, Prediction, Response};
use dynocal_ident::plan::{Plan, PlanChannel};
use dynocal_ident::plant::{Causality, Plant};
use dynocal_jobs::map::Mapped;
use dynocal_jobs::map::spec::MapSpec;
use dynocal_numerics::watch::Watch;
use dynocal_plant::plants;
use serde::{Deserialize, Serialize};

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

/// A direct search at an operating point.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Best {
    pub(super) at: Vec<f64>,
    /// What is minimised with the setting of the maps.
    pub(super) map: f64,
    /// The least that was found, limits kept.
    pub(super) best: f64,
    /// Its free inputs.
    pub(super) x: Vec<f64>,
    /// Settings that were held.
    pub(super) tried: usize,
}

/// The engine and the maps.
pub(super) struct Truth<'a> {
    found: &'a Mapped,
    plant: Box<dyn Plant>,
    axes: Vec<Vec<f64>>,
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
/// First and last step of the direct search as shares of the ranges, and most settings of one search.
const STEPS: [f64; 4] = [0.16, 0.08, 0.04, 0.02];
const MOST: usize = 160;
/// What passing a limit by all of its size costs, as a multiple of what is minimised.
const PENALTY: f64 = 20.0;
/// Wait with the maps alone in s.
const OPEN_S: f64 = 10.0;

impl<'a> Truth<'a> {
    pub(super) fn new(spec: &MapSpec, found: &'a Mapped, watch: Watch<'a>) -> Result<Self, String> {
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
        let axes = found.axes.iter().map(|a| a.points.clone()).collect();
        let approach = ApproachSpec { settle_s: 60.0, average_s: 2.0, ..spec.bed.approach.clone() };
        Ok(Self { found, plant, axes, approach, now, watch })
    }

    /// Points between cells that hold an optimum, in an order of short ways.
    pub(super) fn places(&self, count: usize) -> Vec<Vec<f64>> {
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
        let order = short_ways(&all, &found.layout.to_unit(&self.now.0));
        order.into_iter().map(|k| places[k].clone()).collect()
    }

    /// Holds the factors `x` with the loops closed; limits are read, not kept.
    fn measure(&mut self, x: &[f64]) -> Result<SteadyPoint, String> {
        let layout = &self.found.layout;
        let watch = self.watch;
        let interrupt = || watch.interrupted();
        let everything = |_: &str| f64::INFINITY;
        let mut station = Station::new(
            self.plant.as_mut(),
            layout,
            &self.approach,
            &everything,
            self.now.clone(),
            &interrupt,
        );
        let point = station.measure(x, &[]).map_err(|e| e.to_string())?;
        let driven = (0..layout.loops.len()).map(|k| point.responses[k]).collect();
        self.now = (x.to_vec(), driven);
        Ok(point)
    }

    /// What is minimised, at the demanded axes: what a loop still misses is taken out with the slope of the models.
    fn fuel(&self, point: &SteadyPoint, x: &[f64]) -> f64 {
        let d = x.len();
        let mut at = Prediction::new(d);
        let mut sum = 0.0;
        for ((r, m), value) in
            self.found.layout.responses.iter().zip(&self.found.models).zip(&point.responses)
        {
            if r.weight == 0.0 {
                continue;
            }
            m.model.predict(x, Ask::Gradient, &mut at);
            let missing: f64 = (0..self.axes.len()).map(|i| at.gradient[i] * (x[i] - point.factors[i])).sum();
            sum += r.weight * (value + missing);
        }
        sum
    }

    fn passed(&self, point: &SteadyPoint) -> BTreeMap<String, (f64, f64)> {
        let all = self.found.layout.responses.iter().zip(&point.responses);
        let one = |(r, v): (&dynocal_calib::steady::layout::ResponseChannel, &f64)| {
            let above = r.upper.map(|u| (v - u, u.abs()));
            let below = r.lower.map(|l| (l - v, l.abs()));
            let worst = [above, below].into_iter().flatten().max_by(|a, b| a.0.total_cmp(&b.0))?;
            Some((r.name.clone(), worst))
        };
        all.filter_map(one).collect()
    }

    /// The maps at the axes `at`.
    pub(super) fn held(&mut self, at: &[f64]) -> Result<Held, String> {
        let x = interpolate(&self.axes, &self.found.cells, at);
        let point = self.measure(&x)?;
        let passed = self.passed(&point).into_iter().map(|(name, p)| (name, p.0)).collect();
        let fuel = self.fuel(&point, &x);
        let open_torque = self.open(at)?;
        Ok(Held {
            at: at.to_vec(),
            torque: at[0],
            open_torque,
            passed,
            fuel,
            settled: point.usable,
            note: point.note,
        })
    }

    /// The first demand with the maps alone, no loop closed.
    fn open(&mut self, at: &[f64]) -> Result<f64, String> {
        let found = self.found;
        let layout = &found.layout;
        let x = interpolate(&self.axes, &found.cells, at);
        let demand =
            |name: &str| place_of(&layout.problem.demand_names(), name).map(|k| layout.demand(k, &x));
        let given = |name: &str| place_of(&layout.problem.given_names(), name).map(|k| layout.given(k, &x));
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
            .map(|(k, g)| PlanChannel::free(&g.name, &g.unit, vec![layout.given(k, &x); n]));
        let mut plan = Plan::open_loop("maps", layout.sample_time_s, inputs.chain(given).collect());
        plan.outputs = vec![p.demands[0].output.clone()];
        let held = hold(self.plant.as_mut(), &spec, &plan, &[]).map_err(|e| e.to_string())?;
        Ok(held.outputs[0])
    }

    /// Direct search from the setting of the maps: one input after the other up and down, steps halved.
    pub(super) fn best(&mut self, at: &[f64]) -> Result<Best, String> {
        let x = interpolate(&self.axes, &self.found.cells, at);
        let (map, mut cost) = self.cost(&x)?;
        let (mut least, mut here, mut tried) = (map, x.clone(), 1);
        for step in STEPS {
            let mut moved = true;
            while moved && tried < MOST {
                moved = false;
                for i in self.axes.len()..x.len() {
                    for sign in [1.0, -1.0] {
                        let f = &self.found.layout.factors[i];
                        let mut trial = here.clone();
                        trial[i] = (trial[i] + sign * step * (f.upper - f.lower)).clamp(f.lower, f.upper);
                        if trial == here {
                            continue;
                        }
                        let (fuel, c) = self.cost(&trial)?;
                        tried += 1;
                        if c < cost {
                            (cost, least, here, moved) = (c, fuel, trial, true);
                            break;
                        }
                    }
                }
            }
        }
        Ok(Best { at: at.to_vec(), map, best: least, x: here[self.axes.len()..].to_vec(), tried })
    }

    /// What is minimised, and with what passing limits costs.
    fn cost(&mut self, x: &[f64]) -> Result<(f64, f64), String> {
        let point = self.measure(x)?;
        let fuel = self.fuel(&point, x);
        if !point.usable {
            return Ok((fuel, f64::INFINITY));
        }
        let over: f64 = self.passed(&point).values().map(|(p, size)| (p / size.max(1e-9)).max(0.0)).sum();
        Ok((fuel, fuel * (1.0 + PENALTY * over)))
    }
}
