//! Every stage of Welkin once: the catalogue, the constants, and the devices' kernels.
//!
//! No I/O, no environment, no clock: fields and parameters go in, fields and pixels come out.

pub mod catalogue;
pub mod constants;
pub mod cpu;
pub mod device;
pub mod gpu;
pub mod grid;
pub mod view;
pub mod volume;
pub mod wgsl;

pub use device::{CloudReductions, Device, Reductions, Substep, Vitals};
pub use grid::Grid;
pub use volume::CloudVolume;
