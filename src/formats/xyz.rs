//! Points as text: `.xyz`, `.txt`, `.pts`, `.asc`, `.csv`.
//!
//! # Practice
//! One point a line; blanks, tabs, commas or semicolons between the columns; `#` and `//` begin comments; the first line may
//! be the number of points (PTS). All rows have as many columns as the first:
//!
//! | columns | meaning |
//! | --- | --- |
//! | 3 | x y z |
//! | 4 | x y z intensity |
//! | 6 | x y z, then a normal or a colour |
//! | 7 | x y z intensity r g b (PTS), or x y z, normal, one more value |
//! | 9 | x y z, then a normal and a colour in either order |
//!
//! Such files do not say what a triple is, so all rows are asked: a **normal** if every length is about 1 (or 0: missing);
//! else a **colour** if all values are whole numbers from 0 to 255, or all real numbers from 0 to 1; else a normal to be
//! brought to length 1. A note tells what was decided.

use glam::{DVec3, Vec3};

use super::error::{Fault, Place, quote};
use super::gather::{ColourRange, Gather, not_finite, unit_normal};
use super::notes::NoteKind;
use super::text::{Lines, Separators, Words};
use super::{Progress, Stated};

/// The numbers of columns that have a meaning.
const COLUMNS: [usize; 5] = [3, 4, 6, 7, 9];

/// Where the first line is a count.
struct Count {
    points: u64,
    line: u64,
}

/// Reads a whole text file of points.
pub(super) fn read(bytes: &[u8], progress: &dyn Progress) -> Result<(Gather, Stated), Fault> {
    /// Rows between two reports of progress.
    const REPORT_ROWS: usize = 8192;
    let mut gather = Gather::default();
    // What follows the coordinates, `extra` values a row.
    let mut others: Vec<f64> = Vec::new();
    let mut places: Vec<u64> = Vec::new();
    let mut columns: Option<(usize, u64)> = None;
    let mut count: Option<Count> = None;
    let mut lines = Lines::of_file(bytes);
    let mut reported = 0;
    let mut row: Vec<f64> = Vec::new();
    while let Some(line) = lines.next() {
        let mut words =
            Words::new(super::text::Line { bytes: without_comment(line.bytes), ..line }, Separators::Columns);
        row.clear();
        let mut first_word = None;
        for word in &mut words {
            first_word = first_word.or(Some(word));
            row.push(word.expect_number()?);
        }
        let Some(first_word) = first_word else { continue };
        match columns {
            None if row.len() == 1 && count.is_none() => {
                let points = first_word.integer().and_then(|n| u64::try_from(n).ok()).ok_or_else(|| {
                    let what = format!("{} alone on its line is no number of points", quote(first_word.bytes));
                    Fault::malformed(first_word.place(), what, "give each point at least three columns")
                })?;
                count = Some(Count { points, line: line.number });
                continue;
            }
            None => {
                if !COLUMNS.contains(&row.len()) {
                    let what = format!("{} columns have no meaning", row.len());
                    let mend = "use 3 (x y z), 4, 6, 7 or 9 columns";
                    return Err(Fault::malformed(Place::Line(line.number), what, mend));
                }
                columns = Some((row.len(), line.number));
            }
            Some((wanted, first_line)) if wanted != row.len() => {
                let what = format!("{} columns, but line {first_line} has {wanted}", row.len());
                return Err(Fault::malformed(words.place(), what, "give every line as many columns"));
            }
            Some(_) => {}
        }
        gather.push_position(DVec3::new(row[0], row[1], row[2]), Place::Line(line.number));
        if row.len() > 3 {
            others.extend_from_slice(&row[3..]);
            places.push(line.number);
        }
        if gather.positions.len().is_multiple_of(REPORT_ROWS) {
            progress.advance(lines.consumed() - reported);
            reported = lines.consumed();
        }
    }
    progress.advance(lines.consumed() - reported);
    let points = gather.positions.len() as u64;
    if let Some(count) = count
        && count.points != points
    {
        let what = format!("the count says {} points, but {points} follow", count.points);
        return Err(Fault::malformed(
            Place::Line(count.line),
            what,
            "copy the file again, or correct or remove the count",
        ));
    }
    let Some((columns, _)) = columns else {
        return Err(Fault::empty("there is no line with a point", "give each point a line with at least x, y and z"));
    };
    Extra { values: &others, width: columns - 3, lines: &places }.assign(&mut gather);
    Ok((gather, Stated { points, faces: 0 }))
}

/// The part of a line before `#` or `//`.
fn without_comment(line: &[u8]) -> &[u8] {
    let end =
        line.iter().enumerate().position(|(i, &b)| b == b'#' && !in_number(line, i) || line[i..].starts_with(b"//"));
    &line[..end.unwrap_or(line.len())]
}

/// Whether the `#` at `at` belongs to Microsoft's `1.#QNAN`.
fn in_number(line: &[u8], at: usize) -> bool {
    at > 0 && line[at - 1] == b'.'
}

/// What a triple of columns holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Triple {
    UnitNormal,
    Bytes,
    Units,
    Normal,
}

/// The columns after the coordinates.
struct Extra<'a> {
    values: &'a [f64],
    width: usize,
    lines: &'a [u64],
}

impl Extra<'_> {
    fn triple(&self, row: usize, from: usize) -> DVec3 {
        let at = row * self.width + from;
        DVec3::from_slice(&self.values[at..at + 3])
    }

    /// What the columns `from..from + 3` hold, by all finite rows.
    fn classify(&self, from: usize) -> Triple {
        /// Normals written with two decimals are off their length by less.
        const UNIT_TOLERANCE: f64 = 0.05;
        let (mut unit, mut bytes, mut units, mut some_length) = (true, true, true, false);
        for row in 0..self.lines.len() {
            let v = self.triple(row, from);
            if !v.is_finite() {
                continue;
            }
            some_length |= v != DVec3::ZERO;
            unit &= (v.length() - 1.0).abs() <= UNIT_TOLERANCE || v == DVec3::ZERO;
            let all = |test: fn(f64) -> bool| v.to_array().into_iter().all(test);
            bytes &= all(|c| (0.0..=255.0).contains(&c) && c.fract() == 0.0);
            units &= all(|c| (0.0..=1.0).contains(&c));
        }
        match () {
            () if unit && some_length => Triple::UnitNormal,
            () if bytes => Triple::Bytes,
            () if units => Triple::Units,
            () => Triple::Normal,
        }
    }

    /// Decides what the columns mean and hands them to `gather`.
    fn assign(&self, gather: &mut Gather) {
        let (normal, colour, unused) = match self.width {
            3 if self.classify(0) == Triple::UnitNormal || self.classify(0) == Triple::Normal => (Some(0), None, None),
            3 => (None, Some(0), None),
            4 if self.classify(0) == Triple::UnitNormal => (Some(0), None, Some(3)),
            4 => (None, Some(1), Some(0)),
            6 => match (self.classify(0), self.classify(3)) {
                (Triple::UnitNormal, _) => (Some(0), Some(3), None),
                (_, Triple::UnitNormal) => (Some(3), Some(0), None),
                (Triple::Bytes | Triple::Units, Triple::Normal) => (Some(3), Some(0), None),
                _ => (Some(0), Some(3), None),
            },
            1 => (None, None, Some(0)),
            _ => (None, None, None),
        };
        let name = |from: usize| format!("{}-{}", from + 4, from + 6);
        if let Some(from) = normal {
            gather.note(NoteKind::Understood, 1, format!("columns {} are normals", name(from)));
        }
        if let Some(from) = colour {
            gather.note(NoteKind::Understood, 1, format!("columns {} are colours", name(from)));
            let in_bytes = self.classify(from) == Triple::Bytes;
            gather.colour_range = if in_bytes { ColourRange::Bytes } else { ColourRange::Reals };
        }
        if let Some(column) = unused {
            gather.note(NoteKind::Ignored, 1, format!("column {}", column + 4));
        }
        if normal.is_none() && colour.is_none() {
            return;
        }
        let mut normals = Vec::with_capacity(if normal.is_some() { self.lines.len() } else { 0 });
        let mut colours = Vec::with_capacity(if colour.is_some() { self.lines.len() } else { 0 });
        for (row, &line) in self.lines.iter().enumerate() {
            let mut bad = None;
            if let Some(from) = normal {
                let n = self.triple(row, from);
                normals.push(if n.is_finite() { unit_normal(n) } else { Vec3::ZERO });
                if !n.is_finite() {
                    bad = Some([("nx", n.x), ("ny", n.y), ("nz", n.z)]);
                }
            }
            if let Some(from) = colour {
                let c = self.triple(row, from);
                colours.push(c.as_vec3().to_array());
                if !c.is_finite() {
                    bad = Some([("red", c.x), ("green", c.y), ("blue", c.z)]);
                }
            }
            if let Some(values) = bad
                && !gather.positions[row].is_nan()
            {
                gather.tally_invalid(Place::Line(line), || not_finite(&values));
                gather.positions[row] = DVec3::NAN;
            }
        }
        gather.normals = normal.map(|_| normals);
        gather.colours = colour.map(|_| colours);
    }
}
