//! Tests of the inverse kinematics: each solution for the pose at random coordinates has this pose.

use std::f64::consts::{FRAC_PI_2, PI};

use rand::RngExt;
use volcomp_kinematics::{Chain, NoSolution, State, letter_direction, nalgebra::Vector3};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{AxisKind, AxisName, PerAxis};

use crate::{placed, seeded, state, vector};

const ANY: PerAxis<[f64; 2]> = PerAxis([[f64::NEG_INFINITY, f64::INFINITY]; 9]);

fn rotary(chain: &Chain) -> Vec<usize> {
    let joints = chain.joints().iter().enumerate();
    joints.filter(|(_, joint)| joint.kind == AxisKind::Rotary).map(|(index, _)| index).collect()
}

fn tool_axis(chain: &Chain, state: &State) -> Vector3<f64> {
    chain.ideal_pose(state).rotation * chain.tool_axis()
}

/// All solutions for the tool pose at the state `at`, with linear axes that bring the tip to its position.
fn solutions(chain: &Chain, at: &State) -> Vec<State> {
    let (tip, axis) = (chain.ideal_tip_mm(at), tool_axis(chain, at));
    let pointings = chain.pointing(&axis, &rotary(chain), &State::default()).unwrap();
    let reach = |pointing: &volcomp_kinematics::Pointing| {
        chain.reaching(&tip, &pointing.state, &ANY).unwrap()
    };
    pointings.iter().map(reach).collect()
}

fn turned_apart(a: f64, b: f64) -> f64 {
    let turns = (a - b) / (2.0 * PI);
    ((turns - turns.round()) * 2.0 * PI).abs()
}

#[test]
fn a_pose_of_every_type_leads_back_to_itself() {
    let mut rng = seeded(71);
    let (mut worst_mm, mut two) = (0.0_f64, 0);
    for structure in all_types() {
        for skew in [0.0, 0.4] {
            let mut chain = placed(&structure, &mut rng);
            for &axis in structure.axes() {
                let tilt = Vector3::from(vector(&mut rng, skew));
                let direction = letter_direction(axis) + tilt;
                chain.set_direction(axis, direction.into()).unwrap();
            }
            let tip = chain.tool_tip_mm();
            // If the tool is inclined in its holder, its direction depends on each rotary axis.
            chain.set_tool(tip.into(), [0.2, 0.1, 1.0]).unwrap();
            for _ in 0..100 {
                let at = state(&chain, &mut rng);
                let found = solutions(&chain, &at);
                two += usize::from(found.len() == 2);
                let mut nearest = f64::INFINITY;
                for one in &found {
                    let off = (chain.ideal_tip_mm(one) - chain.ideal_tip_mm(&at)).norm();
                    worst_mm = worst_mm.max(off);
                    assert!(off < 1e-9, "{structure}: {off} mm");
                    let turned = (tool_axis(&chain, one) - tool_axis(&chain, &at)).norm();
                    assert!(turned < 1e-12, "{structure}: {turned}");
                    let mut apart = 0.0_f64;
                    for (place, joint) in chain.joints().iter().enumerate() {
                        apart = apart.max(match joint.kind {
                            AxisKind::Linear => (one.q[place] - at.q[place]).abs() * 1e-3,
                            AxisKind::Rotary => turned_apart(one.q[place], at.q[place]),
                        });
                    }
                    nearest = nearest.min(apart);
                }
                assert!(nearest < 1e-9, "{structure} skew {skew}: {at:?} {found:?}");
            }
        }
    }
    assert!(two > 1500, "{two} poses have two solutions");
    println!("largest distance {worst_mm:.2e} mm");
}

#[test]
fn a_singular_pose_names_the_axis_that_is_free() {
    let mut held = State::default();
    // At A = 0 the tool is along C, on table and head. On a head A C the tool is always along the second axis.
    for (structure, b_or_a, free) in [
        ("w C' A' b X Y Z t", [0.0, 0.0], AxisName::C),
        ("w b X Y Z C A t", [0.0, 0.0], AxisName::C),
        ("w C' b X Y Z B t", [0.0, 0.0], AxisName::C),
        ("w b X Y Z A C t", [0.5, 0.3], AxisName::C),
    ] {
        let chain = Chain::new(structure.parse().unwrap());
        let places = rotary(&chain);
        let mut at =
            State { q: PerAxis::leading([10.0, 20.0, 30.0, 40.0, 50.0]), ..State::default() };
        (at.q[places[0]], at.q[places[1]]) = (b_or_a[0], b_or_a[1]);
        let free = chain.structure().index_of(free);
        held.q[free.unwrap()] = 0.25;
        let found = chain.pointing(&tool_axis(&chain, &at), &places, &held).unwrap();
        assert_eq!(found.len(), 1, "{structure}");
        assert_eq!(found[0].free, free, "{structure}");
        assert_eq!(found[0].state.q[free.unwrap()], 0.25);
        let off = tool_axis(&chain, &found[0].state) - tool_axis(&chain, &at);
        assert!(off.norm() < 1e-15, "{structure}: {off}");
    }
}

#[test]
fn what_cannot_be_reached_says_by_how_much() {
    // A fork head with axes at 45° to each other tilts the tool by at most 90°.
    let mut chain = Chain::new("w b X Y Z C B t".parse().unwrap());
    chain.set_direction(AxisName::B, [0.0, 1.0, 1.0]).unwrap();
    let down = -Vector3::z();
    let refused = chain.pointing(&down, &rotary(&chain), &State::default());
    let Err(NoSolution::ToolAxis { miss_rad }) = refused else { panic!("{refused:?}") };
    assert!((miss_rad - FRAC_PI_2).abs() < 1e-12, "{miss_rad}");
    let side = Vector3::x();
    let found = chain.pointing(&side, &rotary(&chain), &State::default()).unwrap();
    assert!((tool_axis(&chain, &found[0].state) - side).norm() < 1e-7);
    // At the limit, both solutions coincide.
    assert_eq!(found.len(), 1);
    let three = Chain::new("w b X Y Z t".parse().unwrap());
    assert!(three.pointing(&Vector3::z(), &[], &State::default()).is_ok());
    assert!(three.pointing(&side, &[], &State::default()).is_err());
    assert!(three.pointing(&Vector3::zeros(), &[], &State::default()).is_err());
    let two = Chain::new("w b X Y t".parse().unwrap());
    let state = State::default();
    let refused = two.reaching(&Vector3::new(1.0, 2.0, 3.0), &state, &ANY);
    assert_eq!(refused, Err(NoSolution::Tip { miss_mm: 3.0 }));
    assert!(two.reaching(&Vector3::new(1.0, 2.0, f64::NAN), &state, &ANY).is_err());
    let found = two.reaching(&Vector3::new(1.0, 2.0, 0.0), &state, &ANY).unwrap();
    assert_eq!(found.q[..2], [1.0, 2.0]);
}

/// A portal with two linear axes in X: the first one moves, and the second one provides the travel that is missing.
#[test]
fn redundant_linear_axes_share_what_one_cannot_reach() {
    let chain = Chain::new("w X' b Y Z U C A t".parse().unwrap());
    let mut travel = ANY;
    travel[0] = [0.0, 500.0];
    travel[3] = [-50.0, 100.0];
    let state = State::default();
    let at = |x: f64| chain.reaching(&Vector3::new(x, 20.0, -30.0), &state, &travel);
    for (x, expected) in [(400.0, [400.0, 0.0]), (560.0, [500.0, 60.0]), (-20.0, [0.0, -20.0])] {
        let found = at(x).unwrap();
        assert_eq!([found.q[0], found.q[3]], expected, "{x}");
        assert_eq!([found.q[1], found.q[2]], [20.0, -30.0]);
    }
    let Err(NoSolution::Tip { miss_mm }) = at(650.0) else { panic!("beyond both") };
    assert!((miss_mm - 50.0).abs() < 1e-9, "{miss_mm}");
    // Random poses of both axes are reached, in general with other coordinates.
    let mut rng = seeded(72);
    for _ in 0..200 {
        let mut at = State::default();
        for (q, [low, high]) in at.q.iter_mut().zip([
            [0.0, 500.0],
            [-300.0, 300.0],
            [-300.0, 0.0],
            [-50.0, 100.0],
            [-3.0, 3.0],
            [0.1, 1.5],
        ]) {
            *q = rng.random_range(low..=high);
        }
        let pointing = chain.pointing(&tool_axis(&chain, &at), &rotary(&chain), &state).unwrap();
        for one in &pointing {
            let found = chain.reaching(&chain.ideal_tip_mm(&at), &one.state, &travel).unwrap();
            assert!((chain.ideal_tip_mm(&found) - chain.ideal_tip_mm(&at)).norm() < 1e-9);
            assert!((0.0..=500.0).contains(&found.q[0]) && (-50.0..=100.0).contains(&found.q[3]));
        }
    }
}

/// A quill and an inclined ram. An axis at an end of its travel must move back when other axes take over, so that each
/// pose that is reachable within the travels is found. An axis without travel has no effect.
#[test]
fn slanted_redundant_axes_give_back_what_they_took() {
    let travel_of = [[0.0, 200.0], [0.0, 500.0], [0.0, 400.0], [-400.0, 0.0]];
    let mut travel = ANY;
    for (place, of) in travel_of.into_iter().enumerate() {
        travel[place] = of;
    }
    travel[4] = [0.0; 2];
    let mut rng = seeded(8);
    let slants = [
        Vector3::new(0.5, 0.0, -0.75_f64.sqrt()),
        Vector3::new(-0.6, 0.64, 0.48),
        Vector3::new(0.02, 0.0, -1.0).normalize(),
    ];
    let structures = ["w b W X Y Z t", "w b W X Y Z U t", "w b W X Y Z V t"];
    for (structure, slant) in structures.iter().flat_map(|of| slants.map(|slant| (of, slant))) {
        let mut chain = Chain::new(structure.parse().unwrap());
        chain.set_direction(AxisName::W, slant.into()).unwrap();
        for _ in 0..200 {
            let mut q = [0.0; 4];
            for (q, [low, high]) in q.iter_mut().zip(travel_of) {
                *q = rng.random_range(low..=high);
            }
            let tip = slant * q[0] + Vector3::new(q[1], q[2], q[3]);
            let found = chain.reaching(&tip, &State::default(), &travel);
            let found = found.unwrap_or_else(|error| panic!("{slant:?} {q:?}: {error}"));
            let there = slant * found.q[0] + Vector3::new(found.q[1], found.q[2], found.q[3]);
            assert!((there - tip).norm() < 1e-7, "{q:?} {found:?}");
            for (q, [low, high]) in found.q.iter().zip(travel_of) {
                assert!((low..=high).contains(q), "{found:?}");
            }
        }
        // Beyond all travels, the tip is as near as possible: no point in the box of travels is nearer.
        let tip = Vector3::new(900.0, 200.0, 100.0);
        let Err(NoSolution::Tip { miss_mm }) = chain.reaching(&tip, &State::default(), &travel)
        else {
            panic!("beyond all")
        };
        let nearest = (0..=2000).map(|step| {
            let rest = tip - slant * (0.1 * f64::from(step));
            let held = Vector3::new(
                rest.x.clamp(0.0, 500.0),
                rest.y.clamp(0.0, 400.0),
                rest.z.clamp(-400.0, 0.0),
            );
            (rest - held).norm()
        });
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        assert!((miss_mm - nearest).abs() < 0.01, "{miss_mm} {nearest}");
    }
}

/// Linear axes bring the tip as near as possible: exactly if they have three directions, otherwise except for the
/// direction that no axis has.
#[test]
fn linear_axes_bring_the_tip_as_near_as_they_can() {
    let mut rng = seeded(72);
    for structure in all_types() {
        let chain = placed(&structure, &mut rng);
        let (mut at, there) = (state(&chain, &mut rng), state(&chain, &mut rng));
        let to = chain.ideal_tip_mm(&there);
        let turned = at;
        let left = chain.bring(&mut at, |_| true, &to, |state| chain.ideal_tip_mm(state));
        assert!(left < 1e-9, "{structure}: {left} mm");
        assert!((chain.ideal_tip_mm(&at) - to).norm() < 1e-9);
        for place in rotary(&chain) {
            assert_eq!(at.q[place], turned.q[place], "{structure}");
        }
    }
    // C is between Y and the other axes: at 90° X and Y are parallel, and no axis moves normal to them. The second pose
    // is so near to 90° that such a motion would need moves a thousand times as long.
    let chain = Chain::new("w b X C Y Z t".parse().unwrap());
    let c = chain.structure().index_of(AxisName::C).unwrap();
    for angle in [FRAC_PI_2, FRAC_PI_2 - 1e-7] {
        let mut at = State::default();
        at.q[c] = angle;
        let to = chain.ideal_tip_mm(&at) + Vector3::new(3.0, 4.0, 5.0);
        let left = chain.bring(&mut at, |_| true, &to, |state| chain.ideal_tip_mm(state));
        assert!((left - 4.0).abs() < 1e-3, "{left} mm");
        for (place, q) in at.q.iter().enumerate() {
            assert!(place == c || q.abs() < 10.0, "{at:?}");
        }
    }
    // Axes that are excluded do not move.
    let chain = Chain::new("w b X Y Z t".parse().unwrap());
    let y = chain.structure().index_of(AxisName::Y).unwrap();
    let mut at = State::default();
    let to = chain.ideal_tip_mm(&at) + Vector3::new(3.0, 4.0, 0.0);
    let left = chain.bring(&mut at, |place| place != y, &to, |state| chain.ideal_tip_mm(state));
    assert!((left - 4.0).abs() < 1e-12 && at.q[y] == 0.0, "{left}");
    let chain = Chain::new("w C b t".parse().unwrap());
    let mut at = State::default();
    let to = chain.ideal_tip_mm(&at) + Vector3::new(0.0, 0.0, 2.0);
    let left = chain.bring(&mut at, |_| true, &to, |state| chain.ideal_tip_mm(state));
    assert_eq!((left, at), (2.0, State::default()));
}

/// A tool axis without a direction is rejected for each type of machine. A vector of any other length is a valid
/// direction.
#[test]
fn a_tool_axis_without_a_direction_is_refused_by_every_type() {
    let mut rng = seeded(73);
    for structure in all_types() {
        let chain = placed(&structure, &mut rng);
        let (rotary, none) = (rotary(&chain), State::default());
        let pointing = |axis: [f64; 3]| chain.pointing(&axis.into(), &rotary, &none);
        for axis in [[0.0; 3], [f64::NAN; 3], [0.0, f64::NAN, 1.0], [f64::INFINITY, 0.0, 0.0]] {
            let found = pointing(axis);
            let is_refused =
                matches!(found, Err(NoSolution::ToolAxis { miss_rad }) if miss_rad.is_nan());
            assert!(is_refused, "{structure} {axis:?}: {found:?}");
        }
        let unit = tool_axis(&chain, &none);
        let expected = pointing(unit.into()).unwrap();
        for length in [1e200, 1e308, 1e-200, 1e-310] {
            let found = pointing((unit * length).into()).unwrap();
            assert_eq!(found.len(), expected.len(), "{structure} {length:e}");
            for (one, other) in found.iter().zip(&expected) {
                assert!(one.state.q.iter().all(|q| q.is_finite()));
                let back = tool_axis(&chain, &one.state);
                assert!((back - unit).norm() < 1e-9, "{structure} {length:e}");
                assert_eq!(one.free, other.free);
            }
        }
    }
}

/// A rotary axis between Z and X makes them parallel at ±90°: a common move leaves the tip in place. By hand: the table
/// Z carries the workpiece, so that the tip moves by −Z in the rotated frame of the workpiece.
#[test]
fn linear_axes_that_a_turn_brings_along_one_another_are_dependent() {
    let chain = Chain::new("w Z' B' b X Y t".parse().unwrap());
    let mut at = State::default();
    for (b_rad, is_singular) in [(FRAC_PI_2, true), (-FRAC_PI_2, true), (0.3, false), (0.0, false)]
    {
        at.q[1] = b_rad;
        let moves = chain.dependent_moves(&at);
        assert_eq!(moves.len(), usize::from(is_singular), "{b_rad}");
        for moves in &moves {
            assert_eq!((moves[1], moves[3]), (0.0, 0.0));
            assert!(moves[0].abs() > 0.9 && moves[2].abs() > 0.9, "{moves:?}");
            let mut there = at;
            there.q[0] += 70.0 * moves[0];
            there.q[2] += 70.0 * moves[2];
            let off = chain.ideal_tip_mm(&there) - chain.ideal_tip_mm(&at);
            assert!(off.norm() < 1e-12, "{off}");
            // A move of only one of the two axes moves the tip.
            there.q[2] = at.q[2];
            assert!((chain.ideal_tip_mm(&there) - chain.ideal_tip_mm(&at)).norm() > 60.0);
        }
    }
    // If one of the two axes is at an end of its travel, the other one continues.
    at.q[1] = FRAC_PI_2;
    let mut travel = ANY;
    travel[0] = [-10.0, 10.0];
    at.q[2] = 400.0;
    let tip = chain.ideal_tip_mm(&at);
    let found = chain.reaching(&tip, &at, &travel).unwrap();
    assert!((chain.ideal_tip_mm(&found) - tip).norm() < 1e-9);
    assert!(found.q[0].abs() <= 10.0, "{:?}", found.q);
    // Two axes of one direction are parallel in each pose and do not count. If no rotary axis is between linear axes,
    // there are no dependent moves.
    for structure in ["w X' b Y Z U C A t", "w C' A' b X Y Z t", "w b X Y Z t", "w b X Y t"] {
        let chain = Chain::new(structure.parse().unwrap());
        assert!(chain.dependent_moves(&State::default()).is_empty(), "{structure}");
    }
}
