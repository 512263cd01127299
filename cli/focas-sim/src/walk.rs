//! A program that is run move by move, each move on request.

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

/// Progress through a program. Times are motion times, without emergency stops.
pub(crate) struct Walk {
    pub(crate) stops: Vec<Stop>,
    /// Minimum time at rest at the end of each move.
    pub(crate) dwells: Vec<Duration>,
    /// The moves without their dwell times.
    path: Path,
    leg: Mutex<Leg>,
}

/// A section of the path from the end of one move to the end of the next.
#[derive(Clone, Copy)]
struct Leg {
    left: Duration,
    /// Path times at the two ends of the section.
    from: Duration,
    to: Duration,
}

impl Walk {
    /// Creates a machine at rest at the end of the first move.
    pub(crate) fn new(program: Program, acceleration: f64) -> Self {
        let dwells = program.moves.iter().map(|step| step.dwell).collect();
        let passing = |step: Move| Move { dwell: Duration::ZERO, ..step };
        let moves: Vec<Move> = program.moves.into_iter().map(passing).collect();
        let path = Path::new(&moves, acceleration);
        let first = path.arrival(0).unwrap_or_default();
        Self {
            stops: program.stops,
            dwells,
            path,
            leg: Mutex::new(Leg { left: Duration::ZERO, from: first, to: first }),
        }
    }

    pub(crate) fn motion(self: &Arc<Self>, axes: &[AxisName]) -> Motion {
        let (walk, axes) = (Arc::clone(self), axes.to_vec());
        Arc::new(move |moved_for| outside(&axes, &walk.path.at(walk.leg().reached(moved_for))))
    }

    /// Starts the move `index`, counted from 0; `moved_for` is the present motion time.
    pub(crate) fn go_to(&self, index: usize, moved_for: Duration) {
        let mut leg = self.leg();
        let at = leg.reached(moved_for);
        let to = self.path.arrival(index).unwrap_or(at);
        *leg = Leg {
            left: moved_for,
            // After the last move the path starts again.
            from: if at <= to { at } else { Duration::ZERO },
            to,
        };
    }

    pub(crate) fn has_arrived(&self, moved_for: Duration) -> bool {
        let leg = self.leg();
        leg.reached(moved_for) == leg.to
    }

    fn leg(&self) -> MutexGuard<'_, Leg> {
        self.leg.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Leg {
    fn reached(&self, moved_for: Duration) -> Duration {
        let gone = moved_for.saturating_sub(self.left);
        self.from.saturating_add(gone).min(self.to)
    }
}
