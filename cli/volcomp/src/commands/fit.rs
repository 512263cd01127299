use std::{fmt::Write as _, path::PathBuf};

use clap::ValueEnum;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use volcomp_calibrate::{fit_readings, noise_of_mean};
use volcomp_curve::Curve;
use volcomp_fit::{
    BandSource, Between, Choice, Fit, FitError, MLS_ORDERS, MlsTrial, fit_bspline, fit_chebyshev,
    fit_cubic_table, fit_mls, fit_mls_auto, fit_polynomial, scan_mls,
};
use volcomp_metrology::{DeviationUnit, Measurement, axis_kind, read_file};
use volcomp_model::write_curve;
use volcomp_report::curve_picture;
use volcomp_vocabulary::AxisKind;

use super::{Answer, fixed, table, table_text};
use crate::{
    arguments::{self, Unit},
    failure::Failure,
    output::PlotArguments,
    table::{folded, to_the_left},
};

/// Fit a curve to the mean deviation at each target
///
/// If the targets of a rotary axis (head `target_deg`, or axis named in the file) cover a full turn, the curve must
/// close: a Fourier series, a constant, or a table if the last reading equals the first. `calibrate` decides by the
/// travel of the axis instead. With one run the confidence band of --method auto does not cover changes from run to run.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp fit exx.rtl
  volcomp fit exx.rtl --method chebyshev --order 5 --at 0,4000")]
pub(crate) struct FitArguments {
    /// Measurement file: .csv, .rtl, .rta
    data: PathBuf,
    /// Unit of deviations that the file (.csv) does not state; results are in µm or µrad [default: µm; µrad for tilts with
    /// --bridge-mm]
    #[arg(long)]
    unit: Option<Unit>,
    /// Kind of curve
    #[arg(long, default_value = "auto")]
    method: Method,
    /// Order of the polynomials (poly, chebyshev, mls) [default: 4]
    #[arg(long)]
    order: Option<usize>,
    /// Half width of the weight as a share of the range, at most 1 (mls) [default: 1/3]
    #[arg(long)]
    support: Option<f64>,
    /// Shape of the Gaussian weight (mls) [default: 3]
    #[arg(long)]
    shape: Option<f64>,
    /// Choose order and support by leave-one-out error (mls)
    #[arg(long, conflicts_with_all = ["order", "support"])]
    auto: bool,
    /// Largest residual allowed with --auto or --method auto, µm or µrad
    #[arg(long, alias = "residual-um", value_name = "UM_OR_URAD")]
    residual: Option<f64>,
    /// Show residual and leave-one-out error of every candidate of --auto (mls); x: none
    #[arg(long)]
    scan: bool,
    /// Coordinates at which to print the curve: 0,100,200
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true)]
    at: Vec<f64>,
    #[command(flatten)]
    plot: PlotArguments,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Method {
    /// chosen among these, and Fourier series over a full turn; with a 95 % band
    Auto,
    /// polynomial
    #[value(alias = "polynomial")]
    Poly,
    /// Chebyshev series
    Chebyshev,
    /// moving least squares
    Mls,
    /// smoothing B-spline
    Bspline,
    /// monotone cubics through the means
    Table,
}

/// The document of `volcomp fit`. A file in µm fills the keys that end in `_um`, one in µrad those in `_urad`; values without
/// such an ending are in `unit`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct FittedCurve {
    /// The unit of the readings.
    unit: DeviationUnit,
    /// The fitted curve, as in a machine file.
    curve: Value,
    /// Readings minus curve, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    residual_um: Option<Spread>,
    /// Readings minus curve, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    residual_urad: Option<Spread>,
    /// Root mean square of the leave-one-out errors, µm; missing if a target cannot be predicted
    /// from the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    leave_one_out_um: Option<f64>,
    /// Root mean square of the leave-one-out errors, µrad; missing if a target cannot be predicted
    /// from the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    leave_one_out_urad: Option<f64>,
    /// Values of the curve at the coordinates of `--at`.
    values: Vec<Point>,
    /// Whether the curve meets the residual of `--residual`; only with `--auto --residual`.
    #[serde(skip_serializing_if = "Option::is_none")]
    meets_required: Option<bool>,
    /// Orders and supports of moving least squares that the targets permit; only with `--scan`.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan: Option<Vec<MlsTrial>>,
    /// Choice of the kind of curve; only with `--method auto`.
    #[serde(skip_serializing_if = "Option::is_none")]
    choice: Option<Choice>,
    /// Pointwise 95 % confidence band; only with `--method auto`, missing if unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    band: Option<Band>,
}

/// Range and root mean square of the residuals (readings minus curve), in the unit of the key.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
struct Spread {
    /// The smallest residual, with its sign.
    min: f64,
    /// The largest residual, with its sign.
    max: f64,
    /// Root mean square of the residuals.
    rms: f64,
}

/// The curve at one coordinate.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
struct Point {
    /// The coordinate, mm or deg.
    at: f64,
    /// Value of the curve, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    value_um: Option<f64>,
    /// Value of the curve, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    value_urad: Option<f64>,
    /// Whether the coordinate is outside the measured range. The value is then that at the end of
    /// the range.
    outside_range: bool,
}

/// A 95 % confidence band about the curve.
#[derive(Debug, Serialize, JsonSchema)]
struct Band {
    /// Resampled quantities: `runs`, or the `residuals` of a single run.
    from: BandSource,
    /// Half widths at each target and at places between targets, interpolated linearly.
    half_widths: Vec<HalfWidth>,
}

/// Half width of a band at one coordinate.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
struct HalfWidth {
    /// Coordinate, mm or deg.
    at: f64,
    /// Half width, in `unit` of the document.
    half_width: f64,
}

impl Band {
    fn new(band: volcomp_fit::Band) -> Self {
        Self {
            from: band.source,
            half_widths: (band.at.into_iter().zip(band.half_width))
                .map(|(at, half_width)| HalfWidth { at, half_width })
                .collect(),
        }
    }
}

impl FitArguments {
    fn shape(&self) -> f64 {
        self.shape.unwrap_or(3.0)
    }
}

pub(crate) fn run(arguments: &FitArguments) -> Result<Answer, Failure> {
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
    let has_order = matches!(arguments.method, Method::Poly | Method::Chebyshev | Method::Mls);
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
        return Err(Failure::Input(format!("found {wrong}, expected finite numbers in the call")));
    }
    let plot = (arguments.plot).open(&[(&arguments.data, "the readings")])?;
    let mut measurement = read_file(&arguments.data)?;
    measurement.check_directions()?;
    measurement.check_lines_of_runs()?;
    let unit = arguments::apply(&arguments.data, &mut measurement, arguments.unit)?;
    let (x, u): (Vec<f64>, Vec<f64>) = measurement.mean_curve().into_iter().unzip();
    let failed = |e: FitError| Failure::Input(format!("{}: {e}", arguments.data.display()));
    let (fit, auto) = fit(arguments, &measurement, (&x, &u)).map_err(failed)?;
    let trials = arguments.scan.then(|| scan_mls(&x, &u, arguments.shape()));
    let scan = trials.transpose().map_err(failed)?;
    let noise = noise_of_mean(&measurement);
    let (kind, axis) = (axis_kind(&measurement), measurement.metadata.axis.clone());
    let mut notes = measurement.notes.clone();
    let tolerances_met = fit.meets_required != Some(false);
    if !tolerances_met {
        let what = if auto.is_some() { "kind of curve" } else { "order and support" };
        notes.push(format!("no {what} meets the requested residual: the best is shown"));
    }
    let between = Between::of(&fit, &x, &u, noise);
    let of_choice = auto.as_ref().and_then(|(choice, _)| choice.not_followed(&unit.to_string()));
    notes.extend(of_choice.or_else(|| between.not_followed(&unit.to_string())));
    let along = kind.map_or("mm or deg", AxisKind::coordinate_unit);
    let file = arguments.data.display();
    let of_axis = axis.map_or(String::new(), |axis| format!("axis {axis}: "));
    let said = between.warnings(&unit.to_string(), along).into_iter();
    notes.extend(said.map(|said| format!("{file}: {of_axis}{said}")));
    notes.extend(outside_note(&fit.curve, &arguments.at));
    let mut text = text(&fit, &arguments.at, unit);
    if let Some(trials) = &scan {
        text += &scan_text(trials, &fit.curve, unit);
    }
    if let Some((choice, band)) = &auto {
        text += &choice_text(choice, band.as_ref(), unit);
    }
    let (choice, band) = auto.unzip();
    let band = band.flatten();
    if let Some(plot) = plot {
        plot.write(&picture(arguments, &measurement, (&fit, band.as_ref()), unit))?;
    }
    let document = FittedCurve { scan, choice, band, ..document(&fit, &arguments.at, unit)? };
    Ok(Answer { tolerances_met, ..Answer::new(&document, text, notes)? })
}

fn picture(
    arguments: &FitArguments,
    measurement: &Measurement,
    (fit, band): (&Fit, Option<&Band>),
    unit: DeviationUnit,
) -> String {
    let file = arguments.data.display().to_string();
    let kind = axis_kind(measurement).unwrap_or(AxisKind::Linear);
    let symbol = unit.to_string();
    let halves = |band: &Band| {
        let halves = band.half_widths.iter().map(|of| [of.at, of.half_width]);
        (band.from, halves.collect())
    };
    let curve = volcomp_report::Curve::of_fit(
        file.clone(),
        kind.coordinate_unit().to_owned(),
        symbol.clone(),
        measurement,
        |at| fit.curve.value(at),
        band.map(halves),
    );
    let residual = format!(
        "residual {} to {} {symbol}, rms {} {symbol}",
        fixed(fit.min(), 3),
        fixed(fit.max(), 3),
        fixed(fit.rms(), 3)
    );
    let title = format!("Curve ({}) through the mean deviations", fit.curve.kind());
    curve_picture(&title, &[file, residual], &curve)
}

/// Cell of the table for a target that cannot be predicted from the others.
const NOT_PREDICTED: &str = "x";

/// Formats two tables: the largest residual, and the leave-one-out error. Each has one row per support and one column
/// per order.
fn scan_text(trials: &[MlsTrial], curve: &Curve, unit: DeviationUnit) -> String {
    let mut supports: Vec<f64> = trials.iter().map(|trial| trial.support).collect();
    supports.sort_by(f64::total_cmp);
    supports.dedup();
    let is_shown = |trial: &MlsTrial| match curve {
        Curve::MovingLeastSquares(curve) => {
            curve.order() == trial.order && (curve.support() - trial.support).abs() < 1e-9
        }
        _ => false,
    };
    let mut text = String::new();
    for (title, is_residual) in [("Largest residual", true), ("Leave-one-out error", false)] {
        let value = |trial: &MlsTrial| {
            if is_residual { trial.max_residual } else { trial.leave_one_out_rms }
        };
        let orders = MLS_ORDERS.map(|order| match order {
            1 => "order 1".to_owned(),
            _ => order.to_string(),
        });
        let heads: Vec<String> = std::iter::once("support".to_owned()).chain(orders).collect();
        let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
        let mut rows = table(&heads);
        for &support in &supports {
            let cell = |order: usize| {
                let mut trials = trials.iter();
                let trial = trials.find(|t| t.order == order && t.support == support);
                trial.map_or("-".to_owned(), |trial| {
                    let mark = if is_shown(trial) { "*" } else { "" };
                    let shown = match value(trial) {
                        value if value.is_finite() => fixed(value, 2),
                        _ => NOT_PREDICTED.to_owned(),
                    };
                    mark.to_owned() + &shown
                })
            };
            let cells = MLS_ORDERS.map(cell);
            rows.add_row([fixed(support, 3)].into_iter().chain(cells));
        }
        let _ = write!(text, "\n{title}, {unit}\n{}", table_text(&rows));
    }
    text += "\n* the curve above; - too few targets within the support\n";
    if trials.iter().any(|trial| !trial.leave_one_out_rms.is_finite()) {
        text += &folded(
            &format!(
                "{NOT_PREDICTED} no leave-one-out error: somewhere the curve goes through a target, since the others within its support hardly weigh there; such a setting is never chosen"
            ),
            "",
        );
    }
    text
}

/// Note on coordinates in `at` outside the range of the curve; `None` if all are inside.
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

type Chosen = (Choice, Option<Band>);

/// Fits a curve to the means `u` at `x`. Also returns the choice if the method was chosen automatically.
fn fit(
    arguments: &FitArguments,
    measurement: &Measurement,
    (x, u): (&[f64], &[f64]),
) -> Result<(Fit, Option<Chosen>), FitError> {
    // Targets are sorted and not empty, because the reader rejects an empty measurement.
    let domain = [x.first().copied().unwrap_or(0.0), x.last().copied().unwrap_or(0.0)];
    let (order, shape) = (arguments.order.unwrap_or(4), arguments.shape());
    let fit = match arguments.method {
        Method::Auto => {
            let found = fit_readings(measurement, arguments.residual)?;
            let chosen = (found.choice, found.band.map(Band::new));
            return Ok((found.fit, Some(chosen)));
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

fn document(fit: &Fit, at: &[f64], unit: DeviationUnit) -> Result<FittedCurve, Failure> {
    let angular = unit == DeviationUnit::Urad;
    let residual = Spread { min: fit.min(), max: fit.max(), rms: fit.rms() };
    let point = |&at: &f64| {
        let value = fit.curve.value(at);
        Point {
            at,
            value_um: (!angular).then_some(value),
            value_urad: angular.then_some(value),
            outside_range: !fit.curve.contains(at),
        }
    };
    let left_out = Some(fit.leave_one_out_rms).filter(|error| error.is_finite());
    Ok(FittedCurve {
        unit,
        curve: curve_json(&fit.curve)?,
        residual_um: (!angular).then_some(residual),
        residual_urad: angular.then_some(residual),
        leave_one_out_um: left_out.filter(|_| !angular),
        leave_one_out_urad: left_out.filter(|_| angular),
        values: at.iter().map(point).collect(),
        meets_required: fit.meets_required,
        scan: None,
        choice: None,
        band: None,
    })
}

fn curve_json(curve: &Curve) -> Result<Value, Failure> {
    let text = format!("curve = {}", write_curve(curve));
    let table: toml::Table = text.parse().map_err(|e| Failure::Work(format!("{text}: {e}")))?;
    serde_json::to_value(&table["curve"]).map_err(|e| Failure::Work(e.to_string()))
}

fn text(fit: &Fit, at: &[f64], unit: DeviationUnit) -> String {
    let symbol = &unit.to_string();
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
    if !at.is_empty() {
        let mut table = table(&["at", symbol]);
        for &at in at {
            table.add_row([at.to_string(), format!("{:.3}", fit.curve.value(at))]);
        }
        text += "\n";
        text += &table_text(&table);
    }
    text
}

fn choice_text(choice: &Choice, band: Option<&Band>, unit: DeviationUnit) -> String {
    let symbol = unit.to_string();
    let mut text = format!("\nchosen: {} ({})\n", choice.method, choice.reason);
    if let Some(band) = band {
        let halves = || band.half_widths.iter().map(|of| of.half_width);
        let from = if band.from == BandSource::Runs {
            "from the scatter of the runs"
        } else {
            "from the residuals of one run, in which nothing shows that changes from run to run"
        };
        text += &folded(
            &format!(
                "95 % band: ±{} to ±{} {symbol} at and between the targets, {from}",
                fixed(halves().fold(f64::INFINITY, f64::min), 3),
                fixed(halves().fold(0.0, f64::max), 3),
            ),
            "",
        );
    }
    let error = format!("LOO error, {symbol}");
    let residual = "largest residual";
    let mut rows = table(&["best of each kind", "coefficients", &error, residual, ""]);
    to_the_left(&mut rows, &[4]);
    let mut best = choice.best_of_kinds();
    if let Some(chosen) = choice.chosen() {
        // The chosen candidate represents its kind, even if a more complex candidate of the kind has a slightly smaller
        // error.
        for score in &mut best {
            if score.method.kind() == chosen.method.kind() {
                *score = *chosen;
            }
        }
    }
    for score in best {
        let mut said = Vec::new();
        if score.method == choice.method {
            said.push("chosen");
        }
        if score.swings {
            said.push("swings between targets");
        }
        if !score.follows {
            said.push("does not follow the readings");
        }
        rows.add_row([
            score.method.to_string(),
            fixed(score.coefficients, 1),
            if score.leave_one_out_rms.is_finite() {
                fixed(score.leave_one_out_rms, 3)
            } else {
                "-".to_owned()
            },
            fixed(score.largest_residual, 3),
            said.join(", "),
        ]);
    }
    text + "\n" + &table_text(&rows)
}
