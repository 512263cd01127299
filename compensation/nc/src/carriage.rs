//! Where the carriages of a virtual machine are while its drives go where they are told to.

use crate::{
    coordinates::{Axes, is_rotary},
    correction::Corrector,
    motion::Path,
    turns::steps_of,
    verify::{Made, place_of},
};

/// State: the play operator of each axis. A carriage stays where it is until the flank behind or before it takes it along.
#[derive(Clone, Debug, Default)]
pub(crate) struct Carriages {
    drive: Axes,
    /// The carriage from where its drive is, mm or deg: half of the play at the most. In the middle, while it is not known how the
    /// axis came to where it is.
    pub(crate) off: Axes,
}

impl Carriages {
    /// The drives stand here, and it is not known how they came.
    pub(crate) fn at(drive: &Axes) -> Self {
        Self {
            drive: *drive,
            off: [0.0; 9],
        }
    }

    /// Rotary axes are where they were, which has another number now, deg.
    pub(crate) fn wraps(&mut self, by: &Axes) {
        for (drive, by) in self.drive.iter_mut().zip(by) {
            *drive += by;
        }
    }

    /// The drives go to this place; each axis goes in one direction.
    pub(crate) fn go(&mut self, truth: &Corrector, to: &Axes) {
        let from = std::mem::replace(&mut self.drive, *to);
        let lost = truth.lost(to);
        for axis in 0..9 {
            let half = 0.5 * lost[axis];
            self.off[axis] = (from[axis] + self.off[axis] - to[axis]).clamp(-half, half);
        }
    }
}

/// The places of a motion from one share of it to another that show every turning point, the last one at the end.
pub(crate) fn places<'a>(
    truth: &Corrector,
    made: &'a Made,
    [from, to]: [f64; 2],
) -> impl Iterator<Item = Axes> + use<'a> {
    let steps = if truth.is_bidirectional() {
        steps(truth, made, to - from)
    } else {
        1
    };
    (1..=steps).map(move |step| {
        let share = from + (to - from) * f64::from(step) / f64::from(steps);
        place_of(made, if step == steps { to } else { share })
    })
}

/// In how many steps a motion is followed so that no turning point of an axis is missed.
pub(crate) fn steps(truth: &Corrector, made: &Made, share: f64) -> u32 {
    let Made { motion, frame, .. } = made;
    let from = frame.to_program(&motion.from);
    let mut steps = 1.0_f64;
    if let Path::Arc(arc) = motion.path {
        let (radius, _) = arc.start(&from);
        // The sagitta of the whole of it, as if it were a parabola.
        let turns = arc.turns_by.abs() * share;
        steps = steps_of(0.125 * radius * turns * turns);
    }
    if frame.tip.is_some() {
        let turned: f64 = (3..6)
            .filter(|axis| is_rotary(*axis))
            .map(|axis| (motion.to[axis] - motion.from[axis]).abs().to_radians())
            .sum();
        let to = frame.to_program(&motion.to);
        let way: f64 = (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum();
        let bulge = truth.bulge_mm(share * turned, share * way.sqrt());
        steps = steps.max(steps_of(bulge));
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "1 to 1024"
    )]
    let whole = steps.ceil() as u32;
    whole
}
