//! Channels and regions of a spec.

use std::path::Path;

use dynocal_design::channel::limits::Region;
use dynocal_design::channel::{Channel, Shape};
use dynocal_files::spec::Faults;

use super::PlanChannel;
use super::typed::{TypedChannel, TypedRegion};

/// All channels that are whole; faults of the others are noted.
pub(crate) fn channels(
    typed: &[TypedChannel],
    dt_s: f64,
    folder: &Path,
    faults: &mut Faults,
) -> Vec<PlanChannel> {
    let mut out: Vec<PlanChannel> = Vec::new();
    for (k, t) in typed.iter().enumerate() {
        let key = |name: &str| format!("channels[{}].{name}", k + 1);
        let name = faults.required(&key("name"), &t.name, "the name that the models use");
        let unit = faults.required(&key("unit"), &t.unit, "a unit, `-` for none");
        let (Some(name), Some(unit)) = (name, unit) else { continue };
        if out.iter().any(|c| c.channel.name == name) {
            faults.push(&key("name"), format!("`{name}` twice"), "each channel once");
            continue;
        }
        if let Some(file) = &t.file {
            given_alone(t, &key, faults);
            let channel = Channel::given(&name, Vec::new());
            out.push(PlanChannel { channel, unit, file: Some(folder.join(file)) });
            continue;
        }
        let lower = faults.required(&key("lower"), &t.lower, &format!("least value, {unit}"));
        let upper = faults.required(&key("upper"), &t.upper, &format!("largest value, {unit}"));
        let (Some(lower), Some(upper)) = (lower, upper) else { continue };
        let hold = hold(t.hold_s, dt_s, &key("hold_s"), faults);
        if let Some(r) = t.rate_per_s {
            faults.positive(&key("rate_per_s"), r, &format!("{unit}/s"));
        }
        let channel = Channel {
            hold,
            shape: t.shape.unwrap_or(Shape::Hold),
            rate_per_sample: t.rate_per_s.map(|r| r * dt_s),
            before: t.before,
            start: t.start,
            end: t.end,
            levels: t.levels.clone().unwrap_or_default(),
            ..Channel::free(&name, lower, upper)
        };
        out.push(PlanChannel { channel, unit, file: None });
    }
    out
}

/// Limits of a channel that is not designed would be idle.
fn given_alone(t: &TypedChannel, key: &dyn Fn(&str) -> String, faults: &mut Faults) {
    let idle = [
        ("lower", t.lower.is_some()),
        ("upper", t.upper.is_some()),
        ("hold_s", t.hold_s.is_some()),
        ("shape", t.shape.is_some()),
        ("rate_per_s", t.rate_per_s.is_some()),
        ("before", t.before.is_some()),
        ("start", t.start.is_some()),
        ("end", t.end.is_some()),
        ("levels", t.levels.is_some()),
    ];
    for (name, _) in idle.iter().filter(|i| i.1) {
        faults.push(
            &key(name),
            "a limit beside `file`",
            "one of them: a channel from a file is not designed",
        );
    }
}

fn hold(hold_s: Option<f64>, dt_s: f64, key: &str, faults: &mut Faults) -> usize {
    let Some(hold_s) = hold_s else { return 1 };
    let samples = (hold_s / dt_s).round();
    if !(1.0..=1e9).contains(&samples) {
        faults.push(key, hold_s, format!("a time of at least one sample of {dt_s} s"));
        return 1;
    }
    samples as usize
}

/// Adds the regions to the first channel that each names.
pub(super) fn regions(typed: &[TypedRegion], channels: &mut [PlanChannel], faults: &mut Faults) {
    let known: Vec<String> = channels.iter().map(|c| c.channel.name.clone()).collect();
    for (k, t) in typed.iter().enumerate() {
        let key = format!("regions[{}]", k + 1);
        for region in region(t, k, &key, faults) {
            let unknown: Vec<String> = region
                .channels()
                .iter()
                .filter(|n| !known.iter().any(|c| c == *n))
                .map(|n| (*n).into())
                .collect();
            unknown.iter().for_each(|n| faults.unknown(&key, n, &known));
            let first = region.channels().first().map(ToString::to_string);
            let owner = channels.iter_mut().find(|c| Some(&c.channel.name) == first.as_ref());
            if let (Some(owner), true) = (owner, unknown.is_empty()) {
                owner.channel.regions.push(region);
            }
        }
    }
}

fn region(t: &TypedRegion, k: usize, key: &str, faults: &mut Faults) -> Vec<Region> {
    let name = t.name.clone().unwrap_or_else(|| format!("region {}", k + 1));
    let given = [t.outside.is_some(), t.inside.is_some(), t.forbidden.is_some(), t.sum.is_some()];
    if given.iter().filter(|g| **g).count() != 1 {
        faults.push(
            key,
            format!("{} of the keys inside, outside, forbidden, sum", given.iter().filter(|g| **g).count()),
            "one of them",
        );
        return Vec::new();
    }
    if let Some(sum) = &t.sum {
        let side = |sign: f64, bound: f64| Region::AtMost {
            name: name.clone(),
            coefficients: sum.iter().map(|(n, c)| (n.clone(), sign * c)).collect(),
            bound: sign * bound,
        };
        if t.at_most.is_none() && t.at_least.is_none() {
            faults.push(&format!("{key}.at_most"), "nothing", "at_most, at_least or both beside `sum`");
        }
        return t
            .at_most
            .map(|b| side(1.0, b))
            .into_iter()
            .chain(t.at_least.map(|b| side(-1.0, b)))
            .collect();
    }
    if let Some(sides) = &t.forbidden {
        let sides: Vec<(&String, &[f64; 2])> = sides.iter().collect();
        let [(a, a_range), (b, b_range)] = sides[..] else {
            faults.push(
                &format!("{key}.forbidden"),
                format!("{} channels", sides.len()),
                "two, with their ranges",
            );
            return Vec::new();
        };
        return vec![Region::forbidden_box(&name, (a, *a_range), (b, *b_range))];
    }
    let expected = "two names, the first along the first coordinate of the corners";
    let Some((a, b)) = faults.required(&format!("{key}.channels"), &t.channels, expected) else {
        return Vec::new();
    };
    let channels = [a, b];
    match (&t.inside, &t.outside) {
        (Some(corners), _) => vec![Region::Inside { name, channels, corners: corners.clone() }],
        (_, Some(corners)) => vec![Region::Outside { name, channels, corners: corners.clone() }],
        _ => Vec::new(),
    }
}
