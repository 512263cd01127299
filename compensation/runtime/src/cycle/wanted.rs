//! What the model asks for in a cycle, and what the guard makes of it.

use std::time::Duration;

use volcomp_guard::{Inputs, Output, PositionFlaw, Reading, Reasons, Wanted};
use volcomp_kinematics::State;
use volcomp_vocabulary::{PerAxis, PerChannel};

use super::{Cycle, lag};
use crate::{asked::Asked, model::ModelWanted, path::ControlPath, place::Place};

impl Cycle {
    /// The correction that the model asks for at a place, mm and rad; `None` while a position is not known. `applied`: the
    /// correction that the axes have, in machine order.
    fn wanted(&mut self, place: &Place, applied: &PerAxis<f64>) -> (Option<ModelWanted>, Reasons) {
        let mut state = State::default();
        for (q, position) in state.q.iter_mut().zip(&place.positions) {
            *q = *position;
        }
        (self.report.positions, self.report.known) = (place.positions, place.known);
        let refused = self.judge(place);
        if !refused.is_empty() {
            self.commanded = None;
            return (None, refused);
        }
        self.approach(&mut state, place);
        self.commanded = place.is_complete(self.model.axes.len()).then_some(state);
        if self.commanded.is_none() {
            let unknown = Reasons::AXIS_UNKNOWN.when(place.oldest.is_some());
            return (None, unknown);
        }
        let path = &self.paths[self.selector.active()];
        let of = |correctors| {
            let model = &self.model;
            model.wanted_by(path.only_thermal, &state, correctors, applied)
        };
        let mut wanted = of(&path.correctors);
        if let Some(followers) = &path.followers {
            // What is left over on rotary axes goes to zero, and the tool tip stays where it is.
            wanted.follow = of(followers).follow;
        }
        let outside = self.model.is_outside_range(&state);
        let notes = Reasons::SINGULAR.when(wanted.singular)
            | Reasons::NEAR_SINGULAR.when(wanted.near_singular && !wanted.singular)
            | Reasons::LINEAR_NEAR_SINGULAR.when(wanted.linear_near_singular)
            | Reasons::OUTSIDE_RANGE.when(outside);
        (Some(wanted), notes)
    }

    /// Why positions cannot be true. While no correction is armed the next one is taken as it stands.
    fn judge(&mut self, place: &Place) -> Reasons {
        (self.report.outside_travel, self.report.jumped) = (0, 0);
        let begins = !self.guard.state().is_armed();
        let axes = self.model.axes.len();
        for (index, check) in self.checks.iter_mut().enumerate().take(axes) {
            if place.known >> index & 1 == 1 {
                let limits = self.model.position_limits(index, &self.rapid);
                let (position, taken) = (place.positions[index], place.taken[index]);
                match check.judge(&limits, position, taken) {
                    Ok(()) => {}
                    Err(PositionFlaw::OutsideTravel) => self.report.outside_travel |= 1 << index,
                    Err(PositionFlaw::Jumped) => self.report.jumped |= 1 << index,
                }
            }
            if begins {
                check.forget();
            }
        }
        Reasons::OUTSIDE_TRAVEL.when(self.report.outside_travel != 0)
            | Reasons::JUMPED.when(self.report.jumped != 0)
    }

    /// What the model asks for, what the guard makes of it.
    pub(super) fn decide(&mut self, now: Duration, asked: &Asked, mut notes: Reasons) -> Output {
        let active = self.selector.active();
        let axes = self.model.axes.len();
        let place = Place::seen_by(&self.paths, &self.readers, active, axes, now);
        let applied = self.paths[active].in_machine(&self.guard.output());
        let (wanted, of_model) = self.wanted(&place, &applied);
        notes |= of_model | Reasons::FALLBACK.when(active != 0);
        notes |= self.standby_notes(now, &applied);
        let kept = wanted.map(|wanted| self.kept(&place, &wanted, &applied, now));
        let path = &self.paths[active];
        let wanted = wanted.map(|wanted| in_channel(path, &wanted));
        self.report.wanted = wanted.map_or(PerAxis::ZERO, |wanted| path.in_machine(&wanted.full()));
        let wanted = wanted.zip(kept).map(|(wanted, kept)| Wanted {
            position: wanted.position.map(|share| kept.part * share),
            rotary: wanted.rotary.map(|share| kept.part * share),
            ..wanted
        });
        notes |= kept.map_or(Reasons::NONE, |kept| kept.notes);
        let reading = path.reading.as_ref().map(|snapshot| Reading {
            taken: place.oldest.or(path.seen.taken).unwrap_or_default(),
            positions: snapshot.positions,
        });
        let lost = |then: Duration| now.saturating_sub(then) > path.limits().zero_after;
        if place.oldest.is_some_and(lost) {
            // What held so long ago is not told as if it were so.
            self.report.known = 0;
            self.report.wanted = PerAxis::ZERO;
            self.commanded = None;
        }
        let mut output = self.guard.cycle(&Inputs {
            now,
            reading,
            known: *path.known(),
            interlocks: self.interlocks.reasons(),
            wanted,
            let_go: kept.is_some_and(|kept| kept.let_go),
            request: asked.request,
            forbids: asked.forbids,
        });
        let unproven =
            |place: usize| path.corrects(place) && path.limits().test_shift[place] == 0.0;
        let unproven = (0..path.count()).any(unproven);
        if !self.guard.state().is_armed() || place.oldest.is_none_or(lost) {
            // There is no correction of which a part could be let go.
            notes = notes.without(Reasons::LET_GO);
        }
        output.reasons |= notes | path.notes | Reasons::NOT_PROVEN.when(unproven);
        output
    }

    /// What the age of the positions leaves of what is wanted.
    fn kept(
        &mut self,
        place: &Place,
        wanted: &ModelWanted,
        applied: &PerAxis<f64>,
        now: Duration,
    ) -> lag::Kept {
        self.lag.see(place, &self.model);
        let path = &self.paths[self.selector.active()];
        let limits = self.guard.limits();
        let asked = lag::Asked {
            model: &self.model,
            correctors: &path.correctors,
            only_thermal: path.only_thermal,
            limits,
            state: &self.commanded.unwrap_or_default(),
            wanted,
            applied,
            way_out: self.guard.time_to_zero(),
        };
        let age = place
            .oldest
            .map_or(Duration::MAX, |taken| now.saturating_sub(taken));
        self.lag.kept(&asked, age, now)
    }

    /// From which direction each axis came, from positions without correction.
    fn approach(&mut self, state: &mut State, place: &Place) {
        let axes = self.model.axes.len();
        for (index, memory) in self.directions.iter_mut().enumerate().take(axes) {
            if place.known >> index & 1 == 0 {
                continue;
            }
            // The coarsest controller that shows it; an axis that stands at a stated position does not turn.
            let paths = self.paths.iter().map(|path| &path.seen);
            let readers = self.readers.iter().map(|reader| &reader.seen);
            let thresholds = paths
                .chain(readers)
                .filter_map(|seen| seen.reversal_of(index));
            let threshold = thresholds.fold(0.0, f64::max);
            let (taken, turn) = (place.taken[index], self.model.turn_of(index));
            state.approach[index] = memory.at(taken, state.q[index], threshold, turn);
        }
    }
}

/// What the model asks for, in the order of a path's axes; zero for axes that do not correct. A rotary axis that does not
/// correct but still holds a share goes to zero, and the linear axes follow it all the same, whether they correct or not.
fn in_channel(path: &ControlPath, wanted: &ModelWanted) -> Wanted {
    let of = |values: &PerAxis<f64>, i: usize| {
        if path.corrects(i) {
            values[path.seen.machine_axis[i]]
        } else {
            0.0
        }
    };
    Wanted {
        position: PerChannel::from_fn(|i| of(&wanted.position, i)),
        rotary: PerChannel::from_fn(|i| of(&wanted.rotary, i)),
        follow: PerChannel::from_fn(|rotary| {
            if rotary >= path.count() {
                return PerChannel::ZERO;
            }
            let row = &wanted.follow[path.seen.machine_axis[rotary]];
            PerChannel::from_fn(|i| {
                if i < path.count() {
                    row[path.seen.machine_axis[i]]
                } else {
                    0.0
                }
            })
        }),
    }
}
