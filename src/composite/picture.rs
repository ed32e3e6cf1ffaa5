//! A picture in memory.

/// Linear RGB with straight (not premultiplied) alpha, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// `width · height` pixels: linear red, green, blue, and alpha.
    pub pixels: Vec<[f32; 4]>,
    /// Planar view depth of what each pixel shows, +∞ where that is nothing, world units; `None` where it is that of the
    /// nearest layer.
    pub depth: Option<Vec<f32>>,
    /// Pixels in which any surface is seen.
    pub covered: u64,
    /// Whether the background lets through what a viewer puts behind the picture, so that alpha belongs in its file.
    pub has_alpha: bool,
}

impl Picture {
    /// Whether no surface is seen.
    pub fn is_empty(&self) -> bool {
        self.covered == 0
    }

    /// The pixel at column `x`, row `y`.
    pub fn at(&self, x: u32, y: u32) -> [f32; 4] {
        self.pixels[y as usize * self.width as usize + x as usize]
    }
}
