//! A motion that a program makes, and the places on its way.

use crate::{
    coordinates::{Axes, Frame, is_rotary},
    correction::Corrector,
    motion::{Move, Path, at_height},
    turns::steps_of,
    words::between,
};

/// A motion that a program makes.
#[derive(Clone, Debug)]
pub(crate) struct Made {
    /// The number of its line.
    pub(crate) line: usize,
    pub(crate) motion: Move,
    /// What its coordinates mean.
    pub(crate) frame: Frame,
    /// What the control adds for the tool.
    pub(crate) tool: Axes,
    /// Which of the work offsets holds.
    pub(crate) system: usize,
    /// It cuts, alone or by a cycle at its end, and the set-up file defines its zero.
    pub(crate) cuts_from_stated_zero: bool,
    /// It is known where X, Y and Z stand, as far as the machine has them.
    pub(crate) known: bool,
    /// Its words are inches.
    pub(crate) in_inches: bool,
}

/// The axes at a share of a motion; of a hole, on its way down from its plane R.
pub(crate) fn place_of(made: &Made, share: f64) -> Axes {
    let Made { motion, frame, .. } = made;
    let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
    match motion.path {
        Path::Arc(arc) => frame.to_machine(&arc.place(&from, &to, share)),
        Path::Hole {
            bottom,
            clearance,
            depth,
        } => {
            let height = clearance + share * (bottom - clearance);
            frame.to_machine(&at_height(&to, depth, height))
        }
        _ if share == 1.0 => motion.to,
        _ => frame.to_machine(&between(&from, &to, share)),
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
