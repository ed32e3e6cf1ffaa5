//! Sections, merged pictures and limited layers as a user meets them.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use image::RgbImage;

fn surfcut(directory: &Path, line: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_surfcut")).current_dir(directory).args(line.split_whitespace()).output().unwrap()
}

fn run(directory: &Path, line: &str) -> String {
    let output = surfcut(directory, line);
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{line}: {text}");
    text
}

fn scene(directory: &Path, name: &str, text: &str) {
    fs::write(directory.join(name), text).unwrap();
}

fn picture(directory: &Path, name: &str) -> RgbImage {
    image::open(directory.join(name)).unwrap().into_rgb8()
}

const PARTS: &str = "size = [160, 120]\nbackground = 'white'\n[camera]\neye = [0, -6, 0]\ntarget = [0, 0, 0]\nheight = 3\n\
    [light]\ntowards = [0, -1, 0]\nambient = 1\n\
    [leaf.outer]\nsphere = { centre = [0, 0, 0], radius = 1.2 }\ncolour = '#ffffff'\n\
    [leaf.hole]\nbox = { min = [-0.52, -0.52, -0.52], max = [0.52, 0.52, 0.52] }\n\
    [leaf.core]\nbox = { min = [-0.5, -0.5, -0.5], max = [0.5, 0.5, 0.5] }\ncolour = '#80c0ff'\n";

const SECTION: &str =
    "[leaf.cut]\nhalf_space = { point = [0, 0, 0], normal = [0, 1, 0] }\nsection = true\nhatch_spacing = 0.2\n";

#[test]
fn a_section_cuts_the_result_and_hatches_each_leaf_in_its_own_direction() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    scene(here, "b.toml", &format!("csg = '(outer - hole) | core'\n{PARTS}"));
    let pipelines = ["--pipeline splat", "--pipeline mesh", "--pipeline reference", "--represent outer=surfels"];
    // With a gap between the parts, and without.
    let expressions = ["(outer - hole) | core", "(outer - core) | core", "core | (outer - core)"];
    for (csg, pipeline) in expressions.into_iter().flat_map(|csg| pipelines.map(|pipeline| (csg, pipeline))) {
        // The section is not in the expression: it cuts it.
        scene(here, "a.toml", &format!("csg = '{csg}'\n{PARTS}{SECTION}"));
        run(here, &format!("render a.toml {pipeline} -o a.png --overwrite"));
        let cut = picture(here, "a.png");
        // Dark pixels with a dark neighbour up right, or up left: lines that rise, lines that fall.
        let is_dark = |x: u32, y: u32| cut.get_pixel(x, y).0.iter().all(|c| *c < 110);
        let slants = |x: std::ops::Range<u32>, y: std::ops::Range<u32>| {
            let mut counts = [0, 0];
            for (x, y) in x.flat_map(|x| y.clone().map(move |y| (x, y))).filter(|&(x, y)| is_dark(x, y)) {
                counts[0] += u32::from(is_dark(x + 1, y - 1));
                counts[1] += u32::from(is_dark(x - 1, y - 1));
            }
            counts
        };
        // The core is a square of 40 pixels in the middle; the ball reaches 48 pixels up.
        let (core, outer) = (slants(64..96, 44..76), slants(64..96, 20..36));
        assert!(core[0] + core[1] > 20 && outer[0] + outer[1] > 10, "{csg} {pipeline}: {core:?} {outer:?}");
        assert!((core[0] > 4 * core[1]) != (outer[0] > 4 * outer[1]), "{csg} {pipeline}: {core:?} {outer:?}");
        assert!((4 * core[0] < core[1]) != (4 * outer[0] < outer[1]), "{csg} {pipeline}: {core:?} {outer:?}");
    }
    // Without a section the ball hides the core and has no lines.
    run(here, "render b.toml -o b.png");
    assert!(picture(here, "b.png").pixels().all(|p| p.0.iter().any(|c| *c > 110)));
    scene(here, "c.toml", &format!("csg = 'outer | core | hole'\n{PARTS}section = true\n"));
    let refused = surfcut(here, "render c.toml -o c.png");
    assert!(String::from_utf8_lossy(&refused.stderr).contains("only a half-space is a section"));
}

#[test]
fn a_merged_picture_is_the_scene_that_holds_both() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let head =
        "size = [96, 80]\n[camera]\neye = [3, -5, 2]\ntarget = [0, 0, 0]\nfov_y = 30\n[light]\ntowards = [1, -1, 1]\n";
    let ball = "[leaf.ball]\nsphere = { centre = [0, 0, 0], radius = 0.8 }\ncolour = '#d0a040'\n";
    let rod = "[leaf.rod]\ncylinder = { from = [-1.2, 0.3, 0.2], to = [1.2, -0.3, -0.2], radius = 0.4 }\ncolour = '#4060d0'\n";
    // They pass through each other: each is in front somewhere.
    scene(here, "ball.toml", &format!("{head}{ball}"));
    scene(here, "rod.toml", &format!("{head}{rod}"));
    scene(here, "both.toml", &format!("csg = 'ball | rod'\n{head}{ball}{rod}"));
    run(here, "render rod.toml -o rod.exr --background transparent");
    run(here, "render ball.toml --merge rod.exr -o merged.png -o merged.exr");
    run(here, "render both.toml -o both.png -o both.exr");
    let differing = |a: &RgbImage, b: &RgbImage| {
        a.pixels().zip(b.pixels()).filter(|(a, b)| (0..3).any(|k| a[k].abs_diff(b[k]) > 2)).count()
    };
    let (merged, both) = (picture(here, "merged.png"), picture(here, "both.png"));
    assert!(differing(&merged, &both) <= 4, "{}", differing(&merged, &both));
    run(here, "render ball.toml -o ball.png");
    assert!(differing(&merged, &picture(here, "ball.png")) > 300);
    // The depth that is written is the nearest of the two.
    let depth =
        |name: &str| -> Vec<f32> { surfcut::formats::depth_picture::read(&here.join(name), (96, 80)).unwrap().depth };
    let off = depth("merged.exr")
        .iter()
        .zip(depth("both.exr"))
        .filter(|(a, b)| !(**a == *b || (*a - b).abs() < 1e-4))
        .count();
    assert!(off <= 4, "{off}");
    // In a style with lines the rod stands before and behind the ball too.
    run(here, "render ball.toml --style blueprint --merge rod.exr -o lines.png");
    run(here, "render ball.toml --style blueprint -o alone.png");
    assert!(differing(&picture(here, "lines.png"), &picture(here, "alone.png")) > 300);
    let refused = surfcut(here, "render ball.toml --merge rod.exr -o small.png --size 48x40");
    assert_eq!(refused.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--size 96x80"));
}

#[test]
fn merging_changes_nothing_where_the_other_picture_is_empty() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let head =
        "size = [96, 80]\n[camera]\neye = [3, -5, 2]\ntarget = [0, 0, 0]\nfov_y = 30\n[light]\ntowards = [1, -1, 1]\n";
    let ball = "[leaf.ball]\nsphere = { centre = [0, 0, 0], radius = 0.8 }\n";
    let dent = "[leaf.dent]\nsphere = { centre = [0.5, -0.6, 0.4], radius = 0.4 }\n";
    let cut = "[leaf.cut]\nhalf_space = { point = [0, 0, 0.3], normal = [0, 0, 1] }\nsection = true\n";
    // To the right of the ball.
    let bead = "[leaf.bead]\nsphere = { centre = [1.2, 0.72, 0], radius = 0.2 }\n";
    scene(here, "dented.toml", &format!("csg = 'ball - dent'\n{head}{ball}{dent}"));
    scene(here, "section.toml", &format!("csg = 'ball - dent'\n{head}{ball}{dent}{cut}"));
    scene(here, "bead.toml", &format!("{head}{bead}"));
    scene(here, "nothing.toml", &format!("csg = 'ball & bead'\n{head}{ball}{bead}"));
    for name in ["bead", "nothing"] {
        run(here, &format!("render {name}.toml -o {name}.exr --background transparent"));
    }
    let size = (96, 80);
    let bead = surfcut::formats::depth_picture::read(&here.join("bead.exr"), size).unwrap();
    let is_bead = |x: u32, y: u32| bead.depth[(y * size.0 + x) as usize].is_finite();
    let differing = |alone: &RgbImage, is_counted: &dyn Fn(u32, u32) -> bool| {
        let merged = picture(here, "merged.png");
        // A finished sketch is blended once more, which rounds.
        let differs = |a: &image::Rgb<u8>, b: &image::Rgb<u8>| (0..3).any(|k| a[k].abs_diff(b[k]) > 1);
        merged.enumerate_pixels().filter(|(x, y, p)| is_counted(*x, *y) && differs(p, alone.get_pixel(*x, *y))).count()
    };
    for drawing in [
        "dented.toml",
        "dented.toml --occlusion 0.9",
        "dented.toml --occlusion 0.9 --samples 4",
        "section.toml",
        "dented.toml --style transparent",
        "dented.toml --style blueprint",
        "dented.toml --style edge-transparent",
        "dented.toml --style sketchy",
    ] {
        run(here, &format!("render {drawing} -o alone.png --overwrite"));
        run(here, &format!("render {drawing} --merge nothing.exr -o merged.png --overwrite"));
        let alone = picture(here, "alone.png");
        assert_eq!(differing(&alone, &|_, _| true), 0, "{drawing}");
        run(here, &format!("render {drawing} --merge bead.exr -o merged.png --overwrite"));
        assert_eq!(differing(&alone, &|x, y| !is_bead(x, y)), 0, "{drawing}");
        assert!(differing(&alone, &is_bead) > 30, "{drawing}");
    }
    // The shade is there at all.
    run(here, "render dented.toml -o flat.png");
    run(here, "render dented.toml --occlusion 0.9 -o shaded.png");
    assert_ne!(picture(here, "flat.png"), picture(here, "shaded.png"));
    // What is merged does not hide that the result is empty.
    for style in ["shaded", "blueprint", "sketchy"] {
        let told = run(here, &format!("render nothing.toml --style {style} --merge bead.exr -o empty_{style}.png"));
        assert!(told.contains("the picture is empty"), "{style}: {told}");
    }
}

#[test]
fn layers_with_few_pixels_are_left_out_and_told() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    // A row of balls behind each other, smaller and smaller: ten layers, of fewer and fewer pixels.
    let balls: String = (0..5)
        .map(|i| {
            let radius = 1.0 / f64::from(1 << i);
            format!("[leaf.b{i}]\nsphere = {{ centre = [0, {}, 0], radius = {radius} }}\nopacity = 0.5\n", 3 * i)
        })
        .collect();
    scene(
        here,
        "row.toml",
        &format!(
            "csg = 'b0 | b1 | b2 | b3 | b4'\nsize = [128, 128]\n[camera]\neye = [0, -6, 0]\ntarget = [0, 0, 0]\nheight = 2.4\n{balls}"
        ),
    );
    let told =
        run(here, "render row.toml --style transparent --min-pixels 600 -o few.png -o few.exr --summary-file few.json");
    assert!(told.contains("4 of 10 layers"), "{told}");
    let json: serde_json::Value = serde_json::from_slice(&fs::read(here.join("few.json")).unwrap()).unwrap();
    let share = json["shares"]["pixels_left_out"].as_f64().unwrap();
    // The third ball has a quarter of the first one's radius.
    assert!((share - 1.0 / 16.0).abs() < 0.01, "{share}");
    // A limit by number says the same, with layers in a file or without.
    let tail = "% of all boundaries are left out";
    let said = |told: &str| told.lines().find(|line| line.ends_with(tail)).unwrap_or_default().to_owned();
    for outputs in ["-o four.png -o four.exr", "-o other.png"] {
        let limited = run(here, &format!("render row.toml --style transparent --max-layers 4 {outputs}"));
        assert_eq!(said(&limited), said(&told), "{limited}");
    }
    // The shaded picture of opaque leaves shows one layer in any case.
    assert_eq!(said(&run(here, "render row.toml --layers nearest --max-layers 4 -o nearest.png")), "");
    assert_eq!(picture(here, "few.png"), picture(here, "four.png"));
    assert_eq!(fs::read(here.join("few.exr")).unwrap(), fs::read(here.join("four.exr")).unwrap());
    run(here, "render row.toml --style transparent -o all.png");
    assert_ne!(picture(here, "few.png"), picture(here, "all.png"));
}
