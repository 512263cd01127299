//! Kinds of curve on one irregular axis: what each leaves of the truth.

use std::path::Path;

use volcomp_fit::{Fit, FitError, fit_bspline, fit_mls, fit_polynomial};
use volcomp_metrology::read_file;
use volcomp_model::Temperatures;
use volcomp_shop::{LineOfSight, Shop};
use volcomp_vocabulary::Direction;

use crate::failure::Failure;

/// Peak to peak of truth minus curve over 61 points, µm.
#[expect(clippy::struct_field_names, reason = "the unit belongs to each name")]
pub(crate) struct IrregularCurve {
    pub(crate) polynomial_um: f64,
    pub(crate) mls_um: f64,
    pub(crate) bspline_um: f64,
}

/// Fits the forward means of the X positioning file and compares with the truth.
pub(crate) fn irregular_curve(shop: &Shop, file: &Path) -> Result<IrregularCurve, Failure> {
    let measurement = read_file(file).map_err(Failure::input)?;
    let means = measurement.mean_curve_in(Direction::Positive);
    let (x, u): (Vec<f64>, Vec<f64>) = means.into_iter().unzip();
    let exx = shop
        .lines
        .iter()
        .find(|l| l.setup.error.to_string() == "EXX");
    let line = exx.ok_or_else(|| Failure::Work("the demo measures no EXX".to_owned()))?;
    let sight = LineOfSight::new(&shop.truth, &line.setup)?;
    let none = Temperatures::new();
    let errors = shop.truth.source(&none);
    let domain = [x[0], x[x.len() - 1]];
    let left = |fit: Result<Fit, FitError>| {
        let curve = fit.map_err(Failure::input)?.curve;
        let misses: Vec<f64> = (0..=60)
            .map(|i| {
                let target = domain[0] + (domain[1] - domain[0]) * f64::from(i) / 60.0;
                let state = sight.state(target, Direction::Positive);
                sight.reading(&errors, &state, &state) - curve.value(target)
            })
            .collect();
        let largest = misses.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let smallest = misses.iter().copied().fold(f64::INFINITY, f64::min);
        Ok::<f64, Failure>(largest - smallest)
    };
    Ok(IrregularCurve {
        polynomial_um: left(fit_polynomial(&x, &u, 6, domain))?,
        mls_um: left(fit_mls(&x, &u, 4, 1.0 / 3.0, 3.0))?,
        bspline_um: left(fit_bspline(&x, &u))?,
    })
}
