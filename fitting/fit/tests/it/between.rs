//! What a curve does between targets that stand in irregular places, and the warnings of it.

use volcomp_fit::{Between, Method, fit_polynomial};

use crate::gaps::{KINDS, NOISE, between, irregular, missed};
use crate::{noisy, targets};

/// Of 500 sets and every kind, whatever misses the truth by more than 30 µm is warned of, whether the noise is known or not; of sets without an error
/// hardly one is.
#[test]
fn every_kind_that_is_wrong_in_a_gap_is_warned_of() {
    for (name, fit) in KINDS {
        for index in 0..500 {
            let (x, u) = irregular(index);
            // Moving least squares refuse a support that holds too few targets.
            let Ok(fit) = fit(&x, &u) else { continue };
            let (miss, found) = (missed(&fit), between(&fit, &x, &u));
            let unknown = Between::of(&fit, &x, &u, None);
            let is_warned = |of: Between| !of.warnings("µm", "mm").is_empty();
            assert!(
                miss < 30.0 || is_warned(found) && is_warned(unknown),
                "{name} {index}: {miss} {found:?}"
            );
        }
    }
    let warned = (0..500).filter(|index| {
        let (x, _) = irregular(*index);
        let u = noisy(&x, NOISE, *index, |_| 0.0);
        let fit = KINDS[6].1(&x, &u).expect("a curve");
        between(&fit, &x, &u).is_too_sparse()
    });
    assert!(warned.count() <= 5);
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
