//! A program that is gone through move by move: each one begins when it is told to.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use volcomp_focas::simulator::Motion;
use volcomp_port::simulated::{Move, Path};
use volcomp_vocabulary::AxisName;

use crate::{
    program::{Program, Stop},
    quantities::outside,
};

/// The way through a program. Its times are those for which the machine moved, without emergency stops.
pub(crate) struct Walk {
    /// What the places are where the moves end.
    pub(crate) stops: Vec<Stop>,
    /// How long the machine stands at each of them at least.
    pub(crate) dwells: Vec<Duration>,
    /// The moves without the times at which they stand.
    path: Path,
    leg: Mutex<Leg>,
}

/// From the end of one move to that of the next.
#[derive(Clone, Copy)]
struct Leg {
    /// When it was left.
    left: Duration,
    /// The times of the path there and at the next one.
    from: Duration,
    to: Duration,
}

impl Walk {
    /// A machine that stands where the first move ends.
    pub(crate) fn new(program: Program, acceleration: f64) -> Self {
        let dwells = program.moves.iter().map(|step| step.dwell).collect();
        let passing = |step: Move| Move {
            dwell: Duration::ZERO,
            ..step
        };
        let moves: Vec<Move> = program.moves.into_iter().map(passing).collect();
        let path = Path::new(&moves, acceleration);
        let first = path.arrival(0).unwrap_or_default();
        Self {
            stops: program.stops,
            dwells,
            path,
            leg: Mutex::new(Leg {
                left: Duration::ZERO,
                from: first,
                to: first,
            }),
        }
    }

    /// The motion that a control goes along.
    pub(crate) fn motion(self: &Arc<Self>, axes: &[AxisName]) -> Motion {
        let (walk, axes) = (Arc::clone(self), axes.to_vec());
        Arc::new(move |moved_for| outside(&axes, &walk.path.at(walk.leg().reached(moved_for))))
    }

    /// Leaves for the end of this move, counted from 0, of a machine that has moved for this time.
    pub(crate) fn go_to(&self, index: usize, moved_for: Duration) {
        let mut leg = self.leg();
        let at = leg.reached(moved_for);
        let to = self.path.arrival(index).unwrap_or(at);
        *leg = Leg {
            left: moved_for,
            // From the last one the path begins anew.
            from: if at <= to { at } else { Duration::ZERO },
            to,
        };
    }

    /// Whether the machine is where it was sent.
    pub(crate) fn has_arrived(&self, moved_for: Duration) -> bool {
        let leg = self.leg();
        leg.reached(moved_for) == leg.to
    }

    fn leg(&self) -> MutexGuard<'_, Leg> {
        self.leg.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Leg {
    /// The time of the path that is reached.
    fn reached(&self, moved_for: Duration) -> Duration {
        let gone = moved_for.saturating_sub(self.left);
        self.from.saturating_add(gone).min(self.to)
    }
}
