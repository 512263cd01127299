//! The gateway: its cycle on a simulated machine, and the program as seen by its users.

mod agreement;
mod arming;
mod audit;
mod bench;
mod browser;
mod calls;
mod controlled;
mod cycle;
mod diagonals;
mod documents;
mod edge_paths;
mod edges;
mod effective;
mod faults;
mod first_hour;
mod five_axes;
#[cfg(feature = "fleet")]
mod fleet;
#[cfg(feature = "fleet")]
mod fleet_bench;
mod fleet_config;
#[cfg(feature = "fleet")]
mod fleet_faults;
#[cfg(feature = "fleet")]
mod fleet_partition;
#[cfg(feature = "fleet")]
mod fleet_whole;
#[cfg(feature = "fleet")]
mod fleet_whole_bench;
mod fuzz_corpus;
mod http;
mod hung_disk;
mod interop;
mod keys;
mod linuxcnc;
mod manual;
mod models;
mod online;
#[cfg(feature = "opc-ua-server")]
mod opc_ua;
mod paths;
mod process;
mod program;
mod rehearse;
mod reload;
#[cfg(feature = "sinumerik")]
mod send_map;
#[cfg(feature = "shdr")]
mod shdr;
mod shipped;
#[cfg(feature = "sinumerik")]
mod sinumerik;
mod standing;
mod texts;
mod two_mailboxes;
mod verbs;

/// Aborts the run on an allocation in a section that forbids it.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
mod wrong_configurations;
