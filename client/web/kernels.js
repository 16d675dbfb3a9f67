// @ts-check
// The server's kernels of light and view, compiled for this computer's GPU. Their WGSL, the names of what they bind, and how their
// structs lie in memory all come from the server: nothing of that is written a second time here.

/** @import { ShaderKernel, ShaderStruct, ViewShaders } from "./types.js" */

import { request } from "./stream.js";

/** Invocations that a dispatch may have along one axis are bounded; no kernel of the view comes near with worlds that fit a buffer. */
const GROUPS_MAX = 65_535;

/** @returns {Promise<ViewShaders>} */
export async function loadShaders() {
  return await request("GET", "/v1/shaders/view.json");
}

/**
 * Packs values into a struct's bytes. Every member must be given, but those that only fill space; nothing else may be.
 * @param {string} name
 * @param {ShaderStruct} struct
 * @param {Record<string, number | boolean | ArrayLike<number>>} values
 */
export function pack(name, struct, values) {
  const bytes = new ArrayBuffer(struct.size_bytes);
  const view = new DataView(bytes);
  const left = new Set(Object.keys(values));
  for (const member of struct.members) {
    if (!left.delete(member.name)) {
      if (member.name.startsWith("unused_")) {
        continue;
      }
      throw new Error(`${name}.${member.name} is not given`);
    }
    const value = values[member.name];
    const parts = typeof value === "object" ? value : [Number(value)];
    for (let n = 0; n < parts.length; n++) {
      const at = member.offset_bytes + 4 * n;
      if (4 * (n + 1) > member.size_bytes) {
        throw new Error(`${name}.${member.name} has fewer numbers than ${parts.length}`);
      }
      if (member.kind.includes("f32")) {
        view.setFloat32(at, parts[n], true);
      } else {
        view.setUint32(at, parts[n], true);
      }
    }
  }
  if (left.size > 0) {
    throw new Error(`${name} has no ${[...left].join(", ")}`);
  }
  return bytes;
}

/** @typedef {{module: GPUShaderModule, layout: GPUPipelineLayout}} Module */

/** Compiled kernels, by the names that the server gives them. */
export class Kernels {
  /**
   * @param {GPUDevice} device
   * @param {ViewShaders} shaders
   */
  constructor(device, shaders) {
    this.device = device;
    this.shaders = shaders;
    /** @type {Map<string, GPUComputePipeline>} */
    this.pipelines = new Map();
    /** @type {Map<string, Promise<void>>} modules of late kernels, compiled or being compiled */
    this.late = new Map();
  }

  /**
   * Compiles all but those that few worlds want. Throws what the compiler says.
   * @param {GPUDevice} device
   * @param {ViewShaders} shaders
   */
  static async compile(device, shaders) {
    const kernels = new Kernels(device, shaders);
    await kernels.add((kernel) => !kernel.late);
    return kernels;
  }

  /**
   * Compiles a module's late kernels, once. Throws what the compiler says.
   * @param {string} module
   */
  async prepare(module) {
    const made = this.late.get(module) ?? this.add((kernel) => kernel.late === true && kernel.module === module);
    this.late.set(module, made);
    try {
      await made;
    } catch (error) {
      this.late.delete(module); // who asks again may have better luck
      throw error;
    }
  }

  /** @param {(kernel: ShaderKernel) => boolean} wanted */
  async add(wanted) {
    const { device, shaders } = this;
    /** @type {Map<string, Module>} */
    const modules = new Map();
    await Promise.all(
      Object.entries(shaders.kernels).map(async ([name, kernel]) => {
        if (!wanted(kernel)) {
          return;
        }
        const made = modules.get(kernel.module) ?? this.module(kernel.module);
        modules.set(kernel.module, made);
        const pipeline = await device.createComputePipelineAsync({
          label: name,
          layout: made.layout,
          compute: { module: made.module, entryPoint: kernel.entry },
        });
        this.pipelines.set(name, pipeline);
      }),
    );
  }

  /** @param {string} label @returns {Module} */
  module(label) {
    const { device, shaders } = this;
    const { wgsl, bindings } = shaders.modules[label];
    /** @type {Record<string, GPUBufferBindingType>} */
    const types = { uniform: "uniform", read: "read-only-storage", write: "storage" };
    const group = device.createBindGroupLayout({
      label,
      entries: bindings.map(({ binding, kind }) => ({
        binding,
        visibility: GPUShaderStage.COMPUTE,
        buffer: { type: types[kind] },
      })),
    });
    return {
      module: device.createShaderModule({ label, code: wgsl }),
      layout: device.createPipelineLayout({ label, bindGroupLayouts: [group] }),
    };
  }

  /**
   * A number that the kernels know.
   * @param {string} name
   */
  constant(name) {
    const value = this.shaders.constants[name];
    if (value === undefined) {
      throw new Error(`the server's kernels know no ${name}`);
    }
    return value;
  }

  /**
   * A uniform buffer with a struct's values.
   * @param {string} struct
   * @param {Record<string, number | boolean | ArrayLike<number>>} values
   */
  uniform(struct, values) {
    const bytes = pack(struct, this.shaders.structs[struct], values);
    const buffer = this.device.createBuffer({
      label: struct,
      size: bytes.byteLength,
      usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST,
    });
    this.device.queue.writeBuffer(buffer, 0, bytes);
    return buffer;
  }

  /**
   * Writes a struct's values over a uniform buffer.
   * @param {GPUBuffer} buffer
   * @param {string} struct
   * @param {Record<string, number | boolean | ArrayLike<number>>} values
   */
  write(buffer, struct, values) {
    this.device.queue.writeBuffer(buffer, 0, pack(struct, this.shaders.structs[struct], values));
  }

  /**
   * @param {string} kernel
   * @param {Record<string, GPUBuffer>} buffers by the names in the kernel's WGSL
   */
  bind(kernel, buffers) {
    const { module } = this.shaders.kernels[kernel];
    const entries = this.shaders.modules[module].bindings.map(({ name, binding }) => {
      const buffer = buffers[name];
      if (buffer === undefined) {
        throw new Error(`kernel ${kernel} is not given ${name}`);
      }
      return { binding, resource: { buffer } };
    });
    const pipeline = this.pipeline(kernel);
    return { pipeline, group: this.device.createBindGroup({ layout: pipeline.getBindGroupLayout(0), entries }) };
  }

  /** @param {string} kernel */
  pipeline(kernel) {
    const pipeline = this.pipelines.get(kernel);
    if (pipeline === undefined) {
      throw new Error(`there is no kernel ${kernel}, or it is not compiled`);
    }
    return pipeline;
  }

  /**
   * Records so many workgroups of a kernel.
   * @param {GPUComputePassEncoder} pass
   * @param {string} kernel
   * @param {Record<string, GPUBuffer>} buffers
   * @param {number[]} groups
   */
  dispatch(pass, kernel, buffers, groups) {
    this.record(pass, kernel, this.bind(kernel, buffers).group, groups);
  }

  /**
   * The same with buffers that are bound already, for this kernel or another of its module.
   * @param {GPUComputePassEncoder} pass
   * @param {string} kernel
   * @param {GPUBindGroup} bound
   * @param {number[]} groups
   */
  record(pass, kernel, bound, groups) {
    pass.setPipeline(this.pipeline(kernel));
    pass.setBindGroup(0, bound);
    const [x, y = 1, z = 1] = groups;
    pass.dispatchWorkgroups(x, y, z);
  }

  /**
   * The workgroups that cover so many invocations along each axis.
   * @param {string} kernel
   * @param {number[]} invocations
   */
  groups(kernel, invocations) {
    const size = this.shaders.kernels[kernel].workgroup_size;
    return invocations.map((n, axis) => {
      const groups = Math.ceil(n / size[axis]);
      if (groups > GROUPS_MAX) {
        throw new Error(`kernel ${kernel} would need ${groups} workgroups`);
      }
      return groups;
    });
  }
}
