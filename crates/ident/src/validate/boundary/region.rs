//! Ellipsoid, convex hull, star and one-class region, all in coordinates in which the data have mean zero and unit covariance.

use dynocal_numerics::linalg::{cholesky, dot, norm2, solve_upper, solve_upper_transposed};
use dynocal_numerics::rng::Rng64;
use serde::{Deserialize, Serialize};

use super::gauge::gauge;
use super::one_class::OneClass;
use super::star::Star;

/// Part of the unit matrix that is added to the correlation matrix: dependent channels stay a thin region.
const RIDGE: f64 = 1e-6;
/// A channel that does not move counts as known within this share of its value.
const STILL: f64 = 1e-3;
/// Seed of the directions in which the hull is looked for.
const SEED: u64 = 0;

/// Shape of a region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RegionKind {
    /// Ellipsoid of the covariance: for any number of coordinates.
    #[default]
    Leverage,
    /// Convex hull: follows the data closer; needs many points in more than some ten coordinates.
    Hull,
    /// Star-shaped about the mean: follows bays of the data that a hull fills.
    Star,
    /// One-class kernel: follows any shape, islands included.
    OneClass,
}

/// A squared distance: `z'Az, z = (x - centre) / scale`.
#[derive(Clone, Debug, PartialEq)]
pub struct Quadratic {
    /// Centre (d), in units of the coordinates.
    pub centre: Vec<f64>,
    /// Scale (d), in the same.
    pub scale: Vec<f64>,
    /// A (d x d row-major), symmetric.
    pub matrix: Vec<f64>,
}

/// A region about a centre. `r`: R'R is the correlation matrix of the scaled coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Region {
    centre: Vec<f64>,
    scale: Vec<f64>,
    r: Vec<f64>,
    /// Points of the hull in white coordinates, row by row; none for the other kinds.
    hull: Vec<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    star: Option<Star>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    one_class: Option<OneClass>,
    /// The deepest point of a one-class region: its mean may lie outside.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    deepest: Option<Vec<f64>>,
    kind: RegionKind,
    /// What the raw number is divided by.
    unit: f64,
}

impl Region {
    /// The region of points (row-major, d each), at least d + 2 of them; `inside` is the share that a one-class region is
    /// made to hold.
    pub(super) fn fit(kind: RegionKind, points: &[f64], d: usize, most: usize, inside: f64) -> Self {
        let n = (points.len() / d) as f64;
        let mut centre = vec![0.0; d];
        points.chunks_exact(d).for_each(|x| centre.iter_mut().zip(x).for_each(|(c, x)| *c += x / n));
        let mut covariance = vec![0.0; d * d];
        let mut off = vec![0.0; d];
        for x in points.chunks_exact(d) {
            off.iter_mut().zip(x).zip(&centre).for_each(|((o, x), c)| *o = x - c);
            for i in 0..d {
                for j in i..d {
                    covariance[i * d + j] += off[i] * off[j] / n;
                }
            }
        }
        let scale: Vec<f64> = (0..d)
            .map(|i| {
                let (std, still) = (covariance[i * d + i].sqrt(), STILL * centre[i].abs());
                // Rounding of the mean is no movement.
                if std > 1e-9 * centre[i].abs() {
                    std
                } else if still > 0.0 {
                    still
                } else {
                    STILL
                }
            })
            .collect();
        let mut r = vec![0.0; d * d];
        for i in 0..d {
            for j in i..d {
                r[i * d + j] = covariance[i * d + j] / (scale[i] * scale[j]);
            }
            r[i * d + i] += RIDGE;
        }
        let mut region = Self {
            centre,
            scale,
            r,
            hull: Vec::new(),
            star: None,
            one_class: None,
            deepest: None,
            kind,
            unit: 1.0,
        };
        // The ridge keeps it positive definite; where rounding wins after all, channels count as independent.
        if cholesky(&mut region.r, d).is_err() {
            region.r.fill(0.0);
            (0..d).for_each(|i| region.r[i * d + i] = 1.0);
        }
        let white = || points.chunks_exact(d).flat_map(|x| region.white(x)).collect::<Vec<f64>>();
        match kind {
            RegionKind::Leverage => {}
            // All points where that is cheap: the hull is then exact.
            RegionKind::Hull if points.len() <= most * d => region.hull = white(),
            RegionKind::Hull => region.hull = region.support(points, d, most),
            RegionKind::Star => region.star = Some(Star::fit(&white(), d, most)),
            RegionKind::OneClass => {
                region.one_class = Some(OneClass::fit(&white(), d, most, 1.0 - inside));
                let by =
                    |a: &&[f64], b: &&[f64]| region.distance(a, None).total_cmp(&region.distance(b, None));
                region.deepest = points.chunks_exact(d).min_by(by).map(<[f64]>::to_vec);
            }
        }
        region
    }

    pub(super) fn kind(&self) -> RegionKind {
        self.kind
    }

    pub(super) fn centre(&self) -> &[f64] {
        self.deepest.as_ref().unwrap_or(&self.centre)
    }

    /// The region of the points `offset + scale x`; white coordinates stay as they are.
    pub(super) fn stretched(&self, lines: &[(f64, f64)]) -> Self {
        let mut out = self.clone();
        for ((centre, own), (offset, scale)) in out.centre.iter_mut().zip(&mut out.scale).zip(lines) {
            *centre = offset + scale * *centre;
            *own *= scale;
        }
        out
    }

    /// Divides all distances.
    pub(super) fn scale_by(&mut self, unit: f64) {
        self.unit *= if unit > 0.0 && unit.is_finite() { unit } else { 1.0 };
    }

    /// White coordinates `R^-T (x - c) / scale`.
    fn white(&self, x: &[f64]) -> Vec<f64> {
        let mut z: Vec<f64> =
            x.iter().zip(&self.centre).zip(&self.scale).map(|((x, c), s)| (x - c) / s).collect();
        // The factor has a positive diagonal.
        let _ = solve_upper_transposed(&self.r, z.len(), &mut z);
        z
    }

    /// Centre, scale and matrix A (d x d row-major) with `distance^2 = z'Az, z = (x - centre) / scale`; none for regions whose
    /// distance is no quadratic form.
    pub(super) fn quadratic(&self) -> Option<Quadratic> {
        let d = self.centre.len();
        let mut matrix = vec![0.0; d * d];
        for (k, row) in matrix.chunks_exact_mut(d.max(1)).enumerate() {
            row[k] = 1.0 / (self.unit * self.unit);
            let solved = solve_upper_transposed(&self.r, d, row).and_then(|()| solve_upper(&self.r, d, row));
            solved.ok()?;
        }
        let (centre, scale) = (self.centre.clone(), self.scale.clone());
        (self.kind == RegionKind::Leverage).then_some(Quadratic { centre, scale, matrix })
    }

    /// Distance, and its gradient if asked for.
    pub(super) fn distance(&self, x: &[f64], gradient: Option<&mut [f64]>) -> f64 {
        if x.len() != self.centre.len() || x.iter().any(|v| !v.is_finite()) {
            if let Some(g) = gradient {
                g.fill(0.0);
            }
            return f64::INFINITY;
        }
        let z = self.white(x);
        let (raw, mut normal) = match self.kind {
            RegionKind::Leverage => {
                let length = norm2(&z);
                (length, z.iter().map(|v| if length > 0.0 { v / length } else { 0.0 }).collect())
            }
            RegionKind::Hull => gauge(&self.hull, &z),
            RegionKind::Star => {
                self.star.as_ref().map_or((f64::INFINITY, vec![0.0; z.len()]), |s| s.distance(&z))
            }
            RegionKind::OneClass => {
                self.one_class.as_ref().map_or((f64::INFINITY, vec![0.0; z.len()]), |r| r.distance(&z))
            }
        };
        if let Some(g) = gradient {
            let _ = solve_upper(&self.r, normal.len(), &mut normal);
            for ((g, n), s) in g.iter_mut().zip(&normal).zip(&self.scale) {
                *g = n / (s * self.unit);
            }
        }
        raw / self.unit
    }

    /// The points farthest in many directions (axes first, then seeded ones), white, each once.
    fn support(&self, points: &[f64], d: usize, most: usize) -> Vec<f64> {
        let white: Vec<Vec<f64>> = points.chunks_exact(d).map(|x| self.white(x)).collect();
        let mut rng = Rng64::new(SEED);
        let mut places = std::collections::BTreeSet::new();
        let mut farthest = |direction: &[f64]| {
            let along: Vec<f64> = white.iter().map(|z| dot(z, direction)).collect();
            let place =
                |sign: f64| (0..along.len()).max_by(|&a, &b| (sign * along[a]).total_cmp(&(sign * along[b])));
            places.extend(place(1.0));
            places.extend(place(-1.0));
        };
        for i in 0..d {
            let mut axis = vec![0.0; d];
            axis[i] = 1.0;
            farthest(&axis);
        }
        for _ in d..(most / 2).max(d) {
            let direction: Vec<f64> = (0..d).map(|_| rng.normal()).collect();
            farthest(&direction);
        }
        places.into_iter().flat_map(|k| white[k].clone()).collect()
    }
}
