//! A map in the PMC: the sender of `volcomp-tables` over FOCAS to the map of the simulated control.

use std::time::{Duration, Instant};

use volcomp_focas::{FocasError, MapPlaces, MapWords, PmcAddress, PmcArea};
use volcomp_tables::{
    Exchange, GRID_AXES, GridAxis, Map, Output, Request, SendError, Sender, SenderLimits, Step,
    build,
    control::{FRAME_WORDS, REPORT_WORDS},
};
use volcomp_vocabulary::AxisName;

use super::{PATIENCE, Simulator};

const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];
const CAPACITY: u16 = 700;
/// The map is valid for 6 s after the last frame, so that a busy test still has it. Then the correction ramps to zero by 2 µm per scan of 8 ms.
const CONTROL: [&str; 14] = [
    "--map-words",
    "700",
    "--machine-number",
    "1002",
    "--limit-um",
    "100",
    "--rate-um-per-s",
    "250",
    "--scan-ms",
    "8",
    "--hold-ms",
    "400",
    "--time-out-ms",
    "6000",
];

struct Words(MapWords);

impl Exchange for Words {
    type Error = FocasError;

    fn report(&mut self) -> Result<Vec<u16>, FocasError> {
        self.0.report(REPORT_WORDS)
    }

    fn write(&mut self, frame: &[u16; FRAME_WORDS]) -> Result<(), FocasError> {
        self.0.write(frame)
    }

    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, FocasError> {
        self.0.buffer(buffer, count)
    }
}

fn places() -> MapPlaces {
    let d = |at| PmcAddress { area: PmcArea::D, at };
    MapPlaces { mailbox: d(0), report: d(144), buffers: d(200), capacity: CAPACITY.into() }
}

fn open(simulator: &Simulator) -> Words {
    Words(MapWords::open("127.0.0.1", simulator.port, PATIENCE, places()).unwrap())
}

/// Correction of X: 60 µm · x/1000 - 20 µm · (y/1000)²; of Y: 30 µm · x·z; of Z: -40 µm.
fn field(at: &[f64; GRID_AXES]) -> [f64; 3] {
    let [x, y, z] = [at[0], at[1], at[2]].map(|mm| mm / 1000.0);
    [0.06 * x - 0.02 * y * y, 0.03 * x * z, -0.04]
}

fn map(counter: u16) -> Map {
    let request = Request {
        axes: AXES.map(|name| GridAxis { name, travel: [0.0, 1000.0], step: 0.001 }).to_vec(),
        outputs: AXES.map(|name| Output { name, step_mm: 0.001, limit_mm: 0.1 }).to_vec(),
        within_mm: 0.001,
        words: CAPACITY.into(),
        counter,
        model: 1,
    };
    build(&request, &field).unwrap().map
}

fn sender(counter: u16, owner: u16) -> Sender {
    let allowed = SenderLimits {
        limit_mm: 0.1,
        slew_mm_per_s: 0.25,
        zero_after_s: 6.0,
        scan_s: 0.008,
        capacity: CAPACITY.into(),
    };
    Sender::new(map(counter), 1002, owner, allowed).unwrap()
}

/// Shifts of the axes, from R100 on, µm.
fn shifts(simulator: &Simulator) -> [f64; 3] {
    let bytes = simulator.client().read_pmc(PmcArea::R, 100, 6).unwrap();
    let word = |at: usize| f64::from(i16::from_le_bytes([bytes[at], bytes[at + 1]]));
    [word(0), word(2), word(4)]
}

/// Steps until the axes have the corrections `um` within 1 µm.
fn steps_until(simulator: &Simulator, sender: &mut Sender, words: &mut Words, um: [f64; 3]) {
    let end = Instant::now() + 6 * PATIENCE;
    loop {
        let step = sender.step(words).unwrap();
        let has = shifts(simulator);
        if has.iter().zip(um).all(|(has, um)| (has - um).abs() <= 1.0) {
            return;
        }
        assert!(Instant::now() < end, "{has:?} {step:?}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn the_axes_follow_the_map_and_silence_ramps_to_zero() {
    let at = ["--at", "X=700,Y=200,Z=50"];
    let mut simulator = Simulator::start(&[&CONTROL[..], &at].concat());
    let mut words = open(&simulator);
    let mut first = sender(5, 21);
    let um = field(&[700.0, 200.0, 50.0, 0.0, 0.0]).map(|mm| mm * 1e3);
    steps_until(&simulator, &mut first, &mut words, um);
    // Another sender finds the control in use, and changes nothing.
    let held = sender(7, 22).step(&mut open(&simulator));
    assert!(matches!(held, Err(SendError::Held { by: 21, .. })), "{held:?}");
    let end = Instant::now() + PATIENCE;
    while shifts(&simulator) != [0.0; 3] {
        assert!(Instant::now() < end, "{:?}", shifts(&simulator));
        std::thread::sleep(Duration::from_millis(20));
    }
    // A restarted program ignores the memory, and the map is sent again.
    steps_until(&simulator, &mut first, &mut words, um);
    simulator.type_line("reset");
    let end = Instant::now() + PATIENCE;
    while first.step(&mut words).unwrap() != Step::Loading {
        assert!(Instant::now() < end, "it is not brought again");
        std::thread::sleep(Duration::from_millis(2));
    }
    steps_until(&simulator, &mut first, &mut words, um);
    simulator.type_line("steps");
    let line = simulator.line();
    for axis in ["X", "Y", "Z"] {
        let step = line.split(&format!("{axis} ")).nth(1).unwrap();
        let um: f64 = step.split(' ').next().unwrap().parse().unwrap();
        assert!(um <= 2.0, "{line}");
    }
}

#[test]
fn invalid_settings_are_rejected() {
    for (arguments, words) in [
        (&["--map-words", "68"][..], "69..=2450"),
        (&["--map-words", "700", "--axes", "X,A"], "at most 3 linear axes"),
        (&["--map-words", "700", "--rate-um-per-s", "1"], "--rate-um-per-s: found 1"),
        (&["--map-words", "700", "--hold-ms", "400", "--time-out-ms", "500"], "--map-words: "),
    ] {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_focas-sim"))
            .args(["--listen", "127.0.0.1:0"])
            .args(arguments)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(words), "{arguments:?}: {said}");
    }
}
