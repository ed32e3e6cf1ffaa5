//! What must hold of whatever a reader returns, for the fuzz targets and for the test that replays their findings.

use std::path::Path;

use surfcut::formats::{Format, Geometry, Loaded, NoProgress, ReadError, ReadOptions, read_as, read_bytes};

/// Reads `bytes` in every way, as `format` or as whatever they look like, and checks all that comes back.
pub fn check(format: Option<Format>, bytes: &[u8]) {
    for drop_invalid in [false, true] {
        for as_points in [false, true] {
            let options = ReadOptions { drop_invalid, as_points };
            let name = Path::new("fuzzed");
            let result = match format {
                Some(format) => read_as(format, name, bytes, &options, &NoProgress),
                None => read_bytes(name, bytes, &options, &NoProgress),
            };
            match result {
                Ok(loaded) => check_loaded(&loaded),
                Err(error) => check_message(&error, bytes.len()),
            }
        }
    }
}

fn check_message(error: &ReadError, length: usize) {
    /// Messages quote names of properties, of which a header may have many.
    const LONGEST_FIXED: usize = 1000;
    let message = error.to_string();
    assert!(message.starts_with("fuzzed: ") && message.contains("; "), "{message}");
    assert!(message.len() < LONGEST_FIXED + 8 * length, "{message}");
}

fn check_loaded(loaded: &Loaded) {
    loaded.notes.iter().for_each(|note| assert!(note.count > 0 && !note.to_string().is_empty()));
    match &loaded.geometry {
        Geometry::Cloud(cloud) => {
            assert!(!cloud.is_empty());
            assert!(cloud.positions.iter().all(|p| p.is_finite()));
            for length in [
                cloud.normals.as_ref().map(Vec::len),
                cloud.radii.as_ref().map(Vec::len),
                cloud.ellipses.as_ref().map(Vec::len),
                cloud.colours.as_ref().map(Vec::len),
                cloud.opacities.as_ref().map(Vec::len),
            ] {
                assert!(length.is_none_or(|length| length == cloud.len()));
            }
            for index in 0..cloud.len() {
                assert!(cloud.normal(index).is_none_or(|n| (n.length() - 1.0).abs() < 1e-5));
            }
            assert!(cloud.radii.iter().flatten().all(|r| *r > 0.0 && r.is_finite()));
            assert!(cloud.opacities.iter().flatten().all(|o| (0.0..=1.0).contains(o)));
            for ellipse in cloud.ellipses.iter().flatten() {
                assert!(ellipse.axis_u.is_finite() && ellipse.axis_v.is_finite());
                assert!(ellipse.axis_u.length_squared() >= 0.0 && ellipse.axis_v.length_squared() >= 0.0);
            }
        }
        Geometry::Mesh(mesh) => {
            assert!(!mesh.triangles.is_empty());
            assert!(mesh.positions.iter().all(|p| p.is_finite()));
            assert!(mesh.colours.as_ref().is_none_or(|colours| colours.len() == mesh.positions.len()));
            let mut used = vec![false; mesh.positions.len()];
            for &[a, b, c] in &mesh.triangles {
                assert!(a != b && b != c && c != a);
                [a, b, c].iter().for_each(|&v| used[v as usize] = true);
            }
            assert!(used.iter().all(|&used| used));
        }
    }
}
