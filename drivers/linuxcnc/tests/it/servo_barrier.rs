//! Compares the bridge's component, compiled with sanitizers and without LinuxCNC, with the reference barrier for each
//! scan and each datagram.

use std::{
    io::{BufRead as _, BufReader, Write as _},
    net::UdpSocket,
    path::Path,
    process::{Command, Stdio},
    time::Duration,
};

use proptest::{prelude::*, test_runner::TestRunner};
use volcomp_guard::{
    barrier::{Barrier, REPORT_WORDS, Settings},
    protocol::Counts,
};
use volcomp_linuxcnc::{self as linuxcnc, COMMAND_BYTES, Content, Flags, STATE_BYTES, State};
use volcomp_port::Words;
use volcomp_vocabulary::PerChannel;

use crate::{
    bridge::KEY,
    component::{Ended, MEMORY, THREADS, built, key_file},
    frames::{Post, mailboxes_of, posts, settings},
};

/// Number of scans after switching on in which the axes do not move.
const SETTLES: usize = 20;
/// Advance of the epoch at a start, relative to the stored epoch.
const EPOCHS_AHEAD: u16 = 16;

#[derive(Clone, Debug)]
struct Case {
    settings: Settings,
    kept: u16,
    tick: u16,
    applied: [i16; 2],
    scans: Vec<(bool, Post, Post, usize)>,
}

fn cases() -> impl Strategy<Value = Case> {
    (
        0_u16..=65_534,
        prop_oneof![Just(0_u16), Just(u16::MAX - 15), any::<u16>()],
        any::<u16>(),
        [1_i16..200, 1_i16..i16::MAX],
        [1_i16..20, 1_i16..300],
        (1_u16..4, 1_u16..20),
        (any::<i16>(), -30_i16..30),
        prop::collection::vec((prop::bool::weighted(0.1), posts(), posts(), 1_usize..30), 1..150),
    )
        .prop_map(|(machine, kept, tick, limit, rate, (step, hold), applied, scans)| Case {
            settings: settings(machine, limit, rate, [step, hold]),
            kept,
            tick,
            applied: applied.into(),
            scans,
        })
}

/// Socket of a gateway, with the run number and the sequence number of the last state received.
struct Sender {
    socket: UdpSocket,
    answers: [u32; 2],
}

impl Sender {
    fn new(port: u16) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.connect(("127.0.0.1", port)).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        Self { socket, answers: [0; 2] }
    }

    fn send(&mut self, machine: u16, words: Option<&Vec<u16>>) {
        let content =
            words.map_or(Content::Listen, |words| Content::Frame(Words::new(words).unwrap()));
        let command = linuxcnc::Command { machine, answers: self.answers, content };
        let mut bytes = [0; COMMAND_BYTES];
        let length = command.encode(&KEY, &mut bytes);
        self.socket.send(&bytes[..length]).unwrap();
    }

    fn receive(&mut self) -> State {
        let mut bytes = [0; STATE_BYTES + 1];
        let length = self.socket.recv(&mut bytes).unwrap();
        let state = State::decode(&bytes[..length], &KEY).unwrap();
        self.answers = [state.run, state.sequence];
        state
    }
}

fn same(program: &Path, dir: &Path, case: &Case) -> Result<[usize; 2], TestCaseError> {
    let s = &case.settings;
    let epoch_file = dir.join("epoch");
    std::fs::write(&epoch_file, case.kept.to_string()).unwrap();
    let before = case.kept.wrapping_add(EPOCHS_AHEAD - 1);
    let applied: Counts = PerChannel::leading(case.applied);
    let mut barrier = Barrier::start(*s, before, case.tick, &applied).unwrap();
    let mut child = Ended(
        Command::new(program)
            .arg(&epoch_file)
            .arg(key_file(dir))
            // Memory that system libraries keep until the end is no leak.
            .env("ASAN_OPTIONS", "detect_leaks=0")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut input = child.0.stdin.take().unwrap();
    let mut answers = BufReader::new(child.0.stdout.take().unwrap()).lines();
    writeln!(
        input,
        "XC {} {} {} {} {} {} {} {} {} {} {}",
        s.machine,
        s.step_scans,
        s.hold_scans,
        s.time_out_scans,
        case.tick,
        s.limit[0],
        s.limit[1],
        s.rate[0],
        s.rate[1],
        case.applied[0],
        case.applied[1]
    )
    .unwrap();
    let port: u16 = answers.next().unwrap().unwrap().parse().unwrap();
    let mut senders = [Sender::new(port), Sender::new(port)];
    // A command that answers no state only requests states, so that the first scan accepts no frame.
    for sender in &mut senders {
        sender.send(s.machine, None);
    }
    writeln!(input, "0").unwrap();
    answers.next().unwrap().unwrap();
    barrier.scan(&[], true);
    let first = senders.each_mut().map(Sender::receive);
    prop_assert_eq!(first[0], first[1]);
    let (mut scan, mut counts) = (1, [0; 2]);
    for (shall_hold, first, second, times) in &case.scans {
        for repeat in 0..*times {
            let last = barrier.report();
            let mailboxes = mailboxes_of([*first, *second], repeat, &last);
            for (at, sender) in senders.iter_mut().enumerate() {
                sender.send(s.machine, mailboxes.get(at));
            }
            writeln!(input, "{}", u8::from(*shall_hold)).unwrap();
            let held = answers.next().unwrap().unwrap() == "1";
            prop_assert_eq!(held, *shall_hold || scan < SETTLES, "scan {}", scan);
            let state = senders[0].receive();
            prop_assert_eq!(senders[1].receive(), state);
            let mailboxes: Vec<&[u16]> = mailboxes.iter().map(Vec::as_slice).collect();
            let mut report = [0; REPORT_WORDS];
            let output = barrier.scan(&mailboxes, held);
            let length = output.encode(&mut report);
            prop_assert_eq!(state.report.as_slice(), &report[..length], "scan {}", scan);
            prop_assert_eq!(state.machine, s.machine);
            prop_assert_eq!(usize::try_from(state.sequence), Ok(scan + 1));
            prop_assert_eq!(state.flags.has(Flags::EMERGENCY_STOP), *shall_hold);
            prop_assert!(!state.flags.has(Flags::LOST));
            scan += 1;
            counts[0] += usize::from(output.owner != 0 && output.sequence != last.sequence);
            counts[1] += usize::from(output.applied != last.applied);
        }
    }
    drop(input);
    let status = child.0.wait().unwrap();
    prop_assert!(status.success(), "{status}");
    // When it ends, the component has stored its epoch.
    let kept = std::fs::read_to_string(&epoch_file).unwrap();
    prop_assert_eq!(kept.trim().parse(), Ok(barrier.report().epoch));
    Ok(counts)
}

#[test]
fn the_component_equals_the_reference_at_every_scan() {
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("linuxcnc-component");
    std::fs::create_dir_all(&dir).unwrap();
    let Some(program) = built(&dir, "datagrams.c", MEMORY) else {
        return;
    };
    let mut runner = TestRunner::new(ProptestConfig { cases: 24, ..ProptestConfig::default() });
    let seen = std::cell::Cell::new([0; 2]);
    let ran = runner.run(&cases(), |case| {
        let counts = same(&program, &dir, &case)?;
        let before = seen.get();
        seen.set([before[0] + counts[0], before[1] + counts[1]]);
        Ok(())
    });
    ran.unwrap_or_else(|error| panic!("{error}"));
    // Each kind of case occurred often: frames were accepted and axes moved.
    assert!(seen.get().iter().all(|count| *count > 100), "{:?}", seen.get());
}

/// The servo thread and the thread that stores the epoch share only atomic words: the thread sanitizer finds no data
/// race.
#[test]
fn the_component_has_no_data_race() {
    let dir = tempfile::tempdir().unwrap();
    let Some(program) = built(dir.path(), "datagrams.c", THREADS) else {
        return;
    };
    // The scans include a timeout, which advances the epoch.
    let scans = "0\n".repeat(60);
    let input = format!("XC 7 1 2 7 0 100 100 5 5 0 0\n{scans}");
    let run = |command: &mut Command| {
        let mut child = command
            .arg(dir.path().join("epoch"))
            .arg(key_file(dir.path()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // The program may exit before it has read all input.
        let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
        let output = child.wait_with_output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.success(), errors)
    };
    let (mut succeeds, mut errors) = run(&mut Command::new(&program));
    if errors.contains("unexpected memory mapping") {
        // The kernel randomises more address bits than the sanitizer library supports.
        (succeeds, errors) = run(Command::new("setarch").arg("-R").arg(&program));
    }
    assert!(succeeds && !errors.contains("data race"), "{errors}");
}
