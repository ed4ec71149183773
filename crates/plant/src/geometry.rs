//! Crank-slider geometry with pin offset (thesis Table 3.2).

use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Dimensions of one cylinder; all cylinders are equal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Geometry {
    /// Bore B \[m\], thesis Table 3.2.
    pub bore_m: f64,
    /// Nominal stroke S = 2 r \[m\], thesis Table 3.2.
    pub stroke_m: f64,
    /// Connecting-rod length L \[m\], thesis Table 3.2.
    pub conrod_m: f64,
    /// Piston-pin offset e \[m\], thesis Table 3.2 (sign assumed; effect below 0.1 %).
    pub pin_offset_m: f64,
    /// Nominal compression ratio V_d/V_c + 1, thesis Table 3.2.
    pub compression_ratio: f64,
    /// Piston crown area \[m2\] for heat transfer, thesis Table 3.2.
    pub piston_area_m2: f64,
    /// Head area / bore area \[-\], assumption.
    pub head_area_ratio: f64,
    /// Liner height exposed at top dead centre \[m\], assumption.
    pub clearance_height_m: f64,
}

impl Geometry {
    /// The engine of thesis Table 3.2.
    pub fn thesis() -> Self {
        Self {
            bore_m: 0.0875,
            stroke_m: 0.0832,
            conrod_m: 0.1566,
            pin_offset_m: 0.0008,
            compression_ratio: 9.9,
            piston_area_m2: 0.006_448_89,
            head_area_ratio: 1.15,
            clearance_height_m: 0.0005,
        }
    }

    /// Bore area pi B^2/4 \[m2\].
    pub fn bore_area_m2(&self) -> f64 {
        0.25 * PI * self.bore_m * self.bore_m
    }

    /// Displacement of one cylinder V_d = pi B^2 S/4 \[m3\].
    pub fn displacement_m3(&self) -> f64 {
        self.bore_area_m2() * self.stroke_m
    }

    /// Clearance volume V_c = V_d/(CR - 1) \[m3\].
    pub fn clearance_m3(&self) -> f64 {
        self.displacement_m3() / (self.compression_ratio - 1.0)
    }

    /// Piston travel below its highest position \[m\]; `phi_rad` is 0 at (nominal) top dead centre.
    ///
    /// x = sqrt((r+L)^2 - e^2) - r cos phi - sqrt(L^2 - (r sin phi - e)^2).
    pub fn travel_m(&self, phi_rad: f64) -> f64 {
        let (r, l, e) = (0.5 * self.stroke_m, self.conrod_m, self.pin_offset_m);
        let (s, c) = phi_rad.sin_cos();
        let side = r * s - e;
        ((r + l) * (r + l) - e * e).sqrt() - r * c - (l * l - side * side).sqrt()
    }

    /// Crank angle \[rad\] of the highest and the lowest piston position.
    pub fn dead_centres_rad(&self) -> (f64, f64) {
        let (r, l, e) = (0.5 * self.stroke_m, self.conrod_m, self.pin_offset_m);
        ((e / (r + l)).asin(), PI + (e / (l - r)).asin())
    }

    /// Cylinder volume \[m3\].
    pub fn volume_m3(&self, phi_rad: f64) -> f64 {
        self.clearance_m3() + self.bore_area_m2() * self.travel_m(phi_rad)
    }

    /// dV/dphi \[m3/rad\].
    pub fn dvolume_m3_per_rad(&self, phi_rad: f64) -> f64 {
        let (r, l, e) = (0.5 * self.stroke_m, self.conrod_m, self.pin_offset_m);
        let (s, c) = phi_rad.sin_cos();
        let side = r * s - e;
        self.bore_area_m2() * (r * s + side * r * c / (l * l - side * side).sqrt())
    }

    /// Gas-side wall area: piston, head and exposed liner \[m2\].
    pub fn wall_area_m2(&self, phi_rad: f64) -> f64 {
        self.piston_area_m2
            + self.head_area_ratio * self.bore_area_m2()
            + PI * self.bore_m * (self.travel_m(phi_rad) + self.clearance_height_m)
    }

    /// Mean piston speed c_m = 2 S N/60 \[m/s\].
    pub fn mean_piston_speed_m_s(&self, speed_rpm: f64) -> f64 {
        2.0 * self.stroke_m * speed_rpm / 60.0
    }
}
