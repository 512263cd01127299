//! `volcomp fit`: readings to a curve of the machine file.

use std::path::PathBuf;

use clap::ValueEnum;
use serde_json::Value;
use volcomp_curve::Curve;
use volcomp_fit::{
    Fit, FitError, fit_bspline, fit_chebyshev, fit_mls, fit_mls_auto, fit_polynomial,
};
use volcomp_metrology::{DeviationUnit, MetrologyError, read_file};
use volcomp_model::write_curve;

use super::{Answer, fixed, table, table_text};
use crate::{
    answers::fit::{Fit as Document, Point, Spread},
    failure::Failure,
    unit::{self, Unit},
};

/// Fits a curve to the mean deviation at each target
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Measurement file: .csv, .rtl, .rta
    data: PathBuf,
    /// Unit of the deviations in a file that does not state it (.csv), without it µm; the answer is in µm or µrad
    #[arg(long)]
    unit: Option<Unit>,
    /// Kind of curve: polynomial, Chebyshev series, moving least squares or smoothing B-spline
    #[arg(long)]
    method: Method,
    /// Order of the polynomials (poly, chebyshev, mls)
    #[arg(long, default_value_t = 4)]
    order: usize,
    /// Half width of the weight as a share of the measured range, above 0 (mls) [default: 1/3]
    #[arg(long, default_value_t = 1.0 / 3.0, hide_default_value = true)]
    support: f64,
    /// Shape of the Gaussian weight (mls)
    #[arg(long, default_value_t = 3.0)]
    shape: f64,
    /// Choose order and support by the leave-one-out error (mls)
    #[arg(long)]
    auto: bool,
    /// The residual that --auto has to meet, µm for displacements and µrad for rotations
    #[arg(
        long,
        alias = "residual-um",
        requires = "auto",
        value_name = "UM_OR_URAD"
    )]
    residual: Option<f64>,
    /// Coordinates at which to print the curve: 0,100,200
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true)]
    at: Vec<f64>,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Method {
    Poly,
    Chebyshev,
    Mls,
    Bspline,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    if arguments.auto && arguments.method != Method::Mls {
        let message = "--auto: found another method, expected --method mls";
        return Err(Failure::Input(message.to_owned()));
    }
    let numbers = arguments.at.iter().chain(&arguments.residual);
    if let Some(wrong) = numbers.copied().find(|x| !x.is_finite()) {
        return Err(Failure::Input(format!(
            "found {wrong}, expected finite numbers in the call"
        )));
    }
    let mut measurement = read_file(&arguments.data).map_err(|e| reading(&e))?;
    let unit = unit::apply(&arguments.data, &mut measurement, arguments.unit)?;
    let (x, u): (Vec<f64>, Vec<f64>) = measurement.mean_curve().into_iter().unzip();
    let fit = fit(arguments, &x, &u)
        .map_err(|e| Failure::Input(format!("{}: {e}", arguments.data.display())))?;
    let values: Vec<(f64, f64)> = arguments
        .at
        .iter()
        .map(|&at| (at, fit.curve.value(at)))
        .collect();
    let mut notes = measurement.notes;
    if fit.meets_required == Some(false) {
        notes.push(
            "no order and support meets the residual asked for: the best is shown".to_owned(),
        );
    }
    notes.extend(outside_note(&fit.curve, &arguments.at));
    Answer::new(
        &document(&fit, &values, unit)?,
        text(&fit, &values, unit),
        notes,
    )
}

/// A note where the curve is printed outside its range.
fn outside_note(curve: &Curve, at: &[f64]) -> Option<String> {
    let [low, high] = curve.domain()?;
    let outside = at.iter().filter(|at| !curve.contains(**at));
    let outside: Vec<String> = outside.map(f64::to_string).collect();
    (!outside.is_empty()).then(|| {
        format!(
            "--at {}: outside the measured range, {low} to {high}: the values there are those at its ends",
            outside.join(",")
        )
    })
}

/// A file that cannot be read is as wrong as one with wrong contents: it was named in the call.
pub(super) fn reading(error: &MetrologyError) -> Failure {
    Failure::from(error)
}

fn fit(arguments: &Arguments, x: &[f64], u: &[f64]) -> Result<Fit, FitError> {
    // Targets come sorted; an empty measurement is refused by its reader.
    let domain = [
        x.first().copied().unwrap_or(0.0),
        x.last().copied().unwrap_or(0.0),
    ];
    let order = arguments.order;
    match arguments.method {
        Method::Poly => fit_polynomial(x, u, order, domain),
        Method::Chebyshev => fit_chebyshev(x, u, order, domain),
        Method::Bspline => fit_bspline(x, u),
        Method::Mls if arguments.auto => fit_mls_auto(x, u, arguments.shape, arguments.residual),
        Method::Mls => fit_mls(x, u, order, arguments.support, arguments.shape),
    }
}

fn document(fit: &Fit, values: &[(f64, f64)], unit: DeviationUnit) -> Result<Document, Failure> {
    let angular = unit == DeviationUnit::Urad;
    let residual = Spread {
        min: fit.min(),
        max: fit.max(),
        rms: fit.rms(),
    };
    let point = |&(at, value)| Point {
        at,
        value_um: (!angular).then_some(value),
        value_urad: angular.then_some(value),
        outside_range: !fit.curve.contains(at),
    };
    Ok(Document {
        curve: curve_json(&fit.curve)?,
        residual_um: (!angular).then_some(residual),
        residual_urad: angular.then_some(residual),
        leave_one_out_um: (!angular).then_some(fit.leave_one_out_rms),
        leave_one_out_urad: angular.then_some(fit.leave_one_out_rms),
        values: values.iter().map(point).collect(),
        meets_required: fit.meets_required,
    })
}

/// The curve as the machine file has it, in JSON: read back from what would be written there.
fn curve_json(curve: &Curve) -> Result<Value, Failure> {
    let text = format!("curve = {}", write_curve(curve));
    let table: toml::Table = text
        .parse()
        .map_err(|e| Failure::Work(format!("{text}: {e}")))?;
    serde_json::to_value(&table["curve"]).map_err(|e| Failure::Work(e.to_string()))
}

fn text(fit: &Fit, values: &[(f64, f64)], unit: DeviationUnit) -> String {
    let symbol = match unit {
        DeviationUnit::Urad => "µrad",
        DeviationUnit::Um => "µm",
    };
    let leave_one_out = if fit.leave_one_out_rms.is_finite() {
        format!("{} {symbol}", fixed(fit.leave_one_out_rms, 3))
    } else {
        "not defined, the curve needs every target".to_owned()
    };
    let mut text = format!(
        "{}\nresidual {} to {} {symbol}, rms {} {symbol}; LOO error {leave_one_out}\n",
        write_curve(&fit.curve),
        fixed(fit.min(), 3),
        fixed(fit.max(), 3),
        fixed(fit.rms(), 3),
    );
    if !values.is_empty() {
        let mut table = table(&["at", symbol]);
        for (at, value) in values {
            table.add_row([format!("{at}"), format!("{value:.3}")]);
        }
        text += "\n";
        text += &table_text(&table);
    }
    text
}
