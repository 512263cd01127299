//! `volcomp calibrate`: from measurement files to a machine file.

use std::path::PathBuf;

use serde_json::{Map, Value, json};
use volcomp_calibrate::{
    Calibration, CalibrationFile, FitQuality, FittedCurve, Quality, calibrate,
};
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
    let curves: Vec<Value> = calibration.curves.iter().map(curve_json).collect();
    let squareness: Map<String, Value> = calibration
        .squareness
        .iter()
        .map(|(name, value)| (name.to_string(), json!(value.0)))
        .collect();
    json!({
        "file": arguments.output.display().to_string(),
        "curves": curves,
        "squareness_urad": squareness,
        "warnings": calibration.warnings,
    })
}

fn curve_json(curve: &FittedCurve) -> Value {
    let mut json = json!({
        "error": curve.error.to_string(),
        "direction": curve.direction.map(Direction::name),
        "curve": curve.kind,
        "readings": curve.readings,
        "unit": curve.error.component.unit(),
    });
    match curve.quality {
        Quality::Length(FitQuality {
            residual_min: min,
            residual_max: max,
            residual_rms: rms,
            leave_one_out,
            reversal,
        }) => {
            json["residual_um"] = json!({ "min": min.0, "max": max.0, "rms": rms.0 });
            json["leave_one_out_um"] = json!(leave_one_out.0);
            json["reversal_um"] = json!(reversal.map(|reversal| reversal.0));
        }
        Quality::Angle(FitQuality {
            residual_min: min,
            residual_max: max,
            residual_rms: rms,
            leave_one_out,
            reversal,
        }) => {
            json["residual_urad"] = json!({ "min": min.0, "max": max.0, "rms": rms.0 });
            json["leave_one_out_urad"] = json!(leave_one_out.0);
            json["reversal_urad"] = json!(reversal.map(|reversal| reversal.0));
        }
    }
    json
}

/// Smallest and largest residual, their root mean square and the leave-one-out error, for the table.
fn numbers(quality: &Quality) -> [f64; 4] {
    match quality {
        Quality::Length(q) => [
            q.residual_min,
            q.residual_max,
            q.residual_rms,
            q.leave_one_out,
        ]
        .map(|length| length.0),
        Quality::Angle(q) => [
            q.residual_min,
            q.residual_max,
            q.residual_rms,
            q.leave_one_out,
        ]
        .map(|angle| angle.0),
    }
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
        let [min, max, rms, leave_one_out] = numbers(&curve.quality);
        fitted.add_row([
            curve.error.to_string(),
            curve.direction.map_or("both", Direction::name).to_owned(),
            curve.kind.to_owned(),
            curve.readings.to_string(),
            format!("{min:.2}"),
            format!("{max:.2}"),
            format!("{rms:.2}"),
            format!("{leave_one_out:.2}"),
            curve.error.component.unit().to_owned(),
        ]);
    }
    let squareness = calibration
        .squareness
        .iter()
        .map(|(name, value)| format!(" {name} {:.2} urad\n", value.0));
    squareness.fold(table_text(&fitted), |text, line| text + &line)
}
