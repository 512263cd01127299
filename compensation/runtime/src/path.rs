//! The controllers of a cycle, and the machine position combined from their last positions.
//!
//! Corrections are written by a [`ControlPath`]; a [`PositionReader`] is never written. State: the last answer of each
//! controller, and the applied correction as far as it is known.

use std::{
    io,
    time::{Duration, Instant},
};

use volcomp_guard::{
    BarrierLink, CorrectionReport, Interlock, Limits, LimitsError, ReadBack, ReadBackStatus,
    Reasons,
    barrier::FRAME_WORDS,
    ceiling,
    protocol::{Layout, LayoutError},
};
use volcomp_kinematics::Correctors;
use volcomp_port::{Controller, Description, Fault, ShownStates, Snapshot, UnfitAxes, Words};
use volcomp_vocabulary::{AxisName, MAX_AXES, Mm, PerAxis, PerChannel};

use crate::{
    clock::monotonic,
    error::PlanError,
    model::Model,
    plan::{PathPlan, left_to, names, place_in, position_steps, reversals, steps_in_machine},
    report::PathReport,
    settings::PathSettings,
    standby::{ControllerSlot, STANDBY_INTERVAL, StandbyReading},
};

/// One controller and its read-back.
///
/// Invariants:
/// - The thread that reads `device` on standby may hold it. All other data are here, so a cycle never waits for the thread.
/// - `reading` is set only if the last answer was valid and not too old, and the path has not become silent since; `answered_at` is then
///   set too. `read_at` never decreases: answers to earlier requests are dropped.
/// - `reported` has positions without the correction. A reading with an unknown correction is never stored there.
/// - `correctors` and `followers` belong to the active model: `fit_to` is called with every new one. `limits` has the planned test shifts,
///   `limits()` only those of correcting axes.
/// - Every correction recorded as sent in `read_back` was sent by `send`, or by another path to the same barrier.
pub struct ControlPath {
    pub(crate) device: ControllerSlot,
    /// Description of the controller, kept here because another thread may hold the controller.
    pub(crate) description: Description,
    limits: Limits,
    pub(crate) read_back: ReadBack,
    /// Whether the control ramps to zero on its own when writes stop.
    pub(crate) goes_to_zero: bool,
    pub(crate) reported: ReportedPositions,
    /// Resolution of the positions, mm or rad, from which the reversal thresholds follow.
    position_steps: PerChannel<f64>,
    names: Vec<AxisName>,
    /// Axes that correct with the active model.
    pub(crate) correctors: Correctors,
    /// Axes that follow a remaining correction on rotary axes; `None` if the correcting axes can.
    pub(crate) followers: Option<Correctors>,
    /// Maximum movement of the tip by half a step of a correcting rotary axis.
    rotary_step: Mm,
    pub(crate) only_thermal: bool,
    /// Fixed positions of machine axes from the configuration, mm and rad.
    pub(crate) fixed: PerAxis<Option<f64>>,
    pub(crate) notes: Reasons,
    pub(crate) reading: Option<Snapshot>,
    flags_taken: Duration,
    read_at: Option<Duration>,
    answered_at: Option<Duration>,
    sent: Option<Duration>,
}

impl ControlPath {
    /// Creates a path from an open controller and its plan.
    ///
    /// # Errors
    /// Limits that a guard rejects; never for an unmodified plan.
    pub fn new(controller: Box<dyn Controller>, plan: &PathPlan) -> Result<Self, PlanError> {
        plan.limits.check().map_err(|source| PlanError::Limits {
            device: plan.description.device.clone(),
            axis: None,
            source,
        })?;
        Ok(Self {
            description: controller.description().clone(),
            device: ControllerSlot::new(controller),
            limits: plan.limits,
            read_back: match link(plan, owner())? {
                Some(link) => ReadBack::barrier(link),
                None if plan.no_read_back => ReadBack::no_read_back(plan.time_out),
                None => ReadBack::plain(plan.watch),
            },
            reported: ReportedPositions::without_positions(
                plan.machine_axis,
                plan.description.shown_axes().count(),
                plan.reversal,
            ),
            goes_to_zero: plan.goes_to_zero(),
            position_steps: plan.position_steps,
            names: names(&plan.description),
            correctors: plan.correctors.clone(),
            followers: None,
            rotary_step: plan.rotary_step,
            only_thermal: plan.only_thermal,
            fixed: plan.fixed,
            notes: plan.notes,
            reading: None,
            flags_taken: Duration::ZERO,
            read_at: None,
            answered_at: None,
            sent: None,
        })
    }

    /// Replaces the random owner number of a path with a barrier, for one of several machines ([`next_owner`]) and for simulated restarts.
    /// No effect without a barrier.
    ///
    /// # Errors
    /// Axes that a barrier cannot have; never for an unmodified plan.
    pub fn with_owner(mut self, plan: &PathPlan, owner: u16) -> Result<Self, PlanError> {
        if let Some(link) = link(plan, owner.max(1))? {
            self.read_back = ReadBack::barrier(link);
        }
        Ok(self)
    }

    /// Updates the correcting axes for another model. Does not allocate.
    pub(crate) fn fit_to(&mut self, model: &Model) {
        let steps = steps_in_machine(&self.limits, &self.reported.machine_axis);
        self.correctors = model.correctors_of_path(&self.names, &steps, self.rotary_step);
        self.followers = model.followers(&self.names, &self.correctors);
    }

    /// Replaces the limits. Errors: limits of other axes, steps or period. Does not allocate.
    pub(crate) fn set_limits(&mut self, limits: &Limits) -> Result<(), LimitsError> {
        limits.check_in_place_of(&self.limits)?;
        self.limits = *limits;
        // Movement by a faster correction within the read-back delay must not count as a reversal.
        let steps = self.position_steps;
        self.reported.reversal = reversals(&self.description, &steps, Some(limits));
        Ok(())
    }

    /// Limits of the path. Test shifts of non-correcting axes are zero, because no shift is written to these.
    pub(crate) fn limits(&self) -> Limits {
        let shift = |place: usize| {
            if self.corrects(place) { self.limits.test_shift[place] } else { 0.0 }
        };
        Limits { test_shift: PerChannel::from_fn(shift), ..self.limits }
    }

    pub(crate) fn corrects(&self, place: usize) -> bool {
        place < self.count() && self.correctors.contains(self.reported.machine_axis[place])
    }

    pub(crate) fn count(&self) -> usize {
        self.limits.count
    }

    pub(crate) fn read_back_status(&self) -> &ReadBackStatus {
        self.read_back.status()
    }

    /// Machine index of each written axis, in channel order.
    pub(crate) fn written(&self) -> impl Iterator<Item = usize> {
        self.reported.machine_axis.into_iter().take(self.count())
    }

    /// Channel index of each written axis on another path; `None`: the other path does not write it.
    pub(crate) fn places_on(&self, other: &Self) -> PerChannel<Option<usize>> {
        let mut places = PerChannel::default();
        for (place, axis) in places.iter_mut().zip(self.written()) {
            *place = other.written().position(|of_other| of_other == axis);
        }
        places
    }

    /// Converts channel order to machine order; zero for axes that the path does not write.
    pub(crate) fn in_machine(&self, values: &PerChannel<f64>) -> PerAxis<f64> {
        let mut machine = PerAxis::ZERO;
        for (axis, value) in self.written().zip(values) {
            machine[axis] = *value;
        }
        machine
    }

    pub(crate) fn in_channel(&self, values: &PerAxis<f64>) -> PerChannel<f64> {
        let mut channel = PerChannel::ZERO;
        for (into, axis) in channel.iter_mut().zip(self.written()) {
            *into = values[axis];
        }
        channel
    }

    /// Whether this path writes an axis that the other path does not.
    pub(crate) fn leaves_axes_to(&self, other: &Self) -> bool {
        left_to(&self.description, &other.description).is_some()
    }

    /// Whether the positions of the path are recent enough for correcting.
    pub(crate) fn is_fresh(&self, now: Duration) -> bool {
        self.is_young(self.reported.taken, now)
    }

    /// Whether positions that were valid at `taken` are recent enough for correcting on this path.
    pub(crate) fn is_young(&self, taken: Option<Duration>, now: Duration) -> bool {
        taken.is_some_and(|taken| now.saturating_sub(taken) <= self.limits.hold)
    }

    /// Whether the positions were recent enough when the controller reported them.
    pub(crate) fn was_fresh(&self) -> bool {
        self.answered_at.is_some_and(|answered_at| self.is_young(self.reported.taken, answered_at))
    }

    /// Time of the last message to the controller that may have arrived; `None` before the first.
    pub(crate) fn last_sent(&self) -> Option<Duration> {
        self.sent
    }

    pub(crate) fn last_read(&self) -> Option<Duration> {
        self.read_at
    }

    /// Interlocks of the last reading, given the age of its flags; `None`: the controller did not answer.
    pub(crate) fn interlock(&self) -> Option<Interlock> {
        let (reading, answered_at) = (self.reading.as_ref()?, self.answered_at?);
        let age = answered_at.saturating_sub(self.flags_taken);
        let shown = self.description.shown;
        Some(interlock_of(reading, shown, age, self.limits.hold))
    }

    /// Timeout of an exchange: 0.6 periods, or a third of the maximum age of positions if that is longer, because a
    /// late answer costs a few cycles and a dropped connection many.
    pub(crate) fn exchange_time_out(&self) -> Duration {
        // Bounds the delay of a cycle even if positions may be held for seconds.
        let hold = self.limits.hold.min(ceiling::HOLD);
        self.limits.period.mul_f64(0.6).max(hold / 3)
    }

    /// Whether the last reading was answered, and is not older than the allowed silence of a standby path.
    pub(crate) fn answers(&self, now: Duration) -> bool {
        let silent = STANDBY_INTERVAL * 3 + self.exchange_time_out();
        let read_at = self.read_at.filter(|_| self.reading.is_some());
        read_at.is_some_and(|read_at| now.saturating_sub(read_at) <= silent)
    }

    /// Drops the last reading of a path whose exchange hangs for too long. Returns whether it was dropped.
    pub(crate) fn drop_if_silent(&mut self, now: Duration) -> bool {
        let is_silent = self.reading.is_some() && !self.answers(now);
        if is_silent {
            self.reading = None;
        }
        is_silent
    }

    /// Reads the controller. `start` is the start of the cycle's clock. Returns whether the answer was valid.
    pub(crate) fn read(&mut self, deadline: Instant, start: Instant, now: Duration) -> bool {
        let read = match self.device.held_controller() {
            Some(controller) => controller.read(deadline),
            None => Err(Fault::NotConnected),
        };
        self.read_at = Some(now);
        self.receive(&read, start, now)
    }

    /// Processes an answer received on standby. Returns whether it was valid; `None` if a later
    /// answer has already been processed.
    pub(crate) fn receive_standby(
        &mut self,
        reading: &StandbyReading,
        start: Instant,
    ) -> Option<bool> {
        let read_at = reading.requested.saturating_duration_since(start);
        if self.read_at.is_some_and(|last| read_at < last) {
            return None;
        }
        self.read_at = Some(read_at);
        let answered_at = reading.received.saturating_duration_since(start);
        Some(self.receive(&reading.read, start, answered_at))
    }

    fn receive(&mut self, read: &Result<Snapshot, Fault>, start: Instant, now: Duration) -> bool {
        if *read == Err(Fault::OtherGateway) {
            self.read_back.report_other_gateway(now);
        }
        let limits = self.limits();
        let held = |at: Instant| at.saturating_duration_since(start);
        // A device that only repeats data older than the maximum age of positions counts as not answering.
        let is_young = |snapshot: &Snapshot| self.is_young(Some(held(snapshot.youngest())), now);
        self.reading = (*read).ok().filter(is_young);
        let Some(snapshot) = &self.reading else {
            self.read_back.receive(now, now, &CorrectionReport::Missing, &limits);
            return false;
        };
        let taken = held(snapshot.taken);
        self.flags_taken = held(snapshot.state_taken);
        let report = match (&snapshot.report, snapshot.applied) {
            (Some(words), _) => CorrectionReport::Barrier(words.as_slice()),
            (None, Some(applied)) => CorrectionReport::Values(applied),
            (None, None) => CorrectionReport::Missing,
        };
        let report_taken = held(snapshot.correction_taken);
        self.read_back.receive(now, report_taken, &report, &limits);
        self.answered_at = Some(now);
        self.take_positions(taken);
        true
    }

    /// Stores the positions of the last reading without the correction that they contain. If that correction is unknown, the positions are
    /// dropped.
    fn take_positions(&mut self, taken: Duration) {
        let Some(snapshot) = &self.reading else {
            return;
        };
        let applied = self.read_back_status().confirmed.map(|confirmed| confirmed.values);
        let mut positions = snapshot.positions;
        for (place, position) in positions.iter_mut().enumerate().take(self.limits.count) {
            if self.limits.axes[place].includes_correction {
                // An unknown correction makes the position NaN, which is not stored.
                *position -= applied.map_or(f64::NAN, |applied| applied[place]);
            }
        }
        self.reported.store(&positions, taken);
    }

    /// Sends a correction (mm, rad). Returns whether it was sent without an error.
    pub(crate) fn send(
        &mut self,
        correction: &PerChannel<f64>,
        deadline: Instant,
        now: Duration,
    ) -> bool {
        let limits = self.limits();
        let begun = Instant::now();
        let sent = match self.device.held_controller() {
            None => Err(Fault::NotConnected),
            Some(controller)
                if self.read_back.status().scheme == volcomp_guard::Scheme::Barrier =>
            {
                let mut words = [0; FRAME_WORDS];
                let frame = self
                    .read_back
                    .frame(correction, &limits, &mut words)
                    .and_then(|length| Words::new(&words[..length]));
                match frame {
                    Some(frame) => controller.post(&frame, deadline),
                    None => Err(Fault::NotConnected),
                }
            }
            Some(controller) => controller.apply(correction, deadline),
        };
        // A slow control has received the correction only when it answers, so `now` includes the exchange.
        let now = now + begun.elapsed();
        // A failed write on digital lines has no effect.
        if sent.is_ok() || self.read_back_status().scheme != volcomp_guard::Scheme::NoReadBack {
            self.sent = Some(now);
        }
        self.read_back.sent(now, correction, sent.is_ok());
        sent.is_ok()
    }

    pub(crate) fn report(&self, now: Duration) -> PathReport {
        let read_back_status = self.read_back_status();
        PathReport {
            answered: self.answered_at.map(|then| now.saturating_sub(then)),
            positions: self.reported.taken.map(|then| now.saturating_sub(then)),
            confirmed: read_back_status.confirmed.map(|confirmed| now.saturating_sub(confirmed.at)),
            scheme: read_back_status.scheme,
            holds: read_back_status.holds(&self.limits),
            barrier_misfit: read_back_status.barrier_misfit,
            reasons: read_back_status.reasons | self.notes,
        }
    }
}

/// Link to the barrier of a plan; `None` without a barrier.
fn link(plan: &PathPlan, owner: u16) -> Result<Option<BarrierLink>, PlanError> {
    let Some(barrier) = plan.barrier else {
        return Ok(None);
    };
    let axes = names(&plan.description);
    let layout = Layout::of(axes.iter().copied()).map_err(|error| PlanError::Axes {
        device: plan.description.device.clone(),
        source: match error {
            LayoutError::Twice { axis } => UnfitAxes::Twice(axis),
            LayoutError::NoAxes => UnfitAxes::Count(axes.len()),
        },
    })?;
    let link = BarrierLink::new(owner, barrier.machine, layout, barrier.scan);
    Ok(Some(link))
}

/// Interlocks of a reading whose flags have this age; flags older than `hold` are unknown.
fn interlock_of(
    reading: &Snapshot,
    shown: ShownStates,
    age: Duration,
    hold: Duration,
) -> Interlock {
    let flags = Interlock {
        unreferenced: !reading.state.referenced,
        alarm: reading.state.alarm,
        emergency_stop: reading.state.emergency_stop,
    };
    let shown = Interlock {
        unreferenced: shown.referenced,
        alarm: shown.alarm,
        emergency_stop: shown.emergency_stop,
    };
    flags.at_age(age, hold, shown)
}

/// Returns an owner number for the next machine of this process ([`ControlPath::with_owner`]). It differs
/// at every call and between runs, so that a barrier can distinguish two machines of one process.
pub fn next_owner() -> u16 {
    use std::sync::atomic::{AtomicU16, Ordering};
    static NEXT: AtomicU16 = AtomicU16::new(1);
    let numbers = u32::from(u16::MAX);
    let moved = u32::from(owner() - 1) + u32::from(NEXT.fetch_add(1, Ordering::Relaxed));
    // The remainder is below 65535, so it fits, and the result is never 0.
    u16::try_from(moved % numbers).map_or(1, |number| number + 1)
}

/// Number that distinguishes this run of the program from others: random, drawn once, never 0.
fn owner() -> u16 {
    use std::sync::OnceLock;
    static OWNER: OnceLock<u16> = OnceLock::new();
    *OWNER.get_or_init(|| {
        let mut bytes = [0; 2];
        // If the system has no random bytes, the clock is used.
        let drawn = rustix::rand::getrandom(&mut bytes, rustix::rand::GetRandomFlags::empty());
        let by_clock = || u16::try_from(monotonic().subsec_micros() % 65_521).unwrap_or(1);
        drawn.map_or_else(|_| by_clock(), |_| u16::from_ne_bytes(bytes)).max(1)
    })
}

/// Time without an answer after which the interlocks of this controller are unknown.
const SILENT: Duration = Duration::from_millis(500);

/// Plan of a read-only controller: checked against the machine, not opened.
#[derive(Clone, Debug, PartialEq)]
pub struct ReaderPlan {
    /// The driver's description of the controller.
    pub description: Description,
    /// Machine index of each axis whose position the controller reports.
    pub machine_axis: PerChannel<usize>,
    /// Travel after which the direction of each reported axis counts as reversed, mm or rad.
    pub reversal: PerChannel<f64>,
}

impl ReaderPlan {
    /// Checks the description of a controller against the machine, and the position steps of the settings.
    ///
    /// # Errors
    /// The first conflict.
    pub fn new(
        description: Description,
        model: &Model,
        settings: &PathSettings,
    ) -> Result<Self, PlanError> {
        description
            .check()
            .map_err(|source| PlanError::Axes { device: description.device.clone(), source })?;
        let mut machine_axis = PerChannel::default();
        for (place, axis) in machine_axis.iter_mut().zip(description.shown_axes()) {
            *place = place_in(model, &description, axis)?;
        }
        let steps = position_steps(&description, settings)?;
        Ok(Self { machine_axis, reversal: reversals(&description, &steps, None), description })
    }
}

/// A read-only controller.
///
/// Invariants:
/// - Nothing is ever written to the controller.
/// - `interlock` is that of the last valid reading; `None` after a failed or missing one.
pub struct PositionReader {
    device: ControllerSlot,
    description: Description,
    pub(crate) reported: ReportedPositions,
    answered: Option<Duration>,
    /// Interlocks of the last reading; `None`: the controller did not answer.
    interlock: Option<Interlock>,
}

impl PositionReader {
    /// Creates a reader from an open controller and its plan.
    pub fn new(controller: Box<dyn Controller>, plan: &ReaderPlan) -> Self {
        Self {
            device: ControllerSlot::new(controller),
            description: plan.description.clone(),
            reported: ReportedPositions::without_positions(
                plan.machine_axis,
                plan.description.shown_axes().count(),
                plan.reversal,
            ),
            answered: None,
            interlock: None,
        }
    }

    pub(crate) fn description(&self) -> &Description {
        &self.description
    }

    /// Starts a thread that reads the controller once per `every`; `time_out` limits each exchange.
    pub(crate) fn start_thread(&mut self, every: Duration, time_out: Duration) -> io::Result<()> {
        self.device.start_thread(&self.description.device, every)?;
        self.device.hand_over(time_out);
        Ok(())
    }

    /// Processes the answers from the controller's thread; without a thread, reads the controller. `start` is the start of the cycle's
    /// clock, `hold` the maximum age of positions and flags. Returns the number of failed readings.
    pub(crate) fn read(
        &mut self,
        deadline: Instant,
        start: Instant,
        now: Duration,
        hold: Duration,
    ) -> u64 {
        let mut failures = 0;
        if let Some(controller) = self.device.held_controller() {
            let read = controller.read(deadline);
            failures += u64::from(!self.receive(&read, (start, now, hold)));
        }
        while let Some(reading) = self.device.next_reading() {
            let answered = reading.received.saturating_duration_since(start);
            failures += u64::from(!self.receive(&reading.read, (start, answered, hold)));
        }
        // The interlocks are unknown during a hanging exchange.
        let is_silent = |then: Duration| now.saturating_sub(then) > SILENT;
        if !self.device.is_held() && self.answered.is_none_or(is_silent) {
            self.interlock = None;
        }
        failures
    }

    fn receive(
        &mut self,
        read: &Result<Snapshot, Fault>,
        (start, now, hold): (Instant, Duration, Duration),
    ) -> bool {
        let held = |at: Instant| at.saturating_duration_since(start);
        let age = |at: Instant| now.saturating_sub(held(at));
        // A device that only repeats old data counts as not answering.
        let young = (*read).ok().filter(|read| age(read.youngest()) <= hold);
        let shown = self.description.shown;
        self.interlock = young.map(|read| interlock_of(&read, shown, age(read.state_taken), hold));
        let Some(snapshot) = young else {
            return false;
        };
        self.answered = Some(now);
        self.reported.store(&snapshot.positions, held(snapshot.taken));
        true
    }

    /// Interlocks of the last reading; `None`: the controller did not answer.
    pub(crate) fn interlock(&self) -> Option<Interlock> {
        self.interlock
    }

    pub(crate) fn report(&self, now: Duration) -> PathReport {
        PathReport {
            answered: self.answered.map(|then| now.saturating_sub(then)),
            positions: self.reported.taken.map(|then| now.saturating_sub(then)),
            ..PathReport::default()
        }
    }
}

/// Axes reported by a controller, in channel order, and their last positions.
///
/// Invariants:
/// - Once `taken` is set, all `positions` are finite and were valid at this time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReportedPositions {
    /// Machine index of each axis; the axes that the controller writes come first.
    pub(crate) machine_axis: PerChannel<usize>,
    count: usize,
    /// Travel after which the direction of each axis counts as reversed, mm or rad.
    pub(crate) reversal: PerChannel<f64>,
    /// Positions without correction, mm or rad, valid at `taken`.
    positions: PerChannel<f64>,
    pub(crate) taken: Option<Duration>,
}

impl ReportedPositions {
    fn without_positions(
        machine_axis: PerChannel<usize>,
        count: usize,
        reversal: PerChannel<f64>,
    ) -> Self {
        Self { machine_axis, count, reversal, positions: PerChannel::ZERO, taken: None }
    }

    /// Stores positions that were valid at `taken`; if one of them is NaN, none is stored.
    pub(crate) fn store(&mut self, positions: &PerChannel<f64>, taken: Duration) {
        if positions.iter().take(self.count).all(|q| q.is_finite()) {
            (self.positions, self.taken) = (*positions, Some(taken));
        }
    }

    /// Last position of a machine axis (mm or rad) and the time at which it was valid; `None` if none was reported.
    pub(crate) fn position_of(&self, machine_axis: usize) -> Option<(f64, Duration)> {
        Some((self.positions[self.place_of(machine_axis)?], self.taken?))
    }

    /// Travel after which the direction of a machine axis counts as reversed, mm or rad; `None` if the controller does not report the axis.
    pub(crate) fn reversal_of(&self, machine_axis: usize) -> Option<f64> {
        Some(self.reversal[self.place_of(machine_axis)?])
    }

    fn place_of(&self, machine_axis: usize) -> Option<usize> {
        (0..self.count).find(|&place| self.machine_axis[place] == machine_axis)
    }
}

#[derive(Default)]
pub(crate) struct MachinePosition {
    /// Positions without correction, mm and rad.
    pub(crate) positions: PerAxis<f64>,
    /// Time at which each position was valid; zero for a configured fixed position.
    pub(crate) taken: PerAxis<Duration>,
    /// Bit mask of the known positions: bit 0 is the first axis.
    pub(crate) known: u16,
    /// Time at which the oldest reported position was valid; `None`: none was reported.
    pub(crate) oldest: Option<Duration>,
    /// Time at which the oldest position from another controller was valid; `None`: the path itself reports all known ones.
    pub(crate) oldest_of_others: Option<Duration>,
}

impl MachinePosition {
    pub(crate) fn is_complete(&self, axes: usize) -> bool {
        self.known == u16::MAX >> (16 - axes.min(MAX_AXES))
    }
}
