//! How an error reaches the user: message, causes, and an exit code that says whose turn it is.

use surfcut::csg::TooManyProducts;
use surfcut::formats::depth_picture::DepthPictureError;
use surfcut::measure::CompareError;
use surfcut::output::OutputError;
use surfcut::output::frames::FramesError;
use surfcut::pipeline::PrepareError;
use surfcut::reference::ReferenceError;
use surfcut::scene::RepresentError;
use surfcut::scene::inline_solid::InlineSolidError;
use surfcut::scene::load::LoadError;
use surfcut::scene::toml_file::ReadSceneError;
use surfcut::scene::tree_json::TreeJsonError;
use surfcut::space::CameraError;

use super::backend::BackendError;

/// The exit codes, as the help documents them.
pub mod code {
    /// Done.
    pub const OK: u8 = 0;
    /// `check` found something to look at.
    pub const FINDINGS: u8 = 1;
    /// The command line cannot be understood.
    pub const USAGE: u8 = 2;
    /// An input cannot be used.
    pub const INPUT: u8 = 3;
    /// An output was refused.
    pub const OUTPUT: u8 = 4;
    /// `check` found that the result is certainly empty.
    pub const EMPTY: u8 = 5;
    /// The GPU cannot be used, and it was asked for.
    pub const GPU: u8 = 6;
    /// A bug.
    pub const INTERNAL: u8 = 70;
}

/// Flags that are each sound and do not go together.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// An input that cannot be drawn in the way that was asked for.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct InputError(pub String);

/// The exit code for `error`.
pub fn exit_code(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        // Before what it may be wrapped in.
        if let Some(RepresentError::NoSuchLeaf { .. }) = cause.downcast_ref() {
            return code::USAGE;
        }
        if cause.is::<UsageError>() || cause.is::<InlineSolidError>() || cause.is::<CameraError>() {
            return code::USAGE;
        }
        if cause.is::<InputError>()
            || cause.is::<ReadSceneError>()
            || cause.is::<TreeJsonError>()
            || cause.is::<LoadError>()
            || cause.is::<PrepareError>()
            || cause.is::<ReferenceError>()
            || cause.is::<TooManyProducts>()
            || cause.is::<DepthPictureError>()
            || cause.is::<CompareError>()
        {
            return code::INPUT;
        }
        if cause.is::<BackendError>() {
            return code::GPU;
        }
        if cause.is::<OutputError>() || cause.is::<FramesError>() || cause.is::<std::io::Error>() {
            return code::OUTPUT;
        }
    }
    code::INTERNAL
}

/// `error` as the user reads it: the message, then every cause that it does not repeat, then the line of a scene file
/// that it is about.
pub fn message(error: &anyhow::Error) -> String {
    let mut text = format!("error: {error}");
    for cause in error.chain().skip(1) {
        let cause = cause.to_string();
        if !text.contains(&cause) {
            text.push_str("\n  because: ");
            text.push_str(&cause);
        }
    }
    for cause in error.chain() {
        if let Some(ReadSceneError::Scene { error, line, .. }) = cause.downcast_ref() {
            text.push_str(&excerpt(error.place.line, error.place.column, line));
        }
    }
    text
}

/// The line with a mark under the mistake.
fn excerpt(line_number: usize, column: usize, line: &str) -> String {
    /// An expression may be megabytes long: show what is around the mistake.
    const WIDTH: usize = 100;
    let first = column.saturating_sub(WIDTH / 2 + 1);
    // A tab is as wide as the terminal likes; a space is not.
    let shown: String = line.chars().skip(first).take(WIDTH).map(|c| if c.is_control() { ' ' } else { c }).collect();
    let number = line_number.to_string();
    let margin = " ".repeat(number.len());
    let mark = " ".repeat(column - 1 - first);
    format!("\n {margin} |\n {number} | {shown}\n {margin} | {mark}^")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use surfcut::scene::{Scene, toml_file};

    use super::*;

    #[test]
    fn a_mistake_in_a_scene_is_shown_with_its_line() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.toml");
        std::fs::write(&path, "[leaf.a]\nfile = 'a.ply'\n\topacty = 1\n").unwrap();
        let error = anyhow::Error::new(toml_file::read(&path).unwrap_err());
        let text = message(&error);
        assert!(text.contains("a.toml:3:2: unknown key `opacty`"), "{text}");
        assert!(text.ends_with("\n   |\n 3 |  opacty = 1\n   |  ^"), "{text}");
        assert_eq!(exit_code(&error), code::INPUT);
    }

    #[test]
    fn long_lines_are_cut_around_the_mistake() {
        let line = format!("{}X{}", "a".repeat(5000), "b".repeat(5000));
        let text = excerpt(7, 5001, &line);
        let lines: Vec<_> = text.lines().collect();
        assert!(text.len() < 400);
        assert_eq!(lines[2].find('X'), lines[3].find('^'));
    }

    #[test]
    fn every_kind_has_its_code() {
        let absent = toml_file::read(Path::new("no/such/scene.toml")).unwrap_err();
        assert_eq!(exit_code(&absent.into()), code::INPUT);
        assert_eq!(exit_code(&Scene::of_operand("sphere:1").unwrap_err().into()), code::USAGE);
        assert_eq!(exit_code(&CameraError::NoDirection.into()), code::USAGE);
        assert_eq!(exit_code(&OutputError::Exists { path: "a".into() }.into()), code::OUTPUT);
        assert_eq!(exit_code(&anyhow::anyhow!("surprise")), code::INTERNAL);
    }

    #[test]
    fn causes_are_told_once() {
        let error = anyhow::Error::new(std::io::Error::other("the disk is full")).context("cannot write a.png");
        assert_eq!(message(&error), "error: cannot write a.png\n  because: the disk is full");
        let error = anyhow::anyhow!("the disk is full").context("cannot write: the disk is full");
        assert_eq!(message(&error), "error: cannot write: the disk is full");
    }
}
