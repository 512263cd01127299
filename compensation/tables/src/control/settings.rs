//! What a control is set to.

use volcomp_guard::{barrier, protocol::Layout};

use crate::{GRID_AXES, HEADER_WORDS, MOST_WORDS, OUTPUTS};

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
