//! Cases on disk: the TOML scene and its scans as PLY, so that the command line draws what the suite draws.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};

use super::scenes::{Case, CaseError};
use crate::formats::{WriteError, write_ply_cloud};
use crate::geometry::Solid;
use crate::output::{Destination, OutputError};
use crate::space::Lens;

/// Why a case could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteCaseError {
    /// It makes no scans.
    #[error(transparent)]
    Case(#[from] CaseError),
    /// A scan could not be written.
    #[error(transparent)]
    Scan(#[from] WriteError),
    /// The scene could not be written.
    #[error(transparent)]
    Scene(#[from] OutputError),
    /// The folder could not be made.
    #[error("{path}: the folder cannot be made: {source}", path = path.display())]
    Folder {
        /// Which.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
}

impl Case {
    /// Writes `folder/NAME.toml` and `folder/NAME/LEAF.ply` for every leaf, over whatever is there. Returns the scene's path.
    ///
    /// # Errors
    /// [`WriteCaseError`].
    pub fn write(&self, folder: &Path) -> Result<PathBuf, WriteCaseError> {
        let clouds = self.clouds()?;
        let scans = folder.join(&self.name);
        std::fs::create_dir_all(&scans).map_err(|source| WriteCaseError::Folder { path: scans.clone(), source })?;
        for (leaf, cloud) in self.leaves.iter().zip(&clouds) {
            write_ply_cloud(&scans.join(format!("{}.ply", leaf.name)), cloud)?;
        }
        let path = folder.join(format!("{}.toml", self.name));
        let file_of = |leaf: &str| format!("{}/{leaf}.ply", self.name);
        Destination::File(path.clone()).write(true, self.to_toml(&file_of).as_bytes())?;
        Ok(path)
    }

    /// The case as the text of a scene file, in which leaf `name` is the file `file_of(name)`.
    pub fn to_toml(&self, file_of: &dyn Fn(&str) -> String) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_toml(&mut text, file_of);
        text
    }

    fn write_toml(&self, text: &mut String, file_of: &dyn Fn(&str) -> String) -> std::fmt::Result {
        writeln!(text, "# {}.", self.about)?;
        writeln!(text, "# The reference renderer draws each leaf's `truth` instead of its points.")?;
        writeln!(text, "csg = {:?}", self.csg)?;
        writeln!(text, "size = [{}, {}]", self.size.0, self.size.1)?;
        let camera = &self.camera;
        writeln!(text, "\n[camera]")?;
        writeln!(text, "eye = {}", vector(camera.eye))?;
        writeln!(text, "target = {}", vector(camera.target))?;
        writeln!(text, "up = {}", vector(camera.up))?;
        match camera.lens {
            Lens::FovY(degrees) => writeln!(text, "fov_y = {degrees:?}")?,
            Lens::Height(units) => writeln!(text, "height = {units:?}")?,
        }
        for leaf in &self.leaves {
            writeln!(text, "\n[leaf.{}]", leaf.name)?;
            writeln!(text, "file = {:?}", file_of(&leaf.name))?;
            if leaf.world_from_leaf != DAffine3::IDENTITY {
                writeln!(text, "matrix = {}", matrix(&leaf.world_from_leaf))?;
            }
            writeln!(text, "truth = {{ {} }}", solid_toml(&leaf.solid))?;
        }
        Ok(())
    }
}

/// The shortest decimals that are read back as the same numbers.
fn vector(v: DVec3) -> String {
    format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z)
}

fn matrix(map: &DAffine3) -> String {
    let rows = map.matrix3.transpose();
    let row = |r: DVec3, t: f64| format!("[{:?}, {:?}, {:?}, {t:?}]", r.x, r.y, r.z);
    let [x, y, z] = [rows.x_axis, rows.y_axis, rows.z_axis];
    let t = map.translation;
    format!("[{}, {}, {}, [0.0, 0.0, 0.0, 1.0]]", row(x, t.x), row(y, t.y), row(z, t.z))
}

/// A solid as a scene file's `key = { … }`.
fn solid_toml(solid: &Solid) -> String {
    match solid {
        Solid::HalfSpace { point, normal, extent } => {
            format!("half_space = {{ point = {}, normal = {}, extent = {extent:?} }}", vector(*point), vector(*normal))
        }
        Solid::Box { min, max } => format!("box = {{ min = {}, max = {} }}", vector(*min), vector(*max)),
        Solid::Sphere { centre, radius } => {
            format!("sphere = {{ centre = {}, radius = {radius:?} }}", vector(*centre))
        }
        Solid::Cylinder { from, to, radius } => {
            format!("cylinder = {{ from = {}, to = {}, radius = {radius:?} }}", vector(*from), vector(*to))
        }
        Solid::Cone { from, to, radius_from, radius_to } => format!(
            "cone = {{ from = {}, to = {}, radius_from = {radius_from:?}, radius_to = {radius_to:?} }}",
            vector(*from),
            vector(*to)
        ),
        Solid::Torus { centre, axis, radius, tube } => format!(
            "torus = {{ centre = {}, axis = {}, radius = {radius:?}, tube = {tube:?} }}",
            vector(*centre),
            vector(*axis)
        ),
        Solid::Blend { balls, smoothness } => {
            let ball = |ball: &crate::geometry::solid::Ball| {
                let c = ball.centre;
                format!("[{:?}, {:?}, {:?}, {:?}]", c.x, c.y, c.z, ball.radius)
            };
            let balls: Vec<String> = balls.iter().map(ball).collect();
            format!("blend = {{ balls = [{}], smoothness = {smoothness:?} }}", balls.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::formats::{NoProgress, ReadOptions};
    use crate::measure::scenes::{
        accuracy_cases, cube, femoral_cutters, five_spheres_minus, five_spheres_union, icosahedron, proximal_femur,
        unknown_cases,
    };
    use crate::scene::{LeafGeometry, LeafSource, Truth, load, toml_file};

    #[test]
    fn what_is_written_is_read_back_as_it_was() {
        // The large cases only differ in their number of points.
        const MOST_POINTS: usize = 25_000;
        let folder = tempfile::tempdir().unwrap();
        for case in accuracy_cases().into_iter().chain(unknown_cases()) {
            if case.leaves.iter().map(|leaf| leaf.scan.count).sum::<usize>() > MOST_POINTS {
                continue;
            }
            let path = case.write(folder.path()).unwrap();
            let expected = case.scene().unwrap();
            let scene = toml_file::read(&path).unwrap();
            assert_eq!((scene.camera, scene.size, &scene.tree), (expected.camera, expected.size, &expected.tree));
            let loaded = load(scene, &ReadOptions::default(), &NoProgress).unwrap();
            for (i, leaf) in expected.leaves.iter().enumerate() {
                let (LeafSource::Cloud(cloud), LeafGeometry::Cloud(read)) = (&leaf.source, &loaded.geometry[i]) else {
                    panic!("{}: {} is no cloud", case.name, leaf.name);
                };
                assert_eq!(cloud.positions, read.positions, "{} {}", case.name, leaf.name);
                assert_eq!(cloud.radii, read.radii, "{}", case.name);
                // A reader makes normals a unit long again, which may cost the last bit.
                let same = |(a, b): (&Vec3, &Vec3)| a.distance(*b) < 1e-6;
                match (&cloud.normals, &read.normals) {
                    (Some(a), Some(b)) => assert!(a.iter().zip(b).all(same), "{} {}", case.name, leaf.name),
                    (a, b) => assert_eq!(a.is_some(), b.is_some(), "{}", case.name),
                }
                let read = &loaded.scene.leaves[i];
                assert_eq!((&leaf.name, leaf.world_from_leaf), (&read.name, read.world_from_leaf));
                let (Some(Truth::Solid(truth)), Some(Truth::Solid(read))) = (&leaf.truth, &read.truth) else {
                    panic!("{}: {} has no truth", case.name, leaf.name);
                };
                // The same to the last bit but for directions, which a reader normalises once more.
                let off = |p: DVec3| (truth.signed_distance_bound(p) - read.signed_distance_bound(p)).abs();
                let probes = [DVec3::ZERO, DVec3::new(1.7, -0.4, 0.9), DVec3::new(-0.3, 2.1, -1.5)];
                assert!(probes.into_iter().all(|p| off(p) < 1e-12), "{truth:?} {read:?}");
                let ((min, max), (read_min, read_max)) = (truth.drawn_bounds(), read.drawn_bounds());
                assert!(min.distance(read_min) < 1e-12 && max.distance(read_max) < 1e-12, "{truth:?} {read:?}");
            }
        }
    }

    #[test]
    fn the_scenes_of_data_are_those_that_the_programs_write() {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
        let read = |name: &str| load(toml_file::read(&data.join(name)).unwrap(), &ReadOptions::default(), &NoProgress);
        for (case, name) in [
            (five_spheres_union(), "five_spheres_union.toml"),
            (five_spheres_minus(), "five_spheres_minus.toml"),
            (icosahedron(), "icosahedron.toml"),
            (cube(), "cube_1_25_900.toml"),
        ] {
            let loaded = read(name).unwrap();
            assert_eq!(loaded.scene.tree, case.scene().unwrap().tree, "{name}");
            for (cloud, read) in case.clouds().unwrap().iter().zip(&loaded.geometry) {
                let LeafGeometry::Cloud(read) = read else { panic!("{name}") };
                assert_eq!((cloud.len(), &cloud.radii), (read.len(), &read.radii), "{name}");
                assert!(cloud.positions.iter().zip(&read.positions).all(|(a, b)| a.distance(*b) < 1e-6), "{name}");
            }
        }
        // The femur's truth, and its scan within the scanner's noise of it.
        const HEAD_RADIUS: f64 = 24.0;
        let loaded = read("femoral_head.toml").unwrap();
        let femur = proximal_femur(HEAD_RADIUS);
        let (Some(Truth::Solid(truth)), LeafGeometry::Cloud(scan)) =
            (&loaded.scene.leaves[0].truth, &loaded.geometry[0])
        else {
            panic!("the femur is a scan with a truth")
        };
        assert_eq!(scan.len(), 24_000);
        for p in &scan.positions {
            assert!((truth.signed_distance_bound(*p) - femur.signed_distance_bound(*p)).abs() < 1e-9);
            assert!(truth.signed_distance_bound(*p).abs() < 0.15, "a scanned point far off the bone: {p}");
        }
        let cutters = femoral_cutters(HEAD_RADIUS);
        for (cutter, read) in cutters.iter().zip(&loaded.geometry[1..]) {
            let LeafGeometry::Solid(read) = read else { panic!("a cutter is a solid") };
            for p in [DVec3::ZERO, DVec3::X * 20.0] {
                assert!((cutter.signed_distance_bound(p) - read.signed_distance_bound(p)).abs() < 1e-9);
            }
        }
        let meshes = read("mesh_minus_mesh.toml").unwrap();
        for mesh in &meshes.geometry {
            let LeafGeometry::Mesh(mesh) = mesh else { panic!("a mesh") };
            assert!(mesh.signed_volume() > 0.0 && crate::scene::inspect::MeshHealth::of(mesh).is_closed());
        }
    }
}
