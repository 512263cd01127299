#![no_main]
//! Tables of readings: no panic on any bytes, and an accepted table is written and read back unchanged.

use libfuzzer_sys::fuzz_target;
use volcomp_metrology::{evaluate, parse_csv, write_csv};

fuzz_target!(|bytes: &[u8]| {
    if let Ok(measurement) = parse_csv(bytes, "fuzz") {
        let _ = evaluate(&measurement);
        let again = parse_csv(write_csv(&measurement).as_bytes(), "fuzz");
        assert_eq!(again.map(|m| m.readings).ok(), Some(measurement.readings));
    }
});
