//! Builds reports from a calibration, an identification or a machine file.

use volcomp_calibrate::{Calibration, CalibrationFile, errors_without_value, not_stated};
use volcomp_identify::{Identification, Observations};
use volcomp_model::Machine;
use volcomp_vocabulary::{Direction, ErrorName};

use crate::{
    curves::{curves, stated_curves},
    identified::{files, identified, left_open},
    positioning::positioning,
    report::{Contribution, Report, SourceFile, Uncertainty, Warning, WarningKind},
    squares::{other_locations, pair_of, squares},
    stated::{Stated, head},
    warnings::{is_measured, of_calibration, warnings},
};

impl Report {
    /// Creates the report of a calibration; `source` is its file name.
    pub fn of_calibration(
        source: &str,
        file: &CalibrationFile,
        calibration: &Calibration,
        stated: &Stated,
    ) -> Self {
        let lines = file.measurements.iter();
        let machine = &calibration.machine;
        let identified = (calibration.identified.as_ref()).map(|of| identified(&of.found));
        let mut not_measured = calibration.not_measured.clone();
        not_measured.extend(identified.as_ref().and_then(left_open));
        not_measured.extend(one_direction(machine));
        let mut report = Self {
            warnings: of_calibration(file, calibration, &not_measured, stated),
            curves: curves(file, calibration),
            positioning: positioning(file, stated.edition),
            squareness: squares(
                machine,
                |pair| is_measured(calibration, pair),
                |error| of_square(file, calibration, error),
            ),
            locations: other_locations(machine, &calibration.locations),
            not_measured,
            without_scatter: file.files_without_scatter(),
            identified,
            uncertainty: stated_uncertainty(file),
            ..Self::of_statements(source, machine, stated)
        };
        report.head = head(source, machine, &lines.clone().map(|line| &line.readings), stated);
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

    /// Creates the report of an identification; `source` is the name of the file of observations.
    pub fn of_observations(
        source: &str,
        observations: &Observations,
        found: &Identification,
        mut not_measured: Vec<String>,
        stated: &Stated,
    ) -> Self {
        let square = |pair| {
            let named = found.parameters.iter().filter(|parameter| parameter.determined);
            let mut named = named.filter_map(|parameter| parameter.error);
            named.any(|error| error.location && pair_of(error) == Some(pair))
        };
        let identified = identified(found);
        not_measured.extend(left_open(&identified));
        let mut report = Self {
            squareness: squares(&found.machine, square, |_| None),
            identified: Some(identified),
            ..Self::of_statements(source, &found.machine, stated)
        };
        report.warnings = warnings(WarningKind::NotMeasured, &not_measured)
            .chain(warnings(WarningKind::Note, &observations.notes))
            .chain(warnings(WarningKind::Note, &found.warnings))
            .collect();
        report.warnings.dedup();
        report.not_measured = not_measured;
        report.head.files = files(observations).collect();
        report
    }

    /// Creates the report of a machine from its file, without measurements.
    pub fn of_machine(source: &str, machine: &Machine, stated: &Stated) -> Self {
        let mut report = Self::of_statements(source, machine, stated);
        if report.knows_errors() {
            report.not_measured = not_stated(machine);
            report.not_measured.extend(one_direction(machine));
            let of_errors = warnings(WarningKind::NotMeasured, &report.not_measured);
            report.warnings.extend(of_errors);
        } else {
            report.warnings.push(Warning {
                kind: WarningKind::NotMeasured,
                text: "no error of this machine is known: every figure is that of a machine without errors".to_owned(),
            });
        }
        report
    }

    fn of_statements(source: &str, machine: &Machine, stated: &Stated) -> Self {
        Self {
            head: head(source, machine, &std::iter::empty(), stated),
            checks: Vec::new(),
            warnings: warnings(WarningKind::Note, &machine.notes())
                .chain(warnings(WarningKind::Note, on_assembly(machine).as_slice()))
                .chain(warnings(WarningKind::NotMeasured, machine.provenance().note().as_slice()))
                .collect(),
            curves: stated_curves(machine),
            positioning: Vec::new(),
            squareness: squares(machine, |_| false, |_| None),
            locations: other_locations(machine, &[]),
            diagonals: None,
            volume: None,
            uncertainty: None,
            not_measured: Vec::new(),
            count_as_0: errors_without_value(machine),
            undecided: (machine.provenance().undecided.iter()).map(ErrorName::to_string).collect(),
            without_scatter: Vec::new(),
            partly_measured: (machine.partly_measured().iter())
                .map(|(error, ..)| error.to_string())
                .collect(),
            has_assembly: on_assembly(machine).is_some(),
            identified: None,
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }

    pub(crate) fn knows_errors(&self) -> bool {
        let mut squares = self.squareness.iter();
        !self.curves.is_empty()
            || !self.locations.is_empty()
            || self.identified.is_some()
            || squares.any(|square| !square.from.is_empty())
    }
}

/// Standard uncertainty of a squareness, µrad: the one stated for this location error in the calibration file,
/// otherwise that of the lines and of the reference square. `None` if the file states this location error without an
/// uncertainty, or if the angle is the sum of several location errors.
fn of_square(file: &CalibrationFile, calibration: &Calibration, error: ErrorName) -> Option<f64> {
    let mut locations = file.locations.iter();
    if let Some(own) = locations.find(|of| of.error == error) {
        return Some(own.uncertainty).filter(|stated| *stated > 0.0);
    }
    let pair = pair_of(error);
    let of_pair = |name: &ErrorName| pair_of(*name) == pair;
    let locations = calibration.machine.locations().keys();
    let is_alone = locations.filter(|name| of_pair(name)).count() == 1;
    let mut known = calibration.square_uncertainties.iter();
    let known = known.find(|(name, _)| of_pair(name));
    known.filter(|_| is_alone).map(|(_, known)| known.0)
}

fn on_assembly(machine: &Machine) -> Option<String> {
    let axes = machine.axes().iter().enumerate();
    let axes = axes.filter(|(index, _)| machine.assembly(*index).iter().any(|of| *of != 0.0));
    let names: Vec<String> = axes.map(|(_, axis)| axis.name.to_string()).collect();
    (!names.is_empty()).then(|| {
        format!(
            "[assembly] states errors of {}: squarenesses and locations are more than their location errors, and no limit of one is judged",
            names.join(", ")
        )
    })
}

fn one_direction(machine: &Machine) -> Option<String> {
    let names = machine.read_in_one_direction();
    let names: Vec<String> = names.iter().map(ErrorName::to_string).collect();
    (!names.is_empty()).then(|| {
        format!(
            "read in one direction of motion alone, so that the reversal is not known: {}",
            names.join(" ")
        )
    })
}

/// Uncertainty contributions stated in a calibration file; `None` if there are none.
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
    (!stated.is_empty()).then(|| Uncertainty { stated, ..Uncertainty::default() })
}
