//! What a client needs to draw a world's pictures itself: the kernels of light and view with the layout of what they are told, and what a
//! world tells them.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The kernels that draw pictures (`GET /v1/shaders/view.json`), generated from what the server's own GPU device runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ViewShaders {
    /// WGSL modules by name, complete.
    pub modules: BTreeMap<String, ShaderModule>,
    /// Kernels by name.
    pub kernels: BTreeMap<String, ShaderKernel>,
    /// Structs that uniforms hold, by name.
    pub structs: BTreeMap<String, ShaderStruct>,
    /// Numbers that kernels and hosts share, by name.
    pub constants: BTreeMap<String, f64>,
}

/// A WGSL module.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShaderModule {
    /// Its text, with all that it uses.
    pub wgsl: String,
    /// What it binds, `@group(0)`, in order; every kernel of the module binds all of it.
    pub bindings: Vec<ShaderBinding>,
}

/// A binding of a module.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShaderBinding {
    /// Its name in the WGSL.
    pub name: String,
    /// Its `@binding`.
    pub binding: u32,
    /// How a buffer is bound there.
    pub kind: BindingKind,
    /// The struct of a uniform.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uniform: Option<String>,
}

/// How a buffer is bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BindingKind {
    /// `var<uniform>`.
    Uniform,
    /// `var<storage, read>`.
    Read,
    /// `var<storage, read_write>`.
    Write,
}

/// A kernel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShaderKernel {
    /// Its module.
    pub module: String,
    /// Its entry point.
    pub entry: String,
    /// Invocations of a workgroup along x, y, z.
    pub workgroup_size: [u32; 3],
    /// Whether few scenes want it, so that it is best compiled when one does.
    #[serde(default)]
    pub late: bool,
}

/// A struct as it lies in memory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShaderStruct {
    /// Bytes in all.
    pub size_bytes: u32,
    /// Its members in order.
    pub members: Vec<ShaderMember>,
}

/// A member of a struct.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShaderMember {
    /// Its name; those that begin with `unused_` fill space.
    pub name: String,
    /// Its type in WGSL.
    pub kind: String,
    /// Bytes from the struct's start.
    pub offset_bytes: u32,
    /// Bytes that it takes.
    pub size_bytes: u32,
}

/// What a world tells the kernels that is neither its cloud, nor the camera's, nor the sun's (`GET /v1/worlds/{id}/scenery`). It changes only
/// with the world's effects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scenery {
    /// Values of members of uniforms, by struct and member. Of `ViewFrame.detail_offset_m` the air's displacement is still to be taken away, modulo
    /// one over `detail_tiles_per_m`.
    pub uniforms: BTreeMap<String, BTreeMap<String, UniformValue>>,
    /// Why pictures of this world cannot be drawn by these kernels alone; absent where they can.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub server_draws: Option<String>,
    /// Where the stars are drawn; absent where the scene has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stars: Option<SceneryStars>,
}

/// Stars over a world; their table is at `GET /v1/worlds/{id}/stars.bin` and changes only with these numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SceneryStars {
    /// Degrees north: how high the pole stands.
    pub latitude_deg: f64,
    /// The faintest magnitude that is drawn.
    pub faintest_magnitude: f64,
    /// Years since 2000 that precession is taken for.
    pub years_since_2000: f64,
}

/// The value of a member.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum UniformValue {
    /// Of a number.
    Number(f64),
    /// Of a vector.
    Vector(Vec<f64>),
}
