//! The bridge, compiled alone and driven scan by scan: its barrier against the reference, and what it
//! tells of a control that does not do what it is asked for.

use std::{
    fmt::Write as _,
    io::{BufRead as _, BufReader, Write as _},
    path::{Path, PathBuf},
    process::{ChildStdin, ChildStdout, Command, Stdio},
    sync::OnceLock,
};

use proptest::prelude::*;
use tempfile::TempDir;
use volcomp_guard::{
    barrier::{Barrier, FRAME_WORDS, Frame, REPORT_WORDS, Report},
    protocol::{Counts, Head, Layout},
};
use volcomp_linuxcnc::{Flags, Key, State};
use volcomp_test_support::cases;
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{
    component::{Ended, MEMORY, built},
    frames::{boxes_of, posts, settings},
};

/// The program of `scans.c`; `None` where there is no compiler.
fn bridge() -> Option<&'static Path> {
    static BUILT: OnceLock<Option<(TempDir, PathBuf)>> = OnceLock::new();
    let built = BUILT.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let program = built(dir.path(), "scans.c", MEMORY)?;
        Some((dir, program))
    });
    built.as_ref().map(|(_, program)| program.as_path())
}

/// That of a component which has read none.
const NO_KEY: Key = Key::new([0; 16]);

pub(crate) struct Run {
    _child: Ended,
    asks: ChildStdin,
    hears: BufReader<ChildStdout>,
}

/// What a scan is given besides frames.
#[derive(Clone, Copy)]
#[expect(clippy::struct_excessive_bools, reason = "pins of the control")]
pub(crate) struct Given {
    pub(crate) on: bool,
    pub(crate) cut: bool,
    /// Whether offsets move in the mode of the control.
    pub(crate) mode: bool,
    /// 1: the control clears its offsets; 2: its planner does not move them; 3: its planner is 0.1 s late.
    pub(crate) does: u8,
    pub(crate) period_ns: u32,
    pub(crate) probing: bool,
    pub(crate) touching: bool,
}

pub(crate) const GOOD: Given = Given {
    on: true,
    cut: false,
    mode: true,
    does: 0,
    period_ns: 1_000_000,
    probing: false,
    touching: false,
};

pub(crate) struct Said {
    pub(crate) holds: bool,
    /// The counts of the first axis.
    counts: i64,
    pub(crate) state: State,
    /// Of the first axis, mm.
    probed: f64,
}

impl Said {
    pub(crate) fn lost(&self) -> bool {
        self.state.flags.has(Flags::LOST)
    }

    pub(crate) fn applied(&self) -> i16 {
        self.state.report.as_slice()[8].cast_signed()
    }
}

impl Run {
    /// The bridge; `None` where there is no compiler.
    pub(crate) fn new() -> Option<Self> {
        Some(Self::of(&mut Command::new(bridge()?)))
    }

    fn of(command: &mut Command) -> Self {
        let mut child = Ended(
            command
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .stderr(Stdio::null())
                .spawn()
                .unwrap(),
        );
        let asks = child.0.stdin.take().unwrap();
        let hears = BufReader::new(child.0.stdout.take().unwrap());
        Self {
            _child: child,
            asks,
            hears,
        }
    }

    /// One that is set: counts of 1 nm, limits of 30 um and rates of 2 um in a scan.
    pub(crate) fn set() -> Option<Self> {
        Some(Self::new()?.ready())
    }

    fn ready(mut self) -> Self {
        assert_eq!(
            self.ask("set XY 7 1 100 300 5 1 30000 30000 2000 2000"),
            "1"
        );
        self
    }

    pub(crate) fn ask(&mut self, line: &str) -> String {
        writeln!(self.asks, "{line}").unwrap();
        let mut answer = String::new();
        self.hears.read_line(&mut answer).unwrap();
        answer.trim_end().to_owned()
    }

    pub(crate) fn scan(&mut self, given: Given, frames: &[Vec<u16>]) -> Said {
        let flag = u8::from;
        let mut line = format!(
            "scan {} {} {} {} {} {} {}",
            flag(given.on),
            flag(given.cut),
            flag(given.mode),
            given.does,
            given.period_ns,
            if given.probing { 5 } else { 1 },
            flag(given.touching)
        );
        for words in frames {
            let words: Vec<String> = words.iter().map(u16::to_string).collect();
            write!(line, " {}", words.join(",")).unwrap();
        }
        let answer = self.ask(&line);
        let parts: Vec<&str> = answer.split_whitespace().collect();
        let [holds, counts, hex, _, probed, ..] = parts[..] else {
            panic!("{answer}");
        };
        let bytes: Vec<u8> = (0..hex.len())
            .step_by(2)
            .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap())
            .collect();
        Said {
            holds: holds == "1",
            counts: counts.parse().unwrap(),
            state: State::decode(&bytes, &NO_KEY).unwrap(),
            probed: probed.parse().unwrap(),
        }
    }

    /// Scans with a gateway that asks for this on X, counts. The last answer.
    pub(crate) fn correct(&mut self, given: Given, counts: i16, scans: u32) -> Said {
        let axes = Layout::of([AxisName::X, AxisName::Y]).unwrap();
        let mut said = self.scan(given, &[]);
        for _ in 0..scans {
            let Some(report) = Report::decode(7, axes, said.state.report.as_slice()) else {
                said = self.scan(given, &[]);
                continue;
            };
            let frame = Frame {
                head: Head {
                    sequence: report.sequence.wrapping_add(1),
                    owner: 9,
                    ..report.head()
                },
                values: *PerChannel::leading([counts, 0]),
            };
            let mut words = [0; FRAME_WORDS];
            let length = frame.encode(&report.settings, &mut words);
            said = self.scan(given, &[words[..length].to_vec()]);
        }
        said
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn its_barrier_is_the_reference_at_every_scan(
        machine in 0_u16..=65_534,
        epoch in prop_oneof![Just(0_u16), Just(u16::MAX), any::<u16>()],
        limit in [1_i16..200, 1_i16..i16::MAX],
        rate in [1_i16..20, 1_i16..300],
        (step, hold) in (1_u16..4, 1_u16..20),
        applied in [any::<i16>().boxed(), (-30_i16..30).boxed()],
        scans in prop::collection::vec((prop::bool::weighted(0.1), posts(), posts(), 1_usize..30), 1..60),
    ) {
        let settings = settings(machine, limit, rate, [step, hold]);
        let start: Counts = PerChannel::leading(applied);
        let mut barrier = Barrier::start(settings, epoch.wrapping_sub(1), 0, &start).unwrap();
        let Some(mut run) = Run::new() else { return Ok(()) };
        let set = format!(
            "set XC {machine} {step} {hold} {} {epoch} 1 {} {} {} {}",
            2 * hold + 3, limit[0], limit[1], rate[0], rate[1]
        );
        prop_assert_eq!(run.ask(&set), "1");
        run.ask(&format!("at {} {}", applied[0], applied[1]));
        for (cut, first, second, times) in scans {
            for repeat in 0..times {
                let last = barrier.report();
                let boxes = boxes_of([first, second], repeat, &last);
                let said = run.scan(Given { cut, ..GOOD }, &boxes);
                prop_assert!(said.holds || !cut);
                prop_assert!(!said.lost());
                let boxes: Vec<&[u16]> = boxes.iter().map(Vec::as_slice).collect();
                let mut report = [0; REPORT_WORDS];
                let length = barrier.scan(&boxes, said.holds).encode(&mut report);
                prop_assert_eq!(said.state.report.as_slice(), &report[..length]);
            }
        }
    }
}

/// What is published are words of 16 bits: a setting that none holds would be published as another one.
#[test]
fn settings_that_no_word_holds_are_refused() {
    for (line, fits) in [
        ("set XY 7 1 100 300 5 1 30000 30000 2000 2000", "1"),
        ("set XY 7 1 100 300 5 1 32767 1 32767 1", "1"),
        // Published as a time-out of 300 scans, which never came.
        ("set XY 7 1 65636 65836 5 1 30000 30000 2000 2000", "0"),
        ("set XY 7 1 100 32768 5 1 30000 30000 2000 2000", "0"),
        ("set XY 7 1 100 199 5 1 30000 30000 2000 2000", "0"),
        ("set XY 7 1 0 300 5 1 30000 30000 2000 2000", "0"),
        ("set XY 7 0 100 300 5 1 30000 30000 2000 2000", "0"),
        ("set XY 7 40000 100 300 5 1 30000 30000 2000 2000", "0"),
        ("set XY 7 1 100 300 5 1 40000 30000 2000 2000", "0"),
        ("set XY 7 1 100 300 5 1 30000 0 2000 2000", "0"),
        ("set XY 7 1 100 300 5 1 30000 30000 2000 40000", "0"),
        ("set XY 7 1 100 300 5 1 30000 30000 0 2000", "0"),
        ("set XY 7 1 100 300 5 0 30000 30000 2000 2000", "0"),
    ] {
        let Some(mut run) = Run::new() else { return };
        assert_eq!(run.ask(line), fits, "{line}");
    }
}

/// Each message names one setting, by its names in the component and in the INI file, with what was found and what is expected.
#[test]
fn a_setting_that_does_not_fit_is_told_by_its_name() {
    for [line, says] in &cases(
        "
set XY 7 1 100 300 5 0 30000 30000 2000 2000 | step (STEP_NM, STEP_UDEG) of axis X: found 0 nm or 1e-6 deg, expected 1 to 1000000
set XY 7 1 100 300 5 1 30000 40000 2000 2000 | limit (LIMIT_UM, LIMIT_MDEG) of axis Y: found 40000 counts, expected 1 to 32767
set XY 7 1 100 300 5 1 30000 30000 0 2000 | rate (RATE_UM_PER_S, RATE_MDEG_PER_S) of axis X: found 0 counts in a step, expected 1 to 32767
set XY 7 40000 100 300 5 1 30000 30000 2000 2000 | step_scans (RATE_UM_PER_S, RATE_MDEG_PER_S): found 40000 cycles from count to count, expected 1 to 32767
set XY 7 1 0 300 5 1 30000 30000 2000 2000 | hold_scans (HOLD_MS): found 0 cycles, expected 1 to 16383
set XY 7 1 100 199 5 1 30000 30000 2000 2000 | time_out_scans (TIME_OUT_MS): found 199 cycles, expected 200 to 32767
set XQ 7 1 100 300 5 1 30000 30000 2000 2000 | axes (AXES) and reads (READS): found XQ and , expected letters of XYZABCUVW, each once
set XX 7 1 100 300 5 1 30000 30000 2000 2000 | axes (AXES) and reads (READS): found XX and , expected letters of XYZABCUVW, each once
",
    ) {
        let Some(program) = bridge() else { return };
        let mut child = Command::new(program)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        writeln!(child.stdin.take().unwrap(), "{line}").unwrap();
        let output = child.wait_with_output().unwrap();
        let told = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        assert_eq!(told, ["0\n".to_owned(), format!("volcomp: {says}\n")]);
    }
}

#[test]
fn a_file_without_an_epoch_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("epoch");
    let ask = || Some(Run::new()?.ask(&format!("epoch {}", file.display())));
    let Some(kept) = ask() else { return };
    assert_eq!(kept, "0", "none was kept");
    for (text, expected) in [
        ("17\n", "17"),
        ("65535", "65535"),
        ("", "-1"),
        ("\n", "-1"),
        ("seventeen\n", "-1"),
        ("1 7\n", "-1"),
        ("17x", "-1"),
        ("-1\n", "-1"),
        ("65536\n", "-1"),
    ] {
        std::fs::write(&file, text).unwrap();
        assert_eq!(ask().as_deref(), Some(expected), "{text:?}");
    }
}

/// In joint mode LinuxCNC moves no offset: what is asked for there comes as a jump when another mode comes back.
#[test]
fn in_joint_mode_nothing_is_asked_for() {
    let Some(mut run) = Run::set() else { return };
    let said = run.correct(GOOD, 20_000, 100);
    assert_eq!((said.applied(), said.lost()), (20_000, false));
    let joint = Given {
        mode: false,
        ..GOOD
    };
    // The gateway ramps out, and is gone for longer than the time-out.
    let said = run.correct(joint, 0, 100);
    assert!(said.lost() && said.holds);
    assert_eq!((said.applied(), said.counts), (20_000, 20_000));
    for _ in 0..1000 {
        let said = run.scan(joint, &[]);
        assert_eq!((said.applied(), said.counts), (20_000, 20_000));
    }
    // Back in another mode: to zero at the rate of the barrier.
    let (mut last, mut zero) = (20_000, false);
    for _ in 0..20 {
        let said = run.scan(GOOD, &[]);
        assert!(!said.lost() && last - said.counts <= 2000);
        last = said.counts;
        zero |= last == 0;
    }
    assert!(zero);
}

/// Half a second after the planner did not follow, whatever the period of the servo thread is.
#[test]
fn an_offset_that_does_not_come_is_lost() {
    for period_ns in [250_000, 1_000_000] {
        let still = Given {
            does: 2,
            period_ns,
            ..GOOD
        };
        let Some(mut run) = Run::set() else { return };
        run.correct(Given { does: 0, ..still }, 0, 30);
        // As much as it may be off for ever.
        let said = run.correct(still, 13, 3 * 1_000_000_000 / period_ns);
        assert!(!said.lost());
        assert_eq!(said.applied(), 13);
        let Some(mut run) = Run::set() else { return };
        run.correct(Given { does: 0, ..still }, 0, 30);
        let mut lost_after = 0;
        for scan in 0..8000 {
            if run.correct(still, 3500, 0).lost() {
                lost_after = scan;
                break;
            }
            run.correct(still, 3500, 1);
        }
        // Three scans in each pass.
        let ms = f64::from(3 * lost_after) * f64::from(period_ns) * 1e-6;
        // What moved is forgotten within some times of the way.
        assert!((500.0..1200.0).contains(&ms), "{ms} ms");
        // Once it comes, it is over.
        assert!(run.scan(GOOD, &[]).lost());
        for _ in 0..10 {
            run.scan(GOOD, &[]);
        }
        assert!(!run.scan(GOOD, &[]).lost());
    }
}

/// A planner that is late, but in time, however long that goes on: 5 um behind a correction that moves by 50 um/s.
#[test]
fn an_offset_that_follows_late_is_not_lost() {
    let Some(mut run) = Run::new() else { return };
    assert_eq!(run.ask("set XY 7 1 100 300 5 1 30000 30000 50 50"), "1");
    let late = Given { does: 3, ..GOOD };
    for goal in [25_000, -25_000, 25_000] {
        for _ in 0..60 {
            let said = run.correct(late, goal, 20);
            assert!(!said.lost());
        }
        assert_eq!(run.correct(late, goal, 0).applied(), goal);
    }
}

/// The alarm of an offset that was lost lasts a second, whatever the period of the servo thread is.
#[test]
fn a_lost_offset_is_told_for_a_second() {
    for period_ns in [250_000, 1_000_000] {
        let given = Given { period_ns, ..GOOD };
        let Some(mut run) = Run::set() else { return };
        let said = run.correct(given, 20_000, 100);
        assert_eq!(said.applied(), 20_000);
        run.scan(Given { does: 1, ..given }, &[]);
        let lost = (0..10_000).filter(|_| run.scan(given, &[]).lost()).count();
        let scans = 1_000_000_000 / usize::try_from(period_ns).unwrap();
        assert!(lost.abs_diff(scans) <= 2, "{lost} scans of {scans}");
    }
}

/// An offset that no word holds is not told as another one: nothing is told, and it goes towards zero.
#[test]
fn an_offset_that_no_word_holds_is_not_told() {
    let Some(mut run) = Run::set() else { return };
    run.ask("at 60000 0");
    let mut told = None;
    let mut counts = Vec::new();
    for scan in 0..100 {
        let said = run.scan(GOOD, &[]);
        counts.push(said.counts);
        if said.state.report.as_slice().is_empty() {
            assert_eq!(told, None);
            assert!(said.lost());
        } else {
            told = told.or(Some((scan, said.applied())));
        }
    }
    let (scan, applied) = told.expect("at last it is told");
    assert!(
        scan > 20 && (30_000..=32_767).contains(&applied),
        "{scan} {applied}"
    );
    // LinuxCNC counts changes: from 60 um to zero.
    assert_eq!(counts.last().unwrap() - counts[0], -60_000);
    assert!(counts.windows(2).all(|pair| pair[0] - pair[1] <= 2000));
}

/// G38.2 waits for the contact, G38.4 for its loss; before and after, contacts change nothing.
#[test]
fn the_offset_at_the_contact_or_at_its_loss_is_kept() {
    let probe = |touching| Given {
        probing: true,
        touching,
        ..GOOD
    };
    let touching = Given {
        touching: true,
        ..GOOD
    };
    for toward in [true, false] {
        let Some(mut run) = Run::set() else { return };
        let before = if toward { GOOD } else { touching };
        run.correct(before, 5000, 100);
        run.correct(probe(!toward), 5000, 10);
        let said = run.correct(probe(!toward), 8000, 20);
        assert_eq!(said.probed, 0.0, "nothing has happened yet");
        let said = run.scan(probe(toward), &[]);
        assert_eq!(said.probed, 0.008);
        run.correct(
            Given {
                probing: false,
                ..probe(toward)
            },
            1000,
            20,
        );
        let said = run.correct(GOOD, 1000, 20);
        assert_eq!(said.probed, 0.008);
    }
}

/// A small correction that never comes is seen as well as a large one, once what moved is forgotten; one that came is not lost.
#[test]
fn a_small_correction_that_does_not_come_is_lost() {
    let Some(mut run) = Run::set() else { return };
    assert!(!run.correct(GOOD, 0, 30).lost());
    let still = Given { does: 2, ..GOOD };
    let lost_after =
        (0..4000).find(|_| run.correct(still, 300, 0).lost() || run.correct(still, 300, 1).lost());
    // Three scans in each pass; what moved is forgotten by 23 to 1 in some times of the way.
    let ms = 3 * lost_after.expect("lost");
    assert!((500..2000).contains(&ms), "{ms} ms");
    let said = run.correct(GOOD, 300, 20);
    assert!(!said.lost());
    assert_eq!(said.applied(), 300);
}

/// A disk that hangs: after as many time-outs as a start goes on by, no frame is taken, and that is told. Otherwise one of
/// before could pass after a restart.
#[test]
fn frames_are_refused_while_the_epoch_cannot_be_written() {
    let Some(mut run) = Run::set() else { return };
    let mut said = run.correct(GOOD, 100, 30);
    let (epoch, refusal) = (0, 4);
    let begun = said.state.report.as_slice()[epoch];
    assert_eq!(said.applied(), 100);
    run.ask("disk 0");
    let mut taken = 0;
    for _ in 0..20 {
        // The gateway is gone for longer than the time-out, and comes back.
        for _ in 0..310 {
            said = run.scan(GOOD, &[]);
        }
        assert_eq!(said.applied(), 0);
        said = run.correct(GOOD, 100, 5);
        if said.applied() == 0 {
            break;
        }
        assert_eq!(said.state.report.as_slice()[refusal], 0);
        taken += 1;
    }
    assert_eq!(taken, 15);
    let words = said.state.report.as_slice();
    assert_eq!(words[epoch].wrapping_sub(begun), 16);
    assert_eq!(words[refusal], 2, "it is told");
    run.ask("disk 1");
    let said = run.correct(GOOD, 100, 5);
    assert_eq!(
        (said.applied(), said.state.report.as_slice()[refusal]),
        (100, 0)
    );
}
