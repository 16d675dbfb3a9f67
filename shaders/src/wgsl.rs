//! What Rust and WGSL share: constants, structs and the modules made of them.
//!
//! A number or a struct is written once, in Rust; the WGSL text is generated from it. A module is a file under `wgsl/`, named without its ending
//! (`sim/project`), with the generated text before it. A file's first lines may be `//! use shared/NAME`: those modules come before it, each once.

use std::fmt::Write;

/// A number that WGSL is given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Literal {
    /// A 32-bit float.
    F32(f32),
    /// An unsigned integer.
    U32(u32),
    /// A signed integer.
    I32(i32),
}

/// A constant that WGSL is given, under the name that it has in Rust.
#[derive(Clone, Copy, Debug)]
pub struct Constant {
    /// Its name.
    pub name: &'static str,
    /// Its value.
    pub value: Literal,
}

/// A field of a struct that both sides know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Member {
    /// Its name.
    pub name: &'static str,
    /// Its type in WGSL.
    pub kind: &'static str,
    /// Bytes from the struct's start.
    pub offset: usize,
    /// Bytes that it takes.
    pub size: usize,
}

impl Member {
    /// The numbers that it holds in a struct's bytes: one, or those of its vectors in order.
    pub fn numbers(&self, bytes: &[u8]) -> Vec<f64> {
        let own = bytes.get(self.offset..self.offset + self.size).unwrap_or_default();
        let words = own.chunks_exact(4).map(|w| [w[0], w[1], w[2], w[3]]);
        match self.kind {
            kind if kind.contains("f32") => words.map(|w| f32::from_ne_bytes(w).into()).collect(),
            kind if kind.contains("i32") => words.map(|w| i32::from_ne_bytes(w).into()).collect(),
            _ => words.map(|w| u32::from_ne_bytes(w).into()).collect(),
        }
    }
}

/// A struct that both sides know.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    /// Its name.
    pub name: &'static str,
    /// Its fields in order.
    pub members: &'static [Member],
    /// Bytes in all.
    pub size: usize,
}

/// Types that mean the same in Rust and WGSL, byte for byte.
pub trait Shared {
    /// The name in WGSL.
    const WGSL: &'static str;
}
macro_rules! shared {
    ($($rust:ty = $wgsl:literal),* $(,)?) => { $(impl Shared for $rust { const WGSL: &'static str = $wgsl; })* };
}
shared!(
    f32 = "f32",
    u32 = "u32",
    i32 = "i32",
    [f32; 4] = "vec4<f32>",
    [u32; 4] = "vec4<u32>",
    [i32; 4] = "vec4<i32>",
    [[u32; 4]; 3] = "array<vec4<u32>, 3>",
    [[f32; 4]; 2] = "array<vec4<f32>, 2>",
    [[f32; 4]; 3] = "array<vec4<f32>, 3>",
    [[f32; 4]; 4] = "array<vec4<f32>, 4>",
    [[f32; 4]; 8] = "array<vec4<f32>, 8>",
    [[f32; 4]; 9] = "array<vec4<f32>, 9>",
    [[f32; 4]; 16] = "array<vec4<f32>, 16>",
);

/// Writes constants once for both sides: the Rust constants themselves and `WGSL`, the list of which WGSL is generated. Types: f32, f64
/// (f32 in WGSL), u32, usize (u32 in WGSL), i32.
#[macro_export]
macro_rules! constants {
    ($($(#[$doc:meta])* $vis:vis const $name:ident: $kind:ident = $value:expr;)*) => {
        $($(#[$doc])* $vis const $name: $kind = $value;)*
        /// The constants above as WGSL is given them.
        pub const WGSL: &[$crate::wgsl::Constant] = &[$($crate::wgsl::Constant {
            name: stringify!($name),
            value: $crate::literal!($kind $name),
        }),*];
    };
}

/// A constant's value for WGSL, by the name of its type.
#[macro_export]
macro_rules! literal {
    (f32 $name:ident) => {
        $crate::wgsl::Literal::F32($name)
    };
    (f64 $name:ident) => {
        $crate::wgsl::Literal::F32($name as f32)
    };
    (u32 $name:ident) => {
        $crate::wgsl::Literal::U32($name)
    };
    (usize $name:ident) => {
        $crate::wgsl::Literal::U32($name as u32)
    };
    (i32 $name:ident) => {
        $crate::wgsl::Literal::I32($name)
    };
}

/// Writes a struct once for both sides: the Rust struct, laid out as WGSL lays it out, and `LAYOUT`, of which the WGSL is generated. Field types:
/// those of [`Shared`]; fields of 16 bytes stand first or after a multiple of 16 bytes, and the whole is a multiple of 16 (a test checks it).
#[macro_export]
macro_rules! gpu_struct {
    ($(#[$doc:meta])* $vis:vis struct $name:ident { $($(#[$field_doc:meta])* $field_vis:vis $field:ident: $kind:ty,)* }) => {
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        $vis struct $name { $($(#[$field_doc])* $field_vis $field: $kind,)* }
        impl $name {
            /// Its bytes.
            pub fn bytes(&self) -> &[u8] {
                bytemuck::bytes_of(self)
            }
            /// The struct as WGSL sees it.
            pub const LAYOUT: $crate::wgsl::Layout = $crate::wgsl::Layout {
                name: stringify!($name),
                members: &[$($crate::wgsl::Member {
                    name: stringify!($field),
                    kind: <$kind as $crate::wgsl::Shared>::WGSL,
                    offset: std::mem::offset_of!($name, $field),
                    size: std::mem::size_of::<$kind>(),
                }),*],
                size: std::mem::size_of::<$name>(),
            };
        }
    };
}

/// A module: its file and what is generated before it.
#[derive(Debug)]
pub struct Module {
    /// Folder and name, such as `sim/project`.
    pub name: &'static str,
    /// The file's text.
    pub text: &'static str,
    /// Constants that it is given.
    pub constants: &'static [&'static [Constant]],
    /// Structs that it is given.
    pub structs: &'static [Layout],
}

impl Module {
    /// The modules that its first lines name.
    fn uses(&self) -> impl Iterator<Item = &'static str> {
        self.text
            .lines()
            .take_while(|line| line.starts_with("//!"))
            .filter_map(|line| line.strip_prefix("//! use "))
            .map(str::trim)
    }
}

/// Finds a module by name.
pub fn module(name: &str) -> Option<&'static Module> {
    crate::gpu::MODULES.iter().find(|m| m.name == name)
}

/// Modules that have another form where the adapter has subgroups: the same functions, the same results.
pub const BY_SUBGROUPS: &[(&str, &str)] = &[("shared/largest", "shared/largest_by_subgroups")];

/// A module and those that it uses, in the order in which they stand in its text; none if a name is unknown.
pub fn with_used(name: &str) -> Vec<&'static Module> {
    let mut order = Vec::new();
    collect(name, false, &mut order).map_or(Vec::new(), |()| order)
}

/// The whole text of a module: what it uses, the generated constants and structs, and the file itself. None if a name is unknown.
pub fn source(name: &str) -> Option<String> {
    source_for(name, false)
}

/// The same for an adapter with or without `subgroups`.
pub fn source_for(name: &str, subgroups: bool) -> Option<String> {
    let mut order = Vec::new();
    collect(name, subgroups, &mut order)?;
    let mut text = String::new();
    let mut constants: Vec<&str> = Vec::new();
    let mut structs: Vec<&str> = Vec::new();
    for module in order {
        for constant in module.constants.iter().copied().flatten() {
            if !constants.contains(&constant.name) {
                constants.push(constant.name);
                write_constant(&mut text, constant);
            }
        }
        for layout in module.structs {
            if !structs.contains(&layout.name) {
                structs.push(layout.name);
                write_struct(&mut text, layout);
            }
        }
        let _ = writeln!(text, "// {}", module.name); // writing to a string cannot fail
        text.push_str(module.text);
        text.push('\n');
    }
    Some(text)
}

fn collect(name: &str, subgroups: bool, order: &mut Vec<&'static Module>) -> Option<()> {
    let other = BY_SUBGROUPS.iter().find(|(plain, _)| subgroups && *plain == name);
    let module = module(other.map_or(name, |(_, other)| other))?;
    if order.iter().any(|m| m.name == module.name) {
        return Some(());
    }
    for used in module.uses() {
        collect(used, subgroups, order)?;
    }
    order.push(module);
    Some(())
}

fn write_constant(text: &mut String, constant: &Constant) {
    let name = constant.name;
    let _ = match constant.value {
        Literal::F32(v) => writeln!(text, "const {name}: f32 = {v:?};"),
        Literal::U32(v) => writeln!(text, "const {name}: u32 = {v}u;"),
        Literal::I32(v) => writeln!(text, "const {name}: i32 = {v};"),
    };
}

fn write_struct(text: &mut String, layout: &Layout) {
    let _ = writeln!(text, "struct {} {{", layout.name);
    for member in layout.members {
        let _ = writeln!(text, "    {}: {},", member.name, member.kind);
    }
    let _ = writeln!(text, "}}");
}
