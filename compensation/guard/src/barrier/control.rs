//! The barrier itself: which frame is taken, and how the applied correction moves.

use super::{DigitalLines, Frame, Report, Settings, SettingsError};
use crate::protocol::{Counts, Link, Refusal};

/// The largest number of mailboxes that a barrier looks at.
pub const MAILBOXES: usize = 4;

/// The barrier of one machine. It is given what lies in its mailboxes at each scan, and it alone moves the correction
/// that is applied: never by more than its rate, every axis on one line towards the last values that it took.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Barrier {
    settings: Settings,
    state: Memory,
}

/// All that a barrier remembers from one scan to the next, for simulators that stop and go on, and for model checkers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Memory {
    /// Whose frames are taken. A word on lines counts as a frame where it says since when none came.
    pub link: Link,
    /// Why the last frame was not taken.
    pub refusal: Refusal,
    /// The correction that is applied, counts.
    pub applied: Counts,
    /// Where the line began that the axes are on, counts.
    pub from: Counts,
    /// Where the line ends, counts.
    pub goal: Counts,
    /// The number of steps of the line.
    pub steps: u32,
    /// The number of steps of the line that are done.
    pub done: u32,
    /// The number of scans since the last step.
    pub waited: u16,
    /// Tick and sequence of the whole frame that was found last in each mailbox.
    pub found: [Option<(u16, u16)>; MAILBOXES],
    /// The level of the line that says that the others have settled; `None` before the first scan.
    pub latch: Option<bool>,
    /// The number of scans since that level changed, up to the largest age of a frame.
    pub latched: u16,
    /// The words on lines are what is applied: no frame was taken since the first of them.
    pub by_lines: bool,
}

impl Barrier {
    /// A barrier at its start, after power-up or a reset.
    ///
    /// `epoch` is the one that was kept over power-off: it moves on here, so that no frame made before can be taken.
    /// `applied` is what the words of the axes hold at this moment, counts: the axes stand there, and go to zero from
    /// there when nobody sends.
    ///
    /// # Errors
    /// Settings that make no sense.
    pub fn start(
        settings: Settings,
        epoch: u16,
        tick: u16,
        applied: &Counts,
    ) -> Result<Self, SettingsError> {
        settings.check()?;
        let settings = settings.of_axes();
        let applied = settings.present(applied);
        let state = Memory {
            link: Link::start(epoch, tick),
            applied,
            from: applied,
            goal: applied,
            ..Memory::default()
        };
        Ok(Self { settings, state })
    }

    /// A barrier that goes on from what another one remembered.
    ///
    /// # Errors
    /// Settings that make no sense.
    pub fn resume(settings: Settings, state: Memory) -> Result<Self, SettingsError> {
        settings.check()?;
        let settings = settings.of_axes();
        Ok(Self { settings, state })
    }

    /// All that the barrier remembers.
    #[must_use]
    pub fn memory(&self) -> Memory {
        self.state
    }

    /// One scan of the control. `mailboxes` are the words of each way that leads here, at most [`MAILBOXES`], copied
    /// before this call, so that nothing changes while they are judged; all are judged alike. `holds`: emergency stop,
    /// alarm or not referenced; the axes then stay where they are.
    pub fn scan(&mut self, mailboxes: &[&[u16]], holds: bool) -> Report {
        self.scan_with(mailboxes, None, holds)
    }

    /// One scan of a control to which plain lines lead besides. A word on them is taken only at an edge of their last
    /// line, only while no sender of frames holds the control, beginning with nothing applied, and only where it
    /// changes by no more than the axis could follow since the edge before. A frame takes over at any time.
    pub fn scan_with(
        &mut self,
        mailboxes: &[&[u16]],
        lines: Option<&DigitalLines>,
        holds: bool,
    ) -> Report {
        self.state.link.scan();
        let mut goal = None;
        for (mailbox, words) in mailboxes.iter().take(MAILBOXES).enumerate() {
            match self.judge(mailbox, words) {
                Ok(Some(frame)) => {
                    self.state.link.take(frame.head);
                    self.state.refusal = Refusal::None;
                    self.state.by_lines = false;
                    goal = Some(self.settings.present(&frame.counts()));
                }
                Ok(None) => {}
                Err(refusal) => self.state.refusal = refusal,
            }
        }
        if let Some(lines) = lines {
            goal = self.latched(lines).or(goal);
        }
        if goal.is_some() {
            self.state.link.silent = 0;
        } else if self.state.link.is_timed_out(self.settings.time_out_scans) {
            // Nobody sends: to zero.
            self.state.by_lines = false;
            goal = Some(Counts::default());
        }
        if let Some(goal) = goal {
            self.aim(&goal);
        }
        if !holds {
            self.state.waited = self.state.waited.saturating_add(1);
            if self.state.waited >= self.settings.step_scans {
                self.state.waited = 0;
                self.step();
            }
        }
        self.report()
    }

    /// What is published after a scan.
    #[must_use]
    pub fn report(&self) -> Report {
        Report {
            epoch: self.state.link.epoch,
            tick: self.state.link.tick,
            owner: self.state.link.owner,
            sequence: self.state.link.sequence,
            refusal: self.state.refusal,
            applied: self.state.applied,
            settings: self.settings,
        }
    }

    /// The frame if it is to be taken, nothing if it was judged before or is the one that was taken last.
    fn judge(&mut self, mailbox: usize, words: &[u16]) -> Result<Option<Frame>, Refusal> {
        let frame = Frame::decode(&self.settings, words).ok_or(Refusal::Checksum)?;
        let found = &mut self.state.found[mailbox];
        if !(self.state.link).judge(frame.head, found, self.settings.hold_scans)? {
            return Ok(None);
        }
        let within = |axis: usize| frame.values[axis].unsigned_abs() <= self.limit(axis);
        if !(0..self.settings.axes.count()).all(within) {
            return Err(Refusal::Value);
        }
        Ok(Some(frame))
    }

    /// The goal that a word on lines makes, where it is to be taken.
    fn latched(&mut self, lines: &DigitalLines) -> Option<Counts> {
        let before = self.state.latch.replace(lines.latch);
        self.state.latched = (self.state.latched + 1).min(self.settings.hold_scans);
        if before.is_none_or(|before| before == lines.latch) {
            return None;
        }
        let scans = core::mem::take(&mut self.state.latched);
        let state = &self.state;
        let goal = if state.by_lines {
            state.goal
        } else {
            Counts::default()
        };
        let axis = lines.axis;
        let is_free = state.link.owner == 0 && (state.by_lines || state.applied == goal);
        if !is_free
            || axis >= self.settings.axes.count()
            || lines.value.unsigned_abs() > self.limit(axis)
        {
            self.state.refusal = Refusal::Lines;
            return None;
        }
        let most = i32::from(self.settings.rate[axis])
            * (1 + i32::from(scans) / i32::from(self.settings.step_scans));
        let change = i32::from(lines.value) - i32::from(state.applied[axis]);
        if change.abs() > most {
            self.state.refusal = Refusal::Lines;
            return None;
        }
        self.state.refusal = Refusal::None;
        self.state.by_lines = true;
        let mut goal = goal;
        goal[axis] = lines.value;
        Some(goal)
    }

    fn limit(&self, axis: usize) -> u16 {
        self.settings.limit[axis].unsigned_abs()
    }

    /// Begins a line to other values. A line to the same values goes on: begun anew at each frame, an axis with a small
    /// share of the way would never move.
    fn aim(&mut self, goal: &Counts) {
        if *goal == self.state.goal {
            return;
        }
        self.state.from = self.state.applied;
        self.state.goal = *goal;
        self.state.done = 0;
        self.state.steps = (0..self.settings.axes.count())
            .map(|axis| {
                let way = i32::from(goal[axis]) - i32::from(self.state.applied[axis]);
                let rate = u32::from(self.settings.rate[axis].unsigned_abs());
                way.unsigned_abs().div_ceil(rate.max(1))
            })
            .fold(0, u32::max);
    }

    /// One step on the line: no axis moves by more than its rate, since it has at least as many steps as it needs.
    fn step(&mut self) {
        if self.state.done >= self.state.steps {
            return;
        }
        self.state.done += 1;
        for axis in 0..self.settings.axes.count() {
            let from = i64::from(self.state.from[axis]);
            let way = i64::from(self.state.goal[axis]) - from;
            // The count nearest to the line; the way from step to step is still a whole part of the way, or one more.
            let (done, steps) = (i64::from(self.state.done), i64::from(self.state.steps));
            let at = from + way.signum() * ((way.abs() * done + steps / 2) / steps);
            // Between two numbers of 16 bits, so it is one.
            self.state.applied[axis] = i16::try_from(at).unwrap_or(self.state.applied[axis]);
        }
    }
}
