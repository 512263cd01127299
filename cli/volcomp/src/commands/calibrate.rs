//! `volcomp calibrate`: from measurement files to a machine file.

use std::path::PathBuf;

use serde_json::{Map, Value, json};
use volcomp_calibrate::{Calibration, CalibrationFile, calibrate};
use volcomp_vocabulary::Direction;

use super::{Answer, table, table_text};
use crate::{failure::Failure, output::OutputFile, progress};

/// Fits measurement files to a machine file
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Calibration file (TOML)
    calibration: PathBuf,
    /// Machine file to write
    #[arg(long, short)]
    output: PathBuf,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let file = CalibrationFile::read(&arguments.calibration)?;
    let mut output = OutputFile::open(&arguments.output)?;
    let calibration = fit(&file)?;
    output.append(calibration.machine.to_toml().as_bytes())?;
    output.finish()?;
    Ok(Answer {
        json: json(arguments, &calibration),
        text: text(&calibration),
        notes: calibration.warnings,
    })
}

/// Calibrates with a progress bar.
pub(super) fn fit(file: &CalibrationFile) -> Result<Calibration, Failure> {
    let bar = progress::bar(0, "errors fitted");
    let calibration = calibrate(file, |done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    Ok(calibration)
}

fn json(arguments: &Arguments, calibration: &Calibration) -> Value {
    let curves: Vec<Value> = calibration
        .curves
        .iter()
        .map(|curve| {
            json!({
                "error": curve.error.to_string(),
                "direction": curve.direction.map(Direction::name),
                "curve": curve.kind,
                "readings": curve.readings,
                "unit": curve.error.component.unit(),
                "residual_um": { "min": curve.residual[0], "max": curve.residual[1], "rms": curve.rms },
                "leave_one_out_um": curve.leave_one_out,
                "reversal_um": curve.reversal,
            })
        })
        .collect();
    let squareness: Map<String, Value> = calibration
        .squareness
        .iter()
        .map(|(name, value)| (name.to_string(), json!(value)))
        .collect();
    json!({
        "file": arguments.output.display().to_string(),
        "curves": curves,
        "squareness_urad": squareness,
        "warnings": calibration.warnings,
    })
}

fn text(calibration: &Calibration) -> String {
    let mut fitted = table(&[
        "error",
        "direction",
        "curve",
        "points",
        "min",
        "max",
        "rms",
        "left out",
        "",
    ]);
    for curve in &calibration.curves {
        fitted.add_row([
            curve.error.to_string(),
            curve.direction.map_or("both", Direction::name).to_owned(),
            curve.kind.to_owned(),
            curve.readings.to_string(),
            format!("{:.2}", curve.residual[0]),
            format!("{:.2}", curve.residual[1]),
            format!("{:.2}", curve.rms),
            format!("{:.2}", curve.leave_one_out),
            curve.error.component.unit().to_owned(),
        ]);
    }
    let squareness = calibration
        .squareness
        .iter()
        .map(|(name, value)| format!(" {name} {value:.2} urad\n"));
    squareness.fold(table_text(&fitted), |text, line| text + &line)
}
