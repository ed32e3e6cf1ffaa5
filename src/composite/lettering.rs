//! Text in pictures.
//!
//! *Practice.* The typeface is Hack, made for small sizes on screens; it is part of the program, so that pictures are the same
//! on every machine. It has Latin, Greek and Cyrillic letters; what it lacks is shown as an empty box, never left out. Glyphs
//! begin at whole pixels, and so do lines: at small sizes that is sharper than exact distances.

use std::sync::LazyLock;

use fontdue::{Font, FontSettings};

/// Strokes of small letters are narrower than a pixel and would be pale: ink is stronger by so much.
const STRONGER: f32 = 1.35;

/// Stands for a character that the typeface lacks.
const LACKING: char = '▢';

static FONT: LazyLock<Font> = LazyLock::new(|| {
    Font::from_bytes(epaint_default_fonts::HACK_REGULAR, FontSettings::default())
        .expect("the typeface is the program's")
});

/// `text` with a box for every character that cannot be shown.
pub(super) fn showable(text: &str) -> String {
    text.chars().map(|c| if !c.is_control() && FONT.has_glyph(c) { c } else { LACKING }).collect()
}

/// The width of `text` in pixels, of letters of `size` pixels (the height of a line without space between lines, nearly).
pub(super) fn width(text: &str, size: u32) -> u32 {
    text.chars().map(|c| FONT.metrics(c, size as f32).advance_width).sum::<f32>().ceil() as u32
}

/// Height of capital letters of `size`, in pixels.
pub(super) fn capital_height(size: u32) -> u32 {
    FONT.metrics('H', size as f32).height as u32
}

/// Draws `text`: calls `ink` with each pixel that it covers, to the right of its beginning and down from its base line, and the
/// share of ink in it, above 0 to 1.
pub(super) fn draw(text: &str, size: u32, mut ink: impl FnMut(i32, i32, f32)) {
    let mut pen = 0.0_f32;
    for c in text.chars() {
        let (metrics, coverage) = FONT.rasterize(c, size as f32);
        let (left, top) = (pen.round() as i32 + metrics.xmin, -(metrics.ymin + metrics.height as i32));
        for (i, &covered) in coverage.iter().enumerate().filter(|(_, covered)| **covered > 0) {
            let (column, row) = (i % metrics.width, i / metrics.width);
            ink(left + column as i32, top + row as i32, (STRONGER * f32::from(covered) / 255.0).min(1.0));
        }
        pen += metrics.advance_width;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_typeface_lacks_is_a_box_and_nothing_is_left_out() {
        assert_eq!(showable("Hüftkopf Ø8 µm, λ, ж"), "Hüftkopf Ø8 µm, λ, ж");
        assert_eq!(showable("骨 a\tb"), "▢ a▢b");
        let mut inked = 0;
        draw(&showable("骨"), 12, |_, _, _| inked += 1);
        assert!(inked > 20, "{inked}");
    }

    #[test]
    fn text_stays_within_its_width_and_height() {
        for size in [6, 9, 13, 40] {
            let text = "Wgjq|Ål";
            let (width, mut covered) = (width(text, size) as i32, 0.0);
            draw(text, size, |x, y, share| {
                assert!((-1..=width).contains(&x) && y.unsigned_abs() < size + size / 4, "{x}, {y} at {size}");
                covered += share;
            });
            assert!(covered > size as f32, "{covered} at {size}");
        }
    }
}
