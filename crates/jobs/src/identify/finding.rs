//! What an engineer should know about an identification: graded, and grouped by what it concerns.

use serde::{Deserialize, Serialize};

/// How much it matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// The result must not be used as it is.
    Fault,
    /// The result may mislead.
    Warning,
    /// Good to know.
    Note,
}

impl Grade {
    /// The word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Fault => "fault",
            Self::Warning => "warning",
            Self::Note => "note",
        }
    }
}

/// What others than a reader must tell apart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Topic {
    /// Nothing that anything but a reader asks for.
    #[default]
    General,
    /// No unseen record judges the model.
    NoTestData,
    /// Values in the records that no sensor gave, or that say the same twice: nothing else is worth trying before them.
    Values,
}

/// One of them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    /// How much it matters.
    pub grade: Grade,
    /// What it concerns: a target, or a part of the data.
    pub about: String,
    /// In a sentence.
    pub text: String,
    /// What it is to a program.
    #[serde(default)]
    pub topic: Topic,
}

impl Finding {
    /// A new one.
    pub fn new(grade: Grade, about: impl Into<String>, text: impl Into<String>) -> Self {
        Self { grade, about: about.into(), text: text.into(), topic: Topic::General }
    }

    /// The same under a topic.
    pub fn on(self, topic: Topic) -> Self {
        Self { topic, ..self }
    }

    /// With what it concerns.
    pub fn sentence(&self) -> String {
        if self.about.is_empty() { self.text.clone() } else { format!("{}: {}", self.about, self.text) }
    }
}

/// The worst first, equal ones once, the order of equals kept.
pub fn sorted(mut found: Vec<Finding>) -> Vec<Finding> {
    let mut seen: Vec<Finding> = Vec::with_capacity(found.len());
    found.retain(|f| {
        let new = !seen.contains(f);
        if new {
            seen.push(f.clone());
        }
        new
    });
    found.sort_by_key(|f| f.grade);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_come_first_and_equals_once() {
        let one = |grade, text: &str| Finding::new(grade, "y", text);
        let all = vec![
            one(Grade::Note, "a"),
            one(Grade::Fault, "b"),
            one(Grade::Note, "a"),
            one(Grade::Fault, "c"),
        ];
        let texts: Vec<String> = sorted(all).iter().map(Finding::sentence).collect();
        assert_eq!(texts, ["y: b", "y: c", "y: a"]);
    }
}
