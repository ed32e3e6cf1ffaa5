//! The same pictures, byte for byte, on any number of threads.

use std::fs;
use std::path::Path;
use std::process::Command;

/// Surfels of the scanned sphere: enough for several tasks a thread in every stage.
const SURFELS: usize = 20_000;

/// A unit sphere of [`SURFELS`] oriented points on a golden spiral, as an ascii PLY.
fn sphere_ply() -> String {
    let mut ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {SURFELS}\nproperty double x\nproperty double y\nproperty double z\n\
         property float nx\nproperty float ny\nproperty float nz\nend_header\n"
    );
    let golden_angle = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    for i in 0..SURFELS {
        let z = 1.0 - (2 * i + 1) as f64 / SURFELS as f64;
        let (sin, cos) = (golden_angle * i as f64).sin_cos();
        let (x, y) = ((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin);
        ply.push_str(&format!("{x} {y} {z} {x} {y} {z}\n"));
    }
    ply
}

/// The PNG that `flags` draw on so many threads.
fn picture(directory: &Path, flags: &str, threads: u32) -> Vec<u8> {
    let line = format!(
        "render ball.ply --minus cylinder:0,-2,0.4,0,2,0.4,0.5 --eye 2,-4,3 --target 0,0,0 --size 128x128 --samples 4 \
         {flags} --threads {threads} --quiet -o -"
    );
    let output = Command::new(env!("CARGO_BIN_EXE_surfcut"))
        .current_dir(directory)
        .args(line.split_whitespace())
        .output()
        .unwrap();
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

#[test]
fn threads_do_not_change_a_byte() {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("ball.ply"), sphere_ply()).unwrap();
    for clip in ["surface", "fragment"] {
        for layers in ["all", "nearest"] {
            let flags = format!("--clip {clip} --layers {layers}");
            let one = picture(directory.path(), &flags, 1);
            let colours: std::collections::HashSet<_> =
                image::load_from_memory(&one).unwrap().to_rgb8().pixels().copied().collect();
            assert!(colours.len() > 100, "{flags}: the picture shows a shaded body");
            assert!(one == picture(directory.path(), &flags, 2), "{flags}: two threads draw another picture than one");
        }
    }
}

#[test]
fn threads_do_not_change_a_byte_of_meshes() {
    let directory = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/mesh_minus_mesh.toml");
    let picture = |threads: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_surfcut"))
            .current_dir(directory.path())
            .args(["render", scene.to_str().unwrap(), "--pipeline", "mesh", "--size", "200x200", "--samples", "4"])
            .args(["--threads", threads, "--quiet", "-o", "-"])
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    };
    let one = picture("1");
    assert!(one.len() > 10_000, "the picture shows something");
    assert!(one == picture("2"), "two threads draw another picture than one");
}
