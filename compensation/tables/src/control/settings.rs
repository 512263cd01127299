//! What a control is set to.

use volcomp_guard::barrier::{LARGEST_MACHINE, Layout};

use crate::{GRID_AXES, HEADER_WORDS, MOST_WORDS, OUTPUTS};

// The numbers that the messages tell.
const _: () = assert!(HEADER_WORDS == 68 && MOST_WORDS == 32767);

/// What a control is set to. Positions and corrections are whole steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// The axes that maps go over, in the order of [`Position`](crate::Position).
    pub grid: Layout,
    /// The axes that are corrected, in their order.
    pub outputs: Layout,
    /// The number of the machine, which starts every checksum: 0 to 65534.
    pub machine: u16,
    /// A step of the position of each axis of the grid, millionths of a mm (nm) or of a deg.
    pub position_step_millionths: [u32; GRID_AXES],
    /// A step of each output, nm.
    pub output_step_nm: [u32; OUTPUTS],
    /// Words of one of the two buffers, 69 to 32767.
    pub capacity: u16,
    /// The largest correction of each output, steps, 1 to 32767.
    pub limit: [i16; OUTPUTS],
    /// The largest movement of each output at once, steps, 1 to 32767.
    pub rate: [i16; OUTPUTS],
    /// Travel against its direction after which an axis of the grid counts as turned, steps of the position, 1 to 1000000.
    pub turned: [i32; GRID_AXES],
    /// Scans from one movement to the next, 1 to 32767.
    pub step_scans: u16,
    /// The largest age of what a frame answers, scans, 1 to 16383.
    pub hold_scans: u16,
    /// Scans without a frame after which the correction goes to zero, 2·`hold_scans` to 32767.
    pub time_out_scans: u16,
}

/// The largest step: a number that a DINT holds.
const MOST_STEP: i64 = 2_000_000_000;

/// Why settings make no sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what} is {found}, expected {expected}")]
pub struct SettingsError {
    what: &'static str,
    found: i64,
    expected: &'static str,
}

impl Settings {
    /// Whether the settings can be worked with.
    ///
    /// # Errors
    /// The first that makes no sense.
    pub fn check(&self) -> Result<(), SettingsError> {
        let (axes, outputs) = (self.grid.count(), self.outputs.count());
        within("number of axes of the grid", axes, 1..=5, "1 to 5")?;
        within("number of corrected axes", outputs, 1..=3, "1 to 3")?;
        within(
            "number of the machine",
            self.machine,
            0..=LARGEST_MACHINE.into(),
            "0 to 65534",
        )?;
        within(
            "capacity of a buffer",
            self.capacity,
            69..=32767,
            "69 to 32767 words",
        )?;
        within(
            "scans from step to step",
            self.step_scans,
            1..=32767,
            "1 to 32767",
        )?;
        within(
            "largest age of a frame",
            self.hold_scans,
            1..=16383,
            "1 to 16383 scans",
        )?;
        let time_out = 2 * i64::from(self.hold_scans)..=32767;
        let expected = "twice the largest age of a frame to 32767 scans";
        within("time-out", self.time_out_scans, time_out, expected)?;
        for output in 0..outputs.min(OUTPUTS) {
            within(
                "limit of a correction",
                self.limit[output],
                1..=32767,
                "1 to 32767 steps",
            )?;
            within(
                "rate of a correction",
                self.rate[output],
                1..=32767,
                "1 to 32767 steps",
            )?;
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
        let outputs = self.outputs.count().min(OUTPUTS);
        let ways = (0..outputs).map(|output| {
            let [limit, rate] =
                [self.limit, self.rate].map(|of| u32::from(of[output].unsigned_abs()));
            limit.div_ceil(rate.max(1))
        });
        let steps = ways.max().unwrap_or(0);
        u32::from(self.time_out_scans) + steps * u32::from(self.step_scans)
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
    Err(SettingsError {
        what,
        found,
        expected,
    })
}
