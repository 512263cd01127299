//! The machine behind the simulated control, and its memory. Coordinates are as the control counts: mm for linear, deg
//! for rotary axes.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use crate::pmc::{PmcArea, Width};

/// The number of bytes of each PMC area.
const AREA: usize = 10_000;

/// Where the machine zero point shifts of the axes stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShiftArea {
    /// The area of PMC memory.
    pub area: PmcArea,
    /// The byte at which the number of the first axis begins.
    pub first: usize,
    /// The number of bytes of each number.
    pub width: Width,
    /// How far one count moves an axis, mm or deg.
    pub count: f64,
    /// Whether the positions that are told contain the shift.
    pub in_positions: bool,
}

/// Where the axes are after moving for a time, mm or deg.
pub type Motion = Arc<dyn Fn(Duration) -> Vec<f64> + Send + Sync>;

/// The machine and the memory of the control.
pub struct World {
    /// The letters of the axes, in the control's order.
    pub axes: Vec<char>,
    /// How the axes move.
    pub motion: Motion,
    /// Where the shifts are taken from.
    pub shift: ShiftArea,
    /// The time after which a write to PMC memory can be read back and takes effect.
    pub readback_delay: Duration,
    /// The alarms that are on: number and text.
    pub alarms: Vec<(i32, String)>,
    /// Macro variables by number.
    pub macros: BTreeMap<i32, f64>,
    /// Parameters by number and slot.
    pub parameters: BTreeMap<(i32, usize), f64>,
    /// Work offsets by number and slot, mm or deg.
    pub offsets: BTreeMap<(i32, usize), f64>,
    started: Instant,
    /// The time of the motion at which the emergency stop was pressed; `None` where it is released.
    stopped_at: Option<Duration>,
    /// How long the emergency stop was pressed, all times together.
    stood: Duration,
    silent_until: Option<Instant>,
    memory: Vec<Vec<u8>>,
    pending: Vec<(Instant, PmcArea, usize, Vec<u8>)>,
}

impl World {
    /// Axes that stand at 0, referenced, shifts in words of 0.001 from R100 on.
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
            alarms: Vec::new(),
            macros: BTreeMap::new(),
            parameters: BTreeMap::new(),
            offsets: BTreeMap::new(),
            started: Instant::now(),
            stopped_at: None,
            stood: Duration::ZERO,
            silent_until: None,
            memory: vec![vec![0; AREA]; PmcArea::ALL.len()],
            pending: Vec::new(),
        };
        world.set_referenced(true);
        world
    }

    /// Says by the bits of F120 whether the axes are referenced: all of them, or none.
    pub fn set_referenced(&mut self, referenced: bool) {
        self.store(PmcArea::F, 120, &[if referenced { 0xff } else { 0 }]);
    }

    /// Sets the shifts of all axes to zero, as a control does that is switched off and on.
    pub fn clear_shifts(&mut self) {
        let bytes = vec![0; self.axes.len() * usize::from(self.shift.width.bytes())];
        self.pending.clear();
        self.store(self.shift.area, self.shift.first, &bytes);
    }

    /// Lets the control answer nothing for this time from now on, new sessions included. What was asked meanwhile
    /// is answered afterwards.
    pub fn pause(&mut self, time: Duration) {
        self.silent_until = Instant::now().checked_add(time);
    }

    /// For how long the control still answers nothing; `None` where it answers.
    pub(super) fn silence(&self) -> Option<Duration> {
        let left = self.silent_until?.checked_duration_since(Instant::now())?;
        (!left.is_zero()).then_some(left)
    }

    /// Time since the machine was made.
    pub fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    /// Whether the emergency stop is pressed.
    pub fn emergency_stop(&self) -> bool {
        self.stopped_at.is_some()
    }

    /// Presses or releases the emergency stop. While it is pressed the axes stand; afterwards they go on from there.
    pub fn set_emergency_stop(&mut self, pressed: bool) {
        if pressed {
            self.stopped_at = Some(self.moved_for());
        } else if let Some(stopped_at) = self.stopped_at.take() {
            self.stood = self.elapsed().saturating_sub(stopped_at);
        }
    }

    /// How long the axes have been moving: the time since the start without emergency stops.
    fn moved_for(&self) -> Duration {
        let moves = || self.elapsed().saturating_sub(self.stood);
        self.stopped_at.unwrap_or_else(moves)
    }

    /// Where the axes are commanded to be, without shifts, mm or deg.
    pub fn commanded(&self) -> Vec<f64> {
        (self.motion)(self.moved_for())
    }

    /// Where the axes are, as reported, mm or deg.
    pub fn positions(&mut self) -> Vec<f64> {
        let mut positions = self.commanded();
        if self.shift.in_positions {
            let shifts = self.shifts();
            for (position, shift) in positions.iter_mut().zip(shifts) {
                *position += shift;
            }
        }
        positions
    }

    /// The shifts that are in force, mm or deg.
    pub fn shifts(&mut self) -> Vec<f64> {
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
            #[expect(clippy::cast_precision_loss, reason = "four bytes at the most")]
            Some(i64::from_le_bytes(wide) as f64 * shift.count)
        };
        (0..axes)
            .map(count)
            .map(Option::unwrap_or_default)
            .collect()
    }

    /// Bytes of PMC memory as they are seen now.
    pub fn read(&mut self, area: PmcArea, at: usize, length: usize) -> Option<Vec<u8>> {
        let now = Instant::now();
        let (due, later) = std::mem::take(&mut self.pending)
            .into_iter()
            .partition(|(when, ..)| *when <= now);
        self.pending = later;
        for (_, area, at, bytes) in due {
            self.store(area, at, &bytes);
        }
        let memory = self.memory.get(area as usize)?;
        memory.get(at..at.checked_add(length)?).map(<[u8]>::to_vec)
    }

    /// Writes PMC memory; `false` outside it.
    pub fn write(&mut self, area: PmcArea, at: usize, bytes: &[u8]) -> bool {
        if at.checked_add(bytes.len()).is_none_or(|end| end > AREA) {
            return false;
        }
        if self.readback_delay.is_zero() {
            self.store(area, at, bytes);
        } else {
            let when = Instant::now() + self.readback_delay;
            self.pending.push((when, area, at, bytes.to_vec()));
        }
        true
    }

    fn store(&mut self, area: PmcArea, at: usize, bytes: &[u8]) {
        if let Some(memory) = self.memory.get_mut(area as usize)
            && let Some(into) = memory.get_mut(at..at + bytes.len())
        {
            into.copy_from_slice(bytes);
        }
    }
}
