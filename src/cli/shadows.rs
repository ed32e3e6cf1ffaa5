//! The shadow pass: the engine of the picture, looking from the light.

use std::cell::{Cell, RefCell};

use surfcut::composite::light_grid::LightGrid;
use surfcut::composite::light_map::LightMap;
use surfcut::composite::lighting::towards;
use surfcut::composite::shadow::Shadows;
#[cfg(feature = "gpu")]
use surfcut::gpu::{Gpu, GpuError, composite::shadow};
use surfcut::layers::LayerLimit;
use surfcut::output::report::{Report, Stopwatch, Times};
use surfcut::scene::framing::Bounds;
use surfcut::scene::style::Style;
use surfcut::scene::{Light, LoadedScene};
use surfcut::space::{Camera, Motion};

use super::Session;
#[cfg(feature = "gpu")]
use super::backend::BackendError;
use super::engine::{Engine, FrameArgs};
use super::render::is_transparent;

/// The shadows of the frames of one scene.
pub struct ShadowPass {
    light: Light,
    strength: f32,
    /// The style's factor of opacities.
    opacity: f32,
    frame: FrameArgs,
    /// Around what throws shadows.
    bounds: Bounds,
    /// What the light has been seen to see, while neither it nor any leaf moves.
    map: RefCell<Option<LightMap>>,
}

/// What one picture's shadows took.
#[derive(Debug, Clone, Copy, Default)]
pub struct ShadowCost {
    times: Times,
    /// Drawn from the light.
    texels: u64,
    /// Boundaries whose texels are larger than their pixel.
    coarse: u64,
}

impl ShadowPass {
    /// As `style` wants it; `None` where it shows no shadows. `loaded` has all its leaves at rest.
    pub fn of_scene(loaded: &LoadedScene, style: &Style) -> Option<Self> {
        let strength = style.shadow_strength()?;
        let opacity = style.opacity_factor();
        let limit = if opacity < 1.0 || is_transparent(loaded) { LayerLimit::All } else { LayerLimit::Nearest };
        Some(Self {
            light: loaded.scene.light,
            strength,
            opacity,
            frame: FrameArgs { samples: 1, limit, is_picture: false },
            bounds: loaded.drawn_within(|_| Motion::REST),
            map: RefCell::default(),
        })
    }

    /// Forgets what the light saw: leaves have moved, and are within `bounds` now.
    pub fn moved(&mut self, bounds: Bounds) {
        self.bounds = bounds;
        self.map = RefCell::default();
    }

    /// Forgets what the light saw: the next picture is to be drawn as if it were the first.
    pub fn forget(&self) {
        self.map.replace(None);
    }

    /// Calls `draw` with the shadows that `camera` sees.
    pub fn with<T>(
        &self,
        engine: &dyn Engine,
        camera: &Camera,
        draw: impl FnOnce(&Shadows) -> T,
    ) -> anyhow::Result<(T, ShadowCost)> {
        let grid = LightGrid::new(towards(&self.light, camera), &self.bounds);
        let mut map = self.map.borrow_mut();
        let map = match &mut *map {
            Some(known) if *known.grid() == grid => known,
            other => other.insert(LightMap::new(grid, self.opacity)),
        };
        let texels_before = map.texels();
        let failed = RefCell::new(None);
        let from_light =
            |light: &Camera| engine.frame_with(light, self.frame).map_err(|error| failed.replace(Some(error))).ok();
        let spent = Cell::new(Times::default());
        let watch = |work: &mut dyn FnMut()| {
            let watch = Stopwatch::start();
            work();
            spent.set(spent.get() + watch.times());
        };
        let shadows = Shadows::new(map, self.strength, &from_light, &watch);
        let drawn = draw(&shadows);
        let coarse = shadows.coarse();
        drop(shadows);
        if let Some(error) = failed.take() {
            return Err(error);
        }
        Ok((drawn, ShadowCost { times: spent.get(), texels: map.texels() - texels_before, coarse }))
    }
}

#[cfg(feature = "gpu")]
impl ShadowPass {
    /// Calls `draw` with the shadows that `camera` sees, drawn by `gpu`.
    pub fn with_gpu<T>(
        &self,
        gpu: &Gpu,
        engine: &dyn Engine,
        camera: &Camera,
        draw: impl FnOnce(&shadow::Shadows) -> Result<T, GpuError>,
    ) -> Result<(T, Option<ShadowCost>), BackendError> {
        let refused = RefCell::new(None);
        let from_light = |light: &Camera| match engine.gpu_frame_with(gpu, light, self.frame) {
            Ok(frame) => Ok(Some(frame)),
            Err(BackendError::Gpu(error)) => Err(error),
            Err(error) => {
                refused.replace(Some(error));
                Ok(None)
            }
        };
        let grid = LightGrid::new(towards(&self.light, camera), &self.bounds);
        let shadows = shadow::Shadows::new(grid, self.opacity, self.strength, &from_light);
        let drawn = draw(&shadows)?;
        let cost = ShadowCost { times: Times::default(), texels: shadows.texels(), coarse: shadows.coarse() };
        drop(shadows);
        match refused.take() {
            Some(error) => Err(error),
            None => Ok((drawn, Some(cost))),
        }
    }
}

impl ShadowCost {
    /// Adds it to `report`, as a phase of its own; returns what its time was.
    pub fn tell(&self, report: &mut Report) -> Times {
        report.add_phase("shadow", self.times);
        self.tell_counts(report);
        self.times
    }

    /// Adds all but its time to `report`.
    pub fn tell_counts(&self, report: &mut Report) {
        for (name, value) in [("shadow_texels", self.texels), ("shadow_coarse", self.coarse)] {
            let so_far = report.counts.get(name).copied().unwrap_or(0);
            report.count(name, so_far + value);
        }
    }
}

/// Warns where shadows are asked for in a style that lights nothing.
pub fn warn_of_shadows(style: &Style, session: &Session, report: &mut Report) {
    if style.shadows > 0.0 && !style.kind.is_lit() {
        let warning = format!("the style {} has no lit surfaces: it takes no shadows", style.kind.name());
        session.tell(&format!("warning: {warning}"));
        report.warnings.push(warning);
    }
}
