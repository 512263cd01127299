use std::{
    cell::RefCell,
    fmt::Write as _,
    path::{Path, PathBuf},
};

use clap::ValueEnum;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_metrology::{
    DeviationUnit, Measurement, Metadata, ReferenceKind, SlopeUncertainty, StandardQuantity,
    Straightness, TiltReading, Tolerance, angular_method_um, axis_named, implausible_size, judged,
    read_file, straightness_of, straightness_of_profile,
};
use volcomp_report::{StraightnessPlot, straightness_picture};
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName};

use super::{
    Answer,
    evaluation::{
        Evaluated, Judgement, decision_text, evaluated, quantities_text, tolerances, with_csv,
    },
    fixed, table, table_text,
};
use crate::{
    arguments::{self, Unit},
    failure::Failure,
    output::PlotArguments,
    table::coordinate,
};

/// Evaluate the straightness of a motion about reference lines, also from tilts
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp straightness straight-exy.csv --reference end-points
  volcomp --json straightness tilts.csv --bridge-mm 250")]
pub(crate) struct StraightnessArguments {
    /// Measurement files: .rts, .csv; with --bridge-mm tilts, .rta or .csv
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Unit of deviations that the file (.csv) does not state; results are in µm or µrad [default: µm; µrad for tilts with
    /// --bridge-mm]
    #[arg(long)]
    unit: Option<Unit>,
    /// Line subtracted from the profile
    #[arg(long, default_value = "least-squares")]
    reference: Reference,
    /// Evaluate tilts of a bridge with this distance between its feet, mm, moved in steps of that distance
    #[arg(long, value_name = "MM")]
    bridge_mm: Option<f64>,
    /// Straightness error, EYX: tilts have the right-hand sign of its angular error [default: a positive tilt is a
    /// rising profile]
    #[arg(long, requires = "bridge_mm")]
    error: Option<ErrorName>,
    /// Limits, µm: least-squares=5,end-points=6,minimum-zone=4
    #[arg(long, value_name = "LIMITS")]
    tolerance: Option<String>,
    /// Write a CSV file with a row for each input file
    #[arg(long, short = 'o', value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    plot: PlotArguments,
}

/// The straightness of a motion.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct StraightnessTest {
    /// Path as named in the call.
    file: String,
    /// Method of measurement: `direct`, or `angular-method` with `--bridge-mm`.
    method: &'static str,
    /// Slopes of the reference lines, µrad: least squares, end points, minimum zone.
    slopes_urad: [f64; 3],
    /// Standard uncertainty of the least-squares slope, µrad: from the slopes of several runs, or
    /// from the readings of a single run; null for one run of two targets.
    slope_standard_uncertainty_urad: Option<f64>,
    /// Largest difference between the two directions, µm; null with one direction or by the angular
    /// method.
    reversal_um: Option<f64>,
    /// Reference line that is subtracted from `profile`.
    reference: &'static str,
    /// Targets, mm, and deviations from that line, µm.
    profile: Vec<[f64; 2]>,
    /// The straightness by each reference line.
    #[serde(flatten)]
    judgement: Judgement,
}

/// A reference line.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Reference {
    LeastSquares,
    EndPoints,
    MinimumZone,
}

impl Reference {
    pub(crate) fn kind(self) -> ReferenceKind {
        match self {
            Self::LeastSquares => ReferenceKind::LeastSquares,
            Self::EndPoints => ReferenceKind::EndPoints,
            Self::MinimumZone => ReferenceKind::MinimumZone,
        }
    }
}

pub(crate) fn key(kind: ReferenceKind) -> &'static str {
    match kind {
        ReferenceKind::LeastSquares => SYMBOLS[0],
        ReferenceKind::EndPoints => SYMBOLS[1],
        ReferenceKind::MinimumZone => SYMBOLS[2],
    }
}

const SYMBOLS: [&str; 3] = ["least-squares", "end-points", "minimum-zone"];

pub(crate) fn run(arguments: &StraightnessArguments) -> Result<Answer, Failure> {
    let tolerances = tolerances(arguments.tolerance.as_deref(), &SYMBOLS)?;
    let csv = arguments.csv.as_deref();
    let plot = (arguments.plot).open(&with_csv(&arguments.files, csv))?;
    let drawn = RefCell::new(Vec::new());
    let answer = evaluated(&arguments.files, csv, |path| {
        let document = one(path, arguments, &tolerances)?;
        if plot.is_some() {
            drawn.borrow_mut().push(StraightnessPlot {
                file: document.file.clone(),
                reference: document.reference,
                profile: document.profile.iter().map(|[q, x]| (*q, *x)).collect(),
                quantities: document.judgement.quantities.clone(),
            });
        }
        Ok(Evaluated {
            text: text(&document, arguments.files.len() == 1),
            metadata: Metadata::default(),
            judgement: document.judgement.clone(),
            document,
        })
    })?;
    if let Some(plot) = plot {
        plot.write(&straightness_picture(&drawn.into_inner()))?;
    }
    Ok(answer)
}

/// Reads a straightness file and converts its deviations to µm. Rejects other kinds of files.
pub(crate) fn read(path: &Path, asked: Option<Unit>) -> Result<Measurement, Failure> {
    let mut measurement = read_file(path)?;
    if arguments::apply(path, &mut measurement, asked)? == DeviationUnit::Urad {
        let what = "found angles, expected straightness readings in µm; of the tilts of a bridge state --bridge-mm";
        return Err(Failure::in_file(path, what));
    }
    refuse_positioning(path, &measurement)?;
    linear_axis(path, &measurement)?;
    Ok(measurement)
}

/// Rejects a rotary axis: straightness is an error of a linear axis, with targets in mm.
fn linear_axis(path: &Path, measurement: &Measurement) -> Result<(), Failure> {
    let stated = measurement.metadata.axis.as_deref().and_then(axis_named);
    if let Some(axis) = stated.filter(|axis| axis.kind() == AxisKind::Rotary) {
        let what = format!("found rotary axis {axis}, expected the straightness of a linear axis");
        return Err(Failure::in_file(path, what));
    }
    // Targets of an unstated axis are checked as targets of X, a linear axis.
    measurement.check_targets(stated.unwrap_or(AxisName::X))?;
    Ok(())
}

fn refuse_positioning(path: &Path, measurement: &Measurement) -> Result<(), Failure> {
    if measurement.quantity == Some(volcomp_metrology::Quantity::Positioning) {
        let what =
            "found positioning readings, expected straightness; `volcomp iso230` evaluates them";
        return Err(Failure::in_file(path, what));
    }
    Ok(())
}

fn one(
    path: &Path,
    arguments: &StraightnessArguments,
    tolerances: &[Tolerance],
) -> Result<StraightnessTest, Failure> {
    let (found, mut notes, method) = match arguments.bridge_mm {
        None => {
            let measurement = read(path, arguments.unit)?;
            let found = straightness_of(&measurement)?;
            (found, measurement.notes, "direct")
        }
        Some(bridge_mm) => {
            let mut measurement = read_file(path)?;
            refuse_positioning(path, &measurement)?;
            linear_axis(path, &measurement)?;
            if measurement.unit.is_none() && arguments.unit.is_none() {
                measurement.unit = Some(DeviationUnit::Urad);
                let note =
                    "the unit of the tilts is not stated, taken as µrad: state it with --unit";
                measurement.notes.push(note.to_owned());
            }
            if arguments::apply(path, &mut measurement, arguments.unit)? == DeviationUnit::Um {
                let what = "found lengths, expected tilts with --bridge-mm";
                return Err(Failure::in_file(path, what));
            }
            measurement.check_directions()?;
            let tilts = measurement.mean_curve();
            let (error, reading) = match arguments.error {
                Some(error) => (error, TiltReading::RightHand),
                None => (rising(), TiltReading::Slope),
            };
            let profile = angular_method_um(error, reading, &tilts, bridge_mm)?;
            let mut found = straightness_of_profile(&profile)?;
            found.slope_uncertainty = SlopeUncertainty::of_tilts(&tilts);
            (found, measurement.notes, "angular-method")
        }
    };
    notes.extend(odd(&found));
    if found.profile.len() < 3 {
        notes
            .push("two targets are always on one line: nothing is said of straightness".to_owned());
    }
    Ok(document(path, arguments, tolerances, &found, method, notes))
}

/// Note if a straightness is implausible for a machine tool. The slope is ignored, because it depends on the alignment
/// of the optics and may be steep.
pub(crate) fn odd(found: &Straightness) -> Option<String> {
    // Two targets leave no residual about a line.
    let error_um = found.of(ReferenceKind::LeastSquares).error_um;
    (found.profile.len() > 2)
        .then(|| implausible_size(error_um, Some(DeviationUnit::Um)))
        .flatten()
        .map(|text| format!("about the line of least squares {text}"))
}

/// A straightness error for which slopes keep their sign. Any such error gives the same result.
fn rising() -> ErrorName {
    use volcomp_vocabulary::Component;
    ErrorName::motion(Component::EZ, AxisName::X)
}

fn document(
    path: &Path,
    arguments: &StraightnessArguments,
    tolerances: &[Tolerance],
    found: &Straightness,
    method: &'static str,
    notes: Vec<String>,
) -> StraightnessTest {
    let quantities = found.about.iter().map(|about| StandardQuantity {
        symbol: key(about.kind),
        name: match about.kind {
            ReferenceKind::LeastSquares => "straightness about the line of least squares",
            ReferenceKind::EndPoints => "straightness about the line through the end points",
            ReferenceKind::MinimumZone => "straightness by the minimum zone",
        },
        value: Some(about.error_um),
    });
    let none = |_: &str| None;
    let quantities = judged("ISO 230-1", quantities, DeviationUnit::Um, tolerances, none);
    let kind = arguments.reference.kind();
    let profile = found.of(kind).line.removed_from(&found.profile);
    let slopes = [0, 1, 2].map(|k: usize| found.about[k].line.slope().0);
    StraightnessTest {
        file: path.display().to_string(),
        method,
        slopes_urad: slopes,
        slope_standard_uncertainty_urad: found.slope_uncertainty.map(|of| of.standard_urad),
        reversal_um: found.reversal_um,
        reference: key(kind),
        profile: profile.into_iter().map(|(q, x)| [q, x]).collect(),
        judgement: Judgement::new(quantities, notes),
    }
}

fn text(document: &StraightnessTest, with_names: bool) -> String {
    let mut rows = table(&["target", "deviation"]);
    for [target, deviation] in &document.profile {
        rows.add_row([coordinate(*target), fixed(*deviation, 2)]);
    }
    let method = match document.method {
        "direct" => "",
        _ => " by the angular method",
    };
    let [least, ends, zone] = document.slopes_urad.map(|slope| fixed(slope, 2));
    let mut text = format!(
        "straightness{method}, all values in µm, about {}\n\n{}\n{}\nslopes: least squares {least}, end points {ends}, minimum zone {zone} µrad\n",
        document.reference.replace('-', " "),
        table_text(&rows),
        quantities_text(&document.judgement.quantities, with_names)
    );
    if let Some(reversal) = document.reversal_um {
        let _ = writeln!(text, "largest difference of the directions {} µm", fixed(reversal, 2));
    }
    text + &decision_text(&document.judgement)
}
