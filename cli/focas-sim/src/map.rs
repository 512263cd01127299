//! Map interpolation in the simulated control. Its PMC program is the reference implementation in `volcomp-tables`.

use volcomp_focas::{
    PmcAddress, PmcArea,
    simulator::{LadderProgram, World},
};
use volcomp_guard::{
    barrier,
    protocol::{Counts, Layout},
};
use volcomp_tables::{
    GRID_AXES, OUTPUTS,
    control::{FRAME_WORDS, Lookup, REPORT_WORDS, Settings, SettingsError},
};

/// Byte addresses in data table D: mailbox, report, and the first of the two buffers.
const MAILBOX: u16 = 0;
const REPORT: u16 = 144;
const BUFFERS: u16 = 200;
/// Maximum number of 16-bit words in a buffer. Two buffers fit into the 10 000 bytes of the data table.
pub(crate) const MOST_WORDS: u16 = (10_000 - BUFFERS) / 4;
/// Step of positions and corrections, nm.
const STEP_NM: u32 = 1000;
/// Minimum travel that counts as a reversal, steps: 5 µm.
const TURNED: i32 = 5;

pub(crate) struct MapLadder {
    lookup: Lookup,
    settings: Settings,
    /// Index of each corrected axis among the axes of the control.
    slots: Vec<usize>,
}

pub(crate) struct Set {
    pub(crate) machine: u16,
    pub(crate) capacity: u16,
    /// Maximum correction, µm.
    pub(crate) limit: i16,
    /// Maximum change in one scan, µm.
    pub(crate) rate: i16,
    /// Maximum age of the report that a frame answers, scans.
    pub(crate) hold_scans: u16,
    /// Time without a frame after which the correction goes to zero, scans.
    pub(crate) time_out_scans: u16,
}

fn address(at: u16) -> PmcAddress {
    let area = PmcArea::D;
    PmcAddress { area, at }
}

impl MapLadder {
    pub(crate) fn new(axes: Layout, slots: Vec<usize>, set: &Set) -> Result<Self, SettingsError> {
        let settings = Settings {
            grid: axes,
            outputs: barrier::Settings {
                axes,
                machine: set.machine,
                limit: Counts::from_fn(|_| set.limit),
                rate: Counts::from_fn(|_| set.rate),
                step_scans: 1,
                hold_scans: set.hold_scans,
                time_out_scans: set.time_out_scans,
            },
            position_step_millionths: [STEP_NM; GRID_AXES],
            output_step_nm: [STEP_NM; OUTPUTS],
            capacity: set.capacity,
            turned: [TURNED; GRID_AXES],
        };
        Ok(Self { lookup: Lookup::start(settings, 0, 0, [0; OUTPUTS])?, settings, slots })
    }

    /// Positions of the corrected axes without the correction, in steps.
    #[expect(clippy::cast_possible_truncation, reason = "a float is cut to the range of i32")]
    fn steps(&self, world: &World) -> [i32; GRID_AXES] {
        let at_mm = world.commanded();
        let mut steps = [0; GRID_AXES];
        for (step, slot) in steps.iter_mut().zip(&self.slots) {
            *step = (at_mm.get(*slot).copied().unwrap_or(0.0) * 1e6 / f64::from(STEP_NM)).round()
                as i32;
        }
        steps
    }
}

impl LadderProgram for MapLadder {
    fn scan(&mut self, world: &mut World) {
        // Copy the mailbox first; the look-up validates the copy.
        let mut mailbox = [0; FRAME_WORDS];
        let found = world.words(address(MAILBOX), FRAME_WORDS);
        mailbox[..found.len()].copy_from_slice(&found);
        let steps = self.steps(world);
        let report = self.lookup.scan(&mailbox, &steps, world.holds());
        let mut words = [0; REPORT_WORDS];
        let count = report.encode(&mut words);
        world.set_words(address(REPORT), &words[..count]);
        for buffer in 0..2 {
            let at = BUFFERS + 2 * self.settings.capacity * buffer;
            world.set_words(address(at), self.lookup.buffer(buffer.into()));
        }
        for (slot, applied) in self.slots.iter().zip(self.lookup.memory().applied) {
            world.set_shift(*slot, applied.into());
        }
    }

    fn restart(&mut self, world: &mut World) {
        let shifts = world.shift_counts();
        let mut applied = [0; OUTPUTS];
        for (applied, slot) in applied.iter_mut().zip(&self.slots) {
            let counts = shifts.get(*slot).copied().unwrap_or(0);
            *applied = i16::try_from(counts).unwrap_or(0);
        }
        let link = self.lookup.memory().link;
        if let Ok(lookup) = Lookup::start(self.settings, link.epoch, link.tick, applied) {
            self.lookup = lookup;
        }
    }
}
