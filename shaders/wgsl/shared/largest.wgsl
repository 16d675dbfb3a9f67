// Largest values and counts of a workgroup, handed to `shared_block` of the stage that uses this: one atomic operation a thread.
// All threads of the workgroup call, `thread` being their number in it, those without a cell with 0. Twin: `shared/largest_by_subgroups`, which the same stages get where the adapter has subgroups.

fn hand_on_largest(thread: u32, slot: u32, bits: u32) {
    atomicMax(&shared_block[slot], bits);
}

fn hand_on_count(thread: u32, slot: u32, count: u32) {
    atomicAdd(&shared_block[slot], count);
}
