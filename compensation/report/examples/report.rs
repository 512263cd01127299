//! A calibration file to a report: `cargo run -p volcomp-report --example report -- CALIBRATION.toml REPORT.html`.

use std::{env, fs, path::Path, process::ExitCode};

use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_report::{Language, Report, Stated, html};

fn report(calibration: &Path, output: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let file = CalibrationFile::read(calibration)?;
    let found = calibrate(&file, |_, _| {})?;
    let source = calibration.display().to_string();
    let report = Report::of_calibration(&source, &file, &found, &Stated::default());
    fs::write(output, html(&report, Language::En))?;
    Ok(())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [calibration, output] = &arguments[..] else {
        eprintln!("expected CALIBRATION.toml REPORT.html");
        return ExitCode::from(2);
    };
    match report(Path::new(calibration), Path::new(output)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}
