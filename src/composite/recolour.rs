//! What a style changes of the layers before they are drawn: opacity, the colour of cut faces, how many there are.

use crate::layers::limit::first_layers;
use crate::layers::{LayerSource, LayerTile};
use crate::scene::style::{CutColour, Style};
use crate::space::{Camera, PixelRect};

/// A source with a style's opacity and colours, and its first layers alone.
pub struct Recoloured<'a> {
    source: &'a dyn LayerSource,
    pub(crate) opacity: f32,
    pub(crate) cut: CutColour,
    /// By leaf, linear RGB.
    leaf_colours: &'a [[f32; 3]],
    pub(crate) max_layers: Option<u32>,
}

impl<'a> Recoloured<'a> {
    /// `source` as `style` wants it; `leaf_colours` by the leaf's index, for [`CutColour::Leaf`].
    pub fn new(source: &'a dyn LayerSource, style: &Style, leaf_colours: &'a [[f32; 3]]) -> Self {
        // Lines are found with the layers behind the last one drawn: a front's outline is where its back ends too.
        let max_layers = style.max_layers.filter(|_| !style.kind.has_lines());
        Self { source, opacity: style.opacity_factor(), cut: style.cut_colour, leaf_colours, max_layers }
    }

    /// Whether nothing is changed.
    pub fn is_plain(&self) -> bool {
        self.opacity == 1.0 && self.cut == CutColour::Cutter && self.max_layers.is_none()
    }
}

impl LayerSource for Recoloured<'_> {
    fn camera(&self) -> &Camera {
        self.source.camera()
    }

    fn samples(&self) -> u32 {
        self.source.samples()
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let mut tile = self.source.draw(rect);
        if let Some(most) = self.max_layers {
            tile = first_layers(tile, self.samples(), most);
        }
        if self.opacity == 1.0 && self.cut == CutColour::Cutter {
            return tile;
        }
        for boundary in &mut tile.boundaries {
            boundary.opacity *= self.opacity;
            if boundary.leaf != boundary.body {
                match self.cut {
                    CutColour::Cutter => {}
                    CutColour::Leaf => {
                        boundary.colour = *self.leaf_colours.get(boundary.body as usize).unwrap_or(&boundary.colour);
                    }
                    CutColour::Set(colour) => boundary.colour = colour,
                }
            }
        }
        tile
    }
}
