//! The guard, its record of the corrections that may still arrive, and the admissible range of the next word.
//!
//! A read-back beyond the limit of an axis is accepted if this guard sent or confirmed it before the limit was lowered
//! or the path changed (`AcceptedRange`). The next word differs from each earlier word by at most the slew plus one
//! step over every time window, even if the correction was restarted in between (`Corridor`).

use core::time::Duration;

use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::{
    Confirmed, Inputs, Limits, LimitsError, Output, ReadBackStatus, Reading, Reasons,
    RequestedCorrection, Scheme, Vector, ceiling,
    proof::{MotionHistory, Proof, Verdict},
    read_back::are_equal,
    state::{Cause, Facts, Hold, Phase, Request, State},
    step::{ROUNDING, ROUNDING_STEPS, is_same_step, one_step},
};

/// Maximum duration of a cycle, in periods; longer cycles are clamped to this.
const LONGEST_CYCLE_PERIODS: u32 = 5;

/// Number of consecutive confirmed corrections of an axis that differ from the sent corrections, at which the guard
/// faults.
const MOST_ADOPTED: u32 = 3;

/// Reasons that forbid any change of the applied correction before the first write of this guard.
const FOREIGN: [Reasons; 3] = [Reasons::WATCHING, Reasons::OTHER_GATEWAY, Reasons::LEFT_UNKNOWN];

/// Fractions of a cycle's motion, tried in order until the output is within [`reach`](Guard::reach) of the corrections that may be applied.
const SHARES: [f64; 5] = [1.0, 0.5, 0.2, 0.1, 0.0];

/// The guard of a machine: it decides which correction may reach the axes (rules: see the front page of the crate). One path writes at a time.
///
/// Invariants between two cycles:
/// - `vector` is the last decision, and `before` the vector before the last motion.
///   [`not_sent`](Guard::not_sent) returns to `before`, so an output that was not sent is never
///   treated as moved.
/// - Every word that may be sent next is within `corridor`. Only time widens the corridor, by the
///   slew; each sent word narrows it.
/// - `accepted` is at least the limit of each axis. It exceeds the limit only by corrections that were sent by this
///   guard, known before, or accepted by the operator.
/// - While `path_changed` is set, no correction was confirmed on the active path. `confirmed` then belongs to another
///   path and is not compared with the output.
/// - `held` and `stopped_since` are set only during an interlock.
/// - `proof` is valid only in the state `Arming(Proving)`; `verdict` is the result of the last proof on this path.
/// - `inputs_valid_at` is never later than the last cycle: no reading is from the future.
#[derive(Clone, Debug)]
pub struct Guard {
    limits: Limits,
    state: State,
    vector: Vector,
    /// The vector before the last motion, restored if the write of that motion fails.
    before: Vector,
    /// The correction at the start of the last ramp or line.
    from: PerChannel<f64>,
    /// Range of the next output that bounds the rate over every time window.
    corridor: Corridor,
    confirmed: PerChannel<f64>,
    /// The sent corrections, and the corrections accepted when read back.
    accepted: AcceptedRange,
    sent_to_barrier: Option<Duration>,
    /// Whether the output was held at, or reset to, the confirmed correction (start, interlock, change of path). The
    /// next motion then starts at the confirmed correction: with a new ramp or, while ramping to zero, with a new
    /// straight line.
    at_confirmed: bool,
    /// The correction at which the control holds its axes during an interlock; it is sent to the barrier as the word in
    /// every cycle.
    held: Option<PerChannel<f64>>,
    stopped_since: Option<Duration>,
    /// Set if the active path has changed: the output starts from the correction known on the new
    /// path.
    path_changed: bool,
    /// Set if the new path writes the same axes in the same steps as the previous path. The last words of the previous
    /// path may then still be in transit to the common barrier; a reading valid before this time does not show their
    /// effect yet.
    shared_until: Option<Duration>,
    proof: Proof,
    moves: MotionHistory,
    verdict: Verdict,
    last_cycle: Option<Duration>,
    inputs_valid_at: Option<Duration>,
    control_acts_at: Option<Duration>,
    adopted: PerChannel<u32>,
    held_back: u64,
}

impl Guard {
    /// A disarmed guard with zero output.
    ///
    /// # Errors
    /// Limits that are invalid, or beyond a [`ceiling`](crate::ceiling).
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
            accepted: AcceptedRange::within(&limits),
            sent_to_barrier: None,
            at_confirmed: true,
            held: None,
            stopped_since: None,
            path_changed: true,
            shared_until: None,
            proof: Proof::default(),
            moves: MotionHistory::default(),
            verdict: Verdict::default(),
            last_cycle: None,
            inputs_valid_at: None,
            control_acts_at: None,
            adopted: PerChannel::default(),
            held_back: 0,
        })
    }

    /// Replaces the limits from the next cycle on. Corrections beyond the new limits are reduced at the old or the new
    /// rate, whichever is lower. If [`Request::Switched`] follows, they are reduced by a ramp.
    ///
    /// # Errors
    /// Same as [`Limits::check_in_place_of`]; the old limits then stay active.
    pub fn set_limits(&mut self, limits: Limits) -> Result<(), LimitsError> {
        limits.check_in_place_of(&self.limits)?;
        let present = self.largest_present().unwrap_or_default();
        self.accepted.narrow(&present, &limits);
        self.limits = limits;
        Ok(())
    }

    /// Switches to another path from the next cycle on. `limits` are the limits of the new path, in its axis order.
    /// `places` is the index of each axis of the new path on the previous path; `None`: the previous path did not write
    /// the axis.
    ///
    /// The output starts at the confirmed correction of the new path. If both paths lead to one barrier, the output
    /// starts at the last words of the previous path while these words are in transit. Corrections beyond the new
    /// limits that the previous path sent or confirmed are reduced by a ramp.
    ///
    /// # Errors
    /// Invalid limits: the previous path stays active.
    pub fn take_path(
        &mut self,
        limits: Limits,
        places: &PerChannel<Option<usize>>,
    ) -> Result<(), LimitsError> {
        limits.check()?;
        let places = &places.map(|place| place.filter(|place| *place < self.limits.count));
        // Corrections sent by the previous path, or known there, are accepted on this path as well.
        let present = self.largest_present().unwrap_or_default();
        let now = self.last_cycle.unwrap_or_default();
        self.accepted.take_path(now, places, &present, &self.limits, &limits);
        // The last words of the previous path are the output until the correction on the new path is known.
        let is_same = limits.check_in_place_of(&self.limits).is_ok()
            && limits.places().all(|i| places[i] == Some(i));
        let delay = self.limits.longest_delay().max(limits.longest_delay());
        let shared_until = self.sent_to_barrier.map(|sent| sent.saturating_add(delay));
        self.shared_until = shared_until.filter(|_| is_same);
        let sent = self.output();
        let sent = places.map(|place| place.map_or(0.0, |place| sent[place]));
        self.limits = limits;
        if !is_same {
            self.corridor = self.corridor.on_path(places, &self.limits);
        }
        self.restart_at(&sent);
        self.before = self.vector;
        self.adopted = PerChannel::default();
        self.path_changed = true;
        (self.held, self.stopped_since) = (None, None);
        // Positions of the previous path do not permit sending on the new path, which waits for its own positions.
        let stale = self.limits.hold + self.limits.period;
        let stale = self.last_cycle.unwrap_or_default().saturating_sub(stale);
        self.inputs_valid_at =
            self.inputs_valid_at.map(|inputs_valid_at| inputs_valid_at.min(stale));
        // The proof depends on the positions of the previous path, including which axes moved.
        self.verdict = Verdict::default();
        self.proof = Proof::default();
        self.moves = MotionHistory::default();
        Ok(())
    }

    /// Records that the output of the last cycle was not sent, or that sending it failed. The next cycle continues from
    /// the previous output.
    pub fn not_sent(&mut self) {
        self.vector = self.before;
        self.vector.stop();
    }

    /// Remaining time from `now` in which the output of this cycle may be sent; `None`: the time is over. The time ends
    /// when positions or correction expire, or when the control may ramp to zero for lack of writes. Call immediately
    /// before a write.
    #[must_use]
    pub fn time_to_send(&self, now: Duration) -> Option<Duration> {
        // An output that ramps out or is constant depends on no position, but its decision also expires after the
        // maximum hold time.
        let depends = matches!(self.state, State::Arming(_) | State::Compensating);
        let decided = now.saturating_sub(self.last_cycle.unwrap_or(now));
        let age = if depends { self.age(now) } else { decided };
        let young = self.limits.hold.checked_sub(age)?;
        // Positions may be older than the ceiling (thermal terms only); a decision may not.
        let young = young.min(ceiling::HOLD.checked_sub(decided)?);
        match self.control_acts_at {
            Some(acts_at) => acts_at.checked_sub(now).map(|left| left.min(young)),
            None => Some(young),
        }
    }

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

    /// Duration of a ramp from the present correction to zero.
    #[must_use]
    pub fn time_to_zero(&self) -> Duration {
        self.vector.time_to_zero(&self.limits)
    }

    /// Result of the test shift at the last arming, by axis.
    pub fn verdict(&self) -> &Verdict {
        &self.verdict
    }

    /// Runs one cycle: decides the correction to send, and the state.
    pub fn cycle(&mut self, inputs: &Inputs) -> Output {
        let dt_s = self.elapsed(inputs.now);
        let reading = inputs.reading.filter(|reading| self.is_finite(reading));
        let requested = inputs.requested.filter(RequestedCorrection::is_finite);
        let is_number = inputs.requested.is_some() == requested.is_some()
            && inputs.reading.is_some() == reading.is_some();
        let inputs = Inputs { requested, ..*inputs };
        self.control_acts_at = inputs.read_back.control_acts_at;
        self.corridor.stay(&inputs.read_back.between, &self.limits);
        self.corridor.widen(&self.limits, dt_s);
        let path_changed = self.path_changed;
        let changed = self.adopt(&inputs);
        let facts =
            Facts { path_changed, ..self.facts(&inputs, reading.as_ref(), changed, is_number) };
        let before = self.state;
        self.state = before.next(&facts);
        if self.state != before && self.state == State::Arming(Phase::Proving) {
            self.verdict = Verdict::default();
        }
        if self.state.is_armed() && !before.is_armed() {
            // Differing confirmed corrections of an earlier arming do not count: arming starts at the confirmed
            // correction.
            self.adopted = PerChannel::default();
        }
        self.allow(&inputs, before);
        let resumes = self.at_confirmed && !facts.interlocked;
        // The end of the ramp-in needs no further ramp.
        let arrived = (before, self.state) == (State::Arming(Phase::Ramping), State::Compensating);
        let enters = self.state != before && !arrived;
        if enters || changed || resumes || facts.needs_ramp() {
            self.begin();
            self.at_confirmed = false;
        }
        let mut reasons = self.reasons(&inputs, &facts) | Reasons::NOT_A_NUMBER.when(!is_number);
        self.hold(&inputs, &facts);
        self.before = self.vector;
        let write = if self.may_send(&inputs) {
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

    /// A position that is not finite invalidates the whole reading.
    fn is_finite(&self, reading: &Reading) -> bool {
        self.all(|i| reading.positions[i].is_finite())
    }

    /// Time since the last cycle, s, limited to five periods.
    fn elapsed(&mut self, now: Duration) -> f64 {
        let period = self.limits.period;
        let passed = self.last_cycle.map_or(period, |last| now.saturating_sub(last));
        self.last_cycle = Some(now);
        passed.min(period * LONGEST_CYCLE_PERIODS).as_secs_f64()
    }

    /// Age of positions and correction.
    fn age(&self, now: Duration) -> Duration {
        self.inputs_valid_at
            .map_or(Duration::MAX, |inputs_valid_at| now.saturating_sub(inputs_valid_at))
    }

    /// During an interlock the last word is repeated to a barrier so that it does not time out: the axis has reached
    /// that word, or words in transit move it there. The confirmed correction lags the last word; a return to the
    /// confirmed correction would move the axis back and forth.
    ///
    /// If the control accepted the word but has held its axes elsewhere for long, the word is set to the held value, so
    /// that nothing moves when the control is released. A control that was stationary before the interlock may have
    /// been released since. It is treated as holding only if it is still stationary after the time in which a movement
    /// would have been reported.
    fn hold(&mut self, inputs: &Inputs, facts: &Facts) {
        let status = &inputs.read_back;
        if !facts.interlocked {
            (self.held, self.stopped_since) = (None, None);
            return;
        }
        let stopped_since = *self.stopped_since.get_or_insert(inputs.now);
        let Some(Confirmed { values, at }) = status.confirmed.filter(|_| !status.changed) else {
            self.held = None;
            return;
        };
        let is_seen = at.saturating_sub(stopped_since) > status.motion_delay;
        if is_seen && self.is_stationary_elsewhere(inputs) {
            self.held = Some(values);
        }
        // The control moves, so it no longer holds its axes.
        let present = |held: &PerChannel<f64>| are_equal(held, &values, &self.limits);
        self.held = self.held.filter(present);
    }

    /// Takes the confirmed correction as the output if it differs from the sent correction, and returns whether it did.
    /// Has no effect while idle, during an interlock and after a change of path.
    fn adopt(&mut self, inputs: &Inputs) -> bool {
        let status = &inputs.read_back;
        let Some(Confirmed { values, at }) = status.confirmed else {
            return false;
        };
        if !self.all(|i| values[i].is_finite()) {
            return false;
        }
        self.confirmed = values;
        let interlocked = !inputs.interlocks.is_empty();
        self.at_confirmed |= interlocked;
        let path_changed = core::mem::take(&mut self.path_changed);
        // While nothing is sent, the output is set to the applied correction.
        let idle = self.is_idle(inputs);
        if path_changed && !idle && self.is_in_transit(status.scheme, &values, at) {
            self.at_confirmed = true;
            return false;
        }
        if path_changed || idle || interlocked && status.changed {
            self.restart_at(&values);
            return false;
        }
        if !status.changed {
            self.count_landed(status, &values);
            return false;
        }
        let output = self.output();
        // A confirmed correction that equals the sent one does not restart the output.
        let mut is_event = false;
        for i in self.limits.places() {
            if !is_same_step(values[i], output[i], self.limits.axes[i].resolution) {
                self.adopted[i] = self.adopted[i].saturating_add(1);
                is_event = true;
            }
        }
        if is_event {
            self.restart_at(&values);
        }
        is_event
    }

    /// Restarts the output at these values (mm, rad).
    fn restart_at(&mut self, values: &PerChannel<f64>) {
        self.vector = Vector::at(values);
        self.corridor.begin(values, &self.limits);
        self.at_confirmed = true;
    }

    /// Whether the last word of the previous path may still be in transit to the barrier that both paths share: the
    /// word differs from the `values` that the barrier applied at `at` by no more than the slew since then.
    fn is_in_transit(&self, scheme: Scheme, values: &PerChannel<f64>, at: Duration) -> bool {
        let (Some(shared_until), output) = (self.shared_until, self.output()) else {
            return false;
        };
        let slewed_s = shared_until.saturating_sub(at).as_secs_f64();
        let is_near = |i: usize| {
            let slew_per_s = self.accepted.slew_per_s(i);
            let most = slew_per_s * slewed_s + one_step(self.limits.axes[i].resolution);
            (output[i] - values[i]).abs() <= most
        };
        scheme == Scheme::Barrier && at <= shared_until && self.all(is_near)
    }

    /// Whether nothing is sent in this state; during an interlock words are sent only to a barrier.
    fn is_idle(&self, inputs: &Inputs) -> bool {
        match self.state {
            State::Disarmed | State::Faulted(Cause::BeyondLimit) => true,
            _ if inputs.read_back.scheme == Scheme::Barrier => false,
            State::Holding(Hold::Interlocked) => true,
            _ => !inputs.interlocks.is_empty(),
        }
    }

    /// Resets the fault counter of axes whose confirmed correction has reached the sent correction and left the start
    /// of the ramp: such axes accept words.
    fn count_landed(&mut self, status: &ReadBackStatus, values: &PerChannel<f64>) {
        if status.unlanded_since.is_some() || !status.writable {
            return;
        }
        for i in self.limits.places() {
            if !is_same_step(values[i], self.from[i], self.limits.axes[i].resolution) {
                self.adopted[i] = 0;
            }
        }
    }

    /// Updates the range of accepted corrections. The range exceeds the limit of an axis only while the correction
    /// returns to the limit, after the limit was lowered or the operator acknowledged the excess.
    fn allow(&mut self, inputs: &Inputs, before: State) {
        let Some(present) = self.largest_present() else {
            return;
        };
        let ramps_out = matches!(self.state, State::RampingOut(_))
            && !matches!(before, State::RampingOut(_))
            && inputs.request == Some(Request::Acknowledge);
        if ramps_out {
            self.accepted.accept(&present, &self.limits);
        } else {
            self.accepted.narrow(&present, &self.limits);
        }
        if let Some(confirmed) = inputs.read_back.confirmed {
            self.accepted.pass(inputs.now, confirmed.at, &self.limits);
        }
    }

    /// The larger of the absolute output and the absolute confirmed correction of each axis. `None` after a change of
    /// path until the correction is known.
    fn largest_present(&self) -> Option<PerChannel<f64>> {
        let (output, confirmed) = (self.output(), &self.confirmed);
        let furthest = |i: usize| output[i].abs().max(confirmed[i].abs());
        (!self.path_changed).then(|| PerChannel::from_fn(furthest))
    }

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

    fn may_send(&self, inputs: &Inputs) -> bool {
        !self.is_idle(inputs) && inputs.read_back.writable
    }

    fn facts(
        &mut self,
        inputs: &Inputs,
        reading: Option<&Reading>,
        changed: bool,
        is_number: bool,
    ) -> Facts {
        let (now, status, limits) = (inputs.now, &inputs.read_back, &self.limits);
        if let (Some(reading), Some(_)) = (reading, &inputs.requested) {
            // A device may report a future time; clamp it to now.
            self.inputs_valid_at = self.inputs_valid_at.max(Some(reading.taken.min(now)));
        }
        let age = self.age(now);
        let since = |since: Option<Duration>| since.map(|since| now.saturating_sub(since));
        let confirmed = since(status.confirmed.map(|confirmed| confirmed.at));
        let unlanded = since(status.unlanded_since).unwrap_or_default();
        let interlocked = !inputs.interlocks.is_empty();
        let hold = self.hold_unconfirmed(status);
        let unconfirmed = confirmed.is_none_or(|age| age > hold)
            || unlanded > hold
            || !interlocked && self.is_stationary_elsewhere(inputs);
        let does_not_land = unlanded > limits.zero_after && inputs.reading.is_some();
        let values = status.confirmed.map(|confirmed| confirmed.values);
        let is_zero = |values: &PerChannel<f64>| are_equal(values, &PerChannel::ZERO, &self.limits);
        let beyond = |values: &PerChannel<f64>| self.accepted.is_exceeded_by(values, limits);
        Facts {
            request: inputs.request,
            interlocked,
            stale: age > self.limits.hold,
            lost: age > self.limits.zero_after || inputs.fast_ramp_out && age > self.limits.hold,
            unconfirmed,
            does_not_land,
            beyond: values.as_ref().is_some_and(beyond),
            other_gateway: status.scheme == Scheme::Barrier
                && status.reasons.contains(Reasons::OTHER_GATEWAY),
            changed,
            path_changed: false,
            forbidden: !is_number
                || reading.is_none()
                || !(inputs.forbids | status.reasons.without(Reasons::DOES_NOT_FORBID)).is_empty(),
            foreign: FOREIGN.into_iter().any(|reason| status.reasons.contains(reason)),
            ramped: self.vector.is_ramped(),
            zero: values.as_ref().is_some_and(is_zero) && is_zero(&self.output()),
            proves: self.limits.places().any(|i| self.limits.test_shift[i] > 0.0),
            proven: self.prove(inputs, reading, changed || age > self.limits.hold || unconfirmed),
            does_not_stick: self.adopted.iter().any(|times| *times >= MOST_ADOPTED),
        }
    }

    /// True if the control accepts words but has been stationary at another correction for longer than `hold_unconfirmed`.
    fn is_stationary_elsewhere(&self, inputs: &Inputs) -> bool {
        let since = inputs.read_back.stationary_since;
        let hold = self.hold_unconfirmed(&inputs.read_back);
        since.is_some_and(|since| inputs.now.saturating_sub(since) > hold)
    }

    /// Time for which the last confirmed correction is valid: `hold`, but with a barrier at most its timeout or
    /// [`ceiling::HOLD`], whichever is longer.
    fn hold_unconfirmed(&self, status: &ReadBackStatus) -> Duration {
        let most = status.barrier_time_out.map(|after| after.max(ceiling::HOLD));
        most.map_or(self.limits.hold, |most| most.min(self.limits.hold))
    }

    fn prove(
        &mut self,
        inputs: &Inputs,
        reading: Option<&Reading>,
        disturbed: bool,
    ) -> Option<bool> {
        let (now, reading) = (inputs.now, reading?);
        let applied = inputs.read_back.confirmed?.values;
        self.moves.update(now, &reading.positions, &applied, &self.limits);
        if self.state != State::Arming(Phase::Proving) || disturbed {
            return None;
        }
        if let Some(requested) = &inputs.requested {
            self.proof.set_follow(&requested.follow);
        }
        let (from, limits) = (&self.from, &self.limits);
        self.verdict = self.proof.read(now, reading, &applied, from, limits, &self.moves)?;
        Some(!self.verdict.is_contradiction())
    }

    fn reasons(&self, inputs: &Inputs, facts: &Facts) -> Reasons {
        let mut reasons = self.state.reason() | inputs.interlocks | inputs.read_back.reasons;
        reasons |= Reasons::NO_CONTROLLER.when(inputs.reading.is_none());
        reasons |= Reasons::POSITIONS_STALE.when(facts.stale);
        reasons |= Reasons::READ_BACK.when(facts.changed);
        reasons |= Reasons::UNCONFIRMED.when(facts.unconfirmed);
        reasons |= Reasons::CORRECTION_LEFT
            .when(self.state == State::Disarmed && inputs.read_back.holds(&self.limits));
        reasons |= Reasons::BEYOND_LIMIT.when(facts.beyond);
        reasons |=
            Reasons::WAITING_FOR_STANDSTILL.when(self.state == State::Arming(Phase::Proving));
        let shown = |i: usize| self.verdict.proven[i] || self.limits.test_shift[i] == 0.0;
        let after = !matches!(self.state, State::Disarmed | State::Arming(Phase::Proving));
        reasons | Reasons::NOT_PROVEN.when(!facts.proves || after && !self.all(shown))
    }

    /// Moves the output for `dt_s`, as far as it stays within reach of every correction that may be applied. Returns
    /// whether to send the output.
    fn advance(&mut self, inputs: &Inputs, dt_s: f64, reasons: &mut Reasons) -> bool {
        let Some(Confirmed { values, .. }) = inputs.read_back.confirmed else {
            return false;
        };
        let is_barrier = inputs.read_back.scheme == Scheme::Barrier;
        let reach = self.reach(inputs.read_back.scheme);
        let [lowest, highest] = inputs.read_back.between;
        let sent = self.before.output();
        for share in SHARES {
            self.vector = self.before;
            let moved = self.move_by(inputs, dt_s * share);
            let output = self.output();
            let is_near = |i: usize| {
                // Tolerates rounding errors of whole steps.
                let rounding = ROUNDING_STEPS * self.limits.axes[i].resolution;
                let reach = reach[i] * ROUNDING + rounding;
                let (mut least, mut largest) = (highest[i] - reach, lowest[i] + reach);
                // A correction beyond a limit is reduced from the largest value that may be applied now.
                let mut at_confirmed = lowest[i].abs().max(highest[i].abs());
                if is_barrier {
                    // The last word is in transit and may be repeated at any distance from the confirmed correction.
                    (least, largest) = (least.min(sent[i]), largest.max(sent[i]));
                    at_confirmed = at_confirmed.max(sent[i].abs());
                }
                let most = at_confirmed.max(self.limits.axes[i].reachable());
                (least..=largest).contains(&output[i])
                    && output[i].abs() <= most * ROUNDING
                    && self.corridor.contains(i, output[i], &self.limits)
            };
            if self.all(is_near) {
                // A missing confirmation limits the output in the same way as the slew limit.
                let moved = moved | Reasons::SLEWING.when(share < 1.0);
                self.held_back += u64::from(moved.contains(Reasons::SLEWING));
                *reasons |= moved;
                self.corridor.narrow(&output, &self.limits);
                self.accepted.send(&output, &self.limits);
                self.sent_to_barrier = is_barrier.then_some(inputs.now);
                return true;
            }
        }
        if is_barrier {
            // A frame whose sending failed may still have arrived: the rate does not yet allow a return to the previous
            // word.
            self.vector = self.before;
            self.vector.stop();
        } else {
            // The last word is too far from the confirmed correction to be sent again: the output restarts at the
            // confirmed one.
            self.vector = Vector::at(&values);
            self.at_confirmed = true;
        }
        self.held_back += 1;
        *reasons |= Reasons::SLEWING;
        false
    }

    /// Maximum distance of the output of each axis from the corrections that may be applied, mm and rad. With a barrier
    /// it is the slew during the delay of the path (the highest slew among the words in transit); otherwise the slew
    /// per cycle or one step, whichever is larger.
    fn reach(&self, scheme: Scheme) -> PerChannel<f64> {
        let period_s = self.limits.period.as_secs_f64();
        let delay_s = self.limits.delay().as_secs_f64();
        PerChannel::from_fn(|i| {
            let axis = &self.limits.axes[i];
            match scheme {
                Scheme::Barrier => {
                    let slew_per_s = axis.slew_per_s.max(self.accepted.slew_per_s(i));
                    slew_per_s * (delay_s + period_s) + axis.resolution
                }
                Scheme::Plain | Scheme::NoReadBack => {
                    (axis.slew_per_s * period_s).max(axis.resolution)
                }
            }
        })
    }

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
                let Some(requested) = &inputs.requested else {
                    return Reasons::NONE;
                };
                let followed = self.vector.follow(requested, &limits, dt_s);
                Reasons::SLEWING.when(followed.slewing)
                    | Reasons::LIMITED.when(followed.limited)
                    | Reasons::WARN.when(followed.warned)
            }
            State::RampingOut(_) | State::Faulted(_) => {
                let mut limits = limits;
                if inputs.fast_ramp_out {
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

    /// Moves the vector to the correction that the control holds, even beyond a limit that was lowered in the meantime:
    /// no axis moves during the interlock, and the correction is reduced after it.
    fn move_to_held(&mut self, held: &PerChannel<f64>, dt_s: f64) {
        let (present, mut limits) = (self.vector.smooth(), self.limits);
        for (i, axis) in limits.axes.iter_mut().enumerate() {
            axis.limit = axis.limit.max(held[i].abs()).max(present[i].abs());
        }
        limits.ramp = Duration::ZERO;
        self.move_on_line(held, &limits, dt_s);
    }

    /// Moves the vector on a line to a goal some steps away, in as few cycles as possible, without the ramp time. Corrections beyond a lowered
    /// limit are reduced by a ramp.
    fn move_to(&mut self, goal: &PerChannel<f64>, limits: &Limits, dt_s: f64) {
        let (smooth, mut limits) = (self.vector.smooth(), *limits);
        let is_within = |i: usize| smooth[i].abs() <= limits.axes[i].reachable() * ROUNDING;
        if self.all(is_within) {
            limits.ramp = Duration::ZERO;
        }
        self.move_on_line(goal, &limits, dt_s);
    }

    fn move_on_line(&mut self, goal: &PerChannel<f64>, limits: &Limits, dt_s: f64) {
        // A line also restarts after a write that was not sent, which restored the vector.
        if !self.vector.leads_to(goal) {
            self.vector.begin_line(goal);
        }
        self.vector.advance_line(limits, dt_s);
    }
}

/// Maximum time between sending a word and a reading that still shows the word. A barrier accepts only one frame per
/// path delay, because all frames sent while a report is in transit answer the same report. The barrier may therefore
/// still move towards a frame sent one delay before the last frame.
fn longest_visible(limits: &Limits) -> Duration {
    limits.longest_delay().saturating_mul(2)
}

#[derive(Clone, Copy, Debug, Default)]
struct SentRange {
    /// Largest absolute word of each axis, mm or rad.
    largest: PerChannel<f64>,
    /// Highest slew limit of each axis while these corrections were sent, mm/s or rad/s.
    slew_per_s: PerChannel<f64>,
}

/// State of the guard. Call `narrow` or `accept` in each cycle, then `pass`, then `send`: words that expire in a cycle
/// are still included in `narrow` and `accept`.
///
/// Invariants:
/// - `largest` is at least the limit of each axis.
/// - Every word that may still be in transit counts in `recent` or `earlier`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct AcceptedRange {
    largest: PerChannel<f64>,
    /// Range of the words sent recently.
    recent: SentRange,
    /// Range of the words sent in the interval before `recent`.
    earlier: SentRange,
    /// Readings valid at this time or later show no effect of the `earlier` words.
    earlier_until: Duration,
}

impl AcceptedRange {
    pub(crate) fn within(limits: &Limits) -> Self {
        Self { largest: limits.of_axes(|axis| axis.limit), ..Self::default() }
    }

    fn is_exceeded_by(&self, values: &PerChannel<f64>, limits: &Limits) -> bool {
        let is_beyond =
            |i: usize| values[i].abs() > self.largest[i] + one_step(limits.axes[i].resolution);
        limits.places().any(is_beyond)
    }

    /// Highest slew of an axis among the words that may still arrive, mm/s or rad/s.
    pub(crate) fn slew_per_s(&self, axis: usize) -> f64 {
        self.recent.slew_per_s[axis].max(self.earlier.slew_per_s[axis])
    }

    /// Largest absolute correction that may be applied, now or by words that are still in transit. `present` is the larger of the absolute
    /// output and the absolute confirmed correction.
    fn may_be_applied(&self, axis: usize, present: &PerChannel<f64>) -> f64 {
        let sent = self.recent.largest[axis].max(self.earlier.largest[axis]);
        present[axis].max(sent)
    }

    /// Reduces the largest accepted correction of each axis to the correction that may still be applied, but not below
    /// the limit of the axis. `present`: see `may_be_applied`.
    fn narrow(&mut self, present: &PerChannel<f64>, limits: &Limits) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            let left = self.largest[i].min(self.may_be_applied(i, present));
            self.largest[i] = axis.limit.max(left);
        }
    }

    pub(crate) fn accept(&mut self, present: &PerChannel<f64>, limits: &Limits) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            self.largest[i] = axis.limit.max(self.may_be_applied(i, present));
        }
    }

    /// Removes words sent long before `confirmed`, the time of the last confirmation: they can no
    /// longer arrive.
    pub(crate) fn pass(&mut self, now: Duration, confirmed: Duration, limits: &Limits) {
        if confirmed >= self.earlier_until {
            (self.earlier, self.recent) = (self.recent, SentRange::default());
            self.earlier_until = now.saturating_add(longest_visible(limits));
        }
    }

    /// Records words (mm, rad) as sent.
    pub(crate) fn send(&mut self, words: &PerChannel<f64>, limits: &Limits) {
        let SentRange { largest, slew_per_s } = &mut self.recent;
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            largest[i] = largest[i].max(words[i].abs());
            slew_per_s[i] = slew_per_s[i].max(axis.slew_per_s);
        }
    }

    /// Switches to another path, which writes from `now` on. `places` is the index of each of its axes on the previous path, whose limits were
    /// `before`; `present_before` bounds the absolute values of output and control there.
    fn take_path(
        &mut self,
        now: Duration,
        places: &PerChannel<Option<usize>>,
        present_before: &PerChannel<f64>,
        before: &Limits,
        limits: &Limits,
    ) {
        let count = before.count.min(MAX_AXES);
        let carried = |of: &dyn Fn(usize) -> f64| {
            PerChannel::from_fn(|i| {
                let place = places[i].filter(|place| *place < count && i < limits.count);
                place.map_or(0.0, of)
            })
        };
        let sent = SentRange {
            largest: carried(&|place| {
                self.largest[place].min(self.may_be_applied(place, present_before))
            }),
            slew_per_s: carried(&|place| self.slew_per_s(place)),
        };
        let most = limits.of_axes(|axis| axis.limit);
        self.largest = PerChannel::from_fn(|i| sent.largest[i].max(most[i]));
        // The last words of the previous path may arrive as late as on that path.
        (self.recent, self.earlier) = (sent, sent);
        self.earlier_until =
            now.saturating_add(longest_visible(before).max(longest_visible(limits)));
    }
}

/// Range of the next word of each axis; state of the guard.
///
/// Invariants:
/// - The range of an axis is not empty, except for rounding.
/// - Every value in the range differs from each earlier word by at most the slew since that word plus one step, unless
///   a cause outside the guard has moved the axis out of the range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Corridor {
    lowest: PerChannel<f64>,
    highest: PerChannel<f64>,
    sent: PerChannel<f64>,
}

impl Corridor {
    /// The range around applied values (mm, rad), without earlier words.
    pub(crate) fn about(values: &PerChannel<f64>, limits: &Limits) -> Self {
        let step = limits.of_axes(|axis| axis.resolution);
        Self {
            lowest: PerChannel::from_fn(|i| values[i] - step[i]),
            highest: PerChannel::from_fn(|i| values[i] + step[i]),
            sent: *values,
        }
    }

    /// Converts the range to another path. `places` is the index of each axis of the other path on this path; an axis
    /// that this path lacks starts at zero.
    fn on_path(&self, places: &PerChannel<Option<usize>>, limits: &Limits) -> Self {
        let zero = Self::about(&PerChannel::ZERO, limits);
        let carried = |from: &PerChannel<f64>, zero: &PerChannel<f64>| {
            PerChannel::from_fn(|i| places[i].map_or(zero[i], |place| from[place]))
        };
        Self {
            lowest: carried(&self.lowest, &zero.lowest),
            highest: carried(&self.highest, &zero.highest),
            sent: carried(&self.sent, &zero.sent),
        }
    }

    /// Restarts at applied values (mm, rad). The range of an axis is kept if it contains the value; otherwise the range
    /// restarts at the value.
    pub(crate) fn begin(&mut self, values: &PerChannel<f64>, limits: &Limits) {
        let before = *self;
        *self = Self::about(values, limits);
        for i in limits.places() {
            if before.contains(i, values[i], limits) {
                self.lowest[i] = self.lowest[i].max(before.lowest[i]);
                self.highest[i] = self.highest[i].min(before.highest[i]);
                self.sent[i] = before.sent[i];
            }
        }
    }

    /// Tightens the range to one step around the last sent words, because no other words were sent since. Axes whose
    /// words are outside `between`, the lowest and highest values that may be applied, are unchanged.
    fn stay(&mut self, between: &[PerChannel<f64>; 2], limits: &Limits) {
        let [lowest, highest] = between;
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            let (sent, rounding) = (self.sent[i], ROUNDING_STEPS * axis.resolution);
            if (lowest[i] - rounding..=highest[i] + rounding).contains(&sent) {
                self.lowest[i] = self.lowest[i].max(sent - axis.resolution);
                self.highest[i] = self.highest[i].min(sent + axis.resolution);
            }
        }
    }

    fn widen(&mut self, limits: &Limits, dt_s: f64) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            self.lowest[i] -= axis.slew_per_s * dt_s;
            self.highest[i] += axis.slew_per_s * dt_s;
        }
    }

    pub(crate) fn contains(&self, axis: usize, word: f64, limits: &Limits) -> bool {
        let rounding = ROUNDING_STEPS * limits.axes[axis].resolution;
        (self.lowest[axis] - rounding..=self.highest[axis] + rounding).contains(&word)
    }

    /// Tightens the range around the words (mm, rad) being sent.
    fn narrow(&mut self, words: &PerChannel<f64>, limits: &Limits) {
        self.sent = *words;
        self.stay(&[*words; 2], limits);
    }
}
