//! Pictures that this machine cannot hold are refused before anything is drawn.

use std::mem::size_of;

use surfcut::composite::maps;
use surfcut::layers::Boundary;
use surfcut::output::resources::available_memory_bytes;
use surfcut::scene::style::Style;
use surfcut::space::Camera;

use super::failure::InputError;

/// What one pixel of a finished picture takes: four channels in 32 bits.
const PICTURE: u64 = size_of::<[f32; 4]>() as u64;

/// What one pixel of a layer stack takes with one boundary a pixel: few scenes have less on average, many have more.
const STACK: u64 = (size_of::<Boundary>() + size_of::<u32>()) as u64;

/// What one pixel of a picture's depths takes.
const DEPTH: u64 = size_of::<f32>() as u64;

/// What a run keeps in memory for each pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Held {
    bytes_per_pixel: u64,
}

impl Held {
    /// Two pictures' layers, their outlines, and distances in 64 bits to three kinds of edges.
    pub const COMPARISON: Self = Self {
        bytes_per_pixel: 2 * (STACK + size_of::<Option<Boundary>>() as u64 + PICTURE) + 3 * size_of::<f64>() as u64,
    };

    /// A picture and its depths (all but the plainest keep them), composed with `merged` others, and the file that it becomes:
    /// a PNG, or with its layers an EXR.
    pub fn picture(with_layers: bool, merged: usize) -> Self {
        const RGBA_BYTES: u64 = 4;
        // An EXR has ten 32-bit channels a layer.
        let file = if with_layers { STACK + 10 * size_of::<f32>() as u64 } else { 2 * RGBA_BYTES };
        Self { bytes_per_pixel: (1 + merged as u64) * (PICTURE + DEPTH) + file }
    }

    /// The maps of `layers` layers in `style`, beside what is held already.
    pub fn maps(style: &Style, layers: usize) -> Self {
        Self { bytes_per_pixel: maps::bytes_per_pixel(style, layers) }
    }
}

/// Refuses a picture of `camera`'s size that would take more memory than there is.
pub fn check(camera: &Camera, held: Held) -> Result<(), InputError> {
    let pixels = u64::from(camera.width) * u64::from(camera.height);
    let needed = held.bytes_per_pixel.saturating_mul(pixels);
    let available = available_memory_bytes();
    // Where the system does not tell, it may still refuse to hand out so much.
    let refused = usize::try_from(needed).map_or(true, |bytes| Vec::<u8>::new().try_reserve_exact(bytes).is_err());
    if !refused && available.is_none_or(|available| needed <= available) {
        return Ok(());
    }
    let gib = |bytes: u64| format!("{:.1} GiB", bytes as f64 / f64::from(1 << 30));
    let have = available.map_or("more than this machine gives".to_owned(), |bytes| format!("{} are free", gib(bytes)));
    Err(InputError(format!(
        "a picture of {}x{} pixels takes at least {} of memory, and {have}: choose a smaller --size, or draw parts of it with \
         --zoom and --at",
        camera.width,
        camera.height,
        gib(needed)
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use surfcut::scene::Scene;
    use surfcut::scene::style::StyleKind;

    #[test]
    fn ordinary_pictures_pass_and_those_beyond_any_memory_do_not() {
        let scene = Scene::of_operand("sphere:0,0,0,1").unwrap();
        let camera = surfcut::scene::load(scene, &Default::default(), &surfcut::formats::NoProgress);
        let mut camera = camera.unwrap().camera().unwrap();
        let sketchy = Style::of(StyleKind::Sketchy);
        let pictures = [Held::picture(false, 0), Held::picture(true, 0), Held::picture(false, 2)];
        for held in pictures.into_iter().chain([Held::COMPARISON, Held::maps(&sketchy, 3)]) {
            (camera.width, camera.height) = (64, 64);
            check(&camera, held).unwrap();
            // Sides that no flag lets through: 10^19 bytes are more than any machine has.
            (camera.width, camera.height) = (1 << 30, 1 << 28);
            let message = check(&camera, held).unwrap_err().to_string();
            assert!(message.contains("GiB") && message.contains("--size"), "{message}");
        }
    }

    #[test]
    fn what_joins_a_picture_counts() {
        // Four channels and a depth for each picture.
        let bytes = |merged: usize| Held::picture(false, merged).bytes_per_pixel;
        assert_eq!((bytes(2) - bytes(0), bytes(0)), (2 * 20, 20 + 8));
        let sketchy = Style::of(StyleKind::Sketchy);
        // Two depths and five colours a layer.
        let of_maps = |layers: usize| Held::maps(&sketchy, layers).bytes_per_pixel;
        assert_eq!(of_maps(5) - of_maps(4), 2 * 4 + 5 * 3);
    }
}
