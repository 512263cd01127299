//! The program as scripts and operators call it.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod map;
mod targets;

use std::{
    io::{BufRead, BufReader, Write},
    path::PathBuf,
    process::{ChildStdout, Command, Stdio},
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_focas::{Client, PmcArea, PositionKind};
use volcomp_guard::{
    barrier::{FRAME_WORDS, Report},
    protocol::{Layout, Session},
};
use volcomp_test_support::{Running, machines::gantry};
use volcomp_vocabulary::{AxisName, PerChannel};

/// Timeout of all waits; long enough for a busy computer.
const PATIENCE: Duration = Duration::from_secs(60);

struct Simulator {
    running: Running,
    port: u16,
    output: BufReader<ChildStdout>,
}

impl Simulator {
    fn start(arguments: &[&str]) -> Self {
        let (running, line, output) = Running::start_and_hear(
            Command::new(env!("CARGO_BIN_EXE_focas-sim"))
                .args(["--listen", "127.0.0.1:0"])
                .args(arguments)
                .stdin(Stdio::piped()),
        );
        let port = line.strip_prefix("listening on 127.0.0.1:").unwrap();
        Self { port: port.parse().unwrap(), running, output }
    }

    fn client(&self) -> Client {
        Client::open("127.0.0.1", self.port, PATIENCE).unwrap()
    }

    fn type_line(&mut self, line: &str) {
        writeln!(self.running.stdin.as_mut().unwrap(), "{line}").unwrap();
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.output.read_line(&mut line).unwrap();
        line
    }

    fn json(&mut self) -> Value {
        serde_json::from_str(&self.line()).unwrap()
    }

    fn end(&mut self) -> Option<i32> {
        self.running.ended(PATIENCE).expect("it ends").code()
    }
}

fn examples() -> PathBuf {
    volcomp_test_support::root().join("examples")
}

fn until(what: &str, holds: impl FnMut() -> bool) {
    volcomp_test_support::until(what, PATIENCE, holds);
}

/// Waits until the emergency stop is pressed, from which on the axes stand.
fn is_stopped(simulator: &Simulator) {
    let mut client = simulator.client();
    until("the emergency stop is pressed", || client.status().unwrap().emergency != 0);
}

#[test]
fn it_listens_and_moves_the_axes() {
    let simulator = Simulator::start(&["--axes", "X,Y,C", "--version", "4", "--stroke-mm", "100"]);
    let mut client = simulator.client();
    assert_eq!(client.version(), 4);
    assert_eq!(client.axis_names().unwrap(), ['X', 'Y', 'C']);
    let first = client.positions(PositionKind::Machine, 3).unwrap();
    until("it moves", || client.positions(PositionKind::Machine, 3).unwrap() != first);
}

#[test]
fn axes_start_at_the_given_positions() {
    let simulator = Simulator::start(&["--axes", "X,Y,Z,C", "--at", "C=-30.5, X=100"]);
    let positions = simulator.client().positions(PositionKind::Machine, 4);
    assert_eq!(positions.unwrap(), [100.0, 0.0, 0.0, -30.5]);
}

#[test]
fn a_program_is_repeated() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("moves.csv");
    std::fs::write(&file, "X,C,feed,dwell_s\n0,0,6000,0.2\n10,90,60000,0.2\n").unwrap();
    let file = file.to_str().unwrap();
    let simulator = Simulator::start(&["--axes", "X,Y,C", "--program", file, "--at", "Y=7"]);
    let mut client = simulator.client();
    let mut seen = Vec::new();
    until("two repetitions", || {
        let positions = client.positions(PositionKind::Machine, 3).unwrap();
        let on_the_way = (0.0..=10.0).contains(&positions[0]) && positions[1] == 7.0;
        let together = (positions[2] - 9.0 * positions[0]).abs() < 0.01;
        assert!(on_the_way && together, "{positions:?}");
        let ends = [0.0, 10.0].map(|x| positions[0] == x);
        if ends.contains(&true) && seen.last() != Some(&ends) {
            seen.push(ends);
        }
        seen.len() >= 4
    });
}

#[test]
fn states_are_set_by_options_and_commands() {
    let mut simulator = Simulator::start(&["--alarm", "--estop", "--unreferenced"]);
    let mut client = simulator.client();
    let mut states = move || {
        let status = client.status().unwrap();
        let bits = client.read_pmc(PmcArea::F, 120, 1).unwrap()[0];
        [status.alarm != 0, status.emergency != 0, bits & 0b111 != 0b111]
    };
    assert_eq!(states(), [true; 3]);
    for (line, expected) in [
        ("alarm off", [false, true, true]),
        ("estop off", [false, false, true]),
        ("nonsense", [false, false, true]),
        ("unreferenced off", [false, false, false]),
        ("alarm on", [true, false, false]),
    ] {
        simulator.type_line(line);
        until(line, || states() == expected);
    }
    simulator.type_line("quit");
    assert_eq!(simulator.end(), Some(0));
}

/// The axes stop during an emergency stop. Afterwards they continue from there without a jump.
#[test]
fn the_axes_stop_during_an_emergency_stop() {
    let mut simulator = Simulator::start(&["--stroke-mm", "100", "--period-s", "60"]);
    let mut client = simulator.client();
    let mut at = || client.positions(PositionKind::Machine, 3).unwrap()[0];
    let start = at();
    until("it moves", || at() > start + 0.01);
    simulator.type_line("estop on");
    is_stopped(&simulator);
    let stands = at();
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(at(), stands);
    let released = Instant::now();
    simulator.type_line("estop off");
    let mut after = stands;
    until("it goes on", || {
        after = at();
        after > stands
    });
    // 100 mm back and forth within 60 s is at most 5.3 mm/s.
    let most = 5.3 * released.elapsed().as_secs_f64();
    assert!(after < stands + most, "{stands} to {after} mm, at most {most} mm");
}

#[test]
fn it_pauses_and_answers_afterwards() {
    let mut simulator = Simulator::start(&[]);
    let mut client = simulator.client();
    let pauses = |client: &mut Client, ms| {
        until("it pauses, and answers", || {
            let asked = Instant::now();
            client.status().unwrap();
            asked.elapsed() > Duration::from_millis(ms)
        });
    };
    simulator.type_line("pause 0.4");
    pauses(&mut client, 300);
    let simulator = Simulator::start(&["--pause-s", "0.3", "--pause-every-s", "0.6"]);
    pauses(&mut simulator.client(), 200);
}

#[test]
fn the_tool_error_is_reported() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("machine.toml");
    let errors = "[errors]\nEXX = 5.0\nEYX = { poly = [0.0, 0.1] }\n";
    let machine = gantry([[0.0, 200.0]; 3]) + errors;
    std::fs::write(&file, machine).unwrap();
    let truth = ["--truth", file.to_str().unwrap()];
    let mut simulator = Simulator::start(&[
        truth[0],
        truth[1],
        "--no-barrier",
        "--at",
        "X=100",
        "--json",
        "--report-s",
        "0.1",
    ]);
    let report = simulator.json();
    assert_eq!(report["positions_mm"], serde_json::json!({"X": 100.0, "Y": 0.0, "Z": 0.0}));
    let miss = |report: &Value, name: &str| {
        let of = |k: usize| report[name]["position_um"][k].as_f64().unwrap();
        [of(0), of(1), of(2)]
    };
    assert_eq!(miss(&report, "error"), [5.0, 10.0, 0.0]);
    assert_eq!(miss(&report, "residual"), [5.0, 10.0, 0.0]);
    // -4 µm on X and -10 µm on Y, as a gateway writes them.
    let words = [0xfc, 0xff, 0xf6, 0xff];
    simulator.client().write_pmc(PmcArea::R, 100, &words).unwrap();
    until("the shift acts", || {
        let report = simulator.json();
        assert_eq!(miss(&report, "error"), [5.0, 10.0, 0.0]);
        let [x, y, _] = miss(&report, "residual");
        (x - 1.0).abs() < 0.01 && y.abs() < 0.01
    });
    // The same report as text. With `--report-s 0` the simulator reports only on request.
    let mut simulator = Simulator::start(&[truth[0], truth[1], "--report-s", "0"]);
    simulator.type_line("report");
    let line = simulator.line();
    assert!(
        line.contains("X 0.0 Y 0.0 Z 0.0  tool error, unaligned 5.0 → 5.0 µm, 0.0 → 0.0 µrad"),
        "{line}"
    );
    let mut simulator = Simulator::start(&["--at", "Y=7.25", "--no-barrier"]);
    simulator.client().write_pmc(PmcArea::R, 102, &[3, 0]).unwrap();
    simulator.type_line("report");
    let line = simulator.line();
    assert!(line.contains("X 0.0 (+0.0 µm) Y 7.2 (+3.0 µm)"), "{line}");
}

/// By default a barrier moves the axes at its rate. Its next scan overwrites words written by other clients.
#[test]
fn a_barrier_protects_the_axes_by_default() {
    let mut simulator = Simulator::start(&[
        "--axes",
        "Y,X,C",
        "--barrier-axes",
        "X,C",
        "--machine-number",
        "4711",
        "--json",
    ]);
    let mut client = simulator.client();
    client.write_pmc(PmcArea::R, 102, &[0x88, 0x13, 0x88, 0x13]).unwrap();
    let mut words = |at: u16, count: u16| -> Vec<u16> {
        let bytes = client.read_pmc(PmcArea::R, at, 2 * count).unwrap();
        let words = bytes.chunks_exact(2);
        words.map(|b| u16::from_le_bytes([b[0], b[1]])).collect()
    };
    until("the words are overwritten", || words(100, 3) == [0; 3]);
    simulator.type_line("steps");
    // In each scan the axes read their words after the program.
    let steps = simulator.json();
    assert_eq!(steps["largest_step_um"], serde_json::json!({"X": 0.0, "Y": 0.0}));
    simulator.type_line("steps reset");
    // A correction of 30 µm and of -10 counts of 0.001° is sent until the axes have applied it.
    let mut session = Session::new(7);
    let mut client = simulator.client();
    let mut settings = None;
    let layout = Layout::of([AxisName::X, AxisName::C]).unwrap();
    until("applied", || {
        let bytes = client.read_pmc(PmcArea::R, 240, 2 * (8 + 3 * 2 + 2)).unwrap();
        let words: Vec<u16> =
            bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        let report = Report::decode(4711, layout, &words).expect("read whole");
        session.read(report.head());
        let frame = session.frame(&PerChannel::leading([30, -10]));
        let mut words = [0; FRAME_WORDS];
        if let Some(frame) = frame {
            let length = frame.encode(&report.settings, &mut words);
            let bytes: Vec<u8> = words[..length].iter().flat_map(|w| w.to_le_bytes()).collect();
            client.write_pmc(PmcArea::R, 200, &bytes).unwrap();
        }
        settings = Some(report.settings);
        let is_applied = report.applied == PerChannel::leading([30, -10]);
        // The words of this moment: without frames the barrier ramps them to zero.
        let bytes = client.read_pmc(PmcArea::R, 100, 6).unwrap();
        is_applied && bytes == [0, 0, 30, 0, 0xf6, 0xff]
    });
    let settings = settings.unwrap();
    assert_eq!((settings.limit[0], settings.rate[0]), (150, 2));
    assert_eq!((settings.hold_scans, settings.time_out_scans), (100, 225));
    simulator.type_line("quit");
    assert_eq!(simulator.end(), Some(0));
    let steps = simulator.json();
    assert_eq!(steps["largest_step_um"], serde_json::json!({"X": 2.0, "Y": 0.0}));
    let rotary = steps["largest_step_urad"]["C"].as_f64().unwrap();
    assert!((rotary - 17.453).abs() < 1e-3, "{rotary}");
}

#[test]
fn the_machine_file_defines_five_axes() {
    let file = examples().join("table-tilting.toml");
    let mut simulator = Simulator::start(&["--truth", file.to_str().unwrap(), "--report-s", "0.1"]);
    let names = simulator.client().axis_names().unwrap();
    assert_eq!(names, ['X', 'Y', 'Z', 'A', 'C']);
    // The report has two lines of at most 80 columns.
    let [places, misses] = [simulator.line(), simulator.line()];
    assert!(places.contains(" A 0.0 C 0.0"), "{places}");
    assert!(misses.starts_with("            tool error, unaligned "), "{misses}");
}

#[test]
fn it_exits_cleanly() {
    for signal in ["INT", "TERM"] {
        let mut simulator = Simulator::start(&[]);
        simulator.running.signal(signal);
        assert_eq!(simulator.end(), Some(0), "SIG{signal}");
    }
    // End of input does not end the simulator.
    let mut simulator = Simulator::start(&[]);
    drop(simulator.running.stdin.take());
    std::thread::sleep(Duration::from_millis(200));
    assert!(simulator.client().status().is_ok());
}

#[test]
fn invalid_arguments_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let program = |name: &str, text: &str| {
        let file = dir.path().join(name);
        std::fs::write(&file, text).unwrap();
        file.to_str().unwrap().to_owned()
    };
    let empty = program("empty.csv", "X,Y\n");
    let column = program("column.csv", "X,Q\n1,2\n");
    let number = program("number.csv", "X,feed\n1,600\nx,600\n");
    let feed = program("feed.csv", "X,feed\n1,0\n");
    let dwell = program("dwell.csv", "X,dwell_s\n1,-1\n");
    let short = program("short.csv", "X,Y\n1\n");
    let good = program("good.csv", "X\n1\n");
    let truth = examples().join("table-tilting.toml");
    let truth = truth.to_str().unwrap();
    for (arguments, expected) in [
        (&["--listen", "nonsense"][..], "--listen nonsense"),
        (&["--version", "9"], "9 is not in 2..=4"),
        (&["--latency-ms=-1"], "--latency-ms"),
        (&["--period-s", "0"], "--period-s"),
        (&["--stroke-mm", "inf"], "--stroke-mm"),
        (&["--axes", "X,Q"], "expected one of the axis letters"),
        (&["--axes", "X,X"], "--axes: found the axis X twice"),
        (&["--at", "X:1"], "--at: found `X:1`, expected an axis letter"),
        (&["--at", "C=1"], "expected an axis of X,Y,Z"),
        (&["--at", "X=1,X=2"], "every axis once"),
        (&["--at", "X=nan"], "--at: found `X=nan`"),
        (&["--at", "X=1", "--stroke-mm", "1"], "cannot be used with"),
        (&["--pause-s", "60"], "less than --pause-every-s 30"),
        (&["--program", "none.csv"], "none.csv: cannot be read"),
        (&["--program", &empty], "no rows"),
        (&["--program", &column], "column.csv:1: header: found the column `Q`"),
        (&["--program", &number], "number.csv:3: X: found `x`"),
        (&["--program", &feed], "feed.csv:2: feed: found 0"),
        (&["--program", &dwell], "dwell.csv:2: dwell_s: found -1"),
        (&["--program", &short], "short.csv:2: "),
        (&["--scan-ms", "0"], "--scan-ms: found 0, expected 0.1 to 1000"),
        (&["--time-out-ms", "398"], "the barrier: time-out: found 199 scans"),
        (&["--limit-um", "0"], "the barrier: axis 0"),
        (&["--limit-um", "nan"], "the barrier: axis 0"),
        (&["--no-barrier", "--limit-um", "10"], "cannot be used with"),
        (&["--barrier-axes", "X,C"], "--barrier-axes: found X,C, expected axes of X,Y,Z"),
        (&["--barrier-axes", "X,X"], "every one once"),
        (
            &["--acceleration-mm-s2", "0", "--program", &good],
            "--acceleration-mm-s2: found 0, expected 1 to 1000000",
        ),
        (&["--report", "r.csv", "--program", &good], "--truth"),
        (&["--report", "r.csv", "--truth", truth], "--program"),
        (&["--wait", "--program", &good], "--report"),
        (&["--truth", "none.toml"], "none.toml"),
        (&["--truth", truth, "--axes", "X,Y,Z"], "the axis A too"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_focas-sim"))
            .args(arguments)
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(expected), "{arguments:?}: {message}");
    }
    // A port in use is a failure, not an invalid argument.
    let taken = Simulator::start(&[]);
    let output = Command::new(env!("CARGO_BIN_EXE_focas-sim"))
        .args(["--listen", &format!("127.0.0.1:{}", taken.port)])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    let version = Command::new(env!("CARGO_BIN_EXE_focas-sim")).arg("--version").output().unwrap();
    assert!(version.status.success());
}

/// The axis log has a line for every change of a correction, and marks changes while the control is off.
#[test]
fn the_axis_log_has_every_change() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("axes.csv");
    let arguments = ["--no-barrier", "--axes", "X,C", "--axis-log"];
    let mut simulator = Simulator::start(&[&arguments[..], &[log.to_str().unwrap()]].concat());
    let read = || std::fs::read_to_string(&log).unwrap();
    // A write before the first scan would be in its line.
    until("the first scan", || read().lines().count() > 1);
    for (line, rows) in [("write R100 251 255 1 0", 2), ("reset", 2), ("power", 3)] {
        simulator.type_line(line);
        until(line, || read().lines().count() > rows);
    }
    simulator.type_line("quit");
    assert_eq!(simulator.end(), Some(0));
    let text = read();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("monotonic_s,switched_on,X_um,C_urad"));
    let (times, rest): (Vec<f64>, Vec<&str>) = lines
        .map(|line| line.split_once(',').unwrap())
        .map(|(time, rest)| (time.parse::<f64>().unwrap(), rest))
        .unzip();
    assert!(times.is_sorted(), "{text}");
    // 0.001° is 17.453 µrad.
    assert_eq!(rest, ["0,0.000,0.000", "0,-5.000,17.453", "1,0.000,0.000"]);
}
