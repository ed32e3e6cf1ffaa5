//! What is wrong with a leaf before a long run is spent on it: closedness and orientation of meshes, density, outliers and
//! normals of clouds.

use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;

use crate::geometry::mesh::PositionTable;
use crate::geometry::neighbours::Neighbours;
use crate::geometry::{PointCloud, TriMesh};

/// What a mesh is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshHealth {
    /// Vertices.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Edges with one triangle: the mesh is open there.
    pub boundary_edges: usize,
    /// Edges with three or more triangles.
    pub non_manifold_edges: usize,
    /// Edges whose two triangles run along it the same way: one of them is turned over.
    pub inconsistent_edges: usize,
    /// Triangles without area.
    pub flat_triangles: usize,
    /// Signed volume in cubed leaf units; meaningful where the mesh is closed.
    pub signed_volume: f64,
    /// Area in squared leaf units.
    pub area: f64,
    /// |Σ areaᵢ nᵢ| / Σ areaᵢ: 0 for a closed surface, 1 for a flat one, in between the larger the wider it is open.
    pub openness: f64,
    /// Whether the faces look inwards ([`TriMesh::is_inside_out`]).
    pub looks_inwards: bool,
}

impl MeshHealth {
    /// Inspects `mesh`.
    pub fn of(mesh: &TriMesh) -> Self {
        // An edge as its two vertices, the lesser first, and whether the triangle runs along it that way.
        let mut edges: Vec<(u32, u32, bool)> = mesh
            .triangles
            .par_iter()
            .flat_map_iter(|&[a, b, c]| [(a, b), (b, c), (c, a)].map(|(p, q)| (p.min(q), p.max(q), p < q)))
            .collect();
        edges.par_sort_unstable();
        let (mut boundary_edges, mut non_manifold_edges, mut inconsistent_edges) = (0, 0, 0);
        for edge in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            match edge {
                [_] => boundary_edges += 1,
                [a, b] => inconsistent_edges += usize::from(a.2 == b.2),
                _ => non_manifold_edges += 1,
            }
        }
        let twice_areas = |t: usize| {
            let [a, b, c] = mesh.corners(t);
            (b - a).cross(c - a)
        };
        let (vector, area) = (0..mesh.triangles.len())
            .map(twice_areas)
            .fold((DVec3::ZERO, 0.0), |(vector, area), twice| (vector + twice, area + twice.length()));
        Self {
            vertices: mesh.positions.len(),
            triangles: mesh.triangles.len(),
            boundary_edges,
            non_manifold_edges,
            inconsistent_edges,
            flat_triangles: mesh.count_flat(),
            signed_volume: mesh.signed_volume(),
            area: 0.5 * area,
            openness: if area > 0.0 { vector.length() / area } else { 0.0 },
            looks_inwards: mesh.is_inside_out(),
        }
    }

    /// Whether every edge has two triangles that run along it in opposite ways, so that inside and outside are certain.
    pub fn is_closed(&self) -> bool {
        self.boundary_edges == 0 && self.non_manifold_edges == 0 && self.inconsistent_edges == 0
    }

    /// Whether the faces look inwards.
    pub fn is_inside_out(&self) -> bool {
        self.looks_inwards
    }
}

/// What the normals of a cloud are like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalHealth {
    /// Points without one.
    pub missing: usize,
    /// Share of the points inspected whose normal points against most of its neighbours' normals.
    pub against_neighbours: f64,
    /// Volume that the surface encloses by its normals, as a share of area times size: below 0 the normals look inwards.
    pub enclosed: f64,
    /// |Σ areaᵢ nᵢ| / Σ areaᵢ: near 0 for a closed surface, larger the wider it is open.
    pub openness: f64,
}

/// What a cloud is like. Lengths in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudHealth {
    /// Points.
    pub points: usize,
    /// Points at exactly the place of an earlier one.
    pub duplicates: usize,
    /// Median distance to the nearest other point.
    pub spacing: f64,
    /// 5 % and 95 % quantiles of that distance.
    pub spacing_range: (f64, f64),
    /// Estimated number of points that lie far from all others.
    pub outliers: usize,
    /// `None` where the file has no normals.
    pub normals: Option<NormalHealth>,
}

/// This many points are looked at closely; more would change the quantiles by less than a percent.
const INSPECTED: usize = 20_000;

/// Neighbours looked at: about a ring around a point of a surface.
const RING: usize = 8;

/// A point whose ring is this many times wider than the median ring lies by itself.
const FAR: f32 = 8.0;

impl CloudHealth {
    /// Inspects `cloud` as it lies in the world.
    pub fn of(cloud: &PointCloud, world_from_leaf: &DAffine3) -> Self {
        let middle = cloud.positions.get(cloud.len() / 2).copied().unwrap_or_default();
        let origin = world_from_leaf.transform_point3(middle);
        let offsets: Vec<Vec3> =
            cloud.positions.par_iter().map(|&p| (world_from_leaf.transform_point3(p) - origin).as_vec3()).collect();
        let unique = first_of_each_place(&offsets);
        let search = Neighbours::new(DVec3::ZERO, unique.iter().map(|&i| offsets[i as usize]));
        // Normals turn by the inverse transpose; a mirrored leaf's normals still point outward.
        let world_normal_from_leaf = world_from_leaf.matrix3.inverse().transpose();
        let normal = |i: u32| {
            let normal = cloud.normal(i as usize)?;
            (world_normal_from_leaf * normal.as_dvec3()).try_normalize()
        };
        let step = unique.len().div_ceil(INSPECTED).max(1);
        let looks: Vec<Look> =
            unique.par_iter().step_by(step).filter_map(|&i| Look::at(i, &offsets, &unique, &search, &normal)).collect();
        let mut spacings: Vec<f32> = looks.iter().map(|look| look.nearest).collect();
        spacings.sort_by(f32::total_cmp);
        let mut rings: Vec<f32> = looks.iter().map(|look| look.ring).collect();
        rings.sort_by(f32::total_cmp);
        let far = FAR * quantile(&rings, 0.5) as f32;
        let outliers = looks.iter().filter(|look| look.ring > far).count() * step;
        let normals = cloud.normals.as_ref().map(|_| normal_health(cloud, &looks));
        Self {
            points: cloud.len(),
            duplicates: cloud.duplicates(),
            spacing: quantile(&spacings, 0.5),
            spacing_range: (quantile(&spacings, 0.05), quantile(&spacings, 0.95)),
            outliers,
            normals,
        }
    }
}

/// One point and its neighbours.
struct Look {
    offset: DVec3,
    /// Distance to the nearest other point.
    nearest: f32,
    /// Distance to the last of the ring.
    ring: f32,
    normal: Option<DVec3>,
    is_against_neighbours: bool,
}

impl Look {
    fn at(
        index: u32,
        offsets: &[Vec3],
        unique: &[u32],
        search: &Neighbours,
        normal: &impl Fn(u32) -> Option<DVec3>,
    ) -> Option<Self> {
        let mut found = Vec::new();
        let p = offsets[index as usize];
        search.nearest_k(p, RING + 1, &mut found);
        // The point itself is the first.
        let others = found.get(1..)?;
        let (&(_, nearest), &(_, ring)) = (others.first()?, others.last()?);
        let own = normal(index);
        let against = own.map_or(0, |own| {
            let opposes = |&&(other, _): &&(u32, f32)| normal(unique[other as usize]).is_some_and(|n| n.dot(own) < 0.0);
            others.iter().filter(opposes).count()
        });
        let is_against_neighbours = 2 * against > others.len();
        Some(Self { offset: p.as_dvec3(), nearest, ring, normal: own, is_against_neighbours })
    }
}

/// The indices of the points that lie where no earlier point does.
fn first_of_each_place(offsets: &[Vec3]) -> Vec<u32> {
    let places: Vec<DVec3> = offsets.iter().map(|p| p.as_dvec3()).collect();
    let mut table = PositionTable::with_capacity(places.len());
    (0..places.len() as u32).filter(|&i| table.find_or_insert(&places, i) == i).collect()
}

fn quantile(sorted: &[f32], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().map_or(0.0, f64::from)
}

/// By the divergence theorem Σ areaᵢ nᵢ·pᵢ is three times the enclosed volume, and Σ areaᵢ nᵢ vanishes for a closed
/// surface. A point stands for an area that goes with its ring's width squared.
fn normal_health(cloud: &PointCloud, looks: &[Look]) -> NormalHealth {
    let with_normal = || looks.iter().filter_map(|look| Some((look, look.normal?, f64::from(look.ring).powi(2))));
    let area: f64 = with_normal().map(|(_, _, area)| area).sum();
    let centre = with_normal().map(|(look, _, area)| look.offset * area).sum::<DVec3>() / area.max(f64::MIN_POSITIVE);
    let size = with_normal().map(|(look, _, area)| area * (look.offset - centre).length()).sum::<f64>();
    let flux = with_normal().map(|(look, normal, area)| area * normal.dot(look.offset - centre)).sum::<f64>();
    let vector = with_normal().map(|(_, normal, area)| normal * area).sum::<DVec3>();
    let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
    let against = looks.iter().filter(|look| look.is_against_neighbours).count();
    NormalHealth {
        missing: (0..cloud.len()).filter(|&i| cloud.normal(i).is_none()).count(),
        against_neighbours: share(against as f64, looks.len() as f64),
        enclosed: share(flux, size),
        openness: share(vector.length(), area),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A closed cube of side 2, faces outward.
    fn cube() -> TriMesh {
        let positions =
            (0..8).map(|i| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64) * 2.0).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        TriMesh { positions, triangles, colours: None }
    }

    #[test]
    fn a_cube_is_closed_and_knows_its_inside() {
        let health = MeshHealth::of(&cube());
        assert!(health.is_closed() && !health.is_inside_out());
        assert!((health.signed_volume - 8.0).abs() < 1e-12 && (health.area - 24.0).abs() < 1e-12);
        assert!(health.openness < 1e-12);
        let mut turned = cube();
        turned.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        assert!(MeshHealth::of(&turned).is_inside_out());
    }

    #[test]
    fn holes_fins_and_turned_faces_are_counted() {
        let mut open = cube();
        open.triangles.truncate(10); // one face of the six is gone
        let health = MeshHealth::of(&open);
        assert_eq!((health.boundary_edges, health.non_manifold_edges, health.inconsistent_edges), (4, 0, 0));
        assert!((health.openness - 4.0 / 20.0).abs() < 1e-12);
        let mut turned = cube();
        turned.triangles[0].swap(1, 2);
        assert_eq!(MeshHealth::of(&turned).inconsistent_edges, 3);
        let mut fin = cube();
        fin.positions.push(DVec3::splat(5.0));
        fin.triangles.push([0, 1, 8]);
        let health = MeshHealth::of(&fin);
        assert_eq!((health.boundary_edges, health.non_manifold_edges), (2, 1));
    }

    /// `count` points of a unit sphere, evenly spread (Fibonacci), with outward normals.
    fn sphere(count: usize) -> PointCloud {
        let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let point = |i: usize| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
            let (sin, cos) = (golden * i as f64).sin_cos();
            DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
        };
        let positions: Vec<_> = (0..count).map(point).collect();
        let normals = positions.iter().map(|p| p.as_vec3()).collect();
        PointCloud { positions, normals: Some(normals), ..Default::default() }
    }

    #[test]
    fn an_even_sphere_is_healthy() {
        let cloud = sphere(5000);
        let health = CloudHealth::of(&cloud, &DAffine3::from_scale(DVec3::splat(10.0)));
        // The area of the sphere of radius 10 over the points, up to the packing.
        let cell = (4.0 * std::f64::consts::PI * 100.0 / 5000.0).sqrt();
        assert!((health.spacing / cell - 1.0).abs() < 0.15, "{health:?}");
        assert!(health.spacing_range.1 / health.spacing_range.0 < 1.3, "{health:?}");
        assert_eq!((health.points, health.duplicates, health.outliers), (5000, 0, 0));
        let normals = health.normals.unwrap();
        assert_eq!((normals.missing, normals.against_neighbours), (0, 0.0));
        assert!(normals.enclosed > 0.99 && normals.openness < 0.01, "{normals:?}");
    }

    #[test]
    fn faults_of_a_cloud_are_seen() {
        let mut cloud = sphere(5000);
        let normals = cloud.normals.as_mut().unwrap();
        normals.iter_mut().for_each(|n| *n = -*n);
        let health = CloudHealth::of(&cloud, &DAffine3::IDENTITY).normals.unwrap();
        assert!(health.enclosed < -0.99);
        // Every fiftieth normal against its neighbours, one missing; a duplicate and two points far away.
        let mut cloud = sphere(5000);
        let normals = cloud.normals.as_mut().unwrap();
        normals.iter_mut().step_by(50).for_each(|n| *n = -*n);
        normals[1] = PointCloud::NO_NORMAL;
        for far in [cloud.positions[7], DVec3::splat(9.0), DVec3::splat(-9.0)] {
            cloud.positions.push(far);
            cloud.normals.as_mut().unwrap().push(Vec3::Z);
        }
        let health = CloudHealth::of(&cloud, &DAffine3::IDENTITY);
        assert_eq!((health.duplicates, health.outliers), (1, 2));
        let normals = health.normals.unwrap();
        assert_eq!(normals.missing, 1);
        assert!((normals.against_neighbours - 0.02).abs() < 0.005, "{normals:?}");
        // Half a sphere is open: its vector area is that of the disk, π of 2π.
        let mut half = sphere(5000);
        let keep: Vec<bool> = half.positions.iter().map(|p| p.z > 0.0).collect();
        half.retain(|i| keep[i]);
        let openness = CloudHealth::of(&half, &DAffine3::IDENTITY).normals.unwrap().openness;
        assert!((openness - 0.5).abs() < 0.03, "{openness}");
    }

    #[test]
    fn a_mirrored_leaf_keeps_its_outside_and_few_points_do_no_harm() {
        let mirror = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        let health = CloudHealth::of(&sphere(500), &mirror).normals.unwrap();
        assert!(health.enclosed > 0.9);
        for count in [0, 1, 2, 3] {
            let mut cloud = sphere(500);
            cloud.retain(|i| i < count);
            assert_eq!(CloudHealth::of(&cloud, &DAffine3::IDENTITY).points, count);
        }
        // A million identical points are one place.
        let same = PointCloud { positions: vec![DVec3::ONE; 1_000_000], ..Default::default() };
        assert_eq!(CloudHealth::of(&same, &DAffine3::IDENTITY).duplicates, 999_999);
    }
}
