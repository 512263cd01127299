//! Four kinds of curve for the same positioning deviation, and their differences between and beyond the targets.
//!
//! `cargo run -p volcomp-curve --example curves`

use volcomp_curve::{Curve, CurveError, ErrorCurve, MovingLeastSquares, Polynomial, Table};
use volcomp_vocabulary::Direction;

fn main() -> Result<(), CurveError> {
    // Five targets of an axis of 800 mm: coordinate in mm, positioning deviation in µm.
    let targets = vec![[0.0, 0.0], [200.0, 2.1], [400.0, 2.9], [600.0, 6.2], [800.0, 8.0]];
    let curves: [(&str, Curve); 4] = [
        ("straight lines", Table::linear(targets.clone())?.into()),
        ("monotone cubics", Table::cubic(targets.clone())?.into()),
        ("moving least squares", MovingLeastSquares::new(targets, 1, 0.6, 3.0)?.into()),
        ("polynomial 0.01·x", Polynomial::new(vec![0.0, 0.01], [0.0, 800.0])?.into()),
    ];
    println!("value in µm, and slope in µm/m, by coordinate");
    for (name, curve) in &curves {
        print!("{name:>22}:");
        for x_mm in [100.0, 400.0, 700.0, 900.0] {
            let note = if curve.contains(x_mm) { "" } else { " (held)" };
            let slope = 1e3 * curve.derivative(x_mm);
            print!("  {x_mm} mm {:.2}, {slope:.1}{note}", curve.value(x_mm));
        }
        println!();
    }

    // A reversal value B of 3 µm: +1.5 µm after motion in the positive direction, −1.5 µm after motion in the negative
    // direction.
    let [(_, table), ..] = curves;
    let error = ErrorCurve::with_reversal(table.into(), 3.0)?;
    for (text, approach) in [
        ("from below", Some(Direction::Positive)),
        ("from above", Some(Direction::Negative)),
        ("unknown", None),
    ] {
        let value_um = error.value(0, &[400.0], approach);
        println!("at 400 mm, approach {text}: {value_um:.2} µm");
    }

    // An invalid curve is rejected. The message states the value found and the value expected.
    let refused = Table::linear(vec![[0.0, 1.0], [0.0, 2.0]]);
    println!("{}", refused.expect_err("two nodes at one place"));
    Ok(())
}
