//! A compiled WGSL entry point.

use super::context::Context;
use super::error::GpuError;
use crate::wgsl;

/// How a stage binds a buffer. Binding n of a list is `@group(0) @binding(n)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bind {
    /// `var<uniform>`.
    Uniform,
    /// `var<storage, read>`.
    Read,
    /// `var<storage, read_write>`.
    Write,
}

/// A compiled entry point.
#[derive(Debug)]
pub struct Kernel {
    name: &'static str,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

impl Kernel {
    /// Compiles `entry` of the module `name`. Errors: `Shader` with the compiler's words; those of memory and loss.
    pub fn new(context: &Context, name: &'static str, entry: &str, binds: &[Bind]) -> Result<Self, GpuError> {
        let refused = |message: String| GpuError::Shader {
            module: format!("{name}:{entry}"),
            message,
        };
        let source =
            wgsl::source_for(name, context.subgroups).ok_or_else(|| refused("there is no such module".to_owned()))?;
        let entries: Vec<_> = binds
            .iter()
            .enumerate()
            .map(|(n, bind)| wgpu::BindGroupLayoutEntry {
                binding: n as u32,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer {
                    ty: match bind {
                        Bind::Uniform => wgpu::BufferBindingType::Uniform,
                        Bind::Read => wgpu::BufferBindingType::Storage { read_only: true },
                        Bind::Write => wgpu::BufferBindingType::Storage { read_only: false },
                    },
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            })
            .collect();
        let (pipeline, layout) = context
            .guarded(name, |device| {
                let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                    label: Some(name),
                    source: wgpu::ShaderSource::Wgsl(source.into()),
                });
                let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                    label: Some(name),
                    entries: &entries,
                });
                let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                    label: Some(name),
                    bind_group_layouts: &[Some(&layout)],
                    immediate_size: 0,
                });
                let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                    label: Some(name),
                    layout: Some(&pipeline_layout),
                    module: &module,
                    entry_point: Some(entry),
                    compilation_options: Default::default(),
                    cache: None,
                });
                (pipeline, layout)
            })
            .map_err(|error| match error {
                GpuError::Other { message } => refused(message),
                other => other,
            })?;
        Ok(Self { name, pipeline, layout })
    }

    /// Binds buffers in the order of the kernel's list.
    pub fn bind(&self, context: &Context, buffers: &[&wgpu::Buffer]) -> wgpu::BindGroup {
        let entries: Vec<_> = buffers
            .iter()
            .enumerate()
            .map(|(n, buffer)| wgpu::BindGroupEntry {
                binding: n as u32,
                resource: buffer.as_entire_binding(),
            })
            .collect();
        context.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.name),
            layout: &self.layout,
            entries: &entries,
        })
    }

    /// Records a dispatch of `groups` workgroups on a bound group.
    pub fn dispatch(&self, pass: &mut wgpu::ComputePass<'_>, bound: &wgpu::BindGroup, groups: [u32; 3]) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, bound, &[]);
        pass.dispatch_workgroups(groups[0], groups[1], groups[2]);
    }

    /// Binds and records in one go.
    pub fn record(
        &self,
        pass: &mut wgpu::ComputePass<'_>,
        context: &Context,
        buffers: &[&wgpu::Buffer],
        groups: [u32; 3],
    ) {
        let bound = self.bind(context, buffers);
        self.dispatch(pass, &bound, groups);
    }
}
