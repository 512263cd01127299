use proptest::prelude::*;
use volcomp_vocabulary::{
    AxisKind, AxisName, Component, Coordinate, CorrectionLimit, Deg, Direction, Displacement,
    ErrorName, Mm, PerAxis, Rad, Um, Urad,
    bounds::{
        LARGEST_CORRECTION, LARGEST_CORRECTION_ROTARY, PLAUSIBLE_DEGC, is_plausible_error,
        is_plausible_reading, largest_correction,
    },
};

#[test]
fn every_error_name_is_read_as_it_is_written() {
    for component in Component::ALL {
        for axis in AxisName::ALL {
            for name in [ErrorName::motion(component, axis), ErrorName::location(component, axis)] {
                assert_eq!(name.to_string().parse(), Ok(name));
            }
        }
    }
}

#[test]
fn aliases_of_location_errors() {
    for (alias, name) in [
        ("EC(0X)Y", "EC0Y"),
        ("EB(0X)Z", "EB0Z"),
        ("EA(0Y)Z", "EA0Z"),
        ("C0Y", "EC0Y"),
        ("X0C", "EX0C"),
    ] {
        assert_eq!(alias.parse::<ErrorName>(), name.parse(), "{alias}");
    }
}

#[test]
fn texts_that_are_no_error_name_are_told() {
    for wrong in ["", "E", "EX", "EXQ", "EQX", "EX1X", "EC(0Y)X", "exx", "E0X", "µ0C", "EC0Y "] {
        let error = wrong.parse::<ErrorName>().expect_err(wrong);
        assert!(error.to_string().starts_with(&format!("`{wrong}`")));
    }
    let long = "a text that is much longer than any name of an error";
    let error = long.parse::<ErrorName>().expect_err("no name");
    assert!(long.starts_with(error.found.as_str()));
}

proptest! {
    #[test]
    fn any_text_is_read_or_refused_without_a_panic(text in ".{0,12}") {
        if let Ok(name) = text.parse::<ErrorName>() {
            prop_assert!(name.to_string().ends_with(name.axis.letter()));
        }
    }

    #[test]
    fn units_return_to_where_they_came_from(x in -1e6..1e6) {
        prop_assert!((Mm(x).to_um().to_mm().0 - x).abs() <= x.abs() * 1e-15);
        prop_assert!((Rad(x).to_urad().to_rad().0 - x).abs() <= x.abs() * 1e-15);
        prop_assert!((Rad(x).to_deg().to_rad().0 - x).abs() <= x.abs() * 1e-15);
        for kind in [AxisKind::Linear, AxisKind::Rotary] {
            let there = Displacement::from_micro(kind, x);
            prop_assert_eq!(there.kind(), kind);
            prop_assert!((there.um_or_urad() - x).abs() <= x.abs() * 1e-15);
        }
    }
}

#[test]
fn units_convert_by_what_they_are() {
    assert_eq!(Um(5.0).to_mm(), Mm(0.005));
    assert_eq!(Urad(5.0).to_rad(), Rad(5e-6));
    assert_eq!(Deg(180.0).to_rad(), Rad(core::f64::consts::PI));
    assert_eq!(Displacement::from_coordinate(AxisKind::Rotary, 90.0).mm_or_deg(), 90.0);
    assert_eq!(Displacement::from_coordinate(AxisKind::Linear, 90.0).mm_or_rad(), 90.0);
}

#[test]
fn quantities_are_written_with_their_unit() {
    assert_eq!(Um(2.5).to_string(), "2.5 µm");
    assert_eq!(format!("{:.1}", Deg(2.55)), "2.5 deg");
    assert_eq!(Displacement::from_micro(AxisKind::Linear, 0.1).to_string(), "0.1 µm");
    assert_eq!(Displacement::from_micro(AxisKind::Rotary, 17.0).to_string(), "17 µrad");
    assert_eq!(Displacement::new(AxisKind::Linear, f64::INFINITY).to_string(), "inf µm");
}

/// Coordinates are displayed in mm and deg: 250 mm, not 250000 µm, and 30 deg, not 29.999999999999996 deg.
#[test]
fn coordinates_are_written_in_mm_and_deg() {
    for (kind, number, text) in [
        (AxisKind::Linear, 250.0, "250 mm"),
        (AxisKind::Linear, -0.0005, "-0.0005 mm"),
        (AxisKind::Rotary, 30.0, "30 deg"),
    ] {
        let at = Displacement::from_coordinate(kind, number);
        assert_eq!(Coordinate(at).to_string(), text);
        assert!(text.ends_with(kind.coordinate_unit()));
        assert!(at.to_string().ends_with(kind.micro_symbol()));
    }
    for component in Component::ALL {
        assert_eq!(component.kind() == AxisKind::Rotary, component.is_angular());
    }
}

#[test]
fn directions() {
    for direction in Direction::BOTH {
        assert_eq!(direction.to_string().parse(), Ok(direction));
        assert_eq!(Direction::of(direction.sign()), Some(direction));
        assert_eq!((-direction).sign(), -direction.sign());
    }
    assert_eq!(Direction::of(0.0), None);
    assert_eq!(Direction::of(f64::NAN), None);
    assert!("up".parse::<Direction>().is_err());
}

#[test]
fn axes_are_read_by_their_letter() {
    for name in AxisName::ALL {
        assert_eq!(name.to_string().parse(), Ok(name));
        assert_eq!(AxisName::ALL[name.index()], name);
    }
    assert!("XY".parse::<AxisName>().is_err() && "x".parse::<AxisName>().is_err());
}

#[cfg(feature = "serde")]
#[test]
fn json_is_what_people_write() {
    let json = |value: serde_json::Value| value.to_string();
    let written = serde_json::json!({
        "axis": AxisName::C,
        "error": "EC0Y".parse::<ErrorName>().expect("a name"),
        "direction": Direction::Negative,
        "step": Um(0.5),
        "values": PerAxis::from_fn(|i| i),
    });
    assert_eq!(
        json(written),
        r#"{"axis":"C","error":"EC0Y","direction":"-","step":0.5,"values":[0,1,2,3,4,5,6,7,8]}"#
    );
    let read: PerAxis<f64> = serde_json::from_str("[1.0, 2.0]").expect("fewer are filled up");
    assert_eq!(read[1], 2.0);
    assert!(serde_json::from_str::<PerAxis<u8>>("[0,0,0,0,0,0,0,0,0,0]").is_err());
    assert!(serde_json::from_str::<ErrorName>("\"EQQ\"").is_err());
    for (displacement, text) in [
        (Displacement::Length(Mm(0.25)), r#"{"mm":0.25}"#),
        (Displacement::Angle(Rad(-0.5)), r#"{"rad":-0.5}"#),
    ] {
        assert_eq!(json(serde_json::json!(displacement)), text);
        let read: Displacement = serde_json::from_str(text).expect("it is what was written");
        assert_eq!(read, displacement, "{text}");
    }
    for text in ["{}", r#"{"um": 1.0}"#, r#"{"mm": 1.0, "rad": 1.0}"#, "1.0"] {
        assert!(serde_json::from_str::<Displacement>(text).is_err(), "{text}");
    }
}

#[test]
fn places_that_are_not_named_hold_the_default() {
    let mut values = PerAxis::ZERO;
    values[3] = 2.0;
    assert_eq!(values.iter().sum::<f64>(), 2.0);
    assert_eq!(values.map(|x| x > 0.0), PerAxis::from_fn(|i| i == 3));
}

#[test]
fn leading_values_are_followed_by_the_default() {
    let values = volcomp_vocabulary::PerChannel::leading([1.0, -2.0]);
    assert_eq!(values.0, [1.0, -2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
}

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
