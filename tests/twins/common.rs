//! What twin tests share: an adapter, or a loud skip.

// Each test binary uses a part of it.
#![allow(dead_code)]

use std::sync::Arc;

use welkin_shaders::gpu::{AdapterChoice, Context};

/// Any adapter, software too. Without one the test is skipped loudly, or fails where `WELKIN_REQUIRE` names `gpu`.
pub fn adapter(test: &str) -> Option<Arc<Context>> {
    match Context::open(&AdapterChoice::Any) {
        Ok(context) => Some(context),
        Err(error) => {
            welkin_tests::skip(test, "gpu", error);
            None
        }
    }
}

/// The same adapter with all that it offers, and once more as one without subgroups.
pub fn with_and_without_subgroups(test: &str) -> Vec<Arc<Context>> {
    let Some(whole) = adapter(test) else { return Vec::new() };
    // Lavapipe has them: where CI's adapter is required, so are they.
    assert!(whole.subgroups || !whole.report.software, "{test}: no subgroups");
    let plain = Context::open_with(&AdapterChoice::Any, wgpu::Features::empty()).expect("the same adapter");
    assert!(!plain.subgroups);
    vec![whole, plain]
}

/// Numbers in [-1, 1) that look random, by seed and place; never 0.
pub fn noise(seed: u32, i: usize) -> f32 {
    let mut h = (i as u32).wrapping_mul(0x9e37_79b9) ^ seed.wrapping_mul(0x85eb_ca6b) ^ 0x5bd1_e995;
    h = (h ^ (h >> 15)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    ((h ^ (h >> 16)) | 1) as f32 / 2_147_483_648.0 - 1.0
}
