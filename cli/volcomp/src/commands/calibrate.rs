//! `volcomp calibrate`: from measurement files to a machine file.

use std::fmt::Write as _;
use std::path::PathBuf;

use volcomp_calibrate::{Calibration, CalibrationFile, calibrate};
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
use crate::{
    answers::calibrate::Calibrate as Document, failure::Failure, output::OutputFile, progress,
};

/// Fits measurement files to a machine file, or drafts a calibration file from a folder
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The calibration file (TOML), which names the machine file and the measurement files
    #[arg(required_unless_present = "draft")]
    calibration: Option<PathBuf>,
    /// Drafts a calibration file from the measurement files in this folder, with its open questions
    #[arg(
        long,
        value_name = "DIR",
        requires = "machine",
        conflicts_with = "calibration"
    )]
    draft: Option<PathBuf>,
    /// Machine file for --draft: structure, axes and travels
    #[arg(long, short, value_name = "M.toml", requires = "draft")]
    machine: Option<PathBuf>,
    /// With --draft: writes over a file that is there and says something else, answers included
    #[arg(long, requires = "draft")]
    replace: bool,
    /// With --draft: one answer to every open question of a key, or to those of an error or an axis: rides=carriage,
    /// EYX:sign=-1, Y:at.X=4000; can be given several times
    #[arg(long = "answer", value_name = "[OF:]KEY=VALUE", requires = "draft")]
    answers: Vec<String>,
    /// The day of the calibration, which the machine file then states; without it no day stands there
    #[arg(long, value_name = "YYYY-MM-DD", conflicts_with = "draft")]
    date: Option<String>,
    /// Machine file to write; with --draft the calibration file
    #[arg(long, short)]
    output: PathBuf,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    if let (Some(folder), Some(machine)) = (&arguments.draft, &arguments.machine) {
        let wanted = Wanted {
            answers: &arguments.answers,
            replace: arguments.replace,
        };
        return calibrate_draft::run(folder, machine, &arguments.output, &wanted);
    }
    // Where there is no draft the call has a calibration file.
    let path = arguments.calibration.clone().unwrap_or_default();
    let file = CalibrationFile::read(&path)?;
    if let Some(date) = arguments.date.as_ref().filter(|date| !is_date(date)) {
        return Err(Failure::Input(format!(
            "--date: found {}, expected a day of the calendar such as 2026-11-26",
            quoted(date)
        )));
    }
    refuse_overwriting(&file.files, &arguments.output, "calibration")?;
    let mut output = OutputFile::open(&arguments.output)?;
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
    output.append(calibration.machine.to_toml().as_bytes())?;
    output.finish()?;
    let document = Document::new(arguments.output.display().to_string(), &calibration);
    Answer::new(&document, text(&document), calibration.warnings)
}

/// Calibrates with a progress bar.
pub(super) fn fit(file: &CalibrationFile) -> Result<Calibration, Failure> {
    let work = |told: &mut dyn FnMut(usize, usize)| calibrate(file, told);
    Ok(progress::with_bar("errors fitted", work)?)
}

fn text(document: &Document) -> String {
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
        let (residual, leave_one_out) = curve.residual_and_leave_one_out();
        fitted.add_row([
            curve.error.clone(),
            curve.direction.unwrap_or("both").to_owned(),
            curve.curve.to_owned(),
            curve.readings.to_string(),
            fixed(residual.min, 2),
            fixed(residual.max, 2),
            fixed(residual.rms, 2),
            fixed(leave_one_out, 2),
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
