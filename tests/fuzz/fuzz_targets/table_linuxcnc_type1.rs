#![no_main]
//! Compensation tables of the format linuxcnc-type1.

mod tables;

use libfuzzer_sys::fuzz_target;
use volcomp_tables::axis_table::Format;

fuzz_target!(|bytes: &[u8]| tables::keeps(Format::LinuxcncType1, bytes));
