//! The control's half of the map mode, as a reference that a control's program is held against.
//!
//! By the rules of the [`protocol`](volcomp_guard::protocol) the control alone decides what it takes. A map comes in pieces through one mailbox, in
//! their order, into the buffer that is not in use; a last frame swaps the buffers, and only where the checksum of all
//! that arrived fits. What the axes get moves at a rate of its own, to another map as well as to zero, where it goes when
//! nobody sends any more.
//!
//! Everything is 16-bit words and whole numbers. [`Lookup::scan`] allocates nothing, waits for nothing and reads no clock:
//! the time is the number of scans.

use volcomp_guard::{
    barrier,
    protocol::{Counts, HEAD_WORDS, Head, Layout, Link, Refusal, checksum, is_whole, seal},
};
use volcomp_vocabulary::Direction;

use crate::map::{
    FURTHEST, GRID_AXES, HEADER_WORDS, Header, MOST_WORDS, OUTPUTS, Position, look_up,
};

// The numbers that the messages tell.
const _: () = assert!(HEADER_WORDS == 68 && MOST_WORDS == 32767);

/// What a control is set to. Positions and corrections are whole steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// The axes that maps go over, in the order of [`Position`](crate::Position).
    pub grid: Layout,
    /// The axes that are corrected, the machine, and how the corrections are bounded: as of a barrier, 1 to 32767 of each.
    pub outputs: barrier::Settings,
    /// A step of the position of each axis of the grid, millionths of a mm (nm) or of a deg.
    pub position_step_millionths: [u32; GRID_AXES],
    /// A step of each output, nm.
    pub output_step_nm: [u32; OUTPUTS],
    /// Words of one of the two buffers, 69 to 32767.
    pub capacity: u16,
    /// Travel against its direction after which an axis of the grid counts as turned, steps of the position, 1 to 1000000.
    pub turned: [i32; GRID_AXES],
}

/// The largest step: a number that a DINT holds.
const MOST_STEP: i64 = 2_000_000_000;

/// Why settings make no sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingsError {
    /// One of those that a barrier has, too.
    #[error(transparent)]
    Outputs(#[from] barrier::SettingsError),
    /// A number.
    #[error("{what} is {found}, expected {expected}")]
    Number {
        /// Of what.
        what: &'static str,
        /// The number.
        found: i64,
        /// The numbers that can be.
        expected: &'static str,
    },
}

impl Settings {
    /// Whether the settings can be worked with.
    ///
    /// # Errors
    /// The first that makes no sense.
    pub fn check(&self) -> Result<(), SettingsError> {
        self.outputs.check()?;
        let (axes, outputs) = (self.grid.count(), self.outputs.axes.count());
        within("number of axes of the grid", axes, 1..=5, "1 to 5")?;
        within("number of corrected axes", outputs, 1..=3, "1 to 3")?;
        within(
            "capacity of a buffer",
            self.capacity,
            69..=32767,
            "69 to 32767 words",
        )?;
        within(
            "scans from step to step",
            self.outputs.step_scans,
            1..=32767,
            "1 to 32767",
        )?;
        for output in 0..outputs.min(OUTPUTS) {
            let step = self.output_step_nm[output];
            within(
                "step of an output",
                step,
                1..=MOST_STEP,
                "1 to 2000000000 nm",
            )?;
        }
        for axis in 0..axes.min(GRID_AXES) {
            let turned = self.turned[axis];
            within(
                "travel that turns an axis",
                turned,
                1..=1_000_000,
                "1 to 1000000 steps",
            )?;
            let step = self.position_step_millionths[axis];
            within(
                "step of a position",
                step,
                1..=MOST_STEP,
                "1 to 2000000000 millionths",
            )?;
        }
        Ok(())
    }

    /// The scans within which every output is at zero, counted from the last frame that was taken; scans in which the control
    /// holds are not counted.
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
    Err(SettingsError::Number {
        what,
        found,
        expected,
    })
}

/// Words of a map in one frame.
pub const DATA: usize = 64;
/// Words of a frame: head, body, checksum. Every frame has as many.
pub const FRAME_WORDS: usize = BODY + 2 + DATA + 2;

const BODY: usize = HEAD_WORDS;

/// What a frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// A map comes, beginning with its first word.
    Begin {
        /// The number of the map.
        counter: u16,
        /// How many words it has.
        words: u16,
    },
    /// The next words of the map.
    Words {
        /// The place of the first of them.
        place: u16,
        /// The words; beyond the end of the map zeros.
        data: [u16; DATA],
    },
    /// The map is complete: from now on it is the one in use.
    Swap {
        /// The number of the map.
        counter: u16,
        /// The checksum of its words.
        check: [u16; 2],
    },
    /// The map in use stays valid.
    Keep {
        /// The number of the map.
        counter: u16,
    },
}

/// One frame: what shows that it is meant for now, and what it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// What shows that it is meant for now.
    pub head: Head,
    /// What it says.
    pub body: Body,
}

impl Frame {
    /// The words of the frame for a machine and its corrected axes, checksum and all.
    #[must_use]
    pub fn encode(&self, machine: u16, outputs: Layout) -> [u16; FRAME_WORDS] {
        let mut words = [0; FRAME_WORDS];
        words[..BODY].copy_from_slice(&self.head.words());
        match self.body {
            Body::Begin {
                counter,
                words: count,
            } => {
                words[BODY] = 1;
                words[BODY + 2..BODY + 4].copy_from_slice(&[counter, count]);
            }
            Body::Words { place, data } => {
                words[BODY..BODY + 2].copy_from_slice(&[2, place]);
                words[BODY + 2..BODY + 2 + DATA].copy_from_slice(&data);
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

/// The words of a mailbox whose checksum fits.
struct Found<'a>(&'a [u16; FRAME_WORDS]);

impl<'a> Found<'a> {
    fn in_mailbox(machine: u16, outputs: Layout, words: &'a [u16; FRAME_WORDS]) -> Option<Self> {
        is_whole(machine, outputs, words).then_some(Self(words))
    }

    fn head(&self) -> Head {
        Head::of([self.0[0], self.0[1], self.0[2], self.0[3]])
    }

    /// 1 begin, 2 words, 3 swap, 4 keep.
    fn kind(&self) -> u16 {
        self.0[BODY]
    }

    fn place(&self) -> u16 {
        self.0[BODY + 1]
    }

    fn data(&self) -> &[u16] {
        &self.0[BODY + 2..BODY + 2 + DATA]
    }
}

/// The largest number of words of a report.
pub const REPORT_WORDS: usize = HEAD + 3 * OUTPUTS + 2;

const HEAD: usize = 13;
/// No map is being loaded.
const NOTHING: u16 = u16::MAX;

/// The refusals of a look-up, by their numbers in its words.
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

/// What a control with a map publishes after each scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// Its link, and what is applied: as of a barrier.
    pub of: barrier::Report,
    /// A map is in use. Where it is not, the corrections are zero or on the way there.
    pub valid: bool,
    /// The number of the map that is or was in use last; 0: none since the start.
    pub counter: u16,
    /// The number of the map that is being loaded, and the place of the word that comes next.
    pub loading: Option<(u16, u16)>,
    /// Which of the two buffers the map in use lies in, 0 or 1.
    pub buffer: u16,
}

impl Report {
    /// How many words a report of these corrected axes has.
    #[must_use]
    pub fn length(outputs: Layout) -> usize {
        HEAD + 3 * outputs.count().min(OUTPUTS) + 2
    }

    /// Writes the words, and tells how many there are.
    pub fn encode(&self, words: &mut [u16; REPORT_WORDS]) -> usize {
        let (loading, next) = self.loading.unwrap_or((0, NOTHING));
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
        for (place, of) in [of.applied, settings.limit, settings.rate]
            .iter()
            .enumerate()
        {
            for output in 0..outputs {
                words[HEAD + outputs * place + output] = of[output].cast_unsigned();
            }
        }
        let length = Self::length(settings.axes);
        seal(settings.machine, settings.axes, &mut words[..length]);
        length
    }

    /// Reads a report of this machine and these corrected axes; `None` when there are too few words, the checksum does not fit, or a
    /// word means nothing.
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
            loading: (words[8] != NOTHING).then_some((words[7], words[8])),
            buffer: words[9],
        })
    }
}

/// Where an axis was furthest in its direction: it counts as turned only after a travel back from there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Travel {
    extreme: i32,
    direction: Option<Direction>,
}

impl Travel {
    fn at(position: i32) -> Self {
        Self {
            extreme: position,
            direction: None,
        }
    }

    /// The direction at a position, which is within ±1e9 steps.
    fn direction(&mut self, position: i32, turned: i32) -> Option<Direction> {
        let beyond = position - self.extreme;
        let (onward, back) = match self.direction {
            Some(Direction::Positive) => (beyond > 0, beyond <= -turned),
            Some(Direction::Negative) => (beyond < 0, beyond >= turned),
            None => (false, beyond.abs() >= turned),
        };
        if back {
            self.direction = if beyond > 0 {
                Some(Direction::Positive)
            } else {
                Some(Direction::Negative)
            };
        }
        if onward || back {
            self.extreme = position;
        }
        self.direction
    }
}

/// The look-up of one machine in its control.
#[derive(Clone, Debug)]
pub struct Lookup {
    settings: Settings,
    /// The words of both buffers.
    buffers: [Box<[u16]>; 2],
    memory: Memory,
}

/// What a look-up remembers from one scan to the next, besides its buffers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// Whose frames are taken.
    pub link: Link,
    /// Why the last frame was not taken.
    pub refusal: Refusal,
    /// The head of the map in use; `None`: none is, and the corrections go to zero.
    pub used: Option<Header>,
    /// The number of the map that is or was in use last.
    pub counter: u16,
    /// Which buffer the map in use lies in; the other one is loaded.
    pub buffer: usize,
    /// The map that is being loaded.
    pub loading: Option<Loading>,
    /// The corrections that are applied, steps.
    pub applied: [i16; OUTPUTS],
    /// Where they go, steps.
    pub goal: [i16; OUTPUTS],
    /// Scans since the last movement.
    pub waited: u16,
    /// Tick and sequence of the whole frame that was found last.
    pub found: Option<(u16, u16)>,
    travel: Option<[Travel; GRID_AXES]>,
}

/// A map that is being loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loading {
    /// Its number.
    pub counter: u16,
    /// How many words it has.
    pub words: u16,
    /// The place of the word that comes next.
    pub next: u16,
}

impl Lookup {
    /// A look-up at its start, after power-up or a reset: no map is in use. `epoch` is the one that was kept over power-off,
    /// `applied` what the words of the axes hold: the axes go to zero from there.
    ///
    /// # Errors
    /// Settings that make no sense.
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
        Ok(Self {
            settings,
            buffers: [buffer(), buffer()],
            memory,
        })
    }

    /// All that is remembered besides the buffers.
    #[must_use]
    pub fn memory(&self) -> &Memory {
        &self.memory
    }

    /// The words of a buffer, 0 or 1; a sender reads back what it loaded.
    #[must_use]
    pub fn buffer(&self, buffer: usize) -> &[u16] {
        self.buffers.get(buffer).map_or(&[], |words| words)
    }

    /// One scan of the control. `mailbox` are the words that lie in the mailbox, copied before this call; `steps` where each
    /// axis of the grid stands, without the correction where the control can tell; `holds`: emergency stop, alarm or not
    /// referenced: the axes then stay where they are.
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
                    // Nobody sends: to zero.
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

    /// What is published after a scan.
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
            loading: memory
                .loading
                .map(|loading| (loading.counter, loading.next)),
            buffer: u16::from(memory.buffer != 0),
        }
    }

    /// Whether the frame in the mailbox is taken; `false`: it was judged before, or is the one that was taken last.
    fn judge(&mut self, mailbox: &[u16; FRAME_WORDS]) -> Result<bool, Refusal> {
        let of = &self.settings.outputs;
        let frame = Found::in_mailbox(of.machine, of.axes, mailbox).ok_or(Refusal::Checksum)?;
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

    /// Does what a frame says.
    fn take(&mut self, frame: &Found<'_>) -> Result<(), Refusal> {
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
        self.memory.loading = Some(Loading {
            counter,
            words,
            next: 0,
        });
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
        let count = DATA.min(usize::from(loading.words) - first);
        let Some(into) = self.buffers[1 - self.memory.buffer].get_mut(first..first + count) else {
            return Err(Refusal::Place);
        };
        into.copy_from_slice(&data[..count]);
        loading.next += u16::try_from(count).unwrap_or(0);
        // Values come after the whole head.
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
        let found = checksum(
            self.settings.outputs.machine,
            self.settings.outputs.axes,
            words,
        );
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

    /// Whether a map is made for this control.
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

    /// Looks up where the corrections go.
    fn aim(&mut self, steps: &[i32; GRID_AXES]) {
        let steps = steps.map(|steps| steps.clamp(-FURTHEST, FURTHEST));
        let travel = self.memory.travel.get_or_insert(steps.map(Travel::at));
        let mut position = Position {
            steps,
            ..Position::default()
        };
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
        for (output, parts) in parts
            .into_iter()
            .enumerate()
            .take(self.settings.outputs.axes.count())
        {
            let limit = i32::from(self.settings.outputs.limit[output]);
            let before = i32::from(self.memory.goal[output]);
            // It stays while it is nearer than 0.6 of a step, so that a flickering position moves nothing.
            if 10 * (parts - before * scale).abs() <= 6 * scale {
                continue;
            }
            let nearest = (parts + 65536 * scale + scale / 2) / scale - 65536;
            let nearest = nearest.clamp(-limit, limit);
            self.memory.goal[output] = i16::try_from(nearest).unwrap_or(0);
        }
    }

    /// One movement: every output comes to the same share of its way, and none moves by more than its rate.
    fn step(&mut self) {
        let outputs = self.settings.outputs.axes.count();
        let way = |memory: &Memory, output: usize| {
            i32::from(memory.goal[output]) - i32::from(memory.applied[output])
        };
        let movements = (0..outputs).map(|output| {
            let rate = u32::from(self.settings.outputs.rate[output].unsigned_abs());
            way(&self.memory, output)
                .unsigned_abs()
                .div_ceil(rate.max(1))
        });
        let movements = movements.max().unwrap_or(0).max(1);
        for output in 0..outputs {
            let way = way(&self.memory, output);
            let share = i32::try_from(way.unsigned_abs() / movements).unwrap_or(0);
            let at = i32::from(self.memory.applied[output]) + way.signum() * share;
            // Between two numbers of 16 bits, so it is one.
            self.memory.applied[output] = i16::try_from(at).unwrap_or(0);
        }
    }
}
