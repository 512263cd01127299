//! Writes the report of a calibration file:
//!
//! ```text
//! cargo run -p volcomp-report --example report -- calibration.toml report.html
//! ```
//!
//! Without arguments it uses the calibration in the repository's folder `examples/calibration`, and prints the length of the report.

use std::{env, error::Error, fs, path::Path};

use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_report::{Report, Stated, html};

fn report(calibration: &Path) -> Result<String, Box<dyn Error>> {
    let file = CalibrationFile::read(calibration)?;
    let found = calibrate(&file, |_, _| {})?;
    let source = calibration.display().to_string();
    let report = Report::of_calibration(&source, &file, &found, &Stated::default());
    Ok(html(&report))
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    match &arguments[..] {
        [] => {
            let shipped = Path::new(env!("CARGO_MANIFEST_DIR"))
                .join("../../examples/calibration/calibration.toml");
            let page = report(&shipped)?;
            assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
            println!("a report of {} kB", page.len() / 1000);
            Ok(())
        }
        [calibration, output] => Ok(fs::write(output, report(Path::new(calibration))?)?),
        _ => Err("expected CALIBRATION.toml REPORT.html, or nothing".into()),
    }
}
