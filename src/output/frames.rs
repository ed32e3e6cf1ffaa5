//! The files of a sequence, one for each frame, and the record of those that are done, so that a run that was stopped goes
//! on where it stopped.
//!
//! *Practice.* A file gets its name only when it is whole ([`Destination`]); then a line in the record says so, with the
//! file's length. The record begins with hashes of what the frames depend on: a run with other settings or another scene
//! would leave a film of two halves, so it is refused. A run that is killed between a file's move and its line draws that
//! one frame again.
//!
//! The record is a file beside the frames, one JSON object a line: it grows by a line a frame, however many there are.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Destination, OutputError};

/// What stands for a frame's number in an output's name.
pub const FRAME_MARK: &str = "{frame}";

/// Numbers have at least this many digits, so that a longer run later sorts with a shorter one.
const LEAST_DIGITS: usize = 4;

/// The names of a sequence's files: all in one directory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameNames {
    directory: PathBuf,
    before: String,
    after: String,
    digits: usize,
}

impl FrameNames {
    /// From a path whose file name holds [`FRAME_MARK`], for `frames` frames; `None` where it does not.
    pub fn parse(path: &Path, frames: usize) -> Option<Self> {
        let (before, after) = path.file_name()?.to_str()?.split_once(FRAME_MARK)?;
        let digits = frames.saturating_sub(1).to_string().len().max(LEAST_DIGITS);
        let directory = path.parent().unwrap_or(Path::new("")).to_owned();
        Some(Self { directory, before: before.to_owned(), after: after.to_owned(), digits })
    }

    /// Where the files are.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// The file of frame `frame`, counted from 0.
    pub fn path(&self, frame: usize) -> PathBuf {
        self.directory.join(format!("{}{frame:0digits$}{}", self.before, self.after, digits = self.digits))
    }

    /// The file of the record.
    pub fn record_path(&self) -> PathBuf {
        self.directory.join(format!("{}frames{}.jsonl", self.before, self.after))
    }
}

/// What the frames depend on. Two runs with equal keys draw the same bytes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunKey {
    /// The program's version.
    pub surfcut: String,
    /// How many frames there are.
    pub frames: usize,
    /// A hash of the flags that a frame depends on.
    pub settings: String,
    /// A hash of the scene, of the files that it names, and of those that are merged with it.
    pub scene: String,
}

/// Why a sequence cannot be begun or gone on with.
#[derive(Debug, thiserror::Error)]
pub enum FramesError {
    /// The frames that are there were drawn by another run.
    #[error(
        "{} was begun {what}: go on with `{}`, pass --overwrite to draw all frames anew, or name other files",
        record.display(), command.join(" ")
    )]
    OtherRun {
        /// The record of that run.
        record: PathBuf,
        /// What differs, such as `with other flags`.
        what: &'static str,
        /// Its command line.
        command: Vec<String>,
    },
    /// The record is not one of this program's.
    #[error("{} is no record of a sequence: remove it, or name other files", record.display())]
    NotARecord {
        /// The file.
        record: PathBuf,
    },
    /// A file was refused.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// One line of the record.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    /// The first line.
    Begun { key: RunKey, command: Vec<String> },
    /// A process that draws frames; what it leaves under a temporary name when it is killed is known by its number.
    Process(u32),
    /// A file that is whole.
    Done { frame: usize, bytes: u64 },
}

/// A sequence under way. Nothing is written before its first frame is.
#[derive(Debug)]
pub struct Frames {
    names: FrameNames,
    done: Vec<bool>,
    /// What the record begins with.
    beginning: String,
    record: Option<File>,
}

impl Frames {
    /// Begins the sequence, or goes on with one of the same `key`; `overwrite` begins it anew. `command` is what a message
    /// tells the user of another run.
    ///
    /// # Errors
    /// [`FramesError`]; nothing was drawn over or removed.
    pub fn open(names: FrameNames, key: &RunKey, command: &[String], overwrite: bool) -> Result<Self, FramesError> {
        let path = names.record_path();
        let io_error = |source| OutputError::Io { destination: Destination::File(path.clone()), source };
        let mut done: Vec<Option<u64>> = vec![None; key.frames];
        let mut begun = command.to_vec();
        match fs::read_to_string(&path) {
            Ok(text) if !overwrite => {
                let old = Old::parse(&text).ok_or_else(|| FramesError::NotARecord { record: path.clone() })?;
                if let Some(what) = difference(&old.key, key) {
                    return Err(FramesError::OtherRun { record: path, what, command: old.command });
                }
                for (frame, bytes) in old.done {
                    let is_whole = |path| fs::metadata(path).is_ok_and(|file| file.is_file() && file.len() == bytes);
                    if frame < key.frames && is_whole(names.path(frame)) {
                        done[frame] = Some(bytes);
                    }
                }
                begun = old.command;
                old.processes.into_iter().for_each(|process| remove_leftovers(&names.directory, process));
            }
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                // Files of these names that no record knows are somebody else's.
                for frame in 0..key.frames {
                    Destination::File(names.path(frame)).check(overwrite)?;
                }
            }
            Err(error) => return Err(io_error(error).into()),
        }
        let begin = [Line::Begun { key: key.clone(), command: begun }, Line::Process(std::process::id())];
        let known = done.iter().enumerate().filter_map(|(frame, bytes)| Some(Line::Done { frame, bytes: (*bytes)? }));
        let beginning = begin.into_iter().chain(known).map(|line| line.to_text()).collect();
        Ok(Self { names, done: done.iter().map(Option::is_some).collect(), beginning, record: None })
    }

    /// The files' names.
    pub fn names(&self) -> &FrameNames {
        &self.names
    }

    /// Whether the file of frame `frame` is there and whole.
    pub fn is_done(&self, frame: usize) -> bool {
        self.done[frame]
    }

    /// Writes the file of frame `frame` by `write`, which may replace what is there, and records it.
    ///
    /// # Errors
    /// [`OutputError`]: what `write` returns, or where the record cannot grow.
    pub fn write(
        &mut self,
        frame: usize,
        write: impl FnOnce(&Destination) -> Result<(), OutputError>,
    ) -> Result<(), OutputError> {
        let record = Destination::File(self.names.record_path());
        let record_error = |source| OutputError::Io { destination: record.clone(), source };
        let mut log = match self.record.take() {
            Some(log) => log,
            None => {
                record.write(true, self.beginning.as_bytes())?;
                OpenOptions::new().append(true).open(self.names.record_path()).map_err(record_error)?
            }
        };
        let path = self.names.path(frame);
        let destination = Destination::File(path.clone());
        write(&destination)?;
        let bytes = fs::metadata(&path).map_err(|source| OutputError::Io { destination, source })?.len();
        log.write_all(Line::Done { frame, bytes }.to_text().as_bytes()).map_err(record_error)?;
        self.record = Some(log);
        self.done[frame] = true;
        Ok(())
    }
}

impl Line {
    fn to_text(&self) -> String {
        // Text and whole numbers: nothing here can fail to be JSON.
        serde_json::to_string(self).unwrap_or_default() + "\n"
    }
}

/// What a record holds.
struct Old {
    key: RunKey,
    command: Vec<String>,
    processes: Vec<u32>,
    done: Vec<(usize, u64)>,
}

impl Old {
    /// `None` where it does not begin as a record does. A last line that is torn, as a full disk leaves it, is left out.
    fn parse(text: &str) -> Option<Self> {
        let mut lines = text.lines().map_while(|line| serde_json::from_str(line).ok());
        let Some(Line::Begun { key, command }) = lines.next() else { return None };
        let mut old = Self { key, command, processes: Vec::new(), done: Vec::new() };
        for line in lines {
            match line {
                Line::Begun { .. } => return None,
                Line::Process(process) => old.processes.push(process),
                Line::Done { frame, bytes } => old.done.push((frame, bytes)),
            }
        }
        Some(old)
    }
}

/// What of `new` differs from `old`, in words that follow "was begun".
fn difference(old: &RunKey, new: &RunKey) -> Option<&'static str> {
    [
        (old.surfcut != new.surfcut, "by another version of surfcut"),
        (old.frames != new.frames, "with another number of frames"),
        (old.settings != new.settings, "with other flags"),
        (old.scene != new.scene, "with another scene, or a file of it has changed since"),
    ]
    .into_iter()
    .find_map(|(differs, what)| differs.then_some(what))
}

/// Removes what process `process` was writing when it was killed.
fn remove_leftovers(directory: &Path, process: u32) {
    let directory = if directory.as_os_str().is_empty() { Path::new(".") } else { directory };
    let prefix = super::destination::temporary_prefix(process);
    let Ok(entries) = fs::read_dir(directory) else { return };
    for entry in entries.flatten() {
        if process != std::process::id() && entry.file_name().to_string_lossy().starts_with(&prefix) {
            // A failure to clean up is no reason to fail the run.
            let _ = fs::remove_file(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key() -> RunKey {
        RunKey { surfcut: "1".into(), frames: 3, settings: "s".into(), scene: "t".into() }
    }

    fn open(directory: &Path, key: &RunKey, overwrite: bool) -> Result<Frames, FramesError> {
        let names = FrameNames::parse(&directory.join("a_{frame}.png"), key.frames).unwrap();
        Frames::open(names, key, &["surfcut".into(), "render".into()], overwrite)
    }

    fn write(frames: &mut Frames, frame: usize, content: &str) {
        frames.write(frame, |destination| destination.write(true, content.as_bytes())).unwrap();
    }

    #[test]
    fn names_are_padded_and_keep_the_directory() {
        let names = FrameNames::parse(Path::new("out/turn-{frame}.png"), 36).unwrap();
        assert_eq!(names.path(7), Path::new("out/turn-0007.png"));
        assert_eq!(names.record_path(), Path::new("out/turn-frames.png.jsonl"));
        assert_eq!(FrameNames::parse(Path::new("{frame}.exr"), 100_000).unwrap().path(5), Path::new("00005.exr"));
        assert_eq!(FrameNames::parse(Path::new("{frame}/a.png"), 3), None);
    }

    #[test]
    fn a_run_goes_on_with_the_frames_that_are_whole() {
        let directory = tempfile::tempdir().unwrap();
        let mut frames = open(directory.path(), &key(), false).unwrap();
        write(&mut frames, 0, "zero");
        write(&mut frames, 1, "one");
        drop(frames);
        // Frame 1 is cut short; a line is torn; another process left half a file.
        fs::write(directory.path().join("a_0001.png"), "o").unwrap();
        let record = directory.path().join("a_frames.png.jsonl");
        let text = fs::read_to_string(&record).unwrap().replace(&std::process::id().to_string(), "4000000000");
        fs::write(&record, text + "{\"done\":{\"fra").unwrap();
        let leftover = directory.path().join(".surfcut-4000000000-7.tmp");
        fs::write(&leftover, "half").unwrap();
        let mut frames = open(directory.path(), &key(), false).unwrap();
        assert_eq!([0, 1, 2].map(|frame| frames.is_done(frame)), [true, false, false]);
        assert!(!leftover.exists());
        write(&mut frames, 1, "one");
        drop(frames);
        assert_eq!(
            [0, 1, 2].map(|frame| open(directory.path(), &key(), false).unwrap().is_done(frame)),
            [true, true, false]
        );
        // Anew.
        assert!(!open(directory.path(), &key(), true).unwrap().is_done(0));
    }

    #[test]
    fn another_run_is_refused_by_what_differs() {
        let directory = tempfile::tempdir().unwrap();
        write(&mut open(directory.path(), &key(), false).unwrap(), 0, "zero");
        for (other, what) in [
            (RunKey { settings: "u".into(), ..key() }, "other flags"),
            (RunKey { scene: "u".into(), ..key() }, "another scene"),
            (RunKey { frames: 4, ..key() }, "number of frames"),
        ] {
            let message = open(directory.path(), &other, false).unwrap_err().to_string();
            assert!(message.contains(what) && message.contains("surfcut render"), "{message}");
        }
        fs::write(directory.path().join("a_frames.png.jsonl"), "mine").unwrap();
        assert!(matches!(open(directory.path(), &key(), false), Err(FramesError::NotARecord { .. })));
    }

    #[test]
    fn nothing_is_written_before_the_first_frame() {
        let directory = tempfile::tempdir().unwrap();
        drop(open(directory.path(), &key(), false).unwrap());
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 0);
    }

    #[test]
    fn files_that_no_record_knows_are_kept() {
        let directory = tempfile::tempdir().unwrap();
        fs::write(directory.path().join("a_0002.png"), "mine").unwrap();
        let refused = open(directory.path(), &key(), false);
        assert!(matches!(refused, Err(FramesError::Output(OutputError::Exists { .. }))));
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
    }
}
