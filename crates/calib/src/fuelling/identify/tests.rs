use super::follow::shown;
use super::*;
use crate::fuelling::{FuelPolicy, Sensed};
use dynocal_numerics::rng::Rng64;

const DT: f64 = 0.01;

mod cams;
mod moving;
mod spoiled;
mod steady;
mod trimmed;

/// What the record is made with, by the model itself.
fn truth() -> Fuelling {
    let points: Vec<[f64; 3]> = (0..60)
        .map(|k| (1000.0 + 400.0 * f64::from(k % 6), 25.0 + 7.0 * f64::from(k / 6)))
        .map(|(n, p): (f64, f64)| [n, p, 0.3 * p * (0.8 + 1e-4 * n - 2e-8 * n * n) - 1.0])
        .collect();
    let charge = Charge::fit(&points).unwrap();
    let area = vec![0.0, 100.0, 500.0, 100.0];
    let filling = Filling {
        upstream_kpa: 101.325,
        throttle_deg: 30.0,
        area,
        gain: 1.4,
        throttle_lag_s: 0.06,
        throttle_rate_deg_s: None,
        sensor_lag_s: DT,
        correction_per_s: 0.0,
    };
    let timing = Timing {
        charge_s: 0.01,
        charge_cycles: 0.6,
        transport_cycles: 1.1,
        transport_fuel: 9.0,
        mixing_fuel: 6.0,
        sensor_lag_s: 0.08,
    };
    let film = Film { share: 0.25, tau_s: 0.4 };
    Fuelling {
        sample_time_s: DT,
        charge,
        filling,
        film,
        timing,
        coolant: None,
        film_ends: None,
        trim: None,
        left: None,
        rms: 0.0,
        pressure_rms_kpa: 0.0,
    }
}

/// What a coolant does to it, where it counts.
fn law() -> CoolantLaw {
    CoolantLaw {
        at_c: 90.0,
        range_c: [20.0, 115.0],
        share_per_k: -0.006,
        tau_per_k: -0.02,
        charge_per_k: -4e-4,
        charge_ends_per_k: [4e-4, -6e-4],
    }
}

/// The same engine with a sensor in the cylinder.
fn in_cylinder(f: &Fuelling) -> Fuelling {
    let timing = Timing {
        transport_cycles: 0.0,
        transport_fuel: 0.0,
        mixing_fuel: 0.0,
        sensor_lag_s: 1e-9,
        ..f.timing
    };
    Fuelling { timing, ..f.clone() }
}

/// Speed, throttle, injection, pressure, lambda.
type Channels = [Vec<f64>; 5];

fn record(f: &Fuelling, holds: usize) -> Channels {
    heated(f, holds, 3, None)
}

/// Coolant of a record that heats up by 25 K from a start.
fn coolant(start_c: f64, samples: usize) -> Vec<f64> {
    (0..samples).map(|t| start_c + 25.0 * t as f64 / samples as f64).collect()
}

fn heated(f: &Fuelling, holds: usize, seed: u64, start_c: Option<f64>) -> Channels {
    let mut rng = Rng64::stream(seed, 0);
    let (mut speed, mut throttle, mut injection) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..holds {
        let (n, a, q) =
            (1200.0 + 1600.0 * rng.uniform(), 8.0 + 14.0 * rng.uniform(), 8.0 + 8.0 * rng.uniform());
        for _ in 0..300 {
            speed.push(n);
            throttle.push(a);
            injection.push(q);
        }
    }
    let heat = coolant(start_c.unwrap_or(90.0), speed.len());
    let mut r = TransientRecord {
        sample_time_s: DT,
        speed_rpm: &speed,
        throttle_deg: &throttle,
        injection: &injection,
        map_kpa: &vec![50.0; speed.len()],
        lambda: &vec![1.0; speed.len()],
        upstream_kpa: 101.325,
        boost_kpa: None,
        coolant_c: start_c.map(|_| heat.as_slice()),
        cams_deg: None,
    };
    let p = pressure(&r, f);
    let shown = shown(&r, f);
    r.map_kpa = &shown;
    let lambda: Vec<f64> = richness(&r, f, &p).iter().map(|phi| 1.0 / phi).collect();
    [speed, throttle, injection, shown, lambda]
}

fn sensed(speed_rpm: f64, throttle_deg: f64, map_kpa: f64, lambda: Option<f64>) -> Sensed {
    Sensed { speed_rpm, throttle_deg, map_kpa, upstream_kpa: None, coolant_c: 90.0, cams_deg: None, lambda }
}

fn view(c: &Channels) -> TransientRecord<'_> {
    TransientRecord {
        sample_time_s: DT,
        speed_rpm: &c[0],
        throttle_deg: &c[1],
        injection: &c[2],
        map_kpa: &c[3],
        lambda: &c[4],
        upstream_kpa: 101.325,
        boost_kpa: None,
        coolant_c: None,
        cams_deg: None,
    }
}

fn alone<'a>(records: &'a [TransientRecord<'a>]) -> Measured<'a> {
    Measured { records, steady: &[], weights: &[] }
}

#[test]
fn a_record_of_the_model_gives_the_model_back() {
    let truth = truth();
    let channels = record(&truth, 60);
    let found = identify(&[view(&channels)], &|| false).unwrap();
    let near = |a: f64, b: f64, share: f64, what: &str| {
        assert!((a / b - 1.0).abs() < share, "{what}: {a}, planted {b}")
    };
    near(found.film.share, truth.film.share, 0.03, "share");
    near(found.film.tau_s, truth.film.tau_s, 0.03, "tau");
    near(found.filling.gain, truth.filling.gain, 0.03, "gain");
    near(found.filling.throttle_lag_s, truth.filling.throttle_lag_s, 0.05, "throttle");
    near(found.timing.sensor_lag_s, truth.timing.sensor_lag_s, 0.03, "sensor");
    near(found.timing.mixing_fuel, truth.timing.mixing_fuel, 0.05, "mixing");
    near(found.timing.ahead_s(2000.0), truth.timing.ahead_s(2000.0), 0.05, "ahead");
    for (n, p) in [(1400.0, 40.0), (2500.0, 60.0)] {
        near(found.charge.at(n, p), truth.charge.at(n, p), 3e-3, "charge");
    }
    assert!(found.rms < 1e-3, "{}", found.rms);
}

/// Where nothing moves, the policy gives the fuel of lambda; where the throttle jumps, the mixture in the cylinder stays.
#[test]
fn the_policy_holds_the_mixture_of_its_own_model() {
    let truth = truth();
    let mut policy = FuelPolicy::new(truth.clone(), 60.0);
    let (speed, n) = (2000.0, 600);
    let throttle: Vec<f64> = (0..n).map(|t| if t < 200 { 11.0 } else { 19.0 }).collect();
    let speeds = vec![speed; n];
    let zeros = vec![0.0; n];
    let r = TransientRecord {
        sample_time_s: DT,
        speed_rpm: &speeds,
        throttle_deg: &throttle,
        injection: &zeros,
        map_kpa: &vec![40.0; n],
        lambda: &vec![1.0; n],
        upstream_kpa: 101.325,
        boost_kpa: None,
        coolant_c: None,
        cams_deg: None,
    };
    // At rest at the first throttle, whatever it began with.
    let p = pressure(&r, &truth);
    let injection: Vec<f64> =
        (0..n).map(|t| policy.step(&sensed(speed, throttle[t], 40.0, None), 1.0)).collect();
    let r = TransientRecord { injection: &injection, ..r };
    let phi = richness(&r, &in_cylinder(&truth), &p);
    // Not the first second: the film of the record begins with another injection. And not what was injected before the step
    // and meets its air after it: that nobody can know.
    let known = 200 - (truth.timing.ahead_s(speed) / DT).ceil() as usize;
    let held = phi[100..known].iter().chain(&phi[200..n - 20]);
    let worst = held.map(|v| (v - 1.0).abs()).fold(0.0, f64::max);
    assert!(worst < 5e-3, "{worst}");
    // What there was to follow.
    let steady = |p: f64| truth.charge.at(speed, p);
    assert!((steady(p[n - 1]) / steady(p[199]) - 1.0).abs() > 0.2);
}

#[test]
fn what_says_too_little_is_refused() {
    let truth = truth();
    let channels = record(&truth, 8);
    let e = identify(&[view(&channels)], &|| false).unwrap_err();
    assert!(matches!(e, FuellingError::Rests { found: 8, .. }), "{e}");
    let channels = record(&truth, 30);
    let short = TransientRecord { lambda: &channels[4][..50], ..view(&channels) };
    let e = identify(&[short], &|| false).unwrap_err().to_string();
    assert!(e.contains("`lambda` has 50 samples"), "{e}");
    let slow = TransientRecord { sample_time_s: 0.1, ..view(&channels) };
    assert!(identify(&[slow], &|| false).unwrap_err().to_string().contains("0.05 s at most"));
    let low = TransientRecord { upstream_kpa: 30.0, ..view(&channels) };
    assert!(identify(&[low], &|| false).unwrap_err().to_string().contains("before the throttle"));
    assert!(matches!(identify(&[view(&channels)], &|| true), Err(FuellingError::Interrupted)));
}

/// Behind an open throttle waves and noise show a little more than the pressure before it.
#[test]
fn a_little_above_ambient_is_no_boost() {
    let truth = truth();
    let channels = record(&truth, 60);
    let greatest = channels[3].iter().copied().fold(0.0, f64::max);
    let level = |above: f64| TransientRecord { upstream_kpa: greatest / above, ..view(&channels) };
    assert!(identify(&[level(1.06)], &|| false).unwrap_err().to_string().contains("1.05 times"));
    assert!(identify(&[level(1.02)], &|| false).is_ok());
}

/// A turbocharger that spools up and down before the throttle: measured, it is no error; taken for ambient, it is one.
#[test]
fn a_measured_pressure_before_the_throttle_counts() {
    let truth = truth();
    let plain = record(&truth, 40);
    let n = plain[0].len();
    let boost: Vec<f64> = (0..n).map(|t| 115.0 + 12.0 * (t as f64 * DT / 7.0).sin()).collect();
    let blown = |boost: Option<&'_ [f64]>, map: &[f64], lambda: &[f64], f: &Fuelling| {
        let r = TransientRecord { boost_kpa: boost, map_kpa: map, lambda, ..view(&plain) };
        let p = pressure(&r, f);
        let phi = richness(&r, f, &p);
        (shown(&r, f), phi.iter().map(|v| 1.0 / v).collect::<Vec<f64>>())
    };
    let (map, lambda) = blown(Some(&boost), &plain[3], &plain[4], &truth);
    let r = TransientRecord { boost_kpa: Some(&boost), map_kpa: &map, lambda: &lambda, ..view(&plain) };
    let found = identify(&[r], &|| false).unwrap();
    // A still pressure above all that was measured explains less, or nothing at all.
    let still = TransientRecord { upstream_kpa: 130.0, boost_kpa: None, ..r };
    let blind_kpa = identify(&[still], &|| false).map_or(f64::INFINITY, |f| f.pressure_rms_kpa);
    assert!(found.pressure_rms_kpa < 0.3 * blind_kpa, "{} {blind_kpa}", found.pressure_rms_kpa);
    assert!((found.filling.gain / truth.filling.gain - 1.0).abs() < 0.03, "{}", found.filling.gain);
    // Half as much before a choked throttle is half the flow.
    let flow = |upstream| found.filling.inflow(12.0, 20.0, upstream);
    assert!((flow(60.0) / flow(120.0) - 0.5).abs() < 1e-12);
}

/// Without a film a model of a record that has one is worse, and says that nothing wets the wall.
#[test]
fn a_model_without_a_film_is_one() {
    let truth = truth();
    let channels = record(&truth, 40);
    let (with, without) = (
        identify(&[view(&channels)], &|| false).unwrap(),
        identify_without_film(&[view(&channels)], &|| false).unwrap(),
    );
    assert_eq!(without.film.share, 0.0);
    assert!(without.rms > 3.0 * with.rms, "{} {}", without.rms, with.rms);
    let dry = Fuelling { film: Film { share: 0.0, tau_s: 1.0 }, ..truth };
    let channels = record(&dry, 40);
    let found = identify_without_film(&[view(&channels)], &|| false).unwrap();
    assert!(found.rms < 1e-3, "{}", found.rms);
    // What it would show of another record of the same engine is what was measured there.
    let other = heated(&dry, 10, 11, None);
    let phi = found.shown(&view(&other)).unwrap();
    let worst = phi.iter().zip(&other[4]).skip(50).map(|(phi, l)| (phi * l - 1.0).abs()).fold(0.0, f64::max);
    assert!(worst < 2e-2, "{worst}");
}

/// Film and charge over the coolant, from three records that heat up.
#[test]
fn records_at_several_temperatures_give_the_law_of_the_coolant_back() {
    let truth = Fuelling { coolant: Some(law()), ..truth() };
    let starts_c = [20.0, 55.0, 90.0];
    let channels: Vec<Channels> =
        (7..).zip(starts_c).map(|(seed, c)| heated(&truth, 25, seed, Some(c))).collect();
    let heat: Vec<Vec<f64>> = starts_c.iter().zip(&channels).map(|(c, r)| coolant(*c, r[0].len())).collect();
    let views: Vec<TransientRecord<'_>> =
        channels.iter().zip(&heat).map(|(c, h)| TransientRecord { coolant_c: Some(h), ..view(c) }).collect();
    let found = identify(&views, &|| false).unwrap();
    for c in [25.0, 60.0, 100.0] {
        let (film, planted) = (found.film_at(c), truth.film_at(c));
        assert!((film.share / planted.share - 1.0).abs() < 0.05, "{c} degC: {film:?}, planted {planted:?}");
        assert!((film.tau_s / planted.tau_s - 1.0).abs() < 0.05, "{c} degC: {film:?}, planted {planted:?}");
        let (air, is) = (found.air(c, None).at(1800.0, 50.0), truth.air(c, None).at(1800.0, 50.0));
        assert!((air / is - 1.0).abs() < 3e-3, "{c} degC: {air}, planted {is}");
    }
    // And what it is less in the heat, also to the ends of speed and pressure.
    for (n, p) in [(1800.0, 50.0), (2600.0, 38.0), (1400.0, 60.0)] {
        let hot = |f: &Fuelling| f.air(100.0, None).at(n, p) / f.air(25.0, None).at(n, p);
        assert!(
            (hot(&found) / hot(&truth) - 1.0).abs() < 1e-2,
            "{n} rpm, {p} kPa: {}, {}",
            hot(&found),
            hot(&truth)
        );
    }
    // Without the temperatures the same records are one engine that cannot be: the error says so.
    let blind: Vec<TransientRecord<'_>> =
        views.iter().map(|r| TransientRecord { coolant_c: None, ..*r }).collect();
    let one = identify(&blind, &|| false).unwrap();
    assert!(one.coolant.is_none() && one.rms > 5.0 * found.rms, "{} {}", one.rms, found.rms);
    let mixed = [views[0], blind[1]];
    let e = identify(&mixed, &|| false).unwrap_err().to_string();
    assert!(e.starts_with("record 2 has") && e.contains("without coolant"), "{e}");
}

/// A cut dries the wall by exp(-t / tau), and the first injection after it gives the wall what it has lost: policy and ECU.
#[test]
fn a_cut_leaves_the_wall_dry() {
    use crate::fuelling::{SpeedDensity, SpeedDensityState};
    let f = truth();
    let (speed_rpm, map_kpa, throttle_deg) = (2000.0, 50.0, 15.0);
    let y = sensed(speed_rpm, throttle_deg, map_kpa, None);
    let wanted = f.charge.at(speed_rpm, map_kpa);
    let ecu = SpeedDensity {
        sample_time_s: DT,
        charge: f.charge.clone(),
        law: None,
        most_kpa: 100.0,
        ahead_s: 0.0,
        film: Some(f.coat()),
        feedback: None,
    };
    for cut in [10, 40, 400] {
        let left = (-cut as f64 * DT / f.film.tau_s).exp();
        let expected = wanted * (1.0 - f.film.share * left) / (1.0 - f.film.share);
        let mut state = SpeedDensityState::new(ecu.clone(), 60.0);
        assert!((state.step(&y, 1.0) - wanted).abs() < 1e-9);
        (0..cut).for_each(|_| state.cut(&y));
        let first = state.step(&y, 1.0);
        assert!((first - expected).abs() < 1e-9, "{cut}: {first} {expected}");
        // The policy's pressure is its own: by its own next injection at rest.
        let mut policy = FuelPolicy::new(f.clone(), 60.0);
        let mut still = FuelPolicy::new(f.clone(), 60.0);
        policy.step(&y, 1.0);
        still.step(&y, 1.0);
        for _ in 0..cut {
            policy.cut(&y);
            still.step(&y, 1.0);
        }
        let (first, rest) = (policy.step(&y, 1.0), still.step(&y, 1.0));
        let expected = (1.0 - f.film.share * left) / (1.0 - f.film.share);
        assert!((first / rest - expected).abs() < 0.02, "{cut}: {first} over {rest}, expected {expected}");
    }
}

/// A throttle that is slower than its lag on large steps: the pressure says lag and rate; where nothing limits it, it says so.
#[test]
fn a_record_gives_the_rate_of_the_throttle_back() {
    let of = |rate: Option<f64>| {
        let mut truth = truth();
        truth.filling.throttle_rate_deg_s = rate;
        let mut channels = record(&truth, 40);
        let mut rng = Rng64::stream(23, 0);
        channels[3].iter_mut().for_each(|map| *map += 0.1 * rng.normal());
        let records = [view(&channels)];
        let rested = rested(&records, &[]).unwrap();
        filled(&records, &rested, started(&records, &rested).unwrap(), &|| false).unwrap().filling
    };
    let found = of(Some(90.0));
    let rate = found.throttle_rate_deg_s.expect("a rate");
    assert!((rate / 90.0 - 1.0).abs() < 0.1, "{rate}");
    assert!((found.throttle_lag_s / 0.06 - 1.0).abs() < 0.2, "{}", found.throttle_lag_s);
    assert_eq!(of(None).throttle_rate_deg_s, None);
}

/// Pressure before a throttle that is wide open rises by 60 kPa/s: the fuel goes with what it will be when its air comes.
#[test]
fn the_policy_goes_on_with_the_pressure_before_the_throttle() {
    let mut truth = truth();
    truth.film.share = 0.0;
    let mut policy = FuelPolicy::new(truth.clone(), 60.0);
    let (speed, n) = (2000.0, 200);
    let boost: Vec<f64> = (0..n).map(|t| 70.0 + 0.6 * (t as f64 - 100.0).clamp(0.0, 60.0)).collect();
    let (throttle, speeds, zeros) = (vec![40.0; n], vec![speed; n], vec![0.0; n]);
    let r = TransientRecord {
        sample_time_s: DT,
        speed_rpm: &speeds,
        throttle_deg: &throttle,
        injection: &zeros,
        map_kpa: &vec![69.0; n],
        lambda: &vec![1.0; n],
        upstream_kpa: 101.325,
        boost_kpa: Some(&boost),
        coolant_c: None,
        cams_deg: None,
    };
    let p = pressure(&r, &truth);
    let ahead = truth.timing.ahead_s(speed) / DT;
    let injection = |t: usize, policy: &mut FuelPolicy| {
        let upstream_kpa = Some(boost[t.saturating_sub(1)]);
        policy.step(&Sensed { upstream_kpa, ..sensed(speed, 40.0, 69.0, None) }, 1.0)
    };
    let given: Vec<f64> = (0..n).map(|t| injection(t, &mut policy)).collect();
    // While it rises, from when the slope is known.
    let (mut off, mut held) = (0.0_f64, 0.0_f64);
    for t in 110..150 {
        let met = t as f64 + ahead;
        let then = p[met as usize] + met.fract() * (p[met as usize + 1] - p[met as usize]);
        let wanted = truth.charge.at(speed, then);
        off = off.max((given[t] / wanted - 1.0).abs());
        held = held.max((truth.charge.at(speed, p[t]) / wanted - 1.0).abs());
    }
    assert!(off < 0.25 * held && held > 0.02, "{off}, held {held}");
}

/// A record with a sensor that scatters by 0.3 %.
fn scattered(mut channels: Channels) -> Channels {
    let mut rng = Rng64::stream(17, 0);
    channels[4].iter_mut().for_each(|lambda| *lambda *= 1.0 + 3e-3 * rng.normal());
    channels
}

/// Where nothing wets the wall no film is delivered, where something does one is, and its inverse is stable.
#[test]
fn a_film_is_kept_only_where_it_pays() {
    let wet = truth();
    let dry = Fuelling { film: Film { share: 0.0, tau_s: 1.0 }, ..wet.clone() };
    let of = |f: &Fuelling| identify(&[view(&scattered(record(f, 40)))], &|| false).unwrap();
    let found = of(&wet);
    assert!((found.film.share / wet.film.share - 1.0).abs() < 0.1, "{:?}", found.film);
    assert!((0.0..1.0).contains(&found.film.inverse_pole(DT)), "{}", found.film.inverse_pole(DT));
    assert_eq!(of(&dry).film.share, 0.0);
}

/// Derivatives by the coefficients of the charge beside central differences, through film, delay by the flow and lag.
#[test]
fn slopes_of_the_mixture_are_those_of_differences() {
    slopes_are_those_of_differences(&truth(), None);
    slopes_are_those_of_differences(&Fuelling { coolant: Some(law()), ..truth() }, Some(40.0));
}

fn slopes_are_those_of_differences(truth: &Fuelling, start_c: Option<f64>) {
    let channels = heated(truth, 10, 3, start_c);
    let heat = coolant(start_c.unwrap_or(90.0), channels[0].len());
    let r = TransientRecord { coolant_c: start_c.map(|_| heat.as_slice()), ..view(&channels) };
    let p = pressure(&r, truth);
    let at = |k: usize, h: f64| {
        let mut f = truth.clone();
        f.charge.coefficients[k] += h;
        richness(&r, &f, &p)
    };
    let mut slopes = Vec::new();
    let shown = richness(&r, truth, &p);
    follow::richness_slopes(&r, truth, &p, &mut |t, phi, by| {
        assert!((phi / shown[t] - 1.0).abs() < 1e-12, "{t}");
        slopes.push(*by);
    });
    const H: f64 = 1e-6;
    for k in 0..slopes[0].len() {
        let (up, down) = (at(k, H), at(k, -H));
        let scale = slopes.iter().map(|s| s[k].abs()).fold(0.0, f64::max);
        let off: Vec<f64> = slopes
            .iter()
            .zip(up.iter().zip(&down))
            .map(|(s, (u, d))| ((u - d) / (2.0 * H) - s[k]).abs())
            .collect();
        // Where the delay ends on a sample the two sides differ.
        let beyond = off.iter().filter(|o| **o > 1e-5 * scale).count();
        assert!(beyond * 500 < off.len(), "coefficient {k}: {beyond} of {} differ", off.len());
    }
}

/// Nothing tells the size of a film that is not there: its share keeps a least, and a search begins from there again.
#[test]
fn a_film_that_is_not_there_has_a_least_share() {
    let truth = truth();
    let dry = Fuelling { film: Film { share: 0.0, ..truth.film }, ..truth.clone() };
    let channels = record(&dry, 20);
    let records = [view(&channels)];
    let begun = Fuelling { film: Film { share: 2.0 * LEAST_SHARE, ..truth.film }, ..truth };
    let found = mixed(alone(&records), &begun, &begun, Effort::Compared, &|| false).unwrap();
    assert!((LEAST_SHARE..0.02).contains(&found.film.share), "{:?}", found.film);
    let again = mixed(alone(&records), &begun, &found, Effort::Compared, &|| false).unwrap();
    assert!(again.rms <= found.rms * 1.001, "{} {}", again.rms, found.rms);
}
