//! Frequency responses out of records: against responses that are known, in open and closed loop, with honest deviations.

use dynocal_control::closed::Closed;
use dynocal_control::margin::{Side, margins};
use dynocal_control::matrix::C;
use dynocal_control::response::{HIGHEST, Response, Test, frequency_response, odd_multisine};
use dynocal_control::runtime::PidGains;
use dynocal_control::system::{System, Time, Transfer};
use dynocal_numerics::rng::Rng64;

const DT_S: f64 = 0.05;
const TIME: Time = Time::Sampled { sample_time_s: DT_S };

/// Two inputs, two outputs, each output a lag of both inputs.
fn channels() -> [[Transfer; 2]; 2] {
    let lag = |b: f64, a: f64, delay: usize| {
        let mut num = vec![0.0; delay];
        num.push(b);
        Transfer::sampled(&num, &[1.0, -a])
    };
    [[lag(0.3, 0.8, 1), lag(0.1, 0.8, 2)], [lag(-0.05, 0.6, 1), lag(0.4, 0.6, 3)]]
}

fn filtered(g: &Transfer, u: &[f64]) -> Vec<f64> {
    let mut y = vec![0.0; u.len()];
    for t in 0..u.len() {
        let forward: f64 = (0..g.num.len().min(t + 1)).map(|k| g.num[k] * u[t - k]).sum();
        let back: f64 = (1..g.den.len().min(t + 1)).map(|k| g.den[k] * y[t - k]).sum();
        y[t] = forward - back;
    }
    y
}

/// Outputs of both channels with noise, inputs of their own.
fn record(rows: usize, noise: f64, seed: u64) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
    let mut rng = Rng64::new(seed);
    let u: Vec<Vec<f64>> = (0..2).map(|_| (0..rows).map(|_| rng.normal()).collect()).collect();
    let y = channels()
        .iter()
        .map(|row| {
            let (a, b) = (filtered(&row[0], &u[0]), filtered(&row[1], &u[1]));
            a.iter().zip(&b).map(|(a, b)| a + b + noise * rng.normal()).collect()
        })
        .collect();
    (u, y)
}

/// Errors over stated deviations of all channels and frequencies, root of the mean square.
fn ratio(found: &Response, own: &[[Transfer; 2]; 2]) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for (k, f) in found.frequency_hz.iter().enumerate() {
        for (o, row) in own.iter().enumerate() {
            for (i, g) in row.iter().enumerate() {
                let truth = g.at(TIME, std::f64::consts::TAU * f);
                sum += ((found.at(k, o, i) - truth).norm() / found.std_at(k, o, i)).powi(2);
                n += 1.0;
            }
        }
    }
    f64::sqrt(sum / n)
}

/// Over seeds the error is what the deviation says, and no frequency goes past 0.4 of the sampling frequency.
#[test]
fn two_by_two_is_found_with_honest_deviations() {
    for seed in 0..6 {
        let (u, y) = record(20_000, 0.3, seed);
        let test = Test { inputs: &u, outputs: &y, demands: None, sample_time_s: DT_S };
        let found = frequency_response(&test, Some(400)).unwrap();
        let r = ratio(&found, &channels());
        assert!((0.85..1.15).contains(&r), "seed {seed}: errors are {r} of what is stated");
        let last = *found.frequency_hz.last().unwrap();
        assert!(last <= HIGHEST / DT_S && last > 0.39 / DT_S);
        assert!(found.coherence.iter().all(|c| (0.0..=1.0).contains(c)));
    }
}

/// In closed loop under a strong disturbance u and noise go together: the direct quotient is biased, that with the demand is not.
#[test]
fn a_closed_loop_needs_its_demand() {
    let g = &channels()[0][0];
    let (rows, mut rng) = (120_000, Rng64::new(5));
    let w: Vec<f64> = (0..rows).map(|_| rng.normal()).collect();
    let (mut u, mut y) = (vec![0.0; rows], vec![0.0; rows]);
    let (mut x, mut load) = (0.0, 0.0);
    for t in 0..rows {
        load = 0.9 * load + 0.5 * rng.normal();
        x = 0.8 * x + 0.3 * if t > 0 { u[t - 1] } else { 0.0 };
        y[t] = x + load;
        u[t] = w[t] - 1.5 * y[t];
    }
    let (inputs, outputs, demands) = ([u], [y], [w]);
    // Mean error as a share of the response, and root of the mean square of errors over what is stated of them.
    let error = |demands: Option<&[Vec<f64>]>| {
        let test = Test { inputs: &inputs, outputs: &outputs, demands, sample_time_s: DT_S };
        let found = frequency_response(&test, Some(256)).unwrap();
        let n = found.frequency_hz.len() / 4;
        let (mut share, mut stated) = (0.0, 0.0);
        for k in 0..n {
            let truth = g.at(TIME, std::f64::consts::TAU * found.frequency_hz[k]);
            let e = (found.at(k, 0, 0) - truth).norm();
            share += e / truth.norm() / n as f64;
            stated += (e / found.std_at(k, 0, 0)).powi(2) / n as f64;
        }
        (share, stated.sqrt())
    };
    let ((direct, beyond), (by_demand, stated)) = (error(None), error(Some(&demands)));
    assert!(by_demand < 0.2 && direct > 4.0 * by_demand, "direct {direct}, by the demand {by_demand}");
    assert!((0.7..1.4).contains(&stated) && beyond > 3.0, "{stated}, direct {beyond}");
}

/// Margins without a model lie where those of the plant are, nine tenths of the intervals hold them; the delay is found.
#[test]
fn margins_of_a_measured_response() {
    let g = Transfer::sampled(&[0.0, 0.0, 0.0, 0.0, 0.2], &[1.0, -0.8]);
    let c = PidGains::pi(1.2, 3.0).transfer(TIME);
    let plant = dynocal_control::system::System::single(TIME, g.clone()).unwrap();
    let own = dynocal_control::system::System::single(TIME, c.clone()).unwrap();
    let closed = dynocal_control::closed::Closed::new(plant, own).unwrap();
    let truth = dynocal_control::margin::margins(&closed, dynocal_control::margin::Side::Outputs, 0).unwrap();
    let mut inside = 0;
    for seed in 0..12 {
        let mut rng = Rng64::new(100 + seed);
        let u: Vec<f64> = (0..24_000).map(|_| rng.normal()).collect();
        let y: Vec<f64> = filtered(&g, &u).iter().map(|v| v + 0.05 * rng.normal()).collect();
        let test = Test { inputs: &[u], outputs: &[y], demands: None, sample_time_s: DT_S };
        let found = frequency_response(&test, Some(512)).unwrap();
        let m = found.margins(0, 0, &c, 0.2, 100, seed);
        let (gain, phase) = (m.found.gain_up.unwrap(), m.found.phase_deg.unwrap());
        assert!((gain / truth.gain_up.unwrap() - 1.0).abs() < 0.05, "{gain} {:?}", truth.gain_up);
        assert!((phase - truth.phase_deg.unwrap()).abs() < 3.0, "{phase} {:?}", truth.phase_deg);
        // The draws lie about the response that was found: their interval moves with it.
        let (low, high) = m.phase_deg.unwrap();
        inside += u32::from(low - 1.0 < truth.phase_deg.unwrap() && truth.phase_deg.unwrap() < high + 1.0);
        let delay = found.delay_s(0, 0).unwrap();
        assert!(delay > 0.15 && delay < 0.45, "four samples and the lag: {delay}");
    }
    assert!(inside >= 9, "{inside} of 12 intervals hold the phase margin");
}

#[test]
fn multisines_are_odd_and_stay_below_what_a_record_shows() {
    let mut rng = Rng64::new(1);
    let u = odd_multisine(500, DT_S, 6.0, 0.7, &mut rng).unwrap();
    assert!((u.iter().fold(0.0f64, |m, v| m.max(v.abs())) - 0.7).abs() < 1e-12);
    // Odd lines alone: the second half is the first with the other sign.
    assert!((0..250).all(|t| (u[t] + u[t + 250]).abs() < 1e-9));
    let line = |k: usize| {
        let sum = u.iter().enumerate().fold(C::new(0.0, 0.0), |s, (t, v)| {
            s + C::from_polar(*v, -std::f64::consts::TAU * (k * t) as f64 / 500.0)
        });
        sum.norm()
    };
    assert!(line(1) > 1.0 && line(2) < 1e-9 && line(5) < 1e-9 && line(151) < 1e-9);
    let text = odd_multisine(500, DT_S, 9.0, 1.0, &mut rng).unwrap_err().to_string();
    assert!(text.contains("0.4 of the sampling frequency") && text.contains('9'), "{text}");
}

#[test]
fn records_that_tell_nothing_are_named() {
    let (u, y) = record(600, 0.1, 1);
    let of = |inputs: &[Vec<f64>], outputs: &[Vec<f64>], segment: usize| {
        let test = Test { inputs, outputs, demands: None, sample_time_s: DT_S };
        frequency_response(&test, Some(segment)).map(|_| ()).unwrap_err().to_string()
    };
    assert!(of(&u, &y, 500).contains("longer record or shorter segments"));
    let still = vec![u[0].clone(), vec![1.0; 600]];
    assert!(of(&still, &y, 100).contains("stands still"), "{}", of(&still, &y, 100));
    let alike = vec![u[0].clone(), u[0].iter().map(|v| 2.0 * v).collect()];
    assert!(of(&alike, &y, 100).contains("move alike"));
    let mut gap = y.clone();
    gap[1][70] = f64::NAN;
    assert!(of(&u, &gap, 100).contains("sample 71"));
    assert!(of(&u, &[y[0][..100].to_vec()], 100).contains("samples of a channel"));
}

/// A record gives back its plant, and the draws of the model spread as estimates from other records do.
#[test]
fn identified_models_know_how_uncertain_they_are() {
    use dynocal_control::identify::identify;
    use dynocal_control::linear::{about, drawn};
    use dynocal_ident::stored::Quantity;
    let quantity = |n: &str| Quantity { name: n.into(), unit: "-".into() };
    let gain_of = |model: &dynocal_ident::stored::StoredModel| {
        let names = ["a".to_string(), "b".to_string()];
        let point = names.iter().map(|n| (n.clone(), 0.0)).collect();
        about(&[model], &names, &point).unwrap().system.channel(0, 0).steady_gain(TIME)
    };
    let (mut gains, mut stated) = (Vec::new(), Vec::new());
    for seed in 0..8 {
        let (u, y) = record(1200, 0.3, 50 + seed);
        let inputs: Vec<_> = ["a", "b"].iter().zip(&u).map(|(n, c)| (quantity(n), c.clone())).collect();
        let found = identify(&inputs, (quantity("y"), &y[0]), DT_S, &[(1, 3), (2, 5)], &|| false).unwrap();
        assert!(found.selection_r2 > 60.0, "{}", found.selection_r2);
        gains.push(gain_of(&found.model));
        let own: Vec<f64> = (0..40).filter_map(|d| drawn(&found.model, 1, d)).map(|m| gain_of(&m)).collect();
        let mean = own.iter().sum::<f64>() / own.len() as f64;
        stated.push((own.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / 39.0).sqrt());
    }
    // Orders beyond those of the plant may be chosen by chance, with a factor in common that may lie anywhere: the usual record counts.
    stated.sort_by(f64::total_cmp);
    let (mean, said) = (gains.iter().sum::<f64>() / 8.0, 0.5 * (stated[3] + stated[4]));
    let met = (gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / 7.0).sqrt();
    assert!((mean - 1.5).abs() < 4.0 * met / 8f64.sqrt(), "{mean}, deviation {met}");
    assert!(said > 0.4 * met && said < 2.5 * met, "stated {said}, met {met}");
    let short = vec![(quantity("a"), vec![0.0; 100])];
    let text = identify(&short, (quantity("y"), &[0.0; 100]), DT_S, &[(1, 2), (2, 4)], &|| false)
        .unwrap_err()
        .to_string();
    assert!(text.contains("100 samples"), "{text}");
}

/// A test that moves one input after the other: its halves know nothing of each other's input, and are not what judges.
#[test]
fn inputs_that_move_in_turns_are_both_judged() {
    use dynocal_control::identify::{ORDERS, identify};
    use dynocal_ident::stored::Quantity;
    let quantity = |n: &str| Quantity { name: n.into(), unit: "-".into() };
    let rows = 2400;
    let (mut u, _) = record(rows, 0.0, 3);
    u[0][rows / 2..].fill(0.0);
    u[1][..rows / 2].fill(0.0);
    let mut rng = Rng64::new(8);
    let own = &channels()[1];
    let parts = (filtered(&own[0], &u[0]), filtered(&own[1], &u[1]));
    let y: Vec<f64> = parts.0.iter().zip(&parts.1).map(|(a, b)| a + b + 0.02 * rng.normal()).collect();
    let inputs = [(quantity("a"), u[0].clone()), (quantity("b"), u[1].clone())];
    let found = identify(&inputs, (quantity("y"), &y), DT_S, &ORDERS, &|| false).unwrap();
    assert!(found.selection_r2 > 95.0, "{:?}: {}", found.orders, found.selection_r2);
}

/// An offset, a ripple of three samples and a drift that the inputs do not make: the gain at rest is the plant's, no pole is theirs; a
/// plant that integrates keeps its own.
#[test]
fn disturbances_that_go_on_are_not_the_plants() {
    use dynocal_control::identify::{ORDERS, identify};
    use dynocal_control::linear::about;
    use dynocal_ident::stored::Quantity;
    let quantity = |n: &str| Quantity { name: n.into(), unit: "-".into() };
    for seed in 0..2 {
        let mut rng = Rng64::new(70 + seed);
        let (mut u, mut left, mut level) = (vec![0.0; 3000], 0, 0.0);
        for v in &mut u {
            if left == 0 {
                (left, level) = (2 + rng.below(40), rng.uniform_in(-1.0, 1.0));
            }
            left -= 1;
            *v = level;
        }
        let g = Transfer::sampled(&[0.0, 0.0, 0.0, 0.1], &[1.0, -0.9]);
        let y: Vec<f64> = filtered(&g, &u)
            .iter()
            .enumerate()
            .map(|(t, v)| {
                v + 2.0
                    + 0.1 * (std::f64::consts::TAU * t as f64 / 3.0).sin()
                    + 1e-5 * t as f64
                    + 0.05 * rng.normal()
            })
            .collect();
        let of = |y: &[f64]| {
            let inputs = [(quantity("u"), u.clone())];
            let found = identify(&inputs, (quantity("y"), y), DT_S, &ORDERS, &|| false).unwrap();
            let point = [("u".to_string(), 0.0)].into();
            let linear = about(&[&found.model], &["u".to_string()], &point);
            (found.orders, linear.map(|l| (l.system.channel(0, 0).steady_gain(TIME), l.slowest_pole)))
        };
        let (orders, linear) = of(&y);
        let (gain, slowest) = linear.unwrap();
        assert!(
            (gain - 1.0).abs() < 0.1 && slowest < 0.99,
            "seed {seed}: {orders:?}, gain {gain}, pole {slowest}"
        );
        // Beside it: what adds up.
        let integral = Transfer::sampled(&[0.0, 0.05], &[1.0, -1.0]);
        let y: Vec<f64> = filtered(&integral, &u).iter().map(|v| v + 0.02 * rng.normal()).collect();
        let creeps = of(&y).1.map_or(1.0, |l| l.1);
        assert!(creeps > 0.99, "seed {seed}: {creeps}");
    }
}

/// A record whose input is slow shows nothing at high frequencies, where a derivative part still has gain: noise that looks like a line there
/// gives no margin. What is found is none, or near the truth, or its interval holds it.
#[test]
fn noise_has_no_margin() {
    let (dt_s, rows) = (0.05, 6000);
    let a = (-0.05f64).exp();
    let mut num = vec![0.0; 4];
    num.push(1.0 - a);
    let plant = Transfer::sampled(&num, &[1.0, -a]);
    let time = Time::Sampled { sample_time_s: dt_s };
    let own = PidGains { kp: 2.0, ki: 2.0, kd: 0.25, filter_s: 0.01 }.transfer(time);
    let system = |g: &Transfer| System::single(time, g.clone()).unwrap();
    let truth = margins(&Closed::new(system(&plant), system(&own)).unwrap(), Side::Outputs, 0).unwrap();
    let truth = truth.gain_up.unwrap();
    let (mut near, mut all) = (0, Vec::new());
    for seed in 0..30 {
        let mut rng = Rng64::new(500 + seed);
        let (mut u, mut y) = (vec![0.0; rows], vec![0.0; rows]);
        let (mut level, mut x) = (0.0, 0.0);
        for t in 0..rows {
            level = 0.9 * level + 0.1 * rng.normal();
            u[t] = if t > 0 { 0.9 * u[t - 1] + 0.1 * level } else { 0.0 };
            x = a * x + (1.0 - a) * if t >= 4 { u[t - 4] } else { 0.0 };
            y[t] = x + 0.01 * rng.normal();
        }
        let test = Test { inputs: &[u], outputs: &[y], demands: None, sample_time_s: dt_s };
        let found = frequency_response(&test, None).unwrap().margins(0, 0, &own, 0.0, 20, seed);
        let told = found.found.gain_up.zip(found.gain_up);
        near += usize::from(
            told.is_none_or(|(g, i)| (0.7..1.4).contains(&(g / truth)) || (i.0..=i.1).contains(&truth)),
        );
        all.push(told);
    }
    // Nine tenths of thirty within one in a hundred.
    assert!(near >= 23, "{near} of 30, true {truth}: {all:?}");
}

/// Margins of measured responses are those of the plant: over records of levels and holds (a steep spectrum, which a window smears), in open
/// and in closed loop, their mean is near the truth and the interval of nine tenths holds it about as often as it says.
#[test]
fn measured_margins_are_those_of_the_plant() {
    let (dt_s, rows) = (0.05, 6000);
    let a = (-0.05f64).exp();
    // 2 / (s + 1), held, seven samples late.
    let mut num = vec![0.0; 7];
    num.push(2.0 * (1.0 - a));
    let plant = Transfer::sampled(&num, &[1.0, -a]);
    let time = Time::Sampled { sample_time_s: dt_s };
    let own = PidGains::pi(0.53, 0.5783).transfer(time);
    let system = |g: &Transfer| System::single(time, g.clone()).unwrap();
    let truth = margins(&Closed::new(system(&plant), system(&own)).unwrap(), Side::Outputs, 0).unwrap();
    for closed in [false, true] {
        let (mut phases, mut gains, mut inside) = (Vec::new(), Vec::new(), [0; 2]);
        for seed in 0..40 {
            let mut rng = Rng64::new(100 + seed);
            let (mut r, mut u, mut y) = (vec![0.0; rows], vec![0.0; rows], vec![0.0; rows]);
            let (mut level, mut drift, mut sum, mut x) = (0.0, 0.0, 0.0, 0.0);
            for t in 0..rows {
                if rng.uniform_in(0.0, 1.0) < 0.02 {
                    level = rng.uniform_in(-1.0, 1.0);
                }
                r[t] = level;
                x = a * x + 2.0 * (1.0 - a) * if t >= 7 { u[t - 7] } else { 0.0 };
                drift = 0.95 * drift + 0.006 * rng.normal();
                y[t] = x + drift + 0.02 * rng.normal();
                sum += 0.4 * dt_s * (r[t] - y[t]);
                u[t] = if closed { 0.8 * (r[t] - y[t]) + sum } else { r[t] };
            }
            let demands = [r];
            let test = Test {
                inputs: &[u],
                outputs: &[y],
                demands: closed.then_some(&demands[..]),
                sample_time_s: dt_s,
            };
            let found = frequency_response(&test, None).unwrap().margins(0, 0, &own, 0.0, 60, seed);
            let (gain, phase) = (found.gain_up.unwrap(), found.phase_deg.unwrap());
            let (asked_gain, asked_phase) = (truth.gain_up.unwrap(), truth.phase_deg.unwrap());
            inside[0] += usize::from(gain.0 <= asked_gain && asked_gain <= gain.1);
            inside[1] += usize::from(phase.0 <= asked_phase && asked_phase <= phase.1);
            gains.push(20.0 * (found.found.gain_up.unwrap() / asked_gain).log10());
            phases.push(found.found.phase_deg.unwrap() - asked_phase);
        }
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let told = format!("{closed} {} dB {} deg {inside:?}", mean(&gains), mean(&phases));
        assert!(mean(&gains).abs() < 0.1 && mean(&phases).abs() < 0.5, "{told}");
        // Nine tenths of forty within one in a hundred.
        assert!(inside.iter().all(|n| *n >= 31), "{told}");
    }
}
