use glam::DVec4;

use super::*;
use crate::geometry::Solid;

const FULL: &str = r##"
csg = "femur - (drill | ball)"
size = [640, 480]
background = "transparent"
units = "mm"

[leaf.femur]
file = "scans/femur.ply"
rotate = [90, 0, 90]
scale = 2
translate = [1, 2, 3]
truth = { sphere = { center = [0, 0, 0], radius = 1 } }
kind = "solid"

[leaf.drill]
cylinder = { from = [0, 0, -5], to = [0, 0, 5], radius = 0.8 }
color = "#ff0000"
opacity = 0.5
spacing = 0.01
represent = "mesh"

[leaf.ball]
box = { centre = [1, 0, 0], size = 2 }
colour = [0, 1, 0]
matrix = [[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, -1, 7], [0, 0, 0, 1]]

[camera]
eye = [8, -8, 5]
target = [0, 0, 0]
height = 12

[light]
towards = [0, 0, 2]
ambient = 0.5
"##;

fn parse_text(text: &str) -> Result<Scene, SceneError> {
    parse(text, Path::new("base"))
}

#[test]
fn a_full_scene_is_read() {
    let scene = parse_text(FULL).unwrap();
    let names: Vec<_> = scene.leaves.iter().map(|leaf| leaf.name.as_str()).collect();
    assert_eq!(names, ["femur", "drill", "ball"], "in the file's order, not the alphabet's");
    assert_eq!(scene.tree.display(|leaf| names[leaf.0 as usize]).to_string(), "femur - (drill | ball)");
    assert_eq!((scene.size, scene.background, scene.units.as_deref()), ((640, 480), Some([0.0; 4]), Some("mm")));
    let [femur, drill, ball] = &scene.leaves[..] else { panic!("three leaves") };
    assert!(matches!(&femur.source, LeafSource::File(path) if path == Path::new("base/scans/femur.ply")));
    assert!(matches!(femur.truth, Some(Truth::Solid(Solid::Sphere { .. }))));
    // x → (scale) 2x → (90° about x) 2x → (90° about z) 2y → moved.
    let p = femur.world_from_leaf.transform_point3(DVec3::X);
    assert!((p - DVec3::new(1.0, 4.0, 3.0)).length() < 1e-12, "{p}");
    // y → 2y → 2z → 2z: x is turned about before z.
    let p = femur.world_from_leaf.transform_point3(DVec3::Y);
    assert!((p - DVec3::new(1.0, 2.0, 5.0)).length() < 1e-12, "{p}");
    assert_eq!((drill.colour, drill.opacity, drill.spacing), (Some([1.0, 0.0, 0.0]), 0.5, Some(0.01)));
    assert_eq!((femur.represent, drill.represent), (None, Some(Representation::Mesh)));
    let LeafSource::Solid(Solid::Box { min, max }) = ball.source else { panic!("a box") };
    assert_eq!((min, max), (DVec3::new(0.0, -1.0, -1.0), DVec3::new(2.0, 1.0, 1.0)));
    assert_eq!(ball.world_from_leaf.transform_point3(DVec3::ONE), DVec3::new(6.0, 7.0, 6.0));
    let camera = scene.camera.unwrap();
    assert_eq!((camera.lens, camera.up), (Lens::Height(12.0), DVec3::Z));
    assert_eq!((scene.light.towards, scene.light.in_world, scene.light.ambient), (DVec3::Z, true, 0.5));
}

#[test]
fn one_leaf_needs_no_expression_and_files_may_be_absolute() {
    let scene = parse_text("[leaf.a]\nfile = '/scans/a.ply'\nrotate = { axis = [0, 0, 2], angle = 90 }").unwrap();
    assert_eq!(scene.tree, Tree::leaf(LeafId(0)));
    assert!(matches!(&scene.leaves[0].source, LeafSource::File(path) if path == Path::new("/scans/a.ply")));
    assert!((scene.leaves[0].world_from_leaf.transform_vector3(DVec3::X) - DVec3::Y).length() < 1e-12);
    assert_eq!((scene.size, scene.background), (super::super::DEFAULT_SIZE, None));
}

#[test]
fn a_byte_order_mark_and_windows_line_ends_do_not_move_places() {
    let error = parse_text("\u{feff}[leaf.a]\r\nfile = 'a.ply'\r\nopacity = 7\r\n").unwrap_err();
    assert_eq!(error.place, Place { line: 3, column: 11 });
}

/// Every kind of mistake: the scene, the place, and what the message must hold.
#[test]
fn mistakes_are_told_with_line_column_and_mend() {
    let ball = "[leaf.a]\nsphere = { centre = [0, 0, 0], radius = 1 }\n";
    let two = "[leaf.a]\nfile = 'a.ply'\n[leaf.b]\nfile = 'b.ply'\n";
    let with = |line: &str| format!("{ball}{line}");
    let top = |line: &str| format!("{line}\n{two}");
    let cases: Vec<(String, (usize, usize), &[&str])> = vec![
        // Not TOML at all.
        ("[leaf.a\nfile = 'a.ply'".into(), (1, 8), &["TOML"]),
        ("[leaf.a]\nfile = 'a.ply'\nfile = 'b.ply'".into(), (3, 1), &["TOML", "duplicate"]),
        // Keys.
        (with("opacty = 1"), (3, 1), &["`opacty` in [leaf.a]", "did you mean `opacity`", "spacing"]),
        (with("  zzz = 1"), (3, 3), &["`zzz`", "known here"]),
        (top("bakground = 'white'\ncsg = 'a'"), (1, 1), &["the top level", "`background`"]),
        (with("color = '#fff'\ncolour = '#fff'"), (3, 1), &["`colour` and `color`"]),
        (with("name = 'b'"), (3, 8), &["[leaf.a]"]),
        // Geometry.
        ("[leaf.a]\nopacity = 1".into(), (1, 1), &["leaf `a` has no geometry", "sphere"]),
        (
            "\n[leaf.a]\nfile = 'a.ply'\nsphere = { centre = [0, 0, 0], radius = 1 }".into(),
            (4, 10),
            &["`file` and `sphere`"],
        ),
        ("[leaf.a]\nsphere = { centre = [0, 0, 0], radius = -1 }".into(), (2, 41), &["-1", "larger than 0"]),
        ("[leaf.a]\nsphere = { centre = [0, 0, 0] }".into(), (2, 10), &["`sphere` lacks `radius`"]),
        ("[leaf.a]\nsphere = { centre = [0, 0], radius = 1 }".into(), (2, 21), &["2 entries", "[x, y, z]"]),
        ("[leaf.a]\nsphere = { centre = [0, 0, inf], radius = 1 }".into(), (2, 28), &["inf", "finite"]),
        ("[leaf.a]\nsphere = { centre = [0, 0, 'x'], radius = 1 }".into(), (2, 21), &["[x, y, z]"]),
        ("[leaf.a]\nsphere = { centre = [0, 0, 0], radus = 1 }".into(), (2, 32), &["`radius`"]),
        ("[leaf.a]\nbox = { min = [0, 0, 0], max = [1, 0, 1] }".into(), (2, 7), &["`box`", "along y"]),
        ("[leaf.a]\nbox = { centre = [0, 0, 0], max = [1, 0, 1] }".into(), (2, 35), &["`centre` and `max`"]),
        ("[leaf.a]\nbox = { size = [0, 0, 0], max = [1, 0, 1] }".into(), (2, 16), &["centre and size"]),
        ("[leaf.a]\nhalf_space = { point = [0, 0, 0], normal = [0, 0, 0] }".into(), (2, 44), &["length is 0"]),
        ("[leaf.a]\nblend = { balls = [], smoothness = 1 }".into(), (2, 9), &["at least one ball"]),
        ("[leaf.a]\nfile = 3".into(), (2, 8), &["`file` is a number"]),
        ("[leaf.a]\nfile = ''".into(), (2, 8), &["empty"]),
        ("[leaf.a]\nfile = 'a.ply'\ntruth = {}".into(), (3, 9), &["no solid"]),
        // Transforms.
        (with("scale = 0"), (3, 9), &["factor is 0"]),
        (with("scale = [1, 0, 1]"), (3, 9), &["factor is 0"]),
        (with("rotate = 90"), (3, 10), &["axis", "degrees"]),
        (with("rotate = { axis = [0, 0, 0], angle = 90 }"), (3, 19), &["length is 0"]),
        (with("matrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\nscale = 2"), (3, 10), &["`matrix` and `scale`"]),
        (with("matrix = [[1,0,0,0],[2,0,0,0],[0,0,1,0],[0,0,0,1]]"), (3, 10), &["singular"]),
        (with("matrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0]]"), (3, 10), &["3 rows"]),
        (with("matrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,1,1]]"), (3, 41), &["affine"]),
        // Looks.
        (with("colour = '#12345'"), (3, 10), &["#12345", "#rrggbb"]),
        (with("colour = [255, 0, 0]"), (3, 10), &["0 to 1"]),
        (with("opacity = 1.5"), (3, 11), &["0 to 1"]),
        (with("opacity = nan"), (3, 11), &["finite"]),
        (with("kind = 'open'"), (3, 8), &["\"sheet\""]),
        (with("represent = 'splat'"), (3, 13), &["\"splat\"", "\"surfels\""]),
        (with("spacing = 0"), (3, 11), &["larger than 0"]),
        // The whole.
        ("".into(), (1, 1), &["no leaf", "[leaf.body]"]),
        ("size = [0, 10]\n".to_owned() + ball, (1, 8), &["0x10"]),
        ("size = [1.5, 10]\n".to_owned() + ball, (1, 8), &["pixels"]),
        ("units = 3\n".to_owned() + ball, (1, 9), &["mm"]),
        ("leaf = 3".into(), (1, 8), &["[leaf.body]"]),
        ("[[leaf]]\nfile = 'a.ply'".into(), (1, 1), &["[leaf.body]"]),
        ("[leaf]\nfile = 'a.ply'".into(), (2, 8), &["`file`"]),
        // Expressions.
        (two.into(), (1, 1), &["2 leaves", "a | b"]),
        (top("csg = 'a - femur'"), (1, 12), &["unknown leaf `femur`", "a, b"]),
        (top("csg = \"\"\"\na -\n  c\"\"\""), (3, 3), &["unknown leaf `c`"]),
        (top("csg = 'a - (b'"), (1, 12), &["never closed"]),
        (top("csg = 'a b'"), (1, 10), &["expected"]),
        (top("csg = ''"), (1, 7), &["empty"]),
        (top("csg = 3"), (1, 7), &["`csg` is a number"]),
        (top("csg = 'a - !b'") + "kind = 'solid'\n[leaf.c]\nfile = 'c'\nkind = 'shet'", (9, 8), &["kind"]),
        // Cameras.
        (with("[camera]\neye = [0, 0, 0]"), (3, 1), &["`target`"]),
        (with("[camera]\neye = [0, 0, 0]\ntarget = [0, 0, 0]"), (3, 1), &["same point"]),
        (with("[camera]\neye = [0, 0, 5]\ntarget = [0, 0, 0]"), (3, 1), &["another up"]),
        (
            with("[camera]\neye = [5, 0, 0]\ntarget = [0, 0, 0]\nfov_y = 35\nheight = 2"),
            (7, 10),
            &["`fov_y` and `height`"],
        ),
        (with("[camera]\neye = [5, 0, 0]\ntarget = [0, 0, 0]\nfov_y = 180"), (3, 1), &["180"]),
        (with("[light]\ntowards = [0, 0, 0]"), (4, 11), &["length is 0"]),
        (with("[light]\nin_world = 1"), (4, 12), &["true or false"]),
    ];
    for (text, (line, column), parts) in cases {
        let error = parse_text(&text).expect_err(&text);
        let message = error.to_string();
        assert_eq!(error.place, Place { line, column }, "{text}\n→ {message}");
        for part in parts {
            assert!(message.contains(part), "{text}\n→ {message}\nlacks {part}");
        }
        assert!(message.starts_with(&format!("line {line}, column {column}: ")));
    }
}

#[test]
fn a_sheet_can_be_cut_and_never_cuts() {
    let scene = |csg: &str| {
        parse_text(&format!(
            "csg = '{csg}'\n[leaf.skin]\nfile = 'skin.ply'\nkind = 'sheet'\n[leaf.drill]\nfile = 'd.stl'"
        ))
    };
    for csg in ["skin - drill", "skin | drill", "skin & drill", "!(drill - skin) & skin", "!!skin"] {
        scene(csg).expect(csg);
    }
    for csg in ["drill - skin", "!skin", "drill & !(skin | drill)", "drill - (drill - !skin)"] {
        let error = scene(csg).expect_err(csg);
        assert_eq!(error.place, Place { line: 1, column: 7 }, "{csg}");
        assert_eq!(error.problem, SceneProblem::SheetCuts { leaf: "skin".into() }, "{csg}");
        assert!(error.to_string().contains("`skin` is a sheet"));
    }
}

#[test]
fn quoted_names_and_escapes_keep_a_place() {
    let text = "csg = '\"a b\" - nix'\n[leaf.\"a b\"]\nfile = 'a.ply'";
    let error = parse_text(text).unwrap_err();
    assert_eq!(error.place, Place { line: 1, column: 16 });
    // With escapes the text is not the file's: the value's place is the best there is.
    let error = parse_text("csg = \"\\\"a b\\\" - nix\"\n[leaf.\"a b\"]\nfile = 'a.ply'").unwrap_err();
    assert_eq!(error.place, Place { line: 1, column: 7 });
}

#[test]
fn places_count_characters() {
    assert_eq!(Place::of_byte("añb\nü", 3), Place { line: 1, column: 3 });
    assert_eq!(Place::of_byte("añb\nü", 2), Place { line: 1, column: 2 });
    assert_eq!(Place::of_byte("añb\nü", 99), Place { line: 2, column: 2 });
}

#[test]
fn matrices_are_read_by_rows() {
    let scene =
        parse_text("[leaf.a]\nfile = 'a.ply'\nmatrix = [[1, 2, 3, 4], [0, 5, 6, 7], [0, 0, 8, 9], [0, 0, 0, 1]]")
            .unwrap();
    let p = DVec3::new(1.0, -2.0, 0.5);
    let row = |a, b, c, d| DVec4::new(a, b, c, d).dot(p.extend(1.0));
    let wanted = DVec3::new(row(1.0, 2.0, 3.0, 4.0), row(0.0, 5.0, 6.0, 7.0), row(0.0, 0.0, 8.0, 9.0));
    assert!((scene.leaves[0].world_from_leaf.transform_point3(p) - wanted).length() < 1e-12);
}

#[test]
fn rubbish_never_panics() {
    // Every prefix and every deletion of one character of a scene that holds everything.
    for (i, c) in FULL.char_indices() {
        let _ = parse_text(&FULL[..i]);
        let _ = parse_text(&[&FULL[..i], &FULL[i + c.len_utf8()..]].concat());
    }
}

#[test]
fn a_style_is_read_with_all_that_it_names() {
    use crate::scene::style::{Corner, CutColour, StyleKind};
    let text = "[leaf.a]\nfile = 'a.ply'\n[style]\nkind = 'sketchy'\nopacity = 0.3\nline_width = 2\ncrease = 40\njump = 5\n\
                hidden = [4, 3]\nink = '#000000'\ncut_color = 'leaf'\nmax_layers = 3\nfade = 0.1\nocclusion = 0.2\n\
                sketch = { edge = [[1, 2], [3, 4]], wavelength = 50, seed = 9 }";
    let style = parse(text, Path::new("")).unwrap().style;
    assert_eq!((style.kind, style.opacity, style.max_layers), (StyleKind::Sketchy, 0.3, Some(3)));
    assert_eq!((style.fade, style.occlusion, style.cut_colour), (0.1, Some(0.2), CutColour::Leaf));
    let lines = style.lines;
    assert_eq!((lines.width_px, lines.crease_degrees, lines.jump_px), (2.0, 40.0, 5.0));
    assert_eq!((lines.hidden_dash_px, lines.ink), (Some([4.0, 3.0]), Some([0.0; 3])));
    assert_eq!((style.sketch.edge_px, style.sketch.seed), ([[1.0, 2.0], [3.0, 4.0]], 9));
    assert_eq!((style.sketch.wavelength_px, style.legend), (50.0, None));
    for (line, legend) in [("true", Some(Corner::BottomLeft)), ("false", None), ("'top-right'", Some(Corner::TopRight))]
    {
        let text = format!("[leaf.a]\nfile = 'a.ply'\n[style]\nlegend = {line}");
        assert_eq!(parse(&text, Path::new("")).unwrap().style.legend, legend);
    }
    for (line, shadows) in [("true", 1.0), ("false", 0.0), ("0.7", 0.7)] {
        let text = format!("[leaf.a]\nfile = 'a.ply'\n[style]\nshadows = {line}");
        assert_eq!(parse(&text, Path::new("")).unwrap().style.shadows, shadows);
    }
}

#[test]
fn mistakes_in_a_style_are_named() {
    let cases = [
        ("kind = 'cubist'", "blueprint"),
        ("line_width = 99", "16 pixels"),
        ("line_width = nan", "line_width"),
        ("crease = 300", "180"),
        ("hidden = 'wavy'", "dashed"),
        ("hidden = [0.2, 1]", "shorter than a pixel"),
        ("max_layers = 0", "whole number"),
        ("sketch = { edge = [[99, 0], [0, 1]] }", "at most 32"),
        ("sketch = { wavelength = 2 }", "break up"),
        ("legend = 'middle'", "top-right"),
        ("legend = 3", "true or false"),
        ("shadows = 2", "from 0 to 1"),
        ("shadows = 'dark'", "true, false"),
        ("strokes = 2", "unknown key"),
    ];
    for (line, wanted) in cases {
        let error = parse(&format!("[leaf.a]\nfile = 'a.ply'\n[style]\n{line}"), Path::new("")).unwrap_err();
        let text = error.to_string();
        assert!(text.contains(wanted), "{line}: {text}");
        assert_eq!(error.place.line, 4, "{line}");
    }
}
