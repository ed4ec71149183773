//! The player against recursions written out by hand, and against what a plan promises.

use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::{Plan, PlanChannel, PlanDemand, PlanLimit, PlanLoop};
use dynocal_ident::play::{Band, Interruptible, PlayError, Reason, UntilStill, Unwatched, play};

mod common;
use common::lag::Lag;

fn channel(values: Vec<f64>) -> PlanChannel {
    PlanChannel::free("u", "-", values)
}

fn demand(values: Vec<f64>) -> PlanDemand {
    PlanDemand { output: "y".into(), unit: "-".into(), values }
}

/// Row t: inputs applied from t on, outputs measured at t. Settling is not recorded.
#[test]
fn an_open_loop_record_is_the_recursion_row_by_row() {
    let u: Vec<f64> = (0..40).map(|t| ((t * t) % 7) as f64 - 2.5).collect();
    let plan = Plan::open_loop("a", 0.1, vec![channel(u.clone())]).settled(0.5);
    let played = play(&mut Lag::new(0.9, 0.2), &plan, &mut Unwatched).unwrap().whole().unwrap();
    let mut y = 0.0;
    for _ in 0..5 {
        y = 0.9 * y + 0.2 * u[0];
    }
    for (t, (got_u, got_y)) in
        played.record.values("u").unwrap().iter().zip(played.record.values("y").unwrap()).enumerate()
    {
        assert_eq!((*got_u, *got_y), (u[t], y), "row {t}");
        y = 0.9 * y + 0.2 * u[t];
    }
    assert_eq!((played.played, played.before, played.record.len()), (40, 5, 40));
    assert!((played.used_s - 4.5).abs() < 1e-12);
}

/// A second plan, unsettled, goes on where the first has left the plant: its first row holds what stands there, not the start
/// value, and the two records obey one recursion.
#[test]
fn a_plan_without_a_wait_begins_with_what_the_plant_shows() {
    let u: Vec<f64> = (0..30).map(|t| ((t * t) % 5) as f64 - 1.5).collect();
    let plan = Plan::open_loop("a", 0.1, vec![channel(u.clone())]);
    let mut plant = Lag::new(0.9, 0.2);
    let mut y = 0.0;
    for round in 0..3 {
        let record = play(&mut plant, &plan, &mut Unwatched).unwrap().whole().unwrap().record;
        for (t, got) in record.values("y").unwrap().iter().enumerate() {
            assert_eq!(*got, y, "round {round}, row {t}");
            y = 0.9 * y + 0.2 * u[t];
        }
    }
}

/// Loops, ranges and the record of demands, against the loop written out.
#[test]
fn a_closed_loop_is_the_pi_law_over_its_feedforward() {
    let n = 300;
    let feedforward: Vec<f64> = (0..n).map(|t| if t < 100 { 1.0 } else { 1.5 }).collect();
    let asked: Vec<f64> = (0..n).map(|t| if t < 150 { 2.0 } else { 9.0 }).collect();
    let gains = PiGains { ki: 0.4, kp: 0.3 };
    let plan = Plan::open_loop("a", 0.1, vec![channel(feedforward.clone()).within(-1.0, 3.0)])
        .with_loops(vec![demand(asked.clone())], vec![PlanLoop::closed("y", "u", gains)]);
    let record = play(&mut Lag::new(0.9, 0.2), &plan, &mut Unwatched).unwrap().record;
    let (u, y) = (record.values("u").unwrap(), record.values("y").unwrap());
    // One sample in open loop, because a loop needs a measured value.
    let (mut state, mut integral) = (0.2 * feedforward[0], 0.0f64);
    for t in 0..n {
        let e = asked[t] - state;
        integral += gains.ki * e * 0.1;
        let base = feedforward[t] + gains.kp * e;
        integral = integral.clamp(-1.0 - base, 3.0 - base);
        let expected = (base + integral).clamp(-1.0, 3.0);
        assert!((u[t] - expected).abs() < 1e-12 && (y[t] - state).abs() < 1e-12, "row {t}");
        state = 0.9 * state + 0.2 * u[t];
    }
    assert_eq!(record.values("y_demand").unwrap(), asked);
    // 9 needs u = 4.5, which the range does not give: y ends at 2 u = 6.
    assert!((y[n - 1] - 6.0).abs() < 1e-3 && (y[149] - 2.0).abs() < 0.2);
    // An open loop is carried along and does nothing.
    let mut open = plan.clone();
    open.loops[0].closed = false;
    let record = play(&mut Lag::new(0.9, 0.2), &open, &mut Unwatched).unwrap().record;
    assert_eq!(record.values("u").unwrap(), feedforward);
}

/// Gains that are scheduled are those gains: a schedule of twos is the loop with both gains twice as large, and one that changes is the law with
/// the gains of each sample, the integral going on as it is.
#[test]
fn a_schedule_multiplies_the_gains_of_each_sample() {
    let n = 60;
    let gains = PiGains { ki: 0.4, kp: 0.3 };
    let record = |gains: PiGains, schedule: Vec<f64>| {
        let one = PlanLoop { schedule, ..PlanLoop::closed("y", "u", gains) };
        let plan = Plan::open_loop("a", 0.1, vec![channel(vec![0.0; n])])
            .with_loops(vec![demand(vec![1.0; n])], vec![one]);
        play(&mut Lag::new(0.9, 0.2), &plan, &mut Unwatched).unwrap().record
    };
    let twice = PiGains { ki: 0.8, kp: 0.6 };
    assert_eq!(record(gains, vec![2.0; n]), record(twice, Vec::new()));
    let schedule: Vec<f64> = (0..n).map(|t| 1.0 + (t % 3) as f64).collect();
    let found = record(gains, schedule.clone());
    let (mut state, mut integral) = (0.0, 0.0);
    for (t, u) in found.values("u").unwrap().iter().enumerate() {
        let e = 1.0 - state;
        integral += schedule[t] * gains.ki * e * 0.1;
        let expected = schedule[t] * gains.kp * e + integral;
        assert!((u - expected).abs() < 1e-12, "row {t}");
        state = 0.9 * state + 0.2 * u;
    }
}

/// A rate limits what is applied, loop or not.
#[test]
fn rates_are_kept_by_feedforward_and_loops() {
    let steps: Vec<f64> = (0..200).map(|t| if (t / 50) % 2 == 0 { 0.0 } else { 2.0 }).collect();
    let limited = PlanChannel { rate_per_s: Some(1.0), ..channel(steps.clone()) };
    let open = Plan::open_loop("a", 0.1, vec![limited.clone()]);
    let record = play(&mut Lag::new(0.9, 0.2), &open, &mut Unwatched).unwrap().record;
    assert_eq!(record.values("u").unwrap(), limited.applied(0.1));
    let closed = Plan::open_loop("b", 0.1, vec![PlanChannel { values: vec![0.0; 200], ..limited }])
        .with_loops(vec![demand(steps)], vec![PlanLoop::closed("y", "u", PiGains { ki: 2.0, kp: 2.0 })]);
    let record = play(&mut Lag::new(0.9, 0.2), &closed, &mut Unwatched).unwrap().record;
    for w in record.values("u").unwrap().windows(2).chain(open.channels[0].applied(0.1).windows(2)) {
        assert!((w[1] - w[0]).abs() <= 0.1 + 1e-12);
    }
}

#[test]
fn faults_of_a_plan_and_what_the_plant_lacks_are_said_before_anything_is_played() {
    let mut lag = Lag::new(0.9, 0.2);
    let good = Plan::open_loop("a", 0.1, vec![channel(vec![1.0; 10])]);
    let wrong = Plan {
        sample_time_s: 0.0,
        settle_s: -1.0,
        channels: vec![
            PlanChannel { rate_per_s: Some(0.0), ..channel(vec![1.0, f64::NAN]).within(2.0, 1.0) },
            channel(vec![1.0; 3]),
        ],
        demands: vec![demand(vec![0.0; 2])],
        loops: vec![PlanLoop {
            schedule: vec![1.0, -1.0],
            ..PlanLoop::closed("z", "v", PiGains { ki: f64::INFINITY, kp: 0.0 })
        }],
        limits: vec![PlanLimit { margin: -1.0, ..PlanLimit::between("y", "-", 3.0, 2.0, 0.0) }],
        ..good.clone()
    };
    let Err(PlayError::Plan(faults)) = play(&mut lag, &wrong, &mut Unwatched) else { panic!() };
    let keys: Vec<&str> = faults.iter().map(|f| f.key.as_str()).collect();
    assert_eq!(
        keys,
        [
            "sample_time_s",
            "settle_s",
            "channels[0].values[1]",
            "channels[0].lower",
            "channels[0].rate_per_s",
            "channels[1].values",
            "loops[0].input",
            "loops[0].output",
            "loops[0].gains.ki",
            "loops[0].schedule",
            "limits[0].lower",
            "limits[0].margin",
            "channels[1].name"
        ]
    );
    let said = |plan: &Plan, lag: &mut Lag| play(lag, plan, &mut Unwatched).unwrap_err().to_string();
    let other = Plan::open_loop("a", 0.1, vec![PlanChannel::free("boost", "bar", vec![1.0])]);
    assert!(said(&other, &mut lag).contains("no Input `boost`; there are: u"));
    let unit = Plan::open_loop("a", 0.1, vec![PlanChannel::free("u", "bar", vec![1.0])]);
    assert_eq!(said(&unit, &mut lag), "plan `a`: `u` is in bar, the plant has it in -");
    assert!(said(&good.clone().recording(&["z"]), &mut lag).contains("no Output `z`"));
    assert_eq!(lag.steps, 0);
    // A refusal in the middle keeps what was recorded.
    let mut values = vec![1.0; 10];
    values[7] = 1e9;
    let played = play(&mut lag, &Plan::open_loop("a", 0.1, vec![channel(values)]), &mut Unwatched).unwrap();
    assert!(matches!(played.stop.as_ref().unwrap().reason, Reason::Refused(_)));
    assert_eq!((played.played, played.record.len(), played.way_back.is_none()), (7, 7, true));
    assert!(played.whole().unwrap_err().to_string().contains("before sample 7: the plant refused it"));
}

#[test]
fn a_plan_ends_when_the_needles_stand_still_or_the_user_asks() {
    let plan = Plan::open_loop("a", 0.1, vec![channel(vec![1.0; 1000])])
        .with_limits(vec![PlanLimit::between("y", "-", -1.0, 3.0, 0.0)]);
    let band = Band { output: "y".into(), value: 2.0, half_width: 0.02 };
    let mut still = UntilStill::new(vec![band.clone()], 5, 10);
    let played = play(&mut Lag::new(0.9, 0.2), &plan, &mut still).unwrap();
    // 2 - 2 0.9^k < 0.02 from k = 44 on: five samples inside, then ten.
    assert_eq!((played.played, still.reached()), (48 + 10, true));
    assert_eq!(played.stop.unwrap().reason, Reason::Still);
    let y = played.record.values("y").unwrap();
    assert!((2.0 - y[48..].iter().sum::<f64>() / 10.0).abs() < 0.02);
    // Measured at every instant, the last one included: 2 - 2 0.9^58 is nearer to 3 than to -1.
    let last = 2.0 - 2.0 * 0.9f64.powi(58);
    assert!((played.least_distance[0].distance - 1.0f64.min(3.0 - last)).abs() < 1e-12);

    let asked = std::cell::Cell::new(0);
    let interrupt = || {
        asked.set(asked.get() + 1);
        asked.get() > 30
    };
    let mut unwatched = Unwatched;
    let mut watchdog = Interruptible { interrupt: &interrupt, watchdog: &mut unwatched };
    let played = play(&mut Lag::new(0.9, 0.2), &plan, &mut watchdog).unwrap();
    assert_eq!((played.played, played.stop.unwrap().reason), (30, Reason::Interrupted));
    let unknown = UntilStill::new(vec![Band { output: "z".into(), ..band }], 5, 10);
    let error = play(&mut Lag::new(0.9, 0.2), &plan, &mut { unknown }).unwrap_err().to_string();
    assert!(error.contains("no such output; outputs are: y"), "{error}");
}
