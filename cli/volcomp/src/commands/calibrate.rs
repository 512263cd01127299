use std::{fmt::Write as _, path::PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::{Calibration, CalibrationFile, CalibrationSummary, calibrate};
use volcomp_document::quoted;
use volcomp_identify::unit_symbol;
use volcomp_model::{Provenance, is_date};
use volcomp_vocabulary::Urad;

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
    #[arg(long, value_name = "DIR", requires = "machine", conflicts_with = "calibration")]
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
    #[serde(flatten)]
    found: CalibrationSummary,
}

pub(crate) fn run(arguments: &CalibrateArguments) -> Result<Answer, Failure> {
    if let (Some(folder), Some(machine)) = (&arguments.draft, &arguments.machine) {
        let wanted = Wanted { answers: &arguments.answers, replace: arguments.replace };
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
        let dated = Provenance { date: arguments.date.clone(), ..provenance };
        let set = calibration.machine.set_provenance(dated);
        set.map_err(|refusal| Failure::Input(format!("--date: {refusal}")))?;
    }
    output.write_whole(calibration.machine.to_toml())?;
    let document = Calibrate {
        file: arguments.output.display().to_string(),
        found: CalibrationSummary::new(&calibration),
    };
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
    for curve in &document.found.curves {
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
    if !document.found.squareness_urad.is_empty() {
        let mut squareness = table(&["squareness", "", ""]);
        for (error, value) in &document.found.squareness_urad {
            squareness.add_row([error.clone(), fixed(*value, 2), Urad::SYMBOL.to_owned()]);
        }
        text.push('\n');
        text += &table_text(&squareness);
    }
    if !document.found.locations.is_empty() {
        let mut stated = table(&["location error", "stated", "uncertainty", ""]);
        for (error, location) in &document.found.locations {
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
    if let Some(identified) = &document.found.identified {
        text.push('\n');
        text += &found_text(&identified.found);
    }
    let _ = write!(
        text,
        "\nwrote {}: {} fitted, {} squareness\n",
        document.file,
        counted(document.found.curves.len(), "curve"),
        document.found.squareness_urad.len()
    );
    text += "\nResidual: mean reading minus curve. LOO error: root mean square of what the\n\
             curve misses of the readings of a target that were left out of its fit, one\n\
             target at a time.\n";
    if document.found.identified.is_some() {
        text += EXPLAINED;
    }
    text
}

fn counted(count: usize, what: &str) -> String {
    let s = if count == 1 { "" } else { "s" };
    format!("{count} {what}{s}")
}
