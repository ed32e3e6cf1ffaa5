//! STL, binary and ascii.
//!
//! # Practice
//! A binary file is told by its size, which its count must explain, not by its first word: binary files that begin with
//! `solid` are common. Facet normals and attribute bytes are not used: the corners' order says where outside is. Vertices
//! with exactly equal coordinates become one as they are read, so memory follows the welded mesh. Several solids in an ascii
//! file become one mesh. Why this is not the `stl_io` crate: a record is fifty bytes at known places, the crate's errors have
//! no line or byte, and of an ascii file it reads the first solid only. The tests compare the two.

use glam::{DVec3, Vec3};

use super::error::{CUT_OFF, Fault, Place, quote};
use super::gather::Gather;
use super::notes::NoteKind;
use super::text::{Lines, Separators, Words};
use super::{Progress, Stated};
use crate::geometry::mesh::PositionTable;

/// Free text, then the count.
const HEADER_BYTES: usize = 84;
/// Twelve numbers and two attribute bytes.
const RECORD_BYTES: usize = 50;

/// The number of triangles that a binary file claims.
fn claimed(bytes: &[u8]) -> Option<u64> {
    let count = bytes.get(HEADER_BYTES - 4..)?.first_chunk()?;
    Some(u64::from(u32::from_le_bytes(*count)))
}

/// Whether the size is exactly what a binary file's count asks for.
pub(super) fn is_binary_by_size(bytes: &[u8]) -> bool {
    claimed(bytes).is_some_and(|n| bytes.len() as u64 == HEADER_BYTES as u64 + n * RECORD_BYTES as u64)
}

/// Whether a text begins as an ascii file does.
pub(super) fn is_ascii(bytes: &[u8]) -> bool {
    /// As far as a title may reach before the first facet.
    const SNIFFED: usize = 4096;
    let head = &bytes[..bytes.len().min(SNIFFED)];
    let mut words = Lines::of_file(head).flat_map(|line| Words::new(line, Separators::Blanks)).map(|word| word.bytes);
    let begins = words.next().is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    begins && !head.contains(&0)
}

/// Joins corners as they come.
struct Corners {
    gather: Gather,
    table: PositionTable,
}

impl Corners {
    fn new(triangles: usize) -> Self {
        let gather = Gather { is_mesh: true, silent_weld: true, ..Gather::default() };
        // A closed mesh has half as many vertices as triangles.
        Self { gather, table: PositionTable::with_capacity(triangles / 2) }
    }

    #[inline]
    fn add(&mut self, p: DVec3, place: Place) -> Result<u32, Fault> {
        self.gather.check_room(place)?;
        let number = self.gather.positions.len() as u32;
        self.gather.push_position(p, place);
        let first = self.table.find_or_insert(&self.gather.positions, number);
        if first != number {
            self.gather.positions.pop();
        }
        Ok(first)
    }
}

/// Reads a whole STL file.
pub(super) fn read(bytes: &[u8], progress: &dyn Progress) -> Result<(Gather, Stated), Fault> {
    if !is_binary_by_size(bytes) && is_ascii(bytes) { ascii(bytes, progress) } else { binary(bytes, progress) }
}

fn binary(bytes: &[u8], progress: &dyn Progress) -> Result<(Gather, Stated), Fault> {
    /// Records between two reports of progress.
    const REPORT_RECORDS: usize = 8192;
    let Some(claimed) = claimed(bytes) else {
        let what = format!("{} bytes are too few for a header of {HEADER_BYTES}", bytes.len());
        return Err(Fault::malformed(Place::Byte(bytes.len() as u64), what, CUT_OFF));
    };
    let body = &bytes[HEADER_BYTES..];
    let (records, trailing) = body.as_chunks::<RECORD_BYTES>();
    let held = records.len() as u64;
    if claimed > held {
        let what = format!("the header claims {claimed} triangles, but only {held} follow");
        return Err(Fault::malformed(Place::Byte(HEADER_BYTES as u64 - 4), what, CUT_OFF));
    }
    if claimed == 0 {
        return Err(Fault::empty("the header claims 0 triangles", "check what was exported"));
    }
    // Not more than `held`, so it fits.
    let records = &records[..claimed as usize];
    let mut corners = Corners::new(records.len());
    corners.gather.triangles.reserve_exact(records.len());
    progress.advance(HEADER_BYTES as u64);
    for (group, chunk) in records.chunks(REPORT_RECORDS).enumerate() {
        for (index, record) in chunk.iter().enumerate() {
            let place = || Place::Byte((HEADER_BYTES + (group * REPORT_RECORDS + index) * RECORD_BYTES) as u64);
            let (floats, _attribute) = record.as_chunks::<4>();
            let mut triangle = [0; 3];
            for (corner, vertex) in triangle.iter_mut().enumerate() {
                // The first three numbers are the facet's normal.
                let [x, y, z] = [0, 1, 2].map(|axis| f32::from_le_bytes(floats[3 + 3 * corner + axis]));
                *vertex = corners.add(Vec3::new(x, y, z).as_dvec3(), place())?;
            }
            corners.gather.triangles.push(triangle);
        }
        progress.advance((chunk.len() * RECORD_BYTES) as u64);
    }
    let trailing = trailing.len() as u64 + (held - claimed) * RECORD_BYTES as u64;
    corners.gather.note(NoteKind::Trailing, trailing, "");
    let stated = Stated { points: corners.gather.positions.len() as u64, faces: claimed };
    Ok((corners.gather, stated))
}

fn ascii(bytes: &[u8], progress: &dyn Progress) -> Result<(Gather, Stated), Fault> {
    /// Facets between two reports of progress.
    const REPORT_FACETS: u64 = 4096;
    let mut corners = Corners::new(0);
    let mut lines = Lines::of_file(bytes);
    let (mut facets, mut polygons, mut reported) = (0, 0, 0);
    let mut in_facet = false;
    let mut ended = false;
    let mut facet: Vec<u32> = Vec::new();
    while let Some(line) = lines.next_filled() {
        let place = Place::Line(line.number);
        let mut words = Words::new(line, Separators::Blanks);
        let Some(first) = words.next() else { continue };
        let misplaced = |wanted: &str| {
            let what = format!("{} where {wanted} should be", quote(first.bytes));
            Fault::malformed(first.place(), what, CUT_OFF)
        };
        let keyword = first.bytes.to_ascii_lowercase();
        match keyword.as_slice() {
            b"vertex" if in_facet => {
                let mut p = [0.0; 3];
                for value in &mut p {
                    let word = words.next().ok_or_else(|| {
                        Fault::malformed(words.place(), "a vertex has fewer than three coordinates", CUT_OFF)
                    })?;
                    *value = word.expect_number()?;
                }
                facet.push(corners.add(DVec3::from_array(p), place)?);
            }
            b"facet" if !in_facet => {
                in_facet = true;
                facet.clear();
            }
            b"outer" | b"endloop" if in_facet => {}
            b"endfacet" if in_facet => {
                let &[a, ref rest @ ..] = facet.as_slice() else { return Err(misplaced("vertex")) };
                if rest.len() < 2 {
                    return Err(misplaced("vertex"));
                }
                polygons += u64::from(rest.len() > 2);
                corners.gather.triangles.extend(rest.windows(2).map(|pair| [a, pair[0], pair[1]]));
                in_facet = false;
                facets += 1;
                if facets % REPORT_FACETS == 0 {
                    progress.advance(lines.consumed() - reported);
                    reported = lines.consumed();
                }
            }
            b"solid" if !in_facet => ended = false,
            b"endsolid" if !in_facet => ended = true,
            // Some writers add colours or comments between the facets.
            b"color" | b"#" => {}
            _ if in_facet => return Err(misplaced("vertex or endfacet")),
            _ => return Err(misplaced("facet or endsolid")),
        }
    }
    progress.advance(lines.consumed() - reported);
    if !ended {
        let what = "the file ends without endsolid";
        return Err(Fault::malformed(Place::Line(lines.number()), what, CUT_OFF));
    }
    if facets == 0 {
        return Err(Fault::empty("there is no facet", "check what was exported"));
    }
    corners.gather.note(NoteKind::Polygons, polygons, "");
    let stated = Stated { points: corners.gather.positions.len() as u64, faces: facets };
    Ok((corners.gather, stated))
}
