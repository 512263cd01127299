//! No call with absurd arguments panics: it returns a value or an error.

use std::collections::BTreeMap;

use proptest::prelude::*;
use volcomp_curve::{Curve, ErrorCurve, Field, Grid};
use volcomp_kinematics::{CorrectionOptions, Form, State};
use volcomp_model::{
    Component, Drift, ErrorName, ErrorRefusal, Expansion, Fading, Machine, MapGrid, ModelError,
    Temperatures, Thermal, ThermalRefusal, ThermalState, Tolerance, corrected, diagonals,
    quantised, write_curve,
};
use volcomp_vocabulary::{AxisName, PerAxis};

use crate::EXAMPLE;

fn machine() -> Machine {
    Machine::parse(EXAMPLE, "m").unwrap()
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        -1e4..1e4_f64,
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY),
        Just(f64::MAX),
        Just(f64::MIN_POSITIVE),
        Just(0.0),
    ]
}

fn axis() -> impl Strategy<Value = AxisName> {
    prop::sample::select(&AxisName::ALL[..])
}

fn error_name() -> impl Strategy<Value = ErrorName> {
    (prop::sample::select(&Component::ALL[..]), axis(), any::<bool>())
        .prop_map(|(component, axis, location)| ErrorName { component, axis, location })
}

fn thermal() -> impl Strategy<Value = Thermal> {
    let name = "[a-z]{0,2}";
    let expansion = (error_name(), name, number(), number()).prop_map(
        |(error, sensor, um_per_m_k, fixed_mm)| Expansion { error, sensor, um_per_m_k, fixed_mm },
    );
    let drift =
        (error_name(), prop::collection::btree_map(name, number(), 0..3), number(), number())
            .prop_map(|(error, sensors, per_k, lag_s)| Drift { error, sensors, per_k, lag_s });
    (number(), prop::collection::vec(expansion, 0..3), prop::collection::vec(drift, 0..3)).prop_map(
        |(reference_degc, expansion, drift)| Thermal {
            reference_degc,
            expansion,
            drift,
            ..Thermal::default()
        },
    )
}

/// A coordinate far beyond any machine is rejected with the name of its axis; an accepted coordinate gives finite
/// errors and corrections.
#[test]
fn huge_coordinates_are_refused_or_have_numbers_for_answers() {
    let machine = machine();
    let steady = Temperatures::new();
    let options = CorrectionOptions::default();
    for axis in machine.axes() {
        for huge in [1e300, -1e300, f64::MAX, 1.1e9, f64::NAN] {
            let refused = machine.state(&[(axis.name, huge)]);
            assert!(
                matches!(refused, Err(ModelError::Coordinate { axis: named, .. }) if named == axis.name)
            );
        }
        for large in [1e9, -1e9] {
            let state = machine.state(&[(axis.name, large)]).unwrap();
            let error = machine.error_at(&state, Form::Exact, &steady);
            assert!(error.position_mm.iter().all(|mm| mm.is_finite()));
            let found = machine.correction_at(&state, &steady, &options);
            assert!(found.delta.iter().all(|delta| delta.is_finite()));
        }
    }
    let index = machine.index_of(AxisName::X).unwrap();
    let mut state = State::default();
    state.q[index] = 1e300;
    let found = machine.correction_at(&state, &steady, &options);
    assert!(!found.converged || found.delta.iter().all(|delta| delta.is_finite()));
    let twice = machine.state(&[(AxisName::X, 1.0), (AxisName::Y, 2.0), (AxisName::X, 1.0)]);
    assert!(matches!(twice, Err(ModelError::AxisTwice { axis: AxisName::X })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_state_is_answered(
        q in prop::array::uniform9(number()), name in axis(), coordinate in number(),
        degc in number(), mm in number(), rad in number(), points in 0_usize..4,
    ) {
        let machine = machine();
        let state = State { q: PerAxis(q), ..State::default() };
        let temperatures = Temperatures::from([("scale_x".to_owned(), degc), ("bed".to_owned(), degc)]);
        for form in [Form::Exact, Form::Htm, Form::Twist] {
            let _ = machine.error_at(&state, form, &temperatures);
        }
        let found = machine.correction_at(&state, &temperatures, &CorrectionOptions::default());
        let _ = corrected(&state, &found.delta);
        let _ = quantised(&machine, &found.delta, mm, rad);
        let _ = machine.outside_range(&state);
        let _ = machine.outside_travel(&state);
        let _ = machine.curve_coordinates(&state);
        let _ = machine.assembly(usize::MAX);
        let stated = machine.state(&[(name, coordinate)]);
        prop_assert_eq!(stated.is_ok(), coordinate.abs() <= 1e9 && machine.axis(name).is_some());
        prop_assert!(diagonals(&machine, &machine.source(&temperatures), points, &[], |_| state).is_ok());
    }

    /// After any change, an accepted machine can be written, read again, compiled and evaluated.
    #[test]
    fn any_change_is_taken_whole_or_refused(
        name in error_name(), value in number(), reversal in number(), thermal in thermal(),
        six in prop::array::uniform6(number()), at in axis(), text in ".{0,8}",
        correct in prop::collection::vec(axis(), 0..4), steps in prop::array::uniform4(number()),
        hold_s in number(), fade_s in number(),
    ) {
        let mut machine = machine();
        machine.name.clone_from(&text);
        let mean = Field::Curve(Curve::Constant(value));
        let _ = machine.set_error(name, ErrorCurve::Reversal { mean, reversal });
        let _ = machine.set_location(name, value);
        let _ = machine.set_assembly(at, six);
        let _ = machine.set_thermal(thermal);
        let _ = machine.set_correct(Some(&correct));
        let _ = machine.select_tool(&text);
        let again = Machine::parse(&machine.to_toml(), "again");
        prop_assert_eq!(again.map_err(|e| e.to_string()), Ok(machine.clone()));
        let compiled = machine.compile(Tolerance::from_nm(50.0));
        if let Ok(mut thermal) = ThermalState::new(&machine, Fading { hold_s, fade_s }) {
            let degc = [Some(steps[1]), None, Some(steps[2])];
            thermal.step(steps[0], &degc);
            thermal.step(steps[3], &[]);
            let _ = thermal.is_degraded();
            if let Ok(mut compiled) = compiled {
                thermal.apply(&mut compiled);
                let _ = compiled.evaluate(&State::default());
            }
        }
    }

    #[test]
    fn any_grid_over_the_travels_is_made_or_refused(
        counts in prop::array::uniform3(prop_oneof![0..5_usize, any::<usize>()]), index in any::<usize>(),
    ) {
        let machine = machine();
        match MapGrid::over_travels(&machine, counts, &[]) {
            Ok(grid) => {
                let _ = (grid.len(), grid.is_empty(), grid.node(&machine, index));
            }
            Err(error) => prop_assert!(matches!(error, ModelError::TooMany { .. }), "{}", error),
        }
    }
}

#[test]
fn what_is_refused_says_why() {
    let mut machine = machine();
    let exx: ErrorName = "EXX".parse().unwrap();
    let refused = |found: Result<(), ModelError>| match found {
        Err(ModelError::Refused { reason, .. }) => reason,
        other => panic!("{other:?}"),
    };
    assert_eq!(
        refused(machine.set_error(exx, Curve::Constant(f64::NAN).into())),
        ErrorRefusal::NotFinite
    );
    assert_eq!(refused(machine.set_location(exx, 1.0)), ErrorRefusal::ErrorMotion);
    // A grid over a missing axis would read a coordinate that does not exist.
    let nodes = [vec![0.0, 1.0], vec![0.0, 1.0]];
    let grid = Grid::new([1, 7], nodes, vec![vec![0.0; 2]; 2]).unwrap();
    assert_eq!(
        refused(machine.set_error(exx, Field::Grid(grid).into())),
        ErrorRefusal::GridAxis { axis: 7, axes: 4 }
    );
    // The compiled machine has no thermal expansion of angles.
    let thermal = Thermal {
        expansion: vec![Expansion {
            error: "EAX".parse().unwrap(),
            sensor: "s".to_owned(),
            um_per_m_k: 10.0,
            fixed_mm: 0.0,
        }],
        ..Thermal::default()
    };
    assert!(matches!(
        machine.set_thermal(thermal),
        Err(ModelError::Thermal(ThermalRefusal::NotLength { .. }))
    ));
    let drift = Drift {
        error: exx,
        sensors: BTreeMap::from([("s".to_owned(), 1.0)]),
        per_k: 1.0,
        lag_s: f64::NAN,
    };
    let thermal = Thermal { drift: vec![drift], ..Thermal::default() };
    assert!(matches!(
        machine.set_thermal(thermal),
        Err(ModelError::Thermal(ThermalRefusal::Lag { .. }))
    ));
    assert!(machine.thermal().drift.len() == 1 && machine.thermal().expansion.len() == 1);
}

#[test]
fn a_compiled_machine_that_cannot_be_made_names_its_source() {
    let error = machine().compile(Tolerance::from_nm(-1.0)).unwrap_err();
    assert!(matches!(error, ModelError::Compile { .. }));
    assert!(std::error::Error::source(&error).is_some());
    assert_eq!(write_curve(&Curve::Constant(1.0)), "1.0");
}
