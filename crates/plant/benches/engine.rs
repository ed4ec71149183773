//! Speed of the engine: time per degree of crank angle (one step of 1 deg) and per simulated second.
//!
//! The real-time factor at 2000 rpm is 1 / (seconds per simulated second); per deg-step divide by 12 000.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use dynocal_plant::{engine::VirtualEngine, inputs::Inputs, params::EngineParams};

fn engine_at(set: &str, speed_rpm: f64) -> VirtualEngine {
    let params = EngineParams::named(set).expect("embedded set");
    let mut engine = VirtualEngine::new(&params).expect("valid parameters");
    engine.set_inputs(Inputs { speed_rpm, ..Inputs::default() }).expect("inputs are inside the box");
    engine.advance_time(3.0);
    engine
}

fn stepping(c: &mut Criterion) {
    let gtdi = EngineParams::named("gtdi_2l").expect("embedded set");
    let mut group = c.benchmark_group("engine");
    let mut engine = engine_at("thesis", 2000.0);
    group.throughput(Throughput::Elements(720));
    group.bench_function("cycle of 720 steps of 1 deg at 2000 rpm", |b| {
        b.iter(|| engine.advance_angle(720.0))
    });
    for set in ["thesis", "gtdi_2l"] {
        for speed in [1000.0, 2000.0, 3000.0] {
            let mut engine = engine_at(set, speed);
            group.throughput(Throughput::Elements(1));
            group.bench_function(format!("{set}: 0.1 s at {speed} rpm"), |b| {
                b.iter(|| engine.advance_time(0.1))
            });
        }
    }
    group
        .bench_function("build gtdi_2l", |b| b.iter(|| VirtualEngine::new(&gtdi).expect("valid parameters")));
    group.finish();
}

criterion_group!(benches, stepping);
criterion_main!(benches);
