//! What a cycle finds: the facts on which the state depends, the proof, and the reasons that are told.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use super::Guard;
use crate::{
    Inputs, Known, Reading, Reasons, Scheme, ceiling,
    read_back::are_equal,
    state::{Facts, Phase, State},
};

/// So many confirmed corrections of an axis in a row that were not sent, without one between that was, make a fault.
const MOST_ADOPTED: u32 = 3;

/// The reasons for which what is applied is left alone, until it was written here.
const FOREIGN: [Reasons; 3] = [
    Reasons::WATCHING,
    Reasons::OTHER_GATEWAY,
    Reasons::LEFT_UNKNOWN,
];

impl Guard {
    pub(super) fn facts(
        &mut self,
        inputs: &Inputs,
        reading: Option<&Reading>,
        changed: bool,
        is_number: bool,
    ) -> Facts {
        let (now, known, limits) = (inputs.now, &inputs.known, &self.limits);
        if let (Some(reading), Some(_)) = (reading, &inputs.wanted) {
            // No reading is from the future, whatever a device says.
            self.good = self.good.max(Some(reading.taken.min(now)));
        }
        let age = self.age(now);
        let since = |since: Option<Duration>| since.map(|since| now.saturating_sub(since));
        let confirmed = since(known.confirmed.map(|confirmed| confirmed.at));
        let unlanded = since(known.unlanded_since).unwrap_or_default();
        let interlocked = !inputs.interlocks.is_empty();
        let hold = self.hold_unconfirmed(known);
        let unconfirmed = confirmed.is_none_or(|age| age > hold)
            || unlanded > hold
            || !interlocked && self.stands_elsewhere(inputs);
        let does_not_land = unlanded > limits.zero_after && inputs.reading.is_some();
        let values = known.confirmed.map(|confirmed| confirmed.values);
        let is_zero = |values: &PerChannel<f64>| are_equal(values, &PerChannel::ZERO, &self.limits);
        let beyond = |values: &PerChannel<f64>| self.allowed.is_exceeded_by(values, limits);
        Facts {
            request: inputs.request,
            interlocked,
            stale: age > self.limits.hold,
            lost: age > self.limits.zero_after || inputs.let_go && age > self.limits.hold,
            unconfirmed,
            does_not_land,
            beyond: values.as_ref().is_some_and(beyond),
            other_gateway: known.scheme == Scheme::Barrier
                && known.reasons.contains(Reasons::OTHER_GATEWAY),
            changed,
            took_over: false,
            forbidden: !is_number
                || reading.is_none()
                || !(inputs.forbids | known.reasons.without(Reasons::DOES_NOT_FORBID)).is_empty(),
            foreign: FOREIGN
                .into_iter()
                .any(|reason| known.reasons.contains(reason)),
            ramped: self.vector.is_ramped(),
            zero: values.as_ref().is_some_and(is_zero) && is_zero(&self.output()),
            proves: self
                .limits
                .places()
                .any(|i| self.limits.test_shift[i] > 0.0),
            proven: self.prove(
                inputs,
                reading,
                changed || age > self.limits.hold || unconfirmed,
            ),
            does_not_stick: self.adopted.iter().any(|times| *times >= MOST_ADOPTED),
        }
    }

    /// The control takes what is sent, and stands elsewhere for longer than `hold`.
    pub(super) fn stands_elsewhere(&self, inputs: &Inputs) -> bool {
        let since = inputs.known.stands_since;
        let hold = self.hold_unconfirmed(&inputs.known);
        since.is_some_and(|since| inputs.now.saturating_sub(since) > hold)
    }

    /// For how long what was confirmed last counts: on a path that may hold positions for longer than others, not beyond the
    /// time after which its barrier lets go.
    fn hold_unconfirmed(&self, known: &Known) -> Duration {
        let most = known.lets_go_after.map(|after| after.max(ceiling::HOLD));
        most.map_or(self.limits.hold, |most| most.min(self.limits.hold))
    }

    /// Goes on with the proof at arming; its result once there is one.
    fn prove(
        &mut self,
        inputs: &Inputs,
        reading: Option<&Reading>,
        disturbed: bool,
    ) -> Option<bool> {
        let (now, reading) = (inputs.now, reading?);
        let applied = inputs.known.confirmed?.values;
        self.moves
            .see(now, &reading.positions, &applied, &self.limits);
        if self.state != State::Arming(Phase::Proving) || disturbed {
            return None;
        }
        if let Some(wanted) = &inputs.wanted {
            self.proof.follows(&wanted.follow);
        }
        let (from, limits) = (&self.from, &self.limits);
        self.verdict = self
            .proof
            .read(now, reading, &applied, from, limits, &self.moves)?;
        Some(!self.verdict.is_contradiction())
    }

    pub(super) fn reasons(&self, inputs: &Inputs, facts: &Facts) -> Reasons {
        let mut reasons = self.state.reason() | inputs.interlocks | inputs.known.reasons;
        reasons |= Reasons::NO_CONTROLLER.when(inputs.reading.is_none());
        reasons |= Reasons::POSITIONS_STALE.when(facts.stale);
        reasons |= Reasons::READ_BACK.when(facts.changed);
        reasons |= Reasons::UNCONFIRMED.when(facts.unconfirmed);
        reasons |= Reasons::CORRECTION_LEFT
            .when(self.state == State::Disarmed && inputs.known.holds(&self.limits));
        reasons |= Reasons::BEYOND_LIMIT.when(facts.beyond);
        reasons |=
            Reasons::WAITING_FOR_STANDSTILL.when(self.state == State::Arming(Phase::Proving));
        let shown = |i: usize| self.verdict.proven[i] || self.limits.test_shift[i] == 0.0;
        let after = !matches!(self.state, State::Disarmed | State::Arming(Phase::Proving));
        reasons | Reasons::NOT_PROVEN.when(!facts.proves || after && !self.all(shown))
    }
}
