//! Identified fuelling as tables: charge, throttle, film over the coolant, and the numbers of time.

use dynocal_export::characteristic::{Axis, Characteristic};
use dynocal_export::package::{Package, Provenance, ValidRange};

use super::Made;
use crate::fuelling::store::throttle;
use crate::fuelling::stored::StoredFuelling;
use dynocal_calib::fuelling::Film;

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

/// Names of the cams in tables, and as channels.
const CAMS: [(&str, &str); 2] = [("INTAKE", "intake_cam"), ("EXHAUST", "exhaust_cam")];

/// What cams do to the charge: it is multiplied by exp of the sum over both of (slope + curve x) x, and of the product of both times
/// `FUEL_CAMS_BOTH`, with x the distance of a cam from its rest, within its largest distance.
fn cams(stored: &StoredFuelling) -> Vec<Characteristic> {
    let (charge, t) = (&stored.fuelling.charge, &stored.tables);
    let Some(law) = &charge.cams else { return Vec::new() };
    let over = |what: usize, k: usize| -> Vec<f64> {
        let at = |n: f64, p: f64| charge.cams_at(n, p).map_or(f64::NAN, |c| c[what][k]);
        t.map_kpa.iter().flat_map(|p| t.speed_rpm.iter().map(move |n| at(*n, *p))).collect()
    };
    let axes =
        || vec![axis("FUEL_SPEED", "rpm", "speed", &t.speed_rpm), axis("FUEL_MAP", "kPa", "map", &t.map_kpa)];
    let bends = law.bends.clone().unwrap_or_default();
    let mut all = Vec::new();
    for (k, (name, channel)) in CAMS.iter().enumerate() {
        let of = |what: &str| format!("{channel}: {what}");
        let named = |what: &str| format!("FUEL_CAM_{name}_{what}");
        all.push(table(&named("REST"), &of("where it rests"), "deg", axes(), over(0, k)));
        all.push(table(
            &named("SLOPE"),
            &of("logarithm of the charge for a degree"),
            "1/deg",
            axes(),
            over(1, k),
        ));
        all.push(table(
            &named("CURVE"),
            &of("the same for a degree squared"),
            "1/deg^2",
            vec![],
            vec![bends.per_deg2[k]],
        ));
        all.push(table(
            &named("MOST"),
            &of("largest distance from rest that counts"),
            "deg",
            vec![],
            vec![law.most_deg[k]],
        ));
    }
    let what = "logarithm of the charge for the product of both distances";
    all.push(table("FUEL_CAMS_BOTH", what, "1/deg^2", vec![], vec![bends.both]));
    all
}

/// What speed and pressure make of the film: X / (1 - X) and tau are those of `FILM_SHARE` and `FILM_TAU` times these. At their breakpoints the model itself.
fn film_ends(stored: &StoredFuelling) -> Vec<Characteristic> {
    let (f, t) = (&stored.fuelling, &stored.tables);
    let Some(ends) = f.film_ends else { return Vec::new() };
    let even = Film { share: 0.5, tau_s: 1.0 };
    let over = |of: fn(Film) -> f64| -> Vec<f64> {
        let row = |p: &f64| t.speed_rpm.iter().map(|n| of(ends.film(even, *n, *p))).collect::<Vec<_>>();
        t.map_kpa.iter().flat_map(row).collect()
    };
    let axes =
        || vec![axis("FUEL_SPEED", "rpm", "speed", &t.speed_rpm), axis("FUEL_MAP", "kPa", "map", &t.map_kpa)];
    let odds = "factor on FILM_SHARE / (1 - FILM_SHARE)";
    vec![
        table("FILM_ODDS_FACTOR", odds, "-", axes(), over(|x| x.share / (1.0 - x.share))),
        table("FILM_TAU_FACTOR", "factor on FILM_TAU", "-", axes(), over(|x| x.tau_s)),
    ]
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
    let middle = match f.film_ends {
        Some(_) => ", in the middle of speed and pressure: see FILM_ODDS_FACTOR and FILM_TAU_FACTOR",
        None => "",
    };
    if f.coolant.is_some() && !t.coolant_c.is_empty() {
        let coolant = || vec![axis("FUEL_COOLANT", "degC", "coolant", &t.coolant_c)];
        let film: Vec<_> = t.coolant_c.iter().map(|c| f.film_at(*c)).collect();
        let factor = t.coolant_c.iter().map(|c| f.air(*c, None).factor).collect();
        all.push(table(
            "FILM_SHARE",
            &format!("share of the fuel that wets the wall{middle}"),
            "-",
            coolant(),
            film.iter().map(|x| x.share).collect(),
        ));
        all.push(table(
            "FILM_TAU",
            &format!("time constant of its evaporation{middle}"),
            "s",
            coolant(),
            film.iter().map(|x| x.tau_s).collect(),
        ));
        all.push(table("FUEL_CHARGE_FACTOR", "what the coolant makes of the charge", "-", coolant(), factor));
        let ends = |k: usize, half: f64| t.coolant_c.iter().map(|c| f.air(*c, None).ends[k] / half).collect();
        let [middle_rpm, half_rpm] = f.charge.speed_rpm;
        let [middle_kpa, half_kpa] = f.charge.pressure_kpa;
        // The charge is FUEL_CHARGE FUEL_CHARGE_FACTOR (1 + BY_SPEED (N - MIDDLE_RPM) + BY_MAP (p - MIDDLE_KPA)).
        let by_speed = "what a rpm above the middle adds to the factor of the coolant on the charge, over it";
        let by_map = "what a kPa above the middle adds to the factor of the coolant on the charge, over it";
        for (name, what, unit, axes, values) in [
            ("FUEL_COOLANT_BY_SPEED", by_speed, "1/rpm", coolant(), ends(0, half_rpm)),
            ("FUEL_COOLANT_BY_MAP", by_map, "1/kPa", coolant(), ends(1, half_kpa)),
            ("FUEL_COOLANT_MIDDLE_RPM", "speed at which that adds nothing", "rpm", vec![], vec![middle_rpm]),
            (
                "FUEL_COOLANT_MIDDLE_KPA",
                "pressure at which that adds nothing",
                "kPa",
                vec![],
                vec![middle_kpa],
            ),
        ] {
            all.push(table(name, what, unit, axes, values));
        }
    } else {
        all.push(table(
            "FILM_SHARE",
            &format!("share of the fuel that wets the wall{middle}"),
            "-",
            vec![],
            vec![f.film.share],
        ));
        let what = format!("time constant of its evaporation{middle}");
        all.push(table("FILM_TAU", &what, "s", vec![], vec![f.film.tau_s]));
    }
    all.extend(film_ends(stored));
    all.extend(cams(stored));
    let scalars = [
        ("FUEL_AHEAD", "from injection to the pressure that counts, constant part", "s", f.timing.charge_s),
        ("FUEL_AHEAD_CYCLES", "the part that goes with the cycle, in cycles", "-", f.timing.charge_cycles),
        ("LAMBDA_CYCLES", "transport to the lambda sensor, in cycles", "-", f.timing.transport_cycles),
        ("LAMBDA_VOLUME", "transport through volumes, as fuel at lambda 1", unit, f.timing.transport_fuel),
        (
            "LAMBDA_MIXING",
            "mixing in a volume, as fuel at lambda 1 in its time constant",
            unit,
            f.timing.mixing_fuel,
        ),
        ("LAMBDA_LAG", "lag of the lambda sensor", "s", f.timing.sensor_lag_s),
        ("THROTTLE_LAG", "lag of the throttle", "s", f.filling.throttle_lag_s),
        (
            "MAP_GAIN",
            "manifold pressure per fuel that its charge is worth",
            &format!("kPa/{unit}"),
            f.filling.gain,
        ),
        ("MAP_LAG", "lag of the pressure channel beside its mean over a cycle", "s", f.filling.sensor_lag_s),
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
    let mut validity = vec![
        range("speed", "rpm", stored.seen.speed_rpm),
        range("map", "kPa", stored.seen.map_kpa),
        range("throttle", "deg", stored.seen.throttle_deg),
    ];
    if let (Some(_), Some(ranges)) = (&f.charge.cams, &stored.seen.cams_deg) {
        validity.extend(CAMS.iter().zip(ranges).map(|((_, channel), r)| range(channel, "deg", *r)));
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuelling::stored::tests::stored;
    use dynocal_calib::fuelling::{CamBends, CamLaw, Charge, CoolantLaw, FilmEnds};

    /// What is said of the tables of the film gives what the model does, at a breakpoint; without ends there are none.
    #[test]
    fn tables_of_the_film_are_its_law() {
        let mut s = stored(|n, p| 1e-4 * n * p);
        assert!(!fuelling(&s).package.characteristics.iter().any(|c| c.name.ends_with("_FACTOR")));
        let Charge { speed_rpm, pressure_kpa, .. } = s.fuelling.charge;
        s.fuelling.film_ends =
            Some(FilmEnds { speed_rpm, pressure_kpa, share: [-0.2, 0.1], tau: [0.3, -0.1] });
        let made = fuelling(&s).package;
        let of = |name: &str| &made.characteristics.iter().find(|c| c.name == name).unwrap().values;
        let at = 2 * s.tables.speed_rpm.len() + 1;
        let share = of("FILM_SHARE")[0];
        let odds = share / (1.0 - share) * of("FILM_ODDS_FACTOR")[at];
        let truth = s.fuelling.film_of(90.0, s.tables.speed_rpm[1], s.tables.map_kpa[2]);
        assert!((odds / (1.0 + odds) / truth.share - 1.0).abs() < 1e-9, "{odds} {truth:?}");
        assert!(
            (of("FILM_TAU")[0] * of("FILM_TAU_FACTOR")[at] / truth.tau_s - 1.0).abs() < 1e-9,
            "{truth:?}"
        );
        assert!((truth.tau_s / s.fuelling.film.tau_s - 1.0).abs() > 1e-3, "{truth:?}");
    }

    /// What is said of the tables of the cams gives what the model does, at a breakpoint.
    #[test]
    fn tables_of_the_cams_are_the_law() {
        let mut s = stored(|n, p| 1e-4 * n * p);
        assert!(!fuelling(&s).package.characteristics.iter().any(|c| c.name.contains("CAM")));
        s.fuelling.charge.cams = Some(CamLaw {
            rest_deg: [vec![235.0, 4.0, -3.0, 0.5, 0.0, 0.0], vec![230.0, 0.0, 2.0, 0.0, 1.0, 0.0]],
            most_deg: [20.0, 18.0],
            per_deg: [-0.005, 0.002],
            per_deg_pressure: [0.002, 0.001],
            bends: Some(CamBends { per_deg_speed: [0.002, -0.001], per_deg2: [-2e-4, -1e-4], both: 1e-4 }),
        });
        s.seen.cams_deg = Some([[215.0, 255.0]; 2]);
        let made = fuelling(&s).package;
        let of = |name: &str| &made.characteristics.iter().find(|c| c.name == name).unwrap().values;
        // Breakpoint 1 of the speed, 2 of the pressure; speed fastest.
        let at = 2 * s.tables.speed_rpm.len() + 1;
        let cams = [222.0, 241.0];
        let mut log = 0.0;
        let mut off = [0.0; 2];
        for (k, name) in ["INTAKE", "EXHAUST"].iter().enumerate() {
            let table = |what: &str| of(&format!("FUEL_CAM_{name}_{what}"));
            let most = table("MOST")[0];
            let x = (cams[k] - table("REST")[at]).clamp(-most, most);
            log += (table("SLOPE")[at] + table("CURVE")[0] * x) * x;
            off[k] = x;
        }
        log += of("FUEL_CAMS_BOTH")[0] * off[0] * off[1];
        let truth = s.fuelling.charge.cam_factor(s.tables.speed_rpm[1], s.tables.map_kpa[2], Some(cams));
        assert!(
            (log.exp() / truth - 1.0).abs() < 1e-9 && (truth - 1.0).abs() > 0.01,
            "{} {truth}",
            log.exp()
        );
        assert!(made.provenance.validity.iter().any(|v| v.channel == "exhaust_cam"));
    }

    /// What is said of the coolant gives the charge of the model, at breakpoints.
    #[test]
    fn tables_of_the_coolant_are_the_law() {
        let mut s = stored(|n, p| 1e-4 * n * p);
        s.fuelling.coolant = Some(CoolantLaw {
            at_c: 60.0,
            range_c: [20.0, 90.0],
            share_per_k: -1e-3,
            tau_per_k: -0.02,
            charge_per_k: -4e-4,
            charge_ends_per_k: [3e-4, -5e-4],
        });
        s.tables.coolant_c = vec![20.0, 55.0, 90.0];
        let made = fuelling(&s).package;
        let of = |name: &str| &made.characteristics.iter().find(|c| c.name == name).unwrap().values;
        let (n, p) = (s.tables.speed_rpm[1], s.tables.map_kpa[2]);
        let by = of("FUEL_COOLANT_BY_SPEED")[0] * (n - of("FUEL_COOLANT_MIDDLE_RPM")[0])
            + of("FUEL_COOLANT_BY_MAP")[0] * (p - of("FUEL_COOLANT_MIDDLE_KPA")[0]);
        let told = of("FUEL_CHARGE_FACTOR")[0] * (1.0 + by);
        let truth = s.fuelling.air(20.0, None).at(n, p) / s.fuelling.charge.at(n, p);
        assert!((told / truth - 1.0).abs() < 1e-9 && (by.abs() > 1e-3), "{told} {truth} {by}");
    }
}
