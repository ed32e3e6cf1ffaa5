//! Where a file goes: a path, or standard output. A path is written whole or not at all.
//!
//! A file is written beside its destination under a temporary name and moved there when it is complete, so that neither
//! an error nor an interruption leaves half a file, and a reader never sees one.

use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Why a file was not written. Nothing was left behind.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The destination exists and nobody asked to overwrite it.
    #[error("{} exists already: pass --overwrite to replace it, or name another file", path.display())]
    Exists {
        /// The destination.
        path: PathBuf,
    },
    /// The destination is a directory.
    #[error("{} is a directory: name a file in it", path.display())]
    IsDirectory {
        /// The destination.
        path: PathBuf,
    },
    /// The destination's directory does not exist.
    #[error("cannot write {}: the directory {} does not exist; create it first", path.display(), directory.display())]
    NoDirectory {
        /// The destination.
        path: PathBuf,
        /// What is missing.
        directory: PathBuf,
    },
    /// A picture's name tells no format.
    #[error("{} does not end in .png or .exr: one of them says how to write the picture", path.display())]
    UnknownFormat {
        /// The destination.
        path: PathBuf,
    },
    /// The system refused.
    #[error("cannot write {destination}: {source}")]
    Io {
        /// The destination.
        destination: Destination,
        /// The system's words.
        source: io::Error,
    },
    /// The picture cannot be put into the format.
    #[error("cannot write {destination}: {reason}")]
    Encode {
        /// The destination.
        destination: Destination,
        /// The encoder's words.
        reason: String,
    },
}

/// Where a file goes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Destination {
    /// Standard output.
    Stdout,
    /// A path.
    File(PathBuf),
}

impl fmt::Display for Destination {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stdout => f.write_str("standard output"),
            Self::File(path) => path.display().fmt(f),
        }
    }
}

impl From<&Path> for Destination {
    /// `-` is standard output.
    fn from(path: &Path) -> Self {
        if path.as_os_str() == "-" { Self::Stdout } else { Self::File(path.to_owned()) }
    }
}

impl Destination {
    /// Whether a file could be written here, asked before a long run rather than after it.
    ///
    /// # Errors
    /// [`OutputError`] where [`write`](Self::write) would refuse whatever the content.
    pub fn check(&self, overwrite: bool) -> Result<(), OutputError> {
        let Self::File(path) = self else { return Ok(()) };
        match fs::metadata(path) {
            Ok(found) if found.is_dir() => return Err(OutputError::IsDirectory { path: path.clone() }),
            Ok(found) if found.is_file() && !overwrite => return Err(OutputError::Exists { path: path.clone() }),
            Ok(_) => return Ok(()),
            Err(_) => {}
        }
        let directory = directory_of(path);
        if directory.is_dir() {
            Ok(())
        } else {
            Err(OutputError::NoDirectory { path: path.clone(), directory: directory.to_owned() })
        }
    }

    /// Writes `content`, whole or not at all.
    ///
    /// # Errors
    /// [`OutputError`]; an existing file is then as it was.
    pub fn write(&self, overwrite: bool, content: &[u8]) -> Result<(), OutputError> {
        self.write_with(overwrite, |sink| sink.write_all(content))
    }

    /// As [`write`](Self::write), for content that is made while it is written.
    ///
    /// # Errors
    /// As [`write`](Self::write), and what `content` returns.
    pub fn write_with(
        &self,
        overwrite: bool,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), OutputError> {
        let io_error = |source| OutputError::Io { destination: self.clone(), source };
        let Self::File(path) = self else {
            let mut sink = BufWriter::new(io::stdout().lock());
            return content(&mut sink).and_then(|()| sink.flush()).map_err(io_error);
        };
        self.check(overwrite)?;
        // A device or a pipe is written to, not replaced.
        if fs::metadata(path).is_ok_and(|found| !found.is_file()) {
            let mut sink = BufWriter::new(OpenOptions::new().write(true).open(path).map_err(io_error)?);
            return content(&mut sink).and_then(|()| sink.flush()).map_err(io_error);
        }
        // What a link points to is replaced, not the link.
        let target = fs::canonicalize(path).unwrap_or_else(|_| path.clone());
        let (mut file, temporary) = Temporary::beside(&target).map_err(io_error)?;
        let mut sink = BufWriter::new(&mut file);
        content(&mut sink).and_then(|()| sink.flush()).map_err(io_error)?;
        drop(sink);
        drop(file);
        temporary.move_to(&target, overwrite).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => OutputError::Exists { path: path.clone() },
            _ => io_error(source),
        })
    }
}

/// The directory that holds `path`, `.` where it names none.
fn directory_of(path: &Path) -> &Path {
    path.parent().filter(|directory| !directory.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// How the names of the temporary files of process `process` begin.
pub(super) fn temporary_prefix(process: u32) -> String {
    format!(".surfcut-{process}-")
}

/// A file that is removed when dropped, unless it was moved to its destination.
struct Temporary {
    path: PathBuf,
}

impl Temporary {
    fn beside(target: &Path) -> io::Result<(File, Self)> {
        static COUNTER: AtomicU32 = AtomicU32::new(0);
        loop {
            let number = COUNTER.fetch_add(1, Ordering::Relaxed);
            let name = format!("{}{number}.tmp", temporary_prefix(std::process::id()));
            let path = directory_of(target).join(name);
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => return Ok((file, Self { path })),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// A link fails where the destination has appeared meanwhile, which a rename would replace; file systems without
    /// links leave a moment in which that could happen.
    fn move_to(self, target: &Path, overwrite: bool) -> io::Result<()> {
        if !overwrite {
            match fs::hard_link(&self.path, target) {
                Ok(()) => return Ok(()),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => return Err(error),
                Err(_) if target.exists() => return Err(io::ErrorKind::AlreadyExists.into()),
                Err(_) => {}
            }
        }
        fs::rename(&self.path, target)
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // After a rename there is nothing to remove, and a failure to clean up is no reason to fail the run.
        let _ = fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(directory: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn an_existing_file_is_kept_unless_overwriting_was_asked_for() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.png");
        let destination = Destination::from(path.as_path());
        destination.check(false).unwrap();
        destination.write(false, b"first").unwrap();
        assert!(matches!(destination.check(false), Err(OutputError::Exists { .. })));
        assert!(matches!(destination.write(false, b"second"), Err(OutputError::Exists { .. })));
        assert_eq!(fs::read(&path).unwrap(), b"first");
        destination.write(true, b"second").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"second");
        assert_eq!(entries(directory.path()), ["a.png"]);
    }

    #[test]
    fn a_failure_half_way_leaves_what_was_there() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let destination = Destination::File(path.clone());
        let fail = |sink: &mut dyn Write| {
            sink.write_all(&[1; 100_000])?;
            Err(io::Error::other("the disk is full"))
        };
        let error = destination.write_with(false, fail).unwrap_err();
        assert!(error.to_string().contains("the disk is full"));
        assert!(entries(directory.path()).is_empty());
        fs::write(&path, b"old").unwrap();
        destination.write_with(true, fail).unwrap_err();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(entries(directory.path()), ["a.exr"]);
    }

    #[test]
    fn a_file_that_appears_during_the_run_is_kept() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.png");
        let result = Destination::File(path.clone()).write_with(false, |sink| {
            fs::write(&path, b"another program's").unwrap();
            sink.write_all(b"ours")
        });
        assert!(matches!(result, Err(OutputError::Exists { .. })));
        assert_eq!(fs::read(&path).unwrap(), b"another program's");
        assert_eq!(entries(directory.path()), ["a.png"]);
    }

    #[test]
    fn unusable_destinations_are_refused_before_a_run() {
        let directory = tempfile::tempdir().unwrap();
        let check = |path: PathBuf| Destination::File(path).check(true);
        assert!(matches!(check(directory.path().to_owned()), Err(OutputError::IsDirectory { .. })));
        assert!(matches!(check(directory.path().join("no/a.png")), Err(OutputError::NoDirectory { .. })));
        assert_eq!(Destination::from(Path::new("-")), Destination::Stdout);
    }

    #[cfg(unix)]
    #[test]
    fn devices_and_links_stay_what_they_are() {
        let directory = tempfile::tempdir().unwrap();
        Destination::from(Path::new("/dev/null")).write(false, b"gone").unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
        let (real, link) = (directory.path().join("real"), directory.path().join("link"));
        fs::write(&real, b"old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        Destination::File(link.clone()).write(true, b"new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&real).unwrap(), b"new");
    }
}
