//! The CPU device's memory: one vector a field, empty where the plan doesn't ask for the field.

use crate::catalogue::Field;

/// All fields of a world.
#[derive(Clone, Debug)]
pub struct Fields {
    values: Vec<Vec<f32>>,
}

impl Fields {
    /// Allocates `planned`, `cells` values each, all 0.
    pub fn new(cells: usize, planned: &[Field]) -> Self {
        let mut values = vec![Vec::new(); Field::ALL.len()];
        for &field in planned {
            values[field as usize] = vec![0.0; cells];
        }
        Self { values }
    }

    /// The values, empty if not planned.
    pub fn get(&self, field: Field) -> &[f32] {
        &self.values[field as usize]
    }

    /// The values if planned.
    pub fn planned(&self, field: Field) -> Option<&[f32]> {
        let values = &self.values[field as usize];
        (!values.is_empty()).then_some(values.as_slice())
    }

    /// The values to change in place.
    pub fn get_mut(&mut self, field: Field) -> &mut [f32] {
        &mut self.values[field as usize]
    }

    /// Takes a field out to write it while others are read; [`Fields::put`] gives it back.
    pub fn take(&mut self, field: Field) -> Vec<f32> {
        std::mem::take(&mut self.values[field as usize])
    }

    /// Gives a taken field back.
    pub fn put(&mut self, field: Field, values: Vec<f32>) {
        self.values[field as usize] = values;
    }

    /// Exchanges two fields' memory.
    pub fn swap(&mut self, a: Field, b: Field) {
        self.values.swap(a as usize, b as usize);
    }
}
