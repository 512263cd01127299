use proptest::prelude::*;
use volcomp_curve::{Curve, ErrorCurve, Field, Grid, Polynomial};
use volcomp_vocabulary::Direction;

/// A grid over Y (coordinate index 1) and Z (coordinate index 2).
fn sag() -> Grid {
    let values = vec![vec![0.0, 1.0, 2.0], vec![0.5, 1.5, 2.5]];
    Grid::new([1, 2], [vec![0.0, 500.0], vec![0.0, 650.0, 1050.0]], values).unwrap()
}

fn line(c0: f64, c1: f64) -> Field {
    Field::Curve(Polynomial::new(vec![c0, c1], [0.0, 10.0]).unwrap().into())
}

#[test]
fn grid_of_the_machine_file() {
    let grid = sag();
    assert_eq!(grid.value(&[9.0, 500.0, 1050.0]), 2.5);
    assert_eq!(grid.value(&[9.0, 0.0, 650.0]), 1.0);
    assert!((grid.value(&[9.0, 250.0, 325.0]) - 0.75).abs() < 1e-15);
    assert!((grid.value(&[9.0, 600.0, 850.0]) - 2.0).abs() < 1e-15);
    assert!((grid.partial(1, &[9.0, 250.0, 325.0]) - 0.001).abs() < 1e-15);
    assert!((grid.partial(2, &[9.0, 250.0, 850.0]) - 1.0 / 400.0).abs() < 1e-15);
    assert_eq!(grid.partial(0, &[9.0, 250.0, 850.0]), 0.0);
    assert_eq!(grid.partial(1, &[9.0, 500.1, 850.0]), 0.0);
    assert!(grid.partial(2, &[9.0, 500.1, 850.0]) > 0.0);
    assert!(grid.contains(&[9.0, 500.0, 0.0]) && !grid.contains(&[9.0, 500.0, -0.1]));
    assert!(grid.value(&[0.0, f64::NAN, 0.0]).is_nan());
    assert!(grid.partial(2, &[0.0, f64::NAN, 0.0]).is_nan());
}

#[test]
fn missing_coordinates_count_as_zero() {
    assert_eq!(sag().value(&[]), 0.0);
    assert_eq!(line(3.0, 1.0).value(7, &[1.0]), 3.0);
}

#[test]
fn branches() {
    let pair = ErrorCurve::Pair { forward: line(1.0, 2.0), backward: line(3.5, 1.0) };
    assert_eq!(pair.value(0, &[1.0], Some(Direction::Positive)), 3.0);
    assert_eq!(pair.value(0, &[1.0], Some(Direction::Negative)), 4.5);
    assert_eq!(pair.value(0, &[1.0], None), 3.75);
    assert_eq!(pair.derivative(0, &[1.0], None), 1.5);
    assert_eq!(pair.partial(1, 0, &[1.0, 2.0], Some(Direction::Positive)), 0.0);

    let reversal = ErrorCurve::with_reversal(line(1.0, 2.0), 3.5).unwrap();
    assert_eq!(reversal.value(0, &[1.0], Some(Direction::Positive)), 4.75);
    assert_eq!(reversal.value(0, &[1.0], Some(Direction::Negative)), 1.25);
    assert_eq!(reversal.value(0, &[1.0], None), 3.0);
    assert_eq!(reversal.derivative(0, &[1.0], Some(Direction::Negative)), 2.0);

    let single = ErrorCurve::from(Curve::Constant(4.0));
    assert_eq!(single.value(0, &[], Some(Direction::Negative)), 4.0);
}

#[test]
fn contains_checks_all_parts() {
    let short = Polynomial::new(vec![0.0], [0.0, 1.0]).unwrap();
    let pair = ErrorCurve::Pair { forward: line(0.0, 0.0), backward: Curve::from(short).into() };
    assert!(pair.contains(0, &[1.0]));
    assert!(!pair.contains(0, &[2.0]));
    assert_eq!(pair.fields().count(), 2);
}

proptest! {
    #[test]
    fn grid_partials_are_limits_of_differences(y in 1.0..499.0_f64, z in 1.0..1049.0_f64) {
        prop_assume!((z - 650.0).abs() > 1.0);
        let values = vec![vec![0.0, 1.0, -2.0], vec![0.5, 7.5, 2.5]];
        let grid =
            Grid::new([1, 2], [vec![0.0, 500.0], vec![0.0, 650.0, 1050.0]], values).unwrap();
        let by_y = (grid.value(&[0.0, y + 0.5, z]) - grid.value(&[0.0, y - 0.5, z])) / 1.0;
        let by_z = (grid.value(&[0.0, y, z + 0.5]) - grid.value(&[0.0, y, z - 0.5])) / 1.0;
        prop_assert!((grid.partial(1, &[0.0, y, z]) - by_y).abs() < 1e-12);
        prop_assert!((grid.partial(2, &[0.0, y, z]) - by_z).abs() < 1e-12);
    }
}
