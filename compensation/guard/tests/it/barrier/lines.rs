//! Acceptance of words on digital lines at a barrier.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    barrier::{Barrier, DigitalLines},
    protocol::{Counts, Refusal, ReportStatus, Session},
    vocabulary::PerChannel,
};

use super::{at_zero, settings, words};

/// A barrier with digital lines and their levels. Rate: 2 counts per scan; maximum age of a frame: 5 scans; timeout: 12 scans.
struct Rig {
    barrier: Barrier,
    lines: DigitalLines,
    frame: Vec<u16>,
}

impl Rig {
    fn new() -> Self {
        let mut rig = Self {
            barrier: at_zero(settings(2)),
            lines: DigitalLines::default(),
            frame: Vec::new(),
        };
        rig.scans(20);
        rig
    }

    /// Runs scans, and checks that the applied correction changes by at most the rate in each.
    fn scans(&mut self, count: u16) -> Refusal {
        for _ in 0..count {
            let before = self.barrier.memory().applied;
            let report = self.barrier.scan_with(&[&self.frame], Some(&self.lines), false);
            for axis in 0..2 {
                assert!((report.applied[axis] - before[axis]).abs() <= 2);
            }
        }
        self.barrier.report().refusal
    }

    /// Sets another word, and toggles the latch one scan later, when the word has settled.
    fn word(&mut self, axis: usize, value: i16) -> Refusal {
        (self.lines.axis, self.lines.value) = (axis, value);
        self.scans(1);
        self.lines.latch ^= true;
        self.scans(1)
    }

    fn applied(&self) -> [i16; 2] {
        let applied = self.barrier.memory().applied;
        [applied[0], applied[1]]
    }

    fn sends(&mut self, sender: &mut Session, requested: Counts) {
        let report = self.barrier.report();
        let seen = sender.read(report.head());
        assert!(!matches!(seen, ReportStatus::Held { .. }), "lines hold nothing");
        if let Some(frame) = sender.frame(&requested) {
            self.frame = words(&report.settings, &frame);
        }
    }
}

#[test]
fn a_word_is_accepted_only_at_an_edge() {
    let mut rig = Rig::new();
    rig.lines.value = 3;
    rig.scans(30);
    assert_eq!(rig.applied(), [0, 0], "no edge");
    for (axis, value) in [(0, 2), (0, 4), (1, -3), (0, 6)] {
        assert_eq!(rig.word(axis, value), Refusal::None);
    }
    rig.scans(3);
    assert_eq!(rig.applied(), [6, -3], "one axis after the other");
    // Without further edges the correction ramps to zero, and the constant levels are not accepted.
    rig.scans(12 + 4);
    assert_eq!(rig.applied(), [0, 0]);
    assert_eq!(rig.barrier.report().owner, 0);
    rig.scans(100);
    assert_eq!(rig.applied(), [0, 0]);
}

#[test]
fn a_word_that_changes_faster_than_the_axis_is_rejected() {
    let mut rig = Rig::new();
    rig.word(0, 2);
    rig.word(0, 4);
    // Two scans between the edges permit 2 counts each, plus one step.
    assert_eq!(rig.word(0, 4 + 7), Refusal::Lines);
    assert_eq!(rig.applied(), [4, 0]);
    assert_eq!(rig.word(0, 4 + 6), Refusal::None);
    // After any silence the word may change by at most the motion of the axis during the maximum age of a frame.
    let mut rig = Rig::new();
    assert_eq!(rig.word(0, 13), Refusal::Lines);
    rig.scans(100);
    assert_eq!(rig.word(0, 12), Refusal::None);
    // A word for a missing axis, and a word above the limit.
    let mut rig = Rig::new();
    assert_eq!(rig.word(2, 0), Refusal::Lines);
    for value in [4, 10, 14, 20] {
        rig.word(0, value);
        rig.scans(2);
    }
    assert_eq!(rig.applied(), [20, 0]);
    assert_eq!(rig.word(0, 21), Refusal::Lines);
}

#[test]
fn a_sender_of_frames_has_priority() {
    let mut rig = Rig::new();
    rig.word(0, 2);
    rig.word(0, 4);
    // The first frame is accepted although the lines are in use.
    let mut sender = Session::new(7);
    for _ in 0..10 {
        rig.sends(&mut sender, PerChannel::leading([10, 4]));
        rig.scans(1);
    }
    assert_eq!(rig.applied(), [10, 4]);
    // Words on lines are rejected as long as the sender owns the control or its correction is applied.
    rig.sends(&mut sender, PerChannel::leading([10, 4]));
    assert_eq!(rig.word(0, 10), Refusal::Lines);
    rig.scans(12);
    assert_eq!(rig.barrier.report().owner, 0, "it sends nothing any more");
    assert_ne!(rig.applied(), [0, 0]);
    assert_eq!(rig.word(0, rig.applied()[0]), Refusal::Lines);
    rig.scans(10);
    assert_eq!(rig.applied(), [0, 0]);
    assert_eq!(rig.word(0, 1), Refusal::None);
}

#[test]
fn the_initial_latch_level_is_no_edge() {
    for latch in [false, true] {
        let mut barrier = at_zero(settings(2));
        let lines = DigitalLines { latch, axis: 0, value: 2 };
        for _ in 0..30 {
            barrier.scan_with(&[], Some(&lines), false);
        }
        assert_eq!(barrier.report().applied, Counts::default());
    }
}

/// One gateway alternates between frames and lines. Frames are lost, late or torn, bits are wrong, edges are missing or
/// extra. No axis exceeds its rate or limit, and the lines start to move an axis only from zero.
#[test]
fn alternating_frames_and_lines_with_faults() {
    let (mut by_lines, mut by_frames) = (0, 0);
    for seed in 0..500 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut rig = Rig::new();
        let mut sender = Session::new(7);
        let mut late = Vec::new();
        let mut output = [0_i16; 2];
        for scan in 0..1500_u32 {
            let memory = rig.barrier.memory();
            let uses_lines = (scan / 300) % 2 == 1;
            let requested = [12, -6];
            if uses_lines && scan % 2 == 0 {
                // The word stays zero until no correction can remain: timeout + maximum age of a frame + ramp.
                let axis = usize::from(scan % 4 == 0);
                let waits = scan % 300 < 12 + 5 + 10;
                output[axis] += (requested[axis] - output[axis]).signum();
                if waits {
                    output = [0; 2];
                } else {
                    (rig.lines.axis, rig.lines.value) = (axis, output[axis]);
                    if rng.random_bool(0.02) {
                        rig.lines.value ^= 1 << rng.random_range(0..8);
                    }
                }
            } else if uses_lines && !rng.random_bool(0.05) {
                rig.lines.latch ^= true;
            } else if !uses_lines {
                rig.sends(&mut sender, PerChannel::leading(requested));
                output = [0; 2];
                if rng.random_bool(0.05) {
                    late.push(std::mem::take(&mut rig.frame));
                }
                if rng.random_bool(0.05) {
                    let at = rng.random_range(0..8);
                    if let Some(word) = rig.frame.get_mut(at) {
                        *word = rng.random();
                    }
                }
            }
            if rng.random_bool(0.01)
                && let Some(old) = late.pop()
            {
                rig.frame = old;
            }
            rig.scans(1);
            let after = rig.barrier.memory();
            for axis in 0..2 {
                assert!(after.applied[axis].abs() <= 20);
            }
            if after.by_lines && !memory.by_lines {
                assert_eq!(memory.applied, Counts::default(), "seed {seed}");
            }
            by_lines += u32::from(after.by_lines && after.applied[0] == 12);
            by_frames += u32::from(!after.by_lines && after.applied[0] == 12);
        }
    }
    assert!(by_lines > 20_000 && by_frames > 20_000, "{by_lines} {by_frames}");
}
