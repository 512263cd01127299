//! A controller with faults.

use std::time::Instant;

use rand::RngExt;
use volcomp_vocabulary::PerChannel;

use super::{Faulty, Lie, faulty::MOST_LAG, held::Write};
use crate::{Controller, ControllerState, Description, Fault, Snapshot, Words};

/// The maximum error of a wrong read-back, steps.
const MOST_STEPS: f64 = 5000.0;

fn deliver<C: Controller>(device: &mut C, write: &Write, deadline: Instant) -> Result<(), Fault> {
    match write {
        Write::Frame(frame) => device.post(frame, deadline),
        Write::Values(values) => device.apply(values, deadline),
        Write::Levels(_) => Ok(()),
    }
}

impl<C: Controller> Controller for Faulty<C> {
    fn description(&self) -> &Description {
        self.device.description()
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        self.before(deadline)?;
        self.deliver_due(deliver);
        if self.is_frozen()
            && let Some(last) = self.last_snapshot
        {
            return Ok(last);
        }
        let mut snapshot = self.device.read(deadline)?;
        let late = self.way_back(deadline);
        // A driver takes the middle of the exchange.
        snapshot.taken += late / 2;
        snapshot.state_taken += late / 2;
        snapshot.correction_taken += late / 2;
        snapshot.uncertainty += late / 2;
        self.last_snapshot = Some(snapshot);
        let axes = self.device.description().axes.len().max(1);
        if self.happens(self.faults.corrupt) {
            let axis = self.random.random_range(0..axes);
            snapshot.positions[axis] = self.broken_number(snapshot.positions[axis]);
        }
        self.draw_reading(axes);
        self.spoil_positions(&mut snapshot);
        self.spoil_read_back(&mut snapshot, axes);
        if self.asked.dropped_flag > 0 {
            self.asked.dropped_flag -= 1;
            snapshot.state = ControllerState {
                referenced: true,
                alarm: false,
                emergency_stop: false,
            };
        }
        self.after_reading();
        Ok(snapshot)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        self.put(Write::Frame(*frame), deadline, deliver)
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        self.put(Write::Values(*corrections), deadline, deliver)
    }
}

impl<C: Controller> Faulty<C> {
    fn spoil_positions(&mut self, snapshot: &mut Snapshot) {
        self.positions[self.readings % MOST_LAG] = snapshot.positions;
        let lag = usize::try_from(self.faults.lag).unwrap_or(MOST_LAG);
        let lag = lag.min(MOST_LAG - 1).min(self.readings);
        snapshot.positions = self.positions[(self.readings - lag) % MOST_LAG];
        self.readings += 1;
        if self.asked.frozen_positions > 0 {
            self.asked.frozen_positions -= 1;
            let frozen = self.asked.frozen_at.get_or_insert(snapshot.positions);
            snapshot.positions = *frozen;
        } else {
            self.asked.frozen_at = None;
        }
        if let Some((axis, factor, add, readings)) = self.asked.wrong_position {
            if let Some(position) = snapshot.positions.get_mut(axis) {
                *position = *position * factor + add;
            }
            let left = readings - 1;
            self.asked.wrong_position = (left > 0).then_some((axis, factor, add, left));
        }
        if let Some(index) = self.asked.flicker.take()
            && let Some(axis) = self.device.description().axes.get(index)
        {
            snapshot.positions[index] += axis.step();
        }
    }

    fn spoil_read_back(&mut self, snapshot: &mut Snapshot, axes: usize) {
        let before = self.last_true.replace(*snapshot).unwrap_or(*snapshot);
        if self.asked.constant > 0 {
            self.asked.constant -= 1;
            let of = self.asked.constant_of.get_or_insert(*snapshot);
            (snapshot.applied, snapshot.report) = (of.applied, of.report);
        }
        let Some((lie, readings)) = self.asked.lie else {
            return;
        };
        self.asked.lie = (readings > 1).then(|| (lie, readings - 1));
        if readings == 0 {
            return;
        }
        let [one, other] = self.two_of(axes);
        if let Some(applied) = &mut snapshot.applied {
            match lie {
                Lie::Value => {
                    let step = self
                        .device
                        .description()
                        .axes
                        .get(one)
                        .map_or(0.0, crate::Axis::step);
                    let steps = self.random.random_range(1.0..MOST_STEPS).round();
                    let sign = if self.random.random() { 1.0 } else { -1.0 };
                    applied[one] += sign * steps * step;
                }
                Lie::NotANumber => applied[one] = f64::NAN,
                Lie::OtherAxis => applied.swap(one, other),
                Lie::Torn => applied[one] = before.applied.map_or(0.0, |before| before[one]),
                Lie::Zero => *applied = PerChannel::ZERO,
            }
        }
        if let Some(report) = &mut snapshot.report {
            let [one, other] = self.two_of(report.as_slice().len());
            let words = report.as_mut_slice();
            match lie {
                Lie::Value => {
                    if let Some(word) = words.get_mut(one) {
                        *word = self.random.random();
                    }
                }
                Lie::NotANumber => words.fill(u16::MAX),
                Lie::OtherAxis => {
                    if one < words.len() && other < words.len() {
                        words.swap(one, other);
                    }
                }
                Lie::Torn => {
                    let old = before.report.unwrap_or_default();
                    let rest = words.iter_mut().zip(old.as_slice()).skip(one + 1);
                    rest.for_each(|(word, old)| *word = *old);
                }
                Lie::Zero => words.fill(0),
            }
        }
    }

    /// Two places of so many, different ones where there are two.
    fn two_of(&mut self, count: usize) -> [usize; 2] {
        let count = count.max(1);
        let one = self.random.random_range(0..count);
        let further = self.random.random_range(0..(count - 1).max(1)) + 1;
        [one, (one + further) % count]
    }
}
