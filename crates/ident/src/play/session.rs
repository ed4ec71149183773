//! One plan on one plant: what is applied, measured and kept.

use super::{Course, LimitDistance, PlayError, Played, Stop, Watchdog};
use crate::data::{Channel, Dataset, Role};
use crate::pi::Pi;
use crate::plan::{Plan, PlanDemand, PlanLoop, demand_name};
use crate::plant::{Causality, LimitEvent, Plant, PlantError, Variable, variable_index};
use crate::play::Reason;

/// A loop with its places: its demand, and the column of its output.
struct Closed<'a> {
    pi: Pi,
    of: &'a PlanLoop,
    demand: &'a PlanDemand,
    column: usize,
}

pub(super) struct Session<'a> {
    plant: &'a mut dyn Plant,
    plan: &'a Plan,
    /// Inputs of the plant, all of them, and the place of each channel among them.
    inputs: Vec<f64>,
    places: Vec<usize>,
    /// Outputs at this instant.
    outputs: Vec<f64>,
    /// Places of the recorded outputs.
    recorded: Vec<usize>,
    /// The loop over each channel, where one is closed.
    loops: Vec<Option<Closed<'a>>>,
    /// What is applied next (m).
    row: Vec<f64>,
    course: Course,
    events: Vec<LimitEvent>,
}

/// Variables of one direction, in the plant's order.
fn of(plant: &dyn Plant, causality: Causality) -> Vec<Variable> {
    plant.variables().iter().filter(|v| v.causality == causality).cloned().collect()
}

impl<'a> Session<'a> {
    pub(super) fn new(plant: &'a mut dyn Plant, plan: &'a Plan) -> Result<Self, PlayError> {
        let (inputs, outputs) = (of(plant, Causality::Input), of(plant, Causality::Output));
        let input = |name: &str| variable_index(plant, Causality::Input, name);
        let output = |name: &str| variable_index(plant, Causality::Output, name);
        let places = plan.channels.iter().map(|c| input(&c.name)).collect::<Result<Vec<_>, _>>()?;
        let recorded = match plan.outputs.as_slice() {
            [] => (0..outputs.len()).collect(),
            some => some.iter().map(|name| output(name)).collect::<Result<Vec<_>, _>>()?,
        };
        let same_unit = |channel: &str, found: &str, expected: &str| match found == expected {
            true => Ok(()),
            false => Err(PlayError::Unit {
                plan: plan.name.clone(),
                channel: channel.into(),
                found: found.into(),
                expected: expected.into(),
            }),
        };
        for (c, place) in plan.channels.iter().zip(&places) {
            same_unit(&c.name, &c.unit, &inputs[*place].unit)?;
        }
        let demanded = plan.demands.iter().map(|d| (&d.output, &d.unit));
        for (name, unit) in demanded.chain(plan.limits.iter().map(|l| (&l.output, &l.unit))) {
            same_unit(name, unit, &outputs[output(name)?].unit)?;
        }
        let mut loops = Vec::new();
        for c in &plan.channels {
            let pair = plan.closed_loop(&c.name).and_then(|l| Some((l, plan.demand(&l.output)?)));
            let closed = match pair {
                Some((l, demand)) => {
                    let pi = Pi::new(l.gains, 0.0, c.lower, c.upper);
                    Some(Closed { pi, of: l, demand, column: output(&l.output)? })
                }
                None => None,
            };
            loops.push(closed);
        }
        let mut shown = vec![0.0; outputs.len()];
        plant.outputs(&mut shown)?;
        let course = Course {
            inputs: plan.channels.iter().map(|c| c.name.clone()).collect(),
            outputs: outputs.iter().map(|v| v.name.clone()).collect(),
            u: Vec::new(),
            y: shown.clone(),
            before: 0,
        };
        Ok(Self {
            plant,
            plan,
            inputs: inputs.iter().map(|v| v.start).collect(),
            row: vec![0.0; places.len()],
            places,
            outputs: shown,
            recorded,
            loops,
            course,
            events: Vec::new(),
        })
    }

    /// Holds the first row until the record begins.
    pub(super) fn settle(&mut self, watchdog: &mut dyn Watchdog) -> Result<(), PlayError> {
        let before = watchdog.prepare(self.plan, &self.course)?.max(self.plan.settling_samples());
        let rows = before + self.plan.len();
        self.course.u.reserve(rows * self.places.len());
        self.course.y.reserve(rows * self.outputs.len());
        self.course.before = before;
        for k in 0..before {
            // At first nothing is measured that a loop could take.
            self.next(0, k > 0);
            self.step()?;
        }
        let _ = self.plant.take_events();
        watchdog.begin(&self.course)
    }

    /// The plan itself: samples that were played, and what ended it early.
    pub(super) fn plan(&mut self, watchdog: &mut dyn Watchdog) -> (usize, Option<Stop>) {
        for t in 0..self.plan.len() {
            self.next(t, true);
            if let Some(stop) = watchdog.before(&self.course, &self.row) {
                return (t, Some(stop));
            }
            if let Err(e) = self.step() {
                let what = match &e {
                    PlantError::OutOfRange { name, .. } | PlantError::NonFinite { name, .. } => name.clone(),
                    PlantError::Call(_) => "plant".into(),
                };
                return (t, Some(Stop::new(&what, Reason::Refused(e))));
            }
            let events = self.plant.take_events();
            let stop = watchdog.after(&self.course, &events);
            self.events.extend(events);
            if let Some(stop) = stop {
                // An end that was waited for, at the last sample, is the end of the plan all the same.
                return (t + 1, Some(stop));
            }
        }
        (self.plan.len(), None)
    }

    /// What the watchdog knows to do after a stop.
    pub(super) fn way_back(&mut self, watchdog: &mut dyn Watchdog, stop: &Stop) -> Result<(), PlayError> {
        for u in watchdog.way_back(&self.course).chunks_exact(self.row.len()) {
            self.row.copy_from_slice(u);
            self.step().map_err(|error| PlayError::WayBack {
                plan: self.plan.name.clone(),
                stop: Box::new(stop.clone()),
                error,
            })?;
            self.events.extend(self.plant.take_events());
        }
        Ok(())
    }

    /// What is applied at sample t, from the values measured now.
    fn next(&mut self, t: usize, measured: bool) {
        let dt = self.plan.sample_time_s;
        let m = self.row.len();
        let last = self.course.u.len().checked_sub(m);
        for (i, (c, closed)) in self.plan.channels.iter().zip(&mut self.loops).enumerate() {
            let feedforward = c.values[t];
            let wanted = match closed {
                Some(l) if measured => {
                    l.pi.regain(l.of.gains_at(t));
                    l.pi.step(feedforward, l.demand.values[t] - self.outputs[l.column], dt)
                }
                _ => feedforward,
            };
            self.row[i] = c.limited(wanted, last.map(|from| self.course.u[from + i]), dt);
        }
    }

    /// Applies the row and measures.
    fn step(&mut self) -> Result<(), PlantError> {
        for (place, v) in self.places.iter().zip(&self.row) {
            self.inputs[*place] = *v;
        }
        self.plant.step(&self.inputs, self.plan.sample_time_s, &mut self.outputs)?;
        self.course.u.extend_from_slice(&self.row);
        self.course.y.extend_from_slice(&self.outputs);
        Ok(())
    }

    /// What came out.
    pub(super) fn played(self, played: usize, stop: Option<Stop>) -> Result<Played, PlayError> {
        let (before, rows) = (self.course.before, self.course.rows());
        let record = self.record(before, before + played, &self.plan.name, true);
        record.check()?;
        let way_back = (before + played < rows)
            .then(|| self.record(before + played, rows, &format!("{} way back", self.plan.name), false));
        let mut least_distance = Vec::new();
        for l in &self.plan.limits {
            let column = variable_index(self.plant, Causality::Output, &l.output)?;
            let values = (before..=rows).map(|i| l.distance(self.course.output(i)[column]));
            let distance = values.fold(f64::INFINITY, f64::min);
            least_distance.push(LimitDistance { output: l.output.clone(), distance });
        }
        let used_s = rows as f64 * self.plan.sample_time_s;
        Ok(Played { record, played, before, stop, way_back, least_distance, used_s, events: self.events })
    }

    /// Rows `from..to` as a bed records them; the demands where they are rows of the plan.
    fn record(&self, from: usize, to: usize, name: &str, demands: bool) -> Dataset {
        let channel = |name: String, unit: &str, role, values: Vec<f64>| Channel {
            name,
            unit: unit.into(),
            role,
            values,
        };
        let inputs = self.plan.channels.iter().enumerate().map(|(i, c)| {
            let values = (from..to).map(|t| self.course.input(t)[i]).collect();
            channel(c.name.clone(), &c.unit, Role::Input, values)
        });
        let variables = of(self.plant, Causality::Output);
        let outputs = self.recorded.iter().map(|i| {
            let values = (from..to).map(|t| self.course.output(t)[*i]).collect();
            channel(variables[*i].name.clone(), &variables[*i].unit, Role::Output, values)
        });
        let kept: &[PlanDemand] = if demands { &self.plan.demands } else { &[] };
        let asked = kept.iter().map(|d| {
            channel(demand_name(&d.output), &d.unit, Role::Auxiliary, d.values[..to - from].to_vec())
        });
        Dataset {
            name: name.into(),
            sample_time_s: self.plan.sample_time_s,
            channels: inputs.chain(outputs).chain(asked).collect(),
            init_samples: 0,
            origin: self.plant.describe(),
        }
    }
}
