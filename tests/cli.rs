//! The command as a user meets it: exit codes, messages, outputs that are whole or absent.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Runs the command in `directory`.
fn surfcut(directory: &Path, line: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_surfcut")).current_dir(directory).args(line.split_whitespace()).output().unwrap()
}

fn code(output: &Output) -> i32 {
    output.status.code().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn entries(directory: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

const SCENE: &str = "csg = 'ball - drill'\nsize = [48, 32]\nunits = 'mm'\n\
    [leaf.ball]\nsphere = { centre = [0, 0, 0], radius = 1 }\n\
    [leaf.drill]\ncylinder = { from = [0, -2, 0.3], to = [0, 2, 0.3], radius = 0.3 }\nopacity = 0.5\n";

fn with_scene(text: &str) -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("cut.toml"), text).unwrap();
    directory
}

#[test]
fn a_scene_becomes_pictures_and_a_summary() {
    let directory = with_scene(SCENE);
    let here = directory.path();
    let output = surfcut(
        here,
        "render cut.toml --pipeline reference -o a.png -o a.exr --samples 2 --repeat 2 --summary-file run.json",
    );
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(entries(here), ["a.exr", "a.png", "cut.toml", "run.json"]);
    let picture = image::open(here.join("a.png")).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (48, 32));
    assert_ne!(picture.get_pixel(24, 16), picture.get_pixel(0, 0));
    let json: serde_json::Value = serde_json::from_slice(&fs::read(here.join("run.json")).unwrap()).unwrap();
    assert_eq!(json["frame"]["repeats"], 2);
    assert!(json["frame"]["cpu_ms"].is_number() && json["phases"]["load"]["ms"].is_number());
    assert!(json["counts"]["pixels_covered"].as_u64().unwrap() > 100);
    assert_eq!(json["settings"]["samples"], 2);
    // No bar in a pipe.
    assert!(!stderr(&output).contains('\r') && !stderr(&output).contains('\u{1b}'));
}

#[test]
fn pictures_go_to_standard_output_and_quiet_is_quiet() {
    let directory = with_scene(SCENE);
    let output =
        surfcut(directory.path(), "render cut.toml --pipeline reference -o - --quiet --background transparent");
    assert_eq!((code(&output), stderr(&output).as_str()), (0, ""));
    assert!(image::load_from_memory(&output.stdout).unwrap().color().has_alpha());
    assert_eq!(entries(directory.path()), ["cut.toml"]);
    // The same bytes on one thread.
    let line = "render cut.toml --pipeline reference -o - --quiet --background transparent --threads 1";
    assert_eq!(surfcut(directory.path(), line).stdout, output.stdout);
}

#[test]
fn one_liners_take_solids_and_default_to_a_png_here() {
    let directory = tempfile::tempdir().unwrap();
    let line =
        "render sphere:0,0,0,1 --minus box:0,-2,-2,2,2,2 --plus sphere:1,0,0,.2 --pipeline reference --size 32x32";
    assert_eq!(code(&surfcut(directory.path(), line)), 0);
    assert_eq!(entries(directory.path()), ["sphere.png"]);
}

#[test]
fn what_exists_is_refused_before_anything_is_drawn() {
    let directory = with_scene(SCENE);
    let here = directory.path();
    fs::write(here.join("a.png"), "mine").unwrap();
    let output = surfcut(here, "render cut.toml --pipeline reference -o b.png -o a.png");
    assert_eq!(code(&output), 4);
    assert!(stderr(&output).contains("a.png exists already") && stderr(&output).contains("--overwrite"));
    assert_eq!(entries(here), ["a.png", "cut.toml"]);
    assert_eq!(fs::read(here.join("a.png")).unwrap(), b"mine");
    assert_eq!(code(&surfcut(here, "render cut.toml --pipeline reference -o a.png --overwrite")), 0);
    assert_ne!(fs::read(here.join("a.png")).unwrap(), b"mine");
    for (line, part) in [("-o a.jpg", ".exr"), ("-o no/a.png", "no does not exist"), ("-o .", "ends in")] {
        let output = surfcut(here, &format!("render cut.toml --pipeline reference {line}"));
        assert_eq!(code(&output), 4, "{line}: {}", stderr(&output));
        assert!(stderr(&output).contains(part) || line == "-o .", "{}", stderr(&output));
    }
}

#[test]
fn mistakes_have_their_codes_and_places() {
    let directory = with_scene(&SCENE.replace("opacity", "opacty"));
    let here = directory.path();
    fs::write(here.join("bad.xyz"), "0 0 0\n1 2 nan\n").unwrap();
    for (line, wanted, parts) in [
        ("render cut.toml", 3, &["cut.toml:8:1", "did you mean `opacity`", "8 | opacty = 0.5"][..]),
        ("render absent.toml", 3, &["absent.toml"]),
        ("render absent.ply", 3, &["absent.ply", "no such file"]),
        ("render bad.xyz", 3, &["bad.xyz", "line 2", "--drop-invalid"]),
        ("check bad.xyz", 3, &["bad.xyz"]),
        ("render sphere:0,0,0,-1", 2, &["sphere:0,0,0,-1", "greater than 0"]),
        ("render sphere:0,0,0,1 --fov-y 200", 2, &["180"]),
        ("render sphere:0,0,0,1 --size 3", 2, &["1024x768"]),
        ("render sphere:0,0,0,1 --zoom 1e30", 2, &["1e30", "zoom less"]),
        ("render half-space:0,0,0,0,0,1", 3, &["`extent = …`", "seventh number"]),
        ("render sphere:0,0,0,1 -o - --summary-file -", 2, &["standard output"]),
        ("render", 2, &["SCENE"]),
        ("rendr x", 2, &["render"]),
    ] {
        let output = surfcut(here, line);
        assert_eq!(code(&output), wanted, "{line}: {}", stderr(&output));
        for part in parts {
            assert!(stderr(&output).contains(part), "{line}: {} lacks {part}", stderr(&output));
        }
        assert!(stdout(&output).is_empty());
    }
    assert_eq!(entries(here), ["bad.xyz", "cut.toml"]);
}

#[test]
fn an_empty_picture_is_never_silent() {
    let directory = tempfile::tempdir().unwrap();
    let line = "sphere:0,0,0,1 --and sphere:9,0,0,1";
    let output = surfcut(directory.path(), &format!("render {line} --pipeline reference --size 16x16 -o e.png"));
    assert_eq!(code(&output), 0);
    assert!(stderr(&output).contains("the picture is empty"), "{}", stderr(&output));
    assert_eq!(entries(directory.path()), ["e.png"]);
    let output = surfcut(directory.path(), &format!("check {line}"));
    assert_eq!(code(&output), 5);
    assert!(stdout(&output).contains("do not meet"));
}

#[test]
fn check_says_what_will_not_work() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    // A tetrahedron, closed; the same inside-out; the same without a face.
    let vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n";
    fs::write(here.join("good.obj"), format!("{vertices}f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")).unwrap();
    fs::write(here.join("turned.obj"), format!("{vertices}f 1 2 3\nf 1 4 2\nf 2 4 3\nf 3 4 1\n")).unwrap();
    fs::write(here.join("open.obj"), format!("{vertices}f 1 3 2\nf 1 2 4\nf 3 1 4\n")).unwrap();
    for (file, wanted, part) in
        [("good.obj", 0, "nothing is amiss"), ("turned.obj", 1, "inside-out"), ("open.obj", 1, "3 edges")]
    {
        let output = surfcut(here, &format!("check {file}"));
        assert_eq!(code(&output), wanted, "{file}: {}", stdout(&output));
        assert!(stdout(&output).contains(part), "{file}: {}", stdout(&output));
    }
    let output = surfcut(here, "check turned.obj --summary-file -");
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["findings"][0]["leaf"], "turned");
    assert_eq!(json["leaves"][0]["health"]["is_inside_out"], true);
    let output = surfcut(here, "check good.obj --minus sphere:50,0,0,1");
    assert!(stdout(&output).contains("`sphere` cuts nothing"), "{}", stdout(&output));
}

#[test]
fn check_sees_what_the_picture_would_lack() {
    let directory = with_scene(SCENE);
    let here = directory.path();
    let eye = |at: &str| SCENE.replace("units = 'mm'\n", &format!("camera = {{ eye = {at}, target = [0, 0, 0] }}\n"));
    let inside = eye("[0.1, 0, -0.5]");
    let outside = eye("[4, 0, 0]");
    // Points on a line; a wall of 9 points with normals, before which a ball lies whose box misses its own.
    let line: String = (0..60).map(|i| format!("{i} {i} 0\n")).collect();
    let wall: String = (0..9).map(|i| format!("{} {} 0 0 0 1\n", i % 3, i / 3)).collect();
    fs::write(here.join("line.xyz"), line).unwrap();
    fs::write(here.join("wall.xyz"), wall).unwrap();
    fs::write(here.join("point.xyz"), "0 0 0\n").unwrap();
    for (name, text) in [
        ("nothing.toml", SCENE.replace("ball - drill", "ball - ball")),
        ("swallowed.toml", SCENE.replace("radius = 0.3 }", "radius = 3.0 }")),
        ("all.toml", SCENE.replace("ball - drill", "ball | !ball")),
        ("endless.toml", SCENE.replace("ball - drill", "!ball")),
        ("inside.toml", inside),
        ("outside.toml", outside),
    ] {
        fs::write(here.join(name), text).unwrap();
    }
    for (line, wanted, part) in [
        ("nothing.toml", 5, "the result is empty"),
        ("swallowed.toml", 5, "the result is empty"),
        ("all.toml", 1, "all of space"),
        ("endless.toml", 1, "no bounds"),
        ("inside.toml", 1, "eye is inside"),
        ("outside.toml", 0, "nothing is amiss"),
        ("line.xyz", 1, "lie on one line"),
        ("point.xyz", 1, "only one point"),
        ("wall.xyz --and sphere:1,1,-9,2", 0, "stands for the half-space"),
        ("wall.xyz", 1, "no bounds"),
        ("half-space:0,0,0,0,0,1,1", 1, "no bounds"),
    ] {
        let output = surfcut(here, &format!("check {line}"));
        assert_eq!(code(&output), wanted, "{line}: {}{}", stdout(&output), stderr(&output));
        assert!(stdout(&output).contains(part), "{line}: {}", stdout(&output));
        assert!(!stdout(&output).contains("do not meet"), "{line}: {}", stdout(&output));
    }
    let output = surfcut(here, "check nothing.toml --summary-file -");
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&json["is_empty"], &json["surfels"]["surface"]), (&true.into(), &0.into()));
}

#[test]
fn check_tells_how_sure_estimated_normals_are() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    // A ball of 2000 points in even spirals.
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let ball: String = (0..2000)
        .map(|i| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 2000.0;
            let (sin, cos) = (golden * f64::from(i)).sin_cos();
            format!("{} {} {z}\n", (1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin)
        })
        .collect();
    // And 2000 points all through a cube, which have no surface.
    let mut state = 1_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1_u32 << 31)
    };
    let dust: String = (0..2000).map(|_| format!("{} {} {}\n", random(), random(), random())).collect();
    fs::write(here.join("ball.xyz"), ball).unwrap();
    fs::write(here.join("dust.xyz"), dust).unwrap();
    let conversion = |file: &str| {
        let output = surfcut(here, &format!("check {file} --summary-file -"));
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(json["leaves"][0]["conversion"]["estimated_normals"], 2000, "{json}");
        let low = json["leaves"][0]["conversion"]["low_confidence"].as_f64().unwrap();
        (code(&output), low)
    };
    let (ball, dust) = (conversion("ball.xyz"), conversion("dust.xyz"));
    assert!(ball.0 == 0 && ball.1 < 0.01, "{ball:?}");
    assert!(dust.0 == 1 && dust.1 > 0.05, "{dust:?}");
    assert!(stdout(&surfcut(here, "check ball.xyz")).contains("median confidence"));
}

#[cfg(target_os = "linux")]
#[test]
fn pictures_that_do_not_fit_are_refused_with_what_they_need() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    // Twice 2^30 pixels of hundreds of bytes: more than most machines have, and on those that have it the test is idle.
    let bytes = surfcut::output::resources::available_memory_bytes().unwrap();
    if bytes < 150 << 30 {
        let line = "compare sphere:0,0,0,1 --pipeline reference --size 32768x32768";
        let output = surfcut(here, line);
        assert_eq!(code(&output), 3, "{}", stderr(&output));
        for part in ["32768x32768", "GiB", "--size"] {
            assert!(stderr(&output).contains(part), "{}", stderr(&output));
        }
    }
    assert!(entries(here).is_empty());
}

#[test]
fn info_tells_what_there_is() {
    let directory = with_scene(SCENE);
    let output = surfcut(directory.path(), "info cut.toml");
    assert_eq!(code(&output), 0);
    for part in ["ball - drill", "2 leaves, 1 operator deep", "2 IDs", "mm", "48 × 32", "cylinder", "frames the scene"]
    {
        assert!(stdout(&output).contains(part), "{}", stdout(&output));
    }
    let output = surfcut(directory.path(), "info cut.toml --summary-file -");
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["leaves"][1]["geometry"], "cylinder");
    assert_eq!(json["positive_form"]["leaves"], 2);
}

#[test]
fn a_picture_equals_itself() {
    let directory = with_scene(SCENE);
    let output = surfcut(
        directory.path(),
        "compare cut.toml --pipeline reference --with reference --difference d.png --summary-file c.json",
    );
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let json: serde_json::Value = serde_json::from_slice(&fs::read(directory.path().join("c.json")).unwrap()).unwrap();
    assert_eq!(json["comparison"]["wrong_pixels"], 0.0);
    assert_eq!(json["ssim"], 1.0);
    assert!(directory.path().join("d.png").exists());
}

#[test]
fn a_chart_is_four_files_with_every_setting() {
    let directory = with_scene(&SCENE.replace("opacity = 0.5", ""));
    let here = directory.path();
    let output = surfcut(here, "chart cut.toml -o out.v1 --repeat 1 --magnify 1,30 --summary-file run.json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(entries(here), ["cut.toml", "out.v1.csv", "out.v1.json", "out.v1.png", "out.v1.svg", "run.json"]);
    // Five inside tests under two clip modes, and the paper's, at two magnifications.
    const POINTS: usize = 2 * (5 * 2 + 1);
    let csv = fs::read_to_string(here.join("out.v1.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + POINTS, "{csv}");
    assert_eq!(stdout(&output).lines().count(), 1 + POINTS);
    let json: serde_json::Value = serde_json::from_slice(&fs::read(here.join("run.json")).unwrap()).unwrap();
    let points = json["points"].as_array().unwrap();
    assert_eq!(points.len(), POINTS);
    for point in points {
        assert!(point["frame"]["ms"].as_f64().unwrap() > 0.0, "{point}");
        let edge_px = point["comparison"]["edge_px"].as_f64().unwrap();
        // Surfaces are hit on the exact solids; the paper's flat disks are as coarse as so small a picture lets them be.
        assert!(edge_px >= 0.0 && (edge_px < 1.0 || point["clip"] == "fragment"), "{point}");
    }
    assert!(json["phases"]["classify"]["ms"].is_number());
    assert!(image::open(here.join("out.v1.png")).is_ok());

    let output = surfcut(here, "chart cut.toml -o out.v1");
    assert_eq!(code(&output), 4);
    assert!(stderr(&output).contains("out.v1.svg exists already"), "{}", stderr(&output));
    for (line, wanted, part) in [
        ("chart sphere:0,0,0,1 --size 32x32 -o ball", 3, "no cut edge"),
        ("chart cut.toml -o -", 2, "four files"),
        ("chart cut.toml --magnify 0.5", 2, "1 or larger"),
        ("chart cut.toml -o a --summary-file a.json", 2, "another name"),
    ] {
        let output = surfcut(here, line);
        assert_eq!(code(&output), wanted, "{line}: {}", stderr(&output));
        assert!(stderr(&output).contains(part), "{line}: {}", stderr(&output));
    }
    assert_eq!(entries(here).len(), 6);
}

#[test]
fn completions_and_help_are_there() {
    let here = Path::new(".");
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = surfcut(here, &format!("completions {shell}"));
        assert_eq!(code(&output), 0);
        assert!(stdout(&output).contains("minus"), "{shell}");
    }
    let output = surfcut(here, "--help");
    assert_eq!(code(&output), 0);
    for part in ["Exit codes", "render", "check", "Examples"] {
        assert!(stdout(&output).contains(part));
    }
    assert!(stdout(&surfcut(here, "render --help")).contains("half-space:"));
}

#[test]
fn the_mesh_pipeline_draws_solids_and_refuses_points_by_name() {
    let directory = with_scene(SCENE);
    let here = directory.path();
    let output = surfcut(here, "compare cut.toml --pipeline mesh --summary-file run.json --size 96x96");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let json: serde_json::Value = serde_json::from_slice(&fs::read(here.join("run.json")).unwrap()).unwrap();
    let of = |name: &str| json["comparison"][name].as_f64().unwrap();
    assert_eq!((of("wrong_pixels"), of("near_edge_wrong"), of("layers_wrong")), (0.0, 0.0, 0.0));

    fs::write(here.join("scan.xyz"), "0 0 0\n1 0 0\n0 1 0\n0 0 1\n").unwrap();
    let output = surfcut(here, "render scan.xyz --pipeline mesh -o a.png");
    assert_eq!(code(&output), 3);
    assert!(stderr(&output).contains("`scan` is a cloud of points"), "{}", stderr(&output));
    assert!(stderr(&output).contains("--pipeline splat"));
}

#[test]
fn a_tree_in_json_is_a_scene() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let stl = "solid s\nfacet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 0 1 0\nvertex 1 0 0\nendloop\nendfacet\n\
               facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 0 1\nendloop\nendfacet\n\
               facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 0 0 1\nvertex 0 1 0\nendloop\nendfacet\n\
               facet normal 0 0 0\nouter loop\nvertex 1 0 0\nvertex 0 1 0\nvertex 0 0 1\nendloop\nendfacet\nendsolid s\n";
    fs::write(here.join("tetra.stl"), stl).unwrap();
    let leaf = |x: f64| format!(r#"{{"mesh": "tetra.stl", "transform": [1,0,0,{x}, 0,1,0,0, 0,0,1,0, 0,0,0,1]}}"#);
    let tree = format!(r#"{{"op": "difference", "children": [{}, {}]}}"#, leaf(0.0), leaf(0.3));
    fs::write(here.join("two.tree.json"), tree).unwrap();
    let camera = r#"{"eye": [2,3,2], "target": [0.3,0.3,0.3], "up": [0,0,1], "fovy": 30, "width": 64, "height": 64}"#;
    fs::write(here.join("two.camera.json"), camera).unwrap();
    let output = surfcut(here, "render two.tree.json --pipeline mesh --summary-file run.json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(entries(here), ["run.json", "tetra.stl", "two.camera.json", "two.png", "two.tree.json"]);
    assert_eq!(image::open(here.join("two.png")).unwrap().to_rgb8().dimensions(), (64, 64));
    let output = surfcut(here, "compare two.tree.json --pipeline mesh --summary-file both.json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let json: serde_json::Value = serde_json::from_slice(&fs::read(here.join("both.json")).unwrap()).unwrap();
    assert_eq!(json["comparison"]["wrong_pixels"], 0.0);

    fs::write(here.join("bad.tree.json"), "{\"op\": \"xor\", \"children\": []}").unwrap();
    let output = surfcut(here, "render bad.tree.json");
    assert_eq!(code(&output), 3);
    assert!(stderr(&output).contains("bad.tree.json") && stderr(&output).contains("line 1"), "{}", stderr(&output));
}

#[test]
fn a_leaf_is_drawn_as_what_the_user_wants() {
    let directory = with_scene(SCENE);
    let here = directory.path();
    let run = |line: &str, pipeline: &str, surfels: bool| {
        let output = surfcut(here, &format!("render cut.toml -o a.png --overwrite --summary-file run.json {line}"));
        assert_eq!(code(&output), 0, "{line}: {}", stderr(&output));
        let json: serde_json::Value = serde_json::from_slice(&fs::read(here.join("run.json")).unwrap()).unwrap();
        assert_eq!(json["settings"]["pipeline"], pipeline, "{line}");
        assert_eq!(json["counts"]["surfels"].as_u64().unwrap_or(0) > 0, surfels, "{line}");
        json["counts"]["triangles"].as_u64().unwrap_or(0)
    };
    assert_eq!(run("", "mesh", false), 0);
    assert!(run("--represent ball=mesh", "mesh", false) > 50);
    assert_eq!(run("--represent ball=surfels", "hybrid", true), 0);
    assert!(run("--represent ball=surfels --represent drill=mesh", "hybrid", true) > 10);
    assert_eq!(run("--represent ball=surfels --represent drill=surfels", "splat", true), 0);

    let output = surfcut(here, "render cut.toml -o b.png --represent bal=surfels");
    assert_eq!(code(&output), 2);
    assert!(stderr(&output).contains("did you mean `ball`"), "{}", stderr(&output));
    let output = surfcut(here, "render cut.toml -o b.png --represent ball=points");
    assert_eq!(code(&output), 2);
    assert!(stderr(&output).contains("surfels, mesh, exact"), "{}", stderr(&output));
    let output = surfcut(here, "render cut.toml -o b.png --pipeline mesh --represent ball=surfels");
    assert_eq!(code(&output), 3);
    assert!(stderr(&output).contains("`ball` is to be drawn as surfels"), "{}", stderr(&output));
    fs::write(here.join("scan.xyz"), "0 0 0\n1 0 0\n0 1 0\n0 0 1\n").unwrap();
    let output = surfcut(here, "render scan.xyz -o b.png --represent scan=exact");
    assert_eq!(code(&output), 3);
    assert!(stderr(&output).contains("give the leaf the file of a mesh"), "{}", stderr(&output));
    assert!(!here.join("b.png").exists());
}

#[test]
fn ways_to_draw_a_scene_are_one_table() {
    let directory = with_scene(SCENE);
    let here = directory.path();
    let output = surfcut(here, "compare cut.toml --size 96x96 --as splats,meshes,hybrid --summary-file ways.json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let rows: Vec<String> = stdout(&output).lines().map(str::to_owned).collect();
    assert_eq!(rows.len(), 5, "{rows:?}");
    assert!(rows.iter().all(|row| row.len() == rows[0].len()), "{rows:?}");
    let json: serde_json::Value = serde_json::from_slice(&fs::read(here.join("ways.json")).unwrap()).unwrap();
    for (number, (way, pipeline)) in
        [("splats", "splat"), ("meshes", "mesh"), ("hybrid", "mesh")].into_iter().enumerate()
    {
        let row = &json["ways"][number];
        assert_eq!((row["way"].as_str(), row["pipeline"].as_str()), (Some(way), Some(pipeline)));
        assert!(row["comparison"]["wrong_pixels"].as_f64().unwrap() < 1e-3, "{row}");
    }
    assert_eq!(json["ways"][2]["comparison"]["near_edge_wrong"], 0.0);
}

#[test]
fn open_and_inside_out_meshes_are_drawn_and_named() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    // A tetrahedron inside-out; and without the face that looks away from the origin.
    let vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n";
    fs::write(here.join("turned.obj"), format!("{vertices}f 1 2 3\nf 1 4 2\nf 2 4 3\nf 3 4 1\n")).unwrap();
    fs::write(here.join("open.obj"), format!("{vertices}f 1 3 2\nf 1 2 4\nf 3 1 4\n")).unwrap();
    let run = |line: &str| {
        let output = surfcut(here, &format!("render {line} --size 64x64 -o a.png --overwrite --summary-file run.json"));
        assert_eq!(code(&output), 0, "{line}: {}", stderr(&output));
        let json = serde_json::from_slice::<serde_json::Value>(&fs::read(here.join("run.json")).unwrap()).unwrap();
        assert!(json["counts"]["pixels_covered"].as_u64().unwrap() > 100, "{line}");
        (stderr(&output), json)
    };
    let (told, json) = run("turned.obj");
    assert!(told.contains("`turned` is inside-out") && told.contains("turn its faces over"), "{told}");
    assert!(json["warnings"].to_string().contains("inside-out"));
    // From the side that is open rays leave without having entered; from behind, through two faces, some do not either.
    for pipeline in ["auto", "mesh"] {
        let line = format!("open.obj --eye 3,3.2,2.9 --target 0.2,0.2,0.2 --pipeline {pipeline}");
        let (told, json) = run(&line);
        let undecided = json["counts"]["undecided_pixels"].as_u64().unwrap();
        assert!(undecided > 100, "{undecided}");
        // What the light sees for shadows is no pixel of the picture.
        let (_, json) = run(&format!("{line} --shadows"));
        assert!(json["counts"]["shadow_texels"].as_u64().unwrap() > 0);
        assert_eq!(json["counts"]["undecided_pixels"].as_u64(), Some(undecided));
        assert!(
            told.contains("the mesh of leaf `open` is open") && told.contains(&format!("{undecided} pixels")),
            "{told}"
        );
    }
}
