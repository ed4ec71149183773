//! Our side of `bench/peers/disk_margins.py`: disk margins of published loops, and margins of sampled loops over set points and draws.
//!
//!     cargo run --release -p dynocal-control --example control_peer

use std::time::Instant;

use dynocal_control::closed::Closed;
use dynocal_control::disk::{Place, disk};
use dynocal_control::error::ControlError;
use dynocal_control::margin::{Side, margins};
use dynocal_control::runtime::PidGains;
use dynocal_control::system::{System, Time, Transfer};
use dynocal_numerics::rng::Rng64;

const POINTS: usize = 25;
const DRAWS: usize = 100;
const TIME: Time = Time::Sampled { sample_time_s: 0.05 };

fn main() -> Result<(), ControlError> {
    let mut out = String::from("{");
    let start = Instant::now();
    let published = [
        ("third", third()?),
        ("satellite", satellite([1.0, 0.0, 0.0, 1.0])?),
        ("better", satellite([1.0, -2.0, 0.0, 1.0])?),
    ];
    for (name, l) in &published {
        for skew in [0.0, 1.0, -1.0] {
            out += &format!("\"{name} {skew}\": {:.12}, ", disk(l, Place::Outputs, skew)?.alpha);
        }
    }
    out += &format!("\"published_s\": {:.6}, ", start.elapsed().as_secs_f64());
    let plants = drawn()?;
    let start = Instant::now();
    let (mut stable, mut least) = (0usize, f64::INFINITY);
    let mut first = Vec::new();
    for plant in &plants {
        let pi = [PidGains::pi(0.3, 0.9).transfer(TIME), PidGains::pi(0.25, 0.7).transfer(TIME)];
        let l = Closed::new(plant.clone(), System::diagonal(TIME, &pi)?)?;
        if !l.is_stable() {
            first.push("null".to_string());
            continue;
        }
        stable += 1;
        for k in 0..2 {
            least = least.min(margins(&l, Side::Outputs, k)?.gain_up.unwrap_or(f64::INFINITY));
        }
        let alpha = disk(&l, Place::Outputs, 0.0)?.alpha;
        first.push(format!("{alpha:.12}"));
    }
    let taken = start.elapsed().as_secs_f64();
    first.truncate(10);
    out += &format!(
        "\"loops\": {}, \"stable\": {stable}, \"least_gain_margin\": {least:.9}, \"loops_s\": {taken:.6}, ",
        plants.len()
    );
    out += &format!(
        "\"first\": [{}], \"plants\": [{}]}}",
        first.join(", "),
        plants[..10].iter().map(written).collect::<Vec<_>>().join(", ")
    );
    println!("{out}");
    Ok(())
}

fn third() -> Result<Closed, ControlError> {
    let l = Transfer::continuous(&[25.0], &[1.0, 10.0, 10.0, 10.0], 0.0);
    Closed::new(System::single(Time::Continuous, l)?, System::single(Time::Continuous, Transfer::gain(1.0))?)
}

fn satellite(gains: [f64; 4]) -> Result<Closed, ControlError> {
    let (a, b) = ([0.0, 10.0, -10.0, 0.0], [1.0, 0.0, 0.0, 1.0]);
    let plant = System::from_states(Time::Continuous, &a, &b, &[1.0, 10.0, -10.0, 1.0], &[0.0; 4], 2)?;
    let gains = gains.iter().map(|k| Transfer::gain(*k)).collect();
    Closed::new(plant, System::new(Time::Continuous, 2, 2, gains)?)
}

/// Lags with delays of two to five samples, coupled, over set points, and draws about each.
fn drawn() -> Result<Vec<System>, ControlError> {
    let mut rng = Rng64::new(1);
    let mut out = Vec::new();
    for _ in 0..POINTS {
        let a = [rng.uniform_in(0.7, 0.9), rng.uniform_in(0.6, 0.85)];
        let delay = [2 + rng.below(3), 3 + rng.below(3)];
        for _ in 0..DRAWS {
            let mut channel = |row: usize, gain: f64| {
                let a = a[row] * (1.0 + 0.02 * rng.normal());
                let mut num = vec![0.0; delay[row]];
                num.push(gain * (1.0 + 0.05 * rng.normal()) * (1.0 - a));
                (num, a)
            };
            let (own, a0) = channel(0, 1.0);
            let (cross, _) = channel(0, 0.3);
            let (other, a1) = channel(1, -0.4);
            let (last, _) = channel(1, 1.0);
            let g = |num: Vec<f64>, a: f64| Transfer::sampled(&num, &[1.0, -a]);
            out.push(System::new(TIME, 2, 2, vec![g(own, a0), g(cross, a0), g(other, a1), g(last, a1)])?);
        }
    }
    Ok(out)
}

fn written(s: &System) -> String {
    let channel = |g: &Transfer| format!("{{\"num\": {:?}, \"den\": {:?}}}", g.num, g.den);
    format!("[{}]", s.channels.iter().map(channel).collect::<Vec<_>>().join(", "))
}
