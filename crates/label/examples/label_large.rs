//! Our side of `bench/peers/labels.py` for large functions: fifty maps behind a film and two lags, planted, from one record.
//!
//! ```text
//! label_large SAMPLES DRAWS [MAPS [SEED]]    prints JSON: times, memory, how far the labels are from those that were planted
//! out = lag(lag(film(sum_i gain_i(t) map_i(x_i, y_i), share, tau), lag1), lag2)
//! ```
//!
//! Three maps with one gain are read at six quantities; a cell of two of them is locked, since the data know the sum of their means only.

mod process;

use std::error::Error;
use std::time::Instant;

use dynocal_label::graph::{Graph, Node, Op, Record};
use dynocal_label::label::{Axis, Label};
use dynocal_label::linear::Options;
use dynocal_label::nonlinear::{Target, fit};
use dynocal_numerics::rng::Rng64;
use serde_json::json;

use process::{cpu_s, peak_gib};

const MOST_MAPS: usize = 50;
const CELLS: usize = 16;
/// Quantities that maps are read at, two each, and all channels: the others are gains.
const READ: usize = 6;
const CHANNELS: usize = READ + MOST_MAPS.div_ceil(READ / 2);
const SAMPLE_S: f64 = 0.1;
const NOISE: f64 = 0.5;

fn function(maps: usize) -> Graph {
    let points: Vec<f64> = (0..CELLS).map(|k| k as f64 / (CELLS - 1) as f64).collect();
    let axes = || vec![Axis::new("x", "-", &points), Axis::new("y", "-", &points)];
    let mut nodes: Vec<Node> = Vec::new();
    let mut add = |op: Op| {
        nodes.push(Node { name: format!("n{}", nodes.len()), op });
        nodes.len() - 1
    };
    let channels: Vec<usize> = (0..CHANNELS).map(|k| add(Op::Channel(k))).collect();
    let mut labels = Vec::new();
    let mut terms = Vec::new();
    for k in 0..maps {
        let (gain, pair) = (channels[READ + k / (READ / 2)], 2 * (k % (READ / 2)));
        let mut label = Label::new(&format!("MAP{k}"), "-", axes(), &[0.5; CELLS * CELLS]);
        if pair > 0 {
            label.base[0] = planted(k, 0);
            label.locked[0] = true;
        }
        labels.push(label);
        let map = add(Op::Label(k, vec![channels[pair], channels[pair + 1]]));
        terms.push(add(Op::Multiply(vec![map, gain])));
    }
    let sum = add(Op::Add(terms));
    let mut scalar = |name: &str, base: f64, lower: f64, upper: f64| {
        let mut l = Label::scalar(name, "-", base);
        (l.lower, l.upper) = (lower, upper);
        labels.push(l);
        add(Op::Label(labels.len() - 1, vec![]))
    };
    let share = scalar("SHARE", 0.1, 0.0, 0.95);
    let tau = scalar("TAU", 0.5, 0.02, 20.0);
    let fast = scalar("FAST", 0.02, 0.002, 2.0);
    let slow = scalar("SLOW", 0.2, 0.002, 5.0);
    let film = add(Op::Film(sum, share, tau));
    let first = add(Op::Lag(film, fast));
    add(Op::Lag(first, slow));
    Graph { nodes, labels }
}

fn planted(map: usize, cell: usize) -> f64 {
    let (x, y) = ((cell % CELLS) as f64 / 15.0, (cell / CELLS) as f64 / 15.0);
    1.0 + (3.0 * x + map as f64).sin() * (2.0 * y - 0.3 * map as f64).cos()
}

fn truth(maps: usize) -> Vec<f64> {
    let mut out: Vec<f64> = (0..maps).flat_map(|m| (0..CELLS * CELLS).map(move |k| planted(m, k))).collect();
    out.extend([0.3, 0.8, 0.05, 0.3]);
    out
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let usage = "usage: label_large SAMPLES DRAWS [MAPS [SEED]]";
    let n: usize = args.next().ok_or(usage)?.parse()?;
    let draws: usize = args.next().ok_or(usage)?.parse()?;
    let maps: usize = args.next().map_or(Ok(MOST_MAPS), |m| m.parse())?;
    let seed: u64 = args.next().map_or(Ok(1), |s| s.parse())?;
    let (graph, truth) = (function(maps), truth(maps));
    let mut rng = Rng64::new(seed);
    let time_s: Vec<f64> = (0..n).map(|k| SAMPLE_S * k as f64).collect();
    // Quantities that are held and jump, each at its own times, as set points of a drive do.
    let channels: Vec<Vec<f64>> = (0..CHANNELS)
        .map(|c| {
            let (mut v, mut until) = (0.5, 0);
            (0..n)
                .map(|k| {
                    if k >= until {
                        v = rng.uniform();
                        until = k + 5 + rng.below(20 + c);
                    }
                    v
                })
                .collect()
        })
        .collect();
    let record = Record { time_s: &time_s, channels: channels.iter().map(Vec::as_slice).collect() };
    let noise: Vec<f64> = (0..n).map(|_| NOISE * rng.normal()).collect();
    let y: Vec<f64> = graph.values(&truth, &record).iter().zip(&noise).map(|(v, e)| v + e).collect();
    let weights = vec![1.0; n];
    let target = Target { record, node: None, y: &y, weights: &weights };
    let options = Options { smooth: Some(1e-3), draws, ..Options::default() };
    let before = cpu_s()?;
    let clock = Instant::now();
    let found = fit(&graph, &[target], &options, &|| false)?;
    let (wall_s, cpu) = (clock.elapsed().as_secs_f64(), cpu_s()? - before);
    let cells = maps * CELLS * CELLS;
    let square: f64 = (0..cells).map(|k| (found.fit.exact[k] - truth[k]).powi(2)).sum();
    // By how much fewer squares are left than with the planted labels, over what as many labels as are free take from noise.
    let free = graph.labels.iter().flat_map(|l| &l.locked).filter(|locked| !**locked).count();
    let gained = noise.iter().map(|e| e * e).sum::<f64>() - n as f64 * found.fit.rms[1].powi(2);
    let gained = gained / (NOISE * NOISE * free as f64);
    let inside =
        (0..truth.len()).filter(|k| (found.fit.exact[*k] - truth[*k]).abs() <= found.fit.half_width[*k]);
    println!(
        "{}",
        json!({
            "samples": n,
            "cells": truth.len(),
            "wall_s": wall_s,
            "cpu_s": cpu,
            "peak_gib": peak_gib()?,
            "steps": found.steps,
            "converged": found.converged,
            "rms": found.fit.rms[1],
            "off": (square / cells as f64).sqrt(),
            "dynamics": found.fit.exact[cells..].to_vec(),
            "dynamics_half_width": if draws > 0 { Some(found.fit.half_width[cells..].to_vec()) } else { None },
            "dynamics_planted": truth[cells..].to_vec(),
            "gained": gained,
            "within_interval": if draws > 0 { Some(inside.count() as f64 / truth.len() as f64) } else { None },
        })
    );
    Ok(())
}
