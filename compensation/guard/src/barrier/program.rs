//! The reference barrier as the program of a simulated control.

use core::time::Duration;

use volcomp_port::{Axis, ControlProgram, Words};
use volcomp_vocabulary::{AxisKind, Mm, PerChannel, Rad};

use super::{Barrier, DigitalLines, REPORT_WORDS, Report, Settings, SettingsError};
use crate::protocol::{Counts, Layout};

/// The barrier of a simulated control. It keeps its epoch over a restart, like a control with a retained word.
#[derive(Clone, Debug)]
pub struct Program {
    barrier: Barrier,
    /// The levels of digital lines; `None` without lines.
    lines: Option<DigitalLines>,
}

/// The settings of a barrier in physical units instead of counts and scans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Protection {
    /// Machine number, which seeds the checksum.
    pub machine: u16,
    /// Largest correction of linear axes in either direction.
    pub limit: Mm,
    /// Largest correction of rotary axes in either direction.
    pub limit_rotary: Rad,
    /// Largest change of the correction of a linear axis per second.
    pub rate_per_s: Mm,
    /// Largest change of the correction of a rotary axis per second.
    pub rate_rotary_per_s: Rad,
    /// Maximum age of the report that a frame answers.
    pub hold: Duration,
    /// Time without a frame after which the correction ramps to zero.
    pub time_out: Duration,
    /// Scan period of the control.
    pub scan: Duration,
}

impl Default for Protection {
    /// Settings for simulated machines: 250 µm and 250 µrad, 1000 µm/s and 1000 µrad/s (twice the
    /// slew of the simulated machine's guard), frames at most 50 ms old, a timeout of 200 ms, a
    /// scan every 2 ms.
    fn default() -> Self {
        Self {
            machine: 1,
            limit: Mm(0.25),
            limit_rotary: Rad(0.000_25),
            rate_per_s: Mm(1.0),
            rate_rotary_per_s: Rad(0.001),
            hold: Duration::from_millis(50),
            time_out: Duration::from_millis(200),
            scan: Duration::from_millis(2),
        }
    }
}

impl Protection {
    /// Converts to whole counts of these axes and whole scans. Limits and rates are rounded down; a rate below one
    /// count per scan yields several scans per step. If the device cannot represent the limit of an axis, the axis gets
    /// the largest limit that the device can represent.
    ///
    /// # Errors
    /// [`SettingsError`] if a limit is below one step of its axis, the times are inconsistent, there is no axis, or an
    /// axis is named twice.
    pub fn settings(&self, axes: &[Axis]) -> Result<Settings, SettingsError> {
        let layout = Layout::of(axes.iter().map(|axis| axis.name))?;
        let step_scans =
            axes.iter().map(|axis| 1.0 / self.counts_in_a_scan(axis)).fold(1.0, f64::max);
        // A rate too slow to be represented becomes zero counts in the longest step time, and is
        // rejected below.
        let step_scans = whole(libm::ceil(step_scans - 1e-9));
        let (mut limit, mut rate) = (Counts::default(), Counts::default());
        for ((limit, rate), axis) in limit.iter_mut().zip(&mut rate).zip(axes) {
            let most = match axis.kind() {
                AxisKind::Linear => self.limit.0,
                AxisKind::Rotary => self.limit_rotary.0,
            };
            let most = axis.largest.map_or(most, |largest| most.min(largest.mm_or_rad()));
            *limit = counts(most / axis.step());
            *rate = counts(self.counts_in_a_scan(axis) * f64::from(step_scans));
        }
        let settings = Settings {
            axes: layout,
            machine: self.machine,
            limit,
            rate,
            step_scans,
            hold_scans: whole(libm::floor(self.scans(self.hold) + 1e-9)),
            time_out_scans: whole(libm::ceil(self.scans(self.time_out) - 1e-9)),
        };
        settings.check()?;
        Ok(settings)
    }

    fn scans(&self, time: Duration) -> f64 {
        time.as_secs_f64() / self.scan.as_secs_f64()
    }

    fn counts_in_a_scan(&self, axis: &Axis) -> f64 {
        let rate = match axis.kind() {
            AxisKind::Linear => self.rate_per_s.0,
            AxisKind::Rotary => self.rate_rotary_per_s.0,
        };
        rate * self.scan.as_secs_f64() / axis.step()
    }
}

/// Rounds down to whole counts, tolerating rounding errors; 0 for NaN.
#[expect(clippy::cast_possible_truncation, reason = "held within the range")]
fn counts(number: f64) -> i16 {
    libm::floor(number + 1e-9).clamp(0.0, f64::from(i16::MAX)) as i16
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "held within the range"
)]
fn whole(number: f64) -> u16 {
    number.clamp(0.0, f64::from(u16::MAX)) as u16
}

impl Program {
    /// The barrier of a control that is switched on for the first time, with nothing applied.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn new(settings: Settings) -> Result<Self, SettingsError> {
        let barrier = Barrier::start(settings, 0, 0, &Counts::default())?;
        Ok(Self { barrier, lines: None })
    }

    /// The barrier in its present state.
    #[must_use]
    pub fn barrier(&self) -> &Barrier {
        &self.barrier
    }
}

fn words(report: &Report) -> Words {
    let mut words = [0; REPORT_WORDS];
    let length = report.encode(&mut words);
    // A report is shorter than the capacity of a block.
    Words::new(&words[..length]).unwrap_or_default()
}

const _: () = assert!(REPORT_WORDS <= volcomp_port::MOST_WORDS);

impl ControlProgram for Program {
    fn scan(&mut self, mailboxes: &[&[u16]], holds: bool) -> Words {
        let lines = self.lines.as_ref();
        words(&self.barrier.scan_with(mailboxes, lines, holds))
    }

    fn lines(&mut self, latch: bool, axis: usize, value: i16) {
        self.lines = Some(DigitalLines { latch, axis, value });
    }

    fn applied(&self) -> PerChannel<i16> {
        self.barrier.memory().applied
    }

    fn restart(&mut self, applied: &PerChannel<i16>) {
        let (settings, epoch) = (self.barrier.report().settings, self.barrier.memory().link.epoch);
        // The tick restarts: only the epoch is retained. The settings were accepted before.
        if let Ok(started) = Barrier::start(settings, epoch, 0, applied) {
            self.barrier = started;
        }
    }
}
