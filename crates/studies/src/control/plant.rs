//! What is known of an engine before its loops are judged: a map about its set point, a model behind it, and one under loops.

use dynocal_control::closed::Closed;
use dynocal_control::error::ControlError;
use dynocal_control::identify::{ORDERS, identify};
use dynocal_control::interaction::relative_gains;
use dynocal_control::linear::{about, drawn};
use dynocal_control::margin::{Side, margins};
use dynocal_control::matrix::Matrix;
use dynocal_control::plane::Channel;
use dynocal_control::runtime::PidGains;
use dynocal_control::search::choose;
use dynocal_control::system::{System, Transfer};
use dynocal_control::tune::{Asked as Margin, lag, step_run};
use dynocal_ident::stored::{Quantity, StoredModel};
use dynocal_numerics::watch::Watch;

use super::bed::{self, Bench, SAMPLE_S, Under};
use super::{DEMANDED, INPUTS, OUTPUTS};

/// Draws of the parameters, and half of the interval that nine tenths of their gain margins may have, in dB: what is asked of promises.
const DRAWS: u64 = 40;
const SURE_DB: f64 = 1.0;
/// Gain margin that is taken of a loop whose model has none.
const ROOM: f64 = 4.0;

/// The engine behind the inverse of its steady gains, and loops that this model has.
pub(super) struct Behind {
    /// Steady gains, outputs by inputs, and the relative gain.
    pub(super) steady: Matrix,
    pub(super) relative_gain: f64,
    /// The record behind the first inverse, what corrects that, and both as one map.
    pub(super) record: bed::Record,
    pub(super) finer: Vec<f64>,
    pub(super) map: Vec<f64>,
    /// Loops, and factors half-way (in dB) to their gain margins.
    gains: Vec<PidGains>,
    raised: [f64; 2],
}

/// The engine under loops, and the loops that are judged.
pub(super) struct Known {
    pub(super) plant: System,
    pub(super) gains: Vec<PidGains>,
    pub(super) orders: Vec<(usize, usize)>,
    pub(super) fits: Vec<f64>,
    pub(super) test_s: f64,
    /// Half of the interval of each gain margin in dB.
    pub(super) half_db: [f64; 2],
}

/// Two tests: the first tells the steady gains, the second moves behind their inverse.
pub(super) fn behind_a_map(bench: &Bench, length_s: f64, watch: Watch) -> Result<Behind, String> {
    let first = Identified::of(&bench.excite(length_s, None, None)?, INPUTS, watch)?.system()?;
    let steady = first.at(0.0);
    let relative_gain = relative_gains(&first, 0.0).map_err(words)?[0];
    let rough = inverse(&steady)?;
    let record = bench.excite(length_s, Some(&rough), None)?;
    let behind = Identified::of(&record, DEMANDED, watch)?.system()?;
    let finer = inverse(&behind.at(0.0))?;
    let plant = late(behind.mixed(&finer).map_err(words)?)?;
    let gains = tuned(&plant)?;
    let loops = closed(&plant, &gains)?;
    let room = |k| margins(&loops, Side::Outputs, k).map(|m| m.gain_up.unwrap_or(ROOM).sqrt());
    let raised = [room(0).map_err(words)?, room(1).map_err(words)?];
    let map = product(&rough, &finer);
    Ok(Behind { steady, relative_gain, record, finer, map, gains, raised })
}

/// A test under the loops of `first`: margins are decided where loops move the engine, and a plant that bends has other slopes there. Its
/// length doubles until draws of its model agree about the gain margins to 1 dB, or it has the greatest length.
pub(super) fn under_loops(
    bench: &Bench,
    first: &Behind,
    (least_s, most_s): (f64, f64),
    seed: u64,
    watch: Watch,
) -> Result<Known, String> {
    let mut test_s = least_s;
    loop {
        let under = Under { gains: &first.gains, raised: first.raised };
        let record = bench.excite(test_s, Some(&first.map), Some(&under))?;
        let found = Identified::of(&record, DEMANDED, watch)?;
        let plant = late(found.system()?)?;
        let gains = tuned(&plant)?;
        let half_db = found.half_db(&gains, seed);
        if half_db.iter().all(|h| *h <= SURE_DB) || 2.0 * test_s > most_s {
            let Identified { orders, fits, .. } = found;
            return Ok(Known { plant, gains, orders, fits, test_s, half_db });
        }
        test_s *= 2.0;
    }
}

fn words(e: ControlError) -> String {
    e.to_string()
}

/// The controller answers a record's row in the next one.
fn late(plant: System) -> Result<System, String> {
    let later = Transfer::sampled(&[0.0, 1.0], &[1.0]);
    plant.after(&[later.clone(), later]).map_err(words)
}

/// Linear models of both outputs from a record.
struct Identified {
    inputs: [&'static str; 2],
    models: Vec<StoredModel>,
    orders: Vec<(usize, usize)>,
    fits: Vec<f64>,
}

impl Identified {
    fn of(record: &bed::Record, inputs: [&'static str; 2], watch: Watch) -> Result<Self, String> {
        let mut out = Self { inputs, models: Vec::new(), orders: Vec::new(), fits: Vec::new() };
        for (o, output) in OUTPUTS.iter().enumerate() {
            let quantity = |name: &str| Quantity { name: name.into(), unit: "-".into() };
            let column = |k: usize| record.u.iter().skip(k).step_by(2).copied().collect::<Vec<f64>>();
            let columns: Vec<_> = inputs.iter().enumerate().map(|(k, n)| (quantity(n), column(k))).collect();
            let stop = || watch.interrupted();
            let one = identify(&columns, (quantity(output), &record.y[o]), SAMPLE_S, &ORDERS, &stop)
                .map_err(words)?;
            out.orders.push(one.orders);
            out.fits.push(one.selection_r2);
            out.models.push(one.model);
        }
        Ok(out)
    }

    fn system(&self) -> Result<System, String> {
        self.with(&self.models)
    }

    fn with(&self, models: &[StoredModel]) -> Result<System, String> {
        let all: Vec<&StoredModel> = models.iter().collect();
        let names: Vec<String> = self.inputs.iter().map(|n| n.to_string()).collect();
        let point = names.iter().map(|n| (n.clone(), 0.0)).collect();
        about(&all, &names, &point).map(|found| found.system).map_err(words)
    }

    /// Half of the interval that holds nine tenths of the gain margins of each loop over draws of the parameters, in dB. Infinite where a
    /// draw is not stable: of such a model nothing is promised.
    fn half_db(&self, gains: &[PidGains], seed: u64) -> [f64; 2] {
        let margin = |draw: u64| -> Option<[f64; 2]> {
            let own = |(i, m): (usize, &StoredModel)| {
                drawn(m, seed, draw * self.models.len() as u64 + i as u64).unwrap_or_else(|| m.clone())
            };
            let models: Vec<StoredModel> = self.models.iter().enumerate().map(own).collect();
            let loops = closed(&late(self.with(&models).ok()?).ok()?, gains).ok()?;
            let up = |k| Some(20.0 * margins(&loops, Side::Outputs, k).ok()?.gain_up?.log10());
            Some([up(0)?, up(1)?])
        };
        let Some(all) = (0..DRAWS).map(margin).collect::<Option<Vec<_>>>() else {
            return [f64::INFINITY; 2];
        };
        [0, 1].map(|k| {
            let mut own: Vec<f64> = all.iter().map(|m| m[k]).collect();
            own.sort_by(f64::total_cmp);
            let end = all.len() / 20;
            0.5 * (own[own.len() - 1 - end] - own[end])
        })
    }
}

/// Product of two matrices of two rows.
fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    (0..4).map(|k| a[k / 2 * 2] * b[k % 2] + a[k / 2 * 2 + 1] * b[2 + k % 2]).collect()
}

fn inverse(g: &Matrix) -> Result<Vec<f64>, String> {
    let inverse = g.inverse().ok_or("the steady gains of the engine have no inverse")?;
    Ok(inverse.data.iter().map(|v| v.re).collect())
}

/// Gains of each loop alone, made smaller together until both keep the margins with the other closed.
fn tuned(plant: &System) -> Result<Vec<PidGains>, String> {
    let asked = Margin::default();
    let mut alone = Vec::new();
    for k in 0..2 {
        let refused = |e: dynocal_control::error::ControlError| format!("gains of {}: {e}", OUTPUTS[k]);
        let channel = Channel::new(plant.time, plant.channel(k, k).clone()).map_err(refused)?;
        let lags: Vec<_> = lag(&channel).ok().into_iter().collect();
        let channels = [channel];
        let found = choose(&channels, &asked, step_run(&channels, &lags)).map_err(refused)?;
        alone.push(PidGains::pi(found.tuned.kp, found.tuned.ki));
    }
    let mut factor = 1.0;
    for _ in 0..60 {
        let gains: Vec<PidGains> =
            alone.iter().map(|g| PidGains::pi(g.kp / factor, g.ki / (factor * factor))).collect();
        let l = closed(plant, &gains)?;
        let kept = |k: usize| margins(&l, Side::Outputs, k).is_ok_and(|m| asked.violation(&m) <= 1.0);
        if kept(0) && kept(1) {
            return Ok(gains);
        }
        factor *= 1.06;
    }
    Err("no gains keep the margins with both loops closed".into())
}

pub(super) fn closed(plant: &System, gains: &[PidGains]) -> Result<Closed, String> {
    let own: Vec<Transfer> = gains.iter().map(|g| g.transfer(plant.time)).collect();
    let controller = System::diagonal(plant.time, &own).map_err(|e| e.to_string())?;
    Closed::new(plant.clone(), controller).map_err(|e| e.to_string())
}
