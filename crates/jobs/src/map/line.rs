//! A line of the maps: its nodes along the first axis, and the path of the bed along them.

use dynocal_calib::steady::station::Leg;

use super::spec::SweepSpec;

/// A line: factors at its nodes along the first axis.
#[derive(Clone)]
pub(super) struct Line {
    /// Whether it is a part of one that was gone along before.
    pub(super) part: bool,
    /// Its number along the other axis.
    pub(super) number: usize,
    /// Value of the other axis; none where there is none.
    pub(super) other: Option<f64>,
    pub(super) nodes: Vec<Vec<f64>>,
    /// What the maps of the driven inputs say at the nodes, by loop.
    pub(super) driven: Vec<Vec<f64>>,
    /// Factors of the gains of the loops at the nodes, by loop.
    pub(super) gains: Vec<Vec<f64>>,
    /// Where it rests half way to the next node as well: number of the node, and what holds there.
    pub(super) halves: Vec<(usize, Half)>,
}

/// A place half way between two nodes: factors, what the maps of the driven inputs say, and factors of the gains, by loop.
#[derive(Clone)]
pub(super) struct Half {
    pub(super) at: Vec<f64>,
    pub(super) driven: Vec<f64>,
    pub(super) gains: Vec<f64>,
}

impl Line {
    /// With its nodes half way among the others.
    pub(super) fn expanded(&self) -> Self {
        let merged = |nodes: &[Vec<f64>], halves: &dyn Fn(usize) -> Vec<f64>| -> Vec<Vec<f64>> {
            let mut all = nodes.to_vec();
            for (i, (k, _)) in self.halves.iter().enumerate().rev() {
                all.insert(k + 1, halves(i));
            }
            all
        };
        // By loop: nodes along the line.
        let by_loop = |nodes: &[Vec<f64>], half: &dyn Fn(usize, usize) -> f64| -> Vec<Vec<f64>> {
            let one = |(l, values): (usize, &Vec<f64>)| {
                let values: Vec<Vec<f64>> = values.iter().map(|v| vec![*v]).collect();
                merged(&values, &|i| vec![half(i, l)]).concat()
            };
            nodes.iter().enumerate().map(one).collect()
        };
        Self {
            nodes: merged(&self.nodes, &|i| self.halves[i].1.at.clone()),
            driven: by_loop(&self.driven, &|i, l| self.halves[i].1.driven[l]),
            // Where none is raised there is none.
            gains: by_loop(&self.gains, &|i, l| self.halves[i].1.gains.get(l).copied().unwrap_or(1.0)),
            halves: Vec::new(),
            ..*self
        }
    }
}

/// The path along a line, beginning at the first node or at the `last`: there and back, with a rest at the turn where one is asked for; or there with a rest at each
/// node, and back where limits were kept, in the time of a ramp. `whole`: length of the first axis; `pace`: share of the times that the spec asks for.
pub(super) fn path(
    (spec, pace): (&SweepSpec, f64),
    (whole, ramp_s): (f64, f64),
    line: &Line,
    last: bool,
) -> (Vec<f64>, Vec<Leg>) {
    let mut order: Vec<usize> = (0..line.nodes.len()).collect();
    if last {
        order.reverse();
    }
    let begin = line.nodes[order[0]].clone();
    order.extend(order.clone().into_iter().rev().skip(1));
    // A model that says nothing there is not fed forward.
    let change = |a: usize, b: usize| {
        let one = move |d: &Vec<f64>| Some(d[b] - d[a]).filter(|v| v.is_finite()).unwrap_or(0.0);
        line.driven.iter().map(one).collect()
    };
    let leg = |a: usize, b: usize, seconds: f64| Leg {
        to: line.nodes[b].clone(),
        seconds,
        driven: change(a, b),
        gains: line.gains.iter().map(|g| g[b]).collect(),
    };
    let share = |a: usize, b: usize| (line.nodes[b][0] - line.nodes[a][0]).abs() / whole;
    let steps = order.len() - 1;
    let rests = spec.rest_s > 0.0;
    let mut legs = Vec::new();
    if rests {
        legs.push(leg(order[0], order[0], pace * spec.rest_s));
    }
    for (k, w) in order.windows(2).enumerate() {
        let (there, turns) = (2 * k < steps, 2 * (k + 1) == steps);
        let pass_s = if there || !rests { pace * spec.pass_s } else { ramp_s };
        legs.push(leg(w[0], w[1], pass_s * share(w[0], w[1])));
        let rest_s = match rests {
            true if there => pace * spec.rest_s,
            false if turns => spec.turn_s,
            _ => 0.0,
        };
        if rest_s > 0.0 {
            legs.push(leg(w[1], w[1], rest_s));
        }
    }
    (begin, legs)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(nodes: &[f64]) -> Line {
        Line {
            part: false,
            number: 0,
            other: None,
            nodes: nodes.iter().map(|y| vec![*y, 0.1 * y]).collect(),
            driven: vec![nodes.iter().map(|y| 0.2 * y).collect()],
            gains: vec![nodes.iter().map(|y| y / 40.0).collect()],
            halves: Vec::new(),
        }
    }

    /// With rests: one at each node on the way there, none on the way back, which takes the time of a ramp. Without: there and back at the same pace with a rest at the
    /// turn. What is fed forward ends where it began.
    #[test]
    fn a_line_rests_at_each_node_or_at_its_turn() {
        let line = line(&[40.0, 70.0, 160.0]);
        let times = |spec: &SweepSpec, pace: f64, last: bool| -> (f64, Vec<(f64, f64)>) {
            let (from, legs) = path((spec, pace), (120.0, 12.0), &line, last);
            let fed: f64 = legs.iter().map(|l| l.driven[0]).sum();
            assert!(fed.abs() < 1e-9 && legs.iter().all(|l| l.gains[0] == l.to[0] / 40.0));
            (from[0], legs.iter().map(|l| (l.to[0], l.seconds)).collect())
        };
        let rests = SweepSpec { pass_s: 16.0, rest_s: 8.0, ..SweepSpec::default() };
        let there = [(40.0, 8.0), (70.0, 4.0), (70.0, 8.0), (160.0, 12.0), (160.0, 8.0)];
        assert_eq!(times(&rests, 1.0, false), (40.0, [&there[..], &[(70.0, 9.0), (40.0, 3.0)]].concat()));
        let (from, other) = times(&rests, 0.5, true);
        assert_eq!((from, &other[..2]), (160.0, &[(160.0, 4.0), (70.0, 6.0)][..]));
        let turns = SweepSpec { pass_s: 40.0, turn_s: 8.0, ..SweepSpec::default() };
        let all = [(70.0, 10.0), (160.0, 30.0), (160.0, 8.0), (70.0, 30.0), (40.0, 10.0)];
        assert_eq!(times(&turns, 1.0, false), (40.0, all.to_vec()));
    }

    #[test]
    fn nodes_half_way_stand_between_the_others() {
        let line = Line {
            part: false,
            number: 3,
            other: None,
            nodes: [40.0, 60.0, 80.0, 100.0].iter().map(|y| vec![*y]).collect(),
            driven: vec![vec![4.0, 6.0, 8.0, 20.0], vec![1.0, 2.0, 3.0, 4.0]],
            gains: vec![vec![1.0; 4], vec![2.0; 4]],
            halves: vec![
                (0, Half { at: vec![50.0], driven: vec![5.0, 1.5], gains: vec![1.5, 2.5] }),
                (2, Half { at: vec![90.0], driven: vec![12.0, 3.5], gains: Vec::new() }),
            ],
        };
        let all = line.expanded();
        assert_eq!(all.nodes.concat(), [40.0, 50.0, 60.0, 80.0, 90.0, 100.0]);
        assert_eq!(all.driven, [vec![4.0, 5.0, 6.0, 8.0, 12.0, 20.0], vec![1.0, 1.5, 2.0, 3.0, 3.5, 4.0]]);
        assert_eq!(all.gains, [vec![1.0, 1.5, 1.0, 1.0, 1.0, 1.0], vec![2.0, 2.5, 2.0, 2.0, 1.0, 2.0]]);
        let not_raised = Line { gains: Vec::new(), ..line };
        assert!(not_raised.expanded().gains.is_empty());
        assert!(all.halves.is_empty() && all.number == 3);
    }
}
