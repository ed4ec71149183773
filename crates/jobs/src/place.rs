//! Where a run goes, and what a face may change in a spec.

use std::path::{Component, Path, PathBuf};

use dynocal_files::run_folder::RunPlace;
use dynocal_files::spec::Faults;

/// What a face (the command line, a program) changes in a spec.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Seed of every random choice.
    pub seed: Option<u64>,
    /// Run folder.
    pub out: Option<PathBuf>,
}

/// Name and folder of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Name.
    pub name: String,
    /// Folder.
    pub out: RunPlace,
}

impl Place {
    /// The place of a run: its folder is that of the face, else `out` of the spec (relative to the folder of the spec),
    /// else `runs/NAME`; its name is that of the spec, else the stem of the spec's file.
    ///
    /// A name that is no single name of a folder (`../x`, `/tmp/x`, `a/b`) is a fault: it would write outside of `runs`.
    ///
    /// ```
    /// use std::path::Path;
    /// use dynocal_files::spec::Faults;
    /// use dynocal_jobs::place::Place;
    /// let mut faults = Faults::default();
    /// let place = Place::of(Path::new("specs/test.toml"), None, None, None, &mut faults);
    /// assert_eq!(&*place.out, Path::new("runs/test"));
    /// assert!(faults.is_empty());
    /// Place::of(Path::new("specs/test.toml"), Some("../../etc"), None, None, &mut faults);
    /// assert!(!faults.is_empty());
    /// ```
    pub fn of(
        spec: &Path,
        name: Option<&str>,
        out: Option<&Path>,
        face: Option<&Path>,
        faults: &mut Faults,
    ) -> Self {
        let stem = spec.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let name = name.map_or(stem, str::to_string);
        if !is_name(&name) {
            faults.push(
                "name",
                format!("`{name}`"),
                "a name of one folder: no `/`, no `\\`, not `..`, not empty",
            );
        }
        let folder = spec.parent().unwrap_or(Path::new(""));
        let chosen = face.map(Path::to_path_buf).or(out.map(|o| folder.join(o)));
        let own = || RunPlace::named_after(Path::new("runs").join(&name), spec);
        Self { out: chosen.map_or_else(own, RunPlace::from), name }
    }

    /// The place of a run without a spec.
    pub fn run(name: &str, face: Option<&Path>) -> Self {
        let out = face.map_or_else(|| Path::new("runs").join(name), Path::to_path_buf);
        Self { out: out.into(), name: name.into() }
    }
}

/// Whether `name` is the name of one folder or file.
pub fn is_name(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    let one = matches!((parts.next(), parts.next()), (Some(Component::Normal(p)), None) if p == name);
    one && !name.contains(['/', '\\']) && !name.chars().any(char::is_control)
}

#[cfg(test)]
mod tests {
    use super::is_name;

    #[test]
    fn a_name_is_one_folder() {
        assert!(["run", "run 1", "a.b", "..a", "Prüfstand"].iter().all(|n| is_name(n)));
        assert!(["", ".", "..", "../a", "/a", "a/b", "a/", "a\\b", "./a", "a\n"].iter().all(|n| !is_name(n)));
    }
}
