//! The page of a drive.

use dynocal_plant::vehicle::Power;
use dynocal_report::{Axis, Block, Panel, Report, Section, TimePlot, XyPlot};

use super::work::thin;
use super::{Driven, Spec};

/// The page.
pub fn report(spec: &Spec, set: &str, found: &Driven) -> Report {
    let log = &found.log;
    let mut report = Report::new(format!("Drive cycle {}", spec.name))
        .subtitle(format!("Virtual engine, parameter set {set}, in the car of thesis Table 3.3"));
    if found.interrupted {
        report = report.warning("interrupted: a part of the cycle");
    }
    for f in &found.facts {
        report = report.fact(format!("{} [{}]", f.name, f.unit), f.text.clone());
    }
    let time = thin(log.time_s.iter().copied());
    let kmh = |v: &[f64]| thin(v.iter().map(|x| 3.6 * x));
    let speed = Panel::new("Speed", "km/h").demand(kmh(&log.demand_mps)).line("Car", kmh(&log.speed_mps));
    let gear = Panel::new("Gear", "-").held("Gear", thin(log.gear.iter().copied()));
    let engine = Panel::new("Engine speed", "rpm").line("Engine", thin(log.engine_rpm.iter().copied()));
    let drive = TimePlot::new("Car", time.clone()).panel(speed).panel(gear).panel(engine);
    let power = |f: fn(&Power) -> f64| thin(log.power.iter().map(f));
    let torque = Panel::new("Torque", "Nm")
        .demand(thin(log.demand_nm.iter().copied()))
        .line("Engine", power(|p| p.torque_nm));
    let lambda = Panel::new("Lambda", "-")
        .line("Lambda", power(|p| if p.lambda.is_finite() { p.lambda.min(2.0) } else { f64::NAN }));
    let fuel = Panel::new("Fuel", "kg/h").line("Fuel", power(|p| p.fuel_kg_h));
    let throttle = Panel::new("Throttle", "deg").line("Throttle", power(|p| p.throttle_deg));
    let inside = TimePlot::new("Engine", time)
        .panel(torque)
        .panel(lambda)
        .panel(fuel)
        .panel(throttle)
        .caption("Lambda has gaps where fuel is cut off.");
    let points: Block =
        XyPlot::new("Where the engine runs", Axis::new("Engine speed", "rpm"), Axis::new("Torque", "Nm"))
            .points("Every 0.2 s", thin(log.engine_rpm.iter().copied()), power(|p| p.torque_nm))
            .into();
    let text = "Throttle and spark come from steady points with the spark of the static rule, fuel from the air of \
                the last cycle; the demanded torque is trimmed by an integral. Overrun cuts the fuel off.";
    report
        .section(Section::new("Drive").block(drive))
        .section(Section::new("Engine").text(text).block(inside).block(points))
}
