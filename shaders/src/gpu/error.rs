//! What can go wrong on a GPU. Each is a state that a person can act on.

/// An error of the GPU device.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// No adapter, or none of the name.
    #[error("no GPU adapter {wanted}; {}", if .found.is_empty() { "none was found".to_owned() } else { format!("found: {}", .found.join(", ")) })]
    NoAdapter {
        /// What was asked for.
        wanted: String,
        /// The names of those that are there.
        found: Vec<String>,
    },
    /// The adapter can't give what every stage needs.
    #[error("the adapter {adapter} is not enough: {why}")]
    Insufficient {
        /// Its name.
        adapter: String,
        /// What lacks.
        why: String,
    },
    /// A scene is too large for the adapter's limits.
    #[error("{what} needs {needed} bytes in one buffer; the adapter allows {allowed}")]
    TooLarge {
        /// What was to be allocated.
        what: String,
        /// Bytes.
        needed: u64,
        /// Bytes.
        allowed: u64,
    },
    /// Memory ran out.
    #[error("the GPU is out of memory ({what})")]
    OutOfMemory {
        /// What was to be allocated or run.
        what: String,
    },
    /// The scene chose a method that only the CPU device has.
    #[error("the pass {pass} has no shader: it runs on the CPU device alone")]
    NoShader {
        /// The pass.
        pass: &'static str,
    },
    /// A shader was refused.
    #[error("the shader {module} was refused: {message}")]
    Shader {
        /// The module.
        module: String,
        /// What the compiler says.
        message: String,
    },
    /// The device is gone: unplugged, reset, driver crashed.
    #[error("the GPU device was lost: {message}")]
    Lost {
        /// What the driver says.
        message: String,
    },
    /// Any other error that the driver reports.
    #[error("the GPU reports: {message}")]
    Other {
        /// What it says.
        message: String,
    },
}

impl GpuError {
    /// A stable code for the API.
    pub fn code(&self) -> &'static str {
        match self {
            GpuError::NoAdapter { .. } => "no_adapter",
            GpuError::Insufficient { .. } => "adapter_insufficient",
            GpuError::TooLarge { .. } => "device_limit",
            GpuError::NoShader { .. } => "method_needs_cpu",
            GpuError::OutOfMemory { .. } => "device_out_of_memory",
            GpuError::Shader { .. } => "shader_error",
            GpuError::Lost { .. } => "device_lost",
            GpuError::Other { .. } => "device_error",
        }
    }
}
