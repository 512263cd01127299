//! What every kind of curve misses of the truth, with 500 sets of 21 targets in places that chance takes and with 500 nearly even ones.
//!
//! `cargo run --release -p volcomp-fit --example gaps`

#[path = "../tests/it/gaps.rs"]
mod gaps;

use gaps::{NOISE, irregular, missed, nearly_even};
use volcomp_fit::{
    Fit, FitError, FitOptions, fit_auto, fit_bspline, fit_chebyshev, fit_cubic_table,
    fit_linear_table, fit_mls, fit_polynomial,
};

/// A kind of curve, by its name.
type Kind = (&'static str, fn(&[f64], &[f64]) -> Result<Fit, FitError>);

const RANGE: [f64; 2] = [0.0, 8000.0];
const KINDS: [Kind; 7] = [
    ("B-spline", fit_bspline),
    ("polynomial of order 8", |x, u| {
        fit_polynomial(x, u, 8, RANGE)
    }),
    ("Chebyshev of order 12", |x, u| {
        fit_chebyshev(x, u, 12, RANGE)
    }),
    ("monotone table", fit_cubic_table),
    ("linear table", fit_linear_table),
    ("moving least squares", |x, u| {
        fit_mls(x, u, 4, 1.0 / 3.0, 3.0)
    }),
    ("auto", |x, u| {
        fit_auto(x, u, &FitOptions::default()).map(|auto| auto.fit)
    }),
];

fn main() {
    println!("largest miss, µm, of readings with a noise of {NOISE} µm");
    println!("kind                     median     p90     max  over 30 | median     max");
    for (name, fit) in KINDS {
        let misses = |make: fn(u64) -> (Vec<f64>, Vec<f64>)| {
            let sets = (0..500).map(make);
            let fits = sets.filter_map(|(x, u)| fit(&x, &u).ok());
            let mut all: Vec<f64> = fits.map(|fit| missed(&fit)).collect();
            all.sort_by(f64::total_cmp);
            all
        };
        let (irregular, even) = (misses(irregular), misses(nearly_even));
        let at = |all: &[f64], tenths: usize| all[(all.len() - 1) * tenths / 10];
        let over = irregular.iter().filter(|miss| **miss > 30.0).count();
        println!(
            "{name:22} {:8.2} {:7.1} {:7.1}  {over:7} | {:6.2} {:7.2}",
            at(&irregular, 5),
            at(&irregular, 9),
            at(&irregular, 10),
            at(&even, 5),
            at(&even, 10),
        );
    }
}
