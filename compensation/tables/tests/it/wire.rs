//! A gateway, a control, and a wire that loses, duplicates, delays, reorders and tears frames: the applied correction is always that of a
//! complete map or ramps to zero, and changes at most at its rate.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_tables::{
    GRID_AXES, HEADER_WORDS, Map, NextAction, OUTPUTS, ReadBackResult,
    control::{FRAME_WORDS, Frame, Lookup, REPORT_WORDS, Report, Settings},
    next_write,
    protocol::{Counts, ReportStatus, Session},
};

use crate::world;

/// Probabilities of the wire's faults.
#[derive(Clone, Copy, Debug)]
struct Badness {
    lost: f64,
    torn: f64,
    doubled: f64,
    late: f64,
}

/// Writes in transit, with the scan of their arrival, and the last report.
struct Wire {
    bad: Badness,
    writes: Vec<(usize, Vec<(usize, u16)>)>,
    report: Vec<u16>,
}

impl Wire {
    fn new(bad: Badness) -> Self {
        Self { bad, writes: Vec::new(), report: Vec::new() }
    }

    fn write(&mut self, rng: &mut ChaCha8Rng, scan: usize, words: &[u16; FRAME_WORDS]) {
        let copies = 1 + usize::from(rng.random_bool(self.bad.doubled));
        for _ in 0..copies {
            if rng.random_bool(self.bad.lost) {
                continue;
            }
            let mut arrives = scan + rng.random_range(0..3);
            if rng.random_bool(self.bad.late) {
                arrives += rng.random_range(0..400);
            }
            let all: Vec<(usize, u16)> = words.iter().copied().enumerate().collect();
            if rng.random_bool(self.bad.torn) {
                // The frame is written in two pieces, the second of which arrives later or never.
                let (first, second) = all.split_at(rng.random_range(0..FRAME_WORDS));
                self.writes.push((arrives, first.to_vec()));
                if rng.random_bool(0.7) {
                    self.writes.push((arrives + rng.random_range(1..60), second.to_vec()));
                }
            } else {
                self.writes.push((arrives, all));
            }
        }
    }

    fn arrive(&mut self, scan: usize, mailbox: &mut [u16; FRAME_WORDS]) {
        for (_, words) in self.writes.extract_if(.., |(arrives, _)| *arrives <= scan) {
            for (at, word) in words {
                mailbox[at] = word;
            }
        }
    }

    /// Reading of a gateway: nothing, a report torn from two, or the report.
    fn read(
        &mut self,
        rng: &mut ChaCha8Rng,
        settings: &Settings,
        report: &Report,
    ) -> Option<Report> {
        let mut words = [0; REPORT_WORDS];
        let count = report.encode(&mut words);
        let before = core::mem::replace(&mut self.report, words[..count].to_vec());
        if rng.random_bool(self.bad.lost) {
            return None;
        }
        let mut read = self.report.clone();
        if rng.random_bool(self.bad.torn) && before.len() == count {
            let at = rng.random_range(0..count);
            read[at..].copy_from_slice(&before[at..]);
        }
        Report::decode(settings.outputs.machine, settings.outputs.axes, &read)
    }
}

struct Gateway {
    session: Session,
    map: Map,
    loaded: ReadBackResult,
    /// Maps that were sent; every active map must be one of them.
    sent: Vec<Map>,
}

impl Gateway {
    fn next_map(&mut self, map: Map) {
        self.sent.push(map.clone());
        self.map = map;
        self.loaded = ReadBackResult::Unknown;
    }
}

/// Multilinear interpolation of a map in floating point, without reversals, in parts: an independent implementation of the definition.
fn reference(map: &Map, steps: &[i32; GRID_AXES], output: usize) -> f64 {
    let header = map.header();
    let (axes, outputs) = (header.grid.count(), header.outputs.count());
    let values = &map.words()[HEADER_WORDS..];
    let mut sum = 0.0;
    for corner in 0..1 << axes {
        let (mut weight, mut node) = (1.0, 0);
        for (axis, steps) in steps.iter().enumerate().take(axes) {
            let lines = &header.lines[axis];
            let last = f64::from(lines.count - 1);
            let at = (f64::from(*steps) - f64::from(lines.origin)) / f64::from(lines.pitch());
            let at = at.clamp(0.0, last);
            let line = (0..lines.count - 2).rev().find(|line| at >= f64::from(line + 1));
            let cell = line.map_or(0, |line| line + 1);
            let upper = corner >> axis & 1;
            weight *= if upper == 1 { at - f64::from(cell) } else { 1.0 - (at - f64::from(cell)) };
            node = node * usize::from(lines.count) + usize::from(cell) + upper;
        }
        sum += weight * f64::from(values[node * outputs + output].cast_signed());
    }
    sum
}

/// Effects of the reversals for every combination of directions, in parts.
fn reversals(map: &Map, output: usize) -> Vec<f64> {
    let header = map.header();
    let mut sums = vec![0.0];
    for row in header.reversal.iter().take(header.grid.count()) {
        let half = f64::from(row[output]);
        sums = sums.iter().flat_map(|sum| [*sum, sum + half, sum - half]).collect();
    }
    sums
}

/// Runs a simulation for this number of scans. Returns the number of activated maps.
#[expect(
    clippy::too_many_lines,
    reason = "one world: its wire, its senders, its control and their rules"
)]
fn run(seed: u64, bad: Badness, scans: usize) -> Result<usize, TestCaseError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut settings = world::settings(&mut rng);
    let of = &mut settings.outputs;
    of.time_out_scans = of.time_out_scans.max(30);
    of.hold_scans = of.hold_scans.clamp(4, 15);
    let (machine, axes) = (of.machine, of.axes);
    let outputs = axes.count();
    let mut lookup =
        Lookup::start(settings, rng.random(), rng.random(), [0; OUTPUTS]).expect("sensible");
    let mut gateways: Vec<Gateway> = (0..2)
        .map(|_| {
            let counter = rng.random_range(1..50);
            let map = world::map(&mut rng, &settings, counter);
            Gateway {
                session: Session::new(rng.random_range(1..=u16::MAX)),
                sent: vec![map.clone()],
                map,
                loaded: ReadBackResult::Unknown,
            }
        })
        .collect();
    let mut wires = [Wire::new(bad), Wire::new(bad)];
    let mut mailbox = [0; FRAME_WORDS];
    let mut steps = world::somewhere(&mut rng, gateways[0].map.header());
    let mut alive = [true, rng.random_bool(0.3)];
    let mut holds = false;
    let (mut swaps, mut silent, mut since_taken) = (0, 0_u32, lookup.memory().link.sequence);
    for scan in 0..scans {
        for (gateway, wire) in gateways
            .iter_mut()
            .zip(&mut wires)
            .zip(alive)
            .filter_map(|(both, alive)| alive.then_some(both))
        {
            let Some(seen) = wire.read(&mut rng, &settings, &lookup.report()) else {
                continue;
            };
            if rng.random_bool(0.01) && seen.valid {
                let counter = gateway.map.header().counter + 1;
                gateway.next_map(world::map(&mut rng, &settings, counter));
            }
            let ReportStatus::Confirmed { .. } = gateway.session.read(seen.of.head()) else {
                continue;
            };
            match next_write(&gateway.map, machine, &seen, gateway.loaded) {
                NextAction::Write(body) => {
                    gateway.loaded = ReadBackResult::Unknown;
                    let head = gateway.session.answer().expect("a report was read");
                    wire.write(&mut rng, scan, &Frame { head, body }.encode(machine, axes));
                }
                NextAction::ReadBack { buffer } => {
                    let mut words = lookup.buffer(buffer.into()).to_vec();
                    if rng.random_bool(bad.torn) {
                        words[0] ^= 1;
                    }
                    let same = words.starts_with(gateway.map.words());
                    gateway.loaded =
                        if same { ReadBackResult::Same } else { ReadBackResult::Other };
                }
            }
        }
        for wire in &mut wires {
            wire.arrive(scan, &mut mailbox);
        }
        if rng.random_bool(0.004) {
            alive[0] ^= true;
        }
        if rng.random_bool(0.002) {
            let memory = lookup.memory();
            let applied = memory.applied;
            lookup = Lookup::start(settings, memory.link.epoch, rng.random(), applied)
                .expect("sensible");
            // No map is active before a swap, whatever the mailbox contains.
            prop_assert!(!lookup.report().valid);
            silent = 0;
        }
        holds ^= rng.random_bool(0.02);
        for steps in &mut steps {
            *steps = steps.saturating_add(rng.random_range(-9..=9));
        }
        let before = lookup.memory().clone();
        let report = lookup.scan(&mailbox, &steps, holds);
        let memory = lookup.memory();
        // Corrections change at most at their rate, and not at all while the control holds.
        for output in 0..OUTPUTS {
            let moved =
                (i32::from(memory.applied[output]) - i32::from(before.applied[output])).abs();
            let most = if holds || output >= outputs {
                0
            } else {
                i32::from(settings.outputs.rate[output])
            };
            prop_assert!(moved <= most, "scan {scan}: {moved} of {most}");
        }
        let taken = memory.link.sequence != since_taken || memory.link.silent == 0;
        since_taken = memory.link.sequence;
        silent = if taken { 0 } else { silent + u32::from(!holds) };
        if let Some(header) = &memory.used {
            // The active map equals one that was sent, word for word.
            let words = &lookup.buffer(memory.buffer)[..header.words()];
            let sent = gateways.iter().flat_map(|gateway| &gateway.sent);
            let whole = sent.into_iter().find(|map| map.words() == words);
            prop_assert!(whole.is_some(), "scan {scan}: the map in use was never sent");
            let map = whole.expect("seen above");
            swaps += usize::from(before.used != memory.used);
            // Corrections approach the map's values for one of the possible directions of each axis.
            for output in 0..outputs {
                let scale = f64::from(header.scale);
                let limit = f64::from(settings.outputs.limit[output]);
                // Bound: 0.6 of a step, plus the rounding of the values along five axes and of the position within a cell.
                let roundings = 0.6 + 0.5 * (1.0 + GRID_AXES as f64) / scale;
                let fits = roundings + cell_rounding(map, output);
                let value = reference(map, &steps, output);
                let goal = f64::from(memory.goal[output]);
                let close = reversals(map, output).into_iter().any(|reversal| {
                    let expected = ((value + reversal) / scale).clamp(-limit, limit);
                    (goal - expected).abs() <= fits
                });
                prop_assert!(close, "scan {scan}: output {output} goes to {}", memory.goal[output]);
            }
        } else {
            // On the way to zero the corrections never increase.
            for output in 0..outputs {
                let [before, now] =
                    [before.applied, memory.applied].map(|of| i32::from(of[output]));
                prop_assert!(
                    now.abs() <= before.abs() && now * before >= 0,
                    "scan {scan}: {before}, {now}"
                );
            }
        }
        // The corrections are zero within the computed number of scans after the last accepted frame.
        if silent > settings.zero_within_scans() {
            prop_assert_eq!(report.of.applied, Counts::default());
        }
    }
    Ok(swaps)
}

/// Maximum error by rounding the position within a cell, in output steps: half a digit along each axis, times the steepest slope.
fn cell_rounding(map: &Map, output: usize) -> f64 {
    let header = map.header();
    let outputs = header.outputs.count();
    let values = map.words()[HEADER_WORDS..].iter().skip(output).step_by(outputs);
    let values: Vec<i32> = values.map(|word| i32::from(word.cast_signed())).collect();
    let range = values.iter().max().unwrap_or(&0) - values.iter().min().unwrap_or(&0);
    let places = header.lines[..header.grid.count()].iter();
    let share: f64 = places.map(|lines| 0.5 / f64::from(lines.parts)).sum();
    f64::from(range) * share / f64::from(header.scale)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn rules_hold_over_a_faulty_wire(
        seed: u64,
        lost in 0.0..0.4,
        torn in 0.0..0.2,
        doubled in 0.0..0.3,
        late in 0.0..0.2,
    ) {
        run(seed, Badness { lost, torn, doubled, late }, 800)?;
    }
}

#[test]
fn maps_become_active_over_good_and_bad_wires() {
    let good = Badness { lost: 0.0, torn: 0.0, doubled: 0.0, late: 0.0 };
    let bad = Badness { lost: 0.3, torn: 0.1, doubled: 0.2, late: 0.05 };
    for (name, wire) in [("good", good), ("bad", bad)] {
        let swaps: usize = (0..20).map(|seed| run(seed, wire, 800).expect("keeps the rules")).sum();
        assert!(swaps >= 20, "{name}: {swaps} maps came into use");
    }
}

/// A late frame activates nothing in a control that has timed out meanwhile.
#[test]
fn a_late_swap_is_rejected_in_another_epoch() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut settings = world::settings(&mut rng);
    (settings.outputs.hold_scans, settings.outputs.time_out_scans) = (10, 20);
    let (machine, axes) = (settings.outputs.machine, settings.outputs.axes);
    let mut session = Session::new(9);
    let map = world::map(&mut rng, &settings, 1);
    let mut lookup = Lookup::start(settings, 3, 0, [0; OUTPUTS]).expect("sensible");
    let steps = [0; GRID_AXES];
    let mut mailbox = [0; FRAME_WORDS];
    let mut swap = None;
    let mut loaded = ReadBackResult::Unknown;
    while swap.is_none() {
        let seen = lookup.scan(&mailbox, &steps, false);
        session.read(seen.of.head());
        match next_write(&map, machine, &seen, loaded) {
            NextAction::Write(body) => {
                let head = session.answer().expect("the only sender");
                let words = Frame { head, body }.encode(machine, axes);
                if loaded == ReadBackResult::Same {
                    swap = Some(words);
                } else {
                    mailbox = words;
                }
            }
            NextAction::ReadBack { .. } => loaded = ReadBackResult::Same,
        }
    }
    let swap = swap.expect("made above");
    for _ in 0..=settings.outputs.time_out_scans {
        lookup.scan(&mailbox, &steps, false);
    }
    let report = lookup.scan(&swap, &steps, false);
    assert!(!report.valid);
    assert_eq!(report.of.owner, 0);
}
