//! A positioning deviation with a reversal value, and a straightness deviation that depends on two axes.
//!
//! `cargo run -p volcomp-curve --example reversal`

use volcomp_curve::{Curve, CurveError, ErrorCurve, Grid, Polynomial, Table};
use volcomp_vocabulary::Direction;

fn main() -> Result<(), CurveError> {
    // Means of both directions at five targets, mm and µm, with a monotone cubic curve between them.
    let mean =
        Table::cubic(vec![[0.0, 0.0], [200.0, 1.8], [400.0, 2.9], [600.0, 4.4], [800.0, 5.0]])?;
    let positioning = ErrorCurve::with_reversal(Curve::Table(mean).into(), 3.0)?;

    println!("X, mm   forward  backward  either, µm");
    for x in [0.0, 250.0, 500.0, 900.0] {
        let value = |direction| positioning.value(0, &[x], direction);
        println!(
            "{x:5.0}  {:8.3}  {:8.3}  {:7.3}{}",
            value(Some(Direction::Positive)),
            value(Some(Direction::Negative)),
            value(None),
            if positioning.contains(0, &[x]) {
                ""
            } else {
                "  outside the measured range: the end value"
            }
        );
    }

    // The polynomial c0 + c1·x + c2·x², its value and its slope.
    let bow = Curve::Polynomial(Polynomial::new(vec![0.0, 0.02, -2.5e-5], [0.0, 800.0])?);
    println!("middle of the bow: {:.3} µm", bow.value(400.0));
    assert!(bow.derivative(400.0).abs() < 1e-12);

    // Straightness of Y in Z that also depends on the position of Z, linear between the nodes of both axes.
    let sag = Grid::new(
        [0, 1],
        [vec![0.0, 500.0, 1000.0], vec![0.0, 400.0]],
        vec![vec![0.0, 0.0], vec![-8.0, -12.0], vec![0.0, 0.0]],
    )?;
    let sag = ErrorCurve::from(volcomp_curve::Field::Grid(sag));
    assert!((sag.value(0, &[500.0, 200.0], None) + 10.0).abs() < 1e-12);
    Ok(())
}
