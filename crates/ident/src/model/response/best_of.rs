//! The best of several response models by nested validation, as a kind of its own.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::Deserialize;

use super::choose::{Candidate, choose};
use super::score::FoldKind;
use super::{Learn, Learnt, Points, ResponseError};

pub(super) const MEMBER: Member<dyn Learn> = Member {
    doc: MemberDoc {
        name: "best_of",
        what: "one of several response models: the first within one standard error of the best in folds",
        params: &[
            ParamDoc {
                name: "models",
                unit: "-",
                default: "",
                what: "list of tables, the simplest first, each with `kind` and the keys of that kind",
            },
            ParamDoc { name: "folds", unit: "-", default: "5", what: "number of folds, inner and outer" },
            ParamDoc {
                name: "held_out",
                unit: "-",
                default: "\"shuffled\"",
                what: "shuffled: dealt at random, repeated operating points together; interleaved: every k-th point; blocks: consecutive rows",
            },
        ],
    },
    build: |keys| Ok(Box::new(BestOf::parse(keys)?)),
};

/// Fewest and most folds.
const FOLDS: [usize; 2] = [2, 50];

/// Candidates, of which one is taken.
pub struct BestOf {
    /// Them, the simplest first.
    pub candidates: Vec<Candidate>,
    /// Number of folds, inner and outer.
    pub folds: usize,
    /// How points are held out.
    pub held_out: FoldKind,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    models: Vec<toml::Table>,
    #[serde(default = "five")]
    folds: usize,
    #[serde(default)]
    held_out: FoldKind,
}

fn five() -> usize {
    5
}

impl BestOf {
    fn parse(keys: &toml::Table) -> Result<Self, BuildError> {
        let keys: Keys = registry::keys("best_of", keys)?;
        let wrong = |message: String| BuildError::Keys { member: "best_of".into(), message };
        if !(FOLDS[0]..=FOLDS[1]).contains(&keys.folds) {
            let [least, most] = FOLDS;
            return Err(wrong(format!("`folds` is {}, expected {least} to {most}", keys.folds)));
        }
        let candidates = super::mean_of::members("best_of", keys.models)?;
        let candidates = candidates.into_iter().map(|(name, kind)| Candidate { name, kind }).collect();
        Ok(Self { candidates, folds: keys.folds, held_out: keys.held_out })
    }
}

impl Learn for BestOf {
    fn learn(&self, points: &Points, interrupt: &dyn Fn() -> bool) -> Result<Learnt, ResponseError> {
        let (mut learnt, choice) = choose(&self.candidates, points, self.folds, self.held_out, interrupt)?;
        learnt.notes.insert(0, choice.words.clone());
        learnt.choice = Some(choice);
        Ok(learnt)
    }
}
