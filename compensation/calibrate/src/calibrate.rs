//! From readings to a machine: angular curves, then linear ones with Abbe removed, then slopes,
//! squareness, and last the removal of the straightness lines (MODEL.md's order of work).

use std::collections::BTreeMap;

use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_fit::{
    Fit, FitError, fit_auto, fit_bspline, fit_chebyshev, fit_cubic_table, fit_fourier,
    fit_linear_table, fit_mls, fit_polynomial,
};
use volcomp_kinematics::{Approach, ErrorSource, Joint, JointKind, Side, nalgebra::Vector3};
use volcomp_metrology::{
    CarriedSide, Direction, ReferenceLine, Travel, abbe_um, angular_method_um, lever_mm,
    squareness_parts, squareness_urad,
};
use volcomp_model::{Component, ErrorName, Machine, Temperatures};

use crate::{
    calibration_file::{CalibrationFile, CurveChoice, Line, Method, SquarenessSource},
    error::CalibrateError,
};

/// A lever shorter than this takes no notable part: 1 mm times 100 µrad is 0.1 µm.
const LEVER_COUNTS_ABOVE_MM: f64 = 1.0;

/// A calibrated machine and how well its curves follow the readings.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The machine with its fitted errors.
    pub machine: Machine,
    /// Each fitted curve, in the order of work.
    pub curves: Vec<FittedCurve>,
    /// Each squareness error, µrad.
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
}

/// Mean readings of one line in one direction: (target, value in µm or µrad).
type Points = Vec<(f64, f64)>;

/// The lines of one error, split by direction.
struct Profile {
    error: ErrorName,
    curve: CurveChoice,
    files: String,
    /// Points of every line and direction.
    branches: Vec<(Direction, Points)>,
}

/// Turns measurements into a machine. `progress` is told how many of how many errors are done.
///
/// # Errors
/// Readings that do not fit their error, a squareness without its straightness lines.
pub fn calibrate(
    file: &CalibrationFile,
    mut progress: impl FnMut(usize, usize),
) -> Result<Calibration, CalibrateError> {
    let mut work = Work::new(file);
    let mut names: Vec<ErrorName> = file.measurements.iter().map(|line| line.error).collect();
    // Angular errors first: linear ones need them for Abbe.
    names.sort_unstable_by_key(|name| (!name.component.is_angular(), *name));
    names.dedup();
    let count = names.len();
    for (done, name) in names.into_iter().enumerate() {
        let mut profile = work.profile(name)?;
        if is_straightness(name) {
            work.remove_line(&mut profile)?;
        }
        work.fit(&profile)?;
        progress(done + 1, count);
    }
    work.squareness()?;
    work.warn_of_what_was_not_measured();
    Ok(work.result)
}

/// A linear error across a linear axis.
fn is_straightness(name: ErrorName) -> bool {
    name.axis.kind() == JointKind::Linear
        && !name.component.is_angular()
        && name.component.mcs_index() != name.axis.mcs_index()
}

struct Work<'a> {
    file: &'a CalibrationFile,
    result: Calibration,
    /// Least-squares slopes of the straightness lines, µrad.
    slopes_urad: BTreeMap<ErrorName, f64>,
}

impl<'a> Work<'a> {
    fn new(file: &'a CalibrationFile) -> Self {
        let mut machine = file.machine.clone();
        machine.clear_errors();
        Self {
            file,
            result: Calibration {
                machine,
                curves: Vec::new(),
                squareness: Vec::new(),
                warnings: Vec::new(),
            },
            slopes_urad: BTreeMap::new(),
        }
    }

    fn lines_of(&self, name: ErrorName) -> Vec<&'a Line> {
        let lines = self.file.measurements.iter();
        lines.filter(|line| line.error == name).collect()
    }

    /// Every line of an error, Abbe removed.
    fn profile(&mut self, name: ErrorName) -> Result<Profile, CalibrateError> {
        let lines = self.lines_of(name);
        let mut profile = Profile {
            error: name,
            curve: lines.first().map_or(CurveChoice::Auto, |line| line.curve),
            files: String::new(),
            branches: Vec::new(),
        };
        for line in lines {
            if !profile.files.is_empty() {
                profile.files.push_str(", ");
            }
            profile.files.push_str(&line.file.display().to_string());
            self.note_file(line);
            for direction in Direction::BOTH {
                if line.readings.has(direction) {
                    let points = self.points(line, direction)?;
                    profile.branches.push((direction, points));
                }
            }
        }
        Ok(profile)
    }

    fn note_file(&mut self, line: &Line) {
        let file = line.file.display();
        let notes = line
            .readings
            .notes
            .iter()
            .map(|note| format!("{file}: {note}"));
        self.result.warnings.extend(notes);
    }

    /// The mean readings of a line in one direction as the error itself.
    fn points(&mut self, line: &Line, direction: Direction) -> Result<Points, CalibrateError> {
        let mut points = line.readings.mean_curve_in(direction);
        if let Method::Angular { bridge_mm, reading } = line.method {
            points = angular_method_um(&line.error.to_string(), reading, &points, bridge_mm)?;
        }
        let along = self.along_axis(line)?;
        for (_, value) in &mut points {
            *value *= along;
        }
        if !line.error.component.is_angular() && line.error.axis.kind() == JointKind::Linear {
            self.remove_abbe(line, direction, &mut points)?;
        }
        Ok(points)
    }

    /// A positioning deviation p of the coordinate enters as δ = u·p (rotary: ε = u·p): −1 on a
    /// reversed axis.
    fn along_axis(&self, line: &Line) -> Result<f64, CalibrateError> {
        let name = line.error;
        let angular_axis = name.axis.kind() == JointKind::Rotary;
        let positioning = name.component.mcs_index() == name.axis.mcs_index()
            && name.component.is_angular() == angular_axis;
        let joint = self.joint(name)?;
        let share = joint.direction[name.component.mcs_index()];
        match (positioning, share.abs() > 1.0 - 1e-9) {
            (false, _) => Ok(1.0),
            (true, true) => Ok(share.signum()),
            (true, false) => Err(readings_error(
                line,
                "a positioning deviation along an oblique axis fills several errors, expected an axis along its letter",
            )),
        }
    }

    fn joint(&self, name: ErrorName) -> Result<Joint, CalibrateError> {
        let index = self.result.machine.index_of(name.axis)?;
        Ok(self.result.machine.chain().joints()[index])
    }

    /// δ = δ_measured − ε × lever with the fitted ε of the axis.
    fn remove_abbe(
        &mut self,
        line: &Line,
        direction: Direction,
        points: &mut Points,
    ) -> Result<(), CalibrateError> {
        let index = self.result.machine.index_of(line.error.axis)?;
        let component = line.error.component.mcs_index();
        let carriage = self.carried_point(index, line);
        // Measured at the axis's own point; on the other side of the joint the travel is a lever still.
        let point = line.point_mcs.unwrap_or(carriage);
        let joint = self.result.machine.chain().joints()[index];
        let lever = |q: f64| {
            let side = match joint.side {
                Side::Tool => CarriedSide::Tool,
                Side::Workpiece => CarriedSide::Workpiece,
            };
            let travel = Travel {
                side,
                direction_mcs: joint.direction.into(),
                position_mm: q,
            };
            lever_mm(point, carriage, line.rides, travel)
        };
        for (q, value) in points.iter_mut() {
            let tilts = self.tilts_urad(index, line, *q, direction)?;
            *value -= abbe_um(tilts, lever(*q))[component];
        }
        let reach = |k: usize| {
            points
                .iter()
                .map(|(q, _)| lever(*q)[k].abs())
                .fold(0.0, f64::max)
        };
        self.warn_of_levers(line, component, &reach);
        Ok(())
    }

    /// c̃ = c + Σ u_h q_h over the held axes between `b` and the axis, whose motion carries it.
    fn carried_point(&self, index: usize, line: &Line) -> [f64; 3] {
        let joints = self.result.machine.chain().joints();
        let joint = joints[index];
        let carries = |other: usize| match joint.side {
            Side::Tool => joints[other].side == Side::Tool && other < index,
            Side::Workpiece => joints[other].side == Side::Workpiece && other > index,
        };
        let linear = |other: &usize| carries(*other) && joints[*other].kind == JointKind::Linear;
        (0..joints.len())
            .filter(linear)
            .fold(joint.point_mm, |point, other| {
                // A workpiece-side axis moves its carriage the other way: coordinates are of the
                // tool relative to the workpiece.
                let sense = if joint.side == Side::Tool { 1.0 } else { -1.0 };
                point + joints[other].direction * (sense * line.at[other])
            })
            .into()
    }

    /// ε of the axis at a target, µrad, on the branch of the direction.
    fn tilts_urad(
        &self,
        index: usize,
        line: &Line,
        target: f64,
        direction: Direction,
    ) -> Result<[f64; 3], CalibrateError> {
        let machine = &self.result.machine;
        let coordinates: Vec<_> = machine
            .axes()
            .iter()
            .enumerate()
            .map(|(place, axis)| {
                (
                    axis.name,
                    if place == index {
                        target
                    } else {
                        line.at[place]
                    },
                )
            })
            .collect();
        let mut state = machine.state(&coordinates)?;
        state.approach[index] = match direction {
            Direction::Forward => Approach::Positive,
            Direction::Backward => Approach::Negative,
        };
        let none = Temperatures::new();
        let error = machine.source(&none).error_motion(index, &state);
        Ok((error.angular_rad * 1e6).into())
    }

    /// The two rotations normal to a component act through the other two parts of the lever.
    fn warn_of_levers(&mut self, line: &Line, component: usize, reach: &dyn Fn(usize) -> f64) {
        for (about, through) in [(1, 2), (2, 1)] {
            let about = Component::ALL[3 + (component + about) % 3];
            let length = reach((component + through) % 3);
            let angular = ErrorName::motion(about, line.error.axis);
            if length > LEVER_COUNTS_ABOVE_MM && self.result.machine.error(angular).is_none() {
                let warning = format!(
                    "{angular} was not measured: {} from {} keeps its part over a lever of {length:.0} mm",
                    line.error,
                    line.file.display()
                );
                if !self.result.warnings.contains(&warning) {
                    self.result.warnings.push(warning);
                }
            }
        }
    }

    /// Keeps the slope for squareness, cleared of what the held axes' tilts add, and removes the whole
    /// line. The slope is that of the mean of all runs, each target once.
    fn remove_line(&mut self, profile: &mut Profile) -> Result<(), CalibrateError> {
        let mut sums: Vec<(f64, f64, f64)> = Vec::new();
        for &(q, value) in profile.branches.iter().flat_map(|(_, points)| points) {
            match sums.iter_mut().find(|sum| (sum.0 - q).abs() < 1e-9) {
                Some(sum) => *sum = (sum.0, sum.1 + value, sum.2 + 1.0),
                None => sums.push((q, value, 1.0)),
            }
        }
        let means: Points = sums
            .iter()
            .map(|(q, sum, count)| (*q, sum / count))
            .collect();
        let line = ReferenceLine::least_squares(&means)?;
        let held = self.held_slope_urad(profile.error)?;
        self.slopes_urad
            .insert(profile.error, line.slope_urad() - held);
        for (_, points) in &mut profile.branches {
            *points = line.removed_from(points);
        }
        Ok(())
    }

    /// Slope that the tilts of the axes before this one (seen from the workpiece) give its line at
    /// their held positions: ε_h × u, µrad; the mean over the lines.
    fn held_slope_urad(&self, name: ErrorName) -> Result<f64, CalibrateError> {
        let machine = &self.result.machine;
        let index = machine.index_of(name.axis)?;
        let direction = machine.chain().joints()[index].direction;
        let none = Temperatures::new();
        let source = machine.source(&none);
        let lines = self.lines_of(name);
        let mut slope = 0.0;
        for line in &lines {
            let coordinates: Vec<_> = machine
                .axes()
                .iter()
                .map(|axis| axis.name)
                .zip(line.at.iter().copied())
                .collect();
            let state = machine.state(&coordinates)?;
            let tilt = (0..index).fold(Vector3::zeros(), |sum: Vector3<f64>, before| {
                sum + source.error_motion(before, &state).angular_rad
            });
            slope += tilt.cross(&direction)[name.component.mcs_index()] * 1e6 / lines.len() as f64;
        }
        Ok(slope)
    }

    /// Fits every direction of a profile and sets the error, zero at the reference.
    fn fit(&mut self, profile: &Profile) -> Result<(), CalibrateError> {
        let mut fits: Vec<(Direction, Fit)> = Vec::new();
        for direction in Direction::BOTH {
            let points = profile
                .branches
                .iter()
                .filter(|(d, _)| *d == direction)
                .flat_map(|(_, p)| p);
            let (x, u): (Vec<f64>, Vec<f64>) = points.copied().unzip();
            if x.is_empty() {
                continue;
            }
            let fit = fit_branch(profile.curve, &x, &u).map_err(|e| CalibrateError::Readings {
                error: profile.error.to_string(),
                file: profile.files.clone(),
                reason: e.to_string(),
            })?;
            fits.push((direction, fit));
        }
        let single = fits.len() == 1;
        for (direction, fit) in &fits {
            self.result.curves.push(FittedCurve {
                error: profile.error,
                direction: (!single).then_some(*direction),
                kind: kind(&fit.curve),
                readings: fit.residuals.len(),
                residual: [fit.min(), fit.max()],
                rms: fit.rms(),
                leave_one_out: fit.leave_one_out_rms,
            });
        }
        let index = self.result.machine.index_of(profile.error.axis)?;
        let reference = self.file.reference[index];
        let zero = fits
            .iter()
            .map(|(_, fit)| fit.curve.value(reference))
            .sum::<f64>()
            / fits.len() as f64;
        // The line of a straightness is gone already, its constant with it.
        let shift = if is_straightness(profile.error) {
            0.0
        } else {
            -zero
        };
        let mut fields = fits
            .into_iter()
            .map(|(_, fit)| Field::Curve(fit.curve.offset(shift)));
        let curve = match (fields.next(), fields.next()) {
            (Some(forward), Some(backward)) => ErrorCurve::Pair { forward, backward },
            (Some(single), None) => ErrorCurve::Single(single),
            _ => return Ok(()),
        };
        Ok(self.result.machine.set_error(profile.error, curve)?)
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
            self.result.machine.set_location(entry.error, value)?;
            self.result.squareness.push((entry.error, value));
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

    fn warn_of_what_was_not_measured(&mut self) {
        let machine = &self.result.machine;
        let mut warnings = Vec::new();
        for axis in machine.axes() {
            let missing: Vec<String> = Component::ALL
                .into_iter()
                .map(|component| ErrorName::motion(component, axis.name))
                .filter(|name| machine.error(*name).is_none())
                .map(|name| name.to_string())
                .collect();
            if !missing.is_empty() {
                warnings.push(format!("not measured, taken as 0: {}", missing.join(" ")));
            }
        }
        let axes: Vec<String> = machine
            .axes()
            .iter()
            .map(|axis| axis.name.to_string())
            .collect();
        for (name, [first, second]) in [
            ("EC0Y", ["X", "Y"]),
            ("EA0Z", ["Y", "Z"]),
            ("EB0Z", ["X", "Z"]),
        ] {
            let there = |axis: &str| axes.iter().any(|a| a == axis);
            let known = machine.locations().keys().any(|n| n.to_string() == name);
            if there(first) && there(second) && !known {
                warnings.push(format!("squareness not measured, taken as 0: {name}"));
            }
        }
        self.result.warnings.extend(warnings);
    }
}

fn readings_error(line: &Line, reason: &str) -> CalibrateError {
    CalibrateError::Readings {
        error: line.error.to_string(),
        file: line.file.display().to_string(),
        reason: reason.to_owned(),
    }
}

fn fit_branch(choice: CurveChoice, x: &[f64], u: &[f64]) -> Result<Fit, FitError> {
    let lowest = x.iter().copied().fold(f64::INFINITY, f64::min);
    let highest = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let domain = [lowest, highest];
    match choice {
        CurveChoice::Auto => fit_auto(x, u, None),
        CurveChoice::Polynomial { order } => fit_polynomial(x, u, order, domain),
        CurveChoice::Chebyshev { order } => fit_chebyshev(x, u, order, domain),
        CurveChoice::MovingLeastSquares {
            order,
            support,
            shape,
        } => fit_mls(x, u, order, support, shape),
        CurveChoice::BSpline => fit_bspline(x, u),
        CurveChoice::LinearTable => fit_linear_table(x, u),
        CurveChoice::CubicTable => fit_cubic_table(x, u),
        CurveChoice::Fourier { order, period } => fit_fourier(x, u, order, period, domain),
    }
}

fn kind(curve: &Curve) -> &'static str {
    match curve {
        Curve::Constant(_) => "constant",
        Curve::Polynomial(_) => "poly",
        Curve::Chebyshev(_) => "chebyshev",
        Curve::Table(_) => "table",
        Curve::BSpline(_) => "bspline",
        Curve::Fourier(_) => "fourier",
        Curve::MovingLeastSquares(_) => "mls",
    }
}
