//! Models that are already there: nothing is estimated, the records only score them.

use dynocal_files::FilesError;
use dynocal_files::dataset::{ChannelSpec, Layout, Missing, Select, Time, read_table};
use dynocal_ident::data::Role;

use super::model::{Family, StructureSpec, Target};
use super::source::Source;
use super::split::Split;
use super::validation::Validation;
use super::{Job, Overrides};
use crate::identify::result::{ModelFile, Quantity};
use crate::identify::stored::Stored;

impl Job {
    /// A job without a spec that scores `models` on the data files of the command line: columns have the names of the
    /// channels, units are those of the models (others are converted), stamps are in a column `time` where there is one.
    ///
    /// # Errors
    /// [`FilesError`]: no readable data file.
    pub fn of_models(models: Vec<ModelFile>, over: &Overrides) -> Result<Self, FilesError> {
        let sources: Vec<Source> =
            over.data.iter().map(|f| Source { file: f.clone(), format: None }).collect();
        let stamped = match sources.first() {
            Some(s) => read_table(&s.file, None)?.column("time").is_ok(),
            None => false,
        };
        let sample_time_s = models.first().map_or(1.0, |m| m.sample_time_s);
        let time = if stamped {
            Time::Column { column: "time".into(), unit: None }
        } else {
            Time::Sampled { sample_time_s }
        };
        let mut channels: Vec<ChannelSpec> = Vec::new();
        let outputs = models.iter().map(|m| (&m.output, Role::Output));
        let inputs = models.iter().flat_map(|m| m.inputs.iter().map(|q| (q, Role::Input)));
        for (q, role) in outputs.chain(inputs) {
            if !channels.iter().any(|c| c.name == q.name) {
                channels.push(channel(q, role));
            }
        }
        let layout = Layout { channels, time, trajectory: None, init_samples: 0, missing: Missing::Refuse };
        let job = Self {
            name: "scored".into(),
            sources,
            layout,
            multisine_period: None,
            split: Split::Rows { estimation: Select::All, selection: None, test: None },
            tests: Vec::new(),
            prepare: Vec::new(),
            targets: Vec::new(),
            validate: Validation::default(),
            seed: over.seed.unwrap_or(0),
            saved: Vec::new(),
            out: over.out.clone().unwrap_or_else(|| "runs/scored".into()),
        };
        Ok(job.with_models(models))
    }

    /// The same job with `models` instead of an estimate: all its records are unseen.
    pub fn with_models(mut self, models: Vec<ModelFile>) -> Self {
        self.targets = models.iter().map(target).collect();
        self.saved = models;
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

fn target(m: &ModelFile) -> Target {
    let (name, family) = match &m.structure {
        Stored::Polynomial(_) => ("polynomial", Family::Narx),
        Stored::Neural(_) => ("neural", Family::Narx),
        Stored::Linear(_) => ("linear", Family::Linear),
        Stored::Narmax(_) => ("narmax", Family::Narmax),
    };
    Target {
        target: m.output.name.clone(),
        inputs: m.inputs.iter().map(|q| q.name.clone()).collect(),
        structure: StructureSpec { name: name.into(), keys: toml::Table::new(), family },
        select: None,
        warm_start_samples: 0,
        estimator: m.estimator.clone(),
        estimator_keys: toml::Table::new(),
    }
}
