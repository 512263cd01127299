//! The programs of the simulated control: what happens to the words of a gateway before they move an axis.

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

impl Ladder {
    pub(super) fn scan(&mut self, world: &mut World) {
        match self {
            Self::Barrier(ladder) => ladder.scan(world),
            Self::Own(program) => program.scan(world),
        }
    }

    pub(super) fn restart(&mut self, world: &mut World) {
        match self {
            Self::Barrier(ladder) => ladder.restart(world),
            Self::Own(program) => program.restart(world),
        }
    }
}
