//! An opened adapter: what all worlds and views on one GPU share.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::error::GpuError;
use super::kernel::{Bind, Kernel};

/// Storage buffers that a stage may bind: WebGPU's default.
pub const STORAGE_BUFFERS_MAX: u32 = 8;

/// Which adapter to open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AdapterChoice {
    /// The first real GPU, integrated or discrete; software adapters are passed over.
    Hardware,
    /// The first adapter of any kind, real GPUs before software.
    Any,
    /// The first adapter whose name contains this, upper and lower case alike.
    Named(String),
}

/// A short report on an adapter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterReport {
    /// Its name, as its driver gives it.
    pub name: String,
    /// The driver and its version.
    pub driver: String,
    /// Vulkan, Metal or Dx12.
    pub backend: String,
    /// Whether it computes on the processor, as lavapipe does.
    pub software: bool,
}

/// An opened adapter.
pub struct Context {
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// Who it is.
    pub report: AdapterReport,
    /// Whether passes can be timed.
    pub timestamps: bool,
    /// Whether reductions go by subgroups.
    pub subgroups: bool,
    trouble: Arc<Mutex<Option<GpuError>>>,
    kernels: Mutex<HashMap<(&'static str, &'static str), Arc<Kernel>>>,
}

impl std::fmt::Debug for Context {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Context").field("report", &self.report).finish()
    }
}

/// The value of a future that native wgpu has ready, or soon has.
pub(crate) fn wait<F: std::future::Future>(future: F) -> F::Output {
    pollster::block_on(future)
}

fn report(adapter: &wgpu::Adapter) -> AdapterReport {
    let info = adapter.get_info();
    AdapterReport {
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        backend: format!("{:?}", info.backend),
        software: info.device_type == wgpu::DeviceType::Cpu,
        name: info.name,
    }
}

fn adapters() -> Vec<(wgpu::Adapter, AdapterReport)> {
    let mut description = wgpu::InstanceDescriptor::new_without_display_handle();
    description.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(description);
    let mut found: Vec<_> = wait(instance.enumerate_adapters(wgpu::Backends::all()))
        .into_iter()
        .map(|adapter| {
            let report = report(&adapter);
            (adapter, report)
        })
        .collect();
    let rank = |adapter: &wgpu::Adapter| match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    };
    found.sort_by_key(|(adapter, _)| rank(adapter));
    found
}

impl Context {
    /// All adapters of this machine, best first.
    pub fn adapters() -> Vec<AdapterReport> {
        adapters().into_iter().map(|(_, report)| report).collect()
    }

    /// Opens an adapter with the limits that it has, WebGPU's defaults at least.
    ///
    /// Errors: `NoAdapter`, `Insufficient`.
    pub fn open(choice: &AdapterChoice) -> Result<Arc<Context>, GpuError> {
        Self::open_with(choice, wgpu::Features::all())
    }

    /// The same, of optional features only those in `wanted`: how an adapter is stood in for that has fewer.
    ///
    /// Errors: `NoAdapter`, `Insufficient`.
    pub fn open_with(choice: &AdapterChoice, wanted: wgpu::Features) -> Result<Arc<Context>, GpuError> {
        let found = adapters();
        let names = found.iter().map(|(_, r)| format!("\"{}\"", r.name)).collect();
        let fits = |report: &AdapterReport| match choice {
            AdapterChoice::Hardware => !report.software,
            AdapterChoice::Any => true,
            AdapterChoice::Named(name) => report.name.to_lowercase().contains(&name.to_lowercase()),
        };
        let Some((adapter, report)) = found.into_iter().find(|(_, report)| fits(report)) else {
            let wanted = match choice {
                AdapterChoice::Hardware => "that is not software".to_owned(),
                AdapterChoice::Any => "of any kind".to_owned(),
                AdapterChoice::Named(name) => format!("named \"{name}\""),
            };
            return Err(GpuError::NoAdapter { wanted, found: names });
        };
        let has = adapter.limits();
        let limits = wgpu::Limits {
            max_storage_buffer_binding_size: has.max_storage_buffer_binding_size,
            max_buffer_size: has.max_buffer_size,
            ..Default::default()
        };
        let timing = wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS;
        let offered = adapter.features() & wanted;
        let timestamps = offered.contains(timing);
        let subgroups = offered.contains(wgpu::Features::SUBGROUP);
        let mut features = wgpu::Features::empty();
        features.set(timing, timestamps);
        features.set(wgpu::Features::SUBGROUP, subgroups);
        let (device, queue) = wait(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("welkin"),
            required_features: features,
            required_limits: limits,
            ..Default::default()
        }))
        .map_err(|error| GpuError::Insufficient {
            adapter: report.name.clone(),
            why: error.to_string(),
        })?;
        let trouble = Arc::new(Mutex::new(None));
        let lost = trouble.clone();
        device.set_device_lost_callback(move |reason, message| {
            // Dropping the device reports as much; nobody is left to be told.
            set(
                &lost,
                GpuError::Lost {
                    message: format!("{reason:?} {message}"),
                },
            );
        });
        let other = trouble.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| set(&other, judged(error, "a pass"))));
        Ok(Arc::new(Context {
            device,
            queue,
            report,
            timestamps,
            subgroups,
            trouble,
            kernels: Mutex::default(),
        }))
    }

    /// The first thing that went wrong since the device was opened; a device in trouble stays so.
    pub fn check(&self) -> Result<(), GpuError> {
        lock(&self.trouble).clone().map_or(Ok(()), Err)
    }

    /// A module's entry point, compiled at the first call and shared by all who use this adapter. Errors: those of [`Kernel::new`].
    pub fn kernel(&self, module: &'static str, entry: &'static str, binds: &[Bind]) -> Result<Arc<Kernel>, GpuError> {
        if let Some(kernel) = lock(&self.kernels).get(&(module, entry)) {
            return Ok(kernel.clone());
        }
        // Compiled with the lock open: another world's kernels need not wait.
        let kernel = Arc::new(Kernel::new(self, module, entry, binds)?);
        Ok(lock(&self.kernels).entry((module, entry)).or_insert(kernel).clone())
    }

    /// Largest buffer that a stage can bind, bytes.
    pub fn binding_bytes_max(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_buffer_size.min(limits.max_storage_buffer_binding_size)
    }

    /// A buffer of `bytes` bytes, zeroed. Errors: `TooLarge`, `OutOfMemory`.
    pub fn buffer(&self, what: &str, bytes: u64, usage: wgpu::BufferUsages) -> Result<wgpu::Buffer, GpuError> {
        if bytes > self.binding_bytes_max() {
            return Err(GpuError::TooLarge {
                what: what.to_owned(),
                needed: bytes,
                allowed: self.binding_bytes_max(),
            });
        }
        self.guarded(what, |device| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(what),
                size: bytes.max(16).next_multiple_of(16),
                usage,
                mapped_at_creation: false,
            })
        })
    }

    /// A storage buffer that can be copied from and to. Errors: as [`Context::buffer`].
    pub fn storage(&self, what: &str, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
        use wgpu::BufferUsages as Usage;
        self.buffer(what, bytes, Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST)
    }

    /// A uniform buffer with these bytes. Errors: as [`Context::buffer`].
    pub fn uniform(&self, what: &str, bytes: &[u8]) -> Result<wgpu::Buffer, GpuError> {
        use wgpu::BufferUsages as Usage;
        let buffer = self.buffer(what, bytes.len() as u64, Usage::UNIFORM | Usage::COPY_DST)?;
        self.queue.write_buffer(&buffer, 0, bytes);
        Ok(buffer)
    }

    /// A storage buffer with these bytes, a multiple of 4. Errors: as [`Context::buffer`].
    pub fn storage_of(&self, what: &str, bytes: &[u8]) -> Result<wgpu::Buffer, GpuError> {
        let buffer = self.storage(what, bytes.len() as u64)?;
        self.queue.write_buffer(&buffer, 0, bytes);
        Ok(buffer)
    }

    /// Does something that may fail for memory or by a mistake, and says so.
    pub(crate) fn guarded<T>(&self, what: &str, make: impl FnOnce(&wgpu::Device) -> T) -> Result<T, GpuError> {
        self.check()?;
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let made = make(&self.device);
        let errors = [wait(validation.pop()), wait(memory.pop())];
        match errors.into_iter().flatten().next() {
            Some(error) => Err(judged(error, what)),
            None => Ok(made),
        }
    }

    /// Waits until all that was submitted is done, callbacks included. Errors: `Lost`, or what [`Context::check`] knows.
    pub fn wait(&self) -> Result<(), GpuError> {
        let polled = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        polled.map(|_| ()).map_err(|error| GpuError::Lost {
            message: error.to_string(),
        })
    }

    /// Reads a buffer's first `bytes` bytes, waiting for all that was submitted. Errors: those of [`Context::wait`].
    pub fn read(&self, buffer: &wgpu::Buffer, bytes: u64) -> Result<Vec<u8>, GpuError> {
        use wgpu::BufferUsages as Usage;
        let staging = self.buffer("readback", bytes, Usage::MAP_READ | Usage::COPY_DST)?;
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, bytes);
        self.queue.submit([encoder.finish()]);
        staging.map_async(wgpu::MapMode::Read, 0..bytes, |_| {});
        self.wait()?;
        let view = staging.get_mapped_range(0..bytes).map_err(|error| GpuError::Other {
            message: error.to_string(),
        })?;
        Ok(view.to_vec())
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn set(trouble: &Mutex<Option<GpuError>>, error: GpuError) {
    lock(trouble).get_or_insert(error);
}

fn judged(error: wgpu::Error, what: &str) -> GpuError {
    match error {
        wgpu::Error::OutOfMemory { .. } => GpuError::OutOfMemory { what: what.to_owned() },
        wgpu::Error::Validation { description, .. } | wgpu::Error::Internal { description, .. } => GpuError::Other {
            message: format!("{what}: {description}"),
        },
    }
}
