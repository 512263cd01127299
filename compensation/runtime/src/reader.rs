//! A controller that only reports positions, and is never written to. State: its last answer.

use std::{
    io,
    time::{Duration, Instant},
};

use volcomp_guard::Interlock;
use volcomp_port::{Controller, Description, Fault, Snapshot};
use volcomp_vocabulary::PerChannel;

use crate::{
    attendant::Device,
    error::PlanError,
    model::Model,
    path::interlock_of,
    place::Seen,
    plan::{place_in, position_steps, reversals},
    report::PathReport,
    settings::PathSettings,
};

/// The time without an answer after which the state of the machine by this controller is unknown.
const SILENT: Duration = Duration::from_millis(500);

/// A controller of a plan that is only read: checked against the machine, not opened.
#[derive(Clone, Debug, PartialEq)]
pub struct ReaderPlan {
    /// The description of the controller by its driver.
    pub description: Description,
    /// The place in the machine of each axis whose position it reports.
    pub machine_axis: PerChannel<usize>,
    /// Travel after which a direction counts as turned, of each of these axes, mm or rad.
    pub reversal: PerChannel<f64>,
}

impl ReaderPlan {
    /// Checks the description of a controller against machine and settings. Of the settings only the steps of positions
    /// count.
    ///
    /// # Errors
    /// What does not fit.
    pub fn new(
        description: Description,
        model: &Model,
        settings: &PathSettings,
    ) -> Result<Self, PlanError> {
        description.check().map_err(|source| PlanError::Axes {
            device: description.device.clone(),
            source,
        })?;
        let mut machine_axis = PerChannel::default();
        for (place, axis) in machine_axis.iter_mut().zip(description.shown_axes()) {
            *place = place_in(model, &description, axis)?;
        }
        let steps = position_steps(&description, settings)?;
        Ok(Self {
            machine_axis,
            reversal: reversals(&description, &steps, None),
            description,
        })
    }
}

/// A controller that is only read.
pub struct PositionReader {
    device: Device,
    description: Description,
    pub(crate) seen: Seen,
    answered: Option<Duration>,
    /// What it said of the machine in the last reading; `None`: it did not answer.
    said: Option<Interlock>,
}

impl PositionReader {
    /// A reader before its first cycle: an open controller and its plan.
    pub fn new(controller: Box<dyn Controller>, plan: &ReaderPlan) -> Self {
        Self {
            device: Device::new(controller),
            description: plan.description.clone(),
            seen: Seen::none_of(
                plan.machine_axis,
                plan.description.shown_axes().count(),
                plan.reversal,
            ),
            answered: None,
            said: None,
        }
    }

    pub(crate) fn description(&self) -> &Description {
        &self.description
    }

    /// Starts a thread that asks the controller from now on, as often as `every`, each exchange taking `patience` at the
    /// most.
    pub(crate) fn attend(&mut self, every: Duration, patience: Duration) -> io::Result<()> {
        self.device.attend(&self.description.device, every)?;
        self.device.hand_over(patience);
        Ok(())
    }

    /// Takes what the controller has answered to its thread; without one, asks it here. `start` is when the cycle's clock
    /// began; positions and flags may be as old as `hold`. How often it did not answer.
    pub(crate) fn read(
        &mut self,
        deadline: Instant,
        start: Instant,
        now: Duration,
        hold: Duration,
    ) -> u64 {
        let mut failures = 0;
        if let Some(controller) = self.device.in_hand() {
            let read = controller.read(deadline);
            failures += u64::from(!self.hear(&read, (start, now, hold)));
        }
        while let Some(heard) = self.device.heard() {
            let answered = heard.answered.saturating_duration_since(start);
            failures += u64::from(!self.hear(&heard.read, (start, answered, hold)));
        }
        // During an exchange that hangs the state of the machine is unknown.
        let is_silent = |then: Duration| now.saturating_sub(then) > SILENT;
        if !self.device.is_in_hand() && self.answered.is_none_or(is_silent) {
            self.said = None;
        }
        failures
    }

    fn hear(
        &mut self,
        read: &Result<Snapshot, Fault>,
        (start, now, hold): (Instant, Duration, Duration),
    ) -> bool {
        let held = |at: Instant| at.saturating_duration_since(start);
        let age = |at: Instant| now.saturating_sub(held(at));
        // A device that only repeats what it said longer ago than that has not answered.
        let young = (*read).ok().filter(|read| age(read.youngest()) <= hold);
        let shown = self.description.shown;
        self.said = young.map(|read| interlock_of(&read, shown, age(read.state_taken), hold));
        let Some(snapshot) = young else {
            return false;
        };
        self.answered = Some(now);
        self.seen.take(&snapshot.positions, held(snapshot.taken));
        true
    }

    /// What it said of the machine in the last reading; `None`: it did not answer.
    pub(crate) fn interlock(&self) -> Option<Interlock> {
        self.said
    }

    /// Its state, for the report.
    pub(crate) fn report(&self, now: Duration) -> PathReport {
        PathReport {
            answered: self.answered.map(|then| now.saturating_sub(then)),
            positions: self.seen.taken.map(|then| now.saturating_sub(then)),
            ..PathReport::default()
        }
    }
}
