//! The runtime on simulated machines whose time the tests count.

mod change_of_path;
mod coupled;
mod embed;
mod ends_of_travel;
mod errors;
mod fewer_axes;
mod fewer_axes_barrier;
mod held;
mod lag;
mod lags;
mod largest_move;
mod left;
mod left_out;
mod limited;
mod old_positions;
mod only_thermal;
mod order_of_axes;
mod outside_travel;
mod plan;
mod quiet;
mod raised_slew;
mod reads;
mod rig;
mod silence;
mod slow_ways;
mod standby;
mod thread;
mod ways;
mod written;

/// Ends the run on an allocation where one is forbidden.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
