//! Wavefront OBJ: vertices (with colours where they have them) and faces; without faces, points.
//!
//! # Practice
//! Faces are polygons of `v`, `v/vt`, `v//vn` or `v/vt/vn`, counted from 1, or backwards from the latest vertex if negative;
//! only `v` is used, but normals serve where the file is read as points and each vertex has its own. Groups, objects and
//! materials become one mesh. A backslash continues a line. Lines, points and free-form curves are counted and left out. Why
//! this is not the `tobj` crate: without its `use_f64` feature it rounds coordinates to `f32`, its errors have no line, a
//! comment in Latin-1 is one of them, it drops unused vertices silently, and colours on some of the vertices only shift those
//! of the others. The tests compare the two.

use std::borrow::Cow;

use glam::{DVec3, Vec3};

use super::error::{Fault, Place, quote};
use super::gather::{ColourRange, Gather, unit_normal};
use super::notes::NoteKind;
use super::text::{Line, Lines, Separators, Word, Words};
use super::{Progress, ReadOptions, Stated};

/// The keywords whose statements mean nothing here, and are no news.
const SILENT: [&[u8]; 9] = [b"vt", b"g", b"o", b"s", b"usemtl", b"mtllib", b"vp", b"maplib", b"usemap"];

/// The colour of vertices without one in a file that has colours: white.
const NO_COLOUR: [f32; 3] = [1.0; 3];

#[derive(Default)]
struct Reader {
    gather: Gather,
    normals: Vec<DVec3>,
    /// Whether every corner of a face that names a normal names the one of its vertex.
    normals_by_vertex: bool,
    faces: u64,
    polygons: u64,
    small: u64,
    unused: u64,
    /// The greatest vertex that a face uses before it is defined, with its line.
    farthest: Option<(u64, u64)>,
    /// The corners of the face at hand.
    corners: Vec<u32>,
}

/// Reads a whole OBJ file.
pub(super) fn read(bytes: &[u8], options: &ReadOptions, progress: &dyn Progress) -> Result<(Gather, Stated), Fault> {
    /// Lines between two reports of progress.
    const REPORT_LINES: u64 = 8192;
    let gather = Gather { colour_range: ColourRange::Reals, ..Gather::default() };
    let mut reader = Reader { gather, normals_by_vertex: true, ..Reader::default() };
    let mut lines = Lines::of_file(bytes);
    let mut reported = 0;
    while let Some(line) = lines.next() {
        let joined = join_continued(line, &mut lines);
        reader.statement(Line { bytes: &joined, number: line.number })?;
        if line.number % REPORT_LINES == 0 {
            progress.advance(lines.consumed() - reported);
            reported = lines.consumed();
        }
    }
    progress.advance(lines.consumed() - reported);
    reader.finish(options)
}

/// A line and those that a backslash at its end joins to it. Columns then count in the joined line.
fn join_continued<'a>(line: Line<'a>, lines: &mut Lines<'a>) -> Cow<'a, [u8]> {
    let Some(begun) = line.bytes.strip_suffix(b"\\") else { return Cow::Borrowed(line.bytes) };
    let mut joined = begun.to_vec();
    for next in lines.by_ref() {
        joined.push(b' ');
        match next.bytes.strip_suffix(b"\\") {
            Some(more) => joined.extend_from_slice(more),
            None => {
                joined.extend_from_slice(next.bytes);
                break;
            }
        }
    }
    Cow::Owned(joined)
}

impl Reader {
    #[inline]
    fn statement(&mut self, line: Line) -> Result<(), Fault> {
        let mut words = Words::new(line, Separators::Blanks);
        let Some(keyword) = words.next() else { return Ok(()) };
        match keyword.bytes {
            b"v" => self.vertex(words, line),
            b"f" | b"fo" => self.face(words, line),
            b"vn" => {
                let (n, count) = numbers(&mut words)?;
                if count < 3 {
                    return Err(Fault::malformed(words.place(), "a normal needs three numbers", MEND));
                }
                self.normals.push(DVec3::new(n[0], n[1], n[2]));
                Ok(())
            }
            word if word.starts_with(b"#") || SILENT.contains(&word) => Ok(()),
            _ => {
                self.unused += 1;
                Ok(())
            }
        }
    }

    #[inline]
    fn vertex(&mut self, mut words: Words, line: Line) -> Result<(), Fault> {
        let (v, count) = numbers(&mut words)?;
        let place = Place::Line(line.number);
        let mut p = DVec3::new(v[0], v[1], v[2]);
        let colour = match count {
            3 => None,
            4 if v[3] == 0.0 => {
                let mend = "points at infinity cannot be drawn: take them out";
                return Err(Fault::malformed(place, "a vertex has the weight 0", mend));
            }
            4 => {
                p /= v[3];
                None
            }
            // A seventh number is an opacity.
            6 | 7 => Some([v[3] as f32, v[4] as f32, v[5] as f32]),
            _ => {
                let what = format!("a vertex has {count} numbers");
                return Err(Fault::malformed(
                    words.place(),
                    what,
                    "a vertex has 3 numbers, 4 with a weight, 6 with a colour",
                ));
            }
        };
        let before = self.gather.positions.len();
        self.gather.check_room(place)?;
        self.gather.push_position(p, place);
        if let Some(rgb) = colour {
            self.gather.colours.get_or_insert_with(|| vec![NO_COLOUR; before]).push(rgb);
            if !rgb.iter().all(|c| c.is_finite()) && p.is_finite() {
                self.gather.tally_invalid(place, || "its colour is not finite".to_owned());
                self.gather.positions[before] = DVec3::NAN;
            }
        } else if let Some(colours) = &mut self.gather.colours {
            colours.push(NO_COLOUR);
        }
        Ok(())
    }

    #[inline]
    fn face(&mut self, words: Words, line: Line) -> Result<(), Fault> {
        self.corners.clear();
        for word in words {
            if word.bytes.starts_with(b"#") {
                break;
            }
            let vertex = self.corner(word, line)?;
            self.corners.push(vertex);
        }
        self.faces += 1;
        let &[first, ref rest @ ..] = self.corners.as_slice() else {
            return Err(Fault::malformed(Place::Line(line.number), "a face without corners", MEND));
        };
        self.small += u64::from(rest.len() < 2);
        self.polygons += u64::from(rest.len() > 2);
        self.gather.triangles.extend(rest.windows(2).map(|pair| [first, pair[0], pair[1]]));
        Ok(())
    }

    /// The vertex of a corner, from 0.
    #[inline]
    fn corner(&mut self, word: Word, line: Line) -> Result<u32, Fault> {
        let mut parts = word.bytes.split(|&b| b == b'/');
        let vertex = parts.next().and_then(index);
        let normal = parts.nth(1).and_then(index);
        let known = self.gather.positions.len();
        let vertex = match vertex {
            Some(n) if n > 0 => (n - 1) as u64,
            Some(n) if n < 0 && n.unsigned_abs() <= known as u64 => known as u64 - n.unsigned_abs(),
            Some(n) => {
                let what = format!("a face uses vertex {n} where {known} are defined");
                return Err(Fault::malformed(word.place(), what, "vertices count from 1, or backwards from -1"));
            }
            None => {
                let what = format!("{} is no corner of a face", quote(word.bytes));
                return Err(Fault::malformed(word.place(), what, "write v, v/vt, v//vn or v/vt/vn"));
            }
        };
        if vertex >= known as u64 && self.farthest.is_none_or(|(farthest, _)| vertex > farthest) {
            self.farthest = Some((vertex, line.number));
        }
        if let Some(normal) = normal {
            let normal = if normal < 0 { self.normals.len() as i64 + normal } else { normal - 1 };
            self.normals_by_vertex &= i64::try_from(vertex) == Ok(normal);
        }
        // One that does not fit is beyond all vertices, which `finish` reports.
        Ok(u32::try_from(vertex).unwrap_or(u32::MAX))
    }

    fn finish(self, options: &ReadOptions) -> Result<(Gather, Stated), Fault> {
        let points = self.gather.positions.len() as u64;
        if points == 0 {
            return Err(Fault::empty("there is no vertex (no line begins with 'v')", "check what was exported"));
        }
        if let Some((farthest, line)) = self.farthest
            && farthest >= points
        {
            let what = format!("a face uses vertex {}, but the file has {points}", farthest.saturating_add(1));
            return Err(Fault::malformed(Place::Line(line), what, "the file was cut off: export it again"));
        }
        let mut gather = self.gather;
        gather.is_mesh = self.faces > 0;
        if !gather.is_mesh || options.as_points {
            if self.normals_by_vertex && self.normals.len() as u64 == points {
                assign_normals(&mut gather, &self.normals);
            } else if !self.normals.is_empty() {
                gather.note(NoteKind::Ignored, 1, "normals that do not go with the vertices");
            }
        }
        gather.note(NoteKind::Polygons, self.polygons, "");
        gather.note(NoteKind::SmallFaces, self.small, "");
        let statements = format!("{} statements that are neither vertices nor faces", self.unused);
        gather.note(NoteKind::Ignored, self.unused, statements);
        Ok((gather, Stated { points, faces: self.faces }))
    }
}

const MEND: &str = "correct the line, or export the file again";

fn assign_normals(gather: &mut Gather, normals: &[DVec3]) {
    let not_finite = normals.iter().filter(|n| !n.is_finite()).count();
    let unit = |n: &DVec3| if n.is_finite() { unit_normal(*n) } else { Vec3::ZERO };
    gather.normals = Some(normals.iter().map(unit).collect());
    gather.note(NoteKind::Ignored, not_finite as u64, format!("{not_finite} normals that are not finite"));
}

/// The numbers up to the line's end or a comment, at most seven, and how many there are in all.
#[inline]
fn numbers(words: &mut Words) -> Result<([f64; 7], usize), Fault> {
    let mut values = [0.0; 7];
    let mut count = 0;
    for word in words {
        if word.bytes.starts_with(b"#") {
            break;
        }
        let value = word.expect_number()?;
        if let Some(slot) = values.get_mut(count) {
            *slot = value;
        }
        count += 1;
    }
    Ok((values, count))
}

/// A whole number with an optional sign.
#[inline]
fn index(bytes: &[u8]) -> Option<i64> {
    let (negative, digits) = match bytes {
        [b'-', rest @ ..] => (true, rest),
        _ => (false, bytes),
    };
    /// As many digits always fit.
    const MOST_DIGITS: usize = 18;
    if digits.is_empty() || digits.len() > MOST_DIGITS || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let value = digits.iter().fold(0, |value, b| value * 10 + i64::from(b - b'0'));
    Some(if negative { -value } else { value })
}
