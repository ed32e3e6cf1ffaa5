//! Surfels: oriented, curved disks (or ellipses) in world space, the scan's own samples or samples of an exact leaf.
//!
//! A leaf's surfels lie in Morton order, in chunks of [`CHUNK`] whose `f64` origins carry the large coordinates; a surfel
//! keeps an `f32` offset from its chunk's origin, so that a scan 10⁷ units from the world's origin loses nothing. The
//! chunks' bounding balls are the leaves of the hierarchy that classification descends and that the frame culls.
//!
//! ```text
//! PointCloud ─► place ─► normals ─► orient ─┐                 (the last two where normals are missing)
//! Solid ─► solid ─┐                         ├─► around (radius, curvature) ─► assemble ─► SurfelCloud
//! TriMesh ─► mesh ┴─► sampled ──────────────┘
//! ```

mod around;
mod assemble;
pub mod ball_tree;
pub mod cloud;
#[cfg(test)]
mod cloud_tests;
mod curvature;
mod isolated;
pub mod mesh;
mod moved;
mod normals;
mod orient;
mod place;
mod radius;
mod sampled;
#[cfg(test)]
mod sampled_tests;
pub mod solid;
#[cfg(test)]
mod test_shapes;

use glam::{DVec3, Mat3, Vec3};

pub use cloud::{CloudNotes, CloudOptions, from_cloud};
pub(crate) use curvature::SAME_SHEET;
pub use mesh::from_mesh;
pub use solid::from_solid;

/// Surfels a chunk: a cache-friendly run, and the finest node that classification decides as a whole.
pub const CHUNK: usize = 64;

/// A symmetric 3×3 matrix: xx, xy, xz, yy, yz, zz.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct Sym3(pub [f32; 6]);

impl Sym3 {
    /// The matrix as columns.
    pub fn to_mat3(self) -> Mat3 {
        let [xx, xy, xz, yy, yz, zz] = self.0;
        Mat3::from_cols(Vec3::new(xx, xy, xz), Vec3::new(xy, yy, yz), Vec3::new(xz, yz, zz))
    }

    /// The symmetric part of `m`.
    pub fn from_mat3(m: Mat3) -> Self {
        let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
        Self([x.x, 0.5 * (x.y + y.x), 0.5 * (x.z + z.x), y.y, 0.5 * (y.z + z.y), z.z])
    }

    /// M v.
    #[inline]
    pub fn mul(&self, v: Vec3) -> Vec3 {
        let m = &self.0;
        Vec3::new(
            m[0] * v.x + m[1] * v.y + m[2] * v.z,
            m[1] * v.x + m[3] * v.y + m[4] * v.z,
            m[2] * v.x + m[4] * v.y + m[5] * v.z,
        )
    }
}

/// One surfel, world space. 56 bytes, less than a cache line.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C)]
pub struct Surfel {
    /// Centre minus its chunk's origin.
    pub offset: Vec3,
    /// Radius of its support ball (the longest semi-axis where elliptical), world units, positive.
    pub radius: f32,
    /// Unit outward normal.
    pub normal: Vec3,
    /// sRGB colour and opacity, 0 to 255.
    pub colour: [u8; 4],
    /// Curvature M: near the centre the surface is n·e + ½ eᵀMe = 0 with e = x − centre.
    pub curvature: Sym3,
}

/// [`CHUNK`] consecutive surfels (the last chunk may have fewer).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chunk {
    /// World-space origin of the surfels' offsets.
    pub origin: DVec3,
    /// Centre of a ball that holds the centres, relative to `origin`.
    pub centre: Vec3,
    /// Radius of the ball that holds the centres.
    pub extent: f32,
    /// The largest surfel radius.
    pub largest_radius: f32,
}

/// The surfels of one leaf.
#[derive(Debug, Clone, Default)]
pub struct SurfelCloud {
    /// In Morton order.
    pub surfels: Vec<Surfel>,
    /// One for every [`CHUNK`] surfels.
    pub chunks: Vec<Chunk>,
    /// Where the input has ellipses: per surfel the matrix S with eᵀSe = 1 on the border of its support.
    pub supports: Option<Vec<Sym3>>,
    /// Confidence in the normal, 0 to 255, per surfel; 255 where the file gave it.
    pub confidence: Vec<u8>,
    /// Whether the input had a colour for each surfel (else the leaf's colour counts).
    pub coloured: bool,
    /// Median surfel spacing, world units.
    pub spacing: f32,
}

/// Why a leaf has no surfels.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SurfelError {
    /// There is no point or triangle.
    #[error("it holds no points or triangles")]
    Empty,
    /// The leaf's transform flattens space, so that normals have no direction.
    #[error("its transform is not invertible: every scale must be finite and different from zero")]
    Transform,
    /// A point is not finite in world space.
    #[error("its point {index} is not finite in world space ({p}): drop the point, or mend the transform")]
    NotFinite {
        /// Its index in the input.
        index: usize,
        /// Where it lies in world space.
        p: DVec3,
    },
    /// One place alone has no neighbours to take a radius from.
    #[error(
        "its points ({points}) all lie at one place, so there is no spacing to take a radius from: give the file a \
         `radius` property (PLY)"
    )]
    OnePlace {
        /// How many.
        points: usize,
    },
    /// More surfels than the arrays can index.
    #[error("it needs {needed:.0} surfels, more than {limit}: {mend}")]
    TooMany {
        /// How many, perhaps estimated.
        needed: f64,
        /// The most.
        limit: usize,
        /// What to do.
        mend: &'static str,
    },
    /// The sampling distance is not a positive number.
    #[error("the spacing must be a positive number, not {0}")]
    Spacing(f64),
}

impl SurfelCloud {
    /// The number of surfels.
    pub fn len(&self) -> usize {
        self.surfels.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.surfels.is_empty()
    }

    /// Centre of surfel `index` in world space.
    #[inline]
    pub fn centre(&self, index: usize) -> DVec3 {
        self.chunks[index / CHUNK].origin + self.surfels[index].offset.as_dvec3()
    }

    /// How far from closed the surface is: |Σ aᵢ nᵢ| / Σ aᵢ with areas aᵢ ∝ rᵢ². The area vectors of a closed surface cancel
    /// (divergence theorem): near 0 where it is closed and evenly covered, 1 for a flat sheet. NaN where there is no surfel.
    pub fn closure(&self) -> f32 {
        let (mut vector, mut total) = (DVec3::ZERO, 0.0);
        for surfel in &self.surfels {
            let area = f64::from(surfel.radius) * f64::from(surfel.radius);
            vector += surfel.normal.as_dvec3() * area;
            total += area;
        }
        (vector.length() / total) as f32
    }

    /// A rough volume in cubed world units, ⅓ Σ aᵢ nᵢ · (pᵢ − centroid); negative where the normals point inward. The sum of the
    /// areas is that of disks which overlap by the usual radius rule, so only sign and order of magnitude mean something, and
    /// those only where [`Self::closure`] is small.
    pub fn signed_volume(&self) -> f64 {
        // A neighbour at the distance d₆ = r / COVERAGE is one of six within the area π d₆².
        let share = std::f64::consts::PI / (radius::RING as f64 * f64::from(radius::COVERAGE).powi(2));
        let first = self.chunks.first().map_or(DVec3::ZERO, |chunk| chunk.origin);
        let centroid = (0..self.len()).map(|i| self.centre(i) - first).sum::<DVec3>() / self.len().max(1) as f64;
        let sum: f64 = (0..self.len())
            .map(|i| {
                let surfel = &self.surfels[i];
                let area = share * f64::from(surfel.radius) * f64::from(surfel.radius);
                area * surfel.normal.as_dvec3().dot(self.centre(i) - first - centroid)
            })
            .sum();
        sum / 3.0
    }
}
