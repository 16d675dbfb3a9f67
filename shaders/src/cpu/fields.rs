//! The CPU device's memory: one vector a field, empty where the plan doesn't ask for the field.

use rayon::prelude::*;

use crate::catalogue::Field;

/// All fields of a world.
#[derive(Clone, Debug)]
pub struct Fields {
    values: Vec<Vec<f32>>,
    /// Kept states, each one vector a field of the state.
    slots: Vec<Vec<Vec<f32>>>,
}

/// Values that a thread copies at a time: large enough to be worth waking it, small enough for two threads to share a small field.
const COPY_LEN: usize = 1 << 14;

fn copy(from: &[f32], to: &mut [f32]) {
    to.par_chunks_mut(COPY_LEN)
        .zip(from.par_chunks(COPY_LEN))
        .for_each(|(to, from)| to.copy_from_slice(from));
}

impl Fields {
    /// Allocates `planned`, `cells` values each, all 0.
    pub fn new(cells: usize, planned: &[Field]) -> Self {
        let mut values = vec![Vec::new(); Field::ALL.len()];
        for &field in planned {
            values[field as usize] = vec![0.0; cells];
        }
        Self {
            values,
            slots: Vec::new(),
        }
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

    /// Copies the state to `slot`, which is made if it is not there.
    pub fn save(&mut self, slot: usize) {
        while self.slots.len() <= slot {
            self.slots.push(vec![Vec::new(); Field::STATE.len()]);
        }
        for (field, kept) in Field::STATE.into_iter().zip(&mut self.slots[slot]) {
            let values = &self.values[field as usize];
            kept.resize(values.len(), 0.0);
            copy(values, kept);
        }
    }

    /// Exchanges what the last substep started from with what `slot` keeps; nothing where nothing was saved there.
    pub fn exchange_start(&mut self, slot: usize) {
        let Some(slot) = self.slots.get_mut(slot) else { return };
        for (field, kept) in Field::STATE.into_iter().zip(slot) {
            // A method of one stage has no use for `Start*`: what was the state is then in the memory of `Next*`.
            let from = [field.start(), field.next()]
                .into_iter()
                .flatten()
                .find(|f| !self.values[*f as usize].is_empty());
            match from {
                Some(from) => std::mem::swap(&mut self.values[from as usize], kept),
                // Nothing steps this field, so it is now what it was at the start.
                None => copy(&self.values[field as usize], kept),
            }
        }
    }

    /// Makes what `slot` keeps the state again; `false` where nothing was saved.
    pub fn restore(&mut self, slot: usize) -> bool {
        let Some(slot) = self.slots.get(slot).filter(|s| !s.is_empty()) else {
            return false;
        };
        for (field, kept) in Field::STATE.into_iter().zip(slot) {
            copy(kept, &mut self.values[field as usize]);
        }
        true
    }

    /// Bytes that the slots hold.
    pub fn saved_bytes(&self) -> usize {
        4 * self.slots.iter().flatten().map(Vec::len).sum::<usize>()
    }
}
