//! A folder with machine file, measurement files and calibration file.

use std::{fs, path::Path};

use volcomp_calibrate::{CalibrateError, Calibration, CalibrationFile, calibrate};

pub(crate) struct Lab(tempfile::TempDir);

impl Lab {
    pub(crate) fn new(machine: &str) -> Self {
        let lab = Self(tempfile::tempdir().expect("a folder"));
        lab.write("machine.toml", machine);
        lab
    }

    pub(crate) fn folder(&self) -> &Path {
        self.0.path()
    }

    pub(crate) fn write(&self, name: &str, text: &str) {
        fs::write(self.folder().join(name), text).expect("written");
    }

    /// Reads a calibration file that consists of a first line with the name of the machine file, and `text`.
    pub(crate) fn read(&self, text: &str) -> Result<CalibrationFile, CalibrateError> {
        let text = format!("machine = \"machine.toml\"\n{text}");
        self.write("calibration.toml", &text);
        CalibrationFile::read(&self.folder().join("calibration.toml"))
    }

    pub(crate) fn tried(&self, text: &str) -> Result<Calibration, CalibrateError> {
        calibrate(&self.read(text)?, |_, _| {})
    }

    pub(crate) fn calibrated(&self, text: &str) -> Calibration {
        self.tried(text).expect("calibrated")
    }

    pub(crate) fn refused(&self, text: &str) -> String {
        match self.tried(text) {
            Ok(_) => panic!("calibrated, expected a refusal of\n{text}"),
            Err(error) => error.to_string(),
        }
    }
}
