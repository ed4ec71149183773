//! Speed of a map of 16 x 16 cells from 100 000 samples, smoothness given and chosen, and with monotone limits.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::{Options, Problem, fit};
use dynocal_label::rows::Rows;
use dynocal_numerics::rng::Rng64;

fn map(c: &mut Criterion) {
    let axis: Vec<f64> = (0..16).map(f64::from).collect();
    let mut label =
        Label::new("M", "-", vec![Axis::new("x", "-", &axis), Axis::new("y", "-", &axis)], &[0.0; 256]);
    let mut rng = Rng64::new(1);
    let at: Vec<[f64; 2]> =
        (0..100_000).map(|_| [rng.uniform_in(0.0, 15.0), rng.uniform_in(0.0, 15.0)]).collect();
    let y: Vec<f64> = at.iter().map(|p| p[0] + (0.4 * p[1]).sin() + 0.3 * rng.normal()).collect();
    let run = |label: &Label, options: &Options| {
        let mut rows = Rows::default();
        for p in &at {
            rows.start();
            label.enter(&mut rows, 0, 1.0, p);
        }
        fit(&Problem::new(std::slice::from_ref(label), &rows, &y), options).map(|f| f.values)
    };
    let given = Options { smooth: Some(1e-3), ..Options::default() };
    c.bench_function("map_16x16_100000_smooth_given", |b| b.iter(|| black_box(run(&label, &given))));
    c.bench_function("map_16x16_100000_smooth_chosen", |b| {
        b.iter(|| black_box(run(&label, &Options::default())))
    });
    label.axes[0].gradient = [0.0, f64::INFINITY];
    c.bench_function("map_16x16_100000_monotone", |b| b.iter(|| black_box(run(&label, &given))));
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10);
    targets = map
}
criterion_main!(benches);
