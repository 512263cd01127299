//! Tests of the bounds of plausible values at their edges.

use volcomp_vocabulary::{
    AxisKind, CorrectionLimit, Displacement,
    bounds::{
        LARGEST_CORRECTION, LARGEST_CORRECTION_ROTARY, PLAUSIBLE_DEGC, is_plausible_error,
        is_plausible_reading, largest_correction,
    },
};

#[test]
fn errors_are_plausible_up_to_two_millimetres_and_milliradians() {
    for (kind, most) in
        [(AxisKind::Linear, LARGEST_CORRECTION.0), (AxisKind::Rotary, LARGEST_CORRECTION_ROTARY.0)]
    {
        assert_eq!(largest_correction(kind), most);
        for (value, plausible) in [
            (0.0, true),
            (-most, true),
            // The relative error of a conversion from µm or µrad is accepted.
            (most * (1.0 + 1e-12), true),
            (most * 1.001, false),
            (f64::NAN, false),
            (f64::NEG_INFINITY, false),
        ] {
            let value = Displacement::new(kind, value);
            assert_eq!(is_plausible_error(value), plausible, "{value:?}");
        }
    }
}

#[test]
fn a_limit_is_one_number_for_both_kinds_of_axes() {
    let limit = CorrectionLimit::new(300.0).expect("a limit");
    for (kind, um_or_urad, allowed) in [
        (AxisKind::Linear, 300.0, true),
        (AxisKind::Linear, -300.1, false),
        (AxisKind::Rotary, -300.0, true),
        (AxisKind::Rotary, 300.1, false),
        (AxisKind::Linear, f64::NAN, false),
    ] {
        let correction = Displacement::from_micro(kind, um_or_urad);
        assert_eq!(limit.allows(correction), allowed, "{correction:?}");
    }
    assert_eq!(CorrectionLimit::default(), CorrectionLimit::new(250.0).expect("a limit"));
    assert_eq!(CorrectionLimit::LARGEST, CorrectionLimit::new(2000.0).expect("a limit"));
    let refused = CorrectionLimit::new(2000.1).expect_err("beyond the ceiling");
    assert_eq!(refused.to_string(), "found 2000.1, expected µm above 0, at most 2000");
}

/// Temperatures as 32-bit floats are plausible in the correct byte order, and in a wrong byte order in fewer than a
/// tenth of the cases.
#[test]
fn a_float_in_a_wrong_byte_order_is_no_reading() {
    let (mut wrong, mut all) = (0, 0);
    for tenths in -2000..8500 {
        let value = tenths as f32 / 10.0;
        assert!(is_plausible_reading(f64::from(value)), "{value}");
        assert!(PLAUSIBLE_DEGC.contains(&f64::from(value)), "{value}");
        let [a, b, c, d] = value.to_be_bytes();
        for swapped in [[b, a, d, c], [c, d, a, b], [d, c, b, a]] {
            let read = f64::from(f32::from_be_bytes(swapped));
            all += 1;
            wrong += u32::from(read.is_finite() && read != 0.0 && is_plausible_reading(read));
        }
    }
    assert!(wrong * 10 < all, "{wrong} of {all} look like readings");
    assert!(is_plausible_reading(0.0) && is_plausible_reading(-0.0));
    assert!(!is_plausible_reading(f64::NAN) && !is_plausible_reading(1e-9));
}
