use std::{
    array,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use volcomp_vocabulary::{MAX_AXES, PerChannel};

/// The corrections applied to the axes of a simulated machine. There is one record per scan of the control, or per
/// write if the control runs no program. The log can be read from any thread without side effects.
///
/// When the control restarts ([`Controls::clear_applied`](super::Controls::clear_applied)), the changes of its words do
/// not count, because the axes have no power.
#[derive(Debug, Default)]
pub struct AxisLog {
    scans: AtomicU64,
    /// Correction of each axis, as the bits of an `f64`.
    applied: [AtomicU64; MAX_AXES],
    largest_change: [AtomicU64; MAX_AXES],
    furthest: [AtomicU64; MAX_AXES],
    changes_while_held: AtomicU64,
    records: AtomicBool,
    recorded: Mutex<Vec<Given>>,
}

/// The corrections that were applied in one scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given {
    /// Time of the scan on the clock of the machine.
    pub at: Duration,
    /// Applied correction of each axis, mm and rad.
    pub applied: PerChannel<f64>,
    /// Whether the axes were held by an emergency stop, by an alarm, or because an axis was not referenced.
    pub held: bool,
}

fn load(bits: &[AtomicU64; MAX_AXES]) -> PerChannel<f64> {
    PerChannel::from_fn(|axis| f64::from_bits(bits[axis].load(Ordering::Relaxed)))
}

/// Replaces the stored number by `value` if `value` is larger. Negative values are invalid, because their bit patterns
/// are not ordered like the numbers.
fn raise(bits: &AtomicU64, value: f64) {
    bits.fetch_max(value.to_bits(), Ordering::Relaxed);
}

impl AxisLog {
    /// Number of scans since the start, or number of writes if the control runs no program.
    pub fn scans(&self) -> u64 {
        self.scans.load(Ordering::Relaxed)
    }

    /// Correction that is applied to each axis at present, mm and rad.
    pub fn applied(&self) -> PerChannel<f64> {
        load(&self.applied)
    }

    /// Largest change of each axis between consecutive scans since [`forget`](Self::forget), mm and rad.
    pub fn largest_change(&self) -> PerChannel<f64> {
        load(&self.largest_change)
    }

    /// Largest magnitude of the correction of each axis since [`forget`](Self::forget), mm and rad.
    pub fn furthest(&self) -> PerChannel<f64> {
        load(&self.furthest)
    }

    /// Number of scans since [`forget`](Self::forget) that changed a correction during an emergency stop or alarm, or
    /// while an axis was not referenced.
    pub fn changes_while_held(&self) -> u64 {
        self.changes_while_held.load(Ordering::Relaxed)
    }

    /// Resets the largest changes, the largest corrections, the changes while held, and the recorded scans.
    pub fn forget(&self) {
        for bits in self.largest_change.iter().chain(&self.furthest) {
            bits.store(0, Ordering::Relaxed);
        }
        self.changes_while_held.store(0, Ordering::Relaxed);
        self.lock().clear();
    }

    /// Records the next `most` scans, for [`recorded`](Self::recorded). Allocates in this call, so that scans do not
    /// allocate.
    pub fn record(&self, most: usize) {
        *self.lock() = Vec::with_capacity(most);
        self.records.store(most > 0, Ordering::Relaxed);
    }

    /// The scans recorded since the last call of [`record`](Self::record) or [`forget`](Self::forget).
    pub fn recorded(&self) -> Vec<Given> {
        self.lock().clone()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<Given>> {
        self.recorded.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn push(&self, given: &Given) {
        let before = self.applied();
        let changes: [f64; MAX_AXES] = array::from_fn(|i| (given.applied[i] - before[i]).abs());
        for (axis, change) in changes.iter().enumerate() {
            raise(&self.largest_change[axis], *change);
            raise(&self.furthest[axis], given.applied[axis].abs());
        }
        let changed = given.held && changes.iter().any(|change| *change > 0.0);
        self.changes_while_held.fetch_add(changed.into(), Ordering::Relaxed);
        self.start_at(&given.applied);
        self.scans.fetch_add(1, Ordering::Relaxed);
        if self.records.load(Ordering::Relaxed) {
            let mut recorded = self.lock();
            if recorded.len() < recorded.capacity() {
                recorded.push(*given);
            }
        }
    }

    pub(super) fn start_at(&self, applied: &PerChannel<f64>) {
        for (bits, value) in self.applied.iter().zip(applied) {
            bits.store(value.to_bits(), Ordering::Relaxed);
        }
    }
}
