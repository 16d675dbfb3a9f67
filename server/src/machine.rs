//! What worlds compute on: threads, and the device that was chosen when the program started.

use std::sync::{Arc, Mutex, PoisonError};

use welkin_proto::ApiError;
use welkin_shaders::Device;
use welkin_shaders::catalogue::Devices;
use welkin_shaders::cpu::Cpu;
use welkin_shaders::cpu::sim::Parameters;
use welkin_shaders::gpu::{AdapterChoice, Context, Gpu, GpuError, ViewStages, dispatches};

use crate::plan::Plan;

/// Threads and device, cheap to clone. `Some(threads)` and `None` (one a core) alone mean the CPU.
#[derive(Clone, Debug, Default)]
pub struct Machine {
    /// Worker threads; none takes one a core.
    pub threads: Option<usize>,
    /// The device.
    pub compute: Compute,
}

impl From<Option<usize>> for Machine {
    fn from(threads: Option<usize>) -> Self {
        Self {
            threads,
            compute: Compute::Cpu,
        }
    }
}

/// The device that was chosen. It is never changed while the program runs.
#[derive(Clone, Debug, Default)]
pub enum Compute {
    /// The CPU device.
    #[default]
    Cpu,
    /// A GPU, shared by all worlds.
    Gpu(Adapter),
}

/// An adapter, opened again where it was lost.
#[derive(Clone, Debug)]
pub struct Adapter {
    choice: AdapterChoice,
    open: Arc<Mutex<Arc<Context>>>,
    // The stages of pictures, compiled once for all worlds.
    stages: Arc<Mutex<Option<Arc<ViewStages>>>>,
}

impl Adapter {
    fn open(choice: AdapterChoice) -> Result<Self, GpuError> {
        let context = Context::open(&choice)?;
        Ok(Self {
            choice,
            open: Arc::new(Mutex::new(context)),
            stages: Arc::default(),
        })
    }

    /// The adapter as it is open now.
    pub fn context(&self) -> Arc<Context> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The stages of light and view, compiled for the adapter as it is open now. Errors: those of [`ViewStages::new`].
    pub fn view_stages(&self) -> Result<Arc<ViewStages>, GpuError> {
        let context = self.context();
        let mut kept = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        match &*kept {
            Some(stages) if Arc::ptr_eq(stages.context(), &context) => Ok(stages.clone()),
            _ => {
                let stages = Arc::new(ViewStages::new(context)?);
                *kept = Some(stages.clone());
                Ok(stages)
            }
        }
    }

    /// Opens the adapter again if `lost` is still the one that is open; worlds that come later find it open. Errors: those of
    /// [`Context::open`].
    pub fn reopen(&self, lost: &Arc<Context>) -> Result<Arc<Context>, GpuError> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if Arc::ptr_eq(&open, lost) || open.check().is_err() {
            *open = Context::open(&self.choice)?;
        }
        Ok(open.clone())
    }
}

/// A GPU's error as the API tells it. Codes: those of [`GpuError::code`].
pub fn gpu_failure(error: &GpuError) -> ApiError {
    ApiError::new(error.code(), error.to_string())
}

impl Compute {
    /// The device by its name on the command line: `auto` (a GPU that is not software, else the CPU), `cpu`, `gpu` (any adapter, real ones first) or
    /// a part of an adapter's name.
    ///
    /// Errors: `no_adapter`, `adapter_insufficient`; never for `auto` and `cpu`.
    pub fn choose(name: &str) -> Result<Self, ApiError> {
        let choice = match name {
            "cpu" => return Ok(Compute::Cpu),
            "auto" => {
                return Ok(match Adapter::open(AdapterChoice::Hardware) {
                    Ok(adapter) => Compute::Gpu(adapter),
                    Err(error) => {
                        tracing::info!(%error, "computing on the CPU device");
                        Compute::Cpu
                    }
                });
            }
            "gpu" => AdapterChoice::Any,
            name => AdapterChoice::Named(name.to_owned()),
        };
        let adapter = Adapter::open(choice).map_err(|error| gpu_failure(&error))?;
        Ok(Compute::Gpu(adapter))
    }

    /// The device's name, as worlds report it.
    pub fn name(&self) -> String {
        self.context().map_or_else(
            || "cpu".to_owned(),
            |context| {
                let report = &context.report;
                format!("gpu: {} ({}, {})", report.name, report.backend, report.driver)
            },
        )
    }

    /// The open adapter, for pictures; none on the CPU device.
    pub fn context(&self) -> Option<Arc<Context>> {
        match self {
            Compute::Cpu => None,
            Compute::Gpu(adapter) => Some(adapter.context()),
        }
    }

    /// Whether the device has every pass of a plan. Errors: `method_needs_cpu`.
    pub fn supports(&self, plan: &Plan) -> Result<(), ApiError> {
        let missing = match self {
            Compute::Cpu => None,
            Compute::Gpu(_) => {
                let pass = plan.passes.iter().find(|p| !dispatches::is_there(**p));
                let of_pictures = plan
                    .chosen
                    .choices
                    .iter()
                    .find(|c| matches!(c.rung.info().devices, Devices::CpuOnly(_)));
                pass.map(|p| p.info().name).or(of_pictures.map(|c| c.rung.info().name))
            }
        };
        missing.map_or(Ok(()), |pass| Err(gpu_failure(&GpuError::NoShader { pass })))
    }

    /// Opens the adapter again if it is lost. Errors: `no_adapter`, `adapter_insufficient`.
    pub fn reopen(&self) -> Result<(), ApiError> {
        if let Compute::Gpu(adapter) = self {
            let context = adapter.context();
            if context.check().is_err() {
                adapter.reopen(&context).map_err(|error| gpu_failure(&error))?;
            }
        }
        Ok(())
    }

    /// A device for a world of that plan.
    ///
    /// Errors: `method_needs_cpu` where the scene chose a method without a shader, `device_limit`, `device_out_of_memory`,
    /// `shader_error`, `device_lost`.
    pub fn device(&self, parameters: &Parameters, plan: &Plan) -> Result<Box<dyn Device>, ApiError> {
        Ok(match self {
            Compute::Cpu => Box::new(Cpu::new(parameters.clone(), &plan.fields)),
            Compute::Gpu(adapter) => {
                let gpu = Gpu::new(adapter.context(), parameters.clone(), &plan.fields, &plan.passes);
                Box::new(gpu.map_err(|error| gpu_failure(&error))?)
            }
        })
    }
}
