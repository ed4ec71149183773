//! What a demand reaches where its loop has its input at an end of the range.
//!
//! Near such an end the input hardly moves the demand any more (a throttle that is nearly open), so that the input over the demand is steep
//! there and no model of it says where it ends. The demand over the input is flat, and every point at the end tells it:
//!
//! ```text
//! y = T(log u, other factors)                    u: the driven input, y: the demand, both as measured
//! R(x) = T(log u_end, x) - y >= 0                reserve of a cell, with the probability that is asked; less than y at the other end
//! ```
//!
//! It takes the place of the limit `u <= u_end` around places that lines have missed, where some point of the day, or a window of a line, stood at that end. Windows in
//! which the demand was not reached are learnt from, too. From points alone it is not taken: they hardly tell what a wide open throttle would give with a
//! wastegate that is nowhere near, and cells closed it by far too much (up to 2.6 % of fuel on `gtdi_2l`).

use dynocal_calib::steady::cell::Side;
use dynocal_calib::steady::day::{DayPoint, Purpose};
use dynocal_calib::steady::layout::{Layout, ResponseChannel, ResponseSource};
use dynocal_ident::model::response::{Ask, Points, Prediction, Response, ResponseModel};
use dynocal_numerics::watch::Watch;

use super::choose::{Chosen, choose};
use super::error::MapError;
use super::learn::kinds;
use super::spec::{Errors, ModelsSpec};
use super::windows::{Window, missed};

/// What a demand reaches at the ends of its input.
#[derive(Clone, Debug)]
pub(super) struct Reach {
    /// Number of the loop, which is that of its response.
    pub(super) driven: usize,
    /// The ends: where the demand is greatest, and where it is least.
    ends: [End; 2],
    /// Scatter of the demand over the points.
    scale: f64,
}

/// One end.
#[derive(Clone, Debug)]
struct End {
    /// Whether it is the upper one of the input.
    upper: bool,
    /// Whether anything was measured there.
    stood: bool,
    reserve: Reserve,
}

/// The reserve as a response over the factors.
#[derive(Clone, Debug)]
struct Reserve {
    model: ResponseModel,
    widen: f64,
    /// Number of the demand among the factors.
    axis: usize,
    /// The input at the end, as the model takes it.
    end: f64,
    /// 1: as much as is asked has to be reached; -1: no more than that.
    sign: f64,
}

/// What was measured: all factors as measured, the driven input, whether it stood at an end of its range.
type Row<'a> = (&'a [f64], f64, bool);

impl Reach {
    /// From points and lines; none where no loop holds an axis, where its input never stood at an end, or where no candidate can be learnt.
    ///
    /// # Errors
    /// [`MapError::Interrupted`], keys of the models.
    pub(super) fn learn(
        layout: &Layout,
        points: &[DayPoint],
        windows: &[Window],
        spec: &ModelsSpec,
        watch: Watch,
    ) -> Result<Option<Self>, MapError> {
        let Some((axis, driven)) = layout.leading_demand() else { return Ok(None) };
        let input = &layout.problem.inputs[layout.driven()[driven]];
        let usable =
            points.iter().filter(|p| p.purpose != Purpose::Verify && p.point.usable).map(|p| &p.point);
        let of_points = usable.map(|p| {
            let at_end = p.saturated.contains(&input.name);
            (&p.factors[..], p.responses[driven], at_end)
        });
        // Where the demand was not reached it hardly answers its input any more: that the loop had not come to rest is no matter there.
        let mut told = missed(layout, windows);
        told.extend((0..windows.len()).filter(|k| windows[*k].row.at_end[driven] && !windows[*k].settles()));
        told.sort_unstable();
        told.dedup();
        let of_lines = told.iter().map(|k| &windows[*k].row);
        let of_lines = of_lines.map(|r| (&r.factors[..], r.responses[driven], r.at_end[driven]));
        let rows: Vec<Row> = of_points.chain(of_lines).collect();
        if !rows.iter().any(|r| r.2) {
            return Ok(None);
        }
        let log = input.lower > 0.0 && rows.iter().all(|r| r.1 > 0.0);
        let of = |u: f64| if log { u.ln() } else { u };
        let mut inputs = layout.factor_names();
        let output = std::mem::replace(&mut inputs[axis], input.name.clone());
        let with = |(x, u, _): &Row| {
            let mut x = x.to_vec();
            x[axis] = of(*u);
            x
        };
        let y: Vec<f64> = rows.iter().map(|r| r.0[axis]).collect();
        let table = Points { inputs, output: output.clone(), x: rows.iter().flat_map(with).collect(), y };
        watch.note(&format!("what {output} reaches at the ends of {}", input.name));
        let found = choose(&kinds(spec)?, Errors::Absolute, &table, spec.folds, false, watch.interrupt);
        if watch.interrupted() {
            return Err(MapError::Interrupted);
        }
        // What cannot be learnt is no end of the day: the places that lines missed count as not reached.
        let Ok(Chosen { learnt, widen, .. }) = found else { return Ok(None) };
        let reserve = |end: f64, sign: f64| {
            let model = learnt.model.clone();
            Reserve { model, widen, axis, end: of(end), sign }
        };
        let more = |r: &Row| {
            let mean = |u: f64| reserve(u, 1.0).at(r.0, Ask::Mean).mean;
            mean(input.upper) - mean(input.lower)
        };
        let rising = rows.iter().map(more).sum::<f64>() >= 0.0;
        let end = |upper: bool, sign: f64| {
            let near = |r: &&Row| (r.1 - input.lower > input.upper - r.1) == upper;
            let stood = rows.iter().filter(|r| r.2).any(|r| near(&r));
            End { upper, stood, reserve: reserve(if upper { input.upper } else { input.lower }, sign) }
        };
        let n = table.y.len() as f64;
        let mean = table.y.iter().sum::<f64>() / n;
        let scale =
            (table.y.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / n).sqrt().max(f64::MIN_POSITIVE);
        Ok(Some(Self { driven, ends: [end(rising, 1.0), end(!rising, -1.0)], scale }))
    }

    /// The reserves at both ends, as responses after those of the layout.
    pub(super) fn responses(&self) -> impl Iterator<Item = &dyn Response> {
        self.ends.iter().map(|e| &e.reserve as &dyn Response)
    }

    /// Whether the limit of the input itself at an end gives way.
    pub(super) fn replaces(&self, response: usize, upper: bool) -> bool {
        response == self.driven && self.ends.iter().any(|e| e.stood && e.upper == upper)
    }

    /// Limits of the reserves, which follow `responses` others.
    pub(super) fn sides(&self, responses: usize) -> impl Iterator<Item = Side> {
        let stood = self.ends.iter().enumerate().filter(|(_, e)| e.stood);
        stood.map(move |(k, _)| Side {
            response: responses + k,
            limit: 0.0,
            sign: -1.0,
            scale: self.scale,
            caution: 1.0,
        })
    }
}

/// The response number `k` that a price speaks of: one of those with a model, or a reserve.
pub(super) fn channel(layout: &Layout, k: usize) -> ResponseChannel {
    let modelled = || layout.responses.iter().filter(|r| !r.slow);
    if let Some(r) = modelled().nth(k) {
        return r.clone();
    }
    let axis = layout.leading_demand().map(|(k, _)| &layout.factors[k]);
    let (name, unit) = axis.map_or(("demand", "-"), |f| (&f.name[..], &f.unit[..]));
    let which = if k == modelled().count() { "reserve" } else { "reserve downwards" };
    ResponseChannel {
        name: format!("{name} {which}"),
        unit: unit.into(),
        source: ResponseSource::Derived,
        lower: Some(0.0),
        upper: None,
        weight: 0.0,
        slow: false,
    }
}

impl Reserve {
    fn at(&self, x: &[f64], ask: Ask) -> Prediction {
        let mut out = Prediction::new(x.len());
        self.predict(x, ask, &mut out);
        out
    }
}

impl Response for Reserve {
    fn dim(&self) -> usize {
        self.model.dim()
    }

    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction) {
        let (d, k) = (x.len(), self.axis);
        let mut there = x.to_vec();
        there[k] = self.end;
        self.model.predict(&there, ask, out);
        out.mean = self.sign * (out.mean - x[k]);
        let squared = self.widen * self.widen;
        if ask >= Ask::Variance {
            out.variance *= squared;
            out.noise *= squared;
        }
        if ask >= Ask::Gradient {
            out.gradient.iter_mut().for_each(|g| *g *= self.sign);
            out.gradient[k] = -self.sign;
            out.variance_gradient.iter_mut().for_each(|g| *g *= squared);
            out.variance_gradient[k] = 0.0;
        }
        if ask >= Ask::Hessian {
            out.hessian.iter_mut().for_each(|h| *h *= self.sign);
            out.variance_hessian.iter_mut().for_each(|h| *h *= squared);
            for i in 0..d {
                for h in [&mut out.hessian, &mut out.variance_hessian] {
                    (h[k * d + i], h[i * d + k]) = (0.0, 0.0);
                }
            }
        }
    }

    fn describe(&self) -> String {
        format!("reserve at the end of the input, {}", self.model.describe())
    }
}
