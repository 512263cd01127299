//! The programs of the simulated control: what happens to the words of a gateway before they move an axis.

use std::time::Duration;

use volcomp_port::ControlProgram;
use volcomp_vocabulary::{MAX_AXES, PerChannel};

use super::World;
use crate::{
    areas::BarrierArea,
    pmc::{PmcAddress, PmcArea},
};

/// The program of the simulated control, which runs once in each scan.
pub enum Ladder {
    /// A barrier: it judges frames, moves the shifts at its own rate, and reports.
    Barrier(BarrierLadder),
    /// The plain pattern of the manual: it copies the words of the gateway to the shifts while a heartbeat moves, and
    /// ramps them to zero when it stands still.
    Heartbeat(HeartbeatLadder),
    /// Another program.
    Own(Box<dyn LadderProgram>),
}

/// A program of one's own for the simulated control.
pub trait LadderProgram: Send {
    /// One scan: the program reads and writes the memory of the PMC, and sets the shifts of the axes.
    fn scan(&mut self, world: &mut World);

    /// The program begins anew, as after a reset, with the axes where their words have them.
    fn restart(&mut self, world: &mut World);
}

/// A barrier in the control, and where its words lie.
pub struct BarrierLadder {
    /// The barrier.
    pub program: Box<dyn ControlProgram>,
    /// The first byte of each mailbox for frames.
    pub frames: Vec<PmcAddress>,
    /// The first byte of the report.
    pub report: PmcAddress,
    /// For each axis of the barrier, in channel order: its place among the control's axes, from 0.
    pub slots: Vec<usize>,
}

impl BarrierLadder {
    /// A barrier of the control's first `axes` axes: one mailbox from R200 on, the report from R240 on.
    pub fn new(program: Box<dyn ControlProgram>, axes: usize) -> Self {
        let address = |at| PmcAddress {
            area: PmcArea::R,
            at,
        };
        Self {
            program,
            frames: vec![address(200)],
            report: address(240),
            slots: (0..axes.min(MAX_AXES)).collect(),
        }
    }

    fn scan(&mut self, world: &mut World) {
        let words = BarrierArea::frame_words(self.slots.len());
        // Copied first, then judged.
        let frames: Vec<Vec<u16>> = self
            .frames
            .iter()
            .map(|at| world.words(*at, words))
            .collect();
        let frames: Vec<&[u16]> = frames.iter().map(Vec::as_slice).collect();
        if let Some((latch, axis, value)) = world.lines() {
            self.program.lines(latch, axis, value);
        }
        let report = self.program.scan(&frames, world.holds());
        world.set_words(self.report, report.as_slice());
        let applied = self.program.applied();
        for (slot, count) in self.slots.iter().zip(applied.iter()) {
            world.set_shift(*slot, i64::from(*count));
        }
    }

    /// The program begins anew, with the axes where their words have them.
    fn restart(&mut self, world: &mut World) {
        let shifts = world.shift_counts();
        let of = |axis: usize| {
            let slot = self.slots.get(axis);
            let count = slot.and_then(|slot| shifts.get(*slot)).copied();
            let count = count.unwrap_or(0);
            i16::try_from(count.clamp(i16::MIN.into(), i16::MAX.into())).unwrap_or(0)
        };
        self.program.restart(&PerChannel::from_fn(of));
    }
}

/// The pattern of the manual for a control without a barrier.
///
/// The gateway writes `words` and moves `heartbeat` on; the shifts of the axes are other words ([`World::shift`]), which
/// this program sets. It therefore wants a configuration that says so (`copied`).
#[derive(Clone, Debug, PartialEq)]
pub struct HeartbeatLadder {
    /// The first of the words that the gateway writes, two bytes for each axis.
    pub words: PmcAddress,
    /// The byte that every write moves on.
    pub heartbeat: PmcAddress,
    /// The time without a heartbeat after which the shifts go to zero.
    pub hold: Duration,
    /// The largest change of a shift in one scan on the way to zero, counts.
    pub step: i64,
    /// Whether words that stood there at the start stay as they are until the first heartbeat: a control that has not
    /// seen a gateway yet.
    pub keeps_words_until_first_beat: bool,
    beat: Option<u8>,
    has_beaten: bool,
    silent: Duration,
}

impl Default for HeartbeatLadder {
    /// Words from R100 on, the heartbeat at R120, 600 ms, 1 count in each scan.
    fn default() -> Self {
        let address = |at| PmcAddress {
            area: PmcArea::R,
            at,
        };
        Self {
            words: address(100),
            heartbeat: address(120),
            hold: Duration::from_millis(600),
            step: 1,
            keeps_words_until_first_beat: false,
            beat: None,
            has_beaten: false,
            silent: Duration::MAX,
        }
    }
}

impl HeartbeatLadder {
    fn scan(&mut self, world: &mut World) {
        let (area, at) = (self.heartbeat.area, self.heartbeat.at);
        let found = world.read(area, at.into(), 1);
        let beat = found.and_then(|bytes| bytes.first().copied());
        let axes = world.axes.len();
        if self.beat.is_some() && beat != self.beat {
            self.silent = Duration::ZERO;
            self.has_beaten = true;
            for (slot, word) in world.words(self.words, axes).into_iter().enumerate() {
                world.set_shift(slot, i64::from(word.cast_signed()));
            }
        } else if self.silent < self.hold {
            self.silent = self.silent.saturating_add(world.scan);
        } else {
            let mut words = Vec::new();
            for (slot, shift) in world.shift_counts().into_iter().enumerate() {
                let shift = shift - shift.clamp(-self.step, self.step);
                world.set_shift(slot, shift);
                words.push(i16::try_from(shift).unwrap_or(0).cast_unsigned());
            }
            // So that the gateway, when it comes back, reads what is applied.
            if self.has_beaten || !self.keeps_words_until_first_beat {
                world.set_words(self.words, &words);
            }
        }
        self.beat = beat;
    }

    fn restart(&mut self) {
        self.beat = None;
        self.has_beaten = false;
        self.silent = Duration::MAX;
    }
}

impl Ladder {
    pub(super) fn scan(&mut self, world: &mut World) {
        match self {
            Self::Barrier(ladder) => ladder.scan(world),
            Self::Heartbeat(ladder) => ladder.scan(world),
            Self::Own(program) => program.scan(world),
        }
    }

    pub(super) fn restart(&mut self, world: &mut World) {
        match self {
            Self::Barrier(ladder) => ladder.restart(world),
            Self::Heartbeat(ladder) => ladder.restart(),
            Self::Own(program) => program.restart(world),
        }
    }
}
