//! Dense linear algebra against closed forms and against properties that define the factorisations.

use dynocal_numerics::linalg::{
    Factor, LinalgError, QrWork, cholesky, cholesky_inverse, gram_upper, invert_upper, least_squares,
    log_det_gram, norm2, pivoted_r, product, solve_upper, solve_upper_many, solve_upper_transposed,
    solve_upper_transposed_many, symmetric_eigenvalues, symmetric_update,
};
use dynocal_numerics::rng::Rng64;

fn random(rows: usize, cols: usize, seed: u64) -> Vec<f64> {
    let mut g = Rng64::new(seed);
    (0..rows * cols).map(|_| g.uniform_in(-1.0, 1.0)).collect()
}

fn gram(a: &[f64], rows: usize, cols: usize) -> Vec<f64> {
    let mut out = vec![0.0; cols * cols];
    for i in 0..rows {
        for j in 0..cols {
            for k in 0..cols {
                out[j * cols + k] += a[i * cols + j] * a[i * cols + k];
            }
        }
    }
    out
}

/// Shapes on both sides of the switch between the plain loops and the blocked backend, and a wide one.
const SHAPES: [(usize, usize); 6] = [(1, 1), (5, 5), (100, 23), (700, 40), (5000, 12), (3, 6)];

#[test]
fn r_factor_reproduces_the_gram_matrix_and_is_upper_with_a_positive_diagonal() {
    for (m, n) in SHAPES {
        let a = random(m, n, 3);
        let mut r = vec![f64::NAN; n * n];
        let mut work = QrWork::new(m, n);
        // Twice, so that what the first call leaves behind must not matter.
        work.r_factor(&random(m, n, 4), &mut r).expect("shape");
        work.r_factor(&a, &mut r).expect("shape");
        let (expected, found) = (gram(&a, m, n), gram(&r, n, n));
        for k in 0..n * n {
            assert!((expected[k] - found[k]).abs() < 1e-12 * m as f64, "{m} x {n}");
            let (i, j) = (k / n, k % n);
            assert!(if i > j { r[k] == 0.0 } else { i != j || r[k] >= 0.0 });
        }
    }
}

#[test]
fn gram_matrix_agrees_with_the_sum_of_products() {
    for (m, n) in SHAPES {
        let a = random(m, n, 5);
        let (expected, mut found) = (gram(&a, m, n), vec![0.0; n * n]);
        gram_upper(&a, m, n, &mut found).expect("shape");
        for i in 0..n {
            for j in i..n {
                assert!((expected[i * n + j] - found[i * n + j]).abs() < 1e-12 * m as f64);
            }
        }
    }
}

/// ln det of the Hilbert matrix of order n from its closed form c_n^4 / c_2n, c_n = prod k! for k < n.
fn hilbert_log_det(n: usize) -> f64 {
    let ln_c = |n: usize| -> f64 { (1..n).map(|k| (1..=k).map(|j| (j as f64).ln()).sum::<f64>()).sum() };
    4.0 * ln_c(n) - ln_c(2 * n)
}

#[test]
fn log_determinant_of_hilbert_matrices() {
    for n in 2..=8 {
        let a: Vec<f64> = (0..n * n).map(|k| 1.0 / (k / n + k % n + 1) as f64).collect();
        let mut r = vec![0.0; n * n];
        QrWork::new(n, n).r_factor(&a, &mut r).expect("shape");
        // ln det(A'A) = 2 ln det A; the condition number reaches 1e10 at n = 8.
        let error = log_det_gram(&r, n) - 2.0 * hilbert_log_det(n);
        assert!(error.abs() < 1e-5, "order {n}: {error}");
    }
    let n = 4;
    let mut a: Vec<f64> = (0..n * n).map(|k| 1.0 / (k / n + k % n + 1) as f64).collect();
    cholesky(&mut a, n).expect("positive definite");
    assert!((log_det_gram(&a, n) - hilbert_log_det(n)).abs() < 1e-11);
}

#[test]
fn eigenvalues_of_the_second_difference_matrix() {
    let n = 20;
    let mut a = vec![0.0; n * n];
    for i in 0..n {
        a[i * n + i] = 2.0;
        if i > 0 {
            (a[i * n + i - 1], a[(i - 1) * n + i]) = (-1.0, -1.0);
        }
    }
    let found = symmetric_eigenvalues(&a, n).expect("finite");
    for (k, v) in found.iter().enumerate() {
        let exact = 2.0 - 2.0 * ((k + 1) as f64 * std::f64::consts::PI / (n + 1) as f64).cos();
        assert!((v - exact).abs() < 1e-13, "{k}: {v} {exact}");
    }
    a[3] = f64::NAN;
    assert!(matches!(symmetric_eigenvalues(&a, n), Err(LinalgError::NotFinite { index: 3, .. })));
}

#[test]
fn triangular_solves_and_the_inverse_undo_the_product() {
    let n = 9;
    let mut r = random(n, n, 8);
    (0..n).for_each(|i| r[i * n + i] += 3.0);
    for i in 0..n {
        r[i * n..i * n + i].fill(0.0);
    }
    let x = random(n, 1, 9);
    let times = |row: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
        (0..n).map(|i| (0..n).map(|j| row(i, j) * x[j]).sum()).collect()
    };
    let mut b = times(&|i, j| r[i * n + j]);
    solve_upper(&r, n, &mut b).expect("regular");
    let mut c = times(&|i, j| r[j * n + i]);
    solve_upper_transposed(&r, n, &mut c).expect("regular");
    let mut inverse = vec![f64::NAN; n * n];
    invert_upper(&r, n, &mut inverse).expect("regular");
    for i in 0..n {
        assert!((b[i] - x[i]).abs() < 1e-13 && (c[i] - x[i]).abs() < 1e-13);
        for j in 0..n {
            let product: f64 = (0..n).map(|k| r[i * n + k] * inverse[k * n + j]).sum();
            assert!((product - f64::from(u8::from(i == j))).abs() < 1e-13);
        }
    }
    r[4 * n + 4] = 0.0;
    assert!(matches!(solve_upper(&r, n, &mut b), Err(LinalgError::Pivot { index: 4, .. })));
}

#[test]
fn cholesky_refuses_an_indefinite_matrix() {
    let mut a = vec![1.0, 2.0, 2.0, 1.0];
    assert!(matches!(cholesky(&mut a, 2), Err(LinalgError::Pivot { index: 1, .. })));
}

#[test]
fn least_squares_recovers_exact_coefficients_over_twelve_decades_of_column_scales() {
    let (m, n) = (400, 12);
    let mut a = random(m, n, 10);
    for row in a.chunks_exact_mut(n) {
        row.iter_mut().enumerate().for_each(|(j, v)| *v *= 10f64.powi(j as i32 - 6));
    }
    let x: Vec<f64> = (0..n).map(|j| (j as f64 - 4.5) * 10f64.powi(6 - j as i32)).collect();
    let b: Vec<f64> = a.chunks_exact(n).map(|row| row.iter().zip(&x).map(|(a, x)| a * x).sum()).collect();
    let fit = least_squares(&a, m, n, &b, 0.0).expect("finite");
    assert_eq!(fit.factor.rank, n);
    for j in 0..n {
        assert!((fit.x[j] / x[j] - 1.0).abs() < 1e-11, "{j}");
    }
}

#[test]
fn ridge_solution_satisfies_its_normal_equations() {
    let (m, n, ridge) = (60, 5, 0.7);
    let (a, b) = (random(m, n, 11), random(m, 1, 12));
    let fit = least_squares(&a, m, n, &b, ridge).expect("finite");
    let residual: Vec<f64> =
        (0..m).map(|i| b[i] - (0..n).map(|j| a[i * n + j] * fit.x[j]).sum::<f64>()).collect();
    for j in 0..n {
        let g: f64 = (0..m).map(|i| a[i * n + j] * residual[i]).sum::<f64>() - ridge * fit.x[j];
        assert!(g.abs() < 1e-12, "{g}");
    }
    assert!((fit.residual_sum_squares - norm2(&residual).powi(2)).abs() < 1e-12);
}

#[test]
fn dependent_columns_are_reported_and_the_fit_is_still_optimal() {
    // Column 3 = column 0 - 2 column 2 in other units, column 5 = 0.
    let (m, n) = (50, 6);
    let mut a = random(m, n, 13);
    for row in a.chunks_exact_mut(n) {
        row[3] = 1e6 * (row[0] - 2.0 * row[2]);
        row[5] = 0.0;
    }
    let p = pivoted_r(&a, m, n, 1e-10).expect("finite");
    assert_eq!(p.rank, 4);
    assert!(p.dependent.contains(&5));
    assert!([0, 2, 3].iter().any(|k| p.dependent.contains(k)) && p.dependent.len() == 2);
    let b = random(m, 1, 14);
    let fit = least_squares(&a, m, n, &b, 0.0).expect("finite");
    assert_eq!(fit.factor.rank, 4);
    for j in 0..n {
        let g: f64 = (0..m)
            .map(|i| a[i * n + j] * (b[i] - (0..n).map(|k| a[i * n + k] * fit.x[k]).sum::<f64>()))
            .sum();
        assert!(g.abs() < 1e-10 * 1e6, "column {j}: {g}");
    }
}

#[test]
fn wrong_shapes_and_non_finite_entries_are_named() {
    let e = least_squares(&[1.0, 2.0, 3.0], 2, 2, &[0.0, 0.0], 0.0).expect_err("shape");
    assert_eq!(e.to_string(), "matrix: found 3 entries, expected 4");
    let e = pivoted_r(&[1.0, f64::INFINITY], 2, 1, 0.0).expect_err("not finite");
    assert!(matches!(e, LinalgError::NotFinite { index: 1, .. }));
}

#[test]
fn blocked_products_inverses_and_solves_agree_with_plain_sums() {
    for (n, k) in [(1, 1), (7, 3), (60, 5), (130, 40)] {
        let (a, b) = (random(n + 4, n, 11), random(n, k, 12));
        // C = A'A + I through the general product and through the symmetric update.
        let mut general = vec![0.0; n * n];
        product(1.0, Factor::transposed(&a, n + 4, n), Factor::new(&a, n + 4, n), false, &mut general)
            .unwrap();
        let mut c = vec![0.0; n * n];
        (0..n).for_each(|i| c[i * n + i] = 1.0);
        symmetric_update(1.0, &a, n + 4, n, &mut c).unwrap();
        let expected = gram(&a, n + 4, n);
        for i in 0..n {
            for j in i..n {
                let unit = f64::from(u8::from(i == j));
                assert!((general[i * n + j] - expected[i * n + j]).abs() < 1e-12 * n as f64);
                assert!((c[i * n + j] - unit - expected[i * n + j]).abs() < 1e-12 * n as f64);
            }
        }
        let full: Vec<f64> = (0..n * n).map(|p| c[(p / n).min(p % n) * n + (p / n).max(p % n)]).collect();
        let mut r = c.clone();
        cholesky(&mut r, n).unwrap();
        let (mut work, mut inverse) = (vec![0.0; n * n], vec![0.0; n * n]);
        cholesky_inverse(&r, n, &mut work, &mut inverse).unwrap();
        // Two solves with the factor are one with the matrix.
        let mut x = b.clone();
        solve_upper_transposed_many(&r, n, &mut x, k).unwrap();
        solve_upper_many(&r, n, &mut x, k).unwrap();
        let mut back = vec![0.0; n * k];
        product(1.0, Factor::new(&full, n, n), Factor::new(&x, n, k), false, &mut back).unwrap();
        product(-1.0, Factor::new(&b, n, k), Factor::transposed(&identity(k), k, k), true, &mut back)
            .unwrap();
        assert!(back.iter().all(|v| v.abs() < 1e-11 * n as f64), "solve, n = {n}");
        for i in 0..n {
            for j in i..n {
                let row: f64 = (0..n).map(|l| full[i * n + l] * inverse[l.min(j) * n + l.max(j)]).sum();
                assert!((row - f64::from(u8::from(i == j))).abs() < 1e-11 * n as f64, "inverse, n = {n}");
            }
        }
    }
}

fn identity(n: usize) -> Vec<f64> {
    (0..n * n).map(|p| f64::from(u8::from(p / n == p % n))).collect()
}
