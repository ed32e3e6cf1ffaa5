//! Writes a solid as a closed mesh that leaves it by no more than a given length.
//!
//! ```text
//! cargo run --release --example tessellate cylinder:40,-60,-20,130,90,-60,9 0.01 drill.ply
//! ```
//!
//! The arguments are the solid, as the command line of surfcut writes it, the largest error and the file to write.

use std::path::Path;

use anyhow::{Context, bail};
use surfcut::formats::write_ply_mesh;
use surfcut::scene::{LeafSource, Scene};

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [solid, error, output] = &arguments[..] else {
        bail!("expected: the solid, the largest error, the file to write");
    };
    let scene = Scene::of_operand(solid)?;
    let LeafSource::Solid(solid) = &scene.leaves[0].source else { bail!("{solid} is a file, not a solid") };
    let mesh = solid.tessellate(error.parse().with_context(|| format!("the largest error, not {error:?}"))?)?;
    write_ply_mesh(Path::new(output), &mesh)?;
    println!("{output}: {} triangles", mesh.triangles.len());
    Ok(())
}
