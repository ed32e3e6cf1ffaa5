//! A picture of what differs: the greyed truth with the wrong pixels in loud colours.

use image::{Rgb, RgbImage};

use super::compare::{CompareError, Difference, Judge};
use crate::layers::LayerStack;

/// Both see a surface, of different leaf or facing.
pub const WRONG_LEAF: Rgb<u8> = Rgb([255, 0, 255]);
/// The truth sees a surface, the test nothing.
pub const HOLE: Rgb<u8> = Rgb([255, 0, 0]);
/// The test sees a surface, the truth nothing.
pub const SPILL: Rgb<u8> = Rgb([0, 255, 255]);
/// Any of these, within 1 px of the truth's silhouettes and cut edges.
pub const NEAR_EDGE: Rgb<u8> = Rgb([255, 255, 0]);
/// Where the truth sees nothing.
const BACKGROUND: Rgb<u8> = Rgb([24, 24, 24]);

/// Paints the differences between `test` and `truth`.
///
/// # Errors
/// [`CompareError::SizesDiffer`].
pub fn difference_picture(test: &LayerStack, truth: &LayerStack) -> Result<RgbImage, CompareError> {
    let judge = Judge::new(test, truth)?;
    let grey = |pixel| {
        // A headlight between two greys: the shape shows, and no colour of a difference can be mistaken.
        const DARKEST: f32 = 70.0;
        const BRIGHTEST: f32 = 190.0;
        judge.truth.at(pixel).map_or(BACKGROUND, |boundary| {
            let towards_eye = -boundary.normal.dot(truth.camera.forward.as_vec3());
            let level = DARKEST + (BRIGHTEST - DARKEST) * towards_eye.abs().min(1.0);
            Rgb([level as u8; 3])
        })
    };
    let mut picture = RgbImage::new(judge.truth.width, judge.truth.height);
    for pixel in judge.pixels() {
        let colour = match judge.difference(pixel) {
            Difference::None => grey(pixel),
            _ if judge.near_edge(pixel) => NEAR_EDGE,
            Difference::WrongLeaf => WRONG_LEAF,
            Difference::Hole => HOLE,
            Difference::Spill => SPILL,
        };
        picture.put_pixel(pixel.0, pixel.1, colour);
    }
    Ok(picture)
}

#[cfg(test)]
mod tests {
    use super::super::outline::tests::flat;
    use super::*;

    #[test]
    fn every_kind_of_difference_has_its_colour() {
        // Truth: leaf 0 up to column 48, leaf 1 up to column 80, then nothing.
        let truth = flat(|px| (px.x < 80.0).then_some(u32::from(px.x > 48.0)));
        let test = flat(|px| match px.y as u32 {
            0 => (px.x < 60.0).then_some(u32::from(px.x > 48.0)),
            1 => (px.x < 90.0).then_some(u32::from(px.x > 48.0)),
            2 => (px.x < 80.0).then_some(u32::from(px.x > 53.0)),
            _ => (px.x < 80.0).then_some(u32::from(px.x > 48.0)),
        });
        let picture = difference_picture(&test, &truth).unwrap();
        assert_eq!(*picture.get_pixel(70, 0), HOLE);
        assert_eq!(*picture.get_pixel(79, 0), NEAR_EDGE);
        assert_eq!(*picture.get_pixel(85, 1), SPILL);
        assert_eq!(*picture.get_pixel(50, 2), WRONG_LEAF);
        assert_eq!(*picture.get_pixel(48, 2), NEAR_EDGE);
        assert_eq!(*picture.get_pixel(50, 9), Rgb([190; 3]));
        assert_eq!(*picture.get_pixel(95, 9), BACKGROUND);
    }
}
