//! What can go wrong while a file is read, with its place and what would mend it.

use std::borrow::Cow;
use std::fmt;
use std::path::PathBuf;

use super::Format;

/// Where in a file something is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// A line, counted from 1.
    Line(u64),
    /// A line and a column in bytes, both counted from 1.
    Column {
        /// Line, from 1.
        line: u64,
        /// Byte in the line, from 1.
        column: u64,
    },
    /// A byte offset, counted from 0.
    Byte(u64),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Column { line, column } => write!(f, "line {line}, column {column}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
        }
    }
}

/// Why a file could not be read. Every message names the file, what is wrong, where, and what would mend it.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// There is no such file.
    #[error("{path}: there is no such file; check the name (relative names start from the scene's or the working directory)", path = path.display())]
    Absent {
        /// The path as asked for.
        path: PathBuf,
    },
    /// The path is a directory.
    #[error("{path}: this is a directory; name a file in it", path = path.display())]
    Directory {
        /// The path as asked for.
        path: PathBuf,
    },
    /// The path is a device or a socket.
    #[error("{path}: this is neither a file nor a pipe; name a file", path = path.display())]
    NotAFile {
        /// The path as asked for.
        path: PathBuf,
    },
    /// The file may not be read.
    #[error("{path}: reading is not permitted; change the file's permissions (chmod u+r) or copy it", path = path.display())]
    Permission {
        /// The path as asked for.
        path: PathBuf,
    },
    /// The system failed to hand over the file.
    #[error("{path}: cannot be read: {source}", path = path.display())]
    Io {
        /// The path as asked for.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Neither the content nor the extension tells the format.
    #[error(
        "{path}: the format is not known: the file begins with {beginning}; surfcut reads PLY, STL, OBJ and text points \
         (.xyz, .txt, .pts)", path = path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// Its first bytes, readable.
        beginning: String,
    },
    /// A format that is recognised and not read.
    #[error("{path}: this is {name}, which surfcut does not read; {mend}", path = path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What the file is.
        name: &'static str,
        /// What to do instead.
        mend: &'static str,
    },
    /// The content breaks the format's rules, or is cut off.
    #[error("{path}: {format}, {place}: {what}; {mend}", path = path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// How it was read.
        format: Format,
        /// Where.
        place: Place,
        /// What is wrong.
        what: String,
        /// What would mend it.
        mend: Cow<'static, str>,
    },
    /// Values that are not finite numbers, or not possible ones (a radius of 0).
    #[error(
        "{path}: {format}: {count} {rows} with unusable values, the first at {first}: {what}; mend the file, or leave them \
         out with --drop-invalid", path = path.display(), rows = if *count == 1 { "point" } else { "points" }
    )]
    Invalid {
        /// The file.
        path: PathBuf,
        /// How it was read.
        format: Format,
        /// Points or vertices concerned.
        count: u64,
        /// Where the first one is.
        first: Place,
        /// What is wrong with the first one.
        what: String,
    },
    /// Nothing to draw.
    #[error("{path}: {format}: {what}; {mend}", path = path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// How it was read.
        format: Format,
        /// What is missing.
        what: String,
        /// What would mend it.
        mend: Cow<'static, str>,
    },
}

impl ReadError {
    /// The file that the error is about.
    pub fn path(&self) -> &std::path::Path {
        match self {
            Self::Absent { path }
            | Self::Directory { path }
            | Self::NotAFile { path }
            | Self::Permission { path }
            | Self::Io { path, .. }
            | Self::UnknownFormat { path, .. }
            | Self::Unsupported { path, .. }
            | Self::Malformed { path, .. }
            | Self::Invalid { path, .. }
            | Self::Empty { path, .. } => path,
        }
    }

    /// The place in the file that the error is about, where there is one.
    pub fn place(&self) -> Option<Place> {
        match self {
            Self::Malformed { place, .. } | Self::Invalid { first: place, .. } => Some(*place),
            _ => None,
        }
    }
}

/// An error inside a reader, which knows neither the file's name nor its own format's.
#[derive(Debug)]
pub(super) enum Fault {
    Malformed { place: Place, what: String, mend: Cow<'static, str> },
    Invalid { count: u64, first: Place, what: String },
    Empty { what: String, mend: Cow<'static, str> },
}

impl Fault {
    pub fn malformed(place: Place, what: impl Into<String>, mend: impl Into<Cow<'static, str>>) -> Self {
        Self::Malformed { place, what: what.into(), mend: mend.into() }
    }

    pub fn empty(what: impl Into<String>, mend: impl Into<Cow<'static, str>>) -> Self {
        Self::Empty { what: what.into(), mend: mend.into() }
    }

    pub fn in_file(self, path: PathBuf, format: Format) -> ReadError {
        match self {
            Self::Malformed { place, what, mend } => ReadError::Malformed { path, format, place, what, mend },
            Self::Invalid { count, first, what } => ReadError::Invalid { path, format, count, first, what },
            Self::Empty { what, mend } => ReadError::Empty { path, format, what, mend },
        }
    }
}

/// The advice where a file ends too early.
pub(super) const CUT_OFF: &str = "the file was cut off or its header is wrong: copy or export it again";

/// Bytes as a short quotation that is safe to print.
pub(super) fn quote(bytes: &[u8]) -> String {
    /// Longest quotation in a message, bytes.
    const LONGEST: usize = 40;
    let shown: String =
        String::from_utf8_lossy(&bytes[..bytes.len().min(LONGEST)]).chars().flat_map(char::escape_default).collect();
    if bytes.len() > LONGEST { format!("'{shown}…'") } else { format!("'{shown}'") }
}
