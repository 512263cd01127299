//! The look-up itself: which frame is taken, which map is in use, and how the applied correction moves.

use volcomp_guard::{
    barrier,
    protocol::{Counts, Link, Refusal, checksum},
};

use super::{DATA, FRAME_WORDS, Report, Settings, SettingsError, frame::Found, travel::Travel};
use crate::{
    GRID_AXES, HEADER_WORDS, Header, OUTPUTS, Position, header::FURTHEST, interpolation::look_up,
};

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
