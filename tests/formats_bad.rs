//! Unusable files: every one gets a message with its name, the place, what is wrong and what would mend it.

use std::path::Path;

use surfcut::formats::{NoProgress, Place, ReadError, ReadOptions, read, read_bytes};

fn refuse(name: &str, bytes: impl AsRef<[u8]>) -> ReadError {
    match read_bytes(Path::new(name), bytes.as_ref(), &ReadOptions::default(), &NoProgress) {
        Ok(loaded) => panic!("{name} was read: {loaded:?}"),
        Err(error) => {
            let message = error.to_string();
            assert!(message.starts_with(&format!("{name}: ")), "{message}");
            assert!(message.contains("; "), "nothing to mend it with: {message}");
            error
        }
    }
}

#[track_caller]
fn says(error: &ReadError, words: &str, place: Place) {
    let message = error.to_string();
    assert!(message.contains(words), "{message}");
    assert_eq!(error.place(), Some(place), "{message}");
}

fn ply(rest: &str) -> String {
    format!("ply\nformat ascii 1.0\n{rest}")
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

#[test]
fn files_that_cannot_be_opened() {
    let folder = tempfile::tempdir().unwrap();
    let open = |path: &Path| read(path, &ReadOptions::default(), &NoProgress).unwrap_err();
    assert!(matches!(open(&folder.path().join("none.ply")), ReadError::Absent { .. }));
    assert!(matches!(open(folder.path()), ReadError::Directory { .. }));
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        assert!(matches!(open(Path::new("/dev/zero")), ReadError::NotAFile { .. }));
        let locked = folder.path().join("locked.ply");
        std::fs::write(&locked, "x").unwrap();
        std::fs::set_permissions(&locked, std::fs::Permissions::from_mode(0o000)).unwrap();
        // The superuser may read it all the same, and then finds rubbish.
        let error = open(&locked);
        assert!(matches!(error, ReadError::Permission { .. } | ReadError::Malformed { .. }), "{error}");
    }
}

#[test]
fn empty_and_unknown_files() {
    for name in ["a.ply", "a.stl", "a.obj", "a.xyz", "a"] {
        assert!(matches!(refuse(name, b""), ReadError::Empty { .. }));
    }
    assert!(matches!(refuse("a", b"\x00\x01\x02\x03"), ReadError::UnknownFormat { .. }));
    assert!(matches!(refuse("a.bin", "hello\n"), ReadError::UnknownFormat { .. }));
    assert!(matches!(refuse("a.las", b"LASF\x00"), ReadError::Unsupported { .. }));
    assert!(matches!(refuse("a.xyz", b"\xff\xfe1\x00"), ReadError::Unsupported { .. }));
    assert!(matches!(refuse("a.ply", "hello\n"), ReadError::Malformed { .. }));
    assert!(matches!(refuse("a.xyz", "# nothing\n\n"), ReadError::Empty { .. }));
    assert!(matches!(refuse("a.obj", "# nothing\n\n"), ReadError::Empty { .. }));
    assert!(matches!(refuse("a.stl", "solid\nendsolid\n"), ReadError::Empty { .. }));
    assert!(matches!(
        refuse("a.ply", ply("element vertex 0\nproperty float x\nend_header\n")),
        ReadError::Empty { .. }
    ));
    assert!(matches!(
        refuse("a.ply", ply("element point 1\nproperty float x\nend_header\n1\n")),
        ReadError::Empty { .. }
    ));
    assert!(matches!(refuse("a.stl", [0; 84]), ReadError::Empty { .. }));
}

#[test]
fn ply_headers_that_are_wrong() {
    let header = |rest: &str| refuse("a.ply", ply(rest));
    says(&header("element vertex 1\nproperty float x\n"), "no line end_header", Place::Line(5));
    says(&header("element vertex -1\nend_header\n"), "element vertex -1", Place::Line(3));
    says(&header("element vertex 99999999999999999999\nend_header\n"), "no element's", Place::Line(3));
    says(&header("property float x\nend_header\n"), "before any element", Place::Line(3));
    says(&header("element vertex 1\nproperty half x\nend_header\n"), "unknown type 'half'", Place::Line(4));
    says(&header("element vertex 1\nproperty list float int x\nend_header\n"), "real number", Place::Line(4));
    says(&header("element vertex 1\nproperty float\nend_header\n"), "no property", Place::Line(4));
    says(&header("elephant\nend_header\n"), "unknown keyword 'elephant'", Place::Line(3));
    says(
        &header("element vertex 1\nproperty float x\nproperty float y\nend_header\n1 2\n"),
        "lacks x, y or z",
        Place::Line(3),
    );
    let twice = format!("element vertex 1\n{XYZ}property float y\nend_header\n1 2 3 4\n");
    says(&header(&twice), "declared twice", Place::Line(3));
    says(
        &header("element vertex 1\nproperty uint packed_position\nend_header\n1\n"),
        "packed_position",
        Place::Line(3),
    );
    says(&refuse("a.ply", "ply\nformat ebcdic 1.0\nend_header\n"), "unknown format 'ebcdic'", Place::Line(2));
    says(&refuse("a.ply", "ply\nformat ascii 2.0\nend_header\n"), "unknown version", Place::Line(2));
    says(&refuse("a.ply", "ply\nelement vertex 1\nend_header\n"), "no line 'format'", Place::Line(2));
    says(
        &refuse("a.ply", b"ply\nformat ascii 1.0\ncomment \xff\xfe\n\xff\nend_header\n"),
        "unknown keyword",
        Place::Line(4),
    );
}

#[test]
fn ply_headers_that_lie() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let header = |rest: &str| refuse("a.ply", format!("ply\nformat {format} 1.0\n{rest}"));
        says(&header(&format!("element vertex 4000000000\n{XYZ}end_header\n")), "4000000000 rows", Place::Line(3));
        says(
            &header(&format!("element vertex {}\n{XYZ}end_header\n", u64::MAX)),
            "18446744073709551615 rows",
            Place::Line(3),
        );
        let faces = "element face 4000000000\nproperty list uchar int vertex_indices\n";
        says(
            &header(&format!("element vertex 1\n{XYZ}{faces}end_header\n1 2 345678901234567890")),
            "4000000000",
            Place::Line(7),
        );
    }
    let list = |count: &str, body: &[u8]| {
        let head = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty list {count} double q\nproperty uchar x\n\
             property uchar y\nproperty uchar z\nend_header\n"
        );
        let at = head.len() as u64;
        (refuse("a.ply", [head.as_bytes(), body].concat()), at)
    };
    let (error, at) = list("uint", &[0xff; 20]);
    says(&error, "claims 4294967295 items", Place::Byte(at));
    let (error, at) = list("int", &[0xff; 20]);
    says(&error, "claims -1 items", Place::Byte(at));
    let (error, at) = list("uchar", &[2; 18]);
    says(&error, "ends within y", Place::Byte(at + 18));
    let ascii = format!("element vertex 1\nproperty list uint int q\n{XYZ}end_header\n4000000000 1 2 3\n");
    says(&refuse("a.ply", ply(&ascii)), "claims 4000000000 items", Place::Line(9));
    let ascii = format!("element vertex 1\nproperty list uint int q\n{XYZ}end_header\nnan 1 2 3\n");
    says(&refuse("a.ply", ply(&ascii)), "claims NaN items", Place::Line(9));
}

#[test]
fn ply_bodies_that_are_wrong() {
    let body = |rows: &str| refuse("a.ply", ply(&format!("element vertex 2\n{XYZ}end_header\n{rows}")));
    says(&body("1 2 3\n4 5 six\n"), "'six' is not a number", Place::Column { line: 9, column: 5 });
    says(&body("1 2 3\n\n4 5\n"), "ends before z", Place::Column { line: 10, column: 4 });
    says(&body("1 2 3 4\n4 5 6\n"), "'4' follows", Place::Column { line: 8, column: 7 });
    says(&body("1 2 3.00000\n\n\n"), "ends within element vertex", Place::Line(10));
    let face = |row: &str| {
        let text =
            format!("element vertex 2\n{XYZ}element face 1\nproperty list char int vertex_indices\nend_header\n");
        refuse("a.ply", ply(&format!("{text}0 0 0\n1 1 1\n{row}\n")))
    };
    says(&face("3 0 1 2"), "uses vertex 2, but there are 2", Place::Line(12));
    says(&face("3 0 1 -1"), "uses vertex -1", Place::Line(12));
    says(&face("3 0 1 nan"), "uses vertex NaN", Place::Line(12));
    says(&face("3 0 1 0.5"), "uses vertex 0.5", Place::Line(12));
    says(&face("4 0 1 1"), "ends before vertex_indices", Place::Column { line: 12, column: 8 });
    assert!(matches!(face("3 0 1 1"), ReadError::Empty { .. }));
}

#[test]
fn values_that_cannot_be_are_counted_and_the_first_is_named() {
    let check = |error: ReadError, expected: u64, place: Place, words: &str| match &error {
        ReadError::Invalid { count, .. } => {
            assert_eq!(*count, expected);
            says(&error, words, place);
        }
        other => panic!("{other}"),
    };
    check(refuse("a.xyz", "1 2 3\n1 -inf 3\nnan 2 3\n"), 2, Place::Line(2), "y is -inf");
    check(refuse("a.xyz", "1 2 3 0 1 0\n1 2 3 0 nan 0\n"), 1, Place::Line(2), "ny is NaN");
    check(refuse("a.obj", "v 1 2 3\nv 1 2 1e999\n"), 1, Place::Line(2), "z is inf");
    check(refuse("a.xyz", "1 2 3\n1 2 1e16\n"), 1, Place::Line(2), "z is 1e16, beyond");
    let radius = ply(&format!("element vertex 2\n{XYZ}property float radius\nend_header\n1 2 3 1\n1 2 3 0\n"));
    check(refuse("a.ply", radius), 1, Place::Line(10), "radius is 0");
    let mut stl = [0; 84 + 100];
    stl[80] = 2;
    stl[84 + 50 + 12..84 + 50 + 16].copy_from_slice(&f32::NAN.to_le_bytes());
    check(refuse("a.stl", stl), 1, Place::Byte(134), "x is NaN");
    // All are invalid: nothing is left to drop.
    let drop = ReadOptions { drop_invalid: true, ..Default::default() };
    let error = read_bytes(Path::new("a.xyz"), b"nan 1 2\n", &drop, &NoProgress).unwrap_err();
    assert!(matches!(error, ReadError::Empty { .. }), "{error}");
}

#[test]
fn stl_files_that_lie() {
    let mut bytes = vec![b' '; 100];
    bytes[80..84].copy_from_slice(&100_000_000_u32.to_le_bytes());
    says(&refuse("a.stl", &bytes), "claims 100000000 triangles, but only 0", Place::Byte(80));
    says(&refuse("a.stl", &bytes[..50]), "50 bytes are too few", Place::Byte(50));
    let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n";
    says(&refuse("a.stl", text), "without endsolid", Place::Line(5));
    says(&refuse("a.stl", format!("{text}endfacet\n")), "where vertex should be", Place::Column { line: 6, column: 1 });
    says(&refuse("a.stl", format!("{text}vertex 0 1\n")), "fewer than three", Place::Column { line: 6, column: 11 });
    says(
        &refuse("a.stl", format!("{text}vertex 0 1 x\n")),
        "'x' is not a number",
        Place::Column { line: 6, column: 12 },
    );
    says(&refuse("a.stl", "solid a\nvertex 1 2 3\n"), "where facet or endsolid", Place::Column { line: 2, column: 1 });
}

#[test]
fn obj_files_that_are_wrong() {
    let obj = |text: &str| refuse("a.obj", text);
    says(&obj("v 1 2\n"), "2 numbers", Place::Column { line: 1, column: 6 });
    says(&obj("v 1 2 three\n"), "'three' is not a number", Place::Column { line: 1, column: 7 });
    says(&obj("v 1 2 3 0\n"), "weight 0", Place::Line(1));
    says(&obj("v 1 2 3\nf 1 2 3\n"), "uses vertex 3, but the file has 1", Place::Line(2));
    says(&obj("v 1 2 3\nf 1 0 1\n"), "uses vertex 0", Place::Column { line: 2, column: 5 });
    says(&obj("v 1 2 3\nf 1 -2 1\n"), "uses vertex -2", Place::Column { line: 2, column: 5 });
    says(&obj("v 1 2 3\nf 1 a/b 1\n"), "'a/b' is no corner", Place::Column { line: 2, column: 5 });
    says(&obj("v 1 2 3\nf 1 99999999999 1\n"), "uses vertex 99999999999", Place::Line(2));
    says(&obj("v 1 2 3\nf\n"), "without corners", Place::Line(2));
    says(&obj("v 1 2 3\nvn 1 2\n"), "three numbers", Place::Column { line: 2, column: 7 });
}

#[test]
fn text_points_that_are_wrong() {
    let xyz = |text: &str| refuse("a.xyz", text);
    says(&xyz("x y z\n1 2 3\n"), "'x' is not a number", Place::Column { line: 1, column: 1 });
    says(&xyz("# c\n1 2 3\n4 5\n"), "2 columns, but line 2 has 3", Place::Column { line: 3, column: 4 });
    says(&xyz("1 2\n"), "2 columns have no meaning", Place::Line(1));
    says(&xyz("1 2 3 4 5\n"), "5 columns have no meaning", Place::Line(1));
    says(&xyz("1 2 3\n1 2,3x 4\n"), "'3x' is not a number", Place::Column { line: 2, column: 5 });
    says(&xyz("3\n1 2 3\n4 5 6\n"), "says 3 points, but 2 follow", Place::Line(1));
    says(&xyz("1.5\n1 2 3\n"), "no number of points", Place::Column { line: 1, column: 1 });
    assert!(matches!(xyz("3\n"), ReadError::Malformed { .. }));
    assert!(matches!(refuse("a.xyz", b"1 2 \xff\xff\n"), ReadError::Malformed { .. }));
}

#[test]
fn a_header_of_forty_thousand_lines_is_read_in_no_time() {
    let properties: String = (0..40_000).map(|i| format!("property uchar p{i}\n")).collect();
    let started = std::time::Instant::now();
    let message = refuse("a.ply", ply(&format!("element vertex 0\nelement a 0\n{properties}end_header\n"))).to_string();
    assert!(message.len() < 1000, "{} bytes", message.len());
    let text = ply(&format!("element vertex 1\n{properties}end_header\n{}\n", "1 ".repeat(40_000)));
    let message = refuse("a.ply", text).to_string();
    assert!(message.contains("lacks x, y or z") && message.len() < 1000, "{message}");
    // A search of all names for each name would take minutes.
    assert!(started.elapsed().as_secs() < 5);
}
