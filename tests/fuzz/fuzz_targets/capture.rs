#![no_main]
//! Dynamic captures: no panic on any bytes, and an accepted capture has finite samples.

use libfuzzer_sys::fuzz_target;
use volcomp_metrology::parse_rtx;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(capture) = parse_rtx(bytes, "fuzz") {
        assert!(!capture.samples.is_empty());
        assert!(capture.samples.iter().all(|sample| sample.is_finite()));
        let _ = capture.duration_s();
    }
});
