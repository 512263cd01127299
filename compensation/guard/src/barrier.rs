//! The barrier: the control's half of the protection, as a reference that a control's program can be held against.
//!
//! By the rules of the [protocol](crate::protocol) the control decides for itself which [`Frame`] it takes, moves what it
//! applies at its own rate, and goes to zero when no frame comes any more. What it does is published in a [`Report`];
//! a gateway believes a correction only when a report says that it is applied. Values are whole counts: one count is the
//! smallest step of the axis.

#[cfg(feature = "simulate")]
mod program;

use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::protocol::{
    Counts, HEAD_WORDS, Head, Layout, LayoutError, Link, Refusal, Session, is_whole, seal,
};
#[cfg(feature = "simulate")]
pub use program::{Program, Protection};

/// The largest number of a machine. The checksum counts modulo 65535, so a machine 65535 would be the machine 0.
pub const LARGEST_MACHINE: u16 = 65_534;

/// The settings of a barrier: they belong to the machine and are made by its builder, not by the gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Settings {
    /// The axes that are corrected, in the order of the words.
    pub axes: Layout,
    /// A number that distinguishes this machine from others, at most [`LARGEST_MACHINE`]; it starts the checksum.
    pub machine: u16,
    /// The largest correction of each axis in either direction, counts.
    pub limit: Counts,
    /// The largest movement of each axis in one step, counts.
    pub rate: Counts,
    /// The number of scans from one step to the next, for axes whose rate is below one count in a scan.
    pub step_scans: u16,
    /// The largest age of the tick that a frame carries, scans.
    pub hold_scans: u16,
    /// The number of scans without an accepted frame after which the correction goes to zero.
    pub time_out_scans: u16,
}

/// An invalid setting.
#[expect(missing_docs, reason = "the messages say what the fields are")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingsError {
    /// The axes.
    #[error(transparent)]
    Layout(#[from] LayoutError),
    /// The number of the machine is beyond the largest.
    #[error("number of the machine: found {found}, expected 0 to {LARGEST_MACHINE}")]
    Machine { found: u16 },
    /// The limit or the rate of one axis.
    #[error("axis {axis} (counted from 0): found {found} counts, expected at least 1")]
    Counts {
        /// The place of the axis in the channel, from 0.
        axis: usize,
        found: i16,
    },
    /// The number of scans between two steps.
    #[error("scans from step to step: found 0, expected at least 1")]
    StepScans,
    /// The age of a frame against the time-out.
    #[error(
        "time-out: found {time_out} scans, expected at least twice the age of a frame, which is {hold} scans, and less than 32768"
    )]
    TimeOut { hold: u16, time_out: u16 },
}

impl Settings {
    /// Checks every setting.
    ///
    /// # Errors
    /// The first invalid setting.
    pub fn check(&self) -> Result<(), SettingsError> {
        if self.machine > LARGEST_MACHINE {
            let found = self.machine;
            return Err(SettingsError::Machine { found });
        }
        for axis in 0..self.axes.count() {
            for found in [self.limit[axis], self.rate[axis]] {
                if found < 1 {
                    return Err(SettingsError::Counts { axis, found });
                }
            }
        }
        if self.step_scans == 0 {
            return Err(SettingsError::StepScans);
        }
        let (hold, time_out) = (self.hold_scans, self.time_out_scans);
        if hold == 0 || u32::from(time_out) < 2 * u32::from(hold) || time_out >= 1 << 15 {
            return Err(SettingsError::TimeOut { hold, time_out });
        }
        Ok(())
    }

    /// The same settings with zero for axes that there are not.
    fn of_axes(self) -> Self {
        Self {
            limit: self.present(&self.limit),
            rate: self.present(&self.rate),
            ..self
        }
    }

    /// The values of the axes that there are; the others are zero.
    fn present(&self, values: &Counts) -> Counts {
        let count = self.axes.count();
        PerChannel::from_fn(|axis| if axis < count { values[axis] } else { 0 })
    }
}

/// The largest number of words of a frame: head, one value for each axis, checksum.
pub const FRAME_WORDS: usize = HEAD_WORDS + MAX_AXES + 2;

/// The frame of one cycle: the wanted correction and what shows that it is meant for now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Frame {
    /// What shows that it is meant for now.
    pub head: Head,
    /// The wanted correction of each axis, counts.
    pub values: [i16; MAX_AXES],
}

impl Frame {
    /// The number of words that frames of these settings have.
    #[must_use]
    pub fn length(settings: &Settings) -> usize {
        HEAD_WORDS + settings.axes.count() + 2
    }

    /// Writes the words of the frame, checksum included, and returns their number.
    pub fn encode(&self, settings: &Settings, words: &mut [u16; FRAME_WORDS]) -> usize {
        let length = Self::length(settings);
        words[..HEAD_WORDS].copy_from_slice(&self.head.words());
        for (word, value) in words[HEAD_WORDS..length - 2].iter_mut().zip(&self.values) {
            *word = value.cast_unsigned();
        }
        seal(settings.machine, settings.axes, &mut words[..length]);
        length
    }

    /// Reads a frame; `None` when there are too few words or the checksum does not fit.
    #[must_use]
    pub fn decode(settings: &Settings, words: &[u16]) -> Option<Self> {
        let length = Self::length(settings);
        let words = words.get(..length)?;
        if !is_whole(settings.machine, settings.axes, words) {
            return None;
        }
        let (head, words) = words.split_first_chunk()?;
        let mut values = [0; MAX_AXES];
        for (value, word) in values.iter_mut().zip(&words[..length - HEAD_WORDS - 2]) {
            *value = word.cast_signed();
        }
        Some(Self {
            head: Head::of(*head),
            values,
        })
    }

    /// The wanted correction of each axis, counts.
    #[must_use]
    pub fn counts(&self) -> Counts {
        PerChannel::from_fn(|axis| self.values[axis])
    }
}

impl Session {
    /// The frame of these values that answers the last report; `None` when there is no report to answer.
    pub fn frame(&mut self, values: &Counts) -> Option<Frame> {
        let head = self.answer()?;
        let values = core::array::from_fn(|axis| values[axis]);
        Some(Frame { head, values })
    }
}

/// The largest number of words of a report: head, three values for each axis, checksum.
pub const REPORT_WORDS: usize = REPORT_HEAD + 3 * MAX_AXES + 2;

/// Epoch, tick, owner, sequence, refusal, scans from step to step, hold, time-out.
const REPORT_HEAD: usize = 8;

/// The refusals of a barrier, by their numbers in its words.
const REFUSALS: [Refusal; 8] = [
    Refusal::None,
    Refusal::Checksum,
    Refusal::Epoch,
    Refusal::Tick,
    Refusal::Owner,
    Refusal::Sequence,
    Refusal::Value,
    Refusal::Lines,
];

/// What a barrier publishes after each scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Report {
    /// Moves on when the control starts or the time-out ends the correction; kept over power-off.
    pub epoch: u16,
    /// The number of scans of the control.
    pub tick: u16,
    /// The sender whose frames are taken; 0: any.
    pub owner: u16,
    /// The sequence of the last frame that was taken.
    pub sequence: u16,
    /// Why the last frame was not taken.
    pub refusal: Refusal,
    /// The correction that is applied to each axis now, counts.
    pub applied: Counts,
    /// The limits, rates and times of the barrier. The machine's number is not in the words: it starts the checksum.
    pub settings: Settings,
}

impl Report {
    /// The number of words of a report of these axes.
    #[must_use]
    pub fn length(axes: Layout) -> usize {
        REPORT_HEAD + 3 * axes.count() + 2
    }

    /// The numbers that a frame answers.
    #[must_use]
    pub fn head(&self) -> Head {
        Head {
            epoch: self.epoch,
            tick: self.tick,
            sequence: self.sequence,
            owner: self.owner,
        }
    }

    /// Writes the words of the report, checksum included, and returns their number.
    pub fn encode(&self, words: &mut [u16; REPORT_WORDS]) -> usize {
        let s = &self.settings;
        let length = Self::length(s.axes);
        words[..REPORT_HEAD].copy_from_slice(&[
            self.epoch,
            self.tick,
            self.owner,
            self.sequence,
            self.refusal.number_in(&REFUSALS),
            s.step_scans,
            s.hold_scans,
            s.time_out_scans,
        ]);
        for axis in 0..s.axes.count() {
            let three = [self.applied[axis], s.limit[axis], s.rate[axis]];
            words[REPORT_HEAD + 3 * axis..][..3].copy_from_slice(&three.map(i16::cast_unsigned));
        }
        seal(s.machine, s.axes, &mut words[..length]);
        length
    }

    /// Reads the report of a barrier for this machine and these axes; `None` when there are too few words, the checksum
    /// does not fit, or the barrier's settings make no sense.
    #[must_use]
    pub fn decode(machine: u16, axes: Layout, words: &[u16]) -> Option<Self> {
        let words = words.get(..Self::length(axes))?;
        if !is_whole(machine, axes, words) {
            return None;
        }
        let mut settings = Settings {
            axes,
            machine,
            limit: Counts::default(),
            rate: Counts::default(),
            step_scans: words[5],
            hold_scans: words[6],
            time_out_scans: words[7],
        };
        let mut applied = Counts::default();
        for axis in 0..axes.count() {
            let at = REPORT_HEAD + 3 * axis;
            applied[axis] = words[at].cast_signed();
            settings.limit[axis] = words[at + 1].cast_signed();
            settings.rate[axis] = words[at + 2].cast_signed();
        }
        settings.check().ok()?;
        Some(Self {
            epoch: words[0],
            tick: words[1],
            owner: words[2],
            sequence: words[3],
            refusal: Refusal::numbered(&REFUSALS, words[4])?,
            applied,
            settings,
        })
    }
}

/// The levels of plain lines in one scan. They carry no number that distinguishes an old or foreign word from one that is meant
/// now, so a barrier trusts them less than frames: see [`Barrier::scan_with`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct DigitalLines {
    /// The level of the line that is turned once the others have settled.
    pub latch: bool,
    /// The place of the axis that the word is for, in channel order.
    pub axis: usize,
    /// The word: the wanted correction of that axis, counts.
    pub value: i16,
}

/// The maximum number of mailboxes of a barrier.
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
    /// The level of the line that shows that the others have settled; `None` before the first scan.
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
    /// `applied` is what the words of the axes hold at this moment, counts: the axes are there, and go to zero from
    /// there when no frame comes.
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
            // No frame comes: to zero.
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
