#![no_main]
//! Traces of circles: no panic on any bytes, and an accepted trace is finite and can be evaluated without a panic.

use libfuzzer_sys::fuzz_target;
use volcomp_metrology::circular::{CircularPlane, circular_deviations, circular_signatures, parse_trace};

fuzz_target!(|bytes: &[u8]| {
    for radius_mm in [None, Some(150.0)] {
        if let Ok(trace) = parse_trace(bytes, "fuzz", CircularPlane::Xy, radius_mm) {
            assert!(trace.points.iter().all(|point| point.deviation_um.is_finite()));
            let _ = circular_deviations(&trace);
            let _ = circular_signatures(&trace);
        }
    }
});
