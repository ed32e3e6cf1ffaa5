//! Whose processor draws: `--backend`, `--gpu` and `--list-gpus`.
//!
//! *Practice.* Whatever goes wrong with a GPU that nobody insisted on is told in one line, and the CPU draws. A software adapter
//! (lavapipe) is not taken unless it is asked for: it runs on the same processor as the CPU's own code, which is the faster.

use surfcut::composite::{Leaves, Look, Picture};
#[cfg(feature = "gpu")]
use surfcut::gpu::composite::{shadow::Shadows, styled_with};
#[cfg(feature = "gpu")]
use surfcut::gpu::{Gpu, GpuError, GpuLayerSource};
use surfcut::layers::{LayerSource, LayerStack};
use surfcut::scene::style::Style;
use surfcut::space::Camera;

use super::Session;
use super::args::{Backend, BackendArgs};
use super::engine::Engine;
use super::shadows::{ShadowCost, ShadowPass};

/// A GPU that draws as far as it can.
pub struct Device<'s> {
    #[cfg(feature = "gpu")]
    pub gpu: Gpu,
    /// Whether the CPU may not stand in.
    #[cfg(feature = "gpu")]
    is_required: bool,
    #[cfg(feature = "gpu")]
    session: &'s Session,
    #[cfg(feature = "gpu")]
    has_fallen_back: std::cell::Cell<bool>,
    /// Without the feature there is none.
    #[cfg(not(feature = "gpu"))]
    never: (std::convert::Infallible, std::marker::PhantomData<&'s Session>),
}

/// Why the GPU does not draw.
#[derive(Debug, thiserror::Error)]
pub enum BackendError {
    /// It is not built in.
    #[cfg(not(feature = "gpu"))]
    #[error("this surfcut was built without the feature `gpu`: draw with --backend cpu, or build it with the feature")]
    NotBuilt,
    /// Something is not there for the GPU.
    #[cfg(feature = "gpu")]
    #[error("the GPU does not draw {0}: leave --backend gpu out, and the CPU draws it")]
    NotThere(String),
    /// The device failed.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

impl<'s> Device<'s> {
    /// The device that the flags ask for; `None` where the CPU draws.
    pub fn open(args: &BackendArgs, session: &'s Session) -> Result<Option<Self>, BackendError> {
        let is_required = args.backend == Backend::Gpu || args.gpu.is_some();
        if args.backend == Backend::Cpu {
            return Ok(None);
        }
        match Self::opened(args, is_required, session) {
            Ok(device) => Ok(device),
            Err(error) if is_required => Err(error),
            Err(error) => {
                session.tell(&format!("the CPU draws: {error}"));
                Ok(None)
            }
        }
    }

    #[cfg(feature = "gpu")]
    fn opened(args: &BackendArgs, is_required: bool, session: &'s Session) -> Result<Option<Self>, BackendError> {
        let gpu = if is_required {
            Gpu::open(args.gpu.as_deref())?
        } else {
            match Gpu::open_hardware()? {
                Some(gpu) => gpu,
                None => return Ok(None),
            }
        };
        Ok(Some(Self { gpu, is_required, session, has_fallen_back: std::cell::Cell::new(false) }))
    }

    #[cfg(not(feature = "gpu"))]
    fn opened(_: &BackendArgs, is_required: bool, _: &'s Session) -> Result<Option<Self>, BackendError> {
        if is_required { Err(BackendError::NotBuilt) } else { Ok(None) }
    }

    /// The name of the adapter.
    pub fn name(&self) -> String {
        #[cfg(feature = "gpu")]
        return self.gpu.adapter().name.clone();
        #[cfg(not(feature = "gpu"))]
        match self.never.0 {}
    }

    /// The layers of one frame, or `None` where the CPU is to draw it.
    pub fn layers(&self, engine: &dyn Engine, camera: &Camera) -> anyhow::Result<Option<LayerStack>> {
        #[cfg(feature = "gpu")]
        return self.drawn(engine, camera, &|frame| Ok(surfcut::gpu::layers::collect(&self.gpu, frame)?));
        #[cfg(not(feature = "gpu"))]
        match (self.never.0, engine, camera) {}
    }

    /// The picture of one frame, whose layers never leave the GPU; `None` where the CPU is to draw it.
    pub fn picture(
        &self,
        engine: &dyn Engine,
        camera: &Camera,
        look: &Look,
        style: &Style,
        leaves: Leaves,
        shadows: Option<&ShadowPass>,
    ) -> anyhow::Result<Option<(Picture, Option<ShadowCost>)>> {
        #[cfg(feature = "gpu")]
        {
            let gpu = &self.gpu;
            self.drawn(engine, camera, &|frame| {
                let styled = |shadows: Option<&Shadows>| styled_with(gpu, frame, look, style, leaves, shadows);
                match shadows {
                    Some(pass) => pass.with_gpu(gpu, engine, camera, |shadows| styled(Some(shadows))),
                    None => Ok((styled(None)?, None)),
                }
            })
        }
        #[cfg(not(feature = "gpu"))]
        match (self.never.0, engine, camera, look, style, leaves, shadows) {}
    }

    /// What `draw` makes of one frame; `None`, told once, where the CPU is to draw it.
    #[cfg(feature = "gpu")]
    fn drawn<T>(
        &self,
        engine: &dyn Engine,
        camera: &Camera,
        draw: &dyn Fn(&dyn GpuLayerSource) -> Result<T, BackendError>,
    ) -> anyhow::Result<Option<T>> {
        if self.has_fallen_back.get() {
            return Ok(None);
        }
        let mut refused = None;
        let drawn = self.gpu.checked(|| {
            match engine.gpu_frame(&self.gpu, camera) {
                Ok(frame) => draw(&*frame).map(Some),
                Err(error) => Err(error),
            }
            .or_else(|error| match error {
                BackendError::Gpu(error) => Err(error),
                error => {
                    refused = Some(error);
                    Ok(None)
                }
            })
        });
        let error = match (drawn, refused) {
            (Ok(drawn), None) => return Ok(drawn),
            (Ok(_), Some(error)) => error,
            (Err(error), _) => error.into(),
        };
        if self.is_required {
            return Err(error.into());
        }
        self.has_fallen_back.set(true);
        self.session.tell(&format!("the CPU draws: {error}"));
        Ok(None)
    }
}

/// Prints what adapters there are.
pub fn list(session: &Session) -> std::io::Result<()> {
    #[cfg(feature = "gpu")]
    {
        let adapters = surfcut::gpu::device::list();
        if adapters.is_empty() {
            return session.print("no GPU was found: pictures are drawn by the CPU\n");
        }
        let line = |adapter: &surfcut::gpu::device::AdapterText| {
            format!("{} ({}, {}, {})\n", adapter.name, adapter.kind, adapter.interface, adapter.driver)
        };
        session.print(&adapters.iter().map(line).collect::<String>())
    }
    #[cfg(not(feature = "gpu"))]
    session.print("this surfcut was built without the feature `gpu`: pictures are drawn by the CPU\n")
}

/// The source of one frame: the GPU's layers where a device draws, else the CPU's pipeline.
pub fn source<'e>(
    device: Option<&Device>,
    engine: &'e dyn Engine,
    camera: &Camera,
) -> anyhow::Result<Box<dyn LayerSource + 'e>> {
    if let Some(device) = device
        && let Some(stack) = device.layers(engine, camera)?
    {
        return Ok(Box::new(stack));
    }
    engine.frame(camera)
}
