//! Counts heap allocations per thread, so that a process can show that its steady-state loop makes none; and keeps
//! the one block that iceoryx2 takes for every message it loans, so that loaning makes none either.

use core::cell::Cell;
use std::alloc::{GlobalAlloc, Layout, System};

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
    static TRANSPORT: Cell<u64> = const { Cell::new(0) };
    static IN_TRANSPORT: Cell<bool> = const { Cell::new(false) };
    static KEPT: Kept = const { Kept::new() };
}

/// Blocks kept per thread: more than messages are ever on loan at once.
const MOST_KEPT: usize = 32;
/// Larger blocks are not a loan's.
const LARGEST_KEPT: usize = 256;

/// Blocks of one layout, the first that a loan asked for, that wait for the next loan. iceoryx2 0.10 puts a reference
/// counter on the heap for every loan (`ChunkMutSharedState::new`), and its interface leaves no way around; here that
/// counter gets the block of an earlier one. A thread that ends leaves its few blocks to the process's end.
struct Kept {
    layout: Cell<Option<Layout>>,
    blocks: [Cell<*mut u8>; MOST_KEPT],
    count: Cell<usize>,
}

impl Kept {
    const fn new() -> Self {
        Self {
            layout: Cell::new(None),
            blocks: [const { Cell::new(core::ptr::null_mut()) }; MOST_KEPT],
            count: Cell::new(0),
        }
    }

    /// A kept block of this layout, for a loan.
    fn take(&self, layout: Layout) -> Option<*mut u8> {
        if self.layout.get().is_none() && layout.size() <= LARGEST_KEPT {
            self.layout.set(Some(layout));
        }
        let count = self.count.get();
        if count == 0 || self.layout.get() != Some(layout) {
            return None;
        }
        self.count.set(count - 1);
        Some(self.blocks[count - 1].get())
    }

    /// Keeps a block that is given back; false if it is to be freed.
    fn keep(&self, block: *mut u8, layout: Layout) -> bool {
        let count = self.count.get();
        if count == MOST_KEPT || self.layout.get() != Some(layout) {
            return false;
        }
        self.blocks[count].set(block);
        self.count.set(count + 1);
        true
    }
}

/// The system's allocator with a counter, and a few kept blocks, per thread. The `mirror` program and the processes'
/// tests install it:
///
/// ```
/// #[global_allocator]
/// static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;
/// # let before = runtime::alloc_count::allocations();
/// # let kept = vec![1, 2, 3];
/// # assert!(runtime::alloc_count::allocations() > before, "{kept:?}");
/// ```
pub struct CountingAllocator;

/// Allocations (and reallocations) that this thread made so far; stays 0 where [`CountingAllocator`] is not installed.
pub fn allocations() -> u64 {
    ALLOCATIONS.try_with(Cell::get).unwrap_or(0)
}

/// Those of [`allocations`] that iceoryx2 made while it loaned messages; with [`CountingAllocator`] installed there are
/// none once as many messages were on loan as ever are at the same time.
pub fn transport_allocations() -> u64 {
    TRANSPORT.try_with(Cell::get).unwrap_or(0)
}

/// Runs a call of iceoryx2's whose allocations are the transport's, not the process's.
pub(crate) fn in_transport<T>(call: impl FnOnce() -> T) -> T {
    let before = allocations();
    IN_TRANSPORT.with(|inside| inside.set(true));
    let result = call();
    IN_TRANSPORT.with(|inside| inside.set(false));
    let made = allocations() - before;
    let _ = TRANSPORT.try_with(|counter| counter.set(counter.get() + made));
    result
}

fn count() {
    // A thread that is ending has no counter any more; nobody asks for it either.
    let _ = ALLOCATIONS.try_with(|counter| counter.set(counter.get() + 1));
}

// SAFETY: every block comes from `System` with the layout that it is used and given back with, now or a loan later; the
// counters and the kept blocks are plain thread-local cells without destructors, so they neither allocate nor re-enter.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if IN_TRANSPORT.try_with(Cell::get).unwrap_or(false)
            && let Ok(Some(block)) = KEPT.try_with(|kept| kept.take(layout))
        {
            return block;
        }
        count();
        // SAFETY: the caller's promise, passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promise, passed on.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller's promise, passed on.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        if KEPT
            .try_with(|kept| kept.keep(pointer, layout))
            .unwrap_or(false)
        {
            return;
        }
        // SAFETY: the caller's promise, passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}
