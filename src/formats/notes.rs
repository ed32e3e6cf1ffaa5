//! What a reader noticed, and mended or left out: for `info`, `check` and warnings.

use std::fmt;

/// The kind of a [`Note`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum NoteKind {
    /// Points or vertices with NaN, infinite or impossible values, left out as asked.
    InvalidDropped,
    /// Triangles left out because they use such a vertex.
    TrianglesDropped,
    /// Points at exactly the position of an earlier point; kept.
    DuplicatePoints,
    /// Vertices joined with an earlier vertex at exactly the same position.
    WeldedVertices,
    /// Points whose normal has no length: their normal is missing.
    ZeroNormals,
    /// Vertices that no triangle uses; left out.
    UnreferencedVertices,
    /// Triangles that use a vertex twice; left out.
    DegenerateTriangles,
    /// Triangles of three different corners on one line; kept, for they keep the mesh closed.
    FlatTriangles,
    /// Faces with more than three corners, cut into fans.
    Polygons,
    /// Faces with fewer than three corners; left out.
    SmallFaces,
    /// Normals without an orientation: they may point inwards or outwards.
    Unoriented,
    /// Colours or opacities outside their range, clamped.
    Clamped,
    /// Opacities that are all zero, which would hide everything; left out.
    OpacityIgnored,
    /// Things in the file that surfcut does not use; `detail` names them.
    Ignored,
    /// Bytes or lines after the last one that the header speaks of.
    Trailing,
    /// How columns or values without a name were understood; `detail` says it.
    Understood,
}

/// One thing noticed while reading.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// What it is.
    pub kind: NoteKind,
    /// How many there are.
    pub count: u64,
    /// Names or other particulars; often empty.
    pub detail: String,
}

impl Note {
    /// Whether the user should hear of it unasked.
    pub fn is_warning(&self) -> bool {
        matches!(
            self.kind,
            NoteKind::InvalidDropped
                | NoteKind::TrianglesDropped
                | NoteKind::ZeroNormals
                | NoteKind::Clamped
                | NoteKind::OpacityIgnored
                | NoteKind::Trailing
        )
    }
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let one = self.count == 1;
        let n = |singular: &str, plural: &str| format!("{} {}", self.count, if one { singular } else { plural });
        let text = match self.kind {
            NoteKind::InvalidDropped => n("point with unusable values dropped", "points with unusable values dropped"),
            NoteKind::TrianglesDropped => {
                n("triangle dropped with its vertices", "triangles dropped with their vertices")
            }
            NoteKind::DuplicatePoints => n("duplicate point", "duplicate points"),
            NoteKind::WeldedVertices => n("duplicate vertex joined", "duplicate vertices joined"),
            NoteKind::ZeroNormals => n("normal without length: missing", "normals without length: missing"),
            NoteKind::UnreferencedVertices => n("unused vertex dropped", "unused vertices dropped"),
            NoteKind::DegenerateTriangles => n("degenerate triangle dropped", "degenerate triangles dropped"),
            NoteKind::FlatTriangles => n("triangle without area", "triangles without area"),
            NoteKind::Polygons => n("polygon cut into triangles", "polygons cut into triangles"),
            NoteKind::SmallFaces => {
                n("face with fewer than three corners dropped", "faces with fewer than three corners dropped")
            }
            NoteKind::Unoriented => {
                n("normal may point inwards or outwards", "normals may point inwards or outwards (unoriented)")
            }
            NoteKind::Clamped => n("colour or opacity clamped", "colours or opacities clamped"),
            NoteKind::OpacityIgnored => n("opacity is zero: ignored", "opacities are all zero: ignored"),
            NoteKind::Ignored => "not used".to_owned(),
            NoteKind::Trailing => {
                n("trailing byte or line after the data ignored", "trailing bytes or lines after the data ignored")
            }
            NoteKind::Understood => "understood".to_owned(),
        };
        f.write_str(&text)?;
        if !self.detail.is_empty() {
            write!(f, ": {}", self.detail)?;
        }
        Ok(())
    }
}
