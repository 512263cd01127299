//! One measured line on its way from readings to the error itself.

use volcomp_kinematics::{ErrorSource, Joint, Side, State, nalgebra::Vector3};
use volcomp_metrology::{
    CarriedSide, MetrologyError, ReferenceLine, Rides, TiltReading, Travel, abbe_um,
    angular_method_um, lever_mm,
};
use volcomp_model::{Machine, ModelError, Temperatures};
use volcomp_vocabulary::{AxisKind, Direction, ErrorName};

use crate::{calibration_file::Line, setup::Method};

/// (target in mm or deg, mean reading in µm or µrad), targets ascending.
pub(crate) type Points = Vec<(f64, f64)>;

/// What an error states of its axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// The coordinate itself: EXX, ECC.
    Positioning,
    /// A linear error across a linear axis.
    Straightness,
    /// An angular error of a linear axis, or any other of a rotary one.
    Other,
}

impl Kind {
    pub(crate) fn of(name: ErrorName) -> Self {
        let own = name.component.mcs_index() == name.axis.mcs_index();
        match (name.axis.kind(), name.component.is_angular()) {
            (AxisKind::Linear, false) | (AxisKind::Rotary, true) if own => Self::Positioning,
            (AxisKind::Linear, false) => Self::Straightness,
            _ => Self::Other,
        }
    }
}

/// The mean readings of one line, forward and backward; empty in a direction that was not run.
pub(crate) struct Track<'a> {
    pub(crate) line: &'a Line,
    pub(crate) points: [Points; 2],
    /// Slope of all lines removed so far, µrad.
    pub(crate) removed_urad: f64,
}

impl<'a> Track<'a> {
    /// The mean readings of a line; of a bridge, the profile they make.
    pub(crate) fn new(line: &'a Line, joint: &Joint) -> Result<Self, MetrologyError> {
        let mut points = Direction::BOTH.map(|direction| line.readings.mean_curve_in(direction));
        if let Method::Angular { bridge_mm, reading } = line.setup.method {
            let name = line.setup.error.to_string();
            for branch in points.iter_mut().filter(|branch| !branch.is_empty()) {
                *branch = angular_method_um(&name, reading, branch, bridge_mm)?;
                // On a reversed axis the same tilt lifts the bridge the other way along the coordinate.
                let own = joint.direction[line.setup.error.axis.mcs_index()];
                if reading == TiltReading::RightHand && own < 0.0 {
                    for (_, h) in branch.iter_mut() {
                        *h = -*h;
                    }
                }
            }
        }
        Ok(Self {
            line,
            points,
            removed_urad: 0.0,
        })
    }

    /// Standard deviation of a mean reading, pooled over targets and directions; none without
    /// repeated runs, without scatter, or where readings are summed up.
    pub(crate) fn noise_of_mean(&self) -> Option<f64> {
        if self.line.setup.method != Method::Direct {
            return None;
        }
        let readings = &self.line.readings;
        let (mut squares, mut freedom, mut count, mut groups) = (0.0, 0.0, 0.0, 0.0_f64);
        for target in readings.targets() {
            for direction in Direction::BOTH {
                let deviations = readings.deviations_at(target, direction);
                let n = deviations.len() as f64;
                let mean = deviations.iter().sum::<f64>() / n.max(1.0);
                squares += deviations.iter().map(|d| (d - mean).powi(2)).sum::<f64>();
                freedom += (n - 1.0).max(0.0);
                count += n;
                groups += f64::from(u8::from(n > 0.0));
            }
        }
        let variance = squares / freedom / (count / groups);
        (variance > 0.0 && variance.is_finite()).then(|| variance.sqrt())
    }

    pub(crate) fn all(&self) -> impl Iterator<Item = &(f64, f64)> {
        self.points.iter().flatten()
    }

    /// δ = δ_measured − ε × lever with the fitted ε of the axis.
    pub(crate) fn remove_abbe(&mut self, machine: &Machine) -> Result<(), ModelError> {
        let lever = Lever::new(self.line, machine)?;
        for (branch, direction) in self.points.iter_mut().zip(Direction::BOTH) {
            for (target, value) in branch {
                let tilts = tilts_urad(self.line, machine, *target, direction)?;
                *value -= lever.abbe_um(tilts, *target);
            }
        }
        Ok(())
    }

    /// The least-squares line through the mean of all runs of each target.
    pub(crate) fn reference_line(&self) -> Result<ReferenceLine, MetrologyError> {
        line_through(self.all().copied().collect())
    }

    /// Removes a line, intercept included.
    pub(crate) fn remove_line(&mut self, line: &ReferenceLine) {
        for branch in &mut self.points {
            *branch = line.removed_from(branch);
        }
        self.removed_urad += line.slope_urad();
    }
}

/// The least-squares line through the means of readings of the same target.
pub(crate) fn line_through(mut points: Points) -> Result<ReferenceLine, MetrologyError> {
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let means: Points = points
        .chunk_by(|a, b| a.0 == b.0)
        .map(|runs| {
            let sum: f64 = runs.iter().map(|(_, value)| value).sum();
            (runs[0].0, sum / runs.len() as f64)
        })
        .collect();
    ReferenceLine::least_squares(&means)
}

/// The lever of a measured line of a linear axis.
pub(crate) struct Lever {
    point_mcs: [f64; 3],
    carriage_mcs: [f64; 3],
    rides: Rides,
    joint: Joint,
    /// What a reading takes of a displacement: the part along the axis, or one component in MCS.
    sense: Vector3<f64>,
}

impl Lever {
    pub(crate) fn new(line: &Line, machine: &Machine) -> Result<Self, ModelError> {
        let setup = &line.setup;
        let index = machine.index_of(setup.error.axis)?;
        let joint = machine.chain().joints()[index];
        let carriage_mcs = carried_point(index, line, machine);
        let mut component = Vector3::zeros();
        component[setup.error.component.mcs_index()] = 1.0;
        Ok(Self {
            // Measured at the axis's own point unless stated; on the other side of the joint the
            // travel is a lever still.
            point_mcs: setup.point_mcs.unwrap_or(carriage_mcs),
            carriage_mcs,
            rides: setup.rides,
            joint,
            sense: match Kind::of(setup.error) {
                Kind::Positioning => joint.direction,
                _ => component,
            },
        })
    }

    /// m − c̃ with the travel on the other side of the joint, mm along the MCS axes.
    fn at_mm(&self, position_mm: f64) -> [f64; 3] {
        let travel = Travel {
            side: match self.joint.side {
                Side::Tool => CarriedSide::Tool,
                Side::Workpiece => CarriedSide::Workpiece,
            },
            direction_mcs: self.joint.direction.into(),
            position_mm,
        };
        lever_mm(self.point_mcs, self.carriage_mcs, self.rides, travel)
    }

    /// What tilts (µrad) add to a reading, µm.
    fn abbe_um(&self, tilts_urad: [f64; 3], position_mm: f64) -> f64 {
        let added = abbe_um(tilts_urad, self.at_mm(position_mm));
        self.sense.dot(&Vector3::from(added))
    }

    /// The largest reading that 1 mrad of each tilt would add at any of the positions, µm: A, B, C.
    pub(crate) fn um_by_mrad(&self, positions_mm: impl Iterator<Item = f64>) -> [f64; 3] {
        positions_mm.fold([0.0; 3], |largest, position_mm| {
            std::array::from_fn(|about| {
                let mut tilt = [0.0; 3];
                tilt[about] = 1e3;
                self.abbe_um(tilt, position_mm).abs().max(largest[about])
            })
        })
    }
}

/// c̃ = c + Σ u_h q_h over the held axes between `b` and the axis, whose motion carries it.
fn carried_point(index: usize, line: &Line, machine: &Machine) -> [f64; 3] {
    let joints = machine.chain().joints();
    let joint = joints[index];
    let carries = |other: usize| match joint.side {
        Side::Tool => joints[other].side == Side::Tool && other < index,
        Side::Workpiece => joints[other].side == Side::Workpiece && other > index,
    };
    let linear = |other: &usize| carries(*other) && joints[*other].kind == AxisKind::Linear;
    (0..joints.len())
        .filter(linear)
        .fold(joint.point_mm, |point, other| {
            // A workpiece-side axis moves its carriage the other way: coordinates are of the tool
            // relative to the workpiece.
            let sense = if joint.side == Side::Tool { 1.0 } else { -1.0 };
            point + joints[other].direction * (sense * line.setup.at[other])
        })
        .into()
}

/// ε of the measured axis at a target, µrad, on the branch of the direction.
fn tilts_urad(
    line: &Line,
    machine: &Machine,
    target: f64,
    direction: Direction,
) -> Result<[f64; 3], ModelError> {
    let index = machine.index_of(line.setup.error.axis)?;
    let mut state = held_state(line, machine)?;
    // A linear axis: mm in the chain as in the file.
    state.q[index] = target;
    state.approach[index] = match direction {
        Direction::Positive => Some(Direction::Positive),
        Direction::Negative => Some(Direction::Negative),
    };
    let none = Temperatures::new();
    let error = machine.source(&none).error_motion(index, &state);
    Ok((error.angular_rad * 1e6).into())
}

/// The held axes where they stood, the measured one at 0.
pub(crate) fn held_state(line: &Line, machine: &Machine) -> Result<State, ModelError> {
    let names = machine.axes().iter().map(|axis| axis.name);
    let coordinates: Vec<_> = names.zip(line.setup.at.iter().copied()).collect();
    machine.state(&coordinates)
}
