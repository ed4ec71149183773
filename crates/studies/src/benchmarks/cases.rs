//! The benchmarks: their specs, test records and published numbers (free-run RMSE).
//!
//! Published: M. D. Champneys, G. I. Beintema, R. Toth, M. Schoukens, T. J. Rogers, Baseline results for selected nonlinear
//! system identification benchmarks, arXiv:2405.10779 (2024).

/// What a number is held against.
#[derive(Clone, Copy)]
pub(super) enum Against {
    /// The published number of the same kind of model, by whom, and the best NARX of any kind.
    Published { value: f64, by: &'static str, best: f64 },
    /// What is asked of a network, and the published number of one.
    Wanted { value: f64, published: f64 },
    /// A linear ARX fitted in the same run.
    Linear,
    /// Nothing: reported with what is known.
    Nothing { published: &'static str },
}

/// One number.
pub(super) struct Row {
    pub(super) part: &'static str,
    pub(super) output: &'static str,
    pub(super) unit: &'static str,
    /// From the unit of the record to that of the number.
    pub(super) factor: f64,
    pub(super) against: Against,
}

/// One benchmark with one kind of model.
pub(super) struct Case {
    pub(super) name: &'static str,
    pub(super) title: &'static str,
    pub(super) what: &'static str,
    pub(super) spec: &'static str,
    pub(super) rows: &'static [Row],
    /// Whether it takes part at reduced length.
    pub(super) small: bool,
    /// na, nb, nk of the linear ARX beside it.
    pub(super) linear: (usize, usize, usize),
    /// Whether the output belongs to the name of a check.
    pub(super) several_outputs: bool,
}

/// What the task of the linear model has in its name.
pub(super) const LINEAR: &str = "-linear-arx";

const fn published(value: f64, best: f64) -> Against {
    Against::Published { value, by: "polynomial NARX", best }
}

macro_rules! spec {
    ($name:literal) => {
        include_str!(concat!("../../../../examples/benchmarks/", $name, ".toml"))
    };
}

const fn row(
    part: &'static str,
    output: &'static str,
    unit: &'static str,
    factor: f64,
    against: Against,
) -> Row {
    Row { part, output, unit, factor, against }
}

const fn bosch(output: &'static str) -> Row {
    row("test", output, "-", 1.0, Against::Linear)
}

const fn bouc_wen(part: &'static str) -> Row {
    row(part, "y", "um", 1e6, Against::Linear)
}

/// All benchmarks.
pub(super) static CASES: &[Case] = &[
    Case {
        name: "silverbox",
        title: "Silverbox, polynomial",
        what: "An electronic oscillator with a cubic spring. Estimated on ten realisations of a multisine, tested on another \
               and on the growing noise arrow, whose head leaves the range of the estimation.",
        spec: spec!("silverbox"),
        rows: &[
            row("multisine", "y", "mV", 1e3, published(0.640, 0.301)),
            row("arrow_full", "y", "mV", 1e3, published(2.25, 0.60)),
            row("arrow_no_extrapolation", "y", "mV", 1e3, published(0.571, 0.259)),
        ],
        small: false,
        linear: (10, 11, 0),
        several_outputs: false,
    },
    Case {
        name: "silverbox_neural",
        title: "Silverbox, neural",
        what: "The same records; the network is trained in free run.",
        spec: spec!("silverbox_neural"),
        rows: &[
            row("multisine", "y", "mV", 1e3, Against::Wanted { value: 1.5, published: 2.80 }),
            row(
                "arrow_full",
                "y",
                "mV",
                1e3,
                Against::Nothing { published: "published neural NARX: 5.18 mV" },
            ),
            row(
                "arrow_no_extrapolation",
                "y",
                "mV",
                1e3,
                Against::Nothing { published: "published neural NARX: 2.40 mV" },
            ),
        ],
        small: false,
        linear: (10, 11, 0),
        several_outputs: false,
    },
    Case {
        name: "cascaded_tanks",
        title: "Cascaded tanks, polynomial",
        what: "Water from a pump through an upper into a lower tank, whose level is measured; both overflow.",
        spec: spec!("cascaded_tanks"),
        rows: &[row("official_test", "y", "V", 1.0, published(0.413, 0.413))],
        small: true,
        linear: (8, 9, 0),
        several_outputs: false,
    },
    Case {
        name: "cascaded_tanks_neural",
        title: "Cascaded tanks, neural",
        what: "The same records; the network is trained in free run.",
        spec: spec!("cascaded_tanks_neural"),
        rows: &[row("official_test", "y", "V", 1.0, Against::Wanted { value: 0.45, published: 2.04 })],
        small: true,
        linear: (8, 9, 0),
        several_outputs: false,
    },
    Case {
        name: "emps",
        title: "EMPS, polynomial",
        what: "An electro-mechanical positioning system: 25 s of positions from the motor force alone.",
        spec: spec!("emps"),
        rows: &[row("official_test", "position", "mm", 1e3, published(5.17, 5.17))],
        small: false,
        linear: (10, 11, 0),
        several_outputs: false,
    },
    Case {
        name: "bouc_wen",
        title: "Bouc-Wen, polynomial",
        what: "A simulated oscillator with hysteresis.",
        spec: spec!("bouc_wen"),
        rows: &[bouc_wen("multisine"), bouc_wen("sinesweep")],
        small: false,
        linear: (10, 11, 0),
        several_outputs: false,
    },
    Case {
        name: "bosch_engine",
        title: "Real gasoline engine, eight outputs",
        what: "A gasoline engine on its bed, standardised channels; twelve unseen trajectories.",
        spec: spec!("bosch_engine"),
        rows: &[
            bosch("particle_number"),
            bosch("CO"),
            bosch("CO2"),
            bosch("HC"),
            bosch("NOx"),
            bosch("O2"),
            bosch("T_exhaust_manifold"),
            bosch("T_catalyst1"),
        ],
        small: false,
        linear: (2, 5, 1),
        several_outputs: true,
    },
];
