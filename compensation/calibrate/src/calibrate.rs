//! From readings to a machine: angular curves, then linear ones with Abbe removed, then slopes,
//! squareness, and last the removal of the straightness lines (MODEL.md's order of work).

use std::collections::BTreeMap;

use volcomp_kinematics::{ErrorSource, nalgebra::Vector3};
use volcomp_metrology::{squareness_parts, squareness_urad};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisKind, AxisName, Component, Direction, ErrorName};

use crate::{
    branches::Branches,
    calibration_file::{CalibrationFile, Line, SquarenessSource},
    error::CalibrateError,
    track::{Kind, Lever, Track, held_state},
};

/// A tilt that was not measured is named from this effect of 1 mrad on: a lever of 1 mm.
const NAMED_ABOVE_UM_BY_MRAD: f64 = 1.0;

/// A calibrated machine and how well its curves follow the readings.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The machine with its fitted errors.
    pub machine: Machine,
    /// Each fitted curve, in the order of work.
    pub curves: Vec<FittedCurve>,
    /// Each squareness, µrad, as the calibration file names it.
    pub squareness: Vec<(ErrorName, f64)>,
    /// What a person must know: errors not measured, levers left in, notes on files.
    pub warnings: Vec<String>,
}

/// One branch of a fitted error.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedCurve {
    /// The error.
    pub error: ErrorName,
    /// The direction of motion, `None` when there is one branch for both.
    pub direction: Option<Direction>,
    /// Kind of curve, as the machine file names it.
    pub kind: &'static str,
    /// Number of targets times lines.
    pub readings: usize,
    /// Smallest and largest reading minus curve, µm or µrad.
    pub residual: [f64; 2],
    /// Root mean square of the residuals, µm or µrad.
    pub rms: f64,
    /// Leave-one-out error, µm or µrad.
    pub leave_one_out: f64,
    /// Largest difference forward − backward of the curves over the targets, with its sign, µm or
    /// µrad; of two branches only.
    pub reversal: Option<f64>,
}

/// Turns measurements into a machine. `progress` is told how many of how many errors are done.
///
/// Errors of the machine file that were not measured are kept.
///
/// # Errors
/// Readings that do not fit their error, a squareness without its straightness lines.
pub fn calibrate(
    file: &CalibrationFile,
    mut progress: impl FnMut(usize, usize),
) -> Result<Calibration, CalibrateError> {
    let mut work = Work::new(file);
    let mut names: Vec<ErrorName> = file.measurements.iter().map(|l| l.setup.error).collect();
    // Angular errors first: linear ones need them for Abbe.
    names.sort_unstable_by_key(|name| (!name.component.is_angular(), *name));
    names.dedup();
    let count = names.len();
    for (done, &name) in names.iter().enumerate() {
        let tracks = work.tracks(name)?;
        work.fit(name, &names, tracks)?;
        progress(done + 1, count);
    }
    work.squareness()?;
    work.warn_of_what_was_not_measured(&names);
    Ok(work.result)
}

struct Work<'a> {
    file: &'a CalibrationFile,
    result: Calibration,
    /// Least-squares slopes of the straightness lines by MCS coordinate, µrad.
    slopes_urad: BTreeMap<ErrorName, f64>,
}

impl<'a> Work<'a> {
    fn new(file: &'a CalibrationFile) -> Self {
        Self {
            file,
            result: Calibration {
                machine: file.machine.clone(),
                curves: Vec::new(),
                squareness: Vec::new(),
                warnings: Vec::new(),
            },
            slopes_urad: BTreeMap::new(),
        }
    }

    fn lines_of(&self, name: ErrorName) -> impl Iterator<Item = &'a Line> + use<'a> {
        let lines = self.file.measurements.iter();
        lines.filter(move |line| line.setup.error == name)
    }

    /// Every line of an error, Abbe removed.
    fn tracks(&mut self, name: ErrorName) -> Result<Vec<Track<'a>>, CalibrateError> {
        let machine = &self.result.machine;
        let joint = machine.chain().joints()[machine.index_of(name.axis)?];
        let mut tracks = Vec::new();
        for line in self.lines_of(name) {
            let notes = line.readings.notes.iter();
            let named = notes.map(|note| format!("{}: {note}", line.file.display()));
            self.result.warnings.extend(named);
            let mut track = Track::new(line, &joint)?;
            if name.axis.kind() == AxisKind::Linear && !name.component.is_angular() {
                track.remove_abbe(&self.result.machine)?;
                self.warn_of_levers(&track)?;
            }
            tracks.push(track);
        }
        Ok(tracks)
    }

    /// Tilts of the axis that would act on this line and are not known.
    fn warn_of_levers(&mut self, track: &Track) -> Result<(), CalibrateError> {
        let machine = &self.result.machine;
        let line = track.line;
        let effects = Lever::new(line, machine)?.um_by_mrad(track.all().map(|point| point.0));
        for (component, effect) in Component::ALL[3..].iter().zip(effects) {
            let tilt = ErrorName::motion(*component, line.setup.error.axis);
            if effect >= NAMED_ABOVE_UM_BY_MRAD && machine.error(tilt).is_none() {
                self.result.warnings.push(format!(
                    "{tilt} was not measured: {} from {} keeps its part, over a lever of up to {effect:.0} mm",
                    line.setup.error,
                    line.file.display()
                ));
            }
        }
        Ok(())
    }

    /// Keeps the mean slope of the lines removed for squareness, by the MCS coordinate and cleared of
    /// what the held axes' tilts add.
    fn keep_slope(&mut self, name: ErrorName, tracks: &[Track<'_>]) -> Result<(), CalibrateError> {
        let machine = &self.result.machine;
        let direction = machine.chain().joints()[machine.index_of(name.axis)?].direction;
        let along_mcs = direction[name.axis.mcs_index()].signum();
        let mut sum = 0.0;
        for track in tracks {
            sum += track.removed_urad - self.held_slope_urad(track.line)?;
        }
        self.slopes_urad
            .insert(name, along_mcs * sum / tracks.len() as f64);
        Ok(())
    }

    /// Slope that the tilts of the other axes give a line at their held positions, µrad.
    ///
    /// A point of the tool, seen from the workpiece, goes along ε × u of every axis between the
    /// workpiece and the measured one; a point of the workpiece, seen from the tool, along −ε × u of
    /// every axis between the measured one and the tool.
    fn held_slope_urad(&self, line: &Line) -> Result<f64, CalibrateError> {
        let machine = &self.result.machine;
        let index = machine.index_of(line.setup.error.axis)?;
        let joints = machine.chain().joints();
        let (tilting, sign) = if line.setup.point_is_on_tool_side(joints[index].side) {
            (0..index, 1.0)
        } else {
            (index + 1..joints.len(), -1.0)
        };
        let state = held_state(line, machine)?;
        let none = Temperatures::new();
        let source = machine.source(&none);
        let tilt = tilting.fold(Vector3::zeros(), |sum: Vector3<f64>, held| {
            sum + source.error_motion(held, &state).angular_rad
        });
        let slope = tilt.cross(&joints[index].direction) * sign;
        Ok(slope[line.setup.error.component.mcs_index()] * 1e6)
    }

    /// Fits the lines of an error and sets it, zero at the reference. Positioning along an oblique
    /// axis makes one curve for each component of its direction.
    fn fit(
        &mut self,
        name: ErrorName,
        measured: &[ErrorName],
        mut tracks: Vec<Track<'_>>,
    ) -> Result<(), CalibrateError> {
        let choice = tracks.iter().find_map(|track| track.line.curve);
        let index = self.result.machine.index_of(name.axis)?;
        let straightness = Kind::of(name) == Kind::Straightness;
        if straightness {
            for track in &mut tracks {
                let line = track.reference_line()?;
                track.remove_line(&line);
            }
        }
        let branches = Branches::fit(choice.unwrap_or_default(), &mut tracks)?;
        let zero = if straightness {
            // The line is gone already, its constant with it.
            self.keep_slope(name, &tracks)?;
            0.0
        } else {
            branches.mean_at(self.file.reference[index])
        };
        for (error, share) in self.shares(name) {
            if error != name && measured.contains(&error) {
                let reason = format!(
                    "along the oblique axis {} it fills {error} too, which was measured by itself",
                    name.axis
                );
                return Err(CalibrateError::readings(&tracks, &reason));
            }
            let set = branches.scaled(share, zero);
            self.result.curves.extend(set.fitted(error));
            self.result.machine.set_error(error, set.into_curve())?;
        }
        Ok(())
    }

    /// The errors that readings of `name` make, with the factor of each: a positioning deviation p of
    /// the coordinate enters as δ = u·p (rotary: ε = u·p).
    fn shares(&self, name: ErrorName) -> Vec<(ErrorName, f64)> {
        let joints = self.result.machine.chain().joints();
        let joint = joints.iter().find(|joint| joint.name == name.axis);
        match (Kind::of(name), joint) {
            (Kind::Positioning, Some(joint)) => {
                let first = if name.component.is_angular() { 3 } else { 0 };
                let share = |k: usize| {
                    let component = Component::ALL[first + k];
                    (ErrorName::motion(component, name.axis), joint.direction[k])
                };
                let shares = (0..3).map(share);
                shares.filter(|(_, share)| share.abs() > 1e-12).collect()
            }
            _ => vec![(name, 1.0)],
        }
    }

    fn squareness(&mut self) -> Result<(), CalibrateError> {
        for entry in &self.file.squareness {
            let value = match entry.source {
                SquarenessSource::Value(value) => value,
                SquarenessSource::Slopes {
                    reference_angle_urad,
                } => {
                    let name = entry.error.to_string();
                    let [first, second] = squareness_parts(&name)?;
                    let slopes = [
                        (first, self.slope(&name, first)?),
                        (second, self.slope(&name, second)?),
                    ];
                    squareness_urad(&name, reference_angle_urad, slopes)?
                }
            };
            self.set_squareness(entry.error, value)?;
            self.result.squareness.push((entry.error, value));
        }
        Ok(())
    }

    /// A squareness is the difference of the tilts of its two axes about the third; the reference
    /// axes have none: of the pair, the primary, else the secondary.
    fn set_squareness(&mut self, error: ErrorName, value: f64) -> Result<(), CalibrateError> {
        let partner = square_partner(error);
        let [primary, secondary] = self.file.reference_axes;
        let pair = [error.axis, partner];
        let reference = if pair.contains(&primary) {
            primary
        } else {
            secondary
        };
        let (on_error, on_partner) = if reference == partner {
            (value, 0.0)
        } else {
            (0.0, -value)
        };
        let machine = &mut self.result.machine;
        for (name, value) in [
            (error, on_error),
            (ErrorName::location(error.component, partner), on_partner),
        ] {
            // A zero is written only over what the machine file had.
            if value != 0.0 || name == error || machine.locations().contains_key(&name) {
                machine.set_location(name, value)?;
            }
        }
        Ok(())
    }

    fn slope(&self, squareness: &str, straightness: &str) -> Result<f64, CalibrateError> {
        let found = self
            .slopes_urad
            .iter()
            .find(|(name, _)| name.to_string() == straightness);
        found
            .map(|(_, slope)| *slope)
            .ok_or_else(|| CalibrateError::Readings {
                error: squareness.to_owned(),
                file: straightness.to_owned(),
                reason: format!(
                    "{straightness} was not measured, expected its line or `value_urad`"
                ),
            })
    }

    fn warn_of_what_was_not_measured(&mut self, measured: &[ErrorName]) {
        let machine = &self.result.machine;
        let mut warnings = Vec::new();
        for axis in machine.axes() {
            let names = Component::ALL.map(|component| ErrorName::motion(component, axis.name));
            let not_measured = names.into_iter().filter(|name| {
                let fitted = |curve: &FittedCurve| curve.error == *name;
                !measured.contains(name) && !self.result.curves.iter().any(fitted)
            });
            let (kept, missing): (Vec<_>, Vec<_>) =
                not_measured.partition(|name| machine.error(*name).is_some());
            for (what, names) in [
                ("not measured, taken as 0", missing),
                ("not measured, kept from the machine file", kept),
            ] {
                let names: Vec<String> = names.iter().map(ErrorName::to_string).collect();
                if !names.is_empty() {
                    warnings.push(format!("{what}: {}", names.join(" ")));
                }
            }
        }
        for name in [
            ErrorName::location(Component::EC, AxisName::Y),
            ErrorName::location(Component::EA, AxisName::Z),
            ErrorName::location(Component::EB, AxisName::Z),
        ] {
            let there = |axis| machine.axis(axis).is_some();
            let known = self
                .result
                .squareness
                .iter()
                .any(|(known, _)| *known == name);
            if known || !there(name.axis) || !there(square_partner(name)) {
                continue;
            }
            warnings.push(match machine.locations().get(&name) {
                Some(value) => format!(
                    "squareness not measured, kept from the machine file: {name} = {value} urad"
                ),
                None => format!("squareness not measured, taken as 0: {name}"),
            });
        }
        self.result.warnings.extend(warnings);
    }
}

/// The other axis of a squareness: neither its own nor the one it turns about.
fn square_partner(squareness: ErrorName) -> AxisName {
    let own = squareness.axis.mcs_index();
    let about = squareness.component.mcs_index();
    [AxisName::X, AxisName::Y, AxisName::Z][3 - own - about]
}
