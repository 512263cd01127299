#![no_main]
//! API files, compensation exports and reports of 5529 and 5530 lasers: no panic on any bytes, and an accepted file can
//! be evaluated and written as a table.

use libfuzzer_sys::fuzz_target;
use volcomp_metrology::{evaluate, parse_csv, parse_keysight_report, parse_pos, parse_ren, write_csv};

fuzz_target!(|bytes: &[u8]| {
    for parse in [parse_pos, parse_ren, parse_keysight_report] {
        if let Ok(measurement) = parse(bytes, "fuzz") {
            let _ = evaluate(&measurement);
            let again = parse_csv(write_csv(&measurement).as_bytes(), "fuzz");
            assert_eq!(again.map(|m| m.readings).ok(), Some(measurement.readings));
        }
    }
});
