//! Records of the boosted engine on its bed: excitation, and the start of WLTC.

use std::path::{Path, PathBuf};

use dynocal_files::csv_io;
use dynocal_jobs::engine::transient::{self, Every};
use dynocal_jobs::engine::{Engine, cycle};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use dynocal_plant::vehicle::LoadUnits;

/// Sample time in s.
pub(super) const SAMPLE_S: f64 = 0.1;
/// Inputs of the bed, with their units.
const INPUTS: [(&str, &str); 5] =
    [("throttle", "deg"), ("wastegate", "mm"), ("spark", "deg"), ("lambda_demand", "-"), ("speed", "rpm")];

/// A bed with its engine, which records into a folder.
pub(super) struct Recorder<'a> {
    pub(super) engine: Engine,
    pub(super) folder: &'a Path,
    pub(super) bed: PathBuf,
    pub(super) seed: u64,
    pub(super) watch: Watch<'a>,
}

/// A number that is drawn anew after a number of samples that is drawn as well.
fn levels(rng: &mut Rng64, n: usize, range: [f64; 2], hold: [usize; 2]) -> Vec<f64> {
    let mut out = Vec::with_capacity(n);
    while out.len() < n {
        let length = hold[0] + rng.below(hold[1] - hold[0] + 1);
        let level = rng.uniform_in(range[0], range[1]);
        out.extend(std::iter::repeat_n(level, length));
    }
    out.truncate(n);
    out
}

/// First-order lag.
fn lagged(values: &[f64], tau_s: f64) -> Vec<f64> {
    let keep = (-SAMPLE_S / tau_s).exp();
    let mut state = values.first().copied().unwrap_or(0.0);
    let step = |v: &f64| {
        state = keep * state + (1.0 - keep) * v;
        state
    };
    values.iter().map(step).collect()
}

/// Values at multiples of the sample time, between the rows of a log.
fn sampled(time_s: &[f64], values: &[f64], n: usize) -> Vec<f64> {
    let at = |t: f64| {
        let k = time_s.partition_point(|s| *s <= t).clamp(1, time_s.len() - 1);
        let share = ((t - time_s[k - 1]) / (time_s[k] - time_s[k - 1])).clamp(0.0, 1.0);
        values[k - 1] + share * (values[k] - values[k - 1])
    };
    (0..n).map(|k| at(k as f64 * SAMPLE_S)).collect()
}

impl Recorder<'_> {
    /// Excites all inputs for `length_s`, lambda by its loop.
    pub(super) fn excite(&self, name: &str, k: u64, length_s: f64) -> Result<(), String> {
        let n = (length_s / SAMPLE_S) as usize;
        let mut rng = Rng64::stream(self.seed, k);
        let speed = lagged(&levels(&mut rng, n, [1000.0, 3000.0], [30, 120]), 1.5);
        // More levels where the throttle does most.
        let opened = levels(&mut rng, n, [0.0, 1.0], [8, 40]);
        let throttle: Vec<f64> = opened.iter().map(|v| 3.0 + 22.0 * v.powf(1.5)).collect();
        let wastegate = levels(&mut rng, n, [4.0, 20.0], [20, 60]);
        let lambda = levels(&mut rng, n, [0.92, 1.08], [15, 50]);
        let spark = levels(&mut rng, n, [8.0, 34.0], [6, 30]);
        self.record(name, [lagged(&throttle, 0.15), wastegate, spark, lambda, speed])
    }

    /// The engine on its bed as a car asks for it along a cycle, inside of what is excited.
    pub(super) fn drive(&self, name: &str, file: &Path, length_s: f64) -> Result<(), String> {
        let text = |e: dynocal_jobs::engine::EngineJobError| e.to_string();
        let driven = cycle::read(file, Some(length_s), &|_| {}).map_err(text)?;
        let spec = cycle::Spec { name: name.into(), cycle: driven, units: LoadUnits::LbfMph, grade: 0.0 };
        let log = cycle::run(&self.engine, &spec, self.watch).map_err(text)?.log;
        let n = (length_s / SAMPLE_S) as usize;
        let of = |values: &[f64]| sampled(&log.time_s, values, n);
        let power = |f: fn(&dynocal_plant::vehicle::Power) -> f64| -> Vec<f64> {
            of(&log.power.iter().map(f).collect::<Vec<f64>>())
        };
        let within = |v: Vec<f64>, [lower, upper]: [f64; 2], tau_s: f64| {
            lagged(&v.into_iter().map(|v| v.clamp(lower, upper)).collect::<Vec<f64>>(), tau_s)
        };
        self.record(
            name,
            [
                within(power(|p| p.throttle_deg), [3.5, 24.0], 0.2),
                vec![12.0; n],
                within(power(|p| p.spark_deg), [10.0, 32.0], 0.2),
                vec![1.0; n],
                within(of(&log.engine_rpm), [1050.0, 2950.0], 0.3),
            ],
        )
    }

    fn record(&self, name: &str, inputs: [Vec<f64>; 5]) -> Result<(), String> {
        let file = self.folder.join(format!("{name}-inputs.csv"));
        let time: Vec<f64> = (0..inputs[0].len()).map(|k| k as f64 * SAMPLE_S).collect();
        let mut columns: Vec<(&str, &str, &[f64])> = vec![("time", "s", &time)];
        columns.extend(INPUTS.iter().zip(&inputs).map(|((n, u), v)| (*n, *u, v.as_slice())));
        csv_io::write_columns(&file, &columns).map_err(|e| e.to_string())?;
        let every = Every::Time { every_s: SAMPLE_S };
        let spec = transient::Spec { file, bed: Some(self.bed.clone()), every, seed: self.seed };
        self.watch.note(&format!("recording {name}"));
        let found = transient::run(&self.engine, &spec, self.watch).map_err(|e| e.to_string())?;
        transient::csv(&self.folder.join(format!("{name}.csv")), &found).map_err(|e| e.to_string())
    }
}
