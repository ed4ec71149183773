//! Folders of runs.

use dynocal_files::FilesError;
use dynocal_files::run_folder::RunFolder;

/// Of two runs that begin in one empty folder at once the second may find the log of the first before its marker: that is no foreign
/// folder. A log with lines in it and no marker is one.
#[test]
fn a_folder_in_which_another_run_begins_is_not_foreign() {
    let tmp = tempfile::tempdir().unwrap();
    let folder = tmp.path().join("run");
    std::fs::create_dir(&folder).unwrap();
    dynocal_files::atomic::write(&folder.join("log.txt"), b"").unwrap();
    RunFolder::open(&folder, "example", &1).unwrap();
    let other = tmp.path().join("other");
    std::fs::create_dir(&other).unwrap();
    dynocal_files::atomic::write(&other.join("log.txt"), b"a line\n").unwrap();
    assert!(matches!(RunFolder::open(&other, "example", &1), Err(FilesError::ForeignFolder { .. })));
}
