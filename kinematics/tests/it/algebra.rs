//! Tests of identities of exponential, logarithm and adjoint.

use proptest::prelude::*;
use volcomp_kinematics::{
    Pose, Screw, Twist, nalgebra::Vector3, rotation_about_axis, rotation_from_vector,
    vector_from_rotation,
};

fn vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
    [-size..size, -size..size, -size..size].prop_map(Vector3::from)
}

fn twist(angle: f64) -> impl Strategy<Value = Twist> {
    (vector(1000.0), vector(angle))
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
    fn rotation_vectors_come_back(direction in vector(1.0), angle in 0.0..core::f64::consts::PI) {
        prop_assume!(direction.norm() > 1e-3);
        let r = direction.normalize() * angle;
        let back = vector_from_rotation(&rotation_from_vector(&r));
        prop_assert!((r - back).norm() < 1e-7 || (r + back).norm() < 1e-7, "{r} {back}");
        let small = r * 1e-9;
        let back = vector_from_rotation(&rotation_from_vector(&small));
        prop_assert!((small - back).norm() <= 1e-16, "{small} {back}");
    }

    #[test]
    fn two_ways_to_a_rotation(direction in vector(1.0), angle in -3.0..3.0_f64) {
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
    fn a_screw_turns_about_its_line(point in vector(500.0), direction in vector(1.0), q in -3.0..3.0_f64, pitch in -5.0..5.0_f64) {
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
    fn a_twist_at_a_point_moves_that_point(point in vector(500.0), shift in vector(1.0), turn in vector(0.1)) {
        let twist = Twist::at_point(shift, turn, &point);
        prop_assert!((twist.displacement_mm(&point) - shift).norm() < 1e-12);
    }
}
