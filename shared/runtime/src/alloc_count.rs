//! Counts heap allocations per thread, so that a process can show that its steady-state loop makes none.

use core::cell::Cell;
use std::alloc::{GlobalAlloc, Layout, System};

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
    static TRANSPORT: Cell<u64> = const { Cell::new(0) };
}

/// The system's allocator with a counter per thread. The `mirror` program and the processes' tests install it:
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

/// Those of [`allocations`] that iceoryx2 made while it loaned messages: one for every loan, which its interface leaves
/// no way around (`ChunkMutSharedState::new`).
pub fn transport_allocations() -> u64 {
    TRANSPORT.try_with(Cell::get).unwrap_or(0)
}

/// Runs a call of iceoryx2's whose allocations are the transport's, not the process's.
pub(crate) fn in_transport<T>(call: impl FnOnce() -> T) -> T {
    let before = allocations();
    let result = call();
    let made = allocations() - before;
    let _ = TRANSPORT.try_with(|counter| counter.set(counter.get() + made));
    result
}

fn count() {
    // A thread that is ending has no counter any more; nobody asks for it either.
    let _ = ALLOCATIONS.try_with(|counter| counter.set(counter.get() + 1));
}

// SAFETY: everything is passed on to `System`; the counter is a plain thread-local cell without a destructor, so
// counting neither allocates nor re-enters.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
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
        // SAFETY: the caller's promise, passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}
