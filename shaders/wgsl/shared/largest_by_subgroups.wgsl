// As `shared/largest`, where the adapter has subgroups: one atomic operation a subgroup. Maxima of integers and counts do not depend on the
// order, so that both give the same bits.

fn hand_on_largest(thread: u32, slot: u32, bits: u32) {
    let most = subgroupMax(bits);
    if subgroupBroadcastFirst(thread) == thread {
        atomicMax(&shared_block[slot], most);
    }
}

fn hand_on_count(thread: u32, slot: u32, count: u32) {
    let sum = subgroupAdd(count);
    if subgroupBroadcastFirst(thread) == thread {
        atomicAdd(&shared_block[slot], sum);
    }
}
