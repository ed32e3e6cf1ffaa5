//! A legend in a corner of the picture: the names of the leaves that show, each beside its colour.
//!
//! *Practice.* Leaves are told apart by colour, and a reader has to learn whose is which; so each has a `swatch`.
//!
//! Letters are sized by the picture's height, and smaller where that brings in more rows or longer names, but not so small as
//! to be hard to read. What still does not fit is left out from the leaf that shows least, and the last row says how many; a
//! name that is too long ends in an ellipsis. The panel is opaque, of the paper's colour, so that names can be read over
//! anything, and takes at most a third of the picture's width and height.

use super::Look;
use super::lettering;
use super::picture::Picture;
use super::shown::Surface;
use super::styled::Leaves;
use super::swatch::{Part, Swatches};
use crate::scene::colour::{linear_from_srgb, srgb_from_linear};
use crate::scene::style::{Corner, Style};
use crate::space::{Camera, PixelRect};

/// The panel is at most this part of the picture's width and of its height.
const LARGEST_PART: u32 = 3;
/// Letters are this part of the picture's height where there is room…
const PREFERRED_PART: u32 = 40;
/// …and no smaller than this part of it for the sake of more rows.
const LEAST_PART: u32 = 64;
/// Nor smaller than this, in pixels, where any legend has room.
const EASY_SIZE: u32 = 9;
/// Smaller letters than this cannot be read.
const SMALLEST_SIZE: u32 = 6;
/// There is no room for a legend where not even so many letters have room.
const FEWEST_LETTERS: u32 = 4;
/// The frame's darkness between the panel and its letters.
const FRAME_SHARE: f32 = 0.35;

/// One leaf, or what stands for several.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    name: String,
    parts: Vec<Part>,
    /// How much of it shows.
    count: u64,
}

/// Pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Sizes {
    /// Of letters.
    letters: u32,
}

impl Sizes {
    /// From row to row.
    fn row(self) -> u32 {
        self.letters + self.letters.div_ceil(3)
    }

    /// Between the panel's border and what is in it, and around the panel.
    fn space(self) -> u32 {
        self.letters.div_ceil(2)
    }

    /// Width and height of a swatch.
    fn swatch(self) -> (u32, u32) {
        (self.letters + self.letters / 2, (self.letters * 5).div_ceil(6))
    }

    /// From the panel's border to the letters.
    fn before_text(self) -> u32 {
        2 * self.space() + self.swatch().0
    }

    /// Width and height of a panel with `rows` rows of `text` pixels.
    fn panel(self, text: u32, rows: usize) -> (u32, u32) {
        (self.before_text() + text + self.space(), 2 * self.space() + rows as u32 * self.row())
    }

    /// Rows and pixels of text that a panel of `room` has.
    fn within(self, room: (u32, u32)) -> (usize, u32) {
        let (empty_width, empty_height) = self.panel(0, 0);
        ((room.1.saturating_sub(empty_height) / self.row()) as usize, room.0.saturating_sub(empty_width))
    }
}

/// Rows that fit.
#[derive(Debug, Clone, PartialEq)]
struct Layout {
    sizes: Sizes,
    rows: Vec<Row>,
    /// Width and height of the panel.
    panel: (u32, u32),
}

/// The room for a panel.
fn room(width: u32, height: u32) -> (u32, u32) {
    (width / LARGEST_PART, height / LARGEST_PART)
}

/// Sizes of letters that are easy to read in a picture `height` pixels high, the preferred one first.
fn easy_sizes(height: u32) -> impl Iterator<Item = Sizes> {
    let least = (height / LEAST_PART).max(EASY_SIZE);
    (least..=(height / PREFERRED_PART).max(least)).rev().map(|letters| Sizes { letters })
}

/// The largest letters with which a row of a few of them has room.
fn readable_size(width: u32, height: u32) -> Option<Sizes> {
    let least = (height / LEAST_PART).max(EASY_SIZE);
    (SMALLEST_SIZE..=least).rev().map(|letters| Sizes { letters }).find(|sizes| {
        let (rows, text) = sizes.within(room(width, height));
        rows > 0 && text >= lettering::width("m", sizes.letters) * FEWEST_LETTERS
    })
}

/// Whether a picture of `width` by `height` pixels has room for a legend.
pub fn has_room(width: u32, height: u32) -> bool {
    readable_size(width, height).is_some()
}

/// `rows` as a picture of `width` by `height` pixels has room for them; `None` where it has none.
fn layout(rows: &[Row], width: u32, height: u32) -> Option<Layout> {
    let widest = |rows: &[Row], size: u32| rows.iter().map(|row| lettering::width(&row.name, size)).max().unwrap_or(0);
    for sizes in easy_sizes(height) {
        let (most, text) = sizes.within(room(width, height));
        let needed = widest(rows, sizes.letters);
        if rows.len() <= most && needed <= text {
            return Some(Layout { sizes, rows: rows.to_vec(), panel: sizes.panel(needed, rows.len()) });
        }
    }
    let sizes = readable_size(width, height)?;
    let (most, text) = sizes.within(room(width, height));
    let mut kept = rows.to_vec();
    if rows.len() > most {
        let named = most - 1;
        let mut by_count: Vec<usize> = (0..rows.len()).collect();
        by_count.sort_by_key(|&index| std::cmp::Reverse(rows[index].count));
        by_count.truncate(named);
        by_count.sort_unstable();
        kept = by_count.iter().map(|&index| rows[index].clone()).collect();
        let others = rows.len() - named;
        let name = if named > 0 { format!("and {others} more") } else { format!("{others} leaves") };
        kept.push(Row { name, parts: Vec::new(), count: 0 });
    }
    for row in &mut kept {
        shorten(&mut row.name, text, sizes.letters);
    }
    let panel = sizes.panel(widest(&kept, sizes.letters), kept.len());
    Some(Layout { sizes, rows: kept, panel })
}

/// Cuts `name` to what `width` pixels hold, an ellipsis among it where anything is cut.
fn shorten(name: &mut String, width: u32, size: u32) {
    if lettering::width(name, size) <= width {
        return;
    }
    while name.pop().is_some() {
        let cut = format!("{}…", name.trim_end());
        if lettering::width(&cut, size) <= width || name.is_empty() {
            *name = cut;
            return;
        }
    }
}

/// Draws the legend of the leaves whose `surfaces` show into a corner of `picture`, which `camera` sees. Its depths stay, and so
/// does what it counts as covered. Nothing is drawn where nothing shows, or where there is no room ([`has_room`]).
pub(super) fn draw(
    picture: &mut Picture,
    corner: Corner,
    surfaces: &[Surface],
    camera: &Camera,
    look: &Look,
    style: &Style,
    leaves: Leaves,
) {
    let rows = rows(surfaces, camera, look, style, leaves);
    let Some(layout) = layout(&rows, picture.width, picture.height).filter(|_| !rows.is_empty()) else { return };
    let ((width, height), space) = (layout.panel, layout.sizes.space());
    // The panel is a third of the picture at most, so there is room around it.
    let x0 = if corner.is_left() { space } else { picture.width - space - width };
    let y0 = if corner.is_top() { space } else { picture.height - space - height };
    let mut canvas = Canvas::new(picture, look.background);
    canvas.panel(PixelRect { x0, y0, x1: x0 + width, y1: y0 + height });
    for (number, row) in layout.rows.iter().enumerate() {
        let top = y0 + space + number as u32 * layout.sizes.row();
        let ((across, down), capital) = (layout.sizes.swatch(), lettering::capital_height(layout.sizes.letters));
        if !row.parts.is_empty() {
            let (x0, y0) = (x0 + space, top + (layout.sizes.row() - down) / 2);
            canvas.swatch(row, PixelRect { x0, y0, x1: x0 + across, y1: y0 + down }, layout.sizes.letters);
        }
        let baseline = top + (layout.sizes.row() + capital) / 2;
        canvas.text(&row.name, x0 + layout.sizes.before_text(), baseline, layout.sizes.letters);
    }
}

/// A row for each leaf, in the scene's order.
fn rows(surfaces: &[Surface], camera: &Camera, look: &Look, style: &Style, leaves: Leaves) -> Vec<Row> {
    let swatches = Swatches::new(camera, look, style, leaves);
    let mut rows: Vec<(u32, Row)> = Vec::new();
    for surface in surfaces {
        let part = swatches.part_of(surface);
        if rows.last().is_none_or(|(leaf, _)| *leaf != surface.leaf) {
            let unnamed = || format!("leaf {}", surface.leaf + 1);
            let name = leaves.names.get(surface.leaf as usize).cloned().unwrap_or_else(unnamed);
            rows.push((surface.leaf, Row { name: lettering::showable(&name), parts: Vec::new(), count: 0 }));
        }
        let Some((_, row)) = rows.last_mut() else { continue };
        row.count += surface.count;
        // A cutter has one colour for all that it cuts, or one for each.
        if !row.parts.iter().any(|other| other.looks_like(&part)) {
            row.parts.push(part);
        }
    }
    rows.into_iter().map(|(_, row)| row).collect()
}

/// The picture while a legend is drawn into it.
struct Canvas<'a> {
    picture: &'a mut Picture,
    /// Linear RGB of the panel.
    paper: [f32; 3],
    /// Linear RGB of letters.
    ink: [f32; 3],
}

impl<'a> Canvas<'a> {
    fn new(picture: &'a mut Picture, [r, g, b, alpha]: [f32; 4]) -> Self {
        let paper = if alpha > 0.0 { [r, g, b] } else { [1.0; 3] };
        // Whichever of black and white stands out more (WCAG 2's contrast of relative luminances).
        let luminance = 0.2126 * paper[0] + 0.7152 * paper[1] + 0.0722 * paper[2];
        let black_stands_out = (luminance + 0.05) / 0.05 >= 1.05 / (luminance + 0.05);
        Self { picture, paper, ink: if black_stands_out { [0.0; 3] } else { [1.0; 3] } }
    }

    /// Sets a pixel to `share` of the ink over `behind`, as eyes mix: letters look as heavy on dark paper as on light.
    fn mix(&self, behind: [f32; 3], share: f32) -> [f32; 3] {
        let mix = |behind: f32, ink: f32| {
            let (behind, ink) = (srgb_from_linear(behind.max(0.0)), srgb_from_linear(ink));
            linear_from_srgb(behind + share * (ink - behind))
        };
        std::array::from_fn(|c| mix(behind[c], self.ink[c]))
    }

    fn pixel(&mut self, x: u32, y: u32) -> Option<&mut [f32; 4]> {
        let index = (x < self.picture.width).then_some(y as usize * self.picture.width as usize + x as usize)?;
        self.picture.pixels.get_mut(index)
    }

    fn set(&mut self, x: u32, y: u32, [r, g, b]: [f32; 3]) {
        if let Some(pixel) = self.pixel(x, y) {
            *pixel = [r, g, b, 1.0];
        }
    }

    /// Paper with a thin frame.
    fn panel(&mut self, rect: PixelRect) {
        let frame = self.mix(self.paper, FRAME_SHARE);
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                let colour = if is_border(rect, x, y) { frame } else { self.paper };
                self.set(x, y, colour);
            }
        }
    }

    fn swatch(&mut self, row: &Row, rect: PixelRect, size: u32) {
        let frame = self.mix(self.paper, 0.5 + 0.5 * FRAME_SHARE);
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                let (column, line) = (x - rect.x0, y - rect.y0);
                let part = &row.parts[column as usize * row.parts.len() / rect.width() as usize];
                let inside = part.at(column as f32 + 0.5, line as f32 + 0.5, size as f32, self.paper);
                self.set(x, y, if is_border(rect, x, y) { frame } else { inside });
            }
        }
    }

    /// Letters from column `x` on, on the line `baseline`.
    fn text(&mut self, text: &str, x: u32, baseline: u32, size: u32) {
        lettering::draw(text, size, |right, down, share| {
            let (Some(x), Some(y)) = (x.checked_add_signed(right), baseline.checked_add_signed(down)) else { return };
            if let Some(&mut [r, g, b, _]) = self.pixel(x, y) {
                let mixed = self.mix([r, g, b], share);
                self.set(x, y, mixed);
            }
        });
    }
}

/// Whether a pixel of `rect` is one of its outermost.
fn is_border(rect: PixelRect, x: u32, y: u32) -> bool {
    x == rect.x0 || y == rect.y0 || x + 1 == rect.x1 || y + 1 == rect.y1
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::super::merge::Contents;
    use super::super::section::Hatching;
    use super::super::styled_with;
    use super::*;
    use crate::formats::depth_picture::DepthPicture;
    use crate::layers::{Boundary, Facing, LayerStack};
    use crate::scene::Light;
    use crate::scene::style::{CutColour, LineSettings, StyleKind};
    use crate::space::Lens;

    const WHITE: [f32; 4] = [1.0; 4];
    const CLEAR: [f32; 4] = [0.0; 4];
    const BONE: [f32; 3] = [0.8, 0.7, 0.4];
    const DRILL: [f32; 3] = [0.1, 0.3, 0.7];
    /// One step of an 8-bit picture.
    const STEP: f32 = 1.0 / 255.0;

    fn row(name: &str, count: u64) -> Row {
        Row { name: name.into(), parts: vec![Part { colour: BONE, opacity: 1.0, hatch: None }], count }
    }

    fn names(layout: &Layout) -> Vec<&str> {
        layout.rows.iter().map(|row| row.name.as_str()).collect()
    }

    /// Two surfaces that face the eye: leaf 0 in the left half, leaf 1, which cuts leaf 0, in the right.
    fn stack(width: u32, height: u32) -> LayerStack {
        let camera =
            Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, Lens::Height(2.0), width, height);
        LayerStack::from_fn(camera.unwrap(), 1, |x, _| {
            let (leaf, colour) = if x < width / 2 { (0, BONE) } else { (1, DRILL) };
            let facing = Facing::Front;
            vec![Boundary { depth: 4.0, normal: Vec3::NEG_Y, colour, opacity: 1.0, leaf, body: 0, facing, samples: 1 }]
        })
    }

    fn drawn(stack: &LayerStack, style: &Style, background: [f32; 4], contents: &Contents) -> Picture {
        let names = ["bone", "drill"].map(String::from);
        let leaves = Leaves { colours: &[BONE, DRILL], names: &names, ..Leaves::default() };
        let look = Look { light: Light::default(), background };
        styled_with(stack, &look, style, leaves, contents, None, &|| ())
    }

    fn is_near(a: [f32; 4], b: [f32; 4]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < STEP)
    }

    /// The panel's place where both leaves have a row.
    fn panel(width: u32, height: u32, corner: Corner) -> (PixelRect, Sizes) {
        let layout = layout(&[row("bone", 1), row("drill", 1)], width, height).unwrap();
        let ((across, down), space) = (layout.panel, layout.sizes.space());
        let x0 = if corner.is_left() { space } else { width - space - across };
        let y0 = if corner.is_top() { space } else { height - space - down };
        (PixelRect { x0, y0, x1: x0 + across, y1: y0 + down }, layout.sizes)
    }

    #[test]
    fn a_legend_is_never_larger_than_a_third_of_the_picture_nor_says_less_than_it_should() {
        let rows: Vec<Row> = (0..30).map(|i| row(&format!("leaf_with_a_long_name_{i}"), i)).collect();
        for (width, height) in [(1, 1), (64, 64), (100, 2000), (300, 200), (640, 480), (2000, 100), (4096, 4096)] {
            for count in [1, 2, 8, 30] {
                let Some(layout) = layout(&rows[..count], width, height) else {
                    assert!(!has_room(width, height));
                    continue;
                };
                assert!(has_room(width, height));
                assert!(3 * layout.panel.0 <= width && 3 * layout.panel.1 <= height, "{width}x{height}: {layout:?}");
                assert!(layout.sizes.letters >= SMALLEST_SIZE);
                let last = layout.rows.last().unwrap();
                let others = count + 1 - layout.rows.len();
                if layout.rows.len() == count && !last.parts.is_empty() {
                    continue;
                }
                let told = if layout.rows.len() > 1 { format!("and {others} more") } else { format!("{count} leaves") };
                assert!(
                    told == last.name || (last.name.ends_with('…') && told.starts_with(&last.name[..4])),
                    "{last:?}"
                );
            }
        }
        assert!(has_room(320, 240) && !has_room(40, 40));
    }

    #[test]
    fn letters_grow_with_the_picture_and_those_that_show_least_are_left_out() {
        let few = [row("bone", 5), row("drill", 9)];
        let size = |side: u32| layout(&few, side, side).unwrap().sizes.letters;
        assert_eq!([size(512), size(1024), size(2048)], [12, 25, 51]);
        let rows: Vec<Row> = (0..40).map(|i| row(&format!("l{i}"), (i * 17) % 40)).collect();
        let layout = layout(&rows, 512, 512).unwrap();
        let shown = names(&layout);
        let (last, named) = shown.split_last().unwrap();
        assert_eq!(*last, format!("and {} more", 40 - named.len()));
        // In the scene's order, and none that is left out shows more than one that is named.
        let kept: Vec<usize> = named.iter().map(|name| name[1..].parse().unwrap()).collect();
        assert!(kept.len() > 5 && kept.is_sorted(), "{kept:?}");
        let least = kept.iter().map(|&i| rows[i].count).min().unwrap();
        assert!((0..40).filter(|i| !kept.contains(i)).all(|i| rows[i].count < least));
        // A long name is cut where it can be seen.
        let long = [row(&"drill_guide_".repeat(9), 1)];
        let cut = super::layout(&long, 512, 512).unwrap();
        assert!(cut.rows[0].name.ends_with('…') && cut.rows[0].name.starts_with("drill_guide_"), "{cut:?}");
    }

    #[test]
    fn a_swatch_has_the_colour_of_its_leaf_in_the_picture() {
        let (width, height) = (300, 300);
        let stack = stack(width, height);
        let (rect, sizes) = panel(width, height, Corner::TopLeft);
        for (kind, cut_colour) in [
            (StyleKind::Shaded, CutColour::Cutter),
            (StyleKind::Transparent, CutColour::Cutter),
            (StyleKind::Transparent, CutColour::Leaf),
            (StyleKind::EdgeTransparent, CutColour::Set([0.9, 0.1, 0.1])),
            (StyleKind::Sketchy, CutColour::Cutter),
            (StyleKind::Blueprint, CutColour::Cutter),
            (StyleKind::Wireframe, CutColour::Cutter),
        ] {
            let style = Style { legend: Some(Corner::TopLeft), cut_colour, ..Style::of(kind) };
            for background in [WHITE, [0.02, 0.05, 0.1, 1.0]] {
                let picture = drawn(&stack, &style, background, &Contents::default());
                for (number, x) in [(0, width / 4), (1, 3 * width / 4)] {
                    let top = rect.y0 + sizes.space() + number * sizes.row() + sizes.row() / 2;
                    let swatch = picture.at(rect.x0 + sizes.space() + sizes.swatch().0 / 2, top);
                    let surface = picture.at(x, 4 * height / 5);
                    assert!(is_near(swatch, surface), "{kind:?} {number}: {swatch:?}, {surface:?}");
                }
            }
        }
    }

    #[test]
    fn nothing_changes_but_the_panel_in_any_style_and_corner() {
        let (width, height) = (301, 240);
        let stack = stack(width, height);
        let bead = DepthPicture {
            width,
            height,
            pixels: vec![[0.0, 0.3, 0.0, 0.5]; (width * height) as usize],
            depth: vec![3.0; (width * height) as usize],
        };
        for (kind, corner) in StyleKind::ALL.into_iter().zip(Corner::ALL.into_iter().cycle()) {
            for contents in [Contents::default(), Contents::new(vec![bead.clone()])] {
                let plain = Style::of(kind);
                let without = drawn(&stack, &plain, CLEAR, &contents);
                let with = drawn(&stack, &Style { legend: Some(corner), ..plain }, CLEAR, &contents);
                let (rect, _) = panel(width, height, corner);
                let is_inside = |x: u32, y: u32| (rect.x0..rect.x1).contains(&x) && (rect.y0..rect.y1).contains(&y);
                let mut inked = 0;
                for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                    if is_inside(x, y) {
                        assert_eq!(with.at(x, y)[3], 1.0);
                        inked += u32::from(with.at(x, y)[0] < 0.05);
                    } else {
                        assert_eq!(with.at(x, y), without.at(x, y), "{kind:?} {x}, {y}");
                    }
                }
                assert!(inked > 30, "{inked} dark pixels in the letters of {kind:?}");
                assert_eq!((with.depth, with.covered, with.has_alpha), (without.depth, without.covered, true));
            }
        }
    }

    #[test]
    fn letters_stand_out_from_any_paper() {
        let stack = stack(300, 300);
        let style = Style { legend: Some(Corner::default()), ..Style::default() };
        let luminance = |c: [f32; 4]| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2] + 0.05;
        let (rect, sizes) = panel(300, 300, Corner::default());
        for i in 0..=32 {
            let grey = (i as f32 / 32.0).powi(2);
            let picture = drawn(&stack, &style, [grey, grey, grey, 1.0], &Contents::default());
            let text = (rect.y0 + 1..rect.y1 - 1)
                .flat_map(|y| (rect.x0 + sizes.before_text()..rect.x1 - 1).map(move |x| (x, y)));
            let (low, high) = text.fold((f32::INFINITY, 0.0f32), |(low, high), (x, y)| {
                let l = luminance(picture.at(x, y));
                (low.min(l), high.max(l))
            });
            // WCAG 2's AA for text.
            assert!(high / low >= 4.5, "{} on {grey}", high / low);
        }
    }

    #[test]
    fn a_section_s_cap_is_hatched_in_its_swatch() {
        use crate::composite::section::SectionPlane;
        let (width, height) = (300, 300);
        let plane = SectionPlane { leaf: 1, point: DVec3::ZERO, normal: DVec3::NEG_Y, spacing: 0.1 };
        let hatching = Hatching::new(vec![plane], &[0], 1.0, [0.0; 3], vec![BONE, DRILL]);
        let names = ["bone", "cut"].map(String::from);
        let leaves = Leaves { names: &names, hatching: Some(&hatching), ..Leaves::default() };
        let look = Look { light: Light::default(), background: WHITE };
        let lines = LineSettings::default();
        let style = Style { legend: Some(Corner::TopLeft), lines, ..Style::default() };
        let picture = styled_with(&stack(width, height), &look, &style, leaves, &Contents::default(), None, &|| ());
        let (rect, sizes) = panel(width, height, Corner::TopLeft);
        let (across, down) = sizes.swatch();
        let swatch = |number: u32| {
            let (x0, y0) = (rect.x0 + sizes.space(), rect.y0 + sizes.space() + number * sizes.row());
            let y0 = y0 + (sizes.row() - down) / 2;
            (y0 + 1..y0 + down - 1).flat_map(move |y| (x0 + 1..x0 + across - 1).map(move |x| (x, y)))
        };
        let dark = |number: u32| swatch(number).filter(|&(x, y)| picture.at(x, y)[0] < 0.4).count();
        assert_eq!(dark(0), 0);
        assert!(dark(1) > 4 && dark(1) < swatch(1).count() / 2, "{} of {}", dark(1), swatch(1).count());
        // Between its lines a cap has the colour of what is cut.
        let bare = swatch(1).map(|(x, y)| picture.at(x, y)).max_by(|a, b| a[0].total_cmp(&b[0])).unwrap();
        assert!(is_near(bare, picture.at(width / 4, 4 * height / 5)), "{bare:?}");
        // Lines go the way that they go in the picture: dark pixels have dark neighbours on one diagonal.
        let slant = |places: &[(u32, u32)]| {
            let is_dark = |x: u32, y: u32| places.contains(&(x, y)) && picture.at(x, y)[0] < 0.4;
            let along = |dx: i32| {
                let next = |x: u32| x.checked_add_signed(dx).unwrap();
                places.iter().filter(|&&(x, y)| is_dark(x, y) && is_dark(next(x), y - 1)).count()
            };
            along(1) > along(-1)
        };
        let cap: Vec<_> = (200..230).flat_map(|y| (200..230).map(move |x| (x, y))).collect();
        assert_eq!(slant(&swatch(1).collect::<Vec<_>>()), slant(&cap));
    }
}
