//! Invalid public input is rejected by name.

use proptest::prelude::*;
use volcomp_evaluator::{
    AxisParts, CompiledMachine, EvaluatorError, MachineParts, Patch, Tolerance,
};
use volcomp_kinematics::{Chain, ErrorMotion, ErrorSource, State};
use volcomp_vocabulary::{AxisKind, AxisName, Component, Deg, Displacement, ErrorName, Mm};

fn gantry() -> Chain {
    Chain::new("w X' b Y Z t".parse().unwrap())
}

fn travel(axis: AxisName) -> [Displacement; 2] {
    [-100.0, 100.0].map(|end| Displacement::from_coordinate(axis.kind(), end))
}

fn ideal<'a>(axis: AxisName) -> AxisParts<'a> {
    AxisParts::without_errors(travel(axis))
}

fn without(left_out: AxisName) -> MachineParts<'static> {
    let others = [AxisName::X, AxisName::Y, AxisName::Z].into_iter();
    others
        .filter(|axis| *axis != left_out)
        .fold(MachineParts::new(&gantry()), |parts, axis| parts.axis(axis, ideal(axis)).unwrap())
}

fn message(parts: Result<MachineParts<'_>, EvaluatorError>) -> String {
    parts.err().map_or("accepted".to_owned(), |e| e.to_string())
}

#[test]
fn missing_and_foreign_axes_are_named() {
    let compiled = CompiledMachine::new(without(AxisName::Z), Tolerance::default());
    assert!(matches!(compiled, Err(EvaluatorError::MissingAxis { axis: AxisName::Z })));
    assert_eq!(
        message(without(AxisName::Z).axis(AxisName::C, ideal(AxisName::C))),
        "the structure `w X' b Y Z t` has no axis C"
    );
    assert_eq!(
        message(without(AxisName::Z).axis(AxisName::X, ideal(AxisName::X))),
        "axis X: axis: expected each axis once"
    );
}

#[test]
fn invalid_axis_numbers_are_refused() {
    let axis = |parts: AxisParts<'static>| message(without(AxisName::X).axis(AxisName::X, parts));
    let mm = |low: f64, high: f64| [Displacement::Length(Mm(low)), Displacement::Length(Mm(high))];
    let wrong = [
        axis(AxisParts::without_errors(travel(AxisName::C))),
        axis(AxisParts::without_errors(mm(1.0, 1.0))),
        axis(AxisParts::without_errors(mm(f64::NAN, 1.0))),
        axis(ideal(AxisName::X).modulo(Deg(360.0))),
        axis(ideal(AxisName::X).slope_mm([f64::INFINITY, 0.0, 0.0])),
        axis(ideal(AxisName::X).breakpoints(Component::EX, [0.0, f64::NAN])),
        axis(ideal(AxisName::X).range(Component::EX, AxisName::X, [2.0, 1.0])),
        axis(ideal(AxisName::X).range(Component::EX, AxisName::W, [1.0, 2.0])),
    ];
    for message in &wrong {
        assert!(message.contains("axis X: ") || message.contains("no axis W"), "{message}");
    }
}

#[test]
fn errors_over_two_coordinates_are_checked() {
    let good = Patch {
        component: Component::EC,
        weights: [1.0; 3],
        axes: [AxisName::X, AxisName::Y],
        nodes: [vec![0.0, 10.0], vec![0.0]],
        values: vec![0.0, 1e-6],
    };
    let message = |patch: Patch| {
        message(without(AxisName::X).axis(AxisName::X, ideal(AxisName::X).patch(patch)))
    };
    assert_eq!(message(good.clone()), "accepted");
    let wrong = [
        Patch { values: vec![0.0], ..good.clone() },
        Patch { nodes: [vec![], vec![0.0]], values: vec![], ..good.clone() },
        Patch { nodes: [vec![1.0, 1.0], vec![0.0]], ..good.clone() },
        Patch { nodes: [vec![0.0, f64::NAN], vec![0.0]], ..good.clone() },
        Patch { weights: [f64::NAN; 3], ..good.clone() },
        Patch { axes: [AxisName::X, AxisName::B], ..good.clone() },
    ];
    for patch in wrong {
        assert_ne!(message(patch.clone()), "accepted", "{patch:?}");
    }
}

#[test]
fn location_errors_take_the_unit_of_their_name() {
    let name = |text: &str| text.parse::<ErrorName>().unwrap();
    let angle = Displacement::from_micro(AxisKind::Rotary, 10.0);
    let length = Displacement::from_micro(AxisKind::Linear, 10.0);
    let set = |text: &str, value| message(without(AxisName::X).location(name(text), value));
    assert_eq!(set("EC0Y", angle), "accepted");
    for (text, value) in [("EC0Y", length), ("EXX", length), ("EC0C", angle)] {
        assert_ne!(set(text, value), "accepted", "{text}");
    }
    assert_ne!(set("EC0Y", Displacement::new(AxisKind::Rotary, f64::NAN)), "accepted");
}

#[test]
fn a_curve_that_is_not_finite_is_refused_by_name() {
    let errors = |x: f64, _| ErrorMotion::from_um_urad([0.0, 1.0 / (x - 3.0), 0.0, 0.0, 0.0, 0.0]);
    let parts = AxisParts::new(travel(AxisName::X), errors).breakpoints(Component::EY, [0.0, 3.0]);
    let parts = without(AxisName::X).axis(AxisName::X, parts).unwrap();
    let refused = CompiledMachine::new(parts, Tolerance::default()).unwrap_err().to_string();
    assert!(refused.starts_with("curve EYX: found a value that is not finite near 3"), "{refused}");
}

/// A function is compiled over the whole travel; breakpoints can only extend the range.
#[test]
fn a_function_is_compiled_over_the_travel() {
    let linear = |x: f64, _| ErrorMotion::from_um_urad([0.01 * x, 0.0, 0.0, 0.0, 0.0, 0.0]);
    for breakpoints in [&[][..], &[0.0], &[0.0, 50.0], &[-100.0, 100.0]] {
        let x = AxisParts::new(travel(AxisName::X), linear)
            .breakpoints(Component::EX, breakpoints.iter().copied());
        let parts = without(AxisName::X).axis(AxisName::X, x).unwrap();
        let machine = CompiledMachine::new(parts, Tolerance::default()).unwrap();
        for (x, expected_um) in [(-100.0, -1.0), (30.0, 0.3), (100.0, 1.0), (120.0, 1.0)] {
            let found = machine.evaluate(
                &State::new(
                    machine.chain(),
                    [(AxisName::X, x), (AxisName::Y, 0.0), (AxisName::Z, 0.0)],
                )
                .unwrap(),
            );
            let um = found.position_mm[0] * 1e3;
            assert!(
                (um - expected_um).abs() < 1e-6,
                "X {x}, breakpoints {breakpoints:?}: {um} µm, expected {expected_um}"
            );
        }
    }
    let x = AxisParts::new(travel(AxisName::X), |x: f64, _| {
        ErrorMotion::from_um_urad([if x > 50.0 { f64::NAN } else { 0.0 }, 0.0, 0.0, 0.0, 0.0, 0.0])
    });
    let parts = without(AxisName::X).axis(AxisName::X, x).unwrap();
    let refused = CompiledMachine::new(parts, Tolerance::default());
    assert!(matches!(refused, Err(EvaluatorError::NotFinite { .. })));
}

/// Positioning deviation of 10 µm/m, squareness, expansion and a constant over two coordinates add up as in closed
/// form.
#[test]
fn all_parts_act_as_in_closed_form() {
    let x = AxisParts::new(travel(AxisName::X), |q, _| {
        ErrorMotion::from_um_urad([0.01 * q, 0.0, 0.0, 0.0, 0.0, 0.0])
    })
    .breakpoints(Component::EX, [-100.0, 100.0])
    .slope_mm([2e-5, 0.0, 0.0])
    .range(Component::EX, AxisName::X, [-100.0, 100.0])
    .patch(Patch {
        component: Component::EZ,
        weights: [1.0; 3],
        axes: [AxisName::X, AxisName::Y],
        nodes: [vec![0.0], vec![0.0]],
        values: vec![3e-3],
    });
    let parts = without(AxisName::X)
        .axis(AxisName::X, x)
        .unwrap()
        .location("EC0Y".parse().unwrap(), Displacement::from_micro(AxisKind::Rotary, 20.0))
        .unwrap()
        .assembly(AxisName::Z, ErrorMotion::from_um_urad([0.0, 7.0, 0.0, 0.0, 0.0, 0.0]))
        .unwrap();
    let machine = CompiledMachine::new(parts, Tolerance::default()).unwrap();
    let found = machine.evaluate(
        &State::new(
            machine.chain(),
            [(AxisName::X, 50.0), (AxisName::Y, 40.0), (AxisName::Z, 10.0)],
        )
        .unwrap(),
    );
    // Along X: EXX + expansion − squareness·y; along Y: the assembly error; along Z: the constant.
    let expected = [0.0005 + 0.001 - 20e-6 * 40.0, 0.007, 0.003];
    for (found, expected) in found.position_mm.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }
    let outside = machine.outside_range(
        &State::new(
            machine.chain(),
            [(AxisName::X, 101.0), (AxisName::Y, 0.0), (AxisName::Z, 0.0)],
        )
        .unwrap(),
    );
    assert_eq!(outside.iter().map(|name| name.to_string()).collect::<Vec<_>>(), ["EXX"]);
    assert!(machine.outside_range(&State::default()).is_empty());
}

proptest! {
    /// For any arguments, public calls return a result or an error.
    #[test]
    fn nothing_panics(
        axis in 0..9_usize, index in 0..20_usize, q in proptest::num::f64::ANY, number in proptest::num::f64::ANY,
        names in proptest::collection::vec(0..9_usize, 0..12),
    ) {
        let name = AxisName::ALL[axis];
        let parts = AxisParts::new([Displacement::new(name.kind(), number), Displacement::new(name.kind(), q)], move |x, _| {
            ErrorMotion::from_um_urad([x * number, 0.0, 0.0, 0.0, 0.0, q])
        })
        .breakpoints(Component::EX, [q, number])
        .modulo(Deg(number));
        let _ = without(AxisName::Y).axis(name, parts);
        let parts = without(AxisName::Y).axis(AxisName::Y, ideal(AxisName::Y)).unwrap();
        let mut machine = CompiledMachine::new(parts, Tolerance::default()).unwrap();
        let names: Vec<AxisName> = names.into_iter().map(|name| AxisName::ALL[name]).collect();
        let _ = machine.set_correctors(&names);
        machine.set_thermal_offset(index, &ErrorMotion::ZERO, [number; 3]);
        let mut state = State::default();
        state.q[axis] = q;
        let _ = (machine.evaluate(&state), machine.first_order(&state), machine.error_motion(index, &state));
        let _ = machine.linear_grid(&[(name, vec![q, number])], &state).map(|grid| grid.len());
        let bigger = Chain::new("w A' B' C' X' Y' Z' b U V W t".parse().unwrap());
        let _ = machine.first_order_of(&state, &volcomp_kinematics::Correctors::all(&bigger));
        let order = machine.chain().structure().axes();
        let _ = machine.evaluate_batch(order, &[q; 7], state.approach, &mut [[0.0; 6]; 3]);
    }
}
