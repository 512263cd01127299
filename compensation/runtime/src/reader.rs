//! A controller that only reports positions and is never written. State: its last answer.

use std::{
    io,
    time::{Duration, Instant},
};

use volcomp_guard::Interlock;
use volcomp_port::{Controller, Description, Fault, Snapshot};
use volcomp_vocabulary::PerChannel;

use crate::{
    error::PlanError,
    model::Model,
    path::interlock_of,
    plan::{place_in, position_steps, reversals},
    positions::ReportedPositions,
    report::PathReport,
    settings::PathSettings,
    standby::ControllerSlot,
};

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
