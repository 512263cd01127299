//! Transfers a map over OPC UA to a simulated PLC that was written independently from the documentation. The axes get
//! the values of the map, and transfer faults cause no step.

use std::time::{Duration, Instant};

use volcomp_sinumerik::{MapNodes, MapWords, Server, SinumerikError};
use volcomp_tables::{
    Exchange, GRID_AXES, GridAxis, Map, Output, Request, SendError, Sender, SenderLimits, Step,
    build, control::FRAME_WORDS, vocabulary::AxisName,
};
use volcomp_test_support::until;

use crate::{Peer, TIMEOUT};

const MACHINE: u16 = 1002;
/// Settings of the simulated PLC, with 10 ms per scan. The map stays valid for 4 s after the last frame, which is
/// enough for a busy computer.
const PLC: &str = "machine=1002,capacity=700,limit=100,rate=2,hold=200,time_out=400";

struct Words(MapWords);

impl Exchange for Words {
    type Error = SinumerikError;

    fn report(&mut self) -> Result<Vec<u16>, SinumerikError> {
        self.0.report()
    }

    fn write(&mut self, frame: &[u16; FRAME_WORDS]) -> Result<(), SinumerikError> {
        self.0.write(frame)
    }

    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, SinumerikError> {
        self.0.buffer(buffer, count)
    }
}

fn peer() -> Option<Peer> {
    Peer::start(&["--map", PLC, "--at", "X=700,Y=200,Z=50"])
}

fn open(peer: &Peer) -> Words {
    let mut server = Server::new(&*peer.url);
    server.time_out = Duration::from_secs(5);
    Words(MapWords::open(&server, MapNodes::default(), 700).expect("a server"))
}

/// A map over 0 to 1000 mm of X, Y and Z, with x, y and z in m: the correction is 60 µm·x − 20 µm·y² for X, 30 µm·x·z
/// for Y, and −40 µm for Z.
fn map(counter: u16) -> Map {
    let names = [AxisName::X, AxisName::Y, AxisName::Z];
    let request = Request {
        axes: names.map(|name| GridAxis { name, travel: [0.0, 1000.0], step: 0.001 }).to_vec(),
        outputs: names.map(|name| Output { name, step_mm: 0.001, limit_mm: 0.1 }).to_vec(),
        within_mm: 0.001,
        words: 700,
        counter,
        model: 1,
    };
    build(&request, &field).expect("a map").map
}

fn field(at: &[f64; GRID_AXES]) -> [f64; 3] {
    let [x, y, z] = [at[0], at[1], at[2]].map(|mm| mm / 1000.0);
    [0.06 * x - 0.02 * y * y, 0.03 * x * z, -0.04]
}

fn sender(counter: u16, owner: u16) -> Sender {
    let allowed = SenderLimits {
        limit_mm: 0.1,
        slew_mm_per_s: 0.2,
        zero_after_s: 4.0,
        scan_s: 0.01,
        capacity: 700,
    };
    Sender::new(map(counter), MACHINE, owner, allowed).expect("within the limits")
}

fn step_until(sender: &mut Sender, words: &mut Words, expected: Step) {
    let end = Instant::now() + TIMEOUT;
    while sender.step(words).expect("no fault") != expected {
        assert!(Instant::now() < end, "not {expected:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn applied_um(peer: &mut Peer, axis: &str) -> f64 {
    peer.number("map_um", axis)
}

/// Steps the sender until the correction of this axis is within 1 µm of `um`.
fn keep_until(peer: &mut Peer, sender: &mut Sender, words: &mut Words, axis: &str, um: f64) {
    until("the correction", TIMEOUT, || {
        sender.step(words).expect("no fault");
        (applied_um(peer, axis) - um).abs() <= 1.0
    });
}

fn is_valid(peer: &mut Peer) -> bool {
    peer.report().contains("\"valid\": true")
}

#[test]
fn the_axes_follow_the_map() {
    let Some(mut peer) = peer() else { return };
    let mut words = open(&peer);
    let mut sender = sender(5, 21);
    step_until(&mut sender, &mut words, Step::Kept);
    assert!(is_valid(&mut peer));
    for (axis, um) in ["X", "Y", "Z"].iter().zip(field(&[700.0, 200.0, 50.0, 0.0, 0.0])) {
        keep_until(&mut peer, &mut sender, &mut words, axis, um * 1e3);
    }
    // The true position includes the correction; the reported position does not.
    let applied_um = peer.number("correction_um", "Z");
    assert!((applied_um + 40.0).abs() <= 1.0, "{applied_um}");
    let report = peer.report();
    assert!(report.contains("\"largest_move_um\": 2}"), "{report}");
    words.0.close();
}

/// The server acknowledges writes but drops them. The map stays valid until its timeout; then the corrections ramp to
/// zero. When writes have an effect again, the map is sent again.
#[test]
fn silence_ramps_to_zero_and_the_map_is_sent_again() {
    let Some(mut peer) = peer() else { return };
    let mut words = open(&peer);
    let mut sender = sender(5, 21);
    step_until(&mut sender, &mut words, Step::Kept);
    keep_until(&mut peer, &mut sender, &mut words, "Z", -40.0);
    peer.type_in("drop-writes on");
    until("zero", TIMEOUT, || {
        let step = sender.step(&mut words).expect("the sender cannot know");
        let z = applied_um(&mut peer, "Z");
        assert!((-40.0..=0.0).contains(&z), "{z} {step:?}");
        z == 0.0
    });
    let report = peer.report();
    assert!(report.contains("\"valid\": false"), "{report}");
    assert!(report.contains("\"largest_move_um\": 2}"), "{report}");
    peer.type_in("drop-writes off");
    step_until(&mut sender, &mut words, Step::Kept);
    keep_until(&mut peer, &mut sender, &mut words, "Z", -40.0);
}

/// While a first map is active, the sender of a second map is killed during its transfer. A third sender is then
/// rejected, because another sender owns the control.
#[test]
fn a_killed_sender_and_a_foreign_sender() {
    let Some(mut peer) = peer() else { return };
    let mut words = open(&peer);
    let mut first = sender(5, 21);
    step_until(&mut first, &mut words, Step::Kept);
    keep_until(&mut peer, &mut first, &mut words, "Z", -40.0);
    let _ = first.replace(map(6)).expect("within the limits");
    until("half a map", TIMEOUT, || {
        let step = first.step(&mut words).expect("no fault");
        assert_ne!(step, Step::Kept);
        peer.number("map", "loaded") >= 64.0
    });
    drop(words);
    let report = peer.report();
    assert!(report.contains("\"valid\": true, \"counter\": 5"), "{report}");
    let mut others = open(&peer);
    let found = sender(7, 22).step(&mut others);
    assert!(matches!(found, Err(SendError::Held { by: 21, .. })), "{found:?}");
    assert!((applied_um(&mut peer, "Z") + 40.0).abs() <= 1.0);
    // After the timeout of the first map, the corrections ramp to zero, and the third sender is accepted.
    until("zero", TIMEOUT, || applied_um(&mut peer, "Z") == 0.0);
    assert!(!is_valid(&mut peer));
    let mut third = sender(7, 22);
    step_until(&mut third, &mut others, Step::Kept);
    let report = peer.report();
    assert!(report.contains("\"largest_move_um\": 2}"), "{report}");
}

/// A PLC that was restarted does not use the map in its memory, and gets the map again. A stopped PLC gets no writes.
#[test]
fn a_restarted_plc_gets_the_map_again() {
    let Some(mut peer) = peer() else { return };
    let mut words = open(&peer);
    let mut sender = sender(5, 21);
    step_until(&mut sender, &mut words, Step::Kept);
    peer.type_in("plc stop");
    step_until(&mut sender, &mut words, Step::NotScanned);
    peer.type_in("plc start");
    until("no map", TIMEOUT, || !is_valid(&mut peer));
    step_until(&mut sender, &mut words, Step::Loading);
    step_until(&mut sender, &mut words, Step::Kept);
    assert!(is_valid(&mut peer));
}
