//! The machine behind the simulated control, its memory, and the program in the control. Units are those of the
//! control: mm for linear axes, deg for rotary axes.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_port::ControlProgram;
use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::{
    parameters::UNIT_NUMBERS,
    pmc::{BarrierArea, PmcAddress, PmcArea, Width},
};

/// Size of each PMC area, bytes.
const AREA: usize = 10_000;

/// PMC words of the machine zero point shifts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShiftArea {
    pub area: PmcArea,
    /// First byte of the shift word of the first axis.
    pub first: usize,
    pub width: Width,
    /// Size of one count, mm or deg.
    pub count: f64,
    /// Whether reported positions contain the shift.
    pub in_positions: bool,
}

/// Function from motion time to the commanded positions of the axes, mm or deg. Motion time excludes the time in
/// emergency stop.
pub type Motion = Arc<dyn Fn(Duration) -> Vec<f64> + Send + Sync>;

/// State after a scan of the control, for a log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scan<'a> {
    /// Shifts of all axes after the scan, counts.
    pub shifts: &'a [i64],
    /// Whether the control was power-cycled since the previous scan. If so, changes of the shifts since then are not
    /// steps of the axes, because the drives were off.
    pub switched_on: bool,
}

/// Callback for every scan. It must not block, because the world is locked meanwhile.
pub type ScanLog = Box<dyn FnMut(Scan<'_>) + Send>;

/// The machine and the memory of the control.
pub struct World {
    /// Axis letters, in the control's order.
    pub axes: Vec<char>,
    pub motion: Motion,
    pub shift: ShiftArea,
    /// Delay after which a write to PMC memory can be read back and takes effect.
    pub readback_delay: Duration,
    /// Program that runs in the control; `None` if the axes take the shift words directly.
    pub ladder: Option<Ladder>,
    pub scan: Duration,
    /// Delay of each response, in addition to [`Options::latency`](super::Options::latency).
    pub latency: Duration,
    /// Whether the control reports the source of the shifts in parameters 1203 and 1280.
    pub reports_shift_source: bool,
    /// Number and text of each active alarm.
    pub alarms: Vec<(i32, String)>,
    pub scan_log: Option<ScanLog>,
    pub macros: BTreeMap<i32, f64>,
    /// Parameters by number and axis index.
    pub parameters: BTreeMap<(i32, usize), f64>,
    /// Work offsets by number and axis index, mm or deg.
    pub offsets: BTreeMap<(i32, usize), f64>,
    started: Instant,
    /// Motion time at which the emergency stop was pressed; `None` while it is released.
    stopped_at: Option<Duration>,
    /// Total time for which the emergency stop was pressed before.
    stop_time: Duration,
    silent_until: Option<Instant>,
    /// Digital lines to the control: level of the latch line, axis index, counts; `None` if the lines are not used.
    lines: Option<(bool, usize, i16)>,
    memory: Vec<Vec<u8>>,
    pending: Vec<(Instant, PmcArea, usize, Vec<u8>)>,
    /// Number of bytes of the next write that arrive at once, if the write is longer. The rest arrives two scans later.
    /// `None` if writes arrive whole.
    tear: Option<usize>,
    frozen: Option<Vec<f64>>,
    /// Whether positions of linear axes are reported in inches.
    inches: bool,
    scanned: Vec<i64>,
    /// Largest change of each shift between two consecutive scans, counts.
    largest_steps: Vec<i64>,
    /// Whether the control was power-cycled since the last scan.
    switched_on: bool,
}

impl World {
    /// Creates a machine with these axes at 0 and referenced. Its shift words have counts of 0.001 mm or deg and start
    /// at R100.
    pub fn new(axes: &[char]) -> Self {
        let count = axes.len();
        let mut world = Self {
            axes: axes.to_vec(),
            motion: Arc::new(move |_| vec![0.0; count]),
            shift: ShiftArea {
                area: PmcArea::R,
                first: 100,
                width: Width::Word,
                count: 0.001,
                in_positions: false,
            },
            readback_delay: Duration::ZERO,
            ladder: None,
            scan: Duration::from_millis(2),
            latency: Duration::ZERO,
            reports_shift_source: true,
            alarms: Vec::new(),
            scan_log: None,
            macros: BTreeMap::new(),
            parameters: BTreeMap::new(),
            offsets: BTreeMap::new(),
            started: Instant::now(),
            stopped_at: None,
            stop_time: Duration::ZERO,
            silent_until: None,
            lines: None,
            memory: vec![vec![0; AREA]; PmcArea::ALL.len()],
            pending: Vec::new(),
            tear: None,
            frozen: None,
            inches: false,
            scanned: Vec::new(),
            largest_steps: vec![0; count],
            switched_on: false,
        };
        world.set_referenced(true);
        world
    }

    /// Sets the reference bits in F120 for all axes, or clears them.
    pub fn set_referenced(&mut self, referenced: bool) {
        self.set(PmcArea::F, 120, &[if referenced { 0xff } else { 0 }]);
    }

    /// Adds a barrier for all axes to this control, with one mailbox from R200 and the report from R240.
    #[must_use]
    pub fn with_barrier(mut self, program: Box<dyn ControlProgram>) -> Self {
        let axes = self.axes.len();
        self.ladder = Some(Ladder::Barrier(BarrierLadder::new(program, axes)));
        self
    }

    pub(super) fn run_scan(&mut self) {
        if let Some(mut ladder) = self.ladder.take() {
            ladder.scan(self);
            self.ladder = Some(ladder);
        }
        let now = self.shift_counts();
        self.largest_steps.resize(now.len(), 0);
        for (largest, (now, before)) in
            self.largest_steps.iter_mut().zip(now.iter().zip(&self.scanned))
        {
            *largest = (*largest).max((now - before).abs());
        }
        let switched_on = std::mem::take(&mut self.switched_on);
        if let Some(log) = &mut self.scan_log {
            log(Scan { shifts: &now, switched_on });
        }
        self.scanned = now;
    }

    /// Sets the digital lines to the control: `value` (counts) for the axis with this index in the program, and the
    /// level of the latch line, which toggles after the other lines have settled. The program determines the effect of
    /// the lines.
    pub fn set_lines(&mut self, latch: bool, axis: usize, value: i16) {
        self.lines = Some((latch, axis, value));
    }

    pub(super) fn lines(&self) -> Option<(bool, usize, i16)> {
        self.lines
    }

    /// Largest change of each axis's shift between two consecutive scans, counts, since the start or the last
    /// [`reset_largest_steps`](Self::reset_largest_steps).
    pub fn largest_steps(&self) -> &[i64] {
        &self.largest_steps
    }

    /// Sets [`largest_steps`](Self::largest_steps) to zero.
    pub fn reset_largest_steps(&mut self) {
        self.largest_steps.fill(0);
    }

    /// Resets the control. Its program restarts, and the shift words of the axes keep their values.
    pub fn reset(&mut self) {
        if let Some(mut ladder) = self.ladder.take() {
            ladder.restart(self);
            self.ladder = Some(ladder);
        }
    }

    /// Power-cycles the control. The R memory is cleared, and the program restarts with zero shifts. The change of the
    /// shifts is not a step, because the drives are off.
    pub fn power_up(&mut self) {
        self.pending.clear();
        if let Some(memory) = self.memory.get_mut(PmcArea::R as usize) {
            memory.fill(0);
        }
        self.clear_shifts();
    }

    /// Sets the shifts of all axes to zero, as a power cycle does.
    pub fn clear_shifts(&mut self) {
        let bytes = vec![0; self.axes.len() * usize::from(self.shift.width.bytes())];
        self.pending.clear();
        self.set(self.shift.area, self.shift.first, &bytes);
        self.reset();
        self.scanned = self.shift_counts();
        self.switched_on = true;
    }

    /// Freezes the reported positions at their present values, or ends the freeze.
    pub fn freeze_positions(&mut self, frozen: bool) {
        self.frozen = None;
        self.frozen = frozen.then(|| self.positions());
    }

    /// Reports positions of linear axes in inches, like a control with parameter 3104#0 = 1 after G20; or in mm again.
    pub fn report_inches(&mut self, inches: bool) {
        self.inches = inches;
        let [_, in_unit_of_program, program] = UNIT_NUMBERS;
        let [of_program, unit] = if inches { [1.0, 4.0] } else { [0.0, 0.0] };
        self.parameters.insert((in_unit_of_program, 0), of_program);
        self.parameters.insert((program, 0), unit);
    }

    /// Tears the next write of more than `bytes` bytes: its first `bytes` bytes arrive at once, the rest two scans
    /// later.
    pub fn tear_next_write(&mut self, bytes: usize) {
        self.tear = Some(bytes);
    }

    /// Whether the control holds its axes because of an emergency stop, an alarm, or an axis that is not referenced.
    pub fn holds(&mut self) -> bool {
        let bits = self.read(PmcArea::F, 120, 1);
        let bits = bits.and_then(|bytes| bytes.first().copied()).unwrap_or(0);
        // A byte covers eight axes.
        let referenced = (0..self.axes.len().min(8)).all(|slot| bits >> slot & 1 == 1);
        self.emergency_stop() || !self.alarms.is_empty() || !referenced
    }

    /// Delays all responses until this time has passed, also responses to new sessions. Requests received during the
    /// pause are answered after it.
    pub fn pause(&mut self, time: Duration) {
        self.silent_until = Instant::now().checked_add(time);
    }

    /// Remaining time of the pause; `None` outside a pause.
    pub(super) fn silence(&self) -> Option<Duration> {
        let left = self.silent_until?.checked_duration_since(Instant::now())?;
        (!left.is_zero()).then_some(left)
    }

    /// Time since the machine was created.
    pub fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    pub fn emergency_stop(&self) -> bool {
        self.stopped_at.is_some()
    }

    /// Presses or releases the emergency stop. The axes stop while it is pressed, and continue when it is released.
    pub fn set_emergency_stop(&mut self, pressed: bool) {
        if pressed {
            self.stopped_at = Some(self.moved_for());
        } else if let Some(stopped_at) = self.stopped_at.take() {
            self.stop_time = self.elapsed().saturating_sub(stopped_at);
        }
    }

    /// Motion time: time since the start, without the time in emergency stop.
    pub fn moved_for(&self) -> Duration {
        let moves = || self.elapsed().saturating_sub(self.stop_time);
        self.stopped_at.unwrap_or_else(moves)
    }

    /// Present commanded positions of the axes, without shifts, mm or deg.
    pub fn commanded(&self) -> Vec<f64> {
        (self.motion)(self.moved_for())
    }

    /// Present reported positions of the axes, mm or deg. Linear positions are in inches after
    /// [`report_inches`](Self::report_inches).
    pub fn positions(&mut self) -> Vec<f64> {
        if let Some(frozen) = &self.frozen {
            return frozen.clone();
        }
        let mut positions = self.commanded();
        if self.shift.in_positions {
            let shifts = self.shifts();
            for (position, shift) in positions.iter_mut().zip(shifts) {
                *position += shift;
            }
        }
        if self.inches {
            let linear = |axis: &char| !matches!(axis, 'A' | 'B' | 'C');
            for (position, _) in
                positions.iter_mut().zip(&self.axes).filter(|(_, axis)| linear(axis))
            {
                *position /= 25.4;
            }
        }
        positions
    }

    /// Active shift of each axis, mm or deg.
    pub fn shifts(&mut self) -> Vec<f64> {
        let count = self.shift.count;
        #[expect(clippy::cast_precision_loss, reason = "at most four bytes")]
        let shift = |counts: i64| counts as f64 * count;
        self.shift_counts().into_iter().map(shift).collect()
    }

    /// Active shift of each axis, counts.
    pub fn shift_counts(&mut self) -> Vec<i64> {
        let shift = self.shift;
        let width = usize::from(shift.width.bytes());
        let axes = self.axes.len();
        let count = |slot: usize| {
            let bytes = self.read(shift.area, shift.first + slot * width, width)?;
            // Memory is little-endian.
            let mut wide = match bytes.last() {
                Some(high) if high & 0x80 != 0 => [0xff; 8],
                _ => [0; 8],
            };
            wide[..width].copy_from_slice(&bytes);
            Some(i64::from_le_bytes(wide))
        };
        (0..axes).map(count).map(Option::unwrap_or_default).collect()
    }

    /// Sets the shift of the axis with this index in the control. `counts` is in counts.
    pub fn set_shift(&mut self, slot: usize, counts: i64) {
        let (shift, width) = (self.shift, usize::from(self.shift.width.bytes()));
        let bytes = counts.to_le_bytes();
        self.set(shift.area, shift.first + slot * width, &bytes[..width]);
    }

    /// Reads words of PMC memory, low byte first. Returns no words if they extend beyond the end of the memory.
    pub fn words(&mut self, first: PmcAddress, count: usize) -> Vec<u16> {
        let bytes = self.read(first.area, first.at.into(), 2 * count);
        let word = |bytes: &[u8]| u16::from_le_bytes([bytes[0], bytes[1]]);
        bytes.unwrap_or_default().chunks_exact(2).map(word).collect()
    }

    /// Sets words of PMC memory immediately, regardless of `readback_delay`.
    pub fn set_words(&mut self, first: PmcAddress, words: &[u16]) {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        self.set(first.area, first.at.into(), &bytes);
    }

    /// Reads the bytes of PMC memory that are visible at this time (see `readback_delay`); `None` if they extend beyond
    /// the end of the memory.
    pub fn read(&mut self, area: PmcArea, at: usize, length: usize) -> Option<Vec<u8>> {
        let now = Instant::now();
        let (due, later) =
            std::mem::take(&mut self.pending).into_iter().partition(|(when, ..)| *when <= now);
        self.pending = later;
        for (_, area, at, bytes) in due {
            self.set(area, at, &bytes);
        }
        let memory = self.memory.get(area as usize)?;
        memory.get(at..at.checked_add(length)?).map(<[u8]>::to_vec)
    }

    /// Writes bytes to PMC memory, which take effect after `readback_delay`. Returns `false` if the bytes are outside
    /// the memory.
    pub fn write(&mut self, area: PmcArea, at: usize, bytes: &[u8]) -> bool {
        if at.checked_add(bytes.len()).is_none_or(|end| end > AREA) {
            return false;
        }
        let now = Instant::now();
        let (first, rest) = match self.tear.filter(|first| *first < bytes.len()) {
            Some(first) => {
                self.tear = None;
                bytes.split_at(first)
            }
            None => (bytes, &[][..]),
        };
        if self.readback_delay.is_zero() {
            self.set(area, at, first);
        } else {
            let when = now + self.readback_delay;
            self.pending.push((when, area, at, first.to_vec()));
        }
        if !rest.is_empty() {
            let when = now + self.readback_delay + 2 * self.scan;
            let at = at + first.len();
            self.pending.push((when, area, at, rest.to_vec()));
        }
        true
    }

    /// Sets bytes of PMC memory immediately, regardless of `readback_delay`. Does nothing if the bytes are outside the
    /// memory.
    pub fn set(&mut self, area: PmcArea, at: usize, bytes: &[u8]) {
        if let Some(memory) = self.memory.get_mut(area as usize)
            && let Some(end) = at.checked_add(bytes.len())
            && let Some(into) = memory.get_mut(at..end)
        {
            into.copy_from_slice(bytes);
        }
    }
}

/// The program of the simulated control, which runs once per scan.
pub enum Ladder {
    /// A barrier. It validates frames, moves the shifts at its own rate, and sends reports.
    Barrier(BarrierLadder),
    Own(Box<dyn LadderProgram>),
}

pub trait LadderProgram: Send {
    /// Runs one scan. The program reads and writes PMC memory, and sets the shifts of the axes.
    fn scan(&mut self, world: &mut World);

    /// Restarts the program, as after a reset. The shift words of the axes contain the present shifts.
    fn restart(&mut self, world: &mut World);
}

/// A barrier as the program of the control, with its PMC addresses.
pub struct BarrierLadder {
    pub program: Box<dyn ControlProgram>,
    /// First byte of each mailbox for frames.
    pub frames: Vec<PmcAddress>,
    /// First byte of the report.
    pub report: PmcAddress,
    /// Index in the control of each of the barrier's axes, from 0, in channel order.
    pub slots: Vec<usize>,
}

impl BarrierLadder {
    /// Creates a barrier for the control's first `axes` axes, with one mailbox from R200 and the report from R240.
    pub fn new(program: Box<dyn ControlProgram>, axes: usize) -> Self {
        let address = |at| PmcAddress { area: PmcArea::R, at };
        Self {
            program,
            frames: vec![address(200)],
            report: address(240),
            slots: (0..axes.min(MAX_AXES)).collect(),
        }
    }

    fn scan(&mut self, world: &mut World) {
        let words = BarrierArea::frame_words(self.slots.len());
        // Like a ladder, copy the frames before they are validated.
        let frames: Vec<Vec<u16>> = self.frames.iter().map(|at| world.words(*at, words)).collect();
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
