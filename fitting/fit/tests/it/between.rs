//! What a curve does between targets that stand in irregular places, and the warnings of it.

use volcomp_fit::{Between, Fit, Method, Noise, fit_bspline, fit_polynomial};

use crate::gaps::{NOISE, irregular, missed, nearly_even};
use crate::{noisy, targets};

/// Of 60 sets the spline missed the truth by more than 30 µm in 6, and by 260 µm in one, with targets in places that chance takes.
#[test]
fn a_smoothing_spline_invents_nothing_in_gaps() {
    for (make, most) in [
        (irregular as fn(u64) -> (Vec<f64>, Vec<f64>), 25.0),
        (nearly_even, 12.0),
    ] {
        for index in 0..60 {
            let (x, u) = make(index);
            let fit = fit_bspline(&x, &u).expect("a spline");
            let miss = missed(&fit);
            assert!(miss < most, "{index}: {miss}");
            assert_eq!(Between::of(&fit, &x, &u, None).swings, None, "{index}");
        }
    }
}

fn between(fit: &Fit, x: &[f64], u: &[f64]) -> Between {
    let deviation = NOISE;
    let freedom = f64::INFINITY;
    Between::of(fit, x, u, Some(Noise { deviation, freedom }))
}

/// A polynomial through clustered targets swings in the gap, which is named.
#[test]
fn a_kind_that_swings_in_a_gap_is_warned_of() {
    let x = [
        0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 3000.0, 3100.0, 3200.0, 3300.0, 3400.0,
    ];
    let u: Vec<f64> = (0..12).map(|k| f64::from(k % 2)).collect();
    let fit = fit_polynomial(&x, &u, 9, [0.0, 3400.0]).expect("a polynomial");
    let found = between(&fit, &x, &u);
    assert_eq!(found.swings, Some([600.0, 3000.0]));
    let said = found.warnings("µm", "mm").join("\n");
    assert!(
        said.contains("between the targets 600 and 3000 mm"),
        "{said}"
    );
}

/// A wave of 1.3 gaps is missed by targets left out; what 21 targets show well is not warned of, nor is scatter.
#[test]
fn targets_that_are_too_sparse_are_warned_of() {
    let x = targets(21);
    let of = |length: f64, method: Method| {
        let u = noisy(&x, NOISE, 3, |x| {
            6.0 * (std::f64::consts::TAU * x / length).sin()
        });
        let fit = method.fit(&x, &u).expect("a curve");
        between(&fit, &x, &u)
    };
    let sparse = of(520.0, Method::CubicTable);
    assert!(sparse.is_too_sparse(), "{sparse:?}");
    let said = sparse.warnings("µm", "mm").join("\n");
    assert!(said.contains("the targets are too sparse"), "{said}");
    for (length, method) in [
        (8000.0, Method::CubicTable),
        (8000.0, Method::BSpline),
        (1e9, Method::LinearTable),
    ] {
        let found = of(length, method);
        assert_eq!(found.warnings("µm", "mm"), [""; 0], "{length} {method}");
    }
    let unknown = Between {
        repeatability: None,
        ..sparse
    };
    assert!(!unknown.is_too_sparse());
}
