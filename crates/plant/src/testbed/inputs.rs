//! Inputs that a bed may have beside the standard four.

use crate::inputs::Inputs;

pub(crate) struct ExtraInput {
    pub(crate) name: &'static str,
    pub(crate) unit: &'static str,
    pub(crate) range: (f64, f64),
    pub(crate) field: fn(&mut Inputs) -> &mut f64,
}

pub(crate) static EXTRA: &[ExtraInput] = &[
    ExtraInput {
        name: "intake_cam",
        unit: "deg",
        range: (180.0, 300.0),
        field: |u| &mut u.intake_mop_deg_btdc,
    },
    ExtraInput {
        name: "exhaust_cam",
        unit: "deg",
        range: (180.0, 300.0),
        field: |u| &mut u.exhaust_mop_deg_atdc,
    },
    ExtraInput { name: "wastegate", unit: "mm", range: (0.0, 28.0), field: |u| &mut u.wastegate_mm },
    ExtraInput { name: "egr", unit: "mm", range: (0.0, 25.0), field: |u| &mut u.egr_mm },
    ExtraInput { name: "wiebe_m", unit: "-", range: (0.5, 6.0), field: |u| &mut u.wiebe_m },
];

/// Row of a name.
pub(crate) fn find(name: &str) -> Option<usize> {
    EXTRA.iter().position(|i| i.name == name)
}
