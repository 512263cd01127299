//! From laser interferometer readings to the error curve of an axis, with estimates of its accuracy.
//!
//! `cargo run -p volcomp-fit --example fit_axis`

use volcomp_fit::{Fit, FitError, FitOptions, fit_auto, fit_cubic_table, fit_polynomial};

fn main() -> Result<(), FitError> {
    // Three runs over nine targets of an axis of 800 mm: coordinate in mm, positioning deviation in µm. Several runs
    // are given as repeated targets, in any order.
    let run = [0.0, 1.3, 1.9, 3.6, 4.1, 4.4, 6.0, 7.3, 7.9];
    let scatter = [[0.2, -0.1, 0.1], [-0.2, 0.2, -0.1], [0.1, -0.2, 0.0]];
    let (mut x_mm, mut u_um) = (Vec::new(), Vec::new());
    for offsets in scatter {
        for (target, value) in run.iter().enumerate() {
            x_mm.push(100.0 * target as f64);
            u_um.push(value + offsets[target % 3]);
        }
    }

    // The largest residual shows how closely a curve follows its readings; the leave-one-out error shows how well it
    // predicts omitted readings. The leave-one-out error decides.
    let fits: [(&str, Fit); 3] = [
        ("straight line", fit_polynomial(&x_mm, &u_um, 1, [0.0, 800.0])?),
        ("monotone cubics", fit_cubic_table(&x_mm, &u_um)?),
        ("chosen automatically", fit_auto(&x_mm, &u_um, &FitOptions::default())?.fit),
    ];
    println!("all in µm           largest residual   leave-one-out   at 450 mm");
    for (name, fit) in &fits {
        println!(
            "{name:18} {:17.2} {:15.2} {:11.2}   ({})",
            fit.max_abs(),
            fit.leave_one_out_rms,
            fit.curve.value(450.0),
            fit.curve.kind()
        );
    }

    // Readings that do not determine the curve are rejected; the message states what is missing.
    let refused = fit_polynomial(&[0.0, 100.0], &[0.0, 1.0], 3, [0.0, 800.0]);
    println!("{}", refused.expect_err("two targets for order 3"));
    Ok(())
}
