//! Tests of Denavit–Hartenberg tables and zero-position screws against plain products and closed forms.
//!
//! Identities of exponential, logarithm and adjoint are tested as well.

use std::f64::consts::PI;

use proptest::prelude::*;
use rand::RngExt;
use volcomp_kinematics::nalgebra::{Matrix3, Vector3};
use volcomp_kinematics::{
    Chain, DhConvention, DhRow, DhTable, ErrorMotion, Form, GivenErrors, Pose, Screw, State, Twist,
    rotation_about_axis, rotation_from_vector, vector_from_rotation, volumetric_error,
};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{motion, placed, seeded, state, vector};

fn difference(a: &Pose, b: &Pose) -> f64 {
    let turned = (a.rotation - b.rotation).abs().max();
    (a.translation_mm - b.translation_mm).amax().max(turned * 1e3)
}

/// T(q) = base · Π A(q) · tool, where each A is the product of its four elementary motions.
fn plain_product(table: &DhTable, chain: &Chain, state: &State) -> Pose {
    let rotation = |axis: Vector3<f64>, angle: f64| Pose {
        rotation: volcomp_kinematics::rotation_about_axis(&axis, angle),
        translation_mm: Vector3::zeros(),
    };
    let mut pose = table.base;
    for ((row, joint), q) in table.rows.iter().zip(chain.joints()).zip(state.q) {
        let (turn, slide) = match joint.kind {
            AxisKind::Linear => (0.0, q),
            AxisKind::Rotary => (q, 0.0),
        };
        let about_z = rotation(Vector3::z(), row.theta_rad + turn)
            * Pose::from_translation(Vector3::z() * (row.d_mm + slide));
        let (a, alpha) = (
            Pose::from_translation(Vector3::x() * row.a_mm),
            rotation(Vector3::x(), row.alpha_rad),
        );
        pose = match table.convention {
            DhConvention::Distal => pose * about_z * a * alpha,
            DhConvention::Proximal => pose * alpha * a * about_z,
        };
    }
    pose * table.tool(chain.structure())
}

#[test]
fn a_table_moves_as_its_chain_in_every_type() {
    let mut rng = seeded(51);
    for structure in all_types() {
        for oblique in [false, true] {
            let mut chain = placed(&structure, &mut rng);
            if oblique {
                for &axis in structure.axes() {
                    chain.set_direction(axis, vector(&mut rng, 1.0)).unwrap();
                }
            }
            let distal = DhTable::of_chain(&chain);
            let table = if rng.random_bool(0.5) {
                distal.in_convention(DhConvention::Proximal)
            } else {
                distal
            };
            let back = table.to_chain(structure.clone()).unwrap();
            for _ in 0..20 {
                let state = state(&chain, &mut rng);
                let ideal = chain.ideal_pose(&state);
                // Oblique axes can be nearly parallel, with a distant common normal.
                let within = if oblique { 1e-6 } else { 1e-9 };
                let from_table = plain_product(&table, &chain, &state);
                assert!(difference(&from_table, &ideal) < within, "{structure}: {table:?}");
                assert!(difference(&back.ideal_pose(&state), &ideal) < within, "{structure}");
            }
        }
    }
}

/// The modified table of Craig, *Introduction to Robotics*, example 3.3: three parallel axes of a planar arm. The first
/// row is empty; each link is in the row of the next joint.
#[test]
fn a_proximal_table_has_its_links_in_the_next_row() {
    let row = |a_mm| DhRow { a_mm, ..DhRow::default() };
    let proximal = DhTable {
        convention: DhConvention::Proximal,
        base: Pose::identity(),
        rows: [row(0.0), row(300.0), row(200.0)].into_iter().collect(),
    };
    let structure: volcomp_kinematics::Structure = "w b A B C t".parse().unwrap();
    let chain = proximal.to_chain(structure.clone()).unwrap();
    let points: Vec<f64> = chain.joints().iter().map(|joint| joint.point_mm.x).collect();
    assert_eq!(points, [0.0, 300.0, 500.0]);
    let distal = proximal.in_convention(DhConvention::Distal);
    let links: Vec<f64> = distal.rows.iter().map(|row| row.a_mm).collect();
    assert_eq!(links, [300.0, 200.0, 0.0]);
    assert_eq!(distal.in_convention(DhConvention::Proximal), proximal);
    // The first row contains a link from the base.
    let mut led = proximal.clone();
    (led.rows[0].a_mm, led.rows[0].alpha_rad) = (50.0, PI / 2.0);
    let chain = led.to_chain(structure).unwrap();
    let first = chain.joints()[0];
    assert!((first.direction + Vector3::y()).norm() < 1e-15, "{first:?}");
    assert!((first.point_mm - Vector3::x() * 50.0).norm() < 1e-12);
}

/// Two links in a plane, the first table of the textbook: x = a1 cos q1 + a2 cos(q1 + q2).
#[test]
fn two_links_in_a_plane() {
    let row = |a_mm| DhRow { a_mm, ..DhRow::default() };
    let table = DhTable {
        convention: DhConvention::Distal,
        base: Pose::identity(),
        rows: [row(300.0), row(200.0)].into_iter().collect(),
    };
    // The letters A and C do not determine the directions; the table does.
    let structure = "w b A C t".parse().unwrap();
    let mut chain = table.to_chain(structure).unwrap();
    chain.set_tool([500.0, 0.0, 0.0], [0.0, 0.0, 1.0]).unwrap();
    let (q1, q2) = (0.3, -1.1_f64);
    let tip =
        chain.ideal_tip_mm(&State::new(&chain, [(AxisName::A, q1), (AxisName::C, q2)]).unwrap());
    let x = 300.0 * q1.cos() + 200.0 * (q1 + q2).cos();
    let y = 300.0 * q1.sin() + 200.0 * (q1 + q2).sin();
    assert!((tip - Vector3::new(x, y, 0.0)).norm() < 1e-9, "{tip}");
    let again = DhTable::of_chain(&chain);
    assert!((again.rows[0].a_mm - 300.0).abs() < 1e-12, "{again:?}");
    assert_eq!(again.rows[0].alpha_rad, 0.0);
}

#[test]
fn opposite_and_coinciding_axes_have_a_table() {
    let mut chain = Chain::new("w C' A' b B t".parse().unwrap());
    for (axis, direction, point) in [
        (AxisName::C, [0.0, 0.0, 1.0], [10.0, 20.0, 30.0]),
        (AxisName::A, [0.0, 0.0, -1.0], [10.0, 20.0, -50.0]),
        (AxisName::B, [0.0, 0.0, 1.0], [40.0, 60.0, 0.0]),
    ] {
        chain.set_direction(axis, direction).unwrap();
        chain.set_point(axis, point).unwrap();
    }
    let table = DhTable::of_chain(&chain);
    assert_eq!(table.rows[0].alpha_rad, PI);
    assert_eq!(table.rows[0].a_mm, 0.0);
    assert!((table.rows[1].a_mm - 50.0).abs() < 1e-12);
    let state =
        State::new(&chain, [(AxisName::C, 0.4), (AxisName::A, 1.2), (AxisName::B, -0.7)]).unwrap();
    let moved = plain_product(&table, &chain, &state);
    assert!(difference(&moved, &chain.ideal_pose(&state)) < 1e-9);
}

/// Actual axes of the zero-position model, given by direction cosines and a point, are exactly represented by location
/// errors.
#[test]
fn real_axes_are_location_errors() {
    let mut rng = seeded(52);
    for structure in all_types() {
        let nominal = placed(&structure, &mut rng);
        let mut real = nominal.clone();
        let mut errors = GivenErrors::default();
        for (index, joint) in nominal.joints().iter().enumerate() {
            let off = motion(&mut rng);
            let direction = joint.direction + off.angular_rad.cross(&joint.direction);
            real.set_direction(joint.name, direction.into()).unwrap();
            if joint.kind == AxisKind::Rotary {
                // Any point on the actual line gives the same result.
                let point = joint.point_mm + off.linear_mm + direction.normalize() * 123.0;
                real.set_point(joint.name, point.into()).unwrap();
            }
            errors.location[index] = joint.location_of(&real.joints()[index].screw());
            let (Screw::Revolute { direction, .. } | Screw::Prismatic { direction }) =
                joint.real_screw(&errors.location[index]);
            assert!((direction - real.joints()[index].direction).norm() < 1e-15);
        }
        let screws: Vec<Screw> = real.screws().collect();
        let again = Chain::from_screws(structure.clone(), &screws).unwrap();
        for (one, other) in again.joints().iter().zip(real.joints()) {
            assert!((one.direction - other.direction).norm() < 1e-15);
        }
        for _ in 0..20 {
            let state = state(&nominal, &mut rng);
            let error = volumetric_error(&nominal, &errors, &state, Form::Exact);
            let expected = real.ideal_tip_mm(&state) - nominal.ideal_tip_mm(&state);
            assert!((error.position_mm - expected).norm() < 1e-9, "{structure}");
        }
    }
}

#[test]
fn an_axis_the_other_way_round_is_half_a_turn() {
    let chain = Chain::new("w b X C t".parse().unwrap());
    let real = Screw::Prismatic { direction: -Vector3::x() };
    let location = chain.joints()[0].location_of(&real);
    assert!((location.angular_rad.norm() - PI).abs() < 1e-12);
    assert_eq!(location.linear_mm, Vector3::zeros());
    let Screw::Prismatic { direction } = chain.joints()[0].real_screw(&location) else {
        panic!("a sliding joint");
    };
    assert!((direction + Vector3::x()).norm() < 1e-12);
    assert_eq!(chain.joints()[1].location_of(&chain.joints()[1].screw()), ErrorMotion::ZERO);
}

#[test]
fn what_makes_no_chain_is_named() {
    let structure: volcomp_kinematics::Structure = "w b X C t".parse().unwrap();
    let slide = Screw::Prismatic { direction: Vector3::x() };
    let turn = |pitch_mm| Screw::Revolute {
        direction: Vector3::z(),
        point_mm: Vector3::zeros(),
        pitch_mm,
    };
    for (screws, expected) in [
        (vec![slide], "found 1 joints for the structure `w b X C t`, expected 2"),
        (vec![slide, slide], "axis C: found a sliding joint, expected a turning one"),
        (vec![turn(0.0), turn(0.0)], "axis X: found a turning joint, expected a sliding one"),
        (vec![slide, turn(5.0)], "axis C: found a helical joint"),
    ] {
        let error = Chain::from_screws(structure.clone(), &screws).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
    }
    let table = DhTable {
        convention: DhConvention::Distal,
        base: Pose { rotation: Matrix3::from_element(f64::NAN), translation_mm: Vector3::zeros() },
        rows: [DhRow::default(); 2].into_iter().collect(),
    };
    assert!(table.to_chain(structure.clone()).is_err());
    let short = DhTable {
        convention: DhConvention::Distal,
        base: Pose::identity(),
        rows: [DhRow::default()].into_iter().collect(),
    };
    assert!(short.to_chain(structure).unwrap_err().to_string().contains("found 1 joints"));
}

fn any_vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
    [-size..size, -size..size, -size..size].prop_map(Vector3::from)
}

fn twist(angle: f64) -> impl Strategy<Value = Twist> {
    (any_vector(1000.0), any_vector(angle))
        .prop_map(|(linear_mm, angular_rad)| Twist { linear_mm, angular_rad })
}

fn distance(a: &Twist, b: &Twist) -> f64 {
    (a.linear_mm - b.linear_mm).norm() + (a.angular_rad - b.angular_rad).norm()
}

fn apart(a: &Pose, b: &Pose) -> f64 {
    (a.rotation - b.rotation).norm() * 1000.0 + (a.translation_mm - b.translation_mm).norm()
}

proptest! {
    #[test]
    fn log_undoes_exp(t in twist(1.7), shrink in -12..=0) {
        let mut t = t;
        t.angular_rad *= 10f64.powi(shrink);
        let back = Twist::log(&t.exp()).unwrap();
        prop_assert!(distance(&t, &back) < 1e-9, "{t:?} {back:?}");
    }

    #[test]
    fn rotation_vectors_come_back(direction in any_vector(1.0), angle in 0.0..core::f64::consts::PI) {
        prop_assume!(direction.norm() > 1e-3);
        let r = direction.normalize() * angle;
        let back = vector_from_rotation(&rotation_from_vector(&r));
        prop_assert!((r - back).norm() < 1e-7 || (r + back).norm() < 1e-7, "{r} {back}");
        let small = r * 1e-9;
        let back = vector_from_rotation(&rotation_from_vector(&small));
        prop_assert!((small - back).norm() <= 1e-16, "{small} {back}");
    }

    #[test]
    fn two_ways_to_a_rotation(direction in any_vector(1.0), angle in -3.0..3.0_f64) {
        prop_assume!(direction.norm() > 1e-3);
        let unit = direction.normalize();
        let difference = rotation_about_axis(&unit, angle) - rotation_from_vector(&(unit * angle));
        prop_assert!(difference.norm() < 1e-14);
    }

    #[test]
    fn adjoint_of_a_product_is_the_product_of_adjoints(a in twist(3.0), b in twist(3.0), x in twist(1.0)) {
        let (a, b) = (a.exp(), b.exp());
        prop_assert!(distance(&x.adjoint(&(a * b)), &x.adjoint(&b).adjoint(&a)) < 1e-8);
        prop_assert!(distance(&x.adjoint(&a).adjoint(&a.inverse()), &x) < 1e-8);
    }

    #[test]
    fn exp_of_the_adjoint_is_the_conjugate(a in twist(3.0), x in twist(1.0)) {
        let a = a.exp();
        prop_assert!(apart(&x.adjoint(&a).exp(), &(a * x.exp() * a.inverse())) < 1e-8);
    }

    #[test]
    fn bracket_is_the_derivative_of_the_adjoint(a in twist(1.0), x in twist(1.0)) {
        let h = 1e-6;
        let slope = (x.adjoint(&(a * h).exp()) - x.adjoint(&(a * -h).exp())) * (0.5 / h);
        prop_assert!(distance(&slope, &a.bracket(&x)) < 1e-3);
        prop_assert!(distance(&(a.bracket(&x) + x.bracket(&a)), &Twist::zero()) < 1e-9);
    }

    #[test]
    fn a_screw_turns_about_its_line(point in any_vector(500.0), direction in any_vector(1.0), q in -3.0..3.0_f64, pitch in -5.0..5.0_f64) {
        prop_assume!(direction.norm() > 1e-3);
        let direction = direction.normalize();
        let screw = Screw::Revolute { direction, point_mm: point, pitch_mm: pitch };
        let pose = (screw.twist() * q).exp();
        let advance = pose.transform_point(&point) - point;
        prop_assert!((advance - direction * (pitch * q)).norm() < 1e-8);
        let slide = (Screw::Prismatic { direction }.twist() * q).exp();
        prop_assert!(apart(&slide, &Pose::from_translation(direction * q)) < 1e-12);
    }

    #[test]
    fn a_twist_at_a_point_moves_that_point(point in any_vector(500.0), shift in any_vector(1.0), turn in any_vector(0.1)) {
        let twist = Twist::at_point(shift, turn, &point);
        prop_assert!((twist.displacement_mm(&point) - shift).norm() < 1e-12);
    }
}
