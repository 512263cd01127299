//! `volcomp fit`: readings to a curve of the machine file.

use std::{fmt::Write as _, path::PathBuf};

use clap::ValueEnum;
use serde_json::Value;
use volcomp_curve::Curve;
use volcomp_fit::{
    Between, Choice, Fit, FitError, MLS_ORDERS, MlsTrial, fit_bspline, fit_chebyshev,
    fit_cubic_table, fit_mls, fit_mls_auto, fit_polynomial, scan_mls,
};
use volcomp_metrology::{DeviationUnit, Measurement, MetrologyError, axis_kind, read_file};
use volcomp_model::write_curve;
use volcomp_vocabulary::AxisKind;

use super::{Answer, fit_auto, fixed, table, table_text};
use crate::{
    answers::fit::{Band, Fit as Document, Point, Spread, Trial},
    failure::Failure,
    table::folded,
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
    /// Kind of curve
    #[arg(long)]
    method: Method,
    /// Order of the polynomials (poly, chebyshev, mls) [default: 4]
    #[arg(long)]
    order: Option<usize>,
    /// Half width of the weight as a share of the measured range, above 0 and at most 1 (mls) [default: 1/3]
    #[arg(long)]
    support: Option<f64>,
    /// Shape of the Gaussian weight (mls) [default: 3]
    #[arg(long)]
    shape: Option<f64>,
    /// Choose order and support by the leave-one-out error (mls)
    #[arg(long, conflicts_with_all = ["order", "support"])]
    auto: bool,
    /// The residual that --auto or --method auto has to meet, µm for displacements and µrad for rotations
    #[arg(long, alias = "residual-um", value_name = "UM_OR_URAD")]
    residual: Option<f64>,
    /// Show residual and leave-one-out error of every order and support that --auto chooses from (mls)
    #[arg(long)]
    scan: bool,
    /// Coordinates at which to print the curve: 0,100,200
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true)]
    at: Vec<f64>,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Method {
    /// Chooses among the others, and over a whole turn of a rotary axis among Fourier series; prints the candidates and a band of 95 %
    Auto,
    /// Polynomial in powers of the coordinate
    #[value(alias = "polynomial")]
    Poly,
    /// Chebyshev series
    Chebyshev,
    /// Moving least squares
    Mls,
    /// Smoothing B-spline, which chooses its own smoothness
    Bspline,
    /// Monotone cubics through the means of the targets
    Table,
}

impl Arguments {
    fn shape(&self) -> f64 {
        self.shape.unwrap_or(3.0)
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    for (asked, option) in [
        (arguments.auto, "--auto"),
        (arguments.scan, "--scan"),
        (arguments.support.is_some(), "--support"),
        (arguments.shape.is_some(), "--shape"),
    ] {
        if asked && arguments.method != Method::Mls {
            let message = format!("{option}: found another method, expected --method mls");
            return Err(Failure::Input(message));
        }
    }
    let has_order = matches!(
        arguments.method,
        Method::Poly | Method::Chebyshev | Method::Mls
    );
    if arguments.order.is_some() && !has_order {
        let found = arguments.method.to_possible_value();
        let found = found.map_or(String::new(), |value| value.get_name().to_owned());
        return Err(Failure::Input(format!(
            "--order: found --method {found}, which has none to state: expected --method poly, chebyshev or mls"
        )));
    }
    let chooses = arguments.auto || arguments.method == Method::Auto;
    if arguments.residual.is_some() && !chooses {
        return Err(Failure::input(
            "--residual: found without a choice to make, expected it with --method auto, or --method mls --auto",
        ));
    }
    let numbers = arguments.at.iter().chain(&arguments.residual);
    if let Some(wrong) = numbers.copied().find(|x| !x.is_finite()) {
        return Err(Failure::Input(format!(
            "found {wrong}, expected finite numbers in the call"
        )));
    }
    let mut measurement = read_file(&arguments.data).map_err(|e| reading(&e))?;
    measurement.check_directions().map_err(|e| reading(&e))?;
    let unit = unit::apply(&arguments.data, &mut measurement, arguments.unit)?;
    let (x, u): (Vec<f64>, Vec<f64>) = measurement.mean_curve().into_iter().unzip();
    let failed = |e: FitError| Failure::Input(format!("{}: {e}", arguments.data.display()));
    let (fit, auto) = fit(arguments, &measurement, (&x, &u), unit).map_err(failed)?;
    let trials = arguments.scan.then(|| scan_mls(&x, &u, arguments.shape()));
    let scan = match trials {
        Some(trials) => Some(scan(&trials.map_err(failed)?, &fit.curve, unit)),
        None => None,
    };
    let values: Vec<(f64, f64)> = arguments
        .at
        .iter()
        .map(|&at| (at, fit.curve.value(at)))
        .collect();
    let noise = fit_auto::noise_of_mean(&measurement);
    let (kind, axis) = (axis_kind(&measurement), measurement.metadata.axis);
    let mut notes = measurement.notes;
    if fit.meets_required == Some(false) {
        let what = if auto.is_some() {
            "kind of curve"
        } else {
            "order and support"
        };
        notes.push(format!(
            "no {what} meets the residual asked for: the best is shown"
        ));
    }
    let between = Between::of(&fit, &x, &u, noise);
    let of_choice = auto
        .as_ref()
        .and_then(|(choice, _)| choice.not_followed(&unit.to_string()));
    notes.extend(of_choice.or_else(|| between.not_followed(&unit.to_string())));
    let along = kind.map_or("mm or deg", AxisKind::coordinate_unit);
    let file = arguments.data.display();
    let of_axis = axis.map_or(String::new(), |axis| format!("axis {axis}: "));
    let said = between.warnings(&unit.to_string(), along).into_iter();
    notes.extend(said.map(|said| format!("{file}: {of_axis}{said}")));
    notes.extend(outside_note(&fit.curve, &arguments.at));
    let mut more = scan.as_deref().map_or(String::new(), scan_text);
    if let Some((choice, band)) = &auto {
        more += &fit_auto::text(choice, band.as_ref(), unit);
    }
    let (choice, band) = auto.unzip();
    let document = Document {
        scan,
        choice: choice.map(|choice| fit_auto::document(&choice, unit)),
        band: band.flatten(),
        ..document(&fit, &values, unit)?
    };
    Answer::new(&document, text(&fit, &values, unit) + &more, notes)
}

/// The settings of a scan as the document has them.
fn scan(trials: &[MlsTrial], curve: &Curve, unit: DeviationUnit) -> Vec<Trial> {
    let angular = unit == DeviationUnit::Urad;
    let is_shown = |trial: &MlsTrial| match curve {
        Curve::MovingLeastSquares(curve) => {
            curve.order() == trial.order && (curve.support() - trial.support).abs() < 1e-9
        }
        _ => false,
    };
    let row = |trial: &MlsTrial| {
        let left_out = Some(trial.leave_one_out_rms).filter(|error| error.is_finite());
        Trial {
            order: trial.order,
            support: trial.support,
            largest_residual_um: (!angular).then_some(trial.max_residual),
            largest_residual_urad: angular.then_some(trial.max_residual),
            leave_one_out_um: left_out.filter(|_| !angular),
            leave_one_out_urad: left_out.filter(|_| angular),
            shown: is_shown(trial),
        }
    };
    trials.iter().map(row).collect()
}

/// Stands in the table where a target cannot be predicted from the others.
const NOT_PREDICTED: &str = "x";

/// Two tables, of the largest residual and of the leave-one-out error, a row for each support and a column for each
/// order.
fn scan_text(trials: &[Trial]) -> String {
    let mut supports: Vec<f64> = trials.iter().map(|trial| trial.support).collect();
    supports.sort_by(f64::total_cmp);
    supports.dedup();
    let symbol = if trials.iter().any(|t| t.largest_residual_urad.is_some()) {
        "µrad"
    } else {
        "µm"
    };
    let mut text = String::new();
    for (title, is_residual) in [("Largest residual", true), ("Leave-one-out error", false)] {
        let value = |t: &Trial| {
            if is_residual {
                t.largest_residual_um.or(t.largest_residual_urad)
            } else {
                t.leave_one_out()
            }
        };
        let orders = MLS_ORDERS.map(|order| match order {
            1 => "order 1".to_owned(),
            _ => order.to_string(),
        });
        let heads: Vec<String> = std::iter::once("support".to_owned())
            .chain(orders)
            .collect();
        let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
        let mut rows = table(&heads);
        for &support in &supports {
            let cell = |order: usize| {
                let mut trials = trials.iter();
                let trial = trials.find(|t| t.order == order && t.support == support);
                let shown = trial.map_or(String::new(), |trial| {
                    let mark = if trial.shown { "*" } else { "" };
                    let shown = match value(trial) {
                        Some(value) if value.is_finite() => fixed(value, 2),
                        _ => NOT_PREDICTED.to_owned(),
                    };
                    mark.to_owned() + &shown
                });
                if shown.is_empty() {
                    "-".to_owned()
                } else {
                    shown
                }
            };
            let cells = MLS_ORDERS.map(cell);
            rows.add_row([fixed(support, 3)].into_iter().chain(cells));
        }
        // Writing to a string never fails.
        let _ = write!(text, "\n{title}, {symbol}\n{}", table_text(&rows));
    }
    text += "\n* the curve above; - too few targets within the support\n";
    if trials.iter().any(|trial| trial.leave_one_out().is_none()) {
        text += &folded(
            &format!(
                "{NOT_PREDICTED} no leave-one-out error: somewhere the curve goes through a target, since the others within its support hardly weigh there; such a setting is never chosen"
            ),
            "",
        );
    }
    text
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

/// How a curve was chosen, and how far the true one may be from it.
type Chosen = (Choice, Option<Band>);

/// The curve through the means `u` at `x`, and how it was chosen where it was.
fn fit(
    arguments: &Arguments,
    measurement: &Measurement,
    (x, u): (&[f64], &[f64]),
    unit: DeviationUnit,
) -> Result<(Fit, Option<Chosen>), FitError> {
    // Targets come sorted; an empty measurement is refused by its reader.
    let domain = [
        x.first().copied().unwrap_or(0.0),
        x.last().copied().unwrap_or(0.0),
    ];
    let (order, shape) = (arguments.order.unwrap_or(4), arguments.shape());
    let fit = match arguments.method {
        Method::Auto => {
            let found = fit_auto::auto(measurement, x, u, arguments.residual, unit)?;
            return Ok((found.fit, Some((found.choice, found.band))));
        }
        Method::Poly => fit_polynomial(x, u, order, domain),
        Method::Chebyshev => fit_chebyshev(x, u, order, domain),
        Method::Bspline => fit_bspline(x, u),
        Method::Table => fit_cubic_table(x, u),
        Method::Mls if arguments.auto => fit_mls_auto(x, u, shape, arguments.residual),
        Method::Mls => fit_mls(x, u, order, arguments.support.unwrap_or(1.0 / 3.0), shape),
    };
    Ok((fit?, None))
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
    let left_out = Some(fit.leave_one_out_rms).filter(|error| error.is_finite());
    Ok(Document {
        curve: curve_json(&fit.curve)?,
        residual_um: (!angular).then_some(residual),
        residual_urad: angular.then_some(residual),
        leave_one_out_um: left_out.filter(|_| !angular),
        leave_one_out_urad: left_out.filter(|_| angular),
        values: values.iter().map(point).collect(),
        meets_required: fit.meets_required,
        scan: None,
        choice: None,
        band: None,
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
