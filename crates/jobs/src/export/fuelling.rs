//! Identified fuelling as tables: charge, throttle, film over the coolant, and the numbers of time.

use dynocal_export::characteristic::{Axis, Characteristic};
use dynocal_export::package::{Package, Provenance, ValidRange};

use super::Made;
use crate::fuelling::store::throttle;
use crate::fuelling::stored::StoredFuelling;

fn axis(name: &str, unit: &str, input: &str, points: &[f64]) -> Axis {
    Axis {
        name: format!("{name}_AXIS"),
        description: format!("{input} of identified fuelling"),
        unit: unit.into(),
        input: input.into(),
        points: points.to_vec(),
        shared: true,
    }
}

fn table(name: &str, what: &str, unit: &str, axes: Vec<Axis>, values: Vec<f64>) -> Characteristic {
    Characteristic {
        name: name.into(),
        description: what.into(),
        unit: unit.into(),
        axes,
        values,
        limits: None,
    }
}

/// Tables and scalars.
pub(super) fn fuelling(stored: &StoredFuelling) -> Made {
    let (f, unit, t) = (&stored.fuelling, stored.injection_unit.as_str(), &stored.tables);
    let speed = axis("FUEL_SPEED", "rpm", "speed", &t.speed_rpm);
    let map = axis("FUEL_MAP", "kPa", "map", &t.map_kpa);
    let (angles, flows): (Vec<f64>, Vec<f64>) =
        throttle(f, &stored.seen).iter().map(|r| (r[0], r[1])).unzip();
    let angle = axis("FUEL_THROTTLE", "deg", "throttle", &angles);
    let per_s = format!("{unit}/s");
    let mut all = vec![
        table(
            "FUEL_CHARGE",
            "fuel per cycle and cylinder that makes lambda 1",
            unit,
            vec![speed, map],
            stored.charge(),
        ),
        table(
            "FUEL_THROTTLE_FLOW",
            "choked flow of the throttle as fuel at lambda 1 per cylinder",
            &per_s,
            vec![angle],
            flows,
        ),
    ];
    if f.coolant.is_some() && !t.coolant_c.is_empty() {
        let coolant = || vec![axis("FUEL_COOLANT", "degC", "coolant", &t.coolant_c)];
        let film: Vec<_> = t.coolant_c.iter().map(|c| f.film_at(*c)).collect();
        let factor = t.coolant_c.iter().map(|c| f.air(*c, None).factor).collect();
        all.push(table(
            "FILM_SHARE",
            "share of the fuel that wets the wall",
            "-",
            coolant(),
            film.iter().map(|x| x.share).collect(),
        ));
        all.push(table(
            "FILM_TAU",
            "time constant of its evaporation",
            "s",
            coolant(),
            film.iter().map(|x| x.tau_s).collect(),
        ));
        all.push(table("FUEL_CHARGE_FACTOR", "what the coolant makes of the charge", "-", coolant(), factor));
    } else {
        all.push(table(
            "FILM_SHARE",
            "share of the fuel that wets the wall",
            "-",
            vec![],
            vec![f.film.share],
        ));
        all.push(table("FILM_TAU", "time constant of its evaporation", "s", vec![], vec![f.film.tau_s]));
    }
    let scalars = [
        ("FUEL_AHEAD", "from injection to the pressure that counts, constant part", "s", f.timing.charge_s),
        ("FUEL_AHEAD_CYCLES", "the part that goes with the cycle, in cycles", "-", f.timing.charge_cycles),
        ("LAMBDA_CYCLES", "transport to the lambda sensor, in cycles", "-", f.timing.transport_cycles),
        ("LAMBDA_VOLUME", "transport through volumes, as fuel at lambda 1", unit, f.timing.transport_fuel),
        ("LAMBDA_LAG", "lag of mixing and lambda sensor", "s", f.timing.sensor_lag_s),
        ("THROTTLE_LAG", "lag of the throttle", "s", f.filling.throttle_lag_s),
        (
            "MAP_GAIN",
            "manifold pressure per fuel that its charge is worth",
            &format!("kPa/{unit}"),
            f.filling.gain,
        ),
        (
            "MAP_CORRECTION",
            "correction of the manifold by the measured pressure",
            "1/s",
            f.filling.correction_per_s,
        ),
    ];
    all.extend(scalars.iter().map(|(name, what, unit, v)| table(name, what, unit, vec![], vec![*v])));
    // Without a limit there is no number for it.
    let rate = f.filling.throttle_rate_deg_s;
    all.extend(
        rate.map(|v| table("THROTTLE_RATE", "greatest rate of the throttle", "deg/s", vec![], vec![v])),
    );
    let range = |channel: &str, unit: &str, [lower, upper]: [f64; 2]| ValidRange {
        channel: channel.into(),
        unit: unit.into(),
        lower,
        upper,
    };
    let validity = vec![
        range("speed", "rpm", stored.seen.speed_rpm),
        range("map", "kPa", stored.seen.map_kpa),
        range("throttle", "deg", stored.seen.throttle_deg),
    ];
    let lost = match stored.loss() {
        Some(loss) => format!("{} %", dynocal_report::significant(100.0 * loss, 3)),
        None => "an unknown share: the charge is not positive everywhere on its axes".into(),
    };
    Made {
        package: Package {
            name: "fuelling".into(),
            description: "Fuel by measured states".into(),
            provenance: Provenance { validity, ..Default::default() },
            characteristics: all,
            ..Default::default()
        },
        notes: vec![format!(
            "fuelling: interpolation in FUEL_CHARGE loses at most {lost} of the identified charge"
        )],
    }
}
