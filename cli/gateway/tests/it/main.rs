//! The gateway: its cycle on a simulated machine, and the program as seen by its users.

mod arming;
mod audit;
mod bench;
mod browser;
mod check;
mod cycle;
mod diagonals;
mod edges;
mod first_hour;
#[cfg(feature = "fleet")]
mod fleet;
#[cfg(feature = "fleet")]
mod fleet_bench;
#[cfg(feature = "fleet")]
mod fleet_whole;
mod http;
mod interop;
mod keys;
mod linuxcnc;
mod manual;
mod models;
#[cfg(feature = "opc-ua-server")]
mod opc_ua;
mod process;
mod program;
mod rehearse;
mod reload;
#[cfg(feature = "sinumerik")]
mod send_map;
#[cfg(feature = "shdr")]
mod shdr;
#[cfg(feature = "sinumerik")]
mod sinumerik;
mod standing;
mod wrong_configurations;

/// Aborts the run on an allocation in a section that forbids it.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
