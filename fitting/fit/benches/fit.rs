//! Benchmarks of fits over 21 targets, and of the automatic choice over many targets.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use volcomp_fit::{
    BandOptions, FitError, FitOptions, Method, band, fit_auto, fit_bspline, fit_mls, fit_mls_auto,
    fit_polynomial,
};

type OneFit = dyn Fn(&[f64], &[f64]) -> Result<f64, FitError>;

fn fits(criterion: &mut Criterion) {
    let x: Vec<f64> = (0..21).map(|i| f64::from(i) * 400.0).collect();
    let u: Vec<f64> =
        x.iter().map(|x| 20.0 * (x / 900.0).sin() + 3.0 * (x / 370.0).cos()).collect();
    let mut bench = |name: &str, fit: &OneFit| {
        criterion.bench_function(name, |b| b.iter(|| fit(black_box(&x), black_box(&u))));
    };
    bench("polynomial order 6", &|x, u| {
        Ok(fit_polynomial(x, u, 6, [0.0, 8000.0])?.leave_one_out_rms)
    });
    bench("mls order 4", &|x, u| Ok(fit_mls(x, u, 4, 1.0 / 3.0, 3.0)?.leave_one_out_rms));
    bench("mls auto", &|x, u| Ok(fit_mls_auto(x, u, 3.0, Some(2.0))?.leave_one_out_rms));
    bench("bspline", &|x, u| Ok(fit_bspline(x, u)?.leave_one_out_rms));
    bench("chosen by itself", &|x, u| {
        Ok(fit_auto(x, u, &FitOptions::default())?.fit.leave_one_out_rms)
    });
    bench("band of one run, mls order 4", &|x, u| {
        let mls = Method::MovingLeastSquares { order: 4, support: 1.0 / 3.0, shape: 3.0 };
        Ok(band(mls, &[(x, u)], x, &BandOptions::default())?.half_width[0])
    });

    let mls = fit_mls(&x, &u, 4, 1.0 / 3.0, 3.0).map(|fit| fit.curve);
    if let Ok(curve) = mls {
        criterion.bench_function("mls order 4, value", |b| {
            b.iter(|| curve.value(black_box(1234.5)));
        });
    }
}

/// Ten runs over this number of targets on 8 m; the deviations have waves, a pitch error and scatter. Returns
/// coordinates (mm) and deviations (µm).
fn runs(targets: u32) -> (Vec<f64>, Vec<f64>) {
    let mut noise = 1_u32;
    let mut random = || {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(noise >> 8) / f64::from(1_u32 << 24) - 0.5
    };
    let x: Vec<f64> =
        (0..targets).map(|k| 8000.0 * f64::from(k) / f64::from(targets - 1)).collect();
    let x = x.repeat(10);
    let u =
        x.iter().map(|x| 20.0 * (x / 900.0).sin() + (x / 25.0).sin() + 2.0 * random()).collect();
    (x, u)
}

fn many(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("chosen by itself, ten runs");
    group.sample_size(10);
    for targets in [21, 200, 1_000, 10_000] {
        let (x, u) = runs(targets);
        group.bench_function(format!("{targets} targets"), |b| {
            b.iter(|| fit_auto(black_box(&x), black_box(&u), &FitOptions::default()));
        });
    }
    group.finish();
}

criterion_group!(benches, fits, many);
criterion_main!(benches);
