//! Builds reports from a calibration, an identification or a machine file.

use volcomp_calibrate::{
    Calibration, CalibrationFile, Line, Method, errors_without_value, is_square, not_stated,
    squareness_lines_of_one_run, with_files,
};
use volcomp_identify::{Identification, Observations, unit_symbol};
use volcomp_metrology::{
    Edition, Environment, MATERIAL_WITHIN_K, Measurement, Metadata, MotionKind, Quantity,
    REFERENCE_DEGC, StartEnd, UncertaintyInputs, Vdi3441, environment_notes, evaluate, opening,
    outlier_hints, positioning_uncertainty, shortfalls, vdi_3441,
};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName, Direction, ErrorName};

use crate::{
    curves::{curves, runs_of, stated_curves},
    report::{
        Contribution, FigureUncertainty, Head, Identified, Location, Parameter, Positioning,
        Report, SourceFile, Square, Stated, Tilt, Uncertainty, Warning, WarningKind,
    },
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

pub(crate) fn head<'a>(
    source: &str,
    machine: &Machine,
    measurements: &(impl Iterator<Item = &'a Measurement> + Clone),
    stated: &Stated,
) -> Head {
    let of_files = |field: fn(&Metadata) -> Option<String>| {
        joined(measurements.clone().filter_map(|m| field(&m.metadata)))
    };
    let of_sensors = |field: fn(&Environment) -> Vec<StartEnd>| {
        let all = measurements.clone().flat_map(|m| field(&m.environment));
        range(all.flat_map(|value| [value.start, value.end]))
    };
    let program = |of: &Metadata| match (&of.owner, &of.version) {
        (Some(owner), Some(version)) => Some(format!("{owner} {version}")),
        (Some(owner), None) => Some(owner.clone()),
        _ => None,
    };
    Head {
        source: source.to_owned(),
        stated: Stated {
            machine: stated.machine.clone().or_else(|| of_files(|m| m.machine.clone())),
            serial: stated.serial.clone().or_else(|| of_files(|m| m.serial.clone())),
            date: stated.date.clone().or_else(|| of_files(|m| m.date.clone())),
            operator: stated.operator.clone().or_else(|| of_files(|m| m.by.clone())),
            instrument: stated.instrument.clone().or_else(|| of_files(program)),
            air_degc: (stated.air_degc)
                .or_else(|| of_sensors(|e| e.air_temperature.into_iter().collect())),
            material_degc: (stated.material_degc)
                .or_else(|| of_sensors(|e| e.material_temperature.into_iter().flatten().collect())),
            ..stated.clone()
        },
        structure: machine.chain().structure().to_string(),
        axes: machine.axes().iter().map(|axis| (axis.name, axis.travel)).collect(),
        tool_tip_mm: machine.chain().tool_tip_mm().into(),
        files: Vec::new(),
    }
}

fn joined(texts: impl Iterator<Item = String>) -> Option<String> {
    const MOST: usize = 4;
    let mut once: Vec<String> = Vec::new();
    for text in texts {
        if !once.contains(&text) {
            once.push(text);
        }
    }
    let beyond = once.len().saturating_sub(MOST);
    once.truncate(MOST);
    if beyond > 0 {
        once.push("…".to_owned());
    }
    (!once.is_empty()).then(|| once.join("; "))
}

fn range(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let finite = values.filter(|value| value.is_finite());
    finite.fold(None, |range: Option<[f64; 2]>, value| {
        let [low, high] = range.unwrap_or([value; 2]);
        Some([low.min(value), high.max(value)])
    })
}

fn of_calibration(
    file: &CalibrationFile,
    calibration: &Calibration,
    not_measured: &[String],
    stated: &Stated,
) -> Vec<Warning> {
    let mut all = Vec::new();
    let mut add = |kind: WarningKind, text: String| {
        // A message that occurs twice is kept with its most severe kind.
        if all.iter().all(|warning: &Warning| warning.text != text) {
            all.push(Warning { kind, text });
        }
    };
    for (_, text) in &calibration.contradictions {
        add(WarningKind::Contradiction, text.clone());
    }
    let named = |line: &Line, text: String| format!("{}: {text}", line.file.display());
    for line in &file.measurements {
        let error = line.setup.error;
        let is_test =
            MotionKind::of(error) == MotionKind::Positioning && line.setup.method == Method::Direct;
        if is_test {
            let lacks = shortfalls(&line.readings, error.axis.kind(), stated.edition);
            if !lacks.is_empty() {
                add(WarningKind::Few, named(line, lacks.join("; ")));
            }
        }
    }
    let mut silent = Vec::new();
    let mut surroundings = Vec::new();
    for line in &file.measurements {
        let environment = &line.readings.environment;
        let is_length = line.setup.error.axis.kind() == AxisKind::Linear
            && MotionKind::of(line.setup.error) == MotionKind::Positioning;
        let quantity = if is_length { Quantity::Positioning } else { Quantity::Angle };
        for text in environment_notes(environment, quantity) {
            surroundings.push((line.file.display().to_string(), text));
        }
        let is_silent = environment.material_temperature.iter().flatten().next().is_none();
        if is_length && is_silent {
            silent.push(line.file.display().to_string());
        }
    }
    for text in with_files(surroundings) {
        add(WarningKind::Temperature, text);
    }
    if let Some(text) = stated.material_degc.and_then(material) {
        add(WarningKind::Temperature, text);
    }
    if let ([first, others @ ..], None) = (silent.as_slice(), stated.material_degc) {
        let files = match others.len() {
            0 => format!("{first} states"),
            more => format!("{first} and {more} other positioning files state"),
        };
        add(
            WarningKind::Temperature,
            format!(
                "{files} no material temperature: whether the lengths hold for 20 °C is not known"
            ),
        );
    }
    for line in &file.measurements {
        for hint in outlier_hints(&line.readings) {
            add(WarningKind::Outlier, named(line, hint.text));
        }
    }
    for text in not_measured {
        add(WarningKind::NotMeasured, text.clone());
    }
    let of_one_run: Vec<String> =
        squareness_lines_of_one_run(file).map(|line| line.file.display().to_string()).collect();
    if !of_one_run.is_empty() {
        add(
            WarningKind::Few,
            format!(
                "{}: one run; U of the squareness from it does not contain the alignment and drift of the reference, which several runs show",
                of_one_run.join(", ")
            ),
        );
    }
    for text in &calibration.warnings {
        add(WarningKind::Note, text.clone());
    }
    all.sort_by_key(|warning| warning.kind);
    all
}

/// Warning if the stated material temperature is far from 20 °C.
fn material([low, high]: [f64; 2]) -> Option<String> {
    let farthest = (low - REFERENCE_DEGC).abs().max((high - REFERENCE_DEGC).abs());
    (farthest > MATERIAL_WITHIN_K).then(|| {
        format!(
            "the material temperature is stated as {low:.2} to {high:.2} °C, farther than {MATERIAL_WITHIN_K} K from 20 °C: whether the readings are brought to 20 °C is not known"
        )
    })
}

pub(crate) fn warnings<T: ToString>(
    kind: WarningKind,
    texts: &[T],
) -> impl Iterator<Item = Warning> {
    texts.iter().map(move |text| Warning { kind, text: text.to_string() })
}

fn is_measured(calibration: &Calibration, pair: [AxisName; 2]) -> bool {
    let named = calibration.squareness.iter().map(|(error, _)| *error);
    let found = calibration.identified.iter().flat_map(|of| &of.found.parameters);
    let found =
        found.filter(|parameter| parameter.determined).filter_map(|parameter| parameter.error);
    named.chain(found).any(|error| error.location && pair_of(error) == Some(pair))
}

pub(crate) fn positioning(file: &CalibrationFile, edition: Edition) -> Vec<Positioning> {
    let lines = file.measurements.iter();
    let tests = lines.filter(|line| {
        MotionKind::of(line.setup.error) == MotionKind::Positioning
            && line.setup.method == Method::Direct
    });
    let test = |line: &Line| {
        let error = line.setup.error;
        // Lines that cannot be evaluated are skipped; they cannot be calibrated either.
        let result = evaluate(&line.readings).ok()?;
        Some(Positioning {
            file: line.file.display().to_string(),
            error: error.to_string(),
            x_unit: error.axis.kind().coordinate_unit().to_owned(),
            unit: error.component.symbol().to_owned(),
            runs: runs_of(&line.readings, |_, _, reading| Some(reading)),
            edition: edition.year(),
            vdi: vdi_3441(&result),
            uncertainties: uncertainties(file, line),
            result,
        })
    };
    tests.filter_map(test).collect()
}

/// Expanded uncertainties of the figures, from the contributions of the instrument in the calibration file: the scale contribution is
/// proportional to the length, the other applies to each reading. Both are common to all readings at a target, and cancel in B and R.
fn uncertainties(file: &CalibrationFile, line: &Line) -> Vec<FigureUncertainty> {
    let of = &file.uncertainty;
    let targets = line.readings.targets();
    let ends = targets.first().zip(targets.last());
    let travel = ends.map_or(0.0, |(first, last)| last - first);
    let positive = |standard: f64| (standard > 0.0).then_some(2.0 * standard);
    let (inputs, length) = if line.setup.error.component.is_angular() {
        // The reading uncertainty of an angle is in µrad and independent of the length.
        let device_um = positive(of.reading_urad);
        (UncertaintyInputs { device_um, ..UncertaintyInputs::default() }, 1.0)
    } else {
        let inputs = UncertaintyInputs {
            device_um_per_m: positive(of.laser_um_per_m),
            device_um: positive(of.reading_um),
            ..UncertaintyInputs::default()
        };
        (inputs, 1e-3 * travel)
    };
    let runs = Direction::BOTH.map(|direction| line.readings.runs(direction).len());
    let fewest = runs.into_iter().filter(|runs| *runs > 0).min().unwrap_or(1);
    // With a single target there is no length, and so no uncertainty.
    let Ok(found) = positioning_uncertainty(&inputs, length, fewest) else {
        return Vec::new();
    };
    let symbols = Edition::symbols().into_iter();
    symbols
        .filter_map(|symbol| {
            Some(FigureUncertainty { symbol: symbol.to_owned(), expanded: found.of(symbol)? })
        })
        .collect()
}

impl Positioning {
    /// Value of a figure by its symbol in ISO 230-2 or VDI/DGQ 3441; `None` if the runs do not determine it.
    pub fn figure(&self, symbol: &str) -> Option<f64> {
        let iso = Edition::default().quantities(&self.result);
        let vdi = Vdi3441::quantities(self.vdi.as_ref());
        let found = iso.iter().chain(&vdi).find(|q| q.symbol == symbol)?;
        found.value
    }

    /// Expanded uncertainty of a figure; `None` if the calibration file states no contribution to it.
    pub fn uncertainty(&self, symbol: &str) -> Option<f64> {
        let found = self.uncertainties.iter().find(|of| of.symbol == symbol);
        found.map(|of| of.expanded)
    }
}

const PAIRS: [[AxisName; 2]; 3] =
    [[AxisName::X, AxisName::Y], [AxisName::Y, AxisName::Z], [AxisName::X, AxisName::Z]];

/// Angles between the linear axes from the location errors of a machine. `measured` returns
/// whether the calibration determined the angle of a pair, `uncertainty` the standard uncertainty
/// of an error, µrad.
pub(crate) fn squares(
    machine: &Machine,
    measured: impl Fn([AxisName; 2]) -> bool,
    uncertainty: impl Fn(ErrorName) -> Option<f64>,
) -> Vec<Square> {
    let pairs = PAIRS.into_iter().filter_map(|pair| {
        if pair.iter().any(|name| machine.axis(*name).is_none()) {
            return None;
        }
        let mut from = Vec::new();
        let mut angle_urad = 0.0;
        for (name, value) in machine.locations() {
            let Some(opens) = opening(*name).filter(|_| pair_of(*name) == Some(pair)) else {
                continue;
            };
            angle_urad += opens * value;
            from.push(Tilt {
                error: name.to_string(),
                urad: *value,
                uncertainty: uncertainty(*name),
            });
        }
        (!from.is_empty()).then(|| Square {
            first: pair[0].to_string(),
            second: pair[1].to_string(),
            angle_urad,
            from,
            measured: measured(pair),
        })
    });
    pairs.collect()
}

pub(crate) fn pair_of(error: ErrorName) -> Option<[AxisName; 2]> {
    PAIRS.into_iter().find(|pair| {
        pair.contains(&error.axis)
            && pair.iter().all(|axis| axis.mcs_index() != error.component.mcs_index())
    })
}

/// The location errors other than squareness.
fn other_locations(machine: &Machine, stated: &[volcomp_calibrate::Location]) -> Vec<Location> {
    let others = machine.locations().iter().filter(|(name, _)| !is_square(**name));
    let location = |(name, value): (&ErrorName, &f64)| Location {
        error: name.to_string(),
        value: *value,
        unit: name.component.symbol().to_owned(),
        uncertainty: stated
            .iter()
            .find(|of| of.error == *name)
            .map(|of| of.uncertainty)
            .filter(|stated| *stated > 0.0),
    };
    others.map(location).collect()
}

pub(crate) fn identified(found: &Identification) -> Identified {
    let parameters = found.parameters.iter().map(|parameter| Parameter {
        name: parameter.name.clone(),
        value: parameter.value,
        uncertainty: parameter.uncertainty,
        unit: unit_symbol(parameter.unit).to_owned(),
        given_zero: parameter.given_zero.clone(),
    });
    let next = found.next.as_ref().map(|next| {
        let pose = next.pose.iter().map(|(axis, at)| format!("{axis} = {at:.1}"));
        let mut with: Vec<String> = pose.collect();
        with.extend(next.target.clone());
        with.extend(next.tool.as_ref().map(|tool| format!("tool {tool}")));
        format!("{} ({}): {}", with.join(", "), next.file, next.parameter)
    });
    Identified {
        parameters: parameters.collect(),
        rank: found.rank,
        of: found.parameters.len().saturating_sub(found.redundant.len()),
        score: found.score_of_determined,
        excess: found.excess,
        residual: found.residual,
        left_out: found.left_out.map(|of| of.figures),
        judged: found.judged,
        null_space: found.null.clone(),
        redundant: found.redundant.clone(),
        next,
    }
}

/// Note on the unknowns that the observations do not determine, which leave their errors undecided; `None` without any.
pub(crate) fn left_open(found: &Identified) -> Option<String> {
    let open: Vec<&str> = found.left_open().collect();
    (!open.is_empty())
        .then(|| format!("not determined by the observations, taken as 0: {}", open.join(", ")))
}

pub(crate) fn files(observations: &Observations) -> impl Iterator<Item = SourceFile> {
    observations.observations.iter().map(|of| SourceFile {
        file: of.file.clone(),
        measures: of.kind.name().to_owned(),
        targets: of.rows.len(),
        runs: None,
        date: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By the right-hand rule EC0Y and EA0Z increase the angles XY and YZ, and EB0Z decreases XZ (see `volcomp_metrology::squareness`). The
    /// same tilt of the other axis has the opposite effect.
    #[test]
    fn location_errors_open_and_close_the_angles() {
        let machine = Machine::parse(
            "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 1000]\nY.travel = [0, 1000]\nZ.travel = [0, 1000]\n[errors]\nEC0Y = 10.0\nEA0Z = 20.0\nEB0Z = 30.0\nEC0X = 4.0\n",
            "machine.toml",
        )
        .expect("a machine");
        let found = squares(&machine, |pair| pair[0] == AxisName::Y, |_| None);
        let angles: Vec<f64> = found.iter().map(|square| square.angle_urad).collect();
        assert_eq!(angles, [6.0, 20.0, -30.0]);
        assert_eq!(found[0].from.len(), 2);
        assert!(found[1].measured && !found[2].measured);
        assert!(other_locations(&machine, &[]).is_empty());
    }
}
