//! Well-formed files of every kind, against values known from outside the readers: typed in, or read by other crates.

use std::path::Path;

use glam::{DVec3, Vec3};
use surfcut::formats::{Format, Geometry, Loaded, NoProgress, NoteKind, ReadOptions, read_bytes};
use surfcut::geometry::{PointCloud, TriMesh};

fn load_with(name: &str, bytes: impl AsRef<[u8]>, options: ReadOptions) -> Loaded {
    read_bytes(Path::new(name), bytes.as_ref(), &options, &NoProgress).unwrap_or_else(|e| panic!("{e}"))
}

fn load(name: &str, bytes: impl AsRef<[u8]>) -> Loaded {
    load_with(name, bytes, ReadOptions::default())
}

fn cloud(loaded: Loaded) -> PointCloud {
    match loaded.geometry {
        Geometry::Cloud(cloud) => cloud,
        Geometry::Mesh(_) => panic!("a mesh where points should be"),
    }
}

fn mesh(loaded: Loaded) -> TriMesh {
    match loaded.geometry {
        Geometry::Mesh(mesh) => mesh,
        Geometry::Cloud(_) => panic!("points where a mesh should be"),
    }
}

/// A small generator of reproducible numbers (xorshift), so that the files here have no pattern.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1_u32 << 24) as f32 - 0.5
    }
}

const CUBE_CORNERS: [[f32; 3]; 8] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [1.0, 0.0, 1.0],
    [1.0, 1.0, 1.0],
    [0.0, 1.0, 1.0],
];
const CUBE_QUADS: [[u32; 4]; 6] = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];

/// Every type, one property each, in an odd order, with lists between them.
fn every_type(encoding: &str) -> Vec<u8> {
    let header = format!(
        "ply\r\nformat {encoding} 1.0\r\ncomment caf\u{e9}\r\nelement nothing 4000000000\r\nelement vertex 2\r\n\
         property list uint8 int16 tags\r\nproperty double z\r\nproperty int8 a\r\nproperty uchar b\r\nproperty short c\r\n\
         property uint16 d\r\nproperty int y\r\nproperty uint32 e\r\nproperty float32 x\r\nproperty list ushort double more\r\n\
         element other 1\r\nproperty float q\r\nend_header\r\n"
    );
    let mut bytes: Vec<u8> = header.chars().map(|c| c as u32 as u8).collect(); // é in Latin-1
    let rows = [(vec![7_i16, -7], 1e-300_f64, -3_i32, 2.5_f32, vec![]), (vec![], -1e14, 7, -0.125, vec![1.0_f64, 2.0])];
    if encoding == "ascii" {
        for (tags, z, y, x, more) in rows {
            let list = |values: Vec<String>| [vec![values.len().to_string()], values].concat().join(" ");
            let tags = list(tags.iter().map(i16::to_string).collect());
            let more = list(more.iter().map(f64::to_string).collect());
            bytes.extend_from_slice(format!("{tags}  {z:e}\t-1 2 -3 4 {y} 5 {x} {more}\r\n").as_bytes());
        }
        bytes.extend_from_slice(b"\r\n9.5\r\n");
        return bytes;
    }
    let big = encoding == "binary_big_endian";
    let mut put = |mut value: Vec<u8>| {
        // Values are handed over in little endian.
        if big {
            value.reverse();
        }
        bytes.append(&mut value);
    };
    for (tags, z, y, x, more) in rows {
        put(vec![tags.len() as u8]);
        tags.iter().for_each(|tag| put(tag.to_le_bytes().to_vec()));
        put(z.to_le_bytes().to_vec());
        put((-1_i8).to_le_bytes().to_vec());
        put(vec![2]);
        put((-3_i16).to_le_bytes().to_vec());
        put(4_u16.to_le_bytes().to_vec());
        put(y.to_le_bytes().to_vec());
        put(5_u32.to_le_bytes().to_vec());
        put(x.to_le_bytes().to_vec());
        put((more.len() as u16).to_le_bytes().to_vec());
        more.iter().for_each(|m| put(m.to_le_bytes().to_vec()));
    }
    put(9.5_f32.to_le_bytes().to_vec());
    bytes
}

#[test]
fn ply_reads_every_type_in_every_encoding() {
    for encoding in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let loaded = load("a.ply", every_type(encoding));
        assert_eq!((loaded.format, loaded.stated.points), (Format::Ply, 2), "{encoding}");
        assert_eq!(loaded.count(NoteKind::Trailing), 0, "{encoding}");
        let expected = [DVec3::new(2.5, -3.0, 1e-300), DVec3::new(-0.125, 7.0, -1e14)];
        assert_eq!(cloud(loaded).positions, expected, "{encoding}");
    }
}

#[test]
fn a_header_that_ends_lines_in_cr_leaves_a_newline_byte_to_the_body() {
    let mut bytes = b"ply\rformat binary_little_endian 1.0\relement vertex 1\rproperty uchar x\rproperty uchar y\r\
        property uchar z\rend_header\r"
        .to_vec();
    bytes.extend_from_slice(b"\n\x05\x06");
    assert_eq!(cloud(load("a.ply", bytes)).positions, [DVec3::new(10.0, 5.0, 6.0)]);
}

#[test]
fn ply_colours_opacities_and_radii_in_all_their_types() {
    let read = |kind: &str, rgba: [&str; 4]| {
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
             property {kind} red\nproperty {kind} green\nproperty {kind} blue\nproperty {kind} alpha\n\
             property float radius\nend_header\n1 2 3 {} 0.25\n",
            rgba.join(" ")
        );
        cloud(load("a.ply", text))
    };
    for (kind, rgba) in [
        ("uchar", ["255", "0", "51", "51"]),
        ("ushort", ["65535", "0", "13107", "13107"]),
        ("float", ["1.0", "0", "0.2", "0.2"]),
        ("int", ["255", "0", "51", "51"]),
    ] {
        let cloud = read(kind, rgba);
        assert_eq!(cloud.colours, Some(vec![[255, 0, 51]]), "{kind}");
        assert_eq!(cloud.opacities, Some(vec![0.2]), "{kind}");
        assert_eq!(cloud.radii, Some(vec![0.25]), "{kind}");
    }
    // Reals far beyond 1 can only be 0 to 255.
    assert_eq!(read("float", ["255", "0", "51", "1"]).colours, Some(vec![[255, 0, 51]]));
}

#[test]
fn ply_normals_are_made_unit_and_a_zero_one_is_missing() {
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float nz\nproperty float x\nproperty float y\n\
                property float z\nproperty float nx\nproperty float ny\nend_header\n\
                0 1 1 1 0 0\n-2 1 1 2 0 0\n4 1 1 1 0 3\n";
    let loaded = load("a.ply", text);
    assert_eq!((loaded.count(NoteKind::ZeroNormals), loaded.count(NoteKind::DuplicatePoints)), (1, 1));
    let cloud = cloud(loaded);
    assert_eq!(cloud.normal(0), None);
    assert_eq!(cloud.normal(1), Some(Vec3::NEG_Z));
    assert_eq!(cloud.normal(2), Some(Vec3::new(0.0, 0.6, 0.8)));
}

fn cube_ply(faces: &str) -> String {
    let corners: String = CUBE_CORNERS.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    format!(
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n{faces}",
        faces = faces.replace("BODY\n", &format!("end_header\n{corners}"))
    )
}

#[test]
fn ply_polygons_become_fans() {
    let rows: String = CUBE_QUADS.iter().map(|[a, b, c, d]| format!("4 {a} {b} {c} {d}\n")).collect();
    let text = cube_ply(&format!("element face 6\nproperty list uchar uint vertex_index\nBODY\n{rows}"));
    let loaded = load("cube.ply", &text);
    assert_eq!((loaded.stated.faces, loaded.count(NoteKind::Polygons)), (6, 6));
    let mesh = mesh(loaded);
    assert_eq!((mesh.positions.len(), mesh.triangles.len()), (8, 12));
    assert!((mesh.signed_volume() - 1.0).abs() < 1e-15);
    let points = load_with("cube.ply", &text, ReadOptions { as_points: true, ..Default::default() });
    assert_eq!(cloud(points).len(), 8);
}

#[test]
fn ply_strips_turn_every_other_triangle() {
    // The cube as one strip and two lone squares, with restarts: the volume tells that all face outwards.
    let strips = "11 4 0 5 1 6 2 7 3 4 0 -1\n9 0 3 1 2 -1 4 5 7 6\n";
    let text = cube_ply(&format!("element tristrips 2\nproperty list int int vertex_indices\nBODY\n{strips}"));
    let mesh = mesh(load("cube.ply", text));
    assert_eq!(mesh.triangles.len(), 12);
    assert!((mesh.signed_volume() - 1.0).abs() < 1e-15, "{}", mesh.signed_volume());
}

#[test]
fn mesh_vertices_are_joined_and_what_is_useless_goes() {
    let text = "ply\nformat ascii 1.0\nelement vertex 6\nproperty double x\nproperty double y\nproperty double z\n\
                property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 5\n\
                property list uchar int vertex_indices\nend_header\n\
                0 0 0 1 1 1\n1 0 0 2 2 2\n0 1 0 3 3 3\n1 0 0 4 4 4\n9 9 9 5 5 5\n2 0 0 6 6 6\n\
                3 0 1 2\n3 1 3 2\n2 0 1\n3 0 1 5\n0\n";
    let loaded = load("a.ply", text);
    let counts = [
        NoteKind::WeldedVertices,
        NoteKind::DegenerateTriangles,
        NoteKind::SmallFaces,
        NoteKind::UnreferencedVertices,
        NoteKind::FlatTriangles,
    ]
    .map(|kind| loaded.count(kind));
    assert_eq!(counts, [1, 1, 2, 1, 1]);
    let mesh = mesh(loaded);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 1, 3]]);
    assert_eq!(mesh.colours, Some(vec![[1; 3], [2; 3], [3; 3], [6; 3]]));
}

#[test]
fn splats_are_flat_ellipses() {
    // Turned by 90 degrees about z (w x y z = 1 0 0 1, not of unit length): x goes to y, y to -x.
    let names = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let rows = "1 2 3 0 0 0 0 1.7724538509055159 -9 0 -4.605170186 0.693147181 0 1 0 0 1\n\
                4 5 6 0 0 0 0 0 0 inf 0 0.693147181 -inf 1 0 0 0\n";
    let text = format!("ply\nformat ascii 1.0\nelement vertex 2\n{properties}end_header\n{rows}");
    let loaded = load("a.ply", text);
    assert!(loaded.is_unoriented());
    assert_eq!(loaded.count(NoteKind::ZeroNormals), 0);
    let cloud = cloud(loaded);
    let normals = cloud.normals.as_deref().unwrap();
    let ellipses = cloud.ellipses.as_deref().unwrap();
    let close = |a: Vec3, b: Vec3| assert!((a - b).length() < 1e-6, "{a} {b}");
    close(normals[0], Vec3::Y); // exp(-4.6) = 0.01 is the least
    close(ellipses[0].axis_u, Vec3::new(-2.0, 0.0, 0.0));
    close(ellipses[0].axis_v, Vec3::Z);
    close(normals[1], Vec3::Z);
    close(ellipses[1].axis_u, Vec3::X);
    close(ellipses[1].axis_v, Vec3::Y * 2.0);
    assert_eq!(cloud.opacities, Some(vec![0.5, 1.0]));
    // 0.5 + 0.2820948 * 1.7724539 = 1.
    assert_eq!(cloud.colours, Some(vec![[128, 255, 0], [128; 3]]));
}

#[test]
fn two_scales_make_a_2dgs_splat() {
    let names = "x y z scale_0 scale_1 rot_0 rot_1 rot_2 rot_3";
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let text = format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n1 2 3 0 1 0 1 0 0\n");
    let cloud = cloud(load("a.ply", text));
    // Half a turn about x.
    assert_eq!(cloud.normals, Some(vec![Vec3::NEG_Z]));
    assert_eq!((cloud.opacities, cloud.colours), (None, None));
}

#[test]
fn text_points_in_all_their_columns() {
    let count = |text: &str| {
        let cloud = cloud(load("a.xyz", text));
        (cloud.len(), cloud.normals.is_some(), cloud.colours.is_some())
    };
    assert_eq!(count("1 2 3\n4 5 6\n"), (2, false, false));
    assert_eq!(count("1 2 3 0.7\n"), (1, false, false));
    assert_eq!(count("1,2,3,0,0,1\n1,2,3,0,1,0"), (2, true, false));
    assert_eq!(count("# caf\u{e9}\n1;2;3;10;20;30 // grey\n\n1;2;3;0;0;255\n"), (2, false, true));
    assert_eq!(count("1\t2\t3\t0.1\t0.2\t0.9\n1\t2\t3\t0.5\t0.5\t0.5\n"), (2, false, true));
    assert_eq!(count("1 2 3 -4 5.5 6\n"), (1, true, false));
    assert_eq!(count("2\n1 2 3 -100 10 20 30\n1 2 3 -200 10 20 30\n"), (2, false, true));
    assert_eq!(count("1 2 3 0 0.6 0.8 7\n"), (1, true, false));
    assert_eq!(count("1 2 3 10 20 30 0 0 -1\n"), (1, true, true));
    assert_eq!(count("1 2 3 0 0 -1 10 20 30\n"), (1, true, true));
    let both = cloud(load("a.txt", "1 2 3 10 20 30 0 0 -2\n1 2 3 255 0 0 1 1 1\n"));
    assert_eq!(both.colours, Some(vec![[10, 20, 30], [255, 0, 0]]));
    assert_eq!(both.normals.map(|n| n[0]), Some(Vec3::NEG_Z));
}

#[test]
fn map_coordinates_keep_their_millimetres() {
    let text = "653812.123 5184762.456 1203.789\n";
    assert_eq!(cloud(load("a.xyz", text)).positions, [DVec3::new(653_812.123, 5_184_762.456, 1_203.789)]);
    let obj = "v 653812.123 5184762.456 1203.789\n";
    assert_eq!(cloud(load("a.obj", obj)).positions, [DVec3::new(653_812.123, 5_184_762.456, 1_203.789)]);
}

/// A binary STL of the cube that begins like an ascii one.
fn cube_stl() -> Vec<u8> {
    let mut bytes = b"solid exported by a program that should know better".to_vec();
    bytes.resize(80, b' ');
    bytes.extend_from_slice(&12_u32.to_le_bytes());
    for [a, b, c, d] in CUBE_QUADS {
        for corners in [[a, b, c], [a, c, d]] {
            bytes.extend_from_slice(&[0; 12]);
            for corner in corners {
                CUBE_CORNERS[corner as usize].iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
            }
            bytes.extend_from_slice(&[0; 2]);
        }
    }
    bytes
}

#[test]
fn binary_stl_that_begins_with_solid() {
    for name in ["cube.stl", "cube", "cube.ply"] {
        let loaded = load(name, cube_stl());
        assert_eq!(loaded.format, Format::Stl);
        let mesh = mesh(loaded);
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (8, 12));
        assert!((mesh.signed_volume() - 1.0).abs() < 1e-15);
    }
}

#[test]
fn ascii_stl_of_two_solids() {
    let facet = |x: f64| {
        format!(
            "  facet normal 0 0 1\n outer loop\n VERTEX {x} 0 0\nvertex {x} 1 0\n vertex 9 {x} 0\n endloop\n endfacet\n"
        )
    };
    let text = format!("solid one\r\n{}endsolid one\nsolid\n{}{}endsolid", facet(0.0), facet(1.0), facet(2.0));
    let loaded = load("a.stl", text);
    assert_eq!((loaded.format, loaded.stated.faces), (Format::Stl, 3));
    assert_eq!(mesh(loaded).positions.len(), 9);
}

#[test]
fn obj_faces_in_every_notation() {
    let corners: String = CUBE_CORNERS.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n")).collect();
    let text = format!(
        "# caf\u{e9}\nmtllib none.mtl\no cube\n{corners}vt 0 0\nvn 0 0 1\nusemtl red\nf 1 4 3 2\nf 5/1 6/1 7/1 8/1 # top\n\
         f 1//1 2//1 6//1 5//1\ng rest\nf 2/1/1 3/1/1 \\\n7/1/1 6/1/1\nf -6 -5 -1 -2\nf 4 1 5 8\nl 1 2\n"
    );
    // Latin-1, as old files are.
    let bytes: Vec<u8> = text.chars().map(|c| c as u32 as u8).collect();
    let loaded = load("cube.obj", bytes);
    assert_eq!((loaded.format, loaded.stated.faces), (Format::Obj, 6));
    assert_eq!((loaded.count(NoteKind::Polygons), loaded.count(NoteKind::Ignored)), (6, 1));
    let mesh = mesh(loaded);
    assert_eq!(mesh.triangles.len(), 12);
    assert!((mesh.signed_volume() - 1.0).abs() < 1e-15);
}

#[test]
fn obj_vertices_alone_are_points_with_colours_and_normals() {
    let cloud = cloud(load("a.obj", "v 0 0 0\nvn 0 0 2\nv 1 0 0 1 0.2 0\nvn 0 0 0\nv 4 2 0 2\nvn 1 0 0\n"));
    assert_eq!(cloud.positions, [DVec3::ZERO, DVec3::X, DVec3::new(2.0, 1.0, 0.0)]);
    assert_eq!(cloud.colours, Some(vec![[255; 3], [255, 51, 0], [255; 3]]));
    assert_eq!((cloud.normal(0), cloud.normal(1), cloud.normal(2)), (Some(Vec3::Z), None, Some(Vec3::X)));
}

#[test]
fn names_do_not_matter_where_the_content_speaks() {
    assert_eq!(load("a.obj", "1 2 3\n").format, Format::Xyz);
    assert_eq!(load("a.xyz", "v 1 2 3\n").format, Format::Obj);
    assert_eq!(load("a", every_type("ascii")).format, Format::Ply);
}

#[test]
fn invalid_rows_can_be_dropped() {
    let drop = ReadOptions { drop_invalid: true, ..Default::default() };
    let loaded = load_with("a.xyz", "1 2 3 0 0 1\nnan 2 3 0 0 1\n4 5 6 0 1 inf\n7 8 9 0 1 0\n", drop);
    assert_eq!(loaded.count(NoteKind::InvalidDropped), 2);
    assert_eq!(cloud(loaded).positions, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(7.0, 8.0, 9.0)]);
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv nan 0 0\nf 1 2 3\nf 2 3 4\n";
    let loaded = load_with("a.obj", obj, drop);
    assert_eq!((loaded.count(NoteKind::InvalidDropped), loaded.count(NoteKind::TrianglesDropped)), (1, 1));
    assert_eq!(loaded.count(NoteKind::UnreferencedVertices), 0);
    assert_eq!(mesh(loaded).triangles, [[0, 1, 2]]);
}

/// Progress must end exactly at the length that was announced.
#[test]
fn progress_adds_up() {
    use std::sync::atomic::{AtomicU64, Ordering};
    #[derive(Default)]
    struct Sum(AtomicU64, AtomicU64);
    impl surfcut::formats::Progress for Sum {
        fn set_len(&self, bytes: u64) {
            self.0.store(bytes, Ordering::Relaxed);
        }
        fn advance(&self, bytes: u64) {
            self.1.fetch_add(bytes, Ordering::Relaxed);
        }
    }
    let rows: String = (0..20_000).map(|i| format!("{i} 2 3\n")).collect();
    let obj: String = (0..20_000).map(|i| format!("v {i} 2 3\n")).collect();
    let files = [rows.into_bytes(), obj.into_bytes(), cube_stl(), every_type("ascii"), every_type("binary_big_endian")];
    for bytes in files {
        let sum = Sum::default();
        read_bytes(Path::new("a"), &bytes, &ReadOptions::default(), &sum).unwrap();
        assert_eq!(sum.0.load(Ordering::Relaxed), bytes.len() as u64);
        assert_eq!(sum.1.load(Ordering::Relaxed), bytes.len() as u64);
    }
}

/// A bumpy sheet of `side`² vertices with colours, its corners in f32.
fn sheet(side: u32) -> TriMesh {
    let mut numbers = Numbers(0x5eed);
    let at = |x: u32, y: u32| y * side + x;
    let positions =
        (0..side * side).map(|i| Vec3::new((i % side) as f32, (i / side) as f32, numbers.unit()).as_dvec3()).collect();
    let triangles = (0..side - 1)
        .flat_map(|y| (0..side - 1).map(move |x| (x, y)))
        .flat_map(|(x, y)| [[at(x, y), at(x + 1, y), at(x + 1, y + 1)], [at(x, y), at(x + 1, y + 1), at(x, y + 1)]])
        .collect();
    let colours = (0..side * side).map(|i| [i as u8, (i >> 3) as u8, 7]).collect();
    TriMesh { positions, triangles, colours: Some(colours) }
}

#[test]
fn what_the_writer_writes_another_crate_and_the_reader_read() {
    use ply_rs_bw::ply::Property;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sheet.ply");
    let written = sheet(30);
    surfcut::formats::write_ply_mesh(&path, &written).unwrap();
    let back = surfcut::formats::read(&path, &ReadOptions::default(), &NoProgress).unwrap();
    assert_eq!(mesh(back), written);

    let mut file = std::fs::File::open(&path).unwrap();
    let parser = ply_rs_bw::parser::Parser::<ply_rs_bw::ply::DefaultElement>::new();
    let other = parser.read_ply(&mut file).unwrap();
    for (row, p) in other.payload["vertex"].iter().zip(&written.positions) {
        let read = ["x", "y", "z"].map(|name| match row[name] {
            Property::Float(value) => f64::from(value),
            ref other => panic!("{other:?}"),
        });
        assert_eq!(DVec3::from_array(read), *p);
    }
    let corners: Vec<_> = other.payload["face"].iter().map(|row| row["vertex_indices"].clone()).collect();
    let expected: Vec<_> =
        written.triangles.iter().map(|t| Property::ListInt(t.iter().map(|&v| v as i32).collect())).collect();
    assert_eq!(corners, expected);
}

#[test]
fn clouds_come_back_as_they_were_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloud.ply");
    let mut numbers = Numbers(77);
    let count = 500;
    let mut random = || Vec3::new(numbers.unit(), numbers.unit(), numbers.unit());
    let surfels = PointCloud {
        positions: (0..count).map(|i| random().as_dvec3() * 1e6 + f64::from(i) * 1e-9).collect(),
        normals: Some((0..count).map(|_| random().normalize()).collect()),
        radii: Some((1..=count).map(|i| i as f32).collect()),
        colours: Some((0..count).map(|i| [i as u8, 1, 2]).collect()),
        opacities: Some((0..count).map(|i| i as f32 / count as f32).collect()),
        ellipses: None,
    };
    surfcut::formats::write_ply_cloud(&path, &surfels).unwrap();
    let back = cloud(surfcut::formats::read(&path, &ReadOptions::default(), &NoProgress).unwrap());
    assert_eq!((&back.positions, &back.radii), (&surfels.positions, &surfels.radii));
    assert_eq!((&back.colours, &back.opacities), (&surfels.colours, &surfels.opacities));
    for (a, b) in back.normals.unwrap().iter().zip(surfels.normals.as_ref().unwrap()) {
        assert!((*a - *b).length() < 1e-6); // made unit once more
    }

    let ellipses = (0..count)
        .map(|i| {
            let u = random().normalize();
            let v = u.cross(random()).normalize();
            surfcut::geometry::Ellipse { axis_u: u * (i + 1) as f32, axis_v: v * 0.01 }
        })
        .collect::<Vec<_>>();
    let normals = ellipses.iter().map(|e| -e.axis_u.cross(e.axis_v).normalize()).collect::<Vec<_>>();
    let splats = PointCloud { ellipses: Some(ellipses), normals: Some(normals), radii: None, ..surfels };
    surfcut::formats::write_ply_cloud(&path, &splats).unwrap();
    let back = cloud(surfcut::formats::read(&path, &ReadOptions::default(), &NoProgress).unwrap());
    assert_eq!((&back.positions, &back.colours), (&splats.positions, &splats.colours));
    for i in 0..count as usize {
        let (a, b) = (back.ellipses.as_ref().unwrap()[i], splats.ellipses.as_ref().unwrap()[i]);
        assert!((a.axis_u - b.axis_u).length() < 2e-6 * b.axis_u.length());
        assert!((a.axis_v + b.axis_v).length().min((a.axis_v - b.axis_v).length()) < 2e-6 * b.axis_v.length());
        assert!((back.normal(i).unwrap() - splats.normal(i).unwrap()).length() < 2e-6);
        assert!((back.opacities.as_ref().unwrap()[i] - splats.opacities.as_ref().unwrap()[i]).abs() < 1e-6);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
}

#[test]
fn a_writer_that_fails_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("none").join("a.ply");
    assert!(surfcut::formats::write_ply_mesh(&missing, &sheet(3)).is_err());
    // A folder cannot be replaced by a file.
    let taken = folder.path().join("taken");
    std::fs::create_dir(&taken).unwrap();
    std::fs::write(taken.join("inside"), "x").unwrap();
    assert!(surfcut::formats::write_ply_mesh(&taken, &sheet(3)).is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    let mut uneven = sheet(3);
    uneven.colours = Some(vec![]);
    let message = surfcut::formats::write_ply_mesh(&folder.path().join("a.ply"), &uneven).unwrap_err().to_string();
    assert!(message.contains("9 points, but 0 colours"), "{message}");
}

#[test]
fn stl_agrees_with_stl_io() {
    let sheet = sheet(20);
    let triangle = |t: usize| stl_io::Triangle {
        normal: stl_io::Normal::new([0.0; 3]),
        vertices: sheet.corners(t).map(|p| stl_io::Vertex::new(p.as_vec3().to_array())),
    };
    let triangles: Vec<_> = (0..sheet.triangles.len()).map(triangle).collect();
    let mut bytes = Vec::new();
    stl_io::write_stl(&mut bytes, triangles.iter()).unwrap();
    let ours = mesh(load("a.stl", &bytes));
    let theirs = stl_io::read_stl(&mut std::io::Cursor::new(&bytes)).unwrap();
    assert_eq!(ours.positions.len(), theirs.vertices.len());
    for (t, face) in theirs.faces.iter().enumerate() {
        let corners = face.vertices.map(|v| Vec3::from_array(theirs.vertices[v].into()).as_dvec3());
        assert_eq!(ours.corners(t), corners);
    }
}

#[test]
fn obj_agrees_with_tobj() {
    let sheet = sheet(20);
    let mut text = String::new();
    for (p, c) in sheet.positions.iter().zip(sheet.colours.as_ref().unwrap()) {
        let [r, g, b] = c.map(|c| f32::from(c) / 255.0);
        text += &format!("v {} {} {} {r} {g} {b}\n", p.x as f32, p.y as f32, p.z as f32);
    }
    for [a, b, c] in &sheet.triangles {
        text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
    }
    let ours = mesh(load("a.obj", &text));
    let no_materials = |_: &Path| Err(tobj::LoadError::OpenFileFailed);
    let (models, _) = tobj::load_obj_buf(&mut text.as_bytes(), &tobj::LoadOptions::default(), no_materials).unwrap();
    let theirs = &models[0].mesh;
    let corner = |i: u32| Vec3::from_slice(&theirs.positions[3 * i as usize..]).as_dvec3();
    let colour = |i: u32| [0, 1, 2].map(|k| (theirs.vertex_color[3 * i as usize + k] * 255.0).round() as u8);
    assert_eq!(theirs.indices.len(), 3 * ours.triangles.len());
    for (t, face) in theirs.indices.as_chunks::<3>().0.iter().enumerate() {
        // Ours keeps the digits of the text, theirs is rounded to f32.
        assert_eq!(ours.corners(t).map(|p| p.as_vec3().as_dvec3()), face.map(corner));
        assert_eq!(ours.triangles[t].map(|v| ours.colours.as_ref().unwrap()[v as usize]), face.map(colour));
    }
}
