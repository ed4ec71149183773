//! Files are written whole: to a temporary name in the same folder, flushed to the disk, then renamed.
//! A reader sees the old file or the new one, and a full disk or an interruption leaves the old one.

use std::fs;
use std::io::{BufWriter, Write};
use std::path::Path;

use crate::error::{FilesError, reason};

/// Writes `bytes` to `path` whole; missing parent folders are made.
///
/// # Errors
/// [`FilesError::Write`] with path and reason; what was at `path` before is then untouched.
///
/// # Examples
/// ```
/// let folder = tempfile::tempdir().unwrap();
/// let path = folder.path().join("results/gain.txt");
/// dynocal_files::atomic::write(&path, b"0.82").unwrap();
/// assert_eq!(std::fs::read(&path).unwrap(), b"0.82");
/// ```
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), FilesError> {
    write_with(path, |w| w.write_all(bytes))
}

/// As [`write()`], with the content streamed by `fill`.
///
/// # Errors
/// [`FilesError::Write`].
pub fn write_with<F>(path: &Path, fill: F) -> Result<(), FilesError>
where
    F: FnOnce(&mut dyn Write) -> std::io::Result<()>,
{
    write_io(path, fill)
        .map_err(|e| FilesError::Write { path: path.display().to_string(), reason: reason(&e) })
}

fn write_io<F>(path: &Path, fill: F) -> std::io::Result<()>
where
    F: FnOnce(&mut dyn Write) -> std::io::Result<()>,
{
    // A rename onto a device or pipe would replace it, so those are written straight.
    if fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        let mut w = BufWriter::new(fs::OpenOptions::new().write(true).open(path)?);
        fill(&mut w)?;
        return w.flush();
    }
    let folder = parent(path);
    fs::create_dir_all(folder)?;
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut builder = tempfile::Builder::new();
    let prefix = format!(".{name}.");
    builder.prefix(&prefix).suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The usual permissions of a new file (less the umask), not the private ones of a temporary.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    // Dropped on any error below, which removes it.
    let file = builder.tempfile_in(folder).map_err(|e| e.into_inner_io())?;
    let mut w = BufWriter::with_capacity(1 << 16, file);
    fill(&mut w)?;
    let file = w.into_inner().map_err(|e| e.into_error())?;
    file.as_file().sync_all()?;
    file.persist(path).map_err(|e| e.error)?;
    // The rename itself reaches the disk with the folder; not every system allows that, so a failure is no error.
    if let Ok(d) = fs::File::open(folder) {
        let _ = d.sync_all();
    }
    Ok(())
}

/// The folder of `path`; `.` where there is none.
pub(crate) fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    }
}

/// tempfile wraps the error in one that hides its kind behind the path; the kind is what we report.
trait IntoInnerIo {
    fn into_inner_io(self) -> std::io::Error;
}

impl IntoInnerIo for std::io::Error {
    fn into_inner_io(self) -> std::io::Error {
        std::io::Error::from(self.kind())
    }
}
