//! One controller with its guard, as a cycle sees it. State: the guard, and what the controller said last.

use std::time::{Duration, Instant};

use volcomp_guard::{Guard, Inputs, Limits, LimitsError, Output, Reading, Reasons, Request};
use volcomp_kinematics::Correctors;
use volcomp_port::{Controller, Fault, Snapshot};
use volcomp_vocabulary::{AxisName, PerAxis, PerChannel};

use crate::{
    asked::Asked,
    error::PlanError,
    model::Model,
    plan::{PathPlan, names},
};

/// A second gateway that was seen is reported for so long.
const OTHER_GATEWAY_FOR: Duration = Duration::from_secs(5);

/// One controller with its guard.
pub struct ControlPath {
    pub(crate) controller: Box<dyn Controller>,
    pub(crate) guard: Guard,
    /// The test shift of each axis while it corrects, mm and rad.
    test_shift: PerChannel<f64>,
    /// The place in the machine of each axis of the controller.
    pub(crate) machine_axis: PerChannel<usize>,
    /// The letters of its axes, and those of them that correct with the model of now.
    names: Vec<AxisName>,
    pub(crate) correctors: Correctors,
    /// Machine axes that stand at a stated position, mm and rad.
    pub(crate) fixed: PerAxis<Option<f64>>,
    /// Paths with the same number replace one another, others add.
    pub(crate) channel: u32,
    /// Reasons that the path reports in every cycle: that nothing watches it, that it does not see other gateways.
    notes: Reasons,
    reading: Option<Snapshot>,
    /// Positions without correction, as they held at `taken`.
    positions: PerChannel<f64>,
    taken: Option<Duration>,
    other_gateway: Option<Duration>,
}

impl ControlPath {
    /// A path before its first cycle: an open controller and its plan.
    ///
    /// # Errors
    /// Limits that a guard refuses: none for a plan that was not changed since it was made.
    pub fn new(controller: Box<dyn Controller>, plan: &PathPlan) -> Result<Self, PlanError> {
        let guard = Guard::new(plan.limits).map_err(|source| PlanError::Limits {
            device: plan.description.device.clone(),
            axis: None,
            source,
        })?;
        Ok(Self {
            controller,
            guard,
            test_shift: plan.limits.test_shift,
            machine_axis: plan.machine_axis,
            names: names(&plan.description),
            correctors: plan.correctors.clone(),
            fixed: plan.fixed,
            channel: 0,
            notes: plan.notes,
            reading: None,
            positions: PerChannel::ZERO,
            taken: None,
            other_gateway: None,
        })
    }

    /// Chooses the axes that correct anew, for another model. Allocates nothing.
    pub(crate) fn fit_to(&mut self, model: &Model) {
        self.correctors = model.correctors_among(&self.names);
        let limits = *self.guard.limits();
        // Only test shifts become zero or are again what was accepted before, so a guard does not refuse them.
        let _ = self.guard.set_limits(self.of_correctors(&limits));
    }

    /// Takes other limits. Allocates nothing.
    pub(crate) fn set_limits(&mut self, limits: &Limits) -> Result<(), LimitsError> {
        limits.check()?;
        let before = std::mem::replace(&mut self.test_shift, limits.test_shift);
        let taken = self.guard.set_limits(self.of_correctors(limits));
        if taken.is_err() {
            self.test_shift = before;
        }
        taken
    }

    /// Limits with the test shift of the axes that correct only: nothing is written to the others.
    fn of_correctors(&self, limits: &Limits) -> Limits {
        let shift = |place: usize| {
            if self.corrects(place) {
                self.test_shift[place]
            } else {
                0.0
            }
        };
        Limits {
            test_shift: PerChannel::from_fn(shift),
            ..*limits
        }
    }

    /// Whether the axis at this place of the controller corrects.
    pub(crate) fn corrects(&self, place: usize) -> bool {
        place < self.count() && self.correctors.contains(self.machine_axis[place])
    }

    /// How many axes it has.
    pub(crate) fn count(&self) -> usize {
        self.guard.limits().count
    }

    /// Its place of a machine axis.
    pub(crate) fn place_of(&self, machine_axis: usize) -> Option<usize> {
        (0..self.count()).find(|&i| self.machine_axis[i] == machine_axis)
    }

    /// Where it last saw a machine axis, and when.
    pub(crate) fn position_of(&self, machine_axis: usize) -> Option<(f64, Duration)> {
        let place = self.place_of(machine_axis)?;
        Some((self.positions[place], self.taken?))
    }

    /// Its correction of a machine axis.
    pub(crate) fn output_of(&self, machine_axis: usize) -> f64 {
        let place = self.place_of(machine_axis);
        place.map_or(0.0, |place| self.guard.output()[place])
    }

    /// Whether its positions are young enough to correct with.
    pub(crate) fn is_fresh(&self, now: Duration) -> bool {
        self.is_young(self.taken, now)
    }

    /// Whether positions that held at `taken` are young enough for this path to correct with.
    pub(crate) fn is_young(&self, taken: Option<Duration>, now: Duration) -> bool {
        taken.is_some_and(|taken| now.saturating_sub(taken) <= self.guard.limits().hold)
    }

    /// It answered in this cycle, and neither reference, alarm nor emergency stop stand against correcting.
    pub(crate) fn is_free(&self) -> bool {
        let free = |reading: &Snapshot| {
            let state = reading.state;
            state.referenced && !state.alarm && !state.emergency_stop
        };
        self.reading.as_ref().is_some_and(free)
    }

    /// Whether it was asked in this cycle what it has applied, and said so.
    pub(crate) fn held_is_known(&self) -> bool {
        self.reading
            .is_some_and(|reading| reading.applied.is_some())
    }

    /// Asks the controller. `start` is when the cycle's clock began. Whether it answered.
    pub(crate) fn read(&mut self, deadline: Instant, start: Instant, now: Duration) -> bool {
        let read = self.controller.read(deadline);
        if read == Err(Fault::OtherGateway) {
            self.other_gateway = Some(now);
        }
        self.reading = read.ok();
        let Some(snapshot) = self.reading else {
            return false;
        };
        let applied = snapshot.applied.unwrap_or_else(|| self.guard.output());
        let limits = self.guard.limits();
        let reported = snapshot.positions.iter().zip(&applied);
        for ((position, (reported, applied)), limits) in
            self.positions.iter_mut().zip(reported).zip(&limits.axes)
        {
            let contained = if limits.includes_correction {
                *applied
            } else {
                0.0
            };
            *position = reported - contained;
        }
        let used = self.positions.iter().take(limits.count);
        if used.into_iter().all(|position| position.is_finite()) {
            self.taken = Some(snapshot.taken.saturating_duration_since(start));
        }
        true
    }

    /// The decision of the guard in this cycle. `oldest` is the time of the oldest positions on which `target` (mm,
    /// rad) depends.
    pub(crate) fn guarded(
        &mut self,
        now: Duration,
        oldest: Option<Duration>,
        target: Option<PerChannel<f64>>,
        request: Option<Request>,
        asked: &Asked,
    ) -> Output {
        let reading = self.reading.map(|snapshot| Reading {
            taken: oldest.or(self.taken).unwrap_or_default(),
            positions: snapshot.positions,
            applied: snapshot.applied,
            referenced: snapshot.state.referenced,
            alarm: snapshot.state.alarm,
            emergency_stop: snapshot.state.emergency_stop,
        });
        let seen_lately = |seen| now.saturating_sub(seen) < OTHER_GATEWAY_FOR;
        let other = Reasons::OTHER_GATEWAY.when(self.other_gateway.is_some_and(seen_lately));
        let mut output = self.guard.cycle(&Inputs {
            now,
            reading,
            target,
            request,
            forbids: asked.forbids | other,
        });
        output.reasons |= other | self.notes;
        output
    }
}
