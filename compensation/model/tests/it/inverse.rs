//! From a tip and a tool axis to coordinates within the travels.

use std::fmt::Write as _;

use volcomp_model::kinematics::State;
use volcomp_model::kinematics::nalgebra::Vector3;
use volcomp_model::{Machine, ModelError, Reached};
use volcomp_vocabulary::AxisName;

fn machine(structure: &str, axes: &str) -> Machine {
    let text = format!("structure = \"{structure}\"\n[axes]\n{axes}\n");
    Machine::parse(&text, "m.toml").unwrap()
}

const LINEAR: &str = "X.travel = [-500, 500]\nY.travel = [-500, 500]\nZ.travel = [-500, 500]\n";

/// The coordinates of an axis in all solutions, deg.
fn degrees(machine: &Machine, reached: &Reached, axis: AxisName) -> Vec<f64> {
    let place = machine.index_of(axis).unwrap();
    reached.solutions.iter().map(|state| state.q[place].to_degrees()).collect()
}

fn near(found: &[f64], expected: &[f64]) {
    let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(found.len() == expected.len() && off < 1e-9, "{found:?} {expected:?}");
}

/// A tilting rotary table, with the tool axis at (sin 30°, 0, cos 30°), solved by hand: A = ±30 with C = ±90, since A′ and C′ carry the workpiece.
/// Solutions with smaller rotations come first.
#[test]
fn every_solution_within_travel_the_smaller_turns_first() {
    let axes = format!("{LINEAR}A.travel = [-90, 90]\nC.travel = [-360, 360]");
    let table = machine("w C' A' b X Y Z t", &axes);
    let target = [0.5, 0.0, 0.75_f64.sqrt()];
    let reached = table.axes_at([10.0, 20.0, 30.0], target).unwrap();
    assert!(!reached.singular && reached.free.is_empty() && reached.missed.is_none());
    // Rot_z(C)·Rot_x(A)·z = (sin C sin A, −cos C sin A, cos A).
    near(
        &degrees(&table, &reached, AxisName::A).iter().map(|a| a.abs()).collect::<Vec<_>>(),
        &[30.0; 4],
    );
    let mut angles = degrees(&table, &reached, AxisName::C);
    near(&angles.iter().map(|c| c.abs()).collect::<Vec<_>>(), &[90.0, 90.0, 270.0, 270.0]);
    angles.sort_by(f64::total_cmp);
    near(&angles, &[-270.0, -90.0, 90.0, 270.0]);
    for state in &reached.solutions {
        let off = table.chain().ideal_tip_mm(state) - Vector3::new(10.0, 20.0, 30.0);
        assert!(off.norm() < 1e-9, "{off}");
    }
    // With a shorter travel of A only one solution of each pair remains.
    let short = machine("w C' A' b X Y Z t", &axes.replace("[-90, 90]", "[-5, 90]"));
    let reached = short.axes_at([0.0; 3], target).unwrap();
    near(&degrees(&short, &reached, AxisName::A), &[30.0, 30.0]);
    assert_eq!(reached.outside, [AxisName::A]);
    let none = machine("w C' A' b X Y Z t", &axes.replace("[-90, 90]", "[-5, 5]"));
    let reached = none.axes_at([0.0; 3], target).unwrap();
    assert!(reached.solutions.is_empty() && reached.missed.is_none());
    assert_eq!(reached.outside, [AxisName::A]);
}

#[test]
fn a_singular_pose_has_a_free_axis_near_zero_and_ends_of_travel_count() {
    let axes = format!("{LINEAR}A.travel = [-90, 90]\nC.travel = [45, 400]");
    let table = machine("w C' A' b X Y Z t", &axes);
    let reached = table.axes_at([100.0, 0.0, 0.0], [0.0, 0.0, 3.0]).unwrap();
    assert_eq!((reached.singular, &reached.free[..]), (true, &[AxisName::C][..]));
    near(&degrees(&table, &reached, AxisName::C), &[45.0]);
    let side = table.axes_at([0.0; 3], [0.0, -1.0, 0.0]).unwrap();
    // A = 90 at C = 0 or 360, A = −90 at C = 180.
    let mut both = degrees(&table, &side, AxisName::C);
    both.sort_by(f64::total_cmp);
    near(&both, &[180.0, 360.0]);
    let round = machine(
        "w C' A' b X Y Z t",
        &axes.replace("C.travel = [45, 400]", "C = { travel = [0, 360], modulo = 360 }"),
    );
    let reached = round.axes_at([0.0; 3], [0.0, -1.0, 0.0]).unwrap();
    assert_eq!(reached.solutions.len(), 2, "0 and 360 are one place");
}

#[test]
fn what_has_no_solution_says_why() {
    let three = machine("w X' b Y Z t", LINEAR);
    assert_eq!(three.axes_at([1.0, 2.0, 3.0], [0.0, 0.0, 1.0]).unwrap().solutions.len(), 1);
    let tilted = three.axes_at([0.0; 3], [0.0, 1.0, 1.0]).unwrap();
    let why = tilted.missed.unwrap().to_string();
    assert!(why.contains("miss it by 45.000000 deg"), "{why}");
    let far = three.axes_at([0.0, 900.0, 0.0], [0.0, 0.0, 1.0]).unwrap();
    assert_eq!(far.outside, [AxisName::Y]);
    for (tip, axis) in [
        ([f64::NAN, 0.0, 0.0], [0.0, 0.0, 1.0]),
        ([0.0; 3], [0.0; 3]),
        ([0.0; 3], [f64::INFINITY, 0.0, 0.0]),
    ] {
        assert!(matches!(three.axes_at(tip, axis), Err(ModelError::Target { .. })));
    }
    let axes = format!("{LINEAR}A.travel = [-9e8, 9e8]\nC.travel = [0, 360]");
    let endless = machine("w C' A' b X Y Z t", &axes);
    let refused = endless.axes_at([0.0; 3], [0.0, 1.0, 1.0]).unwrap_err();
    assert!(refused.to_string().contains("solutions, expected at most 1000"), "{refused}");
}

/// With three rotary axes each pair moves in turn, while the third is at its coordinate nearest to 0.
#[test]
fn a_third_rotary_axis_stands() {
    let axes =
        format!("{LINEAR}A.travel = [-90, 90]\nB.travel = [-90, 90]\nC.travel = [-180, 180]");
    let six = machine("w C' b X Y Z A B t", &axes);
    let target = [0.3, 0.2, 0.9];
    let reached = six.axes_at([5.0, 6.0, 7.0], target).unwrap();
    assert!(reached.solutions.len() >= 3, "{}", reached.solutions.len());
    for state in &reached.solutions {
        let axis = six.chain().ideal_pose(state).rotation * six.chain().tool_axis();
        let wanted = Vector3::from(target).normalize();
        assert!((axis - wanted).norm() < 1e-12);
        let off = six.chain().ideal_tip_mm(state) - Vector3::new(5.0, 6.0, 7.0);
        assert!(off.norm() < 1e-9);
    }
}

/// With a tilting table, a tip beside the table is reached only if the table is rotated, in ranges of C computed by hand from two triangles.
#[test]
fn a_free_axis_stands_where_the_linear_axes_reach() {
    let axes = "X.travel = [-300, 300]\nY.travel = [-250, 250]\nZ.travel = [-400, 0]\nA.travel = [-110, 30]\nC.travel = [-360, 360]";
    let table = machine("w C' A' b X Y Z t", axes);
    let reached = table.axes_at([0.0, 280.0, -50.0], [0.0, 0.0, 1.0]).unwrap();
    // At a radius of 280 mm and angle C, the tip is at 280·|cos C| along Y (at most 250) and 280·|sin C| along X (at most 300).
    let edge = (250.0_f64 / 280.0).acos().to_degrees();
    let degrees_of = |ranges: &[[f64; 2]]| -> Vec<f64> {
        ranges.iter().flatten().map(|q| q.to_degrees()).collect()
    };
    near(&degrees_of(&reached.ranges[0]), &[edge - 180.0, -edge, edge, 180.0 - edge]);
    let mut found = degrees(&table, &reached, AxisName::C);
    found.sort_by(f64::total_cmp);
    near(&found, &[edge - 360.0, -edge, edge, 360.0 - edge]);
    assert!(reached.singular && reached.missed.is_none());
    // The range shrinks to a single coordinate: the radius equals the largest reach of X and Y together.
    let corner = machine("w C' A' b X Y Z t", &axes.replace("[-300, 300]", "[-1, 400]"));
    let [x, y] = [400.0_f64, 250.0];
    let reached = corner.axes_at([0.0, x.hypot(y), -50.0], [0.0, 0.0, 1.0]).unwrap();
    assert!(!reached.solutions.is_empty(), "{reached:?}");
    let reached = corner.axes_at([0.0, x.hypot(y) + 0.01, -50.0], [0.0, 0.0, 1.0]).unwrap();
    assert!(reached.solutions.is_empty() && !reached.outside.is_empty(), "{reached:?}");
}

/// Ranges next to half a turn that are narrower than the sampling step are found: at a radius of 100 mm Y is at 100·|sin C|.
#[test]
fn a_narrow_range_next_to_half_a_turn_is_found() {
    let [low, high] = [0.05_f64, 0.15].map(f64::to_radians);
    let [near_y, far_y] = [low, high].map(|beyond| 100.0 * beyond.sin());
    for (turns, count) in [("[-360, 360]", 2), ("[-180, 180]", 1), ("[-179.97, 179.97]", 1)] {
        let found = [1.0, -1.0].map(|sign: f64| {
            let ends = [sign * near_y, sign * far_y];
            let y = format!("[{}, {}]", ends[0].min(ends[1]), ends[0].max(ends[1]));
            let axes = format!(
                "X.travel = [-500, 0]\nY.travel = {y}\nZ.travel = [-500, 500]\nA.travel = [-90, 90]\nC.travel = {turns}"
            );
            let table = machine("w C' A' b X Y Z t", &axes);
            let reached = table.axes_at([100.0, 0.0, 0.0], [0.0, 0.0, 1.0]).unwrap();
            assert_eq!(reached.solutions.len(), count, "{turns} {sign}: {reached:?}");
            let ranges = &reached.ranges[0];
            assert_eq!(ranges.len(), 1, "{turns} {sign}: {ranges:?}");
            let mut sizes = ranges[0].map(|q| 180.0 - q.to_degrees().abs());
            sizes.sort_by(f64::total_cmp);
            near(&sizes, &[0.05, 0.15]);
            ranges[0][0].signum()
        });
        // One range is next to +180°, the other next to −180°.
        assert!(found[0] * found[1] < 0.0, "{found:?}");
    }
}

/// For random structures, a singular pose with the free axis at any coordinate is found from its tip and tool axis.
#[test]
fn a_singular_pose_that_was_there_is_found() {
    let mut seed = 7_u64;
    let mut draw = |low: f64, high: f64| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((seed >> 11) as f64 / (1_u64 << 53) as f64)
    };
    // The axis that is free if the others are at 0.
    let structures = [
        ("w C' A' b X Y Z t", AxisName::C),
        ("w C' A' X' b Y Z t", AxisName::C),
        ("w X' b Y Z A C t", AxisName::C),
        ("w C' X' b Y Z B t", AxisName::C),
        ("w X' Y' b Z C B t", AxisName::C),
        ("w C' X' Y' b Z t", AxisName::C),
        ("w C' Y' b X Z t", AxisName::C),
    ];
    for round in 0..210 {
        let (structure, free) = structures[round % structures.len()];
        let mut axes = String::new();
        let mut stands = Vec::new();
        for letter in structure.chars().filter(|letter| "XYZABC".contains(*letter)) {
            let is_rotary = "ABC".contains(letter);
            let q = match letter {
                'A' | 'B' => 0.0,
                'C' => draw(-170.0, 170.0),
                _ => draw(-300.0, 300.0),
            };
            let room = if is_rotary {
                [q - draw(0.0, 180.0), q + draw(0.0, 180.0)]
            } else {
                [q - draw(0.001, 60.0), q + draw(0.001, 60.0)]
            };
            let point = format!(
                "point = [{}, {}, {}]",
                draw(-200.0, 200.0),
                draw(-200.0, 200.0),
                draw(-200.0, 200.0)
            );
            let point = if is_rotary { point } else { String::new() };
            let [low, high] = room;
            writeln!(axes, "[axes.{letter}]\ntravel = [{low}, {high}]\n{point}").expect("a string");
            stands.push(q);
        }
        let text = format!(
            "structure = \"{structure}\"\n{axes}[tool]\ntip = [{}, {}, {}]\n",
            draw(-50.0, 50.0),
            draw(-50.0, 50.0),
            draw(-150.0, 0.0)
        );
        let machine = Machine::parse(&text, "m.toml").unwrap();
        let mut state = volcomp_model::kinematics::State::default();
        for (place, q) in stands.iter().enumerate() {
            let is_rotary = machine.axes()[place].name.is_rotary();
            state.q[place] = if is_rotary { q.to_radians() } else { *q };
        }
        let tip = machine.chain().ideal_tip_mm(&state);
        let reached = machine.axes_at(tip.into(), [0.0, 0.0, 1.0]).unwrap();
        assert_eq!(reached.free, [free], "{text}");
        assert!(!reached.solutions.is_empty(), "{text}{stands:?}{reached:?}");
        for found in &reached.solutions {
            let off = machine.chain().ideal_tip_mm(found) - tip;
            assert!(off.norm() < 1e-9, "{off} {text}");
        }
        // The pose itself is in one of the ranges.
        let place = machine.index_of(free).unwrap();
        let is_there = reached.ranges[0].iter().any(|[low, high]| {
            let turns = (state.q[place] - 0.5 * (low + high)) / std::f64::consts::TAU;
            let q = state.q[place] - turns.round() * std::f64::consts::TAU;
            (low - 1e-9..=high + 1e-9).contains(&q)
        });
        assert!(is_there, "{text}{stands:?}{:?}", reached.ranges);
    }
}

/// At B = ±90° Z and X are parallel. Any division of the motion between Z and X within the travels is a solution, and
/// both axes are reported as free.
#[test]
fn linear_axes_along_one_another_are_free() {
    let with = |z: &str| {
        let axes = format!(
            "Z.travel = {z}\nB.travel = [-180, 180]\nX.travel = [-500, 500]\nY.travel = [-500, 500]\n"
        );
        machine("w Z' B' b X Y t", &axes)
    };
    let wide = with("[-500, 500]");
    let [z, x] = [AxisName::Z, AxisName::X].map(|axis| wide.index_of(axis).unwrap());
    for (direction, z_of_tip) in [([1.0, 0.0, 0.0], 5.0), ([-1.0, 0.0, 0.0], -40.0)] {
        let reached = wide.axes_at([0.0, 12.0, z_of_tip], direction).unwrap();
        assert_eq!(reached.solutions.len(), 1);
        assert!(reached.singular);
        assert_eq!(reached.free, [AxisName::Z, AxisName::X]);
        let [moves] = reached.dependent[..] else { panic!("{:?}", reached.dependent) };
        assert!((moves.q[z].abs() - 1.0).abs() < 1e-12 && (moves.q[x].abs() - 1.0).abs() < 1e-12);
        // At both ends of its range the free axis, with the dependent motion, leaves the tip where it is.
        let state = reached.solutions[0];
        let tip = wide.chain().ideal_tip_mm(&state);
        for (place, ranges) in [z, x].into_iter().zip(&reached.ranges) {
            let [range] = ranges[..] else { panic!("{ranges:?}") };
            assert!(range[1] - range[0] > 900.0, "{range:?}");
            for end in range {
                let mut at = state;
                let along = (end - state.q[place]) / moves.q[place];
                for axis in [z, x] {
                    at.q[axis] += along * moves.q[axis];
                    assert!(at.q[axis].abs() < 500.0 + 1e-9, "{at:?}");
                }
                assert!((wide.chain().ideal_tip_mm(&at) - tip).norm() < 1e-9);
            }
        }
    }
    // If Z and X each took half of the motion, Z would be outside its travel; the solution has a smaller motion of Z.
    let narrow = with("[-1, 1]");
    let reached = narrow.axes_at([0.0, 0.0, 300.0], [1.0, 0.0, 0.0]).unwrap();
    assert_eq!(reached.solutions.len(), 1, "{reached:?}");
    assert!(reached.solutions[0].q[z].abs() <= 1.0 && reached.outside.is_empty());
    let other = wide.axes_at([0.0, 12.0, 5.0], [0.6, 0.0, 0.8]).unwrap();
    assert!(!other.singular && other.free.is_empty() && other.dependent.is_empty());
}

/// Points near the pose at which Z and X are parallel are reached by long opposite motions.
#[test]
fn points_near_a_pose_of_dependent_axes_are_reached() {
    for structure in ["w Z' B' b X Y t", "w b X Y B Z t"] {
        let axes = "Z.travel = [-500, 500]\nB.travel = [-180, 180]\nX.travel = [-500, 500]\nY.travel = [-500, 500]\n";
        let machine = machine(structure, axes);
        for off in [0.0, 1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 5e-4, 1e-3, 2e-3] {
            let mut state = State::default();
            for (axis, q) in [
                (AxisName::X, 100.0),
                (AxisName::Y, 30.0),
                (AxisName::Z, 20.0),
                (AxisName::B, std::f64::consts::FRAC_PI_2 + off),
            ] {
                state.q[machine.index_of(axis).unwrap()] = q;
            }
            let tip = machine.chain().ideal_tip_mm(&state);
            let direction =
                machine.chain().ideal_pose(&state).rotation * machine.chain().tool_axis();
            let reached = machine.axes_at(tip.into(), direction.into()).unwrap();
            assert!(!reached.solutions.is_empty(), "{structure} {off}: {reached:?}");
            for found in &reached.solutions {
                let miss = (machine.chain().ideal_tip_mm(found) - tip).norm();
                assert!(miss < 1e-6, "{structure} {off}: {miss}");
            }
            if off > 1e-6 {
                let z = machine.index_of(AxisName::Z).unwrap();
                let near = |found: &State| (found.q[z] - 20.0).abs() < 1e-3;
                assert!(reached.solutions.iter().any(near), "{structure} {off}: {reached:?}");
            }
        }
    }
}
