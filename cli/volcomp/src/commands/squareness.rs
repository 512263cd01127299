use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_metrology::{
    DeviationUnit, LARGEST_PLAUSIBLE, ReferenceKind, ReferenceLine, SlopeUncertainty,
    SquarenessInputs, SquarenessUncertainty, StandardQuantity, judged, opening, squareness,
    squareness_of_lengths, squareness_parts, squareness_uncertainty, straightness_of,
};
use volcomp_report::{SlopePlot, SquarenessPlot, squareness_picture};
use volcomp_vocabulary::{AxisName, ErrorName, Urad};

use super::{
    Answer,
    evaluation::{Judgement, decision_text, quantities_text, tolerances},
    fixed,
    straightness::{Reference, key, odd, read},
    table, table_text,
};
use crate::{
    arguments::{Unit, three},
    failure::Failure,
    output::PlotArguments,
};

/// Calculate the squareness of two axes from two straightness files, or from the lengths of a printed square
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp squareness straight-exy.csv straight-eyx.csv --error EC0Y
  volcomp squareness --lengths 141.36,141.53,100 --error EC0Y")]
pub(crate) struct SquarenessArguments {
    /// Straightness file of the later axis of the error: EXY for EC0Y, EYZ for EA0Z, EXZ for EB0Z
    #[arg(required_unless_present = "lengths", conflicts_with = "lengths")]
    first: Option<PathBuf>,
    /// Straightness file of the other axis: EYX, EZY, EZX
    #[arg(required_unless_present = "lengths", conflicts_with = "lengths")]
    second: Option<PathBuf>,
    /// Instead of files: diagonals AC and BD and side AD of a printed square, mm; corner A at the low ends of both axes,
    /// C opposite
    #[arg(
        long,
        value_name = "AC,BD,AD",
        conflicts_with_all = ["reference_angle_urad", "reference", "unit", "square_urad", "straight_edge_um", "temperature_urad", "plot"]
    )]
    lengths: Option<String>,
    /// Squareness error: EC0Y, EA0Z or EB0Z
    #[arg(long)]
    error: ErrorName,
    /// Angle between the + directions of the reference beams, less 90°, µrad; 0 for a perfect optical square
    #[arg(long, value_name = "URAD", default_value_t = 0.0, allow_hyphen_values = true)]
    reference_angle_urad: f64,
    /// Line whose slope counts
    #[arg(long, default_value = "least-squares")]
    reference: Reference,
    /// Unit of deviations that the file (.csv) does not state; results are in µm or µrad [default: µm; µrad for tilts with
    /// --bridge-mm]
    #[arg(long)]
    unit: Option<Unit>,
    /// Calibration uncertainty of the square (k = 2), µrad
    #[arg(long, value_name = "URAD")]
    square_urad: Option<f64>,
    /// Calibration uncertainty of the straight edge or straightness optics at any place (k = 2), µm
    #[arg(long, value_name = "UM")]
    straight_edge_um: Option<f64>,
    /// Range of the angle with temperature, over a time as long as the measurement, µrad
    #[arg(long, value_name = "URAD")]
    temperature_urad: Option<f64>,
    /// Limit, µrad: squareness=20
    #[arg(long, value_name = "LIMIT")]
    tolerance: Option<String>,
    #[command(flatten)]
    plot: PlotArguments,
}

/// The squareness of two axes, with its tolerance.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct SquarenessTest {
    /// The squareness error: `EC0Y`, `EA0Z` or `EB0Z`.
    error: String,
    /// The two straightness errors with their files and slopes.
    parts: [SquarenessPart; 2],
    /// Angle between the reference beams minus 90°, µrad.
    reference_angle_urad: f64,
    /// Kind of reference line of the slopes.
    reference: &'static str,
    /// Squareness error, µrad, positive by the right-hand rule.
    squareness_urad: f64,
    /// Expanded uncertainty for 95.45 % (the probability of k = 2) from the known contributions,
    /// µrad; null if a file has one run of two targets, or with a reference line other than least
    /// squares.
    uncertainty_urad: Option<f64>,
    /// Contributions to `uncertainty_urad`; null if that is null.
    uncertainty: Option<SquarenessUncertainty>,
    /// The squareness with its tolerance.
    #[serde(flatten)]
    judgement: Judgement,
}

/// One of the two straightness lines.
#[derive(Debug, Serialize, JsonSchema)]
struct SquarenessPart {
    /// The straightness error: `EXY`.
    error: String,
    /// Path as named in the call.
    file: String,
    /// Slope of the reference line of the straightness error, µrad.
    slope_urad: f64,
}

const SYMBOL: &str = "squareness";
/// Note of every result from files: the tilts at the positions of the lines are not removed.
const PLACES: &str = "the squareness holds where the lines were measured: tilts of the other axes there, and those of the measured axis over its Abbe offset, are not removed and not in U; `volcomp calibrate` removes them";

/// The squareness by the lengths of a square, with its tolerance.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct SquareTest {
    /// The squareness error: `EC0Y`, `EA0Z` or `EB0Z`.
    error: String,
    /// Diagonals AC and BD and side AD, mm.
    lengths_mm: [f64; 3],
    /// Squareness error, µrad, positive by the right-hand rule.
    squareness_urad: f64,
    /// Change of `squareness_urad` by 0.01 mm more in AC, µrad.
    per_hundredth_mm_urad: f64,
    /// The squareness with its tolerance.
    #[serde(flatten)]
    judgement: Judgement,
}

fn of_lengths(arguments: &SquarenessArguments, lengths: &str) -> Result<Answer, Failure> {
    let tolerances = tolerances(arguments.tolerance.as_deref(), &[SYMBOL])?;
    let [ac, bd, ad] = three("--lengths", lengths)?;
    let value = squareness_of_lengths(arguments.error, [ac, bd, ad])?.0;
    let longer = squareness_of_lengths(arguments.error, [ac + 0.01, bd, ad])?.0;
    let notes = vec![format!(
        "0.01 mm more in one diagonal changes the result by {} µrad; print without skew correction (SET_SKEW CLEAR=1, M852 I0 J0 K0)",
        fixed((longer - value).abs(), 0)
    )];
    let quantity = StandardQuantity {
        symbol: SYMBOL,
        name: "squareness by the diagonals of a square",
        value: Some(value),
    };
    let quantities =
        judged("volcomp", [quantity], DeviationUnit::Urad, &tolerances, |_: &str| None);
    let judgement = Judgement::new(quantities, notes);
    let document = SquareTest {
        error: arguments.error.to_string(),
        lengths_mm: [ac, bd, ad],
        squareness_urad: value,
        per_hundredth_mm_urad: longer - value,
        judgement: judgement.clone(),
    };
    let text = format!(
        "squareness {}, µrad, by the diagonals of a square\n\n{}{}",
        document.error,
        quantities_text(&document.judgement.quantities, true),
        decision_text(&document.judgement)
    );
    Ok(Answer::new(&document, text, judgement.notes)?.decided(judgement.decision))
}

pub(crate) fn run(arguments: &SquarenessArguments) -> Result<Answer, Failure> {
    if let Some(lengths) = &arguments.lengths {
        return of_lengths(arguments, lengths);
    }
    let (Some(first), Some(second)) = (&arguments.first, &arguments.second) else {
        return Err(Failure::Input("expected two files, or --lengths".to_owned()));
    };
    of_files(arguments, [first, second])
}

fn of_files(arguments: &SquarenessArguments, paths: [&PathBuf; 2]) -> Result<Answer, Failure> {
    /// Maximum plausible error of an optical square, µrad.
    const LARGEST_ANGLE_URAD: f64 = 1e5;
    let tolerances = tolerances(arguments.tolerance.as_deref(), &[SYMBOL])?;
    let angle = arguments.reference_angle_urad;
    if !(0.0..=LARGEST_ANGLE_URAD).contains(&angle.abs()) {
        return Err(Failure::Input(format!(
            "--reference-angle-urad: found {angle}, expected the difference to 90°, at most 100000 µrad"
        )));
    }
    let parts = squareness_parts(arguments.error)?;
    let kind = arguments.reference.kind();
    if let (Ok(a), Ok(b)) = (paths[0].canonicalize(), paths[1].canonicalize())
        && a == b
    {
        let what = "this is the first file as well, expected the straightness of the other axis";
        return Err(Failure::in_file(paths[1], what));
    }
    let plot = (arguments.plot).open(&paths.map(|path| (path.as_path(), "the readings")))?;
    let mut notes = Vec::new();
    let [first_error, second_error] = parts;
    let first = line(arguments, paths[0], first_error, &mut notes)?;
    let second = line(arguments, paths[1], second_error, &mut notes)?;
    let lines = [&first, &second].map(|line| (line.uncertainty, line.length_mm));
    let slopes = [(first_error, first.slope), (second_error, second.slope)];
    let value = squareness(arguments.error, Urad(angle), slopes)?.0;
    let whole = uncertainty(arguments, kind, &lines)?;
    notes.extend(notes_on(arguments, value, whole.as_ref()));
    notes.extend(one_run([&first, &second]).filter(|_| whole.is_some()));
    notes.push(PLACES.to_owned());
    let uncertainty = whole.as_ref().map(|whole| whole.whole_urad);
    let quantity = StandardQuantity {
        symbol: SYMBOL,
        name: "squareness by the slopes of two straightness lines",
        value: Some(value),
    };
    let u = |_: &str| uncertainty;
    let quantities = judged("ISO 230-1", [quantity], DeviationUnit::Urad, &tolerances, u);
    let judgement = Judgement::new(quantities, notes);
    if let Some(plot) = plot {
        let drawn = picture(arguments.error, value, [&first, &second], &judgement);
        plot.write(&squareness_picture(&drawn))?;
    }
    let document = SquarenessTest {
        error: arguments.error.to_string(),
        parts: [first.part, second.part],
        reference_angle_urad: angle,
        reference: key(kind),
        squareness_urad: value,
        uncertainty_urad: uncertainty,
        uncertainty: whole,
        judgement: judgement.clone(),
    };
    let text = text(&document);
    Ok(Answer::new(&document, text, judgement.notes)?.decided(judgement.decision))
}

struct Line {
    part: SquarenessPart,
    slope: Urad,
    uncertainty: Option<SlopeUncertainty>,
    has_one_run: bool,
    length_mm: f64,
    profile: Vec<(f64, f64)>,
    reference: ReferenceLine,
}

fn picture(
    error: ErrorName,
    value: f64,
    lines: [&Line; 2],
    judgement: &Judgement,
) -> SquarenessPlot {
    let mut axes = [AxisName::X, AxisName::Y, AxisName::Z]
        .into_iter()
        .filter(|axis| axis.mcs_index() != error.component.mcs_index())
        .map(|axis| axis.to_string());
    SquarenessPlot {
        error: error.to_string(),
        axes: [0, 1].map(|_| axes.next().unwrap_or_default()),
        angle_urad: opening(error).unwrap_or(1.0) * value,
        lines: lines.map(|line| SlopePlot {
            error: line.part.error.clone(),
            file: line.part.file.clone(),
            profile: line.profile.clone(),
            line: line.reference,
        }),
        quantities: judgement.quantities.clone(),
    }
}

/// Note that the uncertainty omits a contribution, because a line has only one run; `None` if both lines have several
/// runs.
fn one_run(lines: [&Line; 2]) -> Option<String> {
    let names = lines.iter().filter(|line| line.has_one_run);
    let names: Vec<&str> = names.map(|line| line.part.error.as_str()).collect();
    (!names.is_empty()).then(|| {
        format!(
            "one run of {}: U has the scatter of the readings about the line, not the alignment and drift of the reference, which several runs show",
            names.join(" and ")
        )
    })
}

fn line(
    arguments: &SquarenessArguments,
    path: &Path,
    error: ErrorName,
    notes: &mut Vec<String>,
) -> Result<Line, Failure> {
    let measurement = read(path, arguments.unit)?;
    measurement.check_targets(error.axis)?;
    let stated = measurement.metadata.axis.as_deref();
    if let Some(axis) = stated.and_then(volcomp_metrology::axis_named)
        && axis != error.axis
    {
        let what =
            format!("found axis {axis}, expected the straightness {error} of axis {}", error.axis);
        return Err(Failure::in_file(path, what));
    }
    let found = straightness_of(&measurement)?;
    let odd = odd(&found);
    let said = measurement.notes.iter().chain(&odd);
    notes.extend(said.map(|note| format!("{error}: {note}")));
    let slope = found.of(arguments.reference.kind()).line.slope();
    let ends = found.profile.first().zip(found.profile.last());
    Ok(Line {
        part: SquarenessPart {
            error: error.to_string(),
            file: path.display().to_string(),
            slope_urad: slope.0,
        },
        slope,
        uncertainty: found.slope_uncertainty,
        has_one_run: measurement.most_runs() < 2,
        length_mm: ends.map_or(0.0, |(first, last)| last.0 - first.0),
        reference: found.of(arguments.reference.kind()).line,
        profile: found.profile,
    })
}

fn notes_on(
    arguments: &SquarenessArguments,
    value: f64,
    whole: Option<&SquarenessUncertainty>,
) -> Vec<String> {
    let mut notes = Vec::new();
    match whole {
        Some(whole) if !whole.left_out.is_empty() => notes.push(format!(
            "left out of the measurement uncertainty, not stated: {}",
            whole.left_out.join(", ")
        )),
        None if arguments.inputs() != SquarenessInputs::default() => notes.push(
            "no measurement uncertainty is stated: that of the slopes is known for the line of least squares alone, through three targets or of several runs"
                .to_owned(),
        ),
        _ => {}
    }
    if value.abs() > LARGEST_PLAUSIBLE {
        notes.push(format!(
            "a squareness of {value:.0} µrad is large for a machine tool: are the files in another unit?"
        ));
    }
    notes
}

impl SquarenessArguments {
    fn inputs(&self) -> SquarenessInputs {
        SquarenessInputs {
            square_urad: self.square_urad,
            straight_edge_um: self.straight_edge_um,
            temperature_urad: self.temperature_urad,
        }
    }
}

/// The uncertainty of the squareness; `None` unless the uncertainties of both slopes are known. They are known for
/// least-squares lines with at least three targets or several runs.
fn uncertainty(
    arguments: &SquarenessArguments,
    kind: ReferenceKind,
    lines: &[(Option<SlopeUncertainty>, f64)],
) -> Result<Option<SquarenessUncertainty>, Failure> {
    let &[(Some(first), first_mm), (Some(second), second_mm)] = lines else {
        return Ok(None);
    };
    if kind != ReferenceKind::LeastSquares {
        return Ok(None);
    }
    let inputs = arguments.inputs();
    let found = squareness_uncertainty(&inputs, [first, second], [first_mm, second_mm])?;
    Ok(Some(found))
}

fn uncertainty_text(uncertainty: &SquarenessUncertainty) -> String {
    let mut rows = table(&["contribution", "U (95 %) µrad", "from"]);
    crate::table::to_the_left(&mut rows, &[2]);
    let size = |u: Option<f64>| u.map_or_else(|| "left out".to_owned(), |u| fixed(u, 2));
    for (name, u, from) in [
        ("scatter", Some(uncertainty.scatter_urad), "slopes of the runs (one: readings)"),
        ("square", uncertainty.square_urad, "its calibration"),
        ("straight edge", uncertainty.straight_edge_urad, "its calibration, √2 U/L of each line"),
        ("temperature", uncertainty.temperature_urad, "R/√3"),
    ] {
        rows.add_row([name, &size(u), from]);
    }
    format!("\nMeasurement uncertainty\n{}", table_text(&rows))
}

fn text(document: &SquarenessTest) -> String {
    let mut rows = table(&["", "slope µrad"]);
    for part in &document.parts {
        rows.add_row([part.error.clone(), fixed(part.slope_urad, 2)]);
    }
    rows.add_row(["reference angle".to_owned(), fixed(document.reference_angle_urad, 2)]);
    format!(
        "squareness {}, µrad, slopes by {}\n\n{}\n{}{}{}",
        document.error,
        document.reference.replace('-', " "),
        table_text(&rows),
        quantities_text(&document.judgement.quantities, true),
        document.uncertainty.as_ref().map_or_else(String::new, uncertainty_text),
        decision_text(&document.judgement)
    )
}
