//! Colours as users write them (sRGB) and as the renderer keeps them (linear RGB), and the default palette.

use std::sync::LazyLock;

/// Linear light from an sRGB value, both 0 to 1 (IEC 61966-2-1).
pub fn linear_from_srgb(value: f32) -> f32 {
    if value <= 0.040_45 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// sRGB value from linear light, both 0 to 1 (IEC 61966-2-1).
pub fn srgb_from_linear(value: f32) -> f32 {
    if value <= 0.003_130_8 { value * 12.92 } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 }
}

/// The sRGB byte nearest to linear light `value` (0 to 1, clamped; NaN is black). Exact, and free of `powf`.
pub fn srgb_byte_from_linear(value: f32) -> u8 {
    // Even at the dark end, where sRGB is steepest (12.92 per unit), one such step is less than one byte.
    const STEPS: usize = 4096;
    /// `least[b]` is where byte `b` begins; `guess[i]` is the byte of the start of step `i`.
    struct Table {
        least: [f32; 256],
        guess: [u8; STEPS + 1],
    }
    static TABLE: LazyLock<Table> = LazyLock::new(|| {
        let mut least = [0.0; 256];
        (1..256).for_each(|b| least[b] = linear_from_srgb((b as f32 - 0.5) / 255.0));
        let guess = std::array::from_fn(|i| {
            let start = i as f32 / STEPS as f32;
            least.iter().rposition(|&l| l <= start).unwrap_or(0) as u8
        });
        Table { least, guess }
    });
    if !(value > 0.0) {
        return 0;
    }
    if value >= 1.0 {
        return 255;
    }
    let mut byte = TABLE.guess[(value * STEPS as f32) as usize];
    while byte < 255 && value >= TABLE.least[usize::from(byte) + 1] {
        byte += 1;
    }
    byte
}

/// Linear RGB from sRGB bytes.
pub fn linear_from_bytes(bytes: [u8; 3]) -> [f32; 3] {
    bytes.map(|b| linear_from_srgb(f32::from(b) / 255.0))
}

/// Named colours that a user may write instead of `#rrggbb`.
const NAMED: [(&str, [u8; 3]); 10] = [
    ("black", [0, 0, 0]),
    ("white", [255, 255, 255]),
    ("grey", [128, 128, 128]),
    ("gray", [128, 128, 128]),
    ("red", [205, 62, 58]),
    ("orange", [232, 140, 48]),
    ("yellow", [236, 199, 74]),
    ("green", [86, 158, 84]),
    ("blue", [66, 118, 186]),
    ("ivory", [236, 226, 205]),
];

/// Linear RGB of `#rrggbb`, `#rgb` or a colour's name; `None` where the text is neither.
pub fn parse(text: &str) -> Option<[f32; 3]> {
    if let Some((_, bytes)) = NAMED.iter().find(|(name, _)| name.eq_ignore_ascii_case(text)) {
        return Some(linear_from_bytes(*bytes));
    }
    let digits: Vec<u8> =
        text.strip_prefix('#')?.chars().map(|c| c.to_digit(16).map(|d| d as u8)).collect::<Option<_>>()?;
    match digits[..] {
        [r, g, b] => Some(linear_from_bytes([r, g, b].map(|d| d * 17))),
        [r1, r0, g1, g0, b1, b0] => Some(linear_from_bytes([r1 * 16 + r0, g1 * 16 + g0, b1 * 16 + b0])),
        _ => None,
    }
}

/// What [`parse`] takes, for messages.
pub const COLOUR_FORMS: &str = "\"#rrggbb\", a name such as \"ivory\", or [r, g, b] with sRGB values from 0 to 1";

/// Linear RGB and opacity behind everything, from `transparent` or a colour; `None` where the text is neither.
pub fn parse_background(text: &str) -> Option<[f32; 4]> {
    if text.eq_ignore_ascii_case("transparent") {
        return Some([0.0; 4]);
    }
    parse(text).map(|[r, g, b]| [r, g, b, 1.0])
}

/// sRGB of the first leaves: bone first, since a scan is what is cut, then hues that differ in lightness too, so that
/// they stay apart for colour-blind readers and in a grey print.
const PALETTE: [[u8; 3]; 8] = [
    [232, 220, 196], // bone
    [214, 106, 75],  // terracotta
    [78, 132, 182],  // steel blue
    [233, 180, 84],  // ochre
    [96, 160, 124],  // sage
    [156, 108, 158], // plum
    [92, 186, 192],  // teal
    [176, 92, 106],  // rose
];

/// The linear RGB of leaf `index` where neither scene nor file gives one. Leaves past the palette get further hues of
/// the same lightness, at the golden angle, so neighbours never look alike.
pub fn leaf_colour(index: usize) -> [f32; 3] {
    if let Some(bytes) = PALETTE.get(index) {
        return linear_from_bytes(*bytes);
    }
    let golden_turn = (5f64.sqrt() - 1.0) / 2.0;
    let hue = ((index as f64 * golden_turn).fract() * std::f64::consts::TAU) as f32;
    let third = std::f32::consts::TAU / 3.0;
    std::array::from_fn(|channel| linear_from_srgb(0.62 + 0.2 * (hue - third * channel as f32).cos()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_round_trips_every_byte() {
        for byte in 0..=255u8 {
            let linear = linear_from_srgb(f32::from(byte) / 255.0);
            assert_eq!((srgb_from_linear(linear) * 255.0).round() as u8, byte);
            assert_eq!(srgb_byte_from_linear(linear), byte);
        }
        // Mid grey: 21.4 % linear is the figure every sRGB table gives for 50 %.
        assert!((linear_from_srgb(0.5) - 0.2140).abs() < 1e-4);
    }

    #[test]
    fn the_table_rounds_as_the_formula_does() {
        for i in 0..=100_000 {
            let value = i as f32 / 100_000.0;
            let exact = srgb_from_linear(value) * 255.0;
            assert!((f32::from(srgb_byte_from_linear(value)) - exact).abs() < 0.501, "{value}");
        }
        assert_eq!([f32::NAN, -1.0, 2.0, f32::INFINITY].map(srgb_byte_from_linear), [0, 0, 255, 255]);
    }

    #[test]
    fn colours_are_read_in_every_form() {
        assert_eq!(parse("#ffffff"), Some([1.0; 3]));
        assert_eq!(parse("#FfF"), Some([1.0; 3]));
        assert_eq!(parse("Black"), Some([0.0; 3]));
        for bad in ["ffffff", "#ff", "#ggg", "#fffffff", "", "#é0"] {
            assert_eq!(parse(bad), None, "{bad}");
        }
        assert_eq!(parse_background("transparent"), Some([0.0; 4]));
        assert_eq!(parse_background("white"), Some([1.0; 4]));
    }

    #[test]
    fn many_leaves_get_distinct_colours() {
        let colours: Vec<_> = (0..64).map(leaf_colour).collect();
        for (i, a) in colours.iter().enumerate() {
            assert!(a.iter().all(|c| (0.0..=1.0).contains(c)));
            for b in &colours[..i] {
                assert!(a.iter().zip(b).any(|(x, y)| (x - y).abs() > 0.004));
            }
        }
    }
}
