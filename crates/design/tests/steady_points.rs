//! Points of a steady test: what each plan promises.

mod space {
    use dynocal_design::points::space::{latin_hypercube, least_distance, maximin};

    /// One point in each interval of every axis, before and after the exchanges; the seed draws the points.
    #[test]
    fn every_axis_has_a_point_in_each_of_its_intervals() {
        for points in [latin_hypercube(17, 5, 3), maximin(17, 5, 3)] {
            for k in 0..5 {
                let mut cells: Vec<usize> = points.iter().map(|p| (17.0 * p[k]) as usize).collect();
                cells.sort_unstable();
                assert!(cells.into_iter().eq(0..17));
            }
        }
        assert_eq!(maximin(17, 5, 3), maximin(17, 5, 3));
        assert_ne!(latin_hypercube(17, 5, 3), latin_hypercube(17, 5, 4));
    }

    /// Farther apart than the hypercubes that it begins with, on every one of ten seeds.
    #[test]
    fn maximin_points_are_farther_apart() {
        for seed in 0..10 {
            let (before, after) =
                (least_distance(&latin_hypercube(20, 3, seed)), least_distance(&maximin(20, 3, seed)));
            assert!(after > 1.3 * before, "seed {seed}: {after} {before}");
        }
    }

    #[test]
    fn no_points_and_one_point() {
        assert!(maximin(0, 3, 1).is_empty());
        assert_eq!(maximin(1, 3, 1), [[0.5; 3]]);
    }
}

mod optimal {
    use dynocal_design::points::Sobol;
    use dynocal_design::points::optimal::{Criterion, choose, log_determinant, mean_variance};

    fn grid(levels: usize) -> Vec<Vec<f64>> {
        let at = |k: usize| k as f64 / (levels - 1) as f64;
        (0..levels * levels).map(|k| vec![at(k / levels), at(k % levels)]).collect()
    }

    fn of(all: &[Vec<f64>], which: &[usize]) -> Vec<Vec<f64>> {
        which.iter().map(|k| all[*k].clone()).collect()
    }

    /// Nine points of a quadratic over a square: the 3 x 3 factorial is D-optimal (Atkinson, Donev and Tobias, chapter 11); its determinant
    /// follows from its sums by hand.
    #[test]
    fn nine_points_over_a_square_are_the_factorial() {
        let all = grid(5);
        let mut found = choose(&[], &all, &all, 9, Criterion::Determinant);
        found.sort_unstable();
        assert_eq!(found, [0, 2, 4, 10, 12, 14, 20, 22, 24]);
        // x, y: 6 each; xy: 4; (1, x^2, y^2): [[9, 6, 6], [6, 6, 4], [6, 4, 6]] with determinant 9 20 - 6 12 + 6 (-12) = 36.
        let expected = (6.0f64 * 6.0 * 4.0 * 36.0).ln();
        let got = log_determinant(&of(&all, &found));
        assert!((got - expected).abs() < 1e-4, "{got} {expected}");
    }

    /// Each criterion is best by its own measure, and both are better than points that fill the space; points that are there are not taken
    /// again where others tell more.
    #[test]
    fn each_criterion_is_best_by_its_own_measure() {
        let mut s = Sobol::new(4, 2).unwrap();
        let all: Vec<Vec<f64>> = (0..300).map(|_| s.next_point()).collect();
        let there = all[..8].to_vec();
        let with = |which: &[usize]| [there.clone(), of(&all[8..], which)].concat();
        let of = |c| with(&choose(&there, &all[8..], &all, 16, c));
        let (d, i) = (of(Criterion::Determinant), of(Criterion::MeanVariance));
        let filling = with(&(0..16).collect::<Vec<_>>());
        assert_eq!(d.len(), 24);
        assert!(log_determinant(&d) > log_determinant(&i) && log_determinant(&i) > log_determinant(&filling));
        let over = |p: &[Vec<f64>]| mean_variance(p, &all);
        assert!(
            over(&i) < over(&d) && over(&d) < over(&filling),
            "{} {} {}",
            over(&i),
            over(&d),
            over(&filling)
        );
        // No exchange of one point is left that would help.
        let chosen = choose(&there, &all[8..], &all, 16, Criterion::Determinant);
        let best = log_determinant(&with(&chosen));
        for at in 0..16 {
            for k in (0..292).filter(|k| !chosen.contains(k)) {
                let mut other = chosen.clone();
                other[at] = k;
                assert!(log_determinant(&with(&other)) <= best + 1e-6);
            }
        }
    }

    #[test]
    fn fewer_candidates_than_points_and_none() {
        let two = vec![vec![0.0], vec![1.0]];
        assert_eq!(choose(&[], &two, &two, 5, Criterion::MeanVariance).len(), 2);
        assert!(choose(&[], &[], &two, 5, Criterion::Determinant).is_empty());
    }
}
