//! What every reader fills, and what is done to it in the end: the one place for the rules on bad values.
//!
//! * A row with a value that is not finite, or impossible, is *invalid*: all are counted, then the file is refused with the
//!   first one's place, or, if the caller asked so, they are left out (of a mesh: with the triangles that use them).
//! * A normal without length is missing, not invalid.
//! * Mesh vertices at the same position are joined; triangles that then use a vertex twice, and vertices that no triangle
//!   uses, are left out. All is counted.

use glam::{DVec3, Vec3};

use super::error::{Fault, Place};
use super::notes::{Note, NoteKind};
use super::{Geometry, ReadOptions};
use crate::geometry::{Ellipse, PointCloud, TriMesh};

/// The farthest a coordinate may lie from the origin: there, neighbouring `f64` are an eighth apart, and `f32` can still hold
/// squares of distances. What lies beyond is a broken file, not a scan.
pub(crate) const LARGEST_COORDINATE: f64 = 1e15;

/// The range of a file's colour values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ColourRange {
    /// 0 to 255.
    Bytes,
    /// 0 to 65535.
    Shorts,
    /// Real numbers: 0 to 1, unless they go so far beyond that they must be 0 to 255.
    Reals,
}

/// Points or vertices and triangles, as the file has them.
#[derive(Debug)]
pub(super) struct Gather {
    /// NaN in the first coordinate marks a row that is invalid.
    pub positions: Vec<DVec3>,
    /// Unit length or [`PointCloud::NO_NORMAL`].
    pub normals: Option<Vec<Vec3>>,
    pub radii: Option<Vec<f32>>,
    pub ellipses: Option<Vec<Ellipse>>,
    /// As in the file.
    pub colours: Option<Vec<[f32; 3]>>,
    pub colour_range: ColourRange,
    /// 0 to 1.
    pub opacities: Option<Vec<f32>>,
    /// Every index is below `positions.len()` when `finish` is called.
    pub triangles: Vec<[u32; 3]>,
    /// Whether the file has faces, be they usable or not.
    pub is_mesh: bool,
    /// Whether joining vertices is no news (STL has nothing but corners).
    pub silent_weld: bool,
    pub invalid: Option<(u64, Place, String)>,
    pub notes: Vec<Note>,
}

impl Default for Gather {
    fn default() -> Self {
        Self {
            positions: Vec::new(),
            normals: None,
            radii: None,
            ellipses: None,
            colours: None,
            colour_range: ColourRange::Bytes,
            opacities: None,
            triangles: Vec::new(),
            is_mesh: false,
            silent_weld: false,
            invalid: None,
            notes: Vec::new(),
        }
    }
}

impl Gather {
    /// Adds to a note, or begins one.
    pub fn note(&mut self, kind: NoteKind, count: u64, detail: impl Into<String>) {
        if count > 0 {
            self.notes.push(Note { kind, count, detail: detail.into() });
        }
    }

    /// Counts an invalid row. `what` is asked for the first one only.
    pub fn tally_invalid(&mut self, place: Place, what: impl FnOnce() -> String) {
        match &mut self.invalid {
            Some((count, ..)) => *count += 1,
            None => self.invalid = Some((1, place, what())),
        }
    }

    /// Adds a position; one that is not finite, or farther out than any length can be told, is tallied.
    #[inline]
    pub fn push_position(&mut self, p: DVec3, place: Place) {
        // Written so that NaN fails.
        if p.abs().max_element() <= LARGEST_COORDINATE && p.is_finite() {
            self.positions.push(p);
        } else {
            self.tally_invalid(place, || bad_coordinate(p));
            self.positions.push(DVec3::NAN);
        }
    }

    /// Refuses more points than the rest of the program can number.
    pub fn check_room(&self, place: Place) -> Result<(), Fault> {
        // The last number is kept free as a mark.
        if self.positions.len() >= u32::MAX as usize {
            let what = "more than 4 294 967 294 points";
            return Err(Fault::malformed(place, what, "split the file"));
        }
        Ok(())
    }

    /// The geometry, after all rules have been applied.
    pub fn finish(mut self, options: &ReadOptions) -> Result<(Geometry, Vec<Note>), Fault> {
        self.check_room(Place::Byte(0))?;
        let invalid_count = self.invalid.as_ref().map_or(0, |(count, ..)| *count);
        if let Some((count, first, what)) = self.invalid.take()
            && !options.drop_invalid
        {
            return Err(Fault::Invalid { count, first, what });
        }
        self.note(NoteKind::InvalidDropped, invalid_count, "");
        let geometry = if self.is_mesh && !options.as_points {
            Geometry::Mesh(self.finish_mesh()?)
        } else {
            Geometry::Cloud(self.finish_cloud()?)
        };
        Ok((geometry, self.notes))
    }

    fn finish_mesh(&mut self) -> Result<TriMesh, Fault> {
        let colours = self.take_colours();
        let mut mesh = TriMesh {
            positions: std::mem::take(&mut self.positions),
            triangles: std::mem::take(&mut self.triangles),
            colours,
        };
        let faces = mesh.triangles.len();
        let finite: Vec<bool> = mesh.positions.iter().map(|p| p.is_finite()).collect();
        mesh.triangles.retain(|corners| corners.iter().all(|&v| finite[v as usize]));
        self.note(NoteKind::TrianglesDropped, (faces - mesh.triangles.len()) as u64, "");
        let welded = mesh.weld() as u64;
        if !self.silent_weld {
            self.note(NoteKind::WeldedVertices, welded, "");
        }
        let degenerate = mesh.drop_degenerate();
        self.note(NoteKind::DegenerateTriangles, degenerate as u64, "");
        let mut unreferenced = mesh.drop_unreferenced() as u64;
        // The vertices dropped as invalid are in there, and have their own note.
        unreferenced -= finite.iter().filter(|&&finite| !finite).count() as u64;
        self.note(NoteKind::UnreferencedVertices, unreferenced, "");
        self.note(NoteKind::FlatTriangles, mesh.count_flat() as u64, "");
        if mesh.triangles.is_empty() {
            return Err(Fault::empty(
                "no usable triangle is left",
                "read it as points (--as-points), or export the mesh again",
            ));
        }
        Ok(mesh)
    }

    fn finish_cloud(&mut self) -> Result<PointCloud, Fault> {
        let mut cloud = PointCloud {
            normals: self.normals.take(),
            radii: self.radii.take(),
            ellipses: self.ellipses.take(),
            colours: self.take_colours(),
            opacities: self.opacities.take(),
            positions: std::mem::take(&mut self.positions),
        };
        if cloud.positions.iter().any(|p| p.is_nan()) {
            let finite: Vec<bool> = cloud.positions.iter().map(|p| p.is_finite()).collect();
            cloud.retain(|i| finite[i]);
        }
        if cloud.is_empty() {
            return Err(Fault::empty("there is no usable point", "check what was exported"));
        }
        if let Some(normals) = &cloud.normals {
            let missing = normals.iter().filter(|&&n| n == PointCloud::NO_NORMAL).count();
            self.note(NoteKind::ZeroNormals, missing as u64, "");
            if missing == normals.len() {
                cloud.normals = None;
            }
        }
        if let Some(opacities) = &cloud.opacities
            && opacities.iter().all(|&opacity| opacity == 0.0)
        {
            self.note(NoteKind::OpacityIgnored, opacities.len() as u64, "");
            cloud.opacities = None;
        }
        self.note(NoteKind::DuplicatePoints, cloud.duplicates() as u64, "");
        Ok(cloud)
    }

    fn take_colours(&mut self) -> Option<Vec<[u8; 3]>> {
        /// Reals above this are taken for 0 to 255: a bright 0-to-1 colour overshoots less.
        const LARGEST_UNIT_COLOUR: f32 = 2.0;
        let colours = self.colours.take()?;
        let top = match self.colour_range {
            ColourRange::Bytes => 255.0,
            ColourRange::Shorts => 65_535.0,
            ColourRange::Reals => {
                let largest = colours.as_flattened().iter().fold(0.0_f32, |a, &b| a.max(b));
                if largest > LARGEST_UNIT_COLOUR { 255.0 } else { 1.0 }
            }
        };
        let mut clamped = 0;
        let bytes = colours
            .iter()
            .map(|rgb| {
                // Written so that NaN (of a row that is dropped) is outside.
                clamped += u64::from(!rgb.iter().all(|c| (0.0..=top).contains(c)));
                rgb.map(|c| (c / top * 255.0).round() as u8)
            })
            .collect();
        self.note(NoteKind::Clamped, clamped, "");
        Some(bytes)
    }
}

/// A normal of any length as a unit vector; [`PointCloud::NO_NORMAL`] where it has none. NaN stays NaN.
#[inline]
pub(super) fn unit_normal(n: DVec3) -> Vec3 {
    let length = n.length();
    if length.is_finite() && length > 0.0 {
        (n / length).as_vec3()
    } else if length == 0.0 {
        PointCloud::NO_NORMAL
    } else {
        // The squares overflowed: scale first.
        let scaled = n / n.abs().max_element();
        (scaled / scaled.length()).as_vec3()
    }
}

/// Names the coordinate that cannot be used.
#[cold]
fn bad_coordinate(p: DVec3) -> String {
    // NaN lies in no range.
    let usable = -LARGEST_COORDINATE..=LARGEST_COORDINATE;
    match [("x", p.x), ("y", p.y), ("z", p.z)].iter().find(|(_, value)| !usable.contains(value)) {
        Some((name, value)) if value.is_finite() => {
            format!("{name} is {value:e}, beyond ±{LARGEST_COORDINATE:e} (wrong byte order?)")
        }
        Some((name, value)) => format!("{name} is {value}"),
        None => "a coordinate is unusable".to_owned(),
    }
}

/// Names the first of `values` that is not finite.
pub(super) fn not_finite(values: &[(&str, f64)]) -> String {
    match values.iter().find(|(_, value)| !value.is_finite()) {
        Some((name, value)) => format!("{name} is {value}"),
        None => "a value is too large for single precision".to_owned(),
    }
}
