//! Tests of the bridge's component, compiled without LinuxCNC and run scan by scan: its barrier is compared with the
//! reference, and its reports are checked for a control that does not apply offsets.

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
    frames::{mailboxes_of, posts, settings},
};

/// Compiles `scans.c` once and returns the path of the program; `None` without a C compiler.
fn bridge() -> Option<&'static Path> {
    static BUILT: OnceLock<Option<(TempDir, PathBuf)>> = OnceLock::new();
    let built = BUILT.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let program = built(dir.path(), "scans.c", MEMORY)?;
        Some((dir, program))
    });
    built.as_ref().map(|(_, program)| program.as_path())
}

/// The key of a component that has read no key file.
const NO_KEY: Key = Key::new([0; 16]);

pub(crate) struct Run {
    _child: Ended,
    input: ChildStdin,
    replies: BufReader<ChildStdout>,
}

/// Inputs of a scan other than frames.
#[derive(Clone, Copy)]
#[expect(clippy::struct_excessive_bools, reason = "pins of the control")]
pub(crate) struct ScanInput {
    pub(crate) on: bool,
    /// Whether the emergency stop is pressed.
    pub(crate) stopped: bool,
    /// Whether the control reports that it cut an offset at a soft limit.
    pub(crate) cut: bool,
    /// Whether the current mode of the control applies offsets.
    pub(crate) mode: bool,
    /// Behaviour of the control. 1: it clears its offsets; 2: its planner does not apply offsets; 3: its planner
    /// applies offsets 0.1 s late; other values: it applies them at once.
    pub(crate) does: u8,
    pub(crate) period_ns: u32,
    pub(crate) probing: bool,
    pub(crate) touching: bool,
}

pub(crate) const GOOD: ScanInput = ScanInput {
    on: true,
    stopped: false,
    cut: false,
    mode: true,
    does: 0,
    period_ns: 1_000_000,
    probing: false,
    touching: false,
};

pub(crate) struct ScanOutput {
    pub(crate) holds: bool,
    /// Requested offset of the first axis, in counts.
    counts: i64,
    pub(crate) state: State,
    /// Probed position of the first axis, mm.
    probed: f64,
}

impl ScanOutput {
    pub(crate) fn lost(&self) -> bool {
        self.state.flags.has(Flags::LOST)
    }

    pub(crate) fn applied(&self) -> i16 {
        self.state.report.as_slice()[8].cast_signed()
    }
}

impl Run {
    /// Starts the program; `None` without a C compiler.
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
        let input = child.0.stdin.take().unwrap();
        let replies = BufReader::new(child.0.stdout.take().unwrap());
        Self { _child: child, input, replies }
    }

    /// Starts the program and configures counts of 1 nm, limits of 30 µm, and rates of 2 µm per scan; `None` without a
    /// C compiler.
    pub(crate) fn set() -> Option<Self> {
        Some(Self::new()?.ready())
    }

    fn ready(mut self) -> Self {
        assert_eq!(self.command("set XY 7 1 100 300 5 1 30000 30000 2000 2000"), "1");
        self
    }

    pub(crate) fn command(&mut self, line: &str) -> String {
        writeln!(self.input, "{line}").unwrap();
        let mut answer = String::new();
        self.replies.read_line(&mut answer).unwrap();
        answer.trim_end().to_owned()
    }

    pub(crate) fn scan(&mut self, scan_input: ScanInput, frames: &[Vec<u16>]) -> ScanOutput {
        let flag = u8::from;
        let mut line = format!(
            "scan {} {} {} {} {} {} {} {}",
            flag(scan_input.on),
            flag(scan_input.stopped),
            flag(scan_input.cut),
            flag(scan_input.mode),
            scan_input.does,
            scan_input.period_ns,
            if scan_input.probing { 5 } else { 1 },
            flag(scan_input.touching)
        );
        for words in frames {
            let words: Vec<String> = words.iter().map(u16::to_string).collect();
            write!(line, " {}", words.join(",")).unwrap();
        }
        let answer = self.command(&line);
        let parts: Vec<&str> = answer.split_whitespace().collect();
        let [holds, counts, hex, _, probed, ..] = parts[..] else {
            panic!("{answer}");
        };
        let bytes: Vec<u8> = (0..hex.len())
            .step_by(2)
            .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap())
            .collect();
        ScanOutput {
            holds: holds == "1",
            counts: counts.parse().unwrap(),
            state: State::decode(&bytes, &NO_KEY).unwrap(),
            probed: probed.parse().unwrap(),
        }
    }

    /// Runs `scans` scans with a gateway that requests `counts` on X; returns the last output.
    pub(crate) fn correct(&mut self, scan_input: ScanInput, counts: i16, scans: u32) -> ScanOutput {
        let axes = Layout::of([AxisName::X, AxisName::Y]).unwrap();
        let mut output = self.scan(scan_input, &[]);
        for _ in 0..scans {
            let Some(report) = Report::decode(7, axes, output.state.report.as_slice()) else {
                output = self.scan(scan_input, &[]);
                continue;
            };
            let frame = Frame {
                head: Head { sequence: report.sequence.wrapping_add(1), owner: 9, ..report.head() },
                values: *PerChannel::leading([counts, 0]),
            };
            let mut words = [0; FRAME_WORDS];
            let length = frame.encode(&report.settings, &mut words);
            output = self.scan(scan_input, &[words[..length].to_vec()]);
        }
        output
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
        prop_assert_eq!(run.command(&set), "1");
        run.command(&format!("at {} {}", applied[0], applied[1]));
        for (stopped, first, second, times) in scans {
            for repeat in 0..times {
                let last = barrier.report();
                let mailboxes = mailboxes_of([first, second], repeat, &last);
                let output = run.scan(ScanInput { stopped, ..GOOD }, &mailboxes);
                prop_assert!(output.holds || !stopped);
                prop_assert!(!output.lost());
                let mailboxes: Vec<&[u16]> = mailboxes.iter().map(Vec::as_slice).collect();
                let mut report = [0; REPORT_WORDS];
                let length = barrier.scan(&mailboxes, output.holds).encode(&mut report);
                prop_assert_eq!(output.state.report.as_slice(), &report[..length]);
            }
        }
    }
}

/// A setting above the 15 bits of the words is rejected: published in a word, it would have another value.
#[test]
fn settings_beyond_the_word_range_are_rejected() {
    for (line, fits) in [
        ("set XY 7 1 100 300 5 1 30000 30000 2000 2000", "1"),
        ("set XY 7 1 100 300 5 1 32767 1 32767 1", "1"),
        // In 16 bits, the timeout would be published as 300 scans, and the component would never reach its true value.
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
        assert_eq!(run.command(line), fits, "{line}");
    }
}

/// Each message names the setting in the component and in the INI file, the value found, and the values expected.
#[test]
fn invalid_settings_are_named() {
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
        let reported = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        assert_eq!(reported, ["0\n".to_owned(), format!("volcomp: {says}\n")]);
    }
}

#[test]
fn a_file_without_an_epoch_is_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("epoch");
    let command = || Some(Run::new()?.command(&format!("epoch {}", file.display())));
    let Some(kept) = command() else { return };
    assert_eq!(kept, "0", "no epoch stored yet");
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
        assert_eq!(command().as_deref(), Some(expected), "{text:?}");
    }
}

/// In joint mode LinuxCNC applies no offset, and a request would cause a jump at the next change of mode. The counts
/// therefore stay constant, and the offset is reported as lost.
#[test]
fn no_offset_is_requested_in_joint_mode() {
    let Some(mut run) = Run::set() else { return };
    let output = run.correct(GOOD, 20_000, 100);
    assert_eq!((output.applied(), output.lost()), (20_000, false));
    let joint = ScanInput { mode: false, ..GOOD };
    // The gateway ramps out, then is silent for longer than the timeout.
    let output = run.correct(joint, 0, 100);
    assert!(output.lost() && output.holds);
    assert_eq!((output.applied(), output.counts), (20_000, 20_000));
    for _ in 0..1000 {
        let output = run.scan(joint, &[]);
        assert_eq!((output.applied(), output.counts), (20_000, 20_000));
    }
    // After the return to the previous mode, the offset moves to zero at the rate of the barrier.
    let (mut last, mut zero) = (20_000, false);
    for _ in 0..20 {
        let output = run.scan(GOOD, &[]);
        assert!(!output.lost() && last - output.counts <= 2000);
        last = output.counts;
        zero |= last == 0;
    }
    assert!(zero);
}

/// A cut that LinuxCNC reports is an alarm only while an offset is missing: in a program it may report one that was in manual mode at a limit.
#[test]
fn a_reported_cut_without_a_missing_offset_is_no_alarm() {
    let Some(mut run) = Run::set() else { return };
    run.correct(GOOD, 20_000, 100);
    let cut = ScanInput { cut: true, ..GOOD };
    let output = run.correct(cut, 25_000, 1000);
    assert!(!output.holds && !output.state.flags.has(Flags::LIMITED));
    assert_eq!(output.applied(), 25_000);
    // The planner does not get beyond 25 µm.
    let still = ScanInput { does: 2, ..cut };
    run.correct(still, 29_000, 2000);
    let output = run.scan(still, &[]);
    assert!(output.holds && output.state.flags.has(Flags::LIMITED));
}

/// A requested offset of 3.5 µm that the planner does not apply is reported as lost after 0.5 to 1.2 s, at any servo
/// period. An offset within the tolerance is never reported as lost.
#[test]
fn a_missing_offset_is_lost() {
    for period_ns in [250_000, 1_000_000] {
        let still = ScanInput { does: 2, period_ns, ..GOOD };
        let Some(mut run) = Run::set() else { return };
        run.correct(ScanInput { does: 0, ..still }, 0, 30);
        // The largest offset within the tolerance.
        let output = run.correct(still, 13, 3 * 1_000_000_000 / period_ns);
        assert!(!output.lost());
        assert_eq!(output.applied(), 13);
        let Some(mut run) = Run::set() else { return };
        run.correct(ScanInput { does: 0, ..still }, 0, 30);
        let mut lost_after = 0;
        for scan in 0..8000 {
            if run.correct(still, 3500, 0).lost() {
                lost_after = scan;
                break;
            }
            run.correct(still, 3500, 1);
        }
        // Each iteration runs three scans.
        let ms = f64::from(3 * lost_after) * f64::from(period_ns) * 1e-6;
        // The report also waits until the estimate of recent motion has decayed, which takes a few planner lags.
        assert!((500.0..1200.0).contains(&ms), "{ms} ms");
        // The alarm ends when the control has applied the offset.
        assert!(run.scan(GOOD, &[]).lost());
        for _ in 0..10 {
            run.scan(GOOD, &[]);
        }
        assert!(!run.scan(GOOD, &[]).lost());
    }
}

/// An offset is not lost if the planner lags by a constant amount within the tolerance (5 µm at 50 µm/s).
#[test]
fn a_lagging_offset_is_not_lost() {
    let Some(mut run) = Run::new() else { return };
    assert_eq!(run.command("set XY 7 1 100 300 5 1 30000 30000 50 50"), "1");
    let late = ScanInput { does: 3, ..GOOD };
    for goal in [25_000, -25_000, 25_000] {
        for _ in 0..60 {
            let output = run.correct(late, goal, 20);
            assert!(!output.lost());
        }
        assert_eq!(run.correct(late, goal, 0).applied(), goal);
    }
}

/// The alarm for a lost offset lasts one second, within two scans, at any servo period.
#[test]
fn a_lost_offset_is_reported_for_one_second() {
    for period_ns in [250_000, 1_000_000] {
        let scan_input = ScanInput { period_ns, ..GOOD };
        let Some(mut run) = Run::set() else { return };
        let output = run.correct(scan_input, 20_000, 100);
        assert_eq!(output.applied(), 20_000);
        run.scan(ScanInput { does: 1, ..scan_input }, &[]);
        let lost = (0..10_000).filter(|_| run.scan(scan_input, &[]).lost()).count();
        let scans = 1_000_000_000 / usize::try_from(period_ns).unwrap();
        assert!(lost.abs_diff(scans) <= 2, "{lost} scans of {scans}");
    }
}

/// An offset above the range of a word is not reported, because the word would have another value. The correction then
/// moves to zero.
#[test]
fn an_offset_beyond_the_word_range_is_not_reported() {
    let Some(mut run) = Run::set() else { return };
    run.command("at 60000 0");
    let mut reported = None;
    let mut counts = Vec::new();
    for scan in 0..100 {
        let output = run.scan(GOOD, &[]);
        counts.push(output.counts);
        if output.state.report.as_slice().is_empty() {
            assert_eq!(reported, None);
            assert!(output.lost());
        } else {
            reported = reported.or(Some((scan, output.applied())));
        }
    }
    let (scan, applied) = reported.expect("reported at last");
    assert!(scan > 20 && (30_000..=32_767).contains(&applied), "{scan} {applied}");
    // LinuxCNC evaluates differences of the counts: 60 µm to zero.
    assert_eq!(counts.last().unwrap() - counts[0], -60_000);
    assert!(counts.windows(2).all(|pair| pair[0] - pair[1] <= 2000));
}

/// The offset is stored at contact for G38.2 and at loss of contact for G38.4; other contacts have no effect.
#[test]
fn the_offset_at_contact_or_loss_is_stored() {
    let probe = |touching| ScanInput { probing: true, touching, ..GOOD };
    let touching = ScanInput { touching: true, ..GOOD };
    for toward in [true, false] {
        let Some(mut run) = Run::set() else { return };
        let before = if toward { GOOD } else { touching };
        run.correct(before, 5000, 100);
        run.correct(probe(!toward), 5000, 10);
        let output = run.correct(probe(!toward), 8000, 20);
        assert_eq!(output.probed, 0.0, "no contact yet");
        let output = run.scan(probe(toward), &[]);
        assert_eq!(output.probed, 0.008);
        run.correct(ScanInput { probing: false, ..probe(toward) }, 1000, 20);
        let output = run.correct(GOOD, 1000, 20);
        assert_eq!(output.probed, 0.008);
    }
}

/// A small correction that the control never applies is detected like a large one, once the estimate of recent motion
/// has decayed. A small correction that the control applies is not reported as lost.
#[test]
fn a_small_missing_correction_is_lost() {
    let Some(mut run) = Run::set() else { return };
    assert!(!run.correct(GOOD, 0, 30).lost());
    let still = ScanInput { does: 2, ..GOOD };
    let lost_after =
        (0..4000).find(|_| run.correct(still, 300, 0).lost() || run.correct(still, 300, 1).lost());
    // Each iteration runs three scans. The estimate of motion decays to 1/23 within a few planner lags.
    let ms = 3 * lost_after.expect("lost");
    assert!((500..2000).contains(&ms), "{ms} ms");
    let output = run.correct(GOOD, 300, 20);
    assert!(!output.lost());
    assert_eq!(output.applied(), 300);
}

/// While the epoch cannot be written to disk, frames are rejected with this cause once the number of timeouts equals
/// the advance of the epoch at a start. Otherwise an old frame could be accepted after a restart.
#[test]
fn frames_are_rejected_while_the_epoch_cannot_be_written() {
    let Some(mut run) = Run::set() else { return };
    let mut output = run.correct(GOOD, 100, 30);
    let (epoch, refusal) = (0, 4);
    let begun = output.state.report.as_slice()[epoch];
    assert_eq!(output.applied(), 100);
    run.command("disk 0");
    let mut taken = 0;
    for _ in 0..20 {
        // The gateway sends nothing for longer than the timeout, and then sends again.
        for _ in 0..310 {
            output = run.scan(GOOD, &[]);
        }
        assert_eq!(output.applied(), 0);
        output = run.correct(GOOD, 100, 5);
        if output.applied() == 0 {
            break;
        }
        assert_eq!(output.state.report.as_slice()[refusal], 0);
        taken += 1;
    }
    assert_eq!(taken, 15);
    let words = output.state.report.as_slice();
    assert_eq!(words[epoch].wrapping_sub(begun), 16);
    assert_eq!(words[refusal], 2, "the cause is reported");
    run.command("disk 1");
    let output = run.correct(GOOD, 100, 5);
    assert_eq!((output.applied(), output.state.report.as_slice()[refusal]), (100, 0));
}
