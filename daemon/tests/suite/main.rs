//! Tests of the public interface, in one program: each test program costs a link.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

mod command_line;
mod doctor;
mod journal;
mod manual;
mod service_manager;
mod solver_memory;

use cdcr_daemon::rt::sys::WatchedAllocator;

/// It watches only threads that ask for it.
#[global_allocator]
static ALLOCATOR: WatchedAllocator = WatchedAllocator;
