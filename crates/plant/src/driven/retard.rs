//! Retard from best spark that a production controller holds.

/// Speeds \[rpm\] and brake mean effective pressures \[bar\] of the table.
const SPEED_RPM: [f64; 6] = [1500.0, 2000.0, 2500.0, 3000.0, 4000.0, 5000.0];
const BMEP_BAR: [f64; 8] = [6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0];

/// Retard \[deg\] of a 2.0 l turbocharged engine with direct injection and a compression ratio of 10.8: table over speed and
/// intake pressure of `VEP_par.py` (faultdiagnosistoolbox, MIT licence), its pressure turned into BMEP by a measured map of
/// such an engine. Cells that the source leaves empty hold the last value of their row.
const RETARD_DEG: [[f64; 8]; 6] = [
    [4.0, 7.0, 11.0, 13.0, 15.0, 19.0, 20.0, 20.0],
    [2.5, 3.5, 5.0, 9.0, 13.0, 16.0, 18.0, 20.0],
    [0.0, 0.6, 2.0, 6.0, 10.0, 13.0, 16.0, 19.5],
    [0.0, 0.2, 1.0, 4.0, 8.0, 10.5, 13.0, 20.0],
    [0.0, 0.0, 1.0, 4.0, 8.0, 11.0, 11.0, 11.0],
    [0.2, 1.0, 3.0, 5.0, 8.5, 8.5, 8.5, 8.5],
];

/// Retard from best spark \[deg\] at a speed \[rpm\] and a BMEP \[bar\]: bilinear, held at the ends of speed and at the top;
/// below the first pressure the slope of the first cell goes on to zero.
///
/// ```
/// use dynocal_plant::driven::retard::deg;
/// assert_eq!(deg(2000.0, 16.0), 16.0);
/// assert_eq!(deg(2250.0, 12.0), 7.5);
/// assert_eq!(deg(3000.0, 2.0), 0.0);
/// assert_eq!(deg(9000.0, 30.0), 8.5);
/// ```
pub fn deg(speed_rpm: f64, bmep_bar: f64) -> f64 {
    let (i, v) = place(&SPEED_RPM, speed_rpm);
    let v = v.clamp(0.0, 1.0);
    let (j, w) = place(&BMEP_BAR, bmep_bar);
    let w = w.min(1.0);
    let row = |k: usize| RETARD_DEG[k][j] + w * (RETARD_DEG[k][j + 1] - RETARD_DEG[k][j]);
    (row(i) + v * (row(i + 1) - row(i))).max(0.0)
}

/// Cell and place in it.
fn place(x: &[f64], at: f64) -> (usize, f64) {
    let i = x.partition_point(|v| *v <= at).clamp(1, x.len() - 1) - 1;
    (i, (at - x[i]) / (x[i + 1] - x[i]))
}
