//! The barrier, the control's half of the protection: a reference implementation against which the program of a control can be tested.
//!
//! By the rules of the [protocol](crate::protocol) the control decides which [`Frame`] it accepts, moves the applied
//! correction at its own rate, and ramps the correction to zero when no more frames arrive. It publishes the result in
//! a [`Report`]; a gateway considers a correction applied only when a report confirms it. Values are integer counts:
//! one count is the smallest step of the axis.

#[cfg(feature = "simulate")]
mod program;

use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::protocol::{
    Counts, HEAD_WORDS, Head, Layout, LayoutError, Link, Refusal, Session, is_whole, seal,
};
#[cfg(feature = "simulate")]
pub use program::{Program, Protection};

/// Largest machine number. The checksum is modulo 65535, so machine 65535 would be the same as machine 0.
pub const LARGEST_MACHINE: u16 = 65_534;

/// The settings of a barrier. They are part of the machine and are set by its builder, not by the
/// gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Settings {
    /// Corrected axes, in the order of the words.
    pub axes: Layout,
    /// Number that identifies this machine, at most [`LARGEST_MACHINE`]; it seeds the checksum.
    pub machine: u16,
    /// Largest correction of each axis in either direction, counts.
    pub limit: Counts,
    /// Largest movement of each axis per step, counts.
    pub rate: Counts,
    /// Scans per step, for axes whose rate is below one count per scan.
    pub step_scans: u16,
    /// Maximum age of the tick in a frame, scans.
    pub hold_scans: u16,
    /// Scans without an accepted frame after which the correction ramps to zero.
    pub time_out_scans: u16,
}

/// Why the settings of a barrier are invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingsError {
    /// The axes are invalid.
    #[error(transparent)]
    Layout(#[from] LayoutError),
    #[error("number of the machine: found {found}, expected 0 to {LARGEST_MACHINE}")]
    Machine { found: u16 },
    #[error("axis {axis} (counted from 0): found {found} counts, expected at least 1")]
    Counts {
        /// Index of the axis in the channel.
        axis: usize,
        found: i16,
    },
    #[error("scans from step to step: found 0, expected at least 1")]
    StepScans,
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

    /// These settings, with zero for unused axes.
    fn of_axes(self) -> Self {
        Self { limit: self.present(&self.limit), rate: self.present(&self.rate), ..self }
    }

    /// The values of the used axes; zero for unused axes.
    fn present(&self, values: &Counts) -> Counts {
        let count = self.axes.count();
        PerChannel::from_fn(|axis| if axis < count { values[axis] } else { 0 })
    }
}

/// Maximum number of words of a frame: head, one value per axis, checksum.
pub const FRAME_WORDS: usize = HEAD_WORDS + MAX_AXES + 2;

/// The frame of one cycle: the requested correction, and the head that shows that the frame is current.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Frame {
    /// Identifies the report that the frame answers, and the frame's sender.
    pub head: Head,
    /// Requested correction of each axis, counts.
    pub values: [i16; MAX_AXES],
}

impl Frame {
    /// Number of words of a frame with these settings.
    #[must_use]
    pub fn length(settings: &Settings) -> usize {
        HEAD_WORDS + settings.axes.count() + 2
    }

    /// Encodes the frame with its checksum and returns the number of words.
    pub fn encode(&self, settings: &Settings, words: &mut [u16; FRAME_WORDS]) -> usize {
        let length = Self::length(settings);
        words[..HEAD_WORDS].copy_from_slice(&self.head.words());
        for (word, value) in words[HEAD_WORDS..length - 2].iter_mut().zip(&self.values) {
            *word = value.cast_unsigned();
        }
        seal(settings.machine, settings.axes, &mut words[..length]);
        length
    }

    /// Decodes a frame; `None` for too few words or a wrong checksum.
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
        Some(Self { head: Head::of(*head), values })
    }

    /// Requested correction of each axis, counts.
    #[must_use]
    pub fn counts(&self) -> Counts {
        PerChannel::from_fn(|axis| self.values[axis])
    }
}

impl Session {
    /// The frame with these values that answers the last report; `None` without a report to answer.
    pub fn frame(&mut self, values: &Counts) -> Option<Frame> {
        let head = self.answer()?;
        let values = core::array::from_fn(|axis| values[axis]);
        Some(Frame { head, values })
    }
}

/// Maximum number of words of a report: head, three values per axis, checksum.
pub const REPORT_WORDS: usize = REPORT_HEAD + 3 * MAX_AXES + 2;

/// Number of words before the words of the axes: epoch, tick, owner, sequence, refusal, scans per step, hold, timeout.
const REPORT_HEAD: usize = 8;

/// The refusals of a barrier; the index is the code in the report.
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

/// The report that a barrier publishes after each scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Report {
    /// Incremented when the control starts or times out; retained over power-off.
    pub epoch: u16,
    /// Scan counter of the control; it wraps.
    pub tick: u16,
    /// The only sender whose frames are accepted; 0: any.
    pub owner: u16,
    /// Sequence of the last accepted frame.
    pub sequence: u16,
    /// Why the last frame or word on digital lines was rejected; [`Refusal::None`] if it was accepted.
    pub refusal: Refusal,
    /// Correction applied to each axis now, counts.
    pub applied: Counts,
    /// Limits, rates and times of the barrier. The machine number is not transmitted: it seeds the checksum.
    pub settings: Settings,
}

impl Report {
    /// Number of words of a report for these axes.
    #[must_use]
    pub fn length(axes: Layout) -> usize {
        REPORT_HEAD + 3 * axes.count() + 2
    }

    /// The head that a frame answers.
    #[must_use]
    pub fn head(&self) -> Head {
        Head { epoch: self.epoch, tick: self.tick, sequence: self.sequence, owner: self.owner }
    }

    /// Encodes the report with its checksum and returns the number of words.
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

    /// Decodes the report of a barrier for this machine and these axes; `None` for too few words, a wrong checksum or
    /// invalid settings.
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

/// The levels of digital lines in one scan. Words on lines have no sequence number, so that old or
/// foreign words cannot be detected; a barrier therefore restricts them more than frames: see
/// [`Barrier::scan_with`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct DigitalLines {
    /// Level of the latch line, which toggles once the levels of all other lines have settled.
    pub latch: bool,
    /// Index of the axis in channel order.
    pub axis: usize,
    /// Requested correction of that axis, counts.
    pub value: i16,
}

/// Maximum number of mailboxes of a barrier.
pub const MAILBOXES: usize = 4;

/// The barrier of one machine. It reads its mailboxes at each scan, and only the barrier moves the applied correction:
/// each axis by at most its rate, and all axes on one straight line towards the last accepted values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Barrier {
    settings: Settings,
    state: Memory,
}

/// The state of a barrier between scans, for simulators that pause and resume, and for model
/// checkers.
///
/// Invariants:
/// - `applied` is on the straight line from `from` to `goal`, after `done` of `steps` steps; all axes reach `goal`
///   together.
/// - `goal` is within the limits once a frame, or a word on digital lines, was accepted.
/// - `by_lines` is true only while no sender of frames owns the barrier.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Memory {
    /// The protocol state. A word on digital lines resets its `silent` counter like a frame.
    pub link: Link,
    /// Why the last frame or word on digital lines was rejected; [`Refusal::None`] if it was accepted.
    pub refusal: Refusal,
    /// Applied correction, counts.
    pub applied: Counts,
    /// Start of the present straight line, counts.
    pub from: Counts,
    /// End of the straight line, counts.
    pub goal: Counts,
    /// Number of steps from `from` to `goal`.
    pub steps: u32,
    /// Number of completed steps.
    pub done: u32,
    /// Scans since the last step.
    pub waited: u16,
    /// Tick and sequence of the last complete frame in each mailbox.
    pub found: [Option<(u16, u16)>; MAILBOXES],
    /// Level of the latch line; `None` before the first scan.
    pub latch: Option<bool>,
    /// Scans since the latch toggled, up to the maximum age of a frame.
    pub latched: u16,
    /// Whether the applied correction comes from digital lines: no frame was accepted since the first word on the
    /// lines.
    pub by_lines: bool,
}

impl Barrier {
    /// A barrier at its start, after power-up or a reset.
    ///
    /// `epoch` is the retained epoch. It is incremented here, so that no earlier frame can be accepted. `applied` is
    /// the present content of the words of the axes, counts. If no frame arrives, the axes ramp to zero from these
    /// values.
    ///
    /// # Errors
    ///
    /// Invalid settings.
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

    /// A barrier that continues from the memory of a barrier.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn resume(settings: Settings, state: Memory) -> Result<Self, SettingsError> {
        settings.check()?;
        let settings = settings.of_axes();
        Ok(Self { settings, state })
    }

    /// State of the barrier between scans.
    #[must_use]
    pub fn memory(&self) -> Memory {
        self.state
    }

    /// Runs one scan of the control. `mailboxes` are the words of each incoming path, at most [`MAILBOXES`], copied
    /// before this call, so that they cannot change during the check. All mailboxes are checked by the same rules. With
    /// `holds` (emergency stop, alarm or not referenced) the applied correction does not change.
    pub fn scan(&mut self, mailboxes: &[&[u16]], holds: bool) -> Report {
        self.scan_with(mailboxes, None, holds)
    }

    /// Runs one scan of a control that also has digital lines. A word on the lines is accepted only at an edge of the
    /// latch and while no sender of frames owns the control. The first word requires that no correction is applied; a
    /// later word may differ from the previous one by no more than the axis could move since the previous edge. A frame
    /// takes over at any time.
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
            // No frame arrives: ramp to zero.
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

    /// The report to publish after a scan.
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

    /// Checks a frame; `None` if the frame was checked before or is the last accepted frame.
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

    /// The goal that the word on the digital lines requests; `None` unless a word is accepted.
    fn latched(&mut self, lines: &DigitalLines) -> Option<Counts> {
        let before = self.state.latch.replace(lines.latch);
        self.state.latched = (self.state.latched + 1).min(self.settings.hold_scans);
        if before.is_none_or(|before| before == lines.latch) {
            return None;
        }
        let scans = core::mem::take(&mut self.state.latched);
        let state = &self.state;
        let goal = if state.by_lines { state.goal } else { Counts::default() };
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

    /// Starts a straight line to other values. A line to the same values continues: if every frame restarted the line,
    /// an axis with a small part of the movement would never move.
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

    /// Moves one step along the straight line. No axis moves by more than its rate, because the line has at least as
    /// many steps as each axis needs.
    fn step(&mut self) {
        if self.state.done >= self.state.steps {
            return;
        }
        self.state.done += 1;
        for axis in 0..self.settings.axes.count() {
            let from = i64::from(self.state.from[axis]);
            let way = i64::from(self.state.goal[axis]) - from;
            // The nearest count; the movement per step is then `way / steps`, rounded down or up.
            let (done, steps) = (i64::from(self.state.done), i64::from(self.state.steps));
            let at = from + way.signum() * ((way.abs() * done + steps / 2) / steps);
            // The result lies between two 16-bit numbers, so the conversion cannot fail.
            self.state.applied[axis] = i16::try_from(at).unwrap_or(self.state.applied[axis]);
        }
    }
}
