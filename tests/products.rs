//! `--union products` against the products written by hand and drawn one by one.

use std::collections::HashMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn surfcut(directory: &Path, line: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_surfcut")).current_dir(directory).args(line.split_whitespace()).output().unwrap()
}

const LEAVES: &str = "size = [72, 60]\n[camera]\neye = [3, -5, 4]\ntarget = [0.4, 0, 0]\n\
    [leaf.a]\nsphere = { centre = [0, 0, 0], radius = 1 }\nopacity = 0.5\n\
    [leaf.b]\nbox = { min = [0.2, -0.7, -0.7], max = [1.6, 0.7, 0.7] }\nopacity = 0.5\n\
    [leaf.c]\ncylinder = { from = [0.3, 0, -2], to = [0.3, 0, 2], radius = 0.35 }\nopacity = 0.5\n";

fn draw(directory: &Path, name: &str, csg: &str, flags: &str) {
    fs::write(directory.join(format!("{name}.toml")), format!("csg = '{csg}'\n{LEAVES}")).unwrap();
    let output = surfcut(directory, &format!("render {name}.toml -o {name}.exr --overwrite {flags}"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Depth, leaf and facing of every layer of every pixel, from an EXR.
fn layers(path: &Path) -> Vec<Vec<[f32; 3]>> {
    use exr::prelude::{ReadChannels, ReadLayers, read};
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path);
    let layer = image.unwrap().layer_data;
    let channels: HashMap<String, Vec<f32>> = layer
        .channel_data
        .list
        .iter()
        .map(|channel| (channel.name.to_string(), channel.sample_data.values_as_f32().collect()))
        .collect();
    let pixels = channels["Z"].len();
    let of_layer = |pixel: usize, layer: usize| {
        let prefix = if layer == 0 { String::new() } else { format!("layer{layer}.") };
        let at = |name: &str| channels.get(&format!("{prefix}{name}")).map(|values| values[pixel]);
        let found = [at("Z")?, at("Leaf")?, at("Facing")?];
        (found[1] >= 0.0).then_some(found)
    };
    (0..pixels).map(|pixel| (0..).map_while(|layer| of_layer(pixel, layer)).collect()).collect()
}

#[test]
fn products_are_those_written_by_hand_drawn_one_by_one() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let every = [
        ("a | b", vec!["a", "b"]),
        ("(a | b) - c", vec!["a - c", "b - c"]),
        ("(a - b) | (b - a) | c", vec!["a - b", "b - a", "c"]),
    ];
    // Products without a leaf of surfels are drawn by another pipeline when they are alone.
    let with_a = [("(a - b) | (a & c)", vec!["a - b", "a & c"])];
    for (pipeline, cases) in [
        ("--pipeline splat", &every[..]),
        ("--pipeline mesh", &every[..]),
        ("--pipeline reference", &every[..]),
        ("--represent a=surfels", &with_a[..]),
    ] {
        let flags = format!("{pipeline} --layers all");
        for (csg, products) in cases {
            draw(here, "all", csg, &format!("{flags} --union products"));
            let together = layers(&here.join("all.exr"));
            let mut by_hand = vec![Vec::new(); together.len()];
            for product in products {
                draw(here, "one", product, &flags);
                for (pixel, layers) in by_hand.iter_mut().zip(layers(&here.join("one.exr"))) {
                    pixel.extend(layers);
                }
            }
            let mut seen = 0;
            for (together, mut by_hand) in together.into_iter().zip(by_hand) {
                let order = |a: &[f32; 3], b: &[f32; 3]| {
                    a[0].total_cmp(&b[0]).then(a[2].total_cmp(&b[2])).then(a[1].total_cmp(&b[1]))
                };
                by_hand.sort_by(order);
                assert_eq!(together, by_hand, "{pipeline}, {csg}");
                seen += together.len();
            }
            assert!(seen > 1000, "{seen}");
        }
    }
}

#[test]
fn one_product_is_the_volume_and_an_exploding_form_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    draw(here, "volume", "a - b - c", "");
    draw(here, "products", "a - b - c", "--union products");
    assert_eq!(layers(&here.join("volume.exr")), layers(&here.join("products.exr")));
    let many = ["(a | b | c)"; 12].join(" & ");
    fs::write(here.join("many.toml"), format!("csg = '{many}'\n{LEAVES}")).unwrap();
    let refused = surfcut(here, "render many.toml -o many.png --union products");
    let text = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(3));
    assert!(text.contains("531441") && text.contains("--union volume"), "{text}");
}
