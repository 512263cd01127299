//! The same readings fitted with four kinds of curve, and what each would have predicted of a reading it had not seen.
//!
//! `cargo run -p volcomp-fit --example choose`

use volcomp_fit::{Fit, FitError, fit_auto, fit_bspline, fit_cubic_table, fit_mls, fit_polynomial};

fn main() -> Result<(), FitError> {
    // Three runs over 21 targets of a 1 m axis: a slow bow and a ripple of the screw, and what scatters, µm.
    let truth = |x: f64| 12.0 * (x / 1000.0).powi(2) + 1.5 * (x / 80.0).sin();
    let (mut x, mut u) = (Vec::new(), Vec::new());
    for run in 0..3 {
        for target in 0..=20 {
            let at = 50.0 * f64::from(target);
            // No noise generator is needed to show it: a fixed pattern of ±0.3 µm.
            let scatter = 0.3 * f64::from((7 * target + 5 * run) % 11 - 5) / 5.0;
            x.push(at);
            u.push(truth(at) + scatter);
        }
    }

    let domain = [0.0, 1000.0];
    let fits: [(&str, Fit); 5] = [
        ("polynomial of order 2", fit_polynomial(&x, &u, 2, domain)?),
        ("polynomial of order 8", fit_polynomial(&x, &u, 8, domain)?),
        ("moving least squares", fit_mls(&x, &u, 2, 0.2, 3.0)?),
        ("smoothing B-spline", fit_bspline(&x, &u)?),
        ("monotone cubic table", fit_cubic_table(&x, &u)?),
    ];
    println!("                       residual rms  leave-one-out  off the truth at most, µm");
    for (name, fit) in &fits {
        let off = (0..=1000)
            .map(|x| (fit.curve.value(f64::from(x)) - truth(f64::from(x))).abs())
            .fold(0.0, f64::max);
        println!(
            "{name:22} {:12.3} {:14.3} {off:10.3}",
            fit.rms(),
            fit.leave_one_out_rms
        );
    }

    let chosen = fit_auto(&x, &u, None)?;
    println!("chosen by the number of targets: {}", chosen.curve.kind());
    assert!(chosen.leave_one_out_rms < fits[0].1.leave_one_out_rms);
    Ok(())
}
