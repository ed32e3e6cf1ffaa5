//! Readers: files in, [`PointCloud`] or [`TriMesh`] out. One file a format, each behind the same limits.
//!
//! * The format is told by the content; the extension decides only where the content does not.
//! * Sizes in headers are checked against the file's size before anything is allocated; memory stays within a few times the
//!   file's size, time linear in it.
//! * Every error names the file, the line or byte, what is wrong and what would mend it ([`ReadError`]).
//! * What is mended or left out is counted ([`Note`]); the rules are in one place, `gather.rs`.

pub mod depth_picture;
mod error;
mod gather;
mod notes;
mod obj;
mod ply;
pub mod ply_write;
mod stl;
mod text;
mod xyz;

use std::fmt;
use std::io::Read as _;
use std::path::{Path, PathBuf};

pub use error::{Place, ReadError};
pub(crate) use gather::LARGEST_COORDINATE;
pub use notes::{Note, NoteKind};
pub use ply_write::{WriteError, write_ply_cloud, write_ply_mesh};

use crate::geometry::{PointCloud, TriMesh};

/// The formats that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Format {
    /// Stanford PLY: clouds, meshes, surfels, Gaussian splats.
    Ply,
    /// STL, binary or ascii.
    Stl,
    /// Wavefront OBJ.
    Obj,
    /// Points as text.
    Xyz,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => "PLY",
            Self::Stl => "STL",
            Self::Obj => "OBJ",
            Self::Xyz => "text points",
        })
    }
}

/// How to read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ReadOptions {
    /// Leave out points and vertices with values that are not finite, instead of refusing the file.
    pub drop_invalid: bool,
    /// Take the vertices of a mesh as points.
    pub as_points: bool,
}

/// Hears how far a reader is. Calls are some thousand rows apart.
pub trait Progress: Sync {
    /// `bytes` will be read in all.
    fn set_len(&self, bytes: u64);
    /// `bytes` more have been read.
    fn advance(&self, bytes: u64);
}

/// Tells nobody.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn set_len(&self, _bytes: u64) {}
    fn advance(&self, _bytes: u64) {}
}

/// What a file holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Geometry {
    /// Points.
    Cloud(PointCloud),
    /// Triangles.
    Mesh(TriMesh),
}

/// What a file says that it holds, before anything was joined or left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Stated {
    /// Points or vertices. (For STL, which has corners only: the different ones.)
    pub points: u64,
    /// Faces, before polygons and strips are cut into triangles.
    pub faces: u64,
}

/// A file that has been read.
#[derive(Debug, Clone, PartialEq)]
pub struct Loaded {
    /// In leaf space.
    pub geometry: Geometry,
    /// How it was read.
    pub format: Format,
    /// The file's size.
    pub bytes: u64,
    /// What the file says that it holds.
    pub stated: Stated,
    /// What was noticed.
    pub notes: Vec<Note>,
}

impl Loaded {
    /// How many times a thing was noticed.
    pub fn count(&self, kind: NoteKind) -> u64 {
        self.notes.iter().filter(|note| note.kind == kind).map(|note| note.count).sum()
    }

    /// Whether the normals may point inwards or outwards: such a cloud has no inside of its own.
    pub fn is_unoriented(&self) -> bool {
        self.count(NoteKind::Unoriented) > 0
    }
}

/// The most bytes taken from a pipe, whose size is not known before: 16 GiB.
const LARGEST_PIPE: u64 = 16 << 30;

/// Reads the file at `path`.
///
/// # Errors
/// [`ReadError`] says what is wrong, where, and what would mend it.
pub fn read(path: &Path, options: &ReadOptions, progress: &dyn Progress) -> Result<Loaded, ReadError> {
    read_bytes(path, &slurp(path)?, options, progress)
}

fn slurp(path: &Path) -> Result<Vec<u8>, ReadError> {
    let fail = |source: std::io::Error| {
        let path = path.to_owned();
        match source.kind() {
            std::io::ErrorKind::NotFound => ReadError::Absent { path },
            std::io::ErrorKind::PermissionDenied => ReadError::Permission { path },
            std::io::ErrorKind::IsADirectory => ReadError::Directory { path },
            _ => ReadError::Io { path, source },
        }
    };
    // Asked before opening: opening a pipe or a device can block or have effects.
    let kind = std::fs::metadata(path).map_err(fail)?.file_type();
    if kind.is_dir() {
        return Err(ReadError::Directory { path: path.to_owned() });
    }
    if kind.is_file() {
        return std::fs::read(path).map_err(fail);
    }
    #[cfg(unix)]
    if std::os::unix::fs::FileTypeExt::is_fifo(&kind) {
        let mut bytes = Vec::new();
        let pipe = std::fs::File::open(path).map_err(fail)?;
        pipe.take(LARGEST_PIPE + 1).read_to_end(&mut bytes).map_err(fail)?;
        if bytes.len() as u64 > LARGEST_PIPE {
            return Err(fail(std::io::Error::other("more than 16 GiB come from this pipe")));
        }
        return Ok(bytes);
    }
    Err(ReadError::NotAFile { path: path.to_owned() })
}

/// Reads `bytes` as if they were the content of a file called `name`.
///
/// # Errors
/// As [`read`].
pub fn read_bytes(
    name: &Path,
    bytes: &[u8],
    options: &ReadOptions,
    progress: &dyn Progress,
) -> Result<Loaded, ReadError> {
    let format = detect(name, bytes)?;
    read_as(format, name, bytes, options, progress)
}

/// Reads `bytes` in a given format, whatever they look like; `name` is for messages.
///
/// # Errors
/// As [`read`].
pub fn read_as(
    format: Format,
    name: &Path,
    bytes: &[u8],
    options: &ReadOptions,
    progress: &dyn Progress,
) -> Result<Loaded, ReadError> {
    progress.set_len(bytes.len() as u64);
    let gathered = match format {
        Format::Ply => ply::read(bytes, options, progress),
        Format::Stl => stl::read(bytes, progress),
        Format::Obj => obj::read(bytes, options, progress),
        Format::Xyz => xyz::read(bytes, progress),
    };
    let finished = gathered.and_then(|(gather, stated)| {
        let (geometry, notes) = gather.finish(options)?;
        Ok(Loaded { geometry, format, bytes: bytes.len() as u64, stated, notes })
    });
    finished.map_err(|fault| fault.in_file(name.to_owned(), format))
}

/// Beginnings of files that are recognised in order to say what to do with them.
const KNOWN_OTHERS: [(&[u8], &str, &str); 13] = [
    (b"# .PCD", "a PCD cloud", "convert it to PLY"),
    (b"LASF", "a LAS or LAZ cloud", "convert it to PLY (for instance with PDAL)"),
    (b"ASTM-E57", "an E57 scan", "convert it to PLY (for instance with CloudCompare)"),
    (b"[Expe/PointSet", "an Expe surfel file", "convert it to PLY"),
    (b"glTF", "a binary glTF", "convert it to PLY, STL or OBJ"),
    (b"OFF", "an OFF mesh", "convert it to PLY, STL or OBJ"),
    (b"COFF", "an OFF mesh", "convert it to PLY, STL or OBJ"),
    (b"\x1f\x8b", "a gzip archive", "unpack it first (gunzip)"),
    (b"PK\x03\x04", "a zip archive (3MF is one)", "unpack it first, or export PLY, STL or OBJ"),
    (b"\xff\xfe", "text in UTF-16", "save it as UTF-8"),
    (b"\xfe\xff", "text in UTF-16", "save it as UTF-8"),
    (b"<?xml", "an XML document", "convert it to PLY, STL or OBJ"),
    (b"{", "a JSON document", "convert it to PLY, STL or OBJ"),
];

/// Tells the format, by content first.
fn detect(name: &Path, bytes: &[u8]) -> Result<Format, ReadError> {
    let path = || PathBuf::from(name);
    let extension = name.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).unwrap_or_default();
    if bytes.is_empty() {
        let format = by_extension(&extension).unwrap_or(Format::Xyz);
        let (what, mend) = ("the file is empty (0 bytes)".to_owned(), "copy or export it again".into());
        return Err(ReadError::Empty { path: path(), format, what, mend });
    }
    if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
        return Ok(Format::Ply);
    }
    if stl::is_binary_by_size(bytes) {
        return Ok(Format::Stl);
    }
    if let Some(&(_, name, mend)) = KNOWN_OTHERS.iter().find(|(magic, ..)| bytes.starts_with(magic)) {
        return Err(ReadError::Unsupported { path: path(), name, mend });
    }
    if stl::is_ascii(bytes) {
        return Ok(Format::Stl);
    }
    by_first_word(bytes)
        .or_else(|| by_extension(&extension))
        .ok_or_else(|| ReadError::UnknownFormat { path: path(), beginning: error::quote(bytes) })
}

fn by_extension(extension: &str) -> Option<Format> {
    match extension {
        "ply" => Some(Format::Ply),
        "stl" => Some(Format::Stl),
        "obj" => Some(Format::Obj),
        "xyz" | "txt" | "pts" | "asc" | "csv" | "pwn" | "xyzn" | "xyzrgb" => Some(Format::Xyz),
        _ => None,
    }
}

/// Text whose first word is a number, or an OBJ statement.
fn by_first_word(bytes: &[u8]) -> Option<Format> {
    /// A comment at the beginning may be long.
    const SNIFFED: usize = 64 * 1024;
    let head = &bytes[..bytes.len().min(SNIFFED)];
    if head.contains(&0) {
        return None;
    }
    for line in text::Lines::of_file(head) {
        let mut words = text::Words::new(line, text::Separators::Columns);
        let Some(first) = words.next() else { continue };
        match first.bytes {
            word if word.starts_with(b"#") || word.starts_with(b"//") => {}
            b"v" | b"vn" | b"vt" | b"f" | b"o" | b"g" | b"s" | b"mtllib" | b"usemtl" => return Some(Format::Obj),
            word if text::number(word).is_some() => return Some(Format::Xyz),
            _ => return None,
        }
    }
    None
}
