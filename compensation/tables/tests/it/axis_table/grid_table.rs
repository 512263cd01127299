//! What is a grid and what is none.

use volcomp_tables::axis_table::{GridTable, GridTableError};
use volcomp_tables::vocabulary::AxisName::{self, A, U, X, Y, Z};

fn lines(count: usize) -> Vec<Vec<f64>> {
    vec![vec![0.0, 100.0]; count]
}

fn refused(axes: &[AxisName], lines: Vec<Vec<f64>>, values: Vec<f64>) -> GridTableError {
    let outputs = vec![X, Y];
    GridTable::new(axes.to_vec(), lines, outputs, values).expect_err("no grid")
}

#[test]
fn a_wrong_number_of_values_is_told() {
    for found in [0, 7, 9] {
        assert_eq!(
            refused(&[X, Y], lines(2), vec![0.0; found]),
            GridTableError::Count { found, expected: 8 }
        );
    }
    let none = GridTable::new(vec![X], vec![vec![0.0]], Vec::new(), Vec::new());
    assert_eq!(none.expect("nothing deviates").nodes(), 1);
}

/// As many axes as a number has bits, or more, once made `1 << axes` overflow.
#[test]
fn axes_are_three_different_linear_ones_at_the_most() {
    for axes in [vec![X, Y, Z, U], vec![X, X], vec![X, A], vec![X; 64]] {
        let (sets, found) = (lines(axes.len()), axes.clone());
        let what = "axes";
        assert_eq!(
            refused(&axes, sets, Vec::new()),
            GridTableError::Axes { what, found }
        );
    }
    let twice = GridTable::new(vec![X], lines(1), vec![Z, Z], vec![0.0; 4]);
    assert_eq!(
        twice.expect_err("no grid").to_string(),
        "deviations of a grid: found Z Z, expected three different linear axes at the most"
    );
}

#[test]
fn lines_rise() {
    let (found, expected) = (1, 2);
    assert_eq!(
        refused(&[X, Y], lines(1), vec![0.0; 8]),
        GridTableError::Sets { found, expected }
    );
    for wrong in [
        vec![],
        vec![0.0, 0.0],
        vec![1.0, 0.0],
        vec![0.0, f64::NAN],
        vec![0.0, f64::INFINITY],
    ] {
        let values = vec![0.0; 4 * wrong.len()];
        let sets = vec![vec![0.0, 100.0], wrong];
        assert_eq!(
            refused(&[X, Y], sets, values),
            GridTableError::Lines { axis: Y }
        );
    }
}

#[test]
fn values_are_numbers() {
    let values = vec![0.0, 0.0, f64::INFINITY, 0.0];
    assert_eq!(
        refused(&[X], lines(1), values),
        GridTableError::Value {
            place: 3,
            found: f64::INFINITY
        }
    );
}

/// Held beyond the ends, and where a single line stands along an axis.
#[test]
fn deviations_are_those_of_the_nodes() {
    let grid = GridTable::new(
        vec![X, Z],
        vec![vec![0.0, 100.0], vec![50.0]],
        vec![Y],
        vec![1.0, 3.0],
    );
    let grid = grid.expect("a grid");
    for (x, expected) in [
        (-10.0, 1.0),
        (0.0, 1.0),
        (25.0, 1.5),
        (100.0, 3.0),
        (1e9, 3.0),
    ] {
        let at = |axis| if axis == X { x } else { 0.0 };
        assert_eq!(grid.deviation(at), [expected], "at {x}");
    }
    assert_eq!([grid.node(0), grid.node(1)], [[0.0, 50.0], [100.0, 50.0]]);
    let of: Vec<(AxisName, Vec<f64>)> = grid
        .by_output()
        .map(|(axis, values)| (axis, values.copied().collect()))
        .collect();
    assert_eq!(of, [(Y, vec![1.0, 3.0])]);
}
