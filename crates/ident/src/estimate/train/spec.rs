//! Training as a row of the table of estimators.

use dynocal_numerics::registry::{self, MemberDoc, ParamDoc};

use super::Train;
use crate::estimate::table::{EstimatorRow, Fits, Gaps};

/// Row of the table.
pub(in crate::estimate) const ROW: EstimatorRow = EstimatorRow {
    doc: MemberDoc {
        name: "train",
        what: "simulation error from several starts in parallel with early stopping on selection samples (networks)",
        params: &[
            ParamDoc { name: "starts", unit: "-", default: "12", what: "number of starts" },
            ParamDoc {
                name: "mean",
                unit: "-",
                default: "1",
                what: "number of the best starts whose free runs are averaged into one model (networks); 1: the best alone",
            },
            ParamDoc {
                name: "start",
                unit: "-",
                default: "random",
                what: "`random` weights, these trained as `one_step` prediction first, or `linear`: the direct path by least squares",
            },
            ParamDoc {
                name: "max_evaluations",
                unit: "-",
                default: "120",
                what: "most cost evaluations per start over the whole records",
            },
            ParamDoc {
                name: "horizons",
                unit: "samples",
                default: "[]",
                what: "lengths of the subrecords of earlier stages, e.g. `[20, 200]`; 1 is one-step prediction",
            },
            ParamDoc {
                name: "stage_evaluations",
                unit: "-",
                default: "30",
                what: "most cost evaluations of each earlier stage",
            },
            ParamDoc {
                name: "division",
                unit: "-",
                default: "end",
                what: "where the samples for selection and test lie: at the `end` of each record, in `blocks`, or at `random`",
            },
            ParamDoc {
                name: "selection",
                unit: "-",
                default: "0.15",
                what: "share of the samples that selects instead of being fitted",
            },
            ParamDoc {
                name: "test",
                unit: "-",
                default: "0",
                what: "share of the samples that is neither fitted nor selects",
            },
            ParamDoc { name: "block", unit: "samples", default: "50", what: "length of the blocks" },
            ParamDoc {
                name: "patience",
                unit: "-",
                default: "15",
                what: "moves without a better selection score that end a search",
            },
            ParamDoc {
                name: "penalty",
                unit: "-",
                default: "0",
                what: "weight on squared parameters (not those of the direct path), relative to the spread of the output",
            },
            ParamDoc {
                name: "spread",
                unit: "-",
                default: "0.1",
                what: "relative spread of further starts of a model without random ones",
            },
            ParamDoc {
                name: "initial",
                unit: "-",
                default: "measured",
                what: "where free runs start: `measured` outputs, or `rest`",
            },
            ParamDoc {
                name: "seed",
                unit: "-",
                default: "0",
                what: "seed of the starts and of the division",
            },
        ],
    },
    fits: Fits::Narx,
    gaps: Gaps::Bridged { free_run: true },
    build: |keys| Ok(Box::new(registry::keys::<Train>("train", keys)?)),
};
