//! Tests of curves between irregularly spaced targets, and of the warnings about them.

use volcomp_fit::{Between, Method, fit_polynomial};

use crate::gaps::{KINDS, NOISE, Warned, between, even, irregular, nearly_even};
use crate::{noisy, targets};

/// Each curve that misses the truth by more than 30 µm gives a warning, with known and unknown noise. Of the correct
/// curves, at most one in ten gives a warning. The test uses the first 40 of the 500 sets of `examples/gaps.rs`, and
/// five sets on which kinds of curve fail that rarely fail.
#[test]
fn curves_that_miss_the_truth_in_a_gap_are_warned_of() {
    let sets = || (0..40).chain([131, 161, 198, 248, 413]);
    for kind in KINDS {
        let (name, _) = kind;
        let found = Warned::of(kind, irregular, sets());
        assert!(found.silent.is_empty(), "{name} {found:?}");
        // A smoothing B-spline never misses the truth by more than 30 µm.
        assert!(found.gross > 0 || name == "B-spline", "{name} {found:?}");
        if ["B-spline", "auto"].contains(&name) {
            assert!(10 * found.cried <= found.harmless, "{name} {found:?}");
        }
        for make in [even, nearly_even] {
            let found = Warned::of(kind, make, 0..40);
            assert!(found.silent.is_empty(), "{name} {found:?}");
            // A Chebyshev series through 21 targets has large leave-one-out errors and gives a warning more often.
            if !name.starts_with("Chebyshev") {
                assert!(20 * found.cried <= found.harmless, "{name} {found:?}");
            }
        }
    }
}

/// Of a hundred sets of readings that consist only of scatter, at most five give a warning.
#[test]
fn scatter_alone_is_not_warned_of() {
    let warned = (0..100).filter(|index| {
        let (x, _) = irregular(*index);
        let u = noisy(&x, NOISE, *index, |_| 0.0);
        KINDS.iter().any(|(name, fit)| {
            let is_stiff = !name.starts_with("Chebyshev") && *name != "moving least squares";
            let warnings = fit(&x, &u).map(|fit| between(&fit, &x, &u).warnings("µm", "mm"));
            is_stiff && warnings.is_ok_and(|warnings| !warnings.is_empty())
        })
    });
    assert!(warned.count() <= 5);
}

/// A polynomial through clustered targets oscillates in the gap between them; the warning names the gap.
#[test]
fn a_kind_that_swings_in_a_gap_is_warned_of() {
    let x = [0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 3000.0, 3100.0, 3200.0, 3300.0, 3400.0];
    let u: Vec<f64> = (0..12).map(|k| f64::from(k % 2)).collect();
    let fit = fit_polynomial(&x, &u, 9, [0.0, 3400.0]).expect("a polynomial");
    let found = between(&fit, &x, &u);
    assert_eq!(found.swings, Some([600.0, 3000.0]));
    let said = found.warnings("µm", "mm").join("\n");
    assert!(said.contains("between the targets 600 and 3000 mm"), "{said}");
}

/// Leave-one-out errors reveal a wave with a length of 1.3 gaps. Errors that 21 targets resolve and scatter give no
/// warning.
#[test]
fn targets_that_are_too_sparse_are_warned_of() {
    let x = targets(21);
    let of = |length: f64, method: Method| {
        let u = noisy(&x, NOISE, 3, |x| 6.0 * (std::f64::consts::TAU * x / length).sin());
        let fit = method.fit(&x, &u).expect("a curve");
        between(&fit, &x, &u)
    };
    let sparse = of(520.0, Method::CubicTable);
    assert!(sparse.is_too_sparse(), "{sparse:?}");
    let said = sparse.warnings("µm", "mm").join("\n");
    assert!(said.contains("the targets are too sparse"), "{said}");
    for (length, method) in
        [(8000.0, Method::CubicTable), (8000.0, Method::BSpline), (1e9, Method::LinearTable)]
    {
        let found = of(length, method);
        assert_eq!(found.warnings("µm", "mm"), [""; 0], "{length} {method}");
    }
    let unknown = Between { repeatability: None, ..sparse };
    assert!(!unknown.is_too_sparse());
}

/// A parabola fitted to waves with a length of five gaps gives a warning. A table through the waves and a parabola
/// fitted to a bend give none.
#[test]
fn a_curve_that_does_not_follow_its_readings_is_warned_of() {
    let x = targets(31);
    let length = 5.0 * (x[1] - x[0]);
    let wave = |x: f64| 20.0 * (std::f64::consts::TAU * x / length).sin();
    let bend = |x: f64| 1e-5 * x * x;
    let parabola = Method::Polynomial { order: 2 };
    let of = |truth: &dyn Fn(f64) -> f64, method: Method| {
        let u = noisy(&x, NOISE, 3, truth);
        between(&method.fit(&x, &u).expect("a curve"), &x, &u)
    };
    // A slope in addition to the waves does not hide them.
    let steep = |x: f64| wave(x) + 0.3 * x;
    assert!(of(&steep, parabola).is_not_followed());
    let found = of(&wave, parabola);
    let said = found.not_followed("µm").expect("a warning");
    assert!(said.contains("does not follow the readings"), "{said}");
    for (truth, method) in [(&wave as &dyn Fn(f64) -> f64, Method::CubicTable), (&bend, parabola)] {
        assert_eq!(of(truth, method).not_followed("µm"), None);
    }
}

/// With a single run the repeatability is unknown, and the warning compares the residuals with the scatter from target
/// to target.
#[test]
fn a_curve_that_does_not_follow_one_run_is_warned_of() {
    let x = targets(31);
    let wave = |gaps: f64| {
        let length = gaps * (x[1] - x[0]);
        move |x: f64| 20.0 * (std::f64::consts::TAU * x / length).sin()
    };
    let of = |truth: &dyn Fn(f64) -> f64, method: Method| {
        let u: Vec<f64> = x.iter().map(|&x| truth(x)).collect();
        let fit = method.fit(&x, &u).expect("a curve");
        Between::of(&fit, &x, &u, None).not_followed("µm")
    };
    let line = Method::Polynomial { order: 1 };
    let said = of(&wave(10.0), line).expect("a warning");
    assert!(said.contains("from target to target"), "{said}");
    assert_eq!(of(&wave(10.0), Method::CubicTable), None);
    assert_eq!(of(&|x| 0.03 * x - 0.1, line), None);
    assert_eq!(of(&|_| 5.3, line), None);
    // The deviation is an arch over few targets.
    for count in [4, 5, 6, 7] {
        let few = targets(count);
        let u: Vec<f64> = few.iter().map(|x| -1e-6 * x * (x - 8000.0)).collect();
        let fit = line.fit(&few, &u).expect("a line");
        assert!(Between::of(&fit, &few, &u, None).is_not_followed(), "{count}");
    }
    // Three runs have different zero offsets.
    let shifts = [-10.0, 0.0, 10.0];
    let u: Vec<f64> = (shifts.iter())
        .flat_map(|shift| x.iter().map(move |x| shift - 1e-6 * x * (x - 8000.0)))
        .collect();
    let of_runs = [&x[..]; 3].concat();
    let fit = line.fit(&of_runs, &u).expect("a line");
    assert!(between(&fit, &of_runs, &u).is_not_followed());
    // A wave with a length of three gaps looks like scatter.
    assert_eq!(of(&wave(3.0), line), None);
    let warned = (0..200).filter(|seed| {
        let u = noisy(&x, NOISE, *seed, |_| 0.0);
        let fit = line.fit(&x, &u).expect("a line");
        Between::of(&fit, &x, &u, None).is_not_followed()
    });
    assert!(warned.count() <= 1);
}
