//! The smoothing spline where targets stand in irregular places.

use volcomp_fit::fit_bspline;

use crate::gaps::{irregular, missed, nearly_even};

/// With cross-validation alone one of these curves leaves readings within some tens of µm by hundreds, between targets that are clustered.
#[test]
fn a_smoothing_spline_invents_nothing() {
    for (make, most) in [
        (irregular as fn(u64) -> (Vec<f64>, Vec<f64>), 25.0),
        (nearly_even, 12.0),
    ] {
        for index in 0..60 {
            let (x, u) = make(index);
            let miss = missed(&fit_bspline(&x, &u).expect("a spline"));
            assert!(miss < most, "{index}: {miss}");
        }
    }
}
