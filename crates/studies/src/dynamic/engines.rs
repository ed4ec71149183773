//! Engines that a scenario is run on: its own with many seeds, engines like it, and engines of another kind.

/// Engines of another kind than the boosted one: one that differs in structure, and the one with a measured engine behind it. The port-injection
/// engine and that of the thesis have none.
pub(super) const UNLIKE: [&str; 2] = ["other_1_8l", "twin_2l"];

/// What a check is over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Group {
    /// The scenario's own engine: the mean of its seeds.
    Own,
    /// Engines like it (`perturbed:`): the worst.
    Like,
    /// Engines of another kind: the worst.
    Unlike,
}

impl Group {
    pub(super) const ALL: [Self; 3] = [Self::Own, Self::Like, Self::Unlike];

    pub(super) fn of(own: &str, engine: &str) -> Self {
        if engine == own {
            Self::Own
        } else if engine.starts_with("perturbed:") {
            Self::Like
        } else {
            Self::Unlike
        }
    }

    /// What ends the name of a check, and the words that end its sentence.
    pub(super) fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Own => ("", "mean of seeds"),
            Self::Like => ("-others", "worst of engines like it"),
            Self::Unlike => ("-unlike", "worst of engines of another kind"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn engines_have_a_group() {
        let of = |engine| Group::of("gtdi_2l", engine);
        assert_eq!(of("gtdi_2l"), Group::Own);
        assert_eq!(of("perturbed:gtdi_2l:3"), Group::Like);
        assert!(UNLIKE.iter().all(|e| of(e) == Group::Unlike));
    }
}
