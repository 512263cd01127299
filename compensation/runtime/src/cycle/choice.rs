//! Which path corrects in a cycle, and what each is asked for.

use std::time::Duration;

use volcomp_guard::{MAX_PATHS, PathHealth, Reasons, Request, State as GuardState};

use super::Cycle;
use crate::{asked::Asked, path::ControlPath, place::Place};

impl Cycle {
    /// Whether a path could correct now.
    fn health(&self, index: usize, now: Duration) -> PathHealth {
        let path = &self.paths[index];
        let place = Place::seen_by(&self.paths, index, self.model.axes.len(), now);
        // A stop or an alarm of the active path is held, not fled from.
        let stays = index == self.selector.active();
        PathHealth {
            usable: place.is_complete(self.model.axes.len())
                && path.is_young(place.oldest, now)
                && (stays || path.is_free()),
            channel: path.channel,
            held_is_known: path.held_is_known(),
        }
    }

    /// Chooses the path that corrects from now on. Gives why another one that should correct may not.
    pub(super) fn select(&mut self, now: Duration) -> Reasons {
        let state = self.paths[self.selector.active()].guard.state();
        // A fault is for a person to look at.
        if self.paths.len() < 2 || matches!(state, GuardState::Faulted(_)) {
            return Reasons::NONE;
        }
        let mut health = [PathHealth::default(); MAX_PATHS];
        for (index, health) in health.iter_mut().enumerate().take(self.paths.len()) {
            *health = self.health(index, now);
        }
        let choice = self.selector.choose(now, &health[..self.paths.len()]);
        self.taking_over |= choice.switched && state.is_armed();
        Reasons::OTHER_CHANNEL_UNKNOWN.when(choice.blocked && state.is_armed())
    }

    /// The request that goes to one path, of what people and programs ask for and of a change of the active path.
    pub(super) fn request_for(
        &mut self,
        index: usize,
        active: usize,
        before: usize,
        asked: &Asked,
    ) -> Option<Request> {
        if asked.request == Some(Request::Disarm) {
            self.taking_over = false;
        }
        if index == active {
            let takes_over = self.taking_over && asked.request.is_none();
            return asked.request.or(takes_over.then_some(Request::TakeOver));
        }
        // The one that was active lets go; the others do as everybody is told, but only one is armed.
        match asked.request {
            Some(Request::Arm | Request::TakeOver | Request::Switched) | None => {
                (index == before && before != active).then_some(Request::Disarm)
            }
            other => other,
        }
    }
}

/// Paths whose controllers name the same channel get the same number.
pub(super) fn number_channels(paths: &mut [ControlPath]) {
    for index in 0..paths.len() {
        let name = &paths[index].controller.description().channel;
        let first = paths
            .iter()
            .position(|path| path.controller.description().channel == *name);
        paths[index].channel = u32::try_from(first.unwrap_or(index)).unwrap_or(u32::MAX);
    }
}
