//! Where the machine stands, from what the controllers show.

use std::time::Duration;

use volcomp_vocabulary::{MAX_AXES, PerAxis};

use crate::{path::ControlPath, reader::PositionReader};

/// Positions of the machine as one path may use them.
#[derive(Default)]
pub(crate) struct Place {
    /// Positions without correction, mm and rad.
    pub(crate) positions: PerAxis<f64>,
    /// When each position held; zero where it is stated as fixed.
    pub(crate) taken: PerAxis<Duration>,
    /// Which positions are known, as bits: bit 0 is the first axis.
    pub(crate) known: u16,
    /// When the oldest position that was shown held; `None`: none was shown.
    pub(crate) oldest: Option<Duration>,
    /// When the oldest of those held that the path does not show itself; `None`: it shows all that are known.
    pub(crate) oldest_of_others: Option<Duration>,
}

impl Place {
    /// The positions of so many machine axes as the path at `index` may use them: its own, else those of a controller that
    /// is only read, else those of another path that are fresh, else what is stated as fixed.
    pub(crate) fn seen_by(
        paths: &[ControlPath],
        readers: &[PositionReader],
        index: usize,
        axes: usize,
        now: Duration,
    ) -> Self {
        let path = &paths[index];
        let mut place = Self::default();
        let positions = place.positions.iter_mut().zip(path.fixed).enumerate();
        for (axis, (position, fixed)) in positions.take(axes) {
            let fresh = || paths.iter().filter(|other| other.is_fresh(now));
            let others = || fresh().find_map(|other| other.seen.position_of(axis));
            let read = || {
                readers
                    .iter()
                    .find_map(|reader| reader.seen.position_of(axis))
            };
            let own = path.seen.position_of(axis);
            if let Some((seen, taken)) = own.or_else(read).or_else(others) {
                *position = seen;
                place.taken[axis] = taken;
                let older = |than: Option<Duration>| Some(than.map_or(taken, |it| it.min(taken)));
                place.oldest = older(place.oldest);
                if own.is_none() {
                    place.oldest_of_others = older(place.oldest_of_others);
                }
            } else if let Some(fixed) = fixed {
                *position = fixed;
            } else {
                continue;
            }
            place.known |= 1 << axis;
        }
        place
    }

    /// Whether the position of each of so many axes is known.
    pub(crate) fn is_complete(&self, axes: usize) -> bool {
        self.known == u16::MAX >> (16 - axes.min(MAX_AXES))
    }
}
