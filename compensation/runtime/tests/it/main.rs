//! The runtime on simulated machines, with clocks that the tests advance.

mod coupled;
mod exact;
mod held;
mod lag;
mod largest_move;
mod limited;
mod outside_travel;
mod paths;
mod plan;
mod rig;
mod silence;
mod thermal;
mod thread;
mod ways;

#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
