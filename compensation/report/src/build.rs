//! Reports of what calibrating, identifying and reading a machine file gave.

use volcomp_calibrate::{Calibration, CalibrationFile};
use volcomp_identify::{Identification, Observations};
use volcomp_model::Machine;
use volcomp_vocabulary::Direction;

use crate::{
    curves::{curves, stated_curves},
    identified::{files, identified, left_open, not_described},
    positioning::positioning,
    report::{Contribution, Report, SourceFile, Uncertainty, Warning, WarningKind},
    squares::{other_locations, pair_of, squares},
    stated::{Stated, head},
    warnings::{is_measured, notes, of_calibration},
};

impl Report {
    /// The report of a calibration. `source` is the name of its file.
    pub fn of_calibration(
        source: &str,
        file: &CalibrationFile,
        calibration: &Calibration,
        stated: &Stated,
    ) -> Self {
        let lines = file.measurements.iter();
        let machine = &calibration.machine;
        let identified = (calibration.identified.as_ref()).map(|of| identified(&of.found));
        let not_followed = calibration.curves.iter().filter(|curve| !curve.follows());
        let mut not_followed: Vec<String> =
            not_followed.map(|curve| curve.error.to_string()).collect();
        not_followed.dedup();
        not_followed
            .extend((calibration.identified.iter()).flat_map(|of| not_described(&of.found)));
        let mut not_measured = calibration.not_measured.clone();
        not_measured.extend(identified.as_ref().and_then(left_open));
        let mut report = Self {
            warnings: of_calibration(file, calibration, &not_measured, stated.edition),
            curves: curves(file, calibration),
            positioning: positioning(file, stated.edition),
            squareness: squares(machine, |pair| is_measured(calibration, pair)),
            locations: other_locations(machine, &calibration.locations),
            not_measured,
            not_followed,
            identified,
            uncertainty: stated_uncertainty(file),
            ..Self::of_machine(source, machine, stated)
        };
        report.head = head(
            source,
            machine,
            &lines.clone().map(|line| &line.readings),
            stated,
        );
        report.head.files = lines
            .map(|line| SourceFile {
                file: line.file.display().to_string(),
                measures: line.setup.error.to_string(),
                targets: line.readings.targets().len(),
                runs: Some(Direction::BOTH.map(|d| line.readings.runs(d).len())),
                date: line.readings.metadata.date.clone(),
            })
            .collect();
        let of_diagonals = file.diagonals.iter().map(|of| &of.observations);
        for observations in of_diagonals.chain(&file.observations) {
            report.head.files.extend(files(observations));
        }
        report
    }

    /// The report of an identification. `source` is the name of the file of observations.
    pub fn of_observations(
        source: &str,
        observations: &Observations,
        found: &Identification,
        mut not_measured: Vec<String>,
        stated: &Stated,
    ) -> Self {
        let square = |pair| {
            let named = found
                .parameters
                .iter()
                .filter(|parameter| parameter.determined);
            let mut named = named.filter_map(|parameter| parameter.error);
            named.any(|error| error.location && pair_of(error) == Some(pair))
        };
        let identified = identified(found);
        not_measured.extend(left_open(&identified));
        let mut report = Self {
            squareness: squares(&found.machine, square),
            identified: Some(identified),
            not_followed: not_described(found),
            ..Self::of_machine(source, &found.machine, stated)
        };
        let of_errors = not_measured.iter().map(|text| Warning {
            kind: WarningKind::NotMeasured,
            text: text.clone(),
        });
        report.warnings = of_errors
            .chain(notes(&observations.notes))
            .chain(notes(&found.warnings))
            .collect();
        report.warnings.dedup();
        report.not_measured = not_measured;
        report.head.files = files(observations).collect();
        report
    }

    /// The report of a machine as its file states it: nothing in it was measured here.
    pub fn of_machine(source: &str, machine: &Machine, stated: &Stated) -> Self {
        let mut report = Self {
            head: head(source, machine, &std::iter::empty(), stated),
            checks: Vec::new(),
            warnings: notes(&machine.notes()).collect(),
            curves: stated_curves(machine),
            positioning: Vec::new(),
            squareness: squares(machine, |_| false),
            locations: other_locations(machine, &[]),
            diagonals: None,
            volume: None,
            uncertainty: None,
            not_measured: Vec::new(),
            not_followed: Vec::new(),
            partly_measured: (machine.partly_measured().iter())
                .map(|(error, ..)| error.to_string())
                .collect(),
            identified: None,
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        if !report.knows_errors() {
            report.warnings.push(Warning {
                kind: WarningKind::NotMeasured,
                text: "no error of this machine is known: every figure is that of a machine without errors".to_owned(),
            });
        }
        report
    }

    /// Whether it has any error.
    pub(crate) fn knows_errors(&self) -> bool {
        let mut squares = self.squareness.iter();
        !self.curves.is_empty()
            || !self.locations.is_empty()
            || self.identified.is_some()
            || squares.any(|square| !square.from.is_empty())
    }
}

/// The contributions that a calibration file states; `None` where it states none.
fn stated_uncertainty(file: &CalibrationFile) -> Option<Uncertainty> {
    let of = &file.uncertainty;
    let all = [
        ("laser_um_per_m", of.laser_um_per_m, "µm/m"),
        ("square_urad", of.square_urad, "µrad"),
        ("reading_um", of.reading_um, "µm"),
        ("reading_urad", of.reading_urad, "µrad"),
    ];
    let stated = all.into_iter().filter(|(_, value, _)| *value > 0.0);
    let stated: Vec<_> = stated
        .map(|(key, standard, unit)| Contribution {
            key: key.to_owned(),
            standard,
            unit: unit.to_owned(),
        })
        .collect();
    (!stated.is_empty()).then(|| Uncertainty {
        stated,
        ..Uncertainty::default()
    })
}
