use std::{collections::BTreeMap, fmt::Write as _, path::PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::{
    Calibration, CalibrationFile, FitQuality, FittedCurve, Identified, Quality, calibrate,
};
use volcomp_document::quoted;
use volcomp_identify::unit_symbol;
use volcomp_model::{Provenance, is_date};
use volcomp_vocabulary::{Direction, ErrorName, Um, Urad};

use super::{
    Answer,
    calibrate_draft::{self, Wanted},
    fixed,
    identify::{EXPLAINED, found_text},
    refuse_overwriting, table, table_text,
};
use crate::{failure::Failure, output::OutputFile, progress, table::or_dash};

/// Fit measurement files to a machine file, or draft a calibration file from a folder
///
/// A measurement file is refused if it states another axis of the machine or another serial number, has no target within
/// the travel, a deviation over 100 mm or 100 mrad, or angles that vary by more than 5 mrad. Notes report, among others,
/// deviations over 1 mm or 1 mrad (except straightness), and lines without `point` on an axis with tilts.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp calibrate calibration.toml -o machine-new.toml
  volcomp --json calibrate calibration.toml -o machine-new.toml")]
pub(crate) struct CalibrateArguments {
    /// Calibration file (TOML), which names the machine file and the measurement files
    #[arg(required_unless_present = "draft")]
    calibration: Option<PathBuf>,
    /// Draft a calibration file, with open questions, from the files in this folder
    #[arg(
        long,
        value_name = "DIR",
        requires = "machine",
        conflicts_with = "calibration"
    )]
    draft: Option<PathBuf>,
    /// With --draft: machine file with structure, axes and travels
    #[arg(long, short, value_name = "M.toml", requires = "draft")]
    machine: Option<PathBuf>,
    /// With --draft: overwrite an existing file with other content, answers included
    #[arg(long, requires = "draft")]
    replace: bool,
    /// With --draft: answer an open question everywhere (rides=carriage), or of an error or axis (EYX:sign=-1);
    /// repeatable; the most specific wins
    #[arg(long = "answer", value_name = "[OF:]KEY=VALUE", requires = "draft")]
    answers: Vec<String>,
    /// Day of the calibration for the provenance in the machine file [default: none]
    #[arg(long, value_name = "YYYY-MM-DD", conflicts_with = "draft")]
    date: Option<String>,
    /// Machine file to write; with --draft the calibration file
    #[arg(long, short)]
    output: PathBuf,
}

/// A calibration and the written machine file.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Calibrate {
    /// Path of the written machine file.
    file: String,
    /// Every fitted curve, angular errors first.
    curves: Vec<FittedRow>,
    /// Squareness errors by name, µrad.
    squareness_urad: BTreeMap<String, f64>,
    /// Location errors stated in the calibration file, by name; missing if it states none.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    locations: BTreeMap<String, Stated>,
    /// Parameters identified from observations of the whole machine; missing if the calibration
    /// file has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    identified: Option<Identified>,
    /// Warnings: unmeasured errors, Abbe offsets that could not be removed, notes on the files.
    warnings: Vec<String>,
}

/// A location error stated in the calibration file.
#[derive(Debug, Serialize, JsonSchema)]
struct Stated {
    /// The value in `unit`.
    value: f64,
    /// `um` or `urad`.
    unit: &'static str,
    /// Standard uncertainty (k = 1) in the same unit.
    uncertainty: f64,
}

/// A fitted error curve and its residuals, in `unit`.
#[derive(Debug, Serialize, JsonSchema)]
struct FittedRow {
    /// Name of the error.
    error: ErrorName,
    /// `forward` or `backward`; null: one curve for both directions.
    direction: Option<&'static str>,
    /// Kind of curve, as in the machine file.
    curve: &'static str,
    /// Number of mean readings: targets times lines.
    readings: usize,
    /// Unit of the values below: `um` or `urad`.
    unit: &'static str,
    /// Readings minus curve.
    residual: Residual,
    /// Root mean square of the leave-one-out errors; null if a reading cannot be predicted from the
    /// others.
    leave_one_out: Option<f64>,
    /// Largest difference forward − backward of the curves; null: one curve for both directions.
    reversal: Option<f64>,
}

/// Range and size of the residuals, readings minus curve.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
struct Residual {
    /// The smallest residual, with its sign.
    min: f64,
    /// The largest residual, with its sign.
    max: f64,
    /// Root mean square of the residuals.
    rms: f64,
}

impl Calibrate {
    /// `file` is the name of the written machine file.
    fn new(file: String, calibration: &Calibration) -> Self {
        let squareness = calibration.squareness.iter();
        Self {
            file,
            curves: calibration.curves.iter().map(FittedRow::new).collect(),
            squareness_urad: squareness
                .map(|(error, Urad(value))| (error.to_string(), *value))
                .collect(),
            locations: (calibration.locations.iter())
                .map(|location| {
                    let stated = Stated {
                        value: location.value,
                        unit: location.error.component.unit(),
                        uncertainty: location.uncertainty,
                    };
                    (location.error.to_string(), stated)
                })
                .collect(),
            identified: calibration.identified.clone(),
            warnings: calibration.warnings.clone(),
        }
    }
}

impl FittedRow {
    fn new(curve: &FittedCurve) -> Self {
        match curve.quality {
            Quality::Length(quality) => Self::of(curve, &quality, |Um(um)| um),
            Quality::Angle(quality) => Self::of(curve, &quality, |Urad(urad)| urad),
        }
    }

    fn of<U: Copy>(curve: &FittedCurve, quality: &FitQuality<U>, number: fn(U) -> f64) -> Self {
        Self {
            error: curve.error,
            direction: curve.direction.map(Direction::name),
            curve: curve.kind,
            readings: curve.readings,
            unit: curve.error.component.unit(),
            residual: Residual {
                min: number(quality.residual_min),
                max: number(quality.residual_max),
                rms: number(quality.residual_rms),
            },
            leave_one_out: quality.leave_one_out.map(number),
            reversal: quality.reversal.map(number),
        }
    }
}

pub(crate) fn run(arguments: &CalibrateArguments) -> Result<Answer, Failure> {
    if let (Some(folder), Some(machine)) = (&arguments.draft, &arguments.machine) {
        let wanted = Wanted {
            answers: &arguments.answers,
            replace: arguments.replace,
        };
        return calibrate_draft::run(folder, machine, &arguments.output, &wanted);
    }
    // clap requires a calibration file unless a draft is requested.
    let path = arguments.calibration.clone().unwrap_or_default();
    let file = CalibrationFile::read(&path)?;
    if let Some(date) = arguments.date.as_ref().filter(|date| !is_date(date)) {
        return Err(Failure::Input(format!(
            "--date: found {}, expected a day of the calendar such as 2026-11-26",
            quoted(date)
        )));
    }
    refuse_overwriting(&file.files, &arguments.output, "calibration")?;
    let output = OutputFile::open(&arguments.output)?;
    let mut calibration = fit(&file)?;
    if arguments.date.is_some() {
        let provenance = calibration.machine.provenance().clone();
        let dated = Provenance {
            date: arguments.date.clone(),
            ..provenance
        };
        let set = calibration.machine.set_provenance(dated);
        set.map_err(|refusal| Failure::Input(format!("--date: {refusal}")))?;
    }
    output.write_whole(calibration.machine.to_toml())?;
    let document = Calibrate::new(arguments.output.display().to_string(), &calibration);
    Answer::new(&document, text(&document), calibration.warnings)
}

pub(super) fn fit(file: &CalibrationFile) -> Result<Calibration, Failure> {
    let work = |told: &mut dyn FnMut(usize, usize)| calibrate(file, told);
    Ok(progress::with_bar("errors fitted", work)?)
}

fn text(document: &Calibrate) -> String {
    let mut fitted = table(&[
        "error",
        "direction",
        "curve",
        "points",
        "residual min",
        "max",
        "rms",
        "LOO error",
        "",
    ]);
    for curve in &document.curves {
        fitted.add_row([
            curve.error.to_string(),
            curve.direction.unwrap_or("both").to_owned(),
            curve.curve.to_owned(),
            curve.readings.to_string(),
            fixed(curve.residual.min, 2),
            fixed(curve.residual.max, 2),
            fixed(curve.residual.rms, 2),
            or_dash(curve.leave_one_out, 2),
            unit_symbol(curve.unit).to_owned(),
        ]);
    }
    let mut text = table_text(&fitted);
    if !document.squareness_urad.is_empty() {
        let mut squareness = table(&["squareness", "", ""]);
        for (error, value) in &document.squareness_urad {
            squareness.add_row([error.clone(), fixed(*value, 2), Urad::SYMBOL.to_owned()]);
        }
        text.push('\n');
        text += &table_text(&squareness);
    }
    if !document.locations.is_empty() {
        let mut stated = table(&["location error", "stated", "uncertainty", ""]);
        for (error, location) in &document.locations {
            stated.add_row([
                error.clone(),
                fixed(location.value, 2),
                fixed(location.uncertainty, 2),
                unit_symbol(location.unit).to_owned(),
            ]);
        }
        text.push('\n');
        text += &table_text(&stated);
    }
    if let Some(identified) = &document.identified {
        text.push('\n');
        text += &found_text(&identified.found);
    }
    let _ = write!(
        text,
        "\nwrote {}: {} fitted, {} squareness\n",
        document.file,
        counted(document.curves.len(), "curve"),
        document.squareness_urad.len()
    );
    text += "\nResidual: mean reading minus curve. LOO error: root mean square of what the\n\
             curve misses of the readings of a target that were left out of its fit, one\n\
             target at a time.\n";
    if document.identified.is_some() {
        text += EXPLAINED;
    }
    text
}

fn counted(count: usize, what: &str) -> String {
    let s = if count == 1 { "" } else { "s" };
    format!("{count} {what}{s}")
}
