//! Squareness from diagonals (ISO 230-6): the displacements along two face diagonals or four body diagonals, with every
//! other error of the machine held as it was fitted.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use volcomp_document::{InputError, Section, Value};
use volcomp_identify::{
    Basis, Kind, NumberKind, Observation, Observations, Quantity, Row, Seen, SetUp, Stand, Unknown,
    identify,
};
use volcomp_kinematics::{State, nalgebra::Vector3};
use volcomp_metrology::{DeviationUnit, Measurement};
use volcomp_model::{Machine, Source};
use volcomp_vocabulary::{AxisName, Direction, Displacement, ErrorName, Urad};

use crate::{
    error::CalibrateError,
    provenance::sources_of,
    read::read_measurement,
    setup_file::set_coordinates,
    squares::{set_square, tilt_of},
};

/// Targets may stand so much of the length beyond the ends of a diagonal, for the overrun.
const BEYOND: f64 = 0.02;

/// Diagonals from which one to three squareness errors are found together.
#[derive(Clone, Debug)]
pub struct Diagonals {
    /// The squareness errors.
    pub errors: Vec<ErrorName>,
    /// The diagonals as lines of sight. The offset of each is unknown, and a scale that all share: the laser's, its
    /// material temperature's, and that of the diagonals' mean.
    pub observations: Observations,
    /// What the machine file tells of their files.
    pub sources: Vec<Source>,
}

/// What diagonals show.
pub(crate) struct Squares {
    /// The squareness errors and their values.
    pub(crate) errors: Vec<(ErrorName, Urad)>,
    /// How well they do.
    pub(crate) notes: Vec<String>,
    /// What the diagonals do not bear out.
    pub(crate) undecided: BTreeSet<ErrorName>,
}

impl Diagonals {
    /// The squareness errors that the diagonals show on a machine with all its other errors, µrad, and notes on how well they do.
    pub(crate) fn squares(
        &self,
        machine: &Machine,
        reference_axes: [AxisName; 2],
    ) -> Result<Squares, CalibrateError> {
        let mut machine = machine.clone();
        for error in &self.errors {
            set_square(&mut machine, reference_axes, *error, Urad(0.0))?;
        }
        let mut observations = self.observations.clone();
        observations.machine = machine;
        let found = identify(&observations, |_, _| {})?;
        let square = |error: &ErrorName| {
            let (tilt, sign) = tilt_of(*error, reference_axes);
            let name = tilt.to_string();
            let parameter = found.parameters.iter().find(|p| p.name == name);
            match parameter.filter(|p| p.determined && p.given_zero.is_empty()) {
                Some(parameter) => Ok((*error, Urad(sign * parameter.value))),
                None => Err(CalibrateError::Diagonals {
                    error: *error,
                    files: self.files().collect(),
                }),
            }
        };
        let errors = self.errors.iter().map(square).collect::<Result<_, _>>()?;
        let names: Vec<String> = self.errors.iter().map(ErrorName::to_string).collect();
        let names = names.join(" ");
        let notes = found.warnings.iter();
        let notes = notes.map(|note| format!("{names} from diagonals: {note}"));
        Ok(Squares {
            errors,
            notes: notes.collect(),
            undecided: found.undecided(),
        })
    }

    /// The measurement files, for messages.
    fn files(&self) -> impl Iterator<Item = PathBuf> {
        let files = self.observations.observations.iter();
        files.map(|observation| PathBuf::from(&observation.file))
    }
}

/// The diagonals of a `[[squareness]]` with the key `diagonals`.
pub(crate) fn decode_diagonals(
    value: &Value<'_>,
    errors: Vec<ErrorName>,
    uncertainty_um: f64,
    (machine, reference_axes): (&Machine, [AxisName; 2]),
    folder: &Path,
) -> Result<Diagonals, CalibrateError> {
    let mut found = Observations {
        files: Vec::new(),
        machine: machine.clone(),
        measured: Vec::new(),
        unknown: Vec::new(),
        observations: Vec::new(),
        setup: SetUp::default(),
        robust: false,
        folds: 0,
        notes: Vec::new(),
    };
    for error in &errors {
        found.unknown.push(Unknown {
            error: tilt_of(*error, reference_axes).0,
            basis: Some(Basis::Constant),
            second: None,
            reversal: false,
            penalised: false,
        });
    }
    let number = |name: String| Quantity {
        name,
        value: Some(0.0),
        unknown: true,
        drift: 0,
        known_within: None,
    };
    let setup = &mut found.setup;
    let scale = setup.numbers.len();
    setup
        .numbers
        .push(number("scale of the diagonals".to_owned()));
    setup.number_kinds.push(NumberKind::Slope);
    let items = value.items()?;
    if items.len() < 2 {
        return Err(value
            .error(format!(
                "found {} diagonals, expected two face diagonals or the four body diagonals",
                items.len()
            ))
            .into());
    }
    for item in items {
        let section = item.section()?;
        section.allow(&["file", "from", "to"])?;
        let file_value = section.require("file")?;
        let (file, readings) = read_measurement(&file_value, folder, None)?;
        if readings.unit == Some(DeviationUnit::Urad) {
            return Err(file_value
                .error("the file holds angles, expected lengths")
                .into());
        }
        let [from, to] = ["from", "to"].map(|key| end(&section, key, machine));
        let (from, to) = (from?, to?);
        let offset = setup.numbers.len();
        setup
            .numbers
            .push(number(format!("{}:offset", file.display())));
        setup.number_kinds.push(NumberKind::Offset);
        found.observations.push(Observation {
            file: file.display().to_string(),
            kind: Kind::Line,
            judge: false,
            rows: rows(
                &file_value,
                machine,
                (&from, &to),
                (&readings, uncertainty_um),
                [offset, scale],
            )?,
        });
        found.files.push(file);
    }
    Ok(Diagonals {
        errors,
        sources: sources_of(folder, &found.files)?,
        observations: found,
    })
}

/// Where a diagonal begins or ends, mm or deg by the place of the axis.
fn end(section: &Section<'_>, key: &str, machine: &Machine) -> Result<Vec<f64>, InputError> {
    let mut coordinates = vec![0.0; machine.axes().len()];
    let value = section.require(key)?;
    set_coordinates(&mut coordinates, &value.section()?, machine)?;
    Ok(coordinates)
}

/// A row for each mean reading of a diagonal, with its standard uncertainty, µm; `offset` and `scale` are the places of the numbers of its set-up.
fn rows(
    file: &Value<'_>,
    machine: &Machine,
    (from, to): (&[f64], &[f64]),
    (readings, uncertainty_um): (&Measurement, f64),
    [offset, scale]: [usize; 2],
) -> Result<Vec<Row>, CalibrateError> {
    let names = || machine.axes().iter().map(|axis| axis.name);
    for ((name, from), to) in names().zip(from).zip(to) {
        if name.is_rotary() && from != to {
            let message = format!(
                "{name} turns along this diagonal, expected the same angle in `from` and `to`"
            );
            return Err(file.error(message).into());
        }
    }
    let state_at = |share: f64| -> Result<State, CalibrateError> {
        let between = from
            .iter()
            .zip(to)
            .map(|(from, to)| from + share * (to - from));
        let coordinates: Vec<(AxisName, f64)> = names().zip(between).collect();
        Ok(machine.state(&coordinates)?)
    };
    let chain = machine.chain();
    let way: Vector3<f64> =
        chain.ideal_tip_mm(&state_at(1.0)?) - chain.ideal_tip_mm(&state_at(0.0)?);
    let length = way.norm();
    let Some(direction) = way.try_normalize(1e-9) else {
        return Err(file
            .error("`from` and `to` are the same place, expected the ends of a diagonal")
            .into());
    };
    let targets = readings.targets();
    let (first, last) = (targets.first().copied(), targets.last().copied());
    let (first, last) = (first.unwrap_or_default(), last.unwrap_or_default());
    if first < -BEYOND * length || last > (1.0 + BEYOND) * length {
        return Err(file
            .error(format!(
                "found targets from {first} to {last} mm, expected distances from the beginning of the diagonal, 0 to {length:.1} mm"
            ))
            .into());
    }
    let both = Direction::BOTH
        .iter()
        .all(|direction| readings.has(*direction));
    let forward = readings.has(Direction::Positive);
    let mut rows = Vec::new();
    for (target, mean_um) in readings.mean_curve() {
        let mut state = state_at(target / length)?;
        for (approach, (from, to)) in state.approach.iter_mut().zip(from.iter().zip(to)) {
            // With readings in both directions the mean of both branches is what their mean shows.
            if !both && from != to {
                *approach = Some(if (to > from) == forward {
                    Direction::Positive
                } else {
                    Direction::Negative
                });
            }
        }
        rows.push(Row {
            line: 0,
            stand: Stand {
                state,
                tip_mm: chain.tool_tip_mm(),
            },
            seen: Seen::Line {
                direction,
                offset,
                slope: scale,
                deviation_mm: Displacement::from_micro(
                    volcomp_vocabulary::AxisKind::Linear,
                    mean_um,
                )
                .mm_or_rad(),
            },
            run: None,
            time: 0.0,
            uncertainty_mm: uncertainty_um * 1e-3,
        });
    }
    Ok(rows)
}
