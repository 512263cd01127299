//! What the other axes add to the readings of a line.

use volcomp_kinematics::{ErrorMotion, ErrorSource, State};
use volcomp_model::{Machine, ModelError, Temperatures};
use volcomp_vocabulary::{AxisKind, Direction};

use crate::{abbe::held_state, calibration_file::Line, line_of_sight::LineOfSight, set_up::SetUp};

/// A machine on which one axis has no error motion, and the errors of the others stay what they are at the held positions. A
/// linear axis goes where it should; of a rotary axis its line stays where it lies.
struct Others<S> {
    of: S,
    own: usize,
    kind: AxisKind,
    held: State,
}

impl<S: ErrorSource> ErrorSource for Others<S> {
    fn error_motion(&self, axis: usize, _: &State) -> ErrorMotion {
        if axis == self.own {
            return ErrorMotion::ZERO;
        }
        self.of.error_motion(axis, &self.held)
    }

    fn location(&self, axis: usize) -> ErrorMotion {
        if axis == self.own && self.kind == AxisKind::Linear {
            return ErrorMotion::ZERO;
        }
        self.of.location(axis)
    }

    fn assembly(&self, axis: usize) -> ErrorMotion {
        self.of.assembly(axis)
    }
}

/// Readings of a perfect instrument along a line of a machine whose measured axis has no error motion.
pub(crate) struct OtherErrors<'a> {
    machine: &'a Machine,
    sight: LineOfSight<'a>,
    line: &'a Line,
}

impl<'a> OtherErrors<'a> {
    pub(crate) fn new(
        line: &'a Line,
        machine: &'a Machine,
        set_up: &SetUp,
    ) -> Result<Self, ModelError> {
        Ok(Self {
            machine,
            sight: LineOfSight::new(machine, &line.setup)?.with_artefacts(set_up),
            line,
        })
    }

    /// The readings at targets, µm or µrad; of a linear axis a straight line.
    pub(crate) fn readings(
        &self,
        targets: impl Iterator<Item = f64>,
    ) -> Result<Vec<f64>, ModelError> {
        let none = Temperatures::new();
        let own = self.sight.axis();
        let others = Others {
            of: self.machine.source(&none),
            own,
            kind: self.machine.chain().joints()[own].kind,
            held: held_state(self.line, self.machine)?,
        };
        let reading = |target| {
            let state = self.sight.state(target, Direction::Positive);
            self.sight.reading(&others, &state, &state)
        };
        Ok(targets.map(reading).collect())
    }

    /// The slope that the reference of a straightness adds, µrad.
    pub(crate) fn reference_slope_urad(&self) -> f64 {
        let none = Temperatures::new();
        self.sight.reference_slope_urad(&self.machine.source(&none))
    }
}
