//! The shipped Structured Text, run by a small interpreter, produces the same words as the reference barrier for the same frames.

use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    barrier::{Barrier, DigitalLines, Frame, REPORT_WORDS, Settings},
    protocol::{Counts, Head, Layout},
    vocabulary::{AxisName, PerChannel},
};
use volcomp_test_support::structured_text::Block;

use super::words;

const TEXT: &str = include_str!("../../../../../docs/src/plc/barrier.st");

fn number(count: usize) -> i64 {
    i64::try_from(count).expect("few")
}

/// A control that runs the Structured Text.
struct Control {
    block: Block,
}

impl Control {
    fn new(
        text: &str,
        settings: &Settings,
        retained_epoch: u16,
        tick: u16,
        applied: &Counts,
    ) -> Self {
        let block = Block::parse(text).expect("the text that is shipped");
        let mut control = Self { block };
        let block = &mut control.block;
        block.set("axes", 0, number(settings.axes.count()));
        block.set("layout", 0, settings.axes.number().into());
        block.set("machine", 0, settings.machine.into());
        for axis in 0..9 {
            block.set("limit", axis, settings.limit[axis].into());
            block.set("rate", axis, settings.rate[axis].into());
        }
        block.set("stepScans", 0, settings.step_scans.into());
        block.set("holdScans", 0, settings.hold_scans.into());
        block.set("timeOutScans", 0, settings.time_out_scans.into());
        block.set("epoch", 0, retained_epoch.into());
        control.begins(tick, applied);
        control
    }

    /// The next scan is the first after a power-up or reset; the axis words hold `applied`.
    fn begins(&mut self, tick: u16, applied: &Counts) {
        for axis in 0..9 {
            self.block.set("atStart", axis, applied[axis].into());
        }
        self.block.set("tickAtStart", 0, tick.into());
        self.block.set("start", 0, 1);
    }

    fn scan(
        &mut self,
        mailboxes: &[Vec<u16>],
        lines: Option<&DigitalLines>,
        holds: bool,
    ) -> Result<Vec<u16>, String> {
        self.block.set("lines", 0, lines.is_some().into());
        if let Some(lines) = lines {
            self.block.set("latch", 0, lines.latch.into());
            self.block.set("lineAxis", 0, number(lines.axis));
            self.block.set("lineValue", 0, lines.value.into());
        }
        self.block.set("holds", 0, holds.into());
        self.block.set("boxes", 0, number(mailboxes.len()));
        for (at, mailbox) in mailboxes.iter().enumerate() {
            for place in 0..15 {
                let word = mailbox.get(place).copied().unwrap_or(0);
                self.block.set("frame", 15 * at + place, word.into());
            }
        }
        self.block.run()?;
        self.block.set("start", 0, 0);
        let count = self.block.get("words", 0);
        (0..usize::try_from(count).expect("no negative count"))
            .map(|at| u16::try_from(self.block.get("report", at)).map_err(|e| e.to_string()))
            .collect()
    }
}

fn random_settings(rng: &mut ChaCha8Rng) -> Settings {
    let hold_scans = rng.random_range(1..20);
    let axes = rng.random_range(1..=9);
    let of_axes = |rng: &mut ChaCha8Rng, most: i16| {
        PerChannel::from_fn(|axis| if axis < axes { rng.random_range(1..most) } else { 0 })
    };
    let mut names = AxisName::ALL;
    names.shuffle(rng);
    let furthest = [4000, 40][rng.random_range(0..2)];
    Settings {
        axes: Layout::of(names[..axes].iter().copied()).expect("each once"),
        machine: rng.random(),
        limit: of_axes(rng, furthest),
        rate: of_axes(rng, 60),
        step_scans: rng.random_range(1..4),
        hold_scans,
        time_out_scans: 2 * hold_scans + rng.random_range(0..20),
    }
}

fn random_frame(rng: &mut ChaCha8Rng, settings: &Settings, barrier: &Barrier) -> Vec<u16> {
    let now = barrier.report();
    let mut frame = Frame {
        head: Head {
            epoch: now.epoch,
            tick: now.tick.wrapping_sub(rng.random_range(0..3)),
            sequence: now.sequence.wrapping_add(1),
            owner: if now.owner == 0 && rng.random_bool(0.2) {
                0
            } else if now.owner == 0 {
                rng.random()
            } else {
                now.owner
            },
        },
        values: core::array::from_fn(|axis| {
            let most = settings.limit[axis];
            rng.random_range(-most..=most)
        }),
    };
    match rng.random_range(0..24) {
        0 => frame.head.epoch = frame.head.epoch.wrapping_sub(rng.random_range(0..3)),
        1 => frame.head.tick = rng.random(),
        2 => frame.head.sequence = rng.random(),
        3 => frame.head.owner = rng.random_range(0..3),
        4 => frame.values = rng.random(),
        5 => frame.values = [0; 9],
        6 => {
            frame.head.tick =
                now.tick.wrapping_sub(settings.hold_scans).wrapping_add(rng.random_range(0..3));
        }
        _ => {}
    }
    let mut words = words(settings, &frame);
    match rng.random_range(0..24) {
        0 => {
            let at = rng.random_range(0..words.len());
            words[at] = rng.random();
        }
        1 => words.fill(0),
        _ => {}
    }
    words
}

/// Sets another word on the lines, usually one that the axis can follow, and toggles the latch.
fn random_lines(
    rng: &mut ChaCha8Rng,
    settings: &Settings,
    barrier: &Barrier,
    lines: &mut DigitalLines,
) {
    let beyond = usize::from(rng.random_bool(0.1));
    lines.axis = rng.random_range(0..settings.axes.count() + beyond);
    let axis = lines.axis.min(8);
    let most = i32::from(settings.rate[axis]) * rng.random_range(0..5);
    let applied = i32::from(barrier.memory().applied[axis]);
    let requested = match rng.random_range(0..12) {
        0 => rng.random_range(-4100..4100),
        1 => applied - most,
        2 => applied + most,
        _ => applied + rng.random_range(-most..=most),
    };
    lines.value = i16::try_from(requested).unwrap_or(0);
    lines.latch ^= !rng.random_bool(0.1);
}

/// Runs a text in parallel with the reference; returns the numbers of accepted frames and line words, or the first difference.
fn compare(text: &str) -> Result<[usize; 2], String> {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut taken = [0; 2];
    for _ in 0..90 {
        let settings = random_settings(&mut rng);
        let (epoch, tick) = (rng.random(), rng.random());
        let applied =
            if rng.random_bool(0.5) { Counts::default() } else { PerChannel(rng.random()) };
        let mut barrier = Barrier::start(settings, epoch, tick, &applied).expect("valid");
        let mut control = Control::new(text, &settings, epoch, tick, &applied);
        let mut mailboxes = vec![vec![0; 15]; rng.random_range(0..=2)];
        let often = [0.9, 0.3, 0.02, 0.0][rng.random_range(0..4)];
        let mut lines = rng.random_bool(0.5).then(DigitalLines::default);
        let edges = [0.7, 0.2][rng.random_range(0..2)];
        let mut holds = false;
        for scan in 0..200 {
            for mailbox in &mut mailboxes {
                if rng.random_bool(often) {
                    *mailbox = random_frame(&mut rng, &settings, &barrier);
                }
            }
            if let Some(lines) = lines.as_mut().filter(|_| rng.random_bool(edges)) {
                random_lines(&mut rng, &settings, &barrier, lines);
            }
            if scan > 0 && rng.random_bool(0.005) {
                let (epoch, tick) = (barrier.memory().link.epoch, rng.random());
                let applied = barrier.memory().applied;
                barrier = Barrier::start(settings, epoch, tick, &applied).expect("valid");
                control.begins(tick, &applied);
            }
            holds ^= rng.random_bool(0.05);
            let boxes: Vec<&[u16]> = mailboxes.iter().map(Vec::as_slice).collect();
            let report = barrier.scan_with(&boxes, lines.as_ref(), holds);
            let mut expected = [0; REPORT_WORDS];
            let count = report.encode(&mut expected);
            let found = control.scan(&mailboxes, lines.as_ref(), holds)?;
            if found != expected[..count] {
                return Err(format!(
                    "scan {scan} of {settings:?}: {found:?}, not {:?}",
                    &expected[..count]
                ));
            }
            let memory = barrier.memory();
            taken[usize::from(memory.by_lines)] += usize::from(memory.link.silent == 0);
        }
    }
    Ok(taken)
}

#[test]
fn the_structured_text_matches_the_reference() {
    let taken = compare(TEXT).expect("the same words");
    assert!(taken[0] > 1000 && taken[1] > 200, "{taken:?} frames and words on lines were taken");
}

#[test]
fn every_mutation_of_the_structured_text_is_found() {
    let mistakes = [
        ("sum := (machine + layout / 65535) MOD 65535;", "sum := 0;"),
        ("(machine + layout / 65535) MOD", "machine MOD"),
        ("ofSums := layout MOD 65535;", "ofSums := axes;"),
        ("FOR at := 0 TO axes + 3 DO", "FOR at := 0 TO axes + 2 DO"),
        ("frame[15 * box] <> epoch", "FALSE"),
        ("epoch := (epoch + 1) MOD 65536;\n    tick", "tick"),
        ("epoch := (epoch + 1) MOD 65536;\n        owner", "owner"),
        ("frame[15 * box + 3] = 0 OR", "FALSE OR"),
        ("frame[15 * box + 3] <> owner", "FALSE"),
        ("MOD 65536 > holdScans", "MOD 65536 >= holdScans"),
        ("MOD 65536 > 32767", "MOD 65536 > 32000"),
        ("value > 32767", "value > 65000"),
        ("ABS(value) > limit[axis]", "value > limit[axis]"),
        (
            "silent := silent + 1;\n    IF silent = timeOutScans",
            "silent := silent + 1;\n    IF silent = timeOutScans - 1",
        ),
        ("wanted[axis] <> goal[axis]", "TRUE"),
        ("+ rate[axis] - 1) / rate[axis]", ") / rate[axis]"),
        ("value > steps", "axis = 0"),
        ("sign[axis] := -1;", "sign[axis] := 1;"),
        ("carried[axis] := carried[axis] - steps;", "carried[axis] := 0;"),
        ("waited >= stepScans", "waited > stepScans"),
        ("IF NOT holds THEN", "IF TRUE THEN"),
        ("silent := 0;\nELSIF", "silent := 1;\nELSIF"),
        ("= foundTick[box] AND", "= -2 AND"),
        ("= foundSequence[box] THEN", "= sequence THEN"),
        ("foundTick[0] := -1;", ""),
        ("latchKnown := FALSE;", ""),
        ("IF verdict <> 1 THEN", "IF verdict = 0 THEN"),
        ("latchKnown AND latch", "latch"),
        ("IF owner = 0 AND (byLines", "IF (byLines"),
        ("(byLines OR isZero)", "TRUE"),
        ("<= limit[lineAxis]", "<= 40000"),
        ("(1 + latched / stepScans)", "(latched / stepScans)"),
        ("ABS(lineValue - applied[lineAxis])", "ABS(lineValue)"),
        ("wanted[axis] := goal[axis];", "wanted[axis] := 0;"),
        ("byLines := FALSE;\n        aims", "aims"),
        ("latched := 0;\n    END_IF;\n    latchKnown", "END_IF;\n    latchKnown"),
    ];
    for (right, wrong) in mistakes {
        assert!(TEXT.contains(right), "{right}");
        let found = compare(&TEXT.replacen(right, wrong, 1));
        assert!(found.is_err(), "{right} -> {wrong}");
    }
}

/// The hardware enable of the book: while no mailbox is read, the correction is held until the timeout and then ramps
/// to zero at the barrier's rate, although a gateway keeps sending.
#[test]
fn without_mailboxes_the_correction_ramps_out() {
    let mut limit = Counts::default();
    let mut rate = Counts::default();
    (limit[0], rate[0]) = (150, 8);
    let settings = Settings {
        axes: Layout::of([AxisName::X]).expect("an axis"),
        machine: 4711,
        limit,
        rate,
        step_scans: 1,
        hold_scans: 25,
        time_out_scans: 50,
    };
    let mut control = Control::new(TEXT, &settings, 0, 0, &Counts::default());
    let mut scan = |number: u16, enabled: bool| {
        let mut values = [0; 9];
        values[0] = 150;
        let epoch = u16::try_from(control.block.get("epoch", 0)).expect("a word");
        let frame =
            Frame { head: Head { epoch, tick: number, sequence: number + 1, owner: 7 }, values };
        let boxes = if enabled { vec![words(&settings, &frame)] } else { Vec::new() };
        control.scan(&boxes, None, false).expect("it runs");
        control.block.get("applied", 0)
    };
    // The epoch is known only after the first scan.
    scan(0, false);
    for number in 1..40 {
        scan(number, true);
    }
    assert_eq!(scan(40, true), 150);
    let applied: Vec<i64> = (41..41 + 69).map(|number| scan(number, false)).collect();
    assert_eq!(applied[..49], [150; 49], "it waits for its time-out");
    let steps = applied[48..].windows(2).map(|two| two[0] - two[1]);
    assert!(steps.clone().all(|step| (0..=8).contains(&step)));
    assert_eq!(applied[67], 0, "19 steps of at most 8: {applied:?}");
    assert!(applied[66] > 0, "{applied:?}");
}
