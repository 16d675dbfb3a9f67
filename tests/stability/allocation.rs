//! A tick allocates nothing, on one thread and on two.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use welkin_proto::presets;
use welkin_server::world::World;

static COUNTING: AtomicBool = AtomicBool::new(false);
static BLOCKS: AtomicUsize = AtomicUsize::new(0);
static BYTES: AtomicUsize = AtomicUsize::new(0);

/// The system's allocator with a count, over all threads, of what it is asked for.
struct Counting;

impl Counting {
    fn count(&self, bytes: usize) {
        if COUNTING.load(Ordering::Relaxed) {
            BLOCKS.fetch_add(1, Ordering::Relaxed);
            BYTES.fetch_add(bytes, Ordering::Relaxed);
        }
    }
}

// SAFETY: every call is handed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        self.count(layout.size());
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        self.count(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        self.count(bytes);
        unsafe { System.realloc(at, layout, bytes) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Blocks and bytes that `work` asks for.
fn counted(work: impl FnOnce()) -> [usize; 2] {
    BLOCKS.store(0, Ordering::SeqCst);
    BYTES.store(0, Ordering::SeqCst);
    COUNTING.store(true, Ordering::SeqCst);
    work();
    COUNTING.store(false, Ordering::SeqCst);
    [BLOCKS.load(Ordering::SeqCst), BYTES.load(Ordering::SeqCst)]
}

// One test in this file: the count is the process's.
#[test]
fn a_tick_allocates_nothing() {
    for threads in [1, 2] {
        let mut scene = presets::find(presets::DEFAULT).expect("the default preset is there");
        scene.domain.cells = [20, 20, 75];
        let cells = 20 * 20 * 75;
        let mut world = World::new(scene, Some(threads)).expect("a world");
        // Ticks of one substep and of several; 60 simulated seconds are enough for a state to be kept.
        let some = |world: &mut World| {
            for length_s in [1.0, 20.0, 1.0, 60.0, 1.0, 1.0, 90.0, 1.0] {
                world.advance_by(length_s);
            }
        };
        some(&mut world);
        assert_eq!(world.watchdog().retries(), 0, "a retry writes its reason down");
        let within = world.on_threads(|world| counted(|| (0..10).for_each(|_| some(world))));
        assert_eq!(within, [0, 0], "blocks and bytes of 80 ticks on {threads} threads");

        // From outside the world's threads each tick is handed over through rayon's queue, which takes a block of 31 places now and then.
        let [blocks, _] = counted(|| (0..31).for_each(|_| some(&mut world)));
        println!("{threads} threads: {blocks} blocks for 248 ticks from outside");
        assert!(blocks <= 248 / 31 + 1, "{blocks} blocks for 248 ticks from outside");

        // A publication copies the cloud for its readers, and writes a few lines of text.
        let [blocks, bytes] = counted(|| drop(world.snapshot()));
        println!("{threads} threads: a snapshot takes {blocks} blocks, {bytes} bytes");
        assert!(
            blocks <= 6 && bytes <= 4 * cells + 1024,
            "a snapshot takes {blocks} blocks, {bytes} bytes"
        );
    }
}
