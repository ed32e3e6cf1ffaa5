//! The adapter, its device, and what can go wrong with either.
//!
//! *Practice.* Every device is asked for with the limits that WebGPU promises everywhere, whatever the adapter could do: what
//! is too large for them is split by whoever draws it, so that the splitting is exercised on every machine. wgpu tells errors to
//! a handler, not to the caller; [`Gpu::checked`] runs work between scopes that catch them and returns the first.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::shader::Shader;

/// Why the GPU did not draw.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// No driver, or no adapter behind it.
    #[error(
        "no GPU was found: install a Vulkan driver (Mesa's lavapipe serves without a GPU), or draw with --backend cpu"
    )]
    NoAdapter,
    /// No adapter with this name.
    #[error("no GPU is called `{name}`; there {}", found_text(found))]
    NoSuchAdapter {
        /// What was asked for.
        name: String,
        /// What there is.
        found: Vec<String>,
    },
    /// The adapter cannot do what every WebGPU adapter must.
    #[error("the GPU `{adapter}` cannot be used: {what}")]
    Unusable {
        /// Its name.
        adapter: String,
        /// What is wrong.
        what: String,
    },
    /// The device went away.
    #[error("the GPU was lost while drawing: {0}")]
    Lost(String),
    /// Memory ran out.
    #[error("the GPU ran out of memory: {0}; draw a smaller picture, or with --backend cpu")]
    OutOfMemory(String),
    /// More is needed at once than the device takes: what can be drawn in parts is.
    #[error("{needed} {what} are needed at once, and the GPU takes {limit}")]
    TooLarge {
        /// What, in the plural and with its unit.
        what: String,
        /// How many.
        needed: u64,
        /// How many there can be.
        limit: u64,
    },
    /// A thread had more to do than the driver allows.
    #[error(
        "the GPU's driver ends loops before they are done: a pixel has too many surfaces for it; draw with --backend cpu"
    )]
    CutShort,
    /// The driver, or wgpu's checks, refused a command: a defect of surfcut or of the driver.
    #[error("the GPU refused a command: {0}")]
    Refused(String),
}

fn found_text(found: &[String]) -> String {
    match found {
        [] => "is none".to_owned(),
        [one] => format!("is only `{one}`"),
        several => format!("are {}", several.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")),
    }
}

/// An adapter, as `--list-gpus` tells of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdapterText {
    /// The name that `--gpu` takes, or any part of it.
    pub name: String,
    /// What it is: `discrete`, `integrated`, `virtual`, `software` or `other`.
    pub kind: &'static str,
    /// The interface it is driven by: `vulkan`, `metal` or `dx12`.
    pub interface: String,
    /// The driver and its version.
    pub driver: String,
}

/// What a device was told to do since the last look.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Render passes.
    pub passes: u64,
    /// Draw calls.
    pub draws: u64,
    /// Triangles in them; points and quads of other kinds are counted as what they are drawn with.
    pub triangles: u64,
    /// Compute dispatches.
    pub dispatches: u64,
    /// Bytes from the CPU to the GPU.
    pub uploaded: u64,
    /// Bytes from the GPU to the CPU.
    pub downloaded: u64,
}

/// Counters behind [`Work`].
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub passes: AtomicU64,
    pub draws: AtomicU64,
    pub triangles: AtomicU64,
    pub dispatches: AtomicU64,
    pub uploaded: AtomicU64,
    pub downloaded: AtomicU64,
}

/// A device, ready to draw; pipelines are made once and kept.
#[derive(Debug)]
pub struct Gpu {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) limits: wgpu::Limits,
    pub(super) counters: Counters,
    /// What the adapter is.
    text: AdapterText,
    lost: Arc<Mutex<Option<String>>>,
    modules: Mutex<HashMap<String, wgpu::ShaderModule>>,
    kernels: Mutex<HashMap<(String, &'static str), wgpu::ComputePipeline>>,
    renders: Mutex<HashMap<(String, String), wgpu::RenderPipeline>>,
    /// How long pipelines took to make, nanoseconds.
    compiling: AtomicU64,
}

/// All adapters that drivers offer, without duplicates of one behind several interfaces.
fn adapters() -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    // Neither validation layers nor debug information: both need more than a driver.
    descriptor.flags = wgpu::InstanceFlags::empty();
    let instance = wgpu::Instance::new(descriptor);
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    // Those that draw fast first.
    adapters.sort_by_key(|adapter| rank(adapter.get_info().device_type));
    adapters
}

fn rank(kind: wgpu::DeviceType) -> u32 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

fn text(info: &wgpu::AdapterInfo) -> AdapterText {
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => "discrete",
        wgpu::DeviceType::IntegratedGpu => "integrated",
        wgpu::DeviceType::VirtualGpu => "virtual",
        wgpu::DeviceType::Cpu => SOFTWARE,
        wgpu::DeviceType::Other => "other",
    };
    AdapterText {
        name: info.name.clone(),
        kind,
        interface: info.backend.to_str().to_owned(),
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
    }
}

/// The kind of an adapter that runs on the processor.
const SOFTWARE: &str = "software";

impl AdapterText {
    /// Whether it runs on the processor, where the CPU's own code is the faster.
    pub fn is_software(&self) -> bool {
        self.kind == SOFTWARE
    }
}

/// All adapters, fast ones first.
pub fn list() -> Vec<AdapterText> {
    adapters().iter().map(|adapter| text(&adapter.get_info())).collect()
}

impl Gpu {
    /// Opens the adapter whose name contains `name`, whatever the case of its letters, or the fastest.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`], [`GpuError::NoSuchAdapter`], [`GpuError::Unusable`].
    pub fn open(name: Option<&str>) -> Result<Self, GpuError> {
        let adapters = adapters();
        if adapters.is_empty() {
            return Err(GpuError::NoAdapter);
        }
        let is_meant = |adapter: &&wgpu::Adapter| {
            name.is_none_or(|name| adapter.get_info().name.to_lowercase().contains(&name.to_lowercase()))
        };
        let Some(adapter) = adapters.iter().find(is_meant) else {
            let found = adapters.iter().map(|adapter| adapter.get_info().name).collect();
            return Err(GpuError::NoSuchAdapter { name: name.unwrap_or_default().to_owned(), found });
        };
        Self::of(adapter)
    }

    /// Opens the fastest adapter that is hardware; `None` where there is none.
    ///
    /// # Errors
    /// [`GpuError::Unusable`].
    pub fn open_hardware() -> Result<Option<Self>, GpuError> {
        let adapters = adapters();
        let is_hardware = |adapter: &&wgpu::Adapter| !text(&adapter.get_info()).is_software();
        adapters.iter().find(is_hardware).map(Self::of).transpose()
    }

    fn of(adapter: &wgpu::Adapter) -> Result<Self, GpuError> {
        let text = text(&adapter.get_info());
        let unusable = |what: String| GpuError::Unusable { adapter: text.name.clone(), what };
        let limits = wgpu::Limits::defaults();
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("surfcut"),
            required_features: wgpu::Features::empty(),
            required_limits: limits.clone(),
            ..Default::default()
        };
        let opened = pollster::block_on(adapter.request_device(&descriptor));
        let (device, queue) = opened.map_err(|error| unusable(error.to_string()))?;
        let lost = Arc::new(Mutex::new(None));
        let tell = {
            let lost = Arc::clone(&lost);
            move |what: String| {
                lost.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(what);
            }
        };
        let tell_lost = tell.clone();
        device.set_device_lost_callback(move |_, message| tell_lost(message));
        // Whatever no scope caught would panic: it is kept, and the next check tells it.
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| tell(error.to_string())));
        Ok(Self {
            device,
            queue,
            limits,
            counters: Counters::default(),
            text,
            lost,
            modules: Mutex::default(),
            kernels: Mutex::default(),
            renders: Mutex::default(),
            compiling: AtomicU64::new(0),
        })
    }

    /// What the adapter is.
    pub fn adapter(&self) -> &AdapterText {
        &self.text
    }

    /// The most bytes that one binding of a buffer can have.
    pub fn largest_binding(&self) -> u64 {
        self.limits.max_storage_buffer_binding_size
    }

    /// What was done since the last call.
    pub fn take_work(&self) -> Work {
        let take = |counter: &AtomicU64| counter.swap(0, Ordering::Relaxed);
        Work {
            passes: take(&self.counters.passes),
            draws: take(&self.counters.draws),
            triangles: take(&self.counters.triangles),
            dispatches: take(&self.counters.dispatches),
            uploaded: take(&self.counters.uploaded),
            downloaded: take(&self.counters.downloaded),
        }
    }

    /// How long shaders took to compile so far.
    pub fn compile_time(&self) -> Duration {
        Duration::from_nanos(self.compiling.load(Ordering::Relaxed))
    }

    /// Lets the device go, as a driver that crashes does: what is drawn from here on fails with [`GpuError::Lost`].
    pub fn lose(&self) {
        self.device.destroy();
        self.lost.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert("the device was given up".to_owned());
    }

    /// Runs `work`, and returns the first error that the device had meanwhile.
    ///
    /// # Errors
    /// Those of `work`, [`GpuError::Lost`], [`GpuError::OutOfMemory`], [`GpuError::Refused`].
    pub fn checked<T>(&self, work: impl FnOnce() -> Result<T, GpuError>) -> Result<T, GpuError> {
        self.check_lost()?;
        let scopes = [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory]
            .map(|filter| self.device.push_error_scope(filter));
        // wgpu panics at a device that goes away while it waits for it.
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work))
            .unwrap_or_else(|_| Err(GpuError::Lost("the driver failed while it drew".to_owned())));
        let mut first = None;
        // The innermost scope first.
        for scope in scopes.into_iter().rev() {
            if let Some(error) = pollster::block_on(scope.pop()) {
                first.get_or_insert(match error {
                    wgpu::Error::OutOfMemory { source } => GpuError::OutOfMemory(source.to_string()),
                    wgpu::Error::Validation { description, .. } | wgpu::Error::Internal { description, .. } => {
                        GpuError::Refused(description)
                    }
                });
            }
        }
        // A lost device makes every later command fail: its loss is the cause.
        self.check_lost()?;
        match first {
            Some(error) => Err(error),
            None => result,
        }
    }

    /// # Errors
    /// [`GpuError::Lost`].
    fn check_lost(&self) -> Result<(), GpuError> {
        match &*self.lost.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(reason) => Err(GpuError::Lost(reason.clone())),
            None => Ok(()),
        }
    }

    /// Waits until the device has done everything it was told.
    ///
    /// # Errors
    /// [`GpuError::Lost`].
    pub fn wait(&self) -> Result<(), GpuError> {
        let done = self.device.poll(wgpu::PollType::wait_indefinitely());
        done.map_err(|error| GpuError::Lost(error.to_string()))?;
        self.check_lost()
    }

    fn module(&self, shader: &Shader) -> wgpu::ShaderModule {
        let mut modules = self.modules.lock().unwrap_or_else(PoisonError::into_inner);
        let module = modules.entry(shader.text.clone()).or_insert_with(|| {
            self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(shader.name),
                source: wgpu::ShaderSource::Wgsl(shader.text.as_str().into()),
            })
        });
        module.clone()
    }

    /// The compute pipeline of one entry point; its bindings are those that the entry point uses, in group 0.
    pub fn kernel(&self, shader: &Shader, entry: &'static str) -> wgpu::ComputePipeline {
        let key = (shader.text.clone(), entry);
        let mut kernels = self.kernels.lock().unwrap_or_else(PoisonError::into_inner);
        let make = || {
            self.timed(|| {
                self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                    label: Some(entry),
                    layout: None,
                    module: &self.module(shader),
                    entry_point: Some(entry),
                    compilation_options: Default::default(),
                    cache: None,
                })
            })
        };
        kernels.entry(key).or_insert_with(make).clone()
    }

    /// The render pipeline that `make` makes of the shader's module, kept under `name`.
    pub fn render(
        &self,
        shader: &Shader,
        name: &str,
        make: impl FnOnce(&wgpu::Device, &wgpu::ShaderModule) -> wgpu::RenderPipeline,
    ) -> wgpu::RenderPipeline {
        let key = (shader.text.clone(), name.to_owned());
        let mut renders = self.renders.lock().unwrap_or_else(PoisonError::into_inner);
        renders.entry(key).or_insert_with(|| self.timed(|| make(&self.device, &self.module(shader)))).clone()
    }

    fn timed<T>(&self, make: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let made = make();
        self.compiling.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
        made
    }
}
