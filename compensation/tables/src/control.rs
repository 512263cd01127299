//! The control's side of the map mode: a reference implementation for testing control programs.
//!
//! By the rules of the [`protocol`](volcomp_guard::protocol) only the control decides which frames it accepts. A map
//! arrives in pieces through one mailbox, in order, into the inactive buffer. A final frame swaps the buffers if the
//! checksum of all received words is correct. The applied corrections move at a limited rate: to those of another map,
//! and to zero when frames stop.
//!
//! All data are 16-bit words and whole numbers. [`Lookup::scan`] does not allocate, wait or read a clock; time is the number of scans.

use volcomp_guard::{
    barrier,
    protocol::{Counts, HEAD_WORDS, Head, Layout, Link, Refusal, checksum, is_whole, seal},
};
use volcomp_vocabulary::Direction;

use crate::map::{
    GRID_AXES, HEADER_WORDS, Header, MAX_POSITION_STEPS, MAX_WORDS, OUTPUTS, Position, look_up,
};

// These numbers are used in the messages below.
const _: () = assert!(HEADER_WORDS == 68 && MAX_WORDS == 32767);

/// Settings of a control. Positions and corrections are whole steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Input axes of the maps, in the order of [`Position`].
    pub grid: Layout,
    /// Corrected axes, machine number and limits, as for a barrier. Each limit is 1 to 32767.
    pub outputs: barrier::Settings,
    /// Position step of each axis of the grid, millionths of a mm (nm) or of a deg.
    pub position_step_millionths: [u32; GRID_AXES],
    /// Step of each output, nm.
    pub output_step_nm: [u32; OUTPUTS],
    /// Size of each of the two buffers, words: 69 to 32767.
    pub capacity: u16,
    /// Travel in the opposite direction after which an axis of the grid counts as reversed,
    /// position steps: 1 to 1000000.
    pub turned: [i32; GRID_AXES],
}

/// Maximum step of positions (millionths) and of corrections (nm), within the range of a DINT.
const MAX_STEP: i64 = 2_000_000_000;

/// Reasons why settings are invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingsError {
    /// A setting shared with a barrier is invalid.
    #[error(transparent)]
    Outputs(#[from] barrier::SettingsError),
    /// A number is out of range.
    #[error("{what} is {found}, expected {expected}")]
    Number { what: &'static str, found: i64, expected: &'static str },
}

impl Settings {
    /// Checks the settings.
    ///
    /// # Errors
    /// The first invalid setting.
    pub fn check(&self) -> Result<(), SettingsError> {
        self.outputs.check()?;
        let (axes, outputs) = (self.grid.count(), self.outputs.axes.count());
        within("number of axes of the grid", axes, 1..=5, "1 to 5")?;
        within("number of corrected axes", outputs, 1..=3, "1 to 3")?;
        within("capacity of a buffer", self.capacity, 69..=32767, "69 to 32767 words")?;
        within("scans from step to step", self.outputs.step_scans, 1..=32767, "1 to 32767")?;
        for output in 0..outputs.min(OUTPUTS) {
            let step = self.output_step_nm[output];
            within("step of an output", step, 1..=MAX_STEP, "1 to 2000000000 nm")?;
        }
        for axis in 0..axes.min(GRID_AXES) {
            let turned = self.turned[axis];
            within("travel that turns an axis", turned, 1..=1_000_000, "1 to 1000000 steps")?;
            let step = self.position_step_millionths[axis];
            within("step of a position", step, 1..=MAX_STEP, "1 to 2000000000 millionths")?;
        }
        Ok(())
    }

    /// Maximum number of scans from the last accepted frame until every output is at zero; scans in which the control holds are not counted.
    #[must_use]
    pub fn zero_within_scans(&self) -> u32 {
        let of = &self.outputs;
        let ways = (0..of.axes.count()).map(|output| {
            let [limit, rate] = [of.limit, of.rate].map(|of| u32::from(of[output].unsigned_abs()));
            limit.div_ceil(rate.max(1))
        });
        let steps = ways.max().unwrap_or(0);
        u32::from(of.time_out_scans) + steps * u32::from(of.step_scans)
    }
}

fn within(
    what: &'static str,
    found: impl TryInto<i64>,
    range: core::ops::RangeInclusive<i64>,
    expected: &'static str,
) -> Result<(), SettingsError> {
    let found = found.try_into().unwrap_or(i64::MAX);
    if range.contains(&found) {
        return Ok(());
    }
    Err(SettingsError::Number { what, found, expected })
}

/// Number of map words in a frame.
pub const DATA_WORDS: usize = 64;
/// Number of words in a frame: head, body, checksum. All frames have the same length.
pub const FRAME_WORDS: usize = BODY + 2 + DATA_WORDS + 2;

const BODY: usize = HEAD_WORDS;

/// Content of a frame to the control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// Starts the transfer of a map, whose first word is expected next.
    Begin {
        /// Number that distinguishes the map from others.
        counter: u16,
        /// Length of the map, words.
        words: u16,
    },
    /// Transfers the next words of the map.
    Words {
        /// Index of the first transferred word in the map.
        place: u16,
        /// The words; zeros beyond the end of the map.
        data: [u16; DATA_WORDS],
    },
    /// Makes the completely transferred map active.
    Swap {
        /// Number of the transferred map.
        counter: u16,
        /// Checksum of the map's words.
        check: [u16; 2],
    },
    /// Keeps the active map valid.
    Keep {
        /// Number of the active map.
        counter: u16,
    },
}

/// A frame for the control's mailbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Proof that the frame is current: epoch, tick, owner and sequence.
    pub head: Head,
    /// Content by kind of frame.
    pub body: Body,
}

impl Frame {
    /// Encodes the frame for a machine and its corrected axes, with its checksum.
    #[must_use]
    pub fn encode(&self, machine: u16, outputs: Layout) -> [u16; FRAME_WORDS] {
        let mut words = [0; FRAME_WORDS];
        words[..BODY].copy_from_slice(&self.head.words());
        match self.body {
            Body::Begin { counter, words: count } => {
                words[BODY] = 1;
                words[BODY + 2..BODY + 4].copy_from_slice(&[counter, count]);
            }
            Body::Words { place, data } => {
                words[BODY..BODY + 2].copy_from_slice(&[2, place]);
                words[BODY + 2..BODY + 2 + DATA_WORDS].copy_from_slice(&data);
            }
            Body::Swap { counter, check } => {
                words[BODY] = 3;
                words[BODY + 2..BODY + 5].copy_from_slice(&[counter, check[0], check[1]]);
            }
            Body::Keep { counter } => {
                words[BODY] = 4;
                words[BODY + 2] = counter;
            }
        }
        seal(machine, outputs, &mut words);
        words
    }
}

/// Words of a mailbox whose checksum is correct.
struct MailboxFrame<'a>(&'a [u16; FRAME_WORDS]);

impl<'a> MailboxFrame<'a> {
    fn in_mailbox(machine: u16, outputs: Layout, words: &'a [u16; FRAME_WORDS]) -> Option<Self> {
        is_whole(machine, outputs, words).then_some(Self(words))
    }

    fn head(&self) -> Head {
        Head::of([self.0[0], self.0[1], self.0[2], self.0[3]])
    }

    /// Kind of the frame: 1 begin, 2 words, 3 swap, 4 keep.
    fn kind(&self) -> u16 {
        self.0[BODY]
    }

    fn place(&self) -> u16 {
        self.0[BODY + 1]
    }

    fn data(&self) -> &[u16] {
        &self.0[BODY + 2..BODY + 2 + DATA_WORDS]
    }
}

/// Maximum number of words of a report.
pub const REPORT_WORDS: usize = HEAD + 3 * OUTPUTS + 2;

const HEAD: usize = 13;
/// Value of the next word's index in a report if no map is being loaded.
const NOT_LOADING: u16 = u16::MAX;

/// Refusals of a look-up, by their number in the report.
const REFUSALS: [Refusal; 11] = [
    Refusal::None,
    Refusal::Checksum,
    Refusal::Epoch,
    Refusal::Tick,
    Refusal::Owner,
    Refusal::Sequence,
    Refusal::Value,
    Refusal::Place,
    Refusal::Fit,
    Refusal::Map,
    Refusal::Kind,
];

/// Report of a control with a map, published after each scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// State of the link and applied corrections, as for a barrier.
    pub of: barrier::Report,
    /// Whether a map is active. Otherwise the corrections are zero or ramping to zero.
    pub valid: bool,
    /// Number of the active map, or of the last active one; 0: none since start-up.
    pub counter: u16,
    /// Number of the map being loaded, and index of the next expected word; `None`: no map is being loaded.
    pub loading: Option<(u16, u16)>,
    /// Index of the buffer with the active map, 0 or 1.
    pub buffer: u16,
}

impl Report {
    /// Number of words of a report for these corrected axes.
    #[must_use]
    pub fn length(outputs: Layout) -> usize {
        HEAD + 3 * outputs.count().min(OUTPUTS) + 2
    }

    /// Encodes the report and returns its number of words.
    pub fn encode(&self, words: &mut [u16; REPORT_WORDS]) -> usize {
        let (loading, next) = self.loading.unwrap_or((0, NOT_LOADING));
        let (of, settings) = (&self.of, &self.of.settings);
        words[..HEAD].copy_from_slice(&[
            of.epoch,
            of.tick,
            of.owner,
            of.sequence,
            of.refusal.number_in(&REFUSALS),
            self.valid.into(),
            self.counter,
            loading,
            next,
            self.buffer,
            settings.step_scans,
            settings.hold_scans,
            settings.time_out_scans,
        ]);
        let outputs = settings.axes.count().min(OUTPUTS);
        for (place, of) in [of.applied, settings.limit, settings.rate].iter().enumerate() {
            for output in 0..outputs {
                words[HEAD + outputs * place + output] = of[output].cast_unsigned();
            }
        }
        let length = Self::length(settings.axes);
        seal(settings.machine, settings.axes, &mut words[..length]);
        length
    }

    /// Decodes a report of this machine with these corrected axes; `None` if there are too few words, or the checksum or a word is invalid.
    #[must_use]
    pub fn decode(machine: u16, axes: Layout, words: &[u16]) -> Option<Self> {
        let words = words.get(..Self::length(axes))?;
        if !is_whole(machine, axes, words) || words[5] > 1 || words[9] > 1 {
            return None;
        }
        let outputs = axes.count().min(OUTPUTS);
        let values = |place: usize| {
            Counts::from_fn(|output| {
                if output < outputs {
                    words[HEAD + outputs * place + output].cast_signed()
                } else {
                    0
                }
            })
        };
        let settings = barrier::Settings {
            axes,
            machine,
            limit: values(1),
            rate: values(2),
            step_scans: words[10],
            hold_scans: words[11],
            time_out_scans: words[12],
        };
        Some(Self {
            of: barrier::Report {
                epoch: words[0],
                tick: words[1],
                owner: words[2],
                sequence: words[3],
                refusal: Refusal::numbered(&REFUSALS, words[4])?,
                applied: values(0),
                settings,
            },
            valid: words[5] == 1,
            counter: words[6],
            loading: (words[8] != NOT_LOADING).then_some((words[7], words[8])),
            buffer: words[9],
        })
    }
}

/// Extreme position of an axis in its direction of travel; it counts as reversed after a minimum travel back from there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Travel {
    extreme: i32,
    direction: Option<Direction>,
}

impl Travel {
    fn at(position: i32) -> Self {
        Self { extreme: position, direction: None }
    }

    /// Updates and returns the direction at a position (within ±1e9 steps); `None` until the axis has travelled `turned` steps, which are also the
    /// minimum travel for a reversal.
    fn direction(&mut self, position: i32, turned: i32) -> Option<Direction> {
        let beyond = position - self.extreme;
        let (onward, back) = match self.direction {
            Some(Direction::Positive) => (beyond > 0, beyond <= -turned),
            Some(Direction::Negative) => (beyond < 0, beyond >= turned),
            None => (false, beyond.abs() >= turned),
        };
        if back {
            self.direction =
                if beyond > 0 { Some(Direction::Positive) } else { Some(Direction::Negative) };
        }
        if onward || back {
            self.extreme = position;
        }
        self.direction
    }
}

/// Look-up of one machine in its control.
#[derive(Clone, Debug)]
pub struct Lookup {
    settings: Settings,
    buffers: [Box<[u16]>; 2],
    memory: Memory,
}

/// State of a look-up between scans, apart from its buffers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// State of the link: the sender whose frames are accepted.
    pub link: Link,
    /// Reason why the last frame was rejected.
    pub refusal: Refusal,
    /// Header of the active map; `None`: no map is active, and the corrections ramp to zero.
    pub used: Option<Header>,
    /// Number of the active map, or of the last active one; 0: none since start-up.
    pub counter: u16,
    /// Index of the active buffer; maps are loaded into the other one.
    pub buffer: usize,
    /// The map being loaded; `None`: no transfer is in progress.
    pub loading: Option<Loading>,
    /// Correction applied to each axis, output steps.
    pub applied: [i16; OUTPUTS],
    /// Correction towards which each axis moves, output steps.
    pub goal: [i16; OUTPUTS],
    /// Number of scans since the corrections last moved, without those in which the control holds.
    pub waited: u16,
    /// Tick and sequence of the last frame with a correct checksum.
    pub found: Option<(u16, u16)>,
    travel: Option<[Travel; GRID_AXES]>,
}

/// A map being loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loading {
    /// Number that distinguishes the map from others.
    pub counter: u16,
    /// Length of the map, words.
    pub words: u16,
    /// Index of the next expected word.
    pub next: u16,
}

impl Lookup {
    /// Starts a look-up after power-up or reset, without an active map. `epoch` was stored before the power-off; `applied` are the corrections in
    /// the axis words, from which the axes ramp to zero.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn start(
        settings: Settings,
        epoch: u16,
        tick: u16,
        applied: [i16; OUTPUTS],
    ) -> Result<Self, SettingsError> {
        settings.check()?;
        let buffer = || vec![0; usize::from(settings.capacity)].into_boxed_slice();
        let outputs = settings.outputs.axes.count();
        let memory = Memory {
            link: Link::start(epoch, tick),
            applied: core::array::from_fn(|at| if at < outputs { applied[at] } else { 0 }),
            ..Memory::default()
        };
        Ok(Self { settings, buffers: [buffer(), buffer()], memory })
    }

    /// State apart from the buffers.
    #[must_use]
    pub fn memory(&self) -> &Memory {
        &self.memory
    }

    /// Words of a buffer, 0 or 1, for a sender that reads back what it has written.
    #[must_use]
    pub fn buffer(&self, buffer: usize) -> &[u16] {
        self.buffers.get(buffer).map_or(&[], |words| words)
    }

    /// Runs one scan of the control. `mailbox` contains the words of the mailbox, copied before this call. `steps` are the positions of the grid axes,
    /// without the correction if the control can separate it. `holds` states an emergency stop, an alarm, or that the machine is not referenced; the
    /// axes then keep their corrections.
    pub fn scan(
        &mut self,
        mailbox: &[u16; FRAME_WORDS],
        steps: &[i32; GRID_AXES],
        holds: bool,
    ) -> Report {
        self.memory.link.scan();
        match self.judge(mailbox) {
            Ok(true) => {
                self.memory.refusal = Refusal::None;
                self.memory.link.silent = 0;
            }
            verdict => {
                if let Err(refusal) = verdict {
                    self.memory.refusal = refusal;
                }
                let time_out = self.settings.outputs.time_out_scans;
                if self.memory.link.is_timed_out(time_out) {
                    // After the timeout the corrections ramp to zero.
                    self.memory.loading = None;
                    self.memory.used = None;
                }
            }
        }
        self.aim(steps);
        if !holds {
            self.memory.waited += 1;
            if self.memory.waited >= self.settings.outputs.step_scans {
                self.memory.waited = 0;
                self.step();
            }
        }
        self.report()
    }

    /// The report to publish after a scan.
    #[must_use]
    pub fn report(&self) -> Report {
        let memory = &self.memory;
        Report {
            of: barrier::Report {
                epoch: memory.link.epoch,
                tick: memory.link.tick,
                owner: memory.link.owner,
                sequence: memory.link.sequence,
                refusal: memory.refusal,
                applied: Counts::leading(memory.applied),
                settings: self.settings.outputs,
            },
            valid: memory.used.is_some(),
            counter: memory.counter,
            loading: memory.loading.map(|loading| (loading.counter, loading.next)),
            buffer: u16::from(memory.buffer != 0),
        }
    }

    /// Processes the frame in the mailbox. Returns true if it was accepted, and false if it was processed before.
    fn judge(&mut self, mailbox: &[u16; FRAME_WORDS]) -> Result<bool, Refusal> {
        let of = &self.settings.outputs;
        let frame =
            MailboxFrame::in_mailbox(of.machine, of.axes, mailbox).ok_or(Refusal::Checksum)?;
        let memory = &mut self.memory;
        if !(memory.link).judge(frame.head(), &mut memory.found, of.hold_scans)? {
            return Ok(false);
        }
        let taken = self.take(&frame);
        if matches!(taken, Err(Refusal::Value | Refusal::Fit)) {
            self.memory.loading = None;
        }
        taken?;
        self.memory.link.take(frame.head());
        Ok(true)
    }

    fn take(&mut self, frame: &MailboxFrame<'_>) -> Result<(), Refusal> {
        let data = frame.data();
        match frame.kind() {
            1 => self.begin(data[0], data[1]),
            2 => self.load(frame.place(), data),
            3 => self.swap(data[0], [data[1], data[2]]),
            4 if self.memory.used.is_some() && data[0] == self.memory.counter => Ok(()),
            4 => Err(Refusal::Map),
            _ => Err(Refusal::Kind),
        }
    }

    fn begin(&mut self, counter: u16, words: u16) -> Result<(), Refusal> {
        if counter == 0 || usize::from(words) <= HEADER_WORDS || words > self.settings.capacity {
            return Err(Refusal::Fit);
        }
        self.memory.loading = Some(Loading { counter, words, next: 0 });
        Ok(())
    }

    fn load(&mut self, place: u16, data: &[u16]) -> Result<(), Refusal> {
        let Some(loading) = &mut self.memory.loading else {
            return Err(Refusal::Place);
        };
        if place != loading.next || loading.next >= loading.words {
            return Err(Refusal::Place);
        }
        let first = usize::from(place);
        let count = DATA_WORDS.min(usize::from(loading.words) - first);
        let Some(into) = self.buffers[1 - self.memory.buffer].get_mut(first..first + count) else {
            return Err(Refusal::Place);
        };
        into.copy_from_slice(&data[..count]);
        loading.next += u16::try_from(count).unwrap_or(0);
        // Words arrive in order, so the whole header is there before the values.
        let scale = i32::from(self.buffers[1 - self.memory.buffer][9]);
        let outputs = self.settings.outputs.axes.count();
        for (at, word) in data[..count].iter().enumerate() {
            let Some(value) = (first + at).checked_sub(HEADER_WORDS) else {
                continue;
            };
            let limit = i32::from(self.settings.outputs.limit[value % outputs]) * scale;
            if i32::from(word.cast_signed()).abs() > limit {
                return Err(Refusal::Value);
            }
        }
        Ok(())
    }

    fn swap(&mut self, counter: u16, check: [u16; 2]) -> Result<(), Refusal> {
        let complete = self
            .memory
            .loading
            .filter(|loading| loading.counter == counter && loading.next == loading.words);
        let Some(loading) = complete else {
            return Err(Refusal::Place);
        };
        let buffer = 1 - self.memory.buffer;
        let words = self.buffers[buffer].get(..usize::from(loading.words));
        let words = words.ok_or(Refusal::Place)?;
        let found = checksum(self.settings.outputs.machine, self.settings.outputs.axes, words);
        if found.words() != check {
            self.memory.loading = None;
            return Err(Refusal::Map);
        }
        let header = Header::decode(words).map_err(|_| Refusal::Fit)?;
        if !self.fits(&header, counter, words.len()) {
            return Err(Refusal::Fit);
        }
        self.memory.loading = None;
        self.memory.buffer = buffer;
        self.memory.counter = counter;
        self.memory.used = Some(header);
        Ok(())
    }

    fn fits(&self, header: &Header, counter: u16, words: usize) -> bool {
        let settings = &self.settings;
        let axes = settings.grid.count();
        let outputs = settings.outputs.axes.count();
        let same_position = (0..axes).all(|axis| {
            header.lines[axis].step_millionths == settings.position_step_millionths[axis]
        });
        let same_output = header.output_step_nm[..outputs] == settings.output_step_nm[..outputs];
        let within = (0..axes).all(|axis| {
            (0..outputs).all(|output| {
                let most = i32::from(settings.outputs.limit[output]) * i32::from(header.scale);
                i32::from(header.reversal[axis][output]).abs() <= most
            })
        });
        header.counter == counter
            && header.words() == words
            && header.grid == settings.grid
            && header.outputs == settings.outputs.axes
            && same_position
            && same_output
            && within
    }

    fn aim(&mut self, steps: &[i32; GRID_AXES]) {
        let steps = steps.map(|steps| steps.clamp(-MAX_POSITION_STEPS, MAX_POSITION_STEPS));
        let travel = self.memory.travel.get_or_insert(steps.map(Travel::at));
        let mut position = Position { steps, ..Position::default() };
        for axis in 0..self.settings.grid.count() {
            position.directions[axis] =
                travel[axis].direction(steps[axis], self.settings.turned[axis]);
        }
        let Some(header) = &self.memory.used else {
            self.memory.goal = [0; OUTPUTS];
            return;
        };
        let parts = look_up(header, &self.buffers[self.memory.buffer], &position);
        let scale = i32::from(header.scale);
        for (output, parts) in
            parts.into_iter().enumerate().take(self.settings.outputs.axes.count())
        {
            let limit = i32::from(self.settings.outputs.limit[output]);
            let before = i32::from(self.memory.goal[output]);
            // Hysteresis: changes of a goal by up to 0.6 steps are ignored, so that position noise causes no movement.
            if 10 * (parts - before * scale).abs() <= 6 * scale {
                continue;
            }
            let nearest = (parts + 65536 * scale + scale / 2) / scale - 65536;
            let nearest = nearest.clamp(-limit, limit);
            self.memory.goal[output] = i16::try_from(nearest).unwrap_or(0);
        }
    }

    /// Moves every output by the same fraction of its distance, such that none exceeds its rate.
    fn step(&mut self) {
        let outputs = self.settings.outputs.axes.count();
        let distance = |memory: &Memory, output: usize| {
            i32::from(memory.goal[output]) - i32::from(memory.applied[output])
        };
        let movements = (0..outputs).map(|output| {
            let rate = u32::from(self.settings.outputs.rate[output].unsigned_abs());
            distance(&self.memory, output).unsigned_abs().div_ceil(rate.max(1))
        });
        let movements = movements.max().unwrap_or(0).max(1);
        for output in 0..outputs {
            let distance = distance(&self.memory, output);
            let share = i32::try_from(distance.unsigned_abs() / movements).unwrap_or(0);
            let at = i32::from(self.memory.applied[output]) + distance.signum() * share;
            // The value lies between two 16-bit numbers, so the conversion cannot fail.
            self.memory.applied[output] = i16::try_from(at).unwrap_or(0);
        }
    }
}
