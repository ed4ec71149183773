//! Models that are already there: nothing is estimated, the records only score them.

use dynocal_files::FilesError;
use dynocal_files::dataset::{ChannelSpec, Layout, Select, Time, read_table};
use dynocal_files::measurement::{self, ReadKeys};
use dynocal_ident::data::Role;
use dynocal_ident::stored::{Quantity, StoredModel};

use super::derive::DeriveSpec;
use super::model::{StructureSpec, Target};
use super::source::Source;
use super::split::Split;
use super::validation::Validation;
use super::{Job, Keep, Overrides};

impl Job {
    /// A job without a spec that scores `models` on the data files of the command line: columns have the names of the
    /// channels, units are those of the models (others are converted), stamps are in a column of time where there is one.
    ///
    /// # Errors
    /// [`FilesError`]: no readable data file.
    pub fn of_models(models: Vec<StoredModel>, over: &Overrides) -> Result<Self, FilesError> {
        let sources: Vec<Source> = over
            .data
            .iter()
            .map(|f| Source { file: f.clone(), format: None, keys: ReadKeys::default() })
            .collect();
        let stamps = match sources.first() {
            Some(s) => measurement::time_column(&read_table(&s.file, None)?).map(|c| c.name.clone()),
            None => None,
        };
        let sample_time_s = models.first().map_or(1.0, |m| m.sample_time_s);
        let time = if let Some(column) = stamps {
            Time::Column { column, unit: None }
        } else if models.iter().all(|m| m.is_steady()) {
            Time::Steady
        } else {
            Time::Sampled { sample_time_s }
        };
        let mut channels: Vec<ChannelSpec> = Vec::new();
        let outputs = models.iter().map(|m| (m.user_output(), Role::Output));
        let all = models.iter().flat_map(|m| m.measured().into_iter().map(|q| (q, Role::Input)));
        for (q, role) in outputs.chain(all) {
            let modelled = models.iter().any(|m| m.derived.iter().any(|d| d.name == q.name));
            if !modelled && !channels.iter().any(|c| c.name == q.name) {
                channels.push(channel(&q, role));
            }
        }
        let layout = Layout { channels, time, ..Layout::default() };
        let job = Self {
            name: "scored".into(),
            sources,
            layout,
            multisine_period: None,
            split: Split::Rows { estimation: Select::All, selection: None, test: None },
            tests: Vec::new(),
            derive: Vec::new(),
            prepare: Vec::new(),
            targets: Vec::new(),
            validate: Validation::default(),
            seed: over.seed.unwrap_or(0),
            saved: Vec::new(),
            keep: Keep::default(),
            export: None,
            out: over.out.clone().unwrap_or_else(|| "runs/scored".into()).into(),
        };
        Ok(job.with_models(models))
    }

    /// The same job with `models` instead of an estimate: all its records are unseen.
    pub fn with_models(mut self, models: Vec<StoredModel>) -> Self {
        self.targets = models.iter().map(target).collect();
        for (m, d) in models.iter().flat_map(|m| m.derived.iter().map(move |d| (m, d))) {
            let role = if m.output.name == d.name { Role::Output } else { Role::Input };
            self.derive.retain(|own| own.channel.name != d.name || own.channel == *d);
            if !self.derive.iter().any(|own| own.channel.name == d.name) {
                self.derive.push(DeriveSpec { channel: d.clone(), role });
            }
        }
        self.saved = models;
        // Nothing is estimated: nothing new could leave.
        self.export = None;
        self
    }
}

fn channel(q: &Quantity, role: Role) -> ChannelSpec {
    ChannelSpec {
        column: q.name.clone(),
        name: q.name.clone(),
        unit: Some(q.unit.clone()),
        convert: true,
        role,
    }
}

fn target(m: &StoredModel) -> Target {
    Target {
        target: m.output.name.clone(),
        inputs: m.inputs.iter().map(|q| q.name.clone()).collect(),
        structure: StructureSpec { name: m.structure.form().row().name.into(), keys: toml::Table::new() },
        select: None,
        warm_start_samples: 0,
        estimator: m.estimator.clone(),
        estimator_keys: toml::Table::new(),
    }
}
