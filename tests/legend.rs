//! Legends as a user meets them.

use std::fs;
use std::path::Path;
use std::process::Command;

use image::{Rgba, RgbaImage};

fn run(directory: &Path, line: &str) -> String {
    let program = env!("CARGO_BIN_EXE_surfcut");
    let output = Command::new(program).current_dir(directory).args(line.split_whitespace()).output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{line}: {text}");
    text
}

fn picture(directory: &Path, name: &str) -> RgbaImage {
    image::open(directory.join(name)).unwrap().into_rgba8()
}

/// A ball with a bore, a leaf behind it that does not show, and one whose name is not ASCII.
const SCENE: &str = "csg = 'ball - bore | hidden | \"Gewände 骨\"'\nsize = [300, 240]\n[camera]\neye = [0, -6, 0]\n\
    target = [0, 0, 0]\nheight = 3\n[leaf.ball]\nsphere = { centre = [0, 0, 0], radius = 1 }\ncolour = '#ff0000'\n\
    [leaf.bore]\nsphere = { centre = [0, -1, 0], radius = 0.4 }\ncolour = '#00ff00'\n\
    [leaf.hidden]\nsphere = { centre = [0, 3, 0], radius = 0.3 }\ncolour = '#0000ff'\n\
    [leaf.'Gewände 骨']\nsphere = { centre = [1.5, 0, 0.8], radius = 0.3 }\ncolour = '#00ffff'\n";

/// Pixels that differ, as the smallest box that holds them: left, top, right, bottom.
fn changed(a: &RgbaImage, b: &RgbaImage) -> Option<[u32; 4]> {
    let places = a.enumerate_pixels().filter(|(x, y, pixel)| b.get_pixel(*x, *y) != *pixel);
    places.fold(None, |held: Option<[u32; 4]>, (x, y, _)| {
        let [x0, y0, x1, y1] = held.unwrap_or([x, y, x, y]);
        Some([x0.min(x), y0.min(y), x1.max(x), y1.max(y)])
    })
}

/// How many pixels within `[x0, y0, x1, y1]` are mostly red, green, blue, and cyan.
fn hues(picture: &RgbaImage, [x0, y0, x1, y1]: [u32; 4]) -> [usize; 4] {
    let is = |wanted: [bool; 3]| {
        move |pixel: &Rgba<u8>| {
            let most = pixel.0[..3].iter().copied().max().unwrap_or(0);
            most > 120 && (0..3).all(|c| (pixel.0[c] > most / 2) == wanted[c])
        }
    };
    let count = |wanted: [bool; 3]| {
        let places = (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| (x, y)));
        places.filter(|&(x, y)| is(wanted)(picture.get_pixel(x, y))).count()
    };
    [[true, false, false], [false, true, false], [false, false, true], [false, true, true]].map(count)
}

#[test]
fn a_legend_names_the_leaves_that_show_and_changes_nothing_else() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    fs::write(here.join("a.toml"), SCENE).unwrap();
    run(here, "render a.toml --background white -o without.png -o without.exr");
    run(here, "render a.toml --background white -o with.png -o with.exr --legend");
    let (without, with) = (picture(here, "without.png"), picture(here, "with.png"));
    // Bottom left, and at most a third.
    let panel = changed(&without, &with).unwrap();
    assert!(panel[0] < 20 && panel[3] > 220 && panel[2] <= 20 + 100 && panel[1] >= 220 - 80, "{panel:?}");
    let [red, green, blue, cyan] = hues(&with, panel);
    assert!(red > 40 && green > 40 && cyan > 40 && blue == 0, "{red} {green} {blue} {cyan}");
    // Depths and layers are as without.
    let channels = |name: &str| {
        let read = exr::prelude::read_first_flat_layer_from_file(here.join(name)).unwrap();
        let list = read.layer_data.channel_data.list.into_iter();
        list.map(|channel| (channel.name.to_string(), channel.sample_data)).collect::<Vec<_>>()
    };
    let (before, after) = (channels("without.exr"), channels("with.exr"));
    let differ: Vec<&str> =
        before.iter().zip(&after).filter(|(a, b)| a != b).map(|((name, _), _)| name.as_str()).collect();
    assert!(!differ.is_empty() && differ.iter().all(|name| ["R", "G", "B", "A"].contains(name)), "{differ:?}");
    assert!(before.iter().any(|(name, _)| name == "Z"));
    // A scene says the same as a flag, and a flag the last word.
    fs::write(here.join("b.toml"), format!("{SCENE}[style]\nlegend = true\n")).unwrap();
    run(here, "render b.toml --background white -o scene.png");
    assert_eq!(picture(here, "scene.png"), with);
    run(here, "render b.toml --background white --legend none -o none.png");
    assert_eq!(picture(here, "none.png"), without);
    run(here, "render b.toml --background white --legend top-right -o right.png");
    let panel = changed(&without, &picture(here, "right.png")).unwrap();
    assert!(panel[0] > 180 && panel[1] < 20 && panel[2] > 280, "{panel:?}");
    // What is transparent shows what is behind it: a row more.
    run(here, "render a.toml --background white --style transparent -o clear.png");
    run(here, "render a.toml --background white --style transparent -o named.png --legend top-right");
    let taller = changed(&picture(here, "clear.png"), &picture(here, "named.png")).unwrap();
    assert!(taller[3] - taller[1] > panel[3] - panel[1], "{taller:?}, {panel:?}");
    // A picture that is too small says so.
    let told = run(here, "render a.toml --size 40x40 -o small.png --legend");
    assert!(told.contains("no room for a legend"), "{told}");
}

#[test]
fn every_frame_of_a_sequence_has_its_legend() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    fs::write(here.join("a.toml"), SCENE).unwrap();
    run(here, "render a.toml --turntable 2 --background transparent --style edge-transparent -o without_{frame}.png");
    run(
        here,
        "render a.toml --turntable 2 --background transparent --style edge-transparent -o with_{frame}.png --legend",
    );
    for frame in ["0000", "0001"] {
        let without = picture(here, &format!("without_{frame}.png"));
        let with = picture(here, &format!("with_{frame}.png"));
        let panel = changed(&without, &with).unwrap();
        assert!(panel[0] < 20 && panel[3] > 220, "{panel:?}");
        // Opaque over a transparent background.
        assert_eq!(with.get_pixel(panel[0] + 2, panel[1] + 2).0[3], 255);
    }
}
