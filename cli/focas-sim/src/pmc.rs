//! Programs in the PMC of the simulated control: the barrier, and map interpolation.
//!
//! The barrier runs with the given options; its ladder is generated from them. Map interpolation runs the reference
//! implementation in `volcomp-tables`.

use std::time::Duration;

use volcomp_focas::{
    PmcAddress, PmcArea,
    simulator::{BarrierLadder, Ladder, LadderProgram, World},
};
use volcomp_guard::{
    barrier::{self, Program, Protection, SettingsError},
    protocol::{Counts, Layout},
};
use volcomp_port::Axis;
use volcomp_tables::{
    GRID_AXES, OUTPUTS,
    control::{FRAME_WORDS, Lookup, REPORT_WORDS, Settings},
};
use volcomp_vocabulary::{AxisKind, AxisName, Um, Urad};

use crate::error::{SimError, count, duration, letters};

/// The barrier in the control: it validates frames and moves the shifts at its own rate.
#[derive(clap::Args)]
#[command(next_help_heading = "Barrier")]
pub(crate) struct BarrierArguments {
    /// No barrier: the axes take the shifts written from R100 on as they come
    #[arg(long)]
    no_barrier: bool,
    /// Axes that the barrier corrects, in the order of its frames [default: all]
    #[arg(long, value_name = "LETTERS", value_delimiter = ',', conflicts_with = "no_barrier")]
    barrier_axes: Vec<AxisName>,
    /// Machine number; frames for another one are refused
    #[arg(long, value_name = "NUMBER", default_value_t = 1, conflicts_with = "no_barrier")]
    machine_number: u16,
    /// Largest correction of a linear axis, µm
    #[arg(long, value_name = "UM", default_value_t = 150.0, conflicts_with = "no_barrier")]
    limit_um: f64,
    /// Largest correction of a rotary axis, µrad
    #[arg(long, value_name = "URAD", default_value_t = 2000.0, conflicts_with = "no_barrier")]
    limit_urad: f64,
    /// Maximum rate of the correction of a linear axis, µm/s
    #[arg(long, value_name = "UM_PER_S", default_value_t = 1000.0, conflicts_with = "no_barrier")]
    rate_um_per_s: f64,
    /// Maximum rate of the correction of a rotary axis, µrad/s
    #[arg(
        long,
        value_name = "URAD_PER_S",
        default_value_t = 10_000.0,
        conflicts_with = "no_barrier"
    )]
    rate_urad_per_s: f64,
    /// Maximum age of the report that a frame answers, ms
    #[arg(long, value_name = "MS", default_value_t = 200.0, conflicts_with = "no_barrier")]
    hold_ms: f64,
    /// Time without a frame after which the correction ramps to zero, ms: at least twice --hold-ms
    #[arg(long, value_name = "MS", default_value_t = 450.0, conflicts_with = "no_barrier")]
    time_out_ms: f64,
    /// Instead of the barrier use a map of at most this number of words, 69 to 2450: frames from D0, report from D144,
    /// buffers from D200 on
    #[arg(long, value_name = "WORDS", conflicts_with = "no_barrier", value_parser = clap::value_parser!(u16).range(69..=i64::from(MOST_WORDS)))]
    map_words: Option<u16>,
    /// Scan time of the control's program, ms: 0.1 to 1000
    #[arg(long, value_name = "MS", default_value_t = 2.0)]
    scan_ms: f64,
}

impl BarrierArguments {
    pub(crate) fn scan(&self) -> Result<Duration, SimError> {
        let scan = duration("--scan-ms", self.scan_ms, 1e-3)?;
        if (Duration::from_micros(100)..=Duration::from_secs(1)).contains(&scan) {
            Ok(scan)
        } else {
            let found = self.scan_ms.to_string();
            Err(SimError::input("--scan-ms", found, "0.1 to 1000"))
        }
    }

    fn corrected<'a>(&'a self, axes: &'a [AxisName]) -> &'a [AxisName] {
        if self.barrier_axes.is_empty() { axes } else { &self.barrier_axes }
    }

    /// Machine number and axes in the barrier's report; `None` without a barrier.
    pub(crate) fn reports(&self, axes: &[AxisName]) -> Result<Option<(u16, Layout)>, SimError> {
        if self.no_barrier || self.map_words.is_some() {
            return Ok(None);
        }
        let layout =
            Layout::of(self.corrected(axes).iter().copied()).map_err(SettingsError::from)?;
        Ok(Some((self.machine_number, layout)))
    }

    /// The program with the barrier or the map, for a control with these axes; `None` with `--no-barrier`.
    pub(crate) fn ladder(&self, axes: &[AxisName]) -> Result<Option<Ladder>, SimError> {
        if self.no_barrier {
            return Ok(None);
        }
        let corrected = self.corrected(axes);
        let mut slots = Vec::new();
        for name in corrected {
            let slot = axes.iter().position(|axis| axis == name);
            match slot.filter(|slot| !slots.contains(slot)) {
                Some(slot) => slots.push(slot),
                None => {
                    return Err(SimError::input(
                        "--barrier-axes",
                        letters(corrected),
                        format!("axes of {}, every one once", letters(axes)),
                    ));
                }
            }
        }
        if let Some(capacity) = self.map_words {
            return self.map(corrected, slots, capacity).map(Some);
        }
        for (option, found, unit) in [
            ("--limit-um", self.limit_um, count(AxisKind::Linear)),
            ("--limit-urad", self.limit_urad, count(AxisKind::Rotary)),
        ] {
            let most = f64::from(i16::MAX) * unit.um_or_urad();
            if found > most {
                let expected = format!("at most {most:.0}, 32767 counts of the barrier");
                return Err(SimError::input(option, found.to_string(), expected));
            }
        }
        let protection = Protection {
            machine: self.machine_number,
            limit: Um(self.limit_um).to_mm(),
            limit_rotary: Urad(self.limit_urad).to_rad(),
            rate_per_s: Um(self.rate_um_per_s).to_mm(),
            rate_rotary_per_s: Urad(self.rate_urad_per_s).to_rad(),
            hold: duration("--hold-ms", self.hold_ms, 1e-3)?,
            time_out: duration("--time-out-ms", self.time_out_ms, 1e-3)?,
            scan: self.scan()?,
        };
        let of: Vec<Axis> = corrected.iter().map(|name| axis(*name)).collect();
        let program = Program::new(protection.settings(&of)?)?;
        let mut ladder = BarrierLadder::new(Box::new(program), slots.len());
        ladder.slots = slots;
        Ok(Some(Ladder::Barrier(ladder)))
    }

    fn map(&self, axes: &[AxisName], slots: Vec<usize>, capacity: u16) -> Result<Ladder, SimError> {
        let linear = axes.iter().all(|axis| axis.kind() == AxisKind::Linear);
        if !linear || axes.len() > OUTPUTS {
            let expected = format!("at most {OUTPUTS} linear axes with --map-words");
            return Err(SimError::input("--barrier-axes", letters(axes), expected));
        }
        let scan_ms = self.scan()?.as_secs_f64() * 1e3;
        let whole = |option, found: f64, times: f64, most: u16| {
            // A correction is a whole number of steps of 1 µm, and a time a whole number of scans.
            let number = (found * times).round();
            if (1.0..=f64::from(most)).contains(&number) {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "in range"
                )]
                return Ok(number as u16);
            }
            let expected =
                format!("{} to {} with --map-words", 1.0 / times, f64::from(most) / times);
            Err(SimError::input(option, found.to_string(), expected))
        };
        let steps = i16::MAX.cast_unsigned();
        let set = Set {
            machine: self.machine_number,
            capacity,
            limit: whole("--limit-um", self.limit_um, 1.0, steps)?.cast_signed(),
            rate: whole("--rate-um-per-s", self.rate_um_per_s, scan_ms * 1e-3, steps)?
                .cast_signed(),
            hold_scans: whole("--hold-ms", self.hold_ms, 1.0 / scan_ms, 16_383)?,
            time_out_scans: whole("--time-out-ms", self.time_out_ms, 1.0 / scan_ms, steps)?,
        };
        let layout = Layout::of(axes.iter().copied()).map_err(SettingsError::from)?;
        Ok(Ladder::Own(Box::new(MapLadder::new(layout, slots, &set)?)))
    }
}

fn axis(name: AxisName) -> Axis {
    Axis { name, includes_correction: true, resolution: count(name.kind()), largest: None }
}

/// Byte addresses in data table D: mailbox, report, and the first of the two buffers.
const MAILBOX: u16 = 0;
const REPORT: u16 = 144;
const BUFFERS: u16 = 200;
/// Maximum number of 16-bit words in a buffer. Two buffers fit into the 10 000 bytes of the data table.
const MOST_WORDS: u16 = (10_000 - BUFFERS) / 4;
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
    capacity: u16,
    /// Maximum correction, µm.
    limit: i16,
    /// Maximum change in one scan, µm.
    rate: i16,
    /// Maximum age of the report that a frame answers, scans.
    hold_scans: u16,
    /// Time without a frame after which the correction goes to zero, scans.
    time_out_scans: u16,
}

fn address(at: u16) -> PmcAddress {
    let area = PmcArea::D;
    PmcAddress { area, at }
}

impl MapLadder {
    pub(crate) fn new(
        axes: Layout,
        slots: Vec<usize>,
        set: &Set,
    ) -> Result<Self, volcomp_tables::control::SettingsError> {
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
