//! Reports of calibrations made in the tests: data, page as text, and page in a browser.

mod data;
mod page;
mod plots;

use std::{fmt::Write as _, fs, path::Path};

use tempfile::TempDir;
use volcomp_calibrate::{Calibration, CalibrationFile, calibrate};
use volcomp_model::Machine;
use volcomp_report::{Report, Stated};

pub(crate) const MACHINE: &str = "name = \"mill\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 600.0]\n[axes.Z]\ntravel = [-500.0, 0.0]\n";

pub(crate) fn machine(more: &str) -> Machine {
    Machine::parse(&format!("{MACHINE}{more}"), "machine.toml").expect("a machine")
}

/// CSV file of bidirectional runs with deterministic scatter.
pub(crate) fn csv(
    targets: usize,
    step: f64,
    runs: u32,
    value: impl Fn(f64, bool) -> f64,
) -> String {
    let mut text = "target,run,direction,deviation\n".to_owned();
    let mut noise = 7_u64;
    for run in 1..=runs {
        for backward in [false, true] {
            for index in 0..targets {
                let target = step * index as f64;
                // A Lehmer generator, sufficient for irregular values.
                noise = noise * 48_271 % 2_147_483_647;
                let scatter = noise as f64 / 2_147_483_647.0 - 0.5;
                let direction = if backward { "-" } else { "+" };
                let _ = writeln!(
                    text,
                    "{target},{run},{direction},{:.3}",
                    value(target, backward) + scatter
                );
            }
        }
    }
    text
}

/// A folder with a calibration of positioning, straightness, tilt and squareness.
pub(crate) struct Shop {
    pub(crate) folder: TempDir,
}

impl Shop {
    pub(crate) fn new() -> Self {
        let shop = Self { folder: tempfile::tempdir().expect("a folder") };
        shop.write("machine.toml", MACHINE);
        shop.write(
            "exx.csv",
            &csv(17, 50.0, 5, |x, back| {
                0.02 * x + 3.0 * (x / 90.0).sin() - if back { 2.0 } else { 0.0 }
            }),
        );
        shop.write("eyx.csv", &csv(17, 50.0, 5, |x, _| 4.0 * (x / 800.0 * 3.1).sin()));
        shop.write("ebx.csv", &csv(17, 50.0, 5, |x, _| 0.03 * x));
        shop.write(
            "calibration.toml",
            "machine = \"machine.toml\"\n[[measurement]]\nerror = \"EXX\"\nfile = \"exx.csv\"\n[[measurement]]\nerror = \"EYX\"\nfile = \"eyx.csv\"\n[[measurement]]\nerror = \"EBX\"\nfile = \"ebx.csv\"\n[[squareness]]\nerror = \"EC0Y\"\nvalue_urad = 12.0\n",
        );
        shop
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        fs::write(self.folder.path().join(name), text).expect("written");
    }

    pub(crate) fn read(&self, name: &str) -> String {
        fs::read_to_string(self.folder.path().join(name)).expect("read")
    }

    pub(crate) fn calibrated(&self) -> (CalibrationFile, Calibration) {
        calibrated(&self.folder.path().join("calibration.toml"))
    }

    pub(crate) fn report(&self) -> Report {
        let (file, calibration) = self.calibrated();
        Report::of_calibration("calibration.toml", &file, &calibration, &Stated::default())
    }
}

pub(crate) fn calibrated(path: &Path) -> (CalibrationFile, Calibration) {
    let file = CalibrationFile::read(path).unwrap_or_else(|error| panic!("{error}"));
    let calibration = calibrate(&file, |_, _| {}).unwrap_or_else(|error| panic!("{error}"));
    (file, calibration)
}
