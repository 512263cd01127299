use proptest::prelude::*;
use volcomp_modbus::iec60751::{RANGE_DEGC, ratio, temperature, two_wire};

#[test]
fn resistances_match_the_standard() {
    for (degc, ohm) in [
        (-200.0, 18.5201),
        (-100.0, 60.2558),
        (0.0, 100.0),
        (20.0, 107.7935),
        (50.0, 119.3971),
        (100.0, 138.5055),
        (200.0, 175.8560),
        (400.0, 247.0920),
        (850.0, 390.4811),
    ] {
        let found = 100.0 * ratio(degc).unwrap();
        assert!((found - ohm).abs() < 6e-5, "{degc}: {found}");
        // A change of 0.0001 Ω corresponds to 0.25 mK.
        let back = temperature(ohm / 100.0).unwrap();
        assert!((back - degc).abs() < 3e-4, "{ohm}: {back}");
    }
}

#[test]
fn values_outside_the_range_are_rejected() {
    for degc in [-200.1, 850.1, f64::NAN, f64::INFINITY] {
        assert_eq!(ratio(degc), None);
    }
    for broken in [0.0, 0.18, 3.91, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(temperature(broken), None);
    }
    let ends = RANGE_DEGC.map(|degc| temperature(ratio(degc).unwrap()));
    assert_eq!(ends, RANGE_DEGC.map(Some));
}

#[test]
fn lead_resistance() {
    // 0.1 Ω of lead resistance corresponds to 0.25 K.
    let off = two_wire(107.7935 + 0.1, 0.0, 100.0).unwrap() - 20.0;
    assert!((off - 0.257).abs() < 1e-3, "{off}");
    assert!((two_wire(107.7935 + 0.1, 0.1, 100.0).unwrap() - 20.0).abs() < 1e-3);
    assert!((two_wire(1077.935, 0.0, 1000.0).unwrap() - 20.0).abs() < 1e-3);
}

proptest! {
    #[test]
    fn temperatures_round_trip(degc in -200.0..850.0_f64) {
        let back = temperature(ratio(degc).unwrap()).unwrap();
        prop_assert!((back - degc).abs() < 1e-9, "{degc}: {back}");
    }

    #[test]
    fn resistance_increases_with_temperature(degc in -199.9..850.0_f64) {
        prop_assert!(ratio(degc).unwrap() > ratio(degc - 0.1).unwrap());
    }
}
