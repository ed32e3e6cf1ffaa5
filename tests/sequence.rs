//! Sequences as a user meets them: frames, films, and runs that go on where they stopped.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn command(directory: &Path, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_surfcut"));
    command.current_dir(directory).args(line.split_whitespace());
    command
}

fn surfcut(directory: &Path, line: &str) -> Output {
    command(directory, line).output().unwrap()
}

fn text(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn run(directory: &Path, line: &str) -> String {
    let output = surfcut(directory, line);
    assert!(output.status.success(), "{line}: {}", text(&output));
    text(&output)
}

fn entries(directory: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

fn bytes(directory: &Path, name: &str) -> Vec<u8> {
    fs::read(directory.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

const SCENE: &str = "csg = 'ball - drill'\nsize = [64, 48]\n\
    [leaf.ball]\nsphere = { centre = [0, 0, 0], radius = 1 }\ncolour = 'ivory'\n\
    [leaf.drill]\ncylinder = { from = [0, 0, 0], to = [0, 0, 3], radius = 0.4 }\ncolour = '#4682b4'\ntranslate = [0, 0, 0.9]\n";

const KEYFRAMES: &str = "[[keyframe]]\ntime = 0\ncamera = { eye = [3, -5, 4] }\n[[keyframe]]\ntime = 0.2\nleaf.drill = { translate = [0, 0, 0.9], rotate = [0, 0, 0] }\n\
    [[keyframe]]\ntime = 0.5\nleaf.drill = { translate = [0.2, 0, -0.5], rotate = [0, 30, 0] }\n";

fn with_scene(text: &str) -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("cut.toml"), text).unwrap();
    directory
}

#[test]
fn a_turntable_writes_frames_and_a_film_and_goes_on_where_it_stopped() {
    let directory = with_scene(SCENE);
    let here = directory.path();
    let line = "render cut.toml --turntable 6 -o t_{frame}.png -o t.gif --summary-file run.json";
    run(here, line);
    let frames: Vec<String> = (0..6).map(|frame| format!("t_000{frame}.png")).collect();
    let mut wanted = vec!["cut.toml".to_owned(), "run.json".to_owned(), "t.gif".to_owned()];
    wanted.extend(frames.iter().cloned());
    wanted.push("t_frames.png.jsonl".to_owned());
    wanted.sort();
    assert_eq!(entries(here), wanted);
    let json: serde_json::Value = serde_json::from_slice(&bytes(here, "run.json")).unwrap();
    assert_eq!((&json["counts"]["frames"], &json["frame"]["repeats"]), (&6.into(), &6.into()));
    // The first frame is the picture that no sequence draws.
    run(here, "render cut.toml -o still.png");
    let still = image::open(here.join("still.png")).unwrap();
    assert_eq!(image::open(here.join("t_0000.png")).unwrap(), still);
    // Two frames are lost and one is cut short.
    let before: Vec<Vec<u8>> = frames.iter().map(|name| bytes(here, name)).collect();
    fs::remove_file(here.join("t_0001.png")).unwrap();
    fs::remove_file(here.join("t_0005.png")).unwrap();
    fs::remove_file(here.join("t.gif")).unwrap();
    fs::write(here.join("t_0003.png"), &before[3][..100]).unwrap();
    let told = run(here, "render cut.toml --turntable 6 -o t_{frame}.png -o t.gif");
    assert!(told.contains("3 of 6 frames are there already"), "{told}");
    let after: Vec<Vec<u8>> = frames.iter().map(|name| bytes(here, name)).collect();
    assert_eq!(before, after);
    // Another command, and another scene, are refused; --overwrite begins anew.
    let refused = surfcut(here, "render cut.toml --turntable 6 -o t_{frame}.png --samples 4");
    assert_eq!(refused.status.code(), Some(4));
    assert!(
        text(&refused).contains("with other flags") && text(&refused).contains("--overwrite"),
        "{}",
        text(&refused)
    );
    fs::write(here.join("cut.toml"), SCENE.replace("0.4", "0.3")).unwrap();
    let refused = surfcut(here, "render cut.toml --turntable 6 -o t_{frame}.png");
    assert!(text(&refused).contains("another scene"), "{}", text(&refused));
    run(here, "render cut.toml --turntable 6 -o t_{frame}.png --overwrite");
    assert_ne!(bytes(here, "t_0000.png"), before[0]);
}

#[test]
fn a_killed_run_is_finished_by_the_same_command() {
    let directory = with_scene(SCENE);
    let here = directory.path();
    // Slow enough to be killed half way: the judge draws these.
    let line = "render cut.toml --pipeline reference --size 320x240 --samples 4 --turntable 8 -o k_{frame}.png --quiet";
    let mut child = command(here, line).stderr(Stdio::null()).spawn().unwrap();
    let start = Instant::now();
    while !here.join("k_0002.png").exists() && start.elapsed() < Duration::from_secs(120) {
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let there = |name: &String| name.starts_with("k_0");
    assert!(entries(here).iter().filter(|name| there(name)).count() < 8, "the run was over before it could be killed");
    run(here, line);
    assert_eq!(entries(here).iter().filter(|name| there(name)).count(), 8);
    assert!(!entries(here).iter().any(|name| name.ends_with(".tmp")), "{:?}", entries(here));
    let other = with_scene(SCENE);
    run(other.path(), line);
    for frame in 0..8 {
        let name = format!("k_000{frame}.png");
        assert_eq!(bytes(here, &name), bytes(other.path(), &name), "{name}");
    }
}

#[test]
fn keyframes_move_leaves_and_the_camera_alike_in_every_pipeline() {
    let directory = with_scene(&format!("{SCENE}{KEYFRAMES}"));
    let here = directory.path();
    let pipelines = ["--pipeline splat", "--pipeline mesh", "--pipeline reference", "--represent ball=surfels"];
    for (name, pipeline) in ["splat", "mesh", "reference", "hybrid"].into_iter().zip(pipelines) {
        run(here, &format!("render cut.toml {pipeline} --animate --fps 10 -o {name}_{{frame}}.png"));
        // Frames 0 to 5: at rest up to 2, then moving.
        let frame = |i: usize| image::open(here.join(format!("{name}_{i:04}.png"))).unwrap().into_rgb8();
        assert_eq!(frame(0), frame(2));
        assert_ne!(frame(3), frame(2));
        assert!(!here.join(format!("{name}_0006.png")).exists());
        // The last keyframe is the scene that says the same without keyframes.
        let moved = SCENE.replace("translate = [0, 0, 0.9]", "translate = [0.2, 0, -0.5]\nrotate = [0, 30, 0]");
        fs::write(here.join("moved.toml"), moved).unwrap();
        // Looking from there at what the unmoved scene is framed at.
        let target = "--target 0,0,0";
        run(here, &format!("render moved.toml {pipeline} --eye 3,-5,4 {target} -o still.png --overwrite"));
        run(here, &format!("render cut.toml {pipeline} --animate --fps 10 {target} -o at_{name}_{{frame}}.png"));
        let still = image::open(here.join("still.png")).unwrap().into_rgb8();
        let last = image::open(here.join(format!("at_{name}_0005.png"))).unwrap().into_rgb8();
        // Motions round; a pixel on an edge may fall to the other side.
        let differing =
            still.pixels().zip(last.pixels()).filter(|(a, b)| (0..3).any(|k| a[k].abs_diff(b[k]) > 4)).count();
        assert!(differing <= 8, "{name}: {differing} pixels");
    }
}

#[test]
fn a_sequence_is_not_gone_on_with_when_what_it_is_merged_with_has_changed() {
    let directory = with_scene(SCENE);
    let here = directory.path();
    let other = |radius: f64| {
        let line =
            format!("render sphere:1,0,0,{radius} --size 48x40 --turntable 2 -o other_{{frame}}.exr --overwrite");
        run(here, &line);
    };
    let merged = "render cut.toml --size 48x40 --turntable 2 --merge other_{frame}.exr -o a_{frame}.png";
    other(0.5);
    run(here, merged);
    // The same again has nothing to do.
    assert!(run(here, merged).contains("2 of 2 frames are there already"));
    other(0.7);
    let refused = surfcut(here, merged);
    assert_eq!(refused.status.code(), Some(4), "{}", text(&refused));
    assert!(text(&refused).contains("was begun"), "{}", text(&refused));
}

#[test]
fn films_leave_nothing_behind() {
    let directory = with_scene(&format!("{SCENE}{KEYFRAMES}"));
    let here = directory.path();
    run(here, "render cut.toml --animate --fps 10 -o a.gif -o a.apng --background transparent");
    assert_eq!(entries(here), ["a.apng", "a.gif", "cut.toml"]);
    let refused = surfcut(here, "render cut.toml --animate -o a.gif");
    assert_eq!(refused.status.code(), Some(4), "{}", text(&refused));
}

#[test]
fn sequences_that_cannot_be_are_refused_with_the_way_out() {
    let directory = with_scene(SCENE);
    let here = directory.path();
    for (line, code, part) in [
        ("render cut.toml --turntable 4 -o a.png", 2, "a_{frame}.png"),
        ("render cut.toml --turntable 4 -o -", 2, "standard output"),
        ("render cut.toml --turntable 4 -o a.mp4", 4, ".png or .exr"),
        ("render cut.toml --animate -o a.gif", 3, "[[keyframe]]"),
        ("render cut.toml --animate --turntable 4", 2, "cannot be used with"),
        ("render cut.toml --turntable 4 --fps 0", 2, "0.01"),
        ("render cut.toml --turntable 4 --merge other.exr -o a.gif", 2, "{frame}"),
        ("render cut.toml --turntable 4 --dump-maps maps -o a.gif", 2, "--dump-maps"),
        ("render cut.toml --turntable 4 --merge other_{frame}.exr -o a.gif", 3, "other_0000.exr"),
    ] {
        let output = surfcut(here, line);
        assert_eq!(output.status.code(), Some(code), "{line}: {}", text(&output));
        assert!(text(&output).contains(part), "{line}: {}", text(&output));
        assert_eq!(entries(here), ["cut.toml"], "{line}");
    }
}
