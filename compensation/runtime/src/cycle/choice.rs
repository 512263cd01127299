//! Which path corrects in a cycle.

use std::time::Duration;

use volcomp_guard::{End, MAX_PATHS, PathHealth, Reasons, Scheme, State as GuardState};

use super::Cycle;
use crate::place::Place;

impl Cycle {
    /// Whether a path could correct now.
    fn health(&self, index: usize, now: Duration) -> PathHealth {
        let path = &self.paths[index];
        let axes = self.model.axes.len();
        let place = Place::seen_by(&self.paths, &self.readers, index, axes, now);
        let complete = place.is_complete(axes);
        // One that stands by is asked less often than positions grow old: its own count as of when it told them. A path
        // that would find positions as old as the active one does is no better.
        let is_young = if index == self.selector.active() {
            path.is_young(place.oldest, now)
        } else {
            let others = place.oldest_of_others;
            let is_fresh = others.is_none() || path.is_young(others, now);
            path.answers(now) && path.told_fresh() && is_fresh
        };
        PathHealth {
            usable: complete && is_young,
            ready: path.device.is_in_hand() && self.is_ready(index, now),
        }
    }

    /// Whether what the axes get is known once this path writes: it tells it itself, of all axes that the path before
    /// wrote, or nothing can be left of that.
    fn is_ready(&self, index: usize, now: Duration) -> bool {
        let (path, active) = (&self.paths[index], self.selector.active());
        if index == active {
            return true;
        }
        let (known, before) = (path.known(), &self.paths[active]);
        if known.scheme != Scheme::NoReadBack {
            let other = known.reasons.contains(Reasons::OTHER_GATEWAY);
            let tells = known.confirmed.is_some() && !other;
            if !tells || !before.leaves_axes_to(path) {
                return tells;
            }
        }
        let Some(sent) = before.sent_at() else {
            // Nothing was sent since the start: what it tells, or what was written down before.
            return match before.known().confirmed {
                Some(_) => !before.report(now).holds,
                None => self.left_nothing,
            };
        };
        let by_itself = before.read_back.zero_by_itself(&before.limits());
        // In a stop a control holds what it applies.
        let since = sent.max(self.stopped);
        by_itself.is_some_and(|wait| now.saturating_sub(since) > wait)
    }

    /// Chooses the path that corrects from now on. Gives why another one that should correct may not, and whether it is
    /// another one than before.
    pub(super) fn select(&mut self, now: Duration) -> (Reasons, bool) {
        let state = self.guard.state();
        if !self.interlocks.reasons().is_empty() {
            self.stopped = now;
        }
        // A fault is for a person to look at; a stop is held, not fled from; and to disarm, a path needs no positions.
        let disarms = matches!(state, GuardState::RampingOut(End::Disarmed));
        let stays = matches!(state, GuardState::Faulted(_))
            || !self.interlocks.reasons().is_empty()
            || disarms && self.paths[self.selector.active()].answers(now);
        if self.paths.len() < 2 || stays {
            self.standby.wanted = None;
            return (Reasons::NONE, false);
        }
        let mut health = [PathHealth::default(); MAX_PATHS];
        for (index, health) in health.iter_mut().enumerate().take(self.paths.len()) {
            *health = self.health(index, now);
        }
        let before = self.selector.active();
        let choice = self.selector.choose(now, &health[..self.paths.len()]);
        let is_left = choice.blocked && !self.is_ready(choice.wanted, now);
        if choice.blocked && !is_left {
            // It takes over once the thread that asks it has given it back.
            self.paths[choice.wanted].device.recall();
        }
        self.standby.wanted = (choice.blocked && !is_left).then_some(choice.wanted);
        if choice.switched {
            // A barrier that is at zero has let go of what came on lines, too.
            let let_go = self.paths[before].known().scheme == Scheme::Barrier;
            self.paths[choice.active].read_back.take_over(now, let_go);
            let sent = self.paths[before].in_machine(&self.guard.output());
            let path = &self.paths[choice.active];
            // The plan has checked them.
            let _ = self.guard.take_path(path.limits());
            self.guard.carry_over(&path.in_channel(&sent));
        }
        let blocked = Reasons::OTHER_CHANNEL_UNKNOWN.when(is_left);
        (blocked, choice.switched)
    }
}
