//! The CPU device: threads over slabs of levels, SIMD along rows, no allocation in a tick.
//!
//! A slab is a fixed number of levels, whatever the number of threads, and each value is computed by the same operations in
//! the same order; so results are bit-identical for any number of threads.

mod device;
pub mod diagnose;
pub mod fields;
pub mod light;
pub mod math;
pub mod sim;
pub mod view;

pub use device::Cpu;
pub use fields::Fields;
