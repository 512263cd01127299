//! The guard of a machine: inputs of a cycle in, the correction to send out.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use crate::{
    Confirmed, Inputs, Known, Limits, LimitsError, Output, Reading, Reasons, Request, Scheme,
    Vector, Wanted,
    allowed::Allowed,
    ceiling,
    corridor::Corridor,
    proof::{Moves, Proof, Verdict},
    read_back::are_equal,
    state::{Cause, Facts, Hold, Phase, State},
    step::{ROUNDING, ROUNDING_STEPS, is_same_step, one_step},
};

/// The maximum length of a cycle, in periods: longer ones count as this.
const LONGEST_CYCLE_PERIODS: u32 = 5;

/// The number of confirmed corrections of an axis in a row that were not sent, without one between that was, which is a fault.
const MOST_ADOPTED: u32 = 3;

/// The reasons for which what is applied is left alone, until it was written here.
const FOREIGN: [Reasons; 3] = [
    Reasons::WATCHING,
    Reasons::OTHER_GATEWAY,
    Reasons::LEFT_UNKNOWN,
];

/// Shares of a cycle's motion that are tried until the output is as near to what is confirmed as it must be.
const SHARES: [f64; 5] = [1.0, 0.5, 0.2, 0.1, 0.0];

/// The guard of a machine: it decides which correction may reach the axes (rules of the crate's front page). One path
/// writes at a time.
///
/// Invariants between two cycles:
/// - `vector` is what was decided last, and `before` what it was one motion earlier: [`not_sent`](Guard::not_sent) goes back
///   there, so an output that was not sent never counts as moved.
/// - Whatever may be sent next lies within `corridor`, which only time widens, at the slew, and each word that is sent narrows.
/// - `allowed` is at least the limit of each axis. It is above it only by what was sent here, was known before, or was accepted
///   by a person.
/// - While `took_over`, nothing was confirmed on the path that writes: `confirmed` is another path's, and nothing is compared
///   with it.
/// - `held` is there only while an interlock lasts, and so is `stopped_since`.
/// - `proof` counts only while the state is `Arming(Proving)`; `verdict` is that of the last one, and of this path.
/// - `good` is never later than the last cycle: no reading is from the future.
#[derive(Clone, Debug)]
pub struct Guard {
    limits: Limits,
    state: State,
    vector: Vector,
    /// The vector before the last motion, to come back to when its write fails.
    before: Vector,
    /// The correction where the last ramp or line began.
    from: PerChannel<f64>,
    /// Where the next output may be for the rate to hold in every window of time.
    corridor: Corridor,
    /// What was confirmed last.
    confirmed: PerChannel<f64>,
    /// What was sent, and what is expected where it is found.
    allowed: Allowed,
    /// When something was sent last, to a barrier.
    sent_to_barrier: Option<Duration>,
    /// The output stood at what is confirmed: a ramp or a line begins anew when it moves again.
    stood: bool,
    /// Where the control holds on its own while an interlock lasts: what is sent on to its barrier goes there.
    held: Option<PerChannel<f64>>,
    /// Since when an interlock lasts.
    stopped_since: Option<Duration>,
    /// Another path writes from now on: what it is known to apply is where it begins.
    took_over: bool,
    /// It writes to the same axes in the same steps as the path before: what that one sent is on its way to the same barrier,
    /// if there is one, and a reading that held until then does not show yet where it leads.
    shared_until: Option<Duration>,
    proof: Proof,
    moves: Moves,
    /// What the last proof showed.
    verdict: Verdict,
    last_cycle: Option<Duration>,
    /// When positions and correction were good last.
    good: Option<Duration>,
    /// When the control may act on its own.
    until: Option<Duration>,
    adopted: PerChannel<u32>,
    held_back: u64,
}

impl Guard {
    /// A guard that is disarmed, its output zero.
    ///
    /// # Errors
    /// Limits that make no sense, or lie beyond a [`ceiling`](crate::ceiling).
    pub fn new(limits: Limits) -> Result<Self, LimitsError> {
        limits.check()?;
        Ok(Self {
            limits,
            state: State::Disarmed,
            vector: Vector::default(),
            before: Vector::default(),
            from: PerChannel::ZERO,
            corridor: Corridor::about(&PerChannel::ZERO, &limits),
            confirmed: PerChannel::ZERO,
            allowed: Allowed::within(&limits),
            sent_to_barrier: None,
            stood: true,
            held: None,
            stopped_since: None,
            took_over: true,
            shared_until: None,
            proof: Proof::default(),
            moves: Moves::default(),
            verdict: Verdict::default(),
            last_cycle: None,
            good: None,
            until: None,
            adopted: PerChannel::default(),
            held_back: 0,
        })
    }

    /// Other limits from the next cycle on: what lies beyond them comes in at the old or the new rate, whichever is lower, and
    /// by a ramp where [`Request::Switched`] follows.
    ///
    /// # Errors
    /// Those of [`Limits::check_in_place_of`]: the old ones stay.
    pub fn set_limits(&mut self, limits: Limits) -> Result<(), LimitsError> {
        limits.check_in_place_of(&self.limits)?;
        let stands = self.stands().unwrap_or_default();
        self.allowed.narrow(&stands, &limits);
        self.limits = limits;
        Ok(())
    }

    /// Another path writes from the next cycle on, with these limits in its order of axes: the output begins with what is
    /// known to be applied on it, or with what is on its way to a barrier to which both lead. `places` says which place each of
    /// its axes had on the path before; `None`: that path did not write it. What lies beyond the new limits, and was sent by
    /// the path before or known there, comes in by a ramp.
    ///
    /// # Errors
    /// Limits that make no sense: the path before goes on.
    pub fn take_path(
        &mut self,
        limits: Limits,
        places: &PerChannel<Option<usize>>,
    ) -> Result<(), LimitsError> {
        limits.check()?;
        let places = &places.map(|place| place.filter(|place| *place < self.limits.count));
        // What the path before has sent, or was known to apply, is expected on this path, too.
        let stands = self.stands().unwrap_or_default();
        let now = self.last_cycle.unwrap_or_default();
        self.allowed
            .take_path(now, places, &stands, &self.limits, &limits);
        // What the path before sent is the output until it is known what is applied on this one.
        let is_same = limits.check_in_place_of(&self.limits).is_ok()
            && limits.places().all(|i| places[i] == Some(i));
        let delay = self.limits.longest_delay().max(limits.longest_delay());
        let until = self.sent_to_barrier.map(|sent| sent.saturating_add(delay));
        self.shared_until = until.filter(|_| is_same);
        let sent = self.output();
        let sent = places.map(|place| place.map_or(0.0, |place| sent[place]));
        self.limits = limits;
        if !is_same {
            self.corridor = self.corridor.on_path(places, &self.limits);
        }
        self.begin_with(&sent);
        self.before = self.vector;
        self.adopted = PerChannel::default();
        self.took_over = true;
        (self.held, self.stopped_since) = (None, None);
        // The positions of the path before are no positions of this one: what is sent now has to wait for those.
        let stale = self.limits.hold + self.limits.period;
        let stale = self.last_cycle.unwrap_or_default().saturating_sub(stale);
        self.good = self.good.map(|good| good.min(stale));
        // What was shown, was shown of the positions of the other path, and it was those that moved.
        self.verdict = Verdict::default();
        self.proof = Proof::default();
        self.moves = Moves::default();
        Ok(())
    }

    /// The output of the last cycle was not sent, or its sending failed: it does not count as moved.
    pub fn not_sent(&mut self) {
        self.vector = self.before;
        self.vector.stop();
    }

    /// For how long from `now` on the output of this cycle may still be sent, since positions and correction grow old, and
    /// a control that receives nothing may act on its own; `None`: not any more. To be called immediately before a write.
    #[must_use]
    pub fn time_to_send(&self, now: Duration) -> Option<Duration> {
        // An output that is on its way out, or stands, depends on no position. But nothing is sent that was decided
        // longer ago than positions may be held.
        let depends = matches!(self.state, State::Arming(_) | State::Compensating);
        let decided = now.saturating_sub(self.last_cycle.unwrap_or(now));
        let age = if depends { self.age(now) } else { decided };
        let young = self.limits.hold.checked_sub(age)?;
        // Where positions may be older than that, a decision may not.
        let young = young.min(ceiling::HOLD.checked_sub(decided)?);
        match self.until {
            Some(until) => until.checked_sub(now).map(|left| left.min(young)),
            None => Some(young),
        }
    }

    /// The limits that hold now.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// The state after the last cycle.
    pub fn state(&self) -> State {
        self.state
    }

    /// The last output, mm and rad.
    pub fn output(&self) -> PerChannel<f64> {
        self.vector.output()
    }

    /// How long it takes to ramp the correction out once nothing new is available.
    #[must_use]
    pub fn time_to_zero(&self) -> Duration {
        self.vector.time_to_zero(&self.limits)
    }

    /// What the test shift of the last arming showed, axis by axis.
    pub fn verdict(&self) -> &Verdict {
        &self.verdict
    }

    /// Decides one cycle: the correction to send, and the state.
    pub fn cycle(&mut self, inputs: &Inputs) -> Output {
        let dt_s = self.elapsed(inputs.now);
        let reading = inputs.reading.filter(|reading| self.is_finite(reading));
        let wanted = inputs.wanted.filter(Wanted::is_finite);
        let is_number = inputs.wanted.is_some() == wanted.is_some()
            && inputs.reading.is_some() == reading.is_some();
        let inputs = Inputs { wanted, ..*inputs };
        self.until = inputs.known.until;
        self.corridor.stay(&inputs.known.between, &self.limits);
        self.corridor.widen(&self.limits, dt_s);
        let took_over = self.took_over;
        let changed = self.adopt(&inputs);
        let facts = Facts {
            took_over,
            ..self.facts(&inputs, reading.as_ref(), changed, is_number)
        };
        let before = self.state;
        self.state = before.next(&facts);
        if self.state != before && self.state == State::Arming(Phase::Proving) {
            self.verdict = Verdict::default();
        }
        if self.state.is_armed() && !before.is_armed() {
            // What did not stick before does not count: it begins with what is confirmed now.
            self.adopted = PerChannel::default();
        }
        self.allow(&inputs, before);
        let resumes = self.stood && !facts.interlocked;
        // What has been ramped to is followed without another ramp.
        let arrived = (before, self.state) == (State::Arming(Phase::Ramping), State::Compensating);
        let enters = self.state != before && !arrived;
        if enters || changed || resumes || facts.begins_anew() {
            self.begin();
            self.stood = false;
        }
        let mut reasons = self.reasons(&inputs, &facts) | Reasons::NOT_A_NUMBER.when(!is_number);
        self.hold(&inputs, &facts);
        self.before = self.vector;
        let write = if self.sends(&inputs) {
            self.advance(&inputs, dt_s, &mut reasons)
        } else {
            self.vector.stop();
            false
        };
        Output {
            correction: self.output(),
            write,
            state: self.state,
            reasons,
            held_back: self.held_back,
        }
    }

    fn all(&self, holds: impl FnMut(usize) -> bool) -> bool {
        self.limits.places().all(holds)
    }

    /// A position that is no number makes a reading worthless.
    fn is_finite(&self, reading: &Reading) -> bool {
        self.all(|i| reading.positions[i].is_finite())
    }

    /// Time since the last cycle, s, at most five periods of it.
    fn elapsed(&mut self, now: Duration) -> f64 {
        let period = self.limits.period;
        let passed = self
            .last_cycle
            .map_or(period, |last| now.saturating_sub(last));
        self.last_cycle = Some(now);
        passed.min(period * LONGEST_CYCLE_PERIODS).as_secs_f64()
    }

    /// How old positions and correction are.
    fn age(&self, now: Duration) -> Duration {
        self.good
            .map_or(Duration::MAX, |good| now.saturating_sub(good))
    }

    /// In an interlock the last word is sent on to a barrier, so that it does not time out: the axis is there already, or
    /// what is on its way brings it there. What is confirmed lags that word, and led back to it an axis would go to and fro.
    /// Only where the control took the word and stays elsewhere for long, since it holds on its own, the word goes there, so
    /// that nothing moves when the control is free again. A control that stood before the stop may have been free since: it
    /// holds where it is still seen to stand after it would have been seen to move.
    fn hold(&mut self, inputs: &Inputs, facts: &Facts) {
        let known = &inputs.known;
        if !facts.interlocked {
            (self.held, self.stopped_since) = (None, None);
            return;
        }
        let stopped_since = *self.stopped_since.get_or_insert(inputs.now);
        let Some(Confirmed { values, at }) = known.confirmed.filter(|_| !known.changed) else {
            self.held = None;
            return;
        };
        let is_seen = at.saturating_sub(stopped_since) > known.shown_after;
        if is_seen && self.stands_elsewhere(inputs) {
            self.held = Some(values);
        }
        // One that moves is held no more.
        let stands = |held: &PerChannel<f64>| are_equal(held, &values, &self.limits);
        self.held = self.held.filter(stands);
    }

    /// Takes what is confirmed as the output where that is not what was sent, and returns whether this is an event.
    fn adopt(&mut self, inputs: &Inputs) -> bool {
        let known = &inputs.known;
        let Some(Confirmed { values, at }) = known.confirmed else {
            return false;
        };
        if !self.all(|i| values[i].is_finite()) {
            return false;
        }
        self.confirmed = values;
        let interlocked = !inputs.interlocks.is_empty();
        self.stood |= interlocked;
        let took_over = core::mem::take(&mut self.took_over);
        // While nothing is sent the output is what is applied.
        let idle = self.is_idle(inputs);
        if took_over && !idle && self.is_on_its_way(known.scheme, &values, at) {
            self.stood = true;
            return false;
        }
        if took_over || idle || interlocked && known.changed {
            self.begin_with(&values);
            return false;
        }
        if !known.changed {
            self.count_landed(known, &values);
            return false;
        }
        let output = self.output();
        // What is confirmed anew and is what was sent goes on as it went.
        let mut is_event = false;
        for i in self.limits.places() {
            if !is_same_step(values[i], output[i], self.limits.axes[i].resolution) {
                self.adopted[i] = self.adopted[i].saturating_add(1);
                is_event = true;
            }
        }
        if is_event {
            self.begin_with(&values);
        }
        is_event
    }

    /// The output begins with these values (mm, rad).
    fn begin_with(&mut self, values: &PerChannel<f64>) {
        self.vector = Vector::at(values);
        self.corridor.begin(values, &self.limits);
        self.stood = true;
    }

    /// Whether the word that the path before has sent is on its way to the barrier to which this one leads, too, that applied
    /// these `values` at the time `at`: it is no further from them than was slewed since.
    fn is_on_its_way(&self, scheme: Scheme, values: &PerChannel<f64>, at: Duration) -> bool {
        let (Some(until), output) = (self.shared_until, self.output()) else {
            return false;
        };
        let slewed_s = until.saturating_sub(at).as_secs_f64();
        let is_near = |i: usize| {
            let slew_per_s = self.allowed.slew_per_s(i);
            let most = slew_per_s * slewed_s + one_step(self.limits.axes[i].resolution);
            (output[i] - values[i]).abs() <= most
        };
        scheme == Scheme::Barrier && at <= until && self.all(is_near)
    }

    /// Nothing is sent in this state; in an interlock only to a barrier.
    fn is_idle(&self, inputs: &Inputs) -> bool {
        match self.state {
            State::Disarmed | State::Faulted(Cause::BeyondLimit) => true,
            _ if inputs.known.scheme == Scheme::Barrier => false,
            State::Holding(Hold::Interlocked) => true,
            _ => !inputs.interlocks.is_empty(),
        }
    }

    /// An axis that went where it was sent, away from where the ramp began, takes what is sent.
    fn count_landed(&mut self, known: &Known, values: &PerChannel<f64>) {
        if known.unlanded_since.is_some() || !known.writable {
            return;
        }
        for i in self.limits.places() {
            if !is_same_step(values[i], self.from[i], self.limits.axes[i].resolution) {
                self.adopted[i] = 0;
            }
        }
    }

    /// Keeps the largest correction that is expected: more than the limit only on the way in, where it was lowered or
    /// a person has looked.
    fn allow(&mut self, inputs: &Inputs, before: State) {
        let Some(stands) = self.stands() else {
            return;
        };
        let leads_out = matches!(self.state, State::RampingOut(_))
            && !matches!(before, State::RampingOut(_))
            && inputs.request == Some(Request::Acknowledge);
        if leads_out {
            self.allowed.accept(&stands, &self.limits);
        } else {
            self.allowed.narrow(&stands, &self.limits);
        }
        if let Some(confirmed) = inputs.known.confirmed {
            self.allowed.pass(inputs.now, confirmed.at, &self.limits);
        }
    }

    /// How far from zero each axis stands, by the output or in the control; `None`: another path writes, and it is not known
    /// yet on this one.
    fn stands(&self) -> Option<PerChannel<f64>> {
        let (output, confirmed) = (self.output(), &self.confirmed);
        let furthest = |i: usize| output[i].abs().max(confirmed[i].abs());
        (!self.took_over).then(|| PerChannel::from_fn(furthest))
    }

    /// A ramp or a line begins where the output stands.
    fn begin(&mut self) {
        self.from = self.vector.smooth();
        self.proof = Proof::default();
        match self.state {
            State::RampingOut(_) | State::Faulted(_) => self.vector.begin_line(&PerChannel::ZERO),
            State::Arming(_) | State::Compensating | State::Disarmed | State::Holding(_) => {
                self.vector.begin_ramp();
            }
        }
    }

    /// Whether anything is sent: where it is, the output moves, or is sent on.
    fn sends(&self, inputs: &Inputs) -> bool {
        !self.is_idle(inputs) && inputs.known.writable
    }

    fn facts(
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
    fn stands_elsewhere(&self, inputs: &Inputs) -> bool {
        let since = inputs.known.stands_since;
        let hold = self.hold_unconfirmed(&inputs.known);
        since.is_some_and(|since| inputs.now.saturating_sub(since) > hold)
    }

    /// For how long what was confirmed last counts: on a path that may hold positions for longer than others, not beyond the
    /// time-out of its barrier.
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

    fn reasons(&self, inputs: &Inputs, facts: &Facts) -> Reasons {
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

    /// Moves the output for `dt_s`, as far as it stays near to everything that may be applied. Whether it is to be sent.
    fn advance(&mut self, inputs: &Inputs, dt_s: f64, reasons: &mut Reasons) -> bool {
        let Some(Confirmed { values, .. }) = inputs.known.confirmed else {
            return false;
        };
        let is_barrier = inputs.known.scheme == Scheme::Barrier;
        let reach = self.reach(inputs.known.scheme);
        let [lowest, highest] = inputs.known.between;
        let sent = self.before.output();
        for share in SHARES {
            self.vector = self.before;
            let moved = self.move_by(inputs, dt_s * share);
            let output = self.output();
            let is_near = |i: usize| {
                // What is a whole number of steps but for a rounding goes to the next one.
                let rounding = ROUNDING_STEPS * self.limits.axes[i].resolution;
                let reach = reach[i] * ROUNDING + rounding;
                let (mut least, mut largest) = (highest[i] - reach, lowest[i] + reach);
                // What comes in from beyond a limit begins where it may stand.
                let mut stood = lowest[i].abs().max(highest[i].abs());
                if is_barrier {
                    // The word that was sent last is on its way, and may be sent again, however far it is from what is confirmed.
                    (least, largest) = (least.min(sent[i]), largest.max(sent[i]));
                    stood = stood.max(sent[i].abs());
                }
                let most = stood.max(self.limits.axes[i].reachable());
                (least..=largest).contains(&output[i])
                    && output[i].abs() <= most * ROUNDING
                    && self.corridor.contains(i, output[i], &self.limits)
            };
            if self.all(is_near) {
                // What is not confirmed yet holds the output back as its own slew does.
                let moved = moved | Reasons::SLEWING.when(share < 1.0);
                self.held_back += u64::from(moved.contains(Reasons::SLEWING));
                *reasons |= moved;
                self.corridor.narrow(&output, &self.limits);
                self.allowed.send(&output, &self.limits);
                self.sent_to_barrier = is_barrier.then_some(inputs.now);
                return true;
            }
        }
        if is_barrier {
            // A frame whose sending failed may still have landed: from there to the word before it the rate allows
            // nothing yet.
            self.vector = self.before;
            self.vector.stop();
        } else {
            // What was sent last is too far from what is confirmed to be sent again: it goes on from there.
            self.vector = Vector::at(&values);
            self.stood = true;
        }
        self.held_back += 1;
        *reasons |= Reasons::SLEWING;
        false
    }

    /// How far the output of each axis may be from what may be applied, mm and rad: what the guard slews in the delay of a
    /// path with a barrier, or slewed while what is on its way was sent, else one slew or one step, whichever is larger.
    fn reach(&self, scheme: Scheme) -> PerChannel<f64> {
        let period_s = self.limits.period.as_secs_f64();
        let delay_s = self.limits.delay().as_secs_f64();
        PerChannel::from_fn(|i| {
            let axis = &self.limits.axes[i];
            match scheme {
                Scheme::Barrier => {
                    let slew_per_s = axis.slew_per_s.max(self.allowed.slew_per_s(i));
                    slew_per_s * (delay_s + period_s) + axis.resolution
                }
                Scheme::Plain | Scheme::NoReadBack => {
                    (axis.slew_per_s * period_s).max(axis.resolution)
                }
            }
        })
    }

    /// Moves the vector as the state requires. Returns the reasons to report.
    fn move_by(&mut self, inputs: &Inputs, dt_s: f64) -> Reasons {
        let limits = self.limits;
        if !inputs.interlocks.is_empty() {
            match self.held {
                Some(held) => self.move_to_held(&held, dt_s),
                None => self.vector.stop(),
            }
            return Reasons::NONE;
        }
        match self.state {
            State::Arming(Phase::Proving) => {
                self.move_to(&self.proof.goal(&self.from, &limits), &limits, dt_s);
                Reasons::NONE
            }
            State::Arming(Phase::Ramping) | State::Compensating => {
                let Some(wanted) = &inputs.wanted else {
                    return Reasons::NONE;
                };
                let followed = self.vector.follow(wanted, &limits, dt_s);
                Reasons::SLEWING.when(followed.slewing)
                    | Reasons::LIMITED.when(followed.limited)
                    | Reasons::WARN.when(followed.warned)
            }
            State::RampingOut(_) | State::Faulted(_) => {
                let mut limits = limits;
                if inputs.let_go {
                    limits.ramp = Duration::ZERO;
                }
                self.vector.advance_line(&limits, dt_s);
                Reasons::NONE
            }
            State::Disarmed | State::Holding(_) => {
                self.vector.stop();
                Reasons::NONE
            }
        }
    }

    /// Moves the vector to where the control holds on its own, also beyond a limit that was lowered meanwhile: it is led in after
    /// the stop, in which nothing moves.
    fn move_to_held(&mut self, held: &PerChannel<f64>, dt_s: f64) {
        let (stands, mut limits) = (self.vector.smooth(), self.limits);
        for (i, axis) in limits.axes.iter_mut().enumerate() {
            axis.limit = axis.limit.max(held[i].abs()).max(stands[i].abs());
        }
        limits.ramp = Duration::ZERO;
        self.move_on_line(held, &limits, dt_s);
    }

    /// Moves the vector on a line to a goal that is some steps away: it takes the fewest cycles, not those of the ramp of a
    /// correction. What a lowered limit left outside comes in by a ramp.
    fn move_to(&mut self, goal: &PerChannel<f64>, limits: &Limits, dt_s: f64) {
        let (smooth, mut limits) = (self.vector.smooth(), *limits);
        let is_within = |i: usize| smooth[i].abs() <= limits.axes[i].reachable() * ROUNDING;
        if self.all(is_within) {
            limits.ramp = Duration::ZERO;
        }
        self.move_on_line(goal, &limits, dt_s);
    }

    fn move_on_line(&mut self, goal: &PerChannel<f64>, limits: &Limits, dt_s: f64) {
        // Also anew where a write was not sent, and the vector is as it was before.
        if !self.vector.leads_to(goal) {
            self.vector.begin_line(goal);
        }
        self.vector.advance_line(limits, dt_s);
    }
}
