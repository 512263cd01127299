//! Fits over the usual 21 targets.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use volcomp_fit::{FitError, fit_bspline, fit_mls, fit_mls_auto, fit_polynomial};

type OneFit = dyn Fn(&[f64], &[f64]) -> Result<f64, FitError>;

fn fits(criterion: &mut Criterion) {
    let x: Vec<f64> = (0..21).map(|i| f64::from(i) * 400.0).collect();
    let u: Vec<f64> = x
        .iter()
        .map(|x| 20.0 * (x / 900.0).sin() + 3.0 * (x / 370.0).cos())
        .collect();
    let mut bench = |name: &str, fit: &OneFit| {
        criterion.bench_function(name, |b| b.iter(|| fit(black_box(&x), black_box(&u))));
    };
    bench("polynomial order 6", &|x, u| {
        Ok(fit_polynomial(x, u, 6, [0.0, 8000.0])?.leave_one_out_rms)
    });
    bench("mls order 4", &|x, u| {
        Ok(fit_mls(x, u, 4, 1.0 / 3.0, 3.0)?.leave_one_out_rms)
    });
    bench("mls auto", &|x, u| {
        Ok(fit_mls_auto(x, u, 3.0, Some(2.0))?.leave_one_out_rms)
    });
    bench("bspline", &|x, u| Ok(fit_bspline(x, u)?.leave_one_out_rms));

    let mls = fit_mls(&x, &u, 4, 1.0 / 3.0, 3.0).map(|fit| fit.curve);
    if let Ok(curve) = mls {
        criterion.bench_function("mls order 4, value", |b| {
            b.iter(|| curve.value(black_box(1234.5)));
        });
    }
}

criterion_group!(benches, fits);
criterion_main!(benches);
