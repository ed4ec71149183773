//! What a model remembers of its records is known again wherever it stands, and nothing else is.

use dynocal_ident::data::{Channel, Dataset, Role};
use dynocal_ident::stored::pieces::{KEPT, Pieces};
use dynocal_numerics::rng::Rng64;

/// A record of two channels that nobody else has.
fn record(n: usize, seed: u64) -> Dataset {
    let mut rng = Rng64::new(seed);
    let mut draw = || rng.uniform();
    let mut channel = |name: &str, role| Channel {
        name: name.into(),
        unit: "-".into(),
        role,
        values: (0..n).map(|_| draw()).collect(),
    };
    let channels = vec![channel("u", Role::Input), channel("y", Role::Output)];
    Dataset { name: "r".into(), sample_time_s: 0.1, channels, init_samples: 0, origin: String::new() }
}

fn names() -> Vec<String> {
    ["u", "y"].map(String::from).to_vec()
}

#[test]
fn what_is_the_same_record_is_known() {
    let whole = record(5000, 1);
    let known = Pieces::of(&[&whole], &names(), false).unwrap();
    let share = |d: &Dataset| known.share(d, &names(), false).unwrap();
    assert_eq!(share(&whole), 1.0);
    // Channels in another order, one beside them, another sample time, one sample missing, another zero.
    let mut other = whole.clone();
    other.channels.reverse();
    other.channels.push(Channel { name: "z".into(), ..whole.channels[0].clone() });
    other.sample_time_s += 1e-16;
    other.channels[1].values[70] = f64::NAN;
    assert!(share(&other) > 0.95, "{}", share(&other));
    let zero = |z: f64| {
        let mut d = record(100, 2);
        d.channels[0].values[3] = z;
        Pieces::of(&[&d], &names(), false).unwrap()
    };
    assert_eq!(zero(0.0), zero(-0.0));
    // In single precision.
    let mut single = whole.clone();
    single.channels.iter_mut().flat_map(|c| &mut c.values).for_each(|v| *v = f64::from(*v as f32));
    assert_eq!(share(&single), 1.0);
}

#[test]
fn parts_and_what_is_around_are_known_by_their_share() {
    let whole = record(20_000, 3);
    let known = |d: &Dataset| Pieces::of(&[d], &names(), false).unwrap();
    // Of a model of the first quarter the whole record has a quarter: sqrt(0.25 0.75 / 512) is 0.02, five of which are allowed.
    let quarter = whole.part(0, 5000, "quarter".into());
    let around = known(&quarter).share(&whole, &names(), false).unwrap();
    assert!((around - 0.25).abs() < 0.1, "{around}");
    // Of a model of the whole a tenth is all known; so is nothing of the rest by a model of the quarter.
    assert_eq!(known(&whole).share(&whole.part(7000, 9000, "tenth".into()), &names(), false).unwrap(), 1.0);
    assert!(!known(&quarter).know(&whole.part(5000, 20_000, "rest".into()), &names(), false));
    assert!(!known(&whole).know(&record(20_000, 4), &names(), false));
}

#[test]
fn rows_of_points_in_any_order() {
    let points = record(60, 5);
    let known = Pieces::of(&[&points], &names(), true).unwrap();
    let mut turned = points.clone();
    turned.channels.iter_mut().for_each(|c| c.values.reverse());
    assert_eq!(known.share(&turned, &names(), true).unwrap(), 1.0);
    assert_eq!(known.share(&record(60, 6), &names(), true).unwrap(), 0.0);
}

#[test]
fn rest_is_nobodys() {
    let mut a = record(100, 7);
    a.channels.iter_mut().for_each(|c| c.values[..60].fill(0.0));
    let mut b = record(100, 8);
    b.channels.iter_mut().for_each(|c| c.values[..60].fill(0.0));
    assert_eq!(Pieces::of(&[&a], &names(), false).unwrap().share(&b, &names(), false).unwrap(), 0.0);
}

#[test]
fn as_text_and_back() {
    let known = Pieces::of(&[&record(500, 9)], &names(), false).unwrap();
    let text = String::from(known.clone());
    assert_eq!((text.len(), Pieces::try_from(text)), (16 * KEPT, Ok(known)));
    for wrong in ["0", "g000000000000000", "é00000000000000"] {
        assert!(Pieces::try_from(wrong.to_string()).is_err(), "{wrong}");
    }
}
