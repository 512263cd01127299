use std::time::{Duration, Instant};

use volcomp_can::{
    BridgeConfig, CanController, CanThermometer, Frame, Received, SHIPPED_DBC, SignalTable,
};
use volcomp_port::{
    Controller, ControllerState, Fault, Quality, Reason, ShownStates, Thermometer, contract,
};
use volcomp_test_support::cases;
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{Bus, frame_of, shipped, soon};

fn config(axes: &[AxisName]) -> BridgeConfig {
    crate::config(SHIPPED_DBC, axes)
}

/// A control that sends its positions and applies the last correction.
struct Control {
    bus: Bus,
    table: SignalTable,
    counter: u64,
    applied_um: f64,
}

impl Control {
    fn new(bus: &Bus) -> Self {
        Self { bus: bus.clone(), table: shipped(), counter: 0, applied_um: 0.0 }
    }

    fn sends(&mut self, x_mm: f64, state: &[(&str, f64)]) {
        self.counter += 1;
        for frame in self.bus.sent() {
            let (message, place) = self.table.find("X_CORR").unwrap();
            assert!(self.table.messages[message].is_whole(frame.data()));
            self.applied_um = self.table.messages[message].signals[place].value(frame.data());
        }
        let counter = self.counter % 16;
        let place = [("X_POS", x_mm), ("Y_POS", -2.0 * x_mm)];
        self.bus.deliver(frame_of(&self.table, "POSITION_XY", &place, counter));
        let place = [("Z_POS", 0.5 * x_mm), ("C_POS", 90.0)];
        self.bus.deliver(frame_of(&self.table, "POSITION_ZC", &place, counter));
        let applied = [("X_APPLIED", self.applied_um), ("REFERENCED", 1.0)];
        let state = [&applied[..], state].concat();
        self.bus.deliver(frame_of(&self.table, "STATE", &state, counter));
    }
}

/// Frames of other devices on the bus are not asked for: at 4 of them in a millisecond they took the place of the own
/// ones, and the link held on and off.
#[test]
fn only_the_used_messages_are_asked_for() {
    let bus = Bus::default();
    CanController::new(bus.clone(), &config(&[AxisName::X])).unwrap();
    assert_eq!(bus.state().asked, [(256, false), (258, false)]);
    CanController::new(bus.clone(), &config(&[AxisName::Z])).unwrap();
    assert_eq!(bus.state().asked, [(257, false), (258, false)]);
    CanThermometer::new(bus.clone(), &shipped(), &[]).unwrap();
    assert_eq!(bus.state().asked, [(288, false)]);
}

/// Read-only axes follow the corrected ones; a bridge without corrected axes sends nothing.
#[test]
fn read_only_axes_are_read_and_nothing_is_sent() {
    let bus = Bus::default();
    let mut control = Control::new(&bus);
    let read = |axes: &[AxisName]| {
        let reads = vec![AxisName::C, AxisName::Y];
        let config = BridgeConfig { reads, ..config(axes) };
        CanController::new(bus.clone(), &config).unwrap()
    };
    let (mut writer, mut reader) = (read(&[AxisName::X]), read(&[]));
    control.sends(12.0, &[]);
    let positions = writer.read(soon()).unwrap().positions;
    assert!((positions[1] - std::f64::consts::FRAC_PI_2).abs() < 1e-6);
    assert_eq!([positions[0], positions[2], positions[3]], [12.0, -24.0, 0.0]);
    control.sends(12.0, &[]);
    let positions = reader.read(soon()).unwrap().positions;
    assert_eq!([positions[1], positions[2]], [-24.0, 0.0]);
    bus.sent();
    assert!(matches!(reader.apply(&PerChannel::ZERO, soon()), Err(Fault::Unsupported(_))));
    assert!(bus.sent().is_empty(), "nothing is sent");
    writer.apply(&PerChannel::ZERO, soon()).unwrap();
    assert!(!bus.sent().is_empty());
}

#[test]
fn positions_are_received_and_corrections_sent() {
    let bus = Bus::default();
    let mut control = Control::new(&bus);
    let mut controller =
        CanController::new(bus.clone(), &config(&[AxisName::X, AxisName::Z, AxisName::C])).unwrap();
    assert_eq!(controller.read(soon()), Err(Fault::TimedOut), "nothing received yet");
    control.sends(100.0, &[]);
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.positions[0] - 100.0).abs() < 1e-9);
    assert!((snapshot.positions[1] - 50.0).abs() < 1e-9);
    assert!((snapshot.positions[2] - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    assert!(snapshot.state.referenced && !snapshot.state.alarm);
    controller.apply(&PerChannel::leading([0.0123, -0.005, 2e-6]), soon()).unwrap();
    control.sends(101.0, &[("ALARM", 1.0), ("EMERGENCY_STOP", 1.0)]);
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.applied.unwrap()[0] - 0.012).abs() < 1e-12);
    assert!(snapshot.state.alarm && snapshot.state.emergency_stop);
    assert_eq!(controller.saturated(), 0);
    controller.apply(&PerChannel([5.0; 9]), soon()).unwrap();
    assert_eq!(controller.saturated(), 3);
}

#[test]
fn the_controller_contract() {
    struct Answering(CanController<Bus>, Control);
    impl Controller for Answering {
        fn description(&self) -> &volcomp_port::Description {
            self.0.description()
        }
        fn read(&mut self, deadline: std::time::Instant) -> Result<volcomp_port::Snapshot, Fault> {
            self.1.sends(5.0, &[]);
            self.0.read(deadline)
        }
        fn apply(
            &mut self,
            c: &PerChannel<f64>,
            deadline: std::time::Instant,
        ) -> Result<(), Fault> {
            self.0.apply(c, deadline)
        }
    }
    let bus = Bus::default();
    let controller = CanController::new(bus.clone(), &config(&[AxisName::X])).unwrap();
    contract::controller(&mut Answering(controller, Control::new(&bus)));
}

/// Repeated counters, lost frames, wrong checksums and lengths, error frames, bus-off and an interface that is down are
/// counted or reported, and change no position.
#[test]
fn bus_errors_are_counted_and_never_change_a_position() {
    let bus = Bus::default();
    let table = shipped();
    let mut controller = CanController::new(bus.clone(), &config(&[AxisName::X])).unwrap();
    let xy = |x: f64, counter| frame_of(&table, "POSITION_XY", &[("X_POS", x)], counter);
    bus.deliver(xy(1.0, 3));
    bus.deliver(frame_of(&table, "STATE", &[], 3));
    let mut read = |expected: f64| {
        let found = controller.read(soon()).unwrap().positions[0];
        assert!((found - expected).abs() < 1e-9, "{found}");
        controller.health()
    };
    assert_eq!(read(1.0), volcomp_can::Health::default());
    bus.deliver(xy(2.0, 3));
    assert_eq!(read(1.0).repeated, 1);
    bus.deliver(xy(3.0, 7));
    assert_eq!(read(3.0).lost, 3);
    let mut wrong = xy(4.0, 8);
    wrong.data_mut()[0] ^= 1;
    bus.deliver(wrong);
    bus.deliver(volcomp_can::Frame::new(256, false, false, &[1, 2, 3]).unwrap());
    assert_eq!(read(3.0).broken, 2);
    bus.state().incoming.push_back(Received::Error);
    assert_eq!(read(3.0).errors, 1);
    bus.state().incoming.push_back(Received::BusOff);
    // Nothing is received during bus-off.
    assert_eq!(controller.read(soon()), Err(Fault::Disconnected));
    assert!(controller.health().bus_off);
    bus.deliver(xy(5.0, 9));
    bus.deliver(frame_of(&table, "STATE", &[], 4));
    assert!((controller.read(soon()).unwrap().positions[0] - 5.0).abs() < 1e-9);
    assert!(!controller.health().bus_off);
    bus.state().down = true;
    assert_eq!(controller.read(soon()), Err(Fault::Disconnected));
    assert_eq!(controller.apply(&PerChannel::ZERO, soon()), Err(Fault::Disconnected));
}

#[test]
fn corrections_have_increasing_counters_and_valid_checksums() {
    let bus = Bus::default();
    let table = shipped();
    let mut controller =
        CanController::new(bus.clone(), &config(&[AxisName::X, AxisName::Y])).unwrap();
    for _ in 0..40 {
        controller.apply(&PerChannel([0.001; 9]), soon()).unwrap();
    }
    let sent = bus.sent();
    assert_eq!(sent.len(), 40, "one frame holds both axes");
    let message = &table.messages[table.message_of(&sent[0]).unwrap()];
    for pair in sent.windows(2) {
        let [before, after] = [0, 1].map(|k| message.counter(pair[k].data()).unwrap());
        assert_eq!(after, (before + 1) % 16);
        assert!(message.is_whole(pair[1].data()));
    }
}

#[test]
fn invalid_configurations_are_rejected() {
    let message = |axes: &[AxisName], change: fn(&mut BridgeConfig)| {
        let mut config = config(axes);
        change(&mut config);
        CanController::new(Bus::default(), &config).err().unwrap().to_string()
    };
    assert!(
        message(&[AxisName::X, AxisName::B], |_| {})
            .contains("can://memory: there is no signal B_POS; correct the DBC")
    );
    assert!(message(&[], |_| {}).contains("found 0 axes"));
    assert!(message(&[AxisName::X, AxisName::X], |_| {}).contains("axis X: found twice"));
    let none = CanThermometer::new(Bus::default(), &SignalTable { messages: Vec::new() }, &[]);
    assert!(none.err().unwrap().to_string().contains("ends in _TEMP"));
}

#[test]
fn temperatures_are_decoded_with_their_faults() {
    let bus = Bus::default();
    let table = shipped();
    let mut thermometer = CanThermometer::new(bus.clone(), &table, &[]).unwrap();
    assert_eq!(thermometer.names(), ["bed", "column", "spindle", "scale_x"]);
    assert_eq!(thermometer.latest()[0].quality, Quality::Bad(Reason::NotRead));
    let values = [
        ("BED_TEMP", 21.55),
        ("COLUMN_TEMP", -39.95),
        ("SPINDLE_TEMP", -40.0),
        ("SCALE_X_TEMP", 164.75),
    ];
    bus.deliver(frame_of(&table, "TEMPERATURES", &values, 0));
    let latest = thermometer.latest().to_vec();
    assert!((latest[0].degc.unwrap() - 21.55).abs() < 1e-9);
    assert!((latest[1].degc.unwrap() + 39.95).abs() < 1e-9);
    assert_eq!(latest[2].quality, Quality::Bad(Reason::Short));
    assert_eq!(latest[3].quality, Quality::Bad(Reason::Open));
    // A temperature that is no longer sent keeps its value and time.
    std::thread::sleep(Duration::from_millis(20));
    assert_eq!(thermometer.latest(), latest);
    bus.state().down = true;
    assert_eq!(thermometer.latest()[0].quality, Quality::Bad(Reason::NoAnswer));
}

/// The lowest and the highest number of a signed signal are faults; 0 and −1 are temperatures.
#[test]
fn signed_temperatures_are_decoded_with_their_faults() {
    let text =
        "VERSION \"\"\nBU_: A\nBO_ 1 T: 2 A\n SG_ BED_TEMP : 0|12@1- (0.05,0) [0|0] \"degC\" A\n";
    let bus = Bus::default();
    let table = SignalTable::parse(text).unwrap();
    let mut thermometer = CanThermometer::new(bus.clone(), &table, &[]).unwrap();
    for (raw, expected) in [
        (0_u16, Quality::Good),
        (0xfff, Quality::Good),
        (0x7fe, Quality::Good),
        (0x7ff, Quality::Bad(Reason::Open)),
        (0x801, Quality::Good),
        (0x800, Quality::Bad(Reason::Short)),
    ] {
        bus.deliver(Frame::new(1, false, false, &raw.to_le_bytes()).unwrap());
        assert_eq!(thermometer.latest()[0].quality, expected, "{raw:#x}");
    }
}

#[test]
fn names_select_temperatures() {
    let bus = Bus::default();
    let table = shipped();
    let named = |names: &[&str]| {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        CanThermometer::new(bus.clone(), &table, &names)
    };
    let mut two = named(&["spindle", "bed"]).unwrap();
    assert_eq!(two.names(), ["spindle", "bed"]);
    let values = [("BED_TEMP", 21.5), ("SPINDLE_TEMP", 30.0)];
    bus.deliver(frame_of(&table, "TEMPERATURES", &values, 0));
    let degc: Vec<f64> = two.latest().iter().filter_map(|t| t.degc).collect();
    assert!((degc[0] - 30.0).abs() < 1e-9 && (degc[1] - 21.5).abs() < 1e-9 && degc.len() == 2);
    let message = named(&["ram"]).err().unwrap().to_string();
    assert!(
        message.contains("found no temperature ram, expected one of bed, column, spindle, scale_x"),
        "{message}"
    );
    let message = named(&["bed", "bed"]).err().unwrap().to_string();
    assert!(message.contains("the sensor bed is listed twice"), "{message}");
}

/// A control whose state was never received must not be corrected. A received state has the age of its message. If the
/// DBC file defines no state signals, the description says so, and the configuration must accept that.
#[test]
fn an_unknown_state_forbids_correction() {
    let bus = Bus::default();
    let table = shipped();
    let mut controller = CanController::new(bus.clone(), &config(&[AxisName::X])).unwrap();
    assert_eq!(controller.description().shown, ShownStates::ALL);
    let began = Instant::now();
    let at = |ms: u64| began + Duration::from_millis(ms);
    let mut read = |ms: u64, state: bool| {
        let counter = ms / 10;
        let xy = frame_of(&table, "POSITION_XY", &[("X_POS", 1.0)], counter);
        bus.state().incoming.push_back(Received::Frame(xy, at(ms + 1)));
        if state {
            let good = frame_of(&table, "STATE", &[("REFERENCED", 1.0)], counter);
            bus.state().incoming.push_back(Received::Frame(good, at(ms)));
        }
        let snapshot = controller.read(soon()).unwrap();
        assert_eq!(snapshot.taken, at(ms + 1));
        (snapshot.state, snapshot.state_taken)
    };
    let forbids = ControllerState { referenced: false, alarm: true, emergency_stop: true };
    let good = ControllerState { referenced: true, alarm: false, emergency_stop: false };
    assert_eq!(read(10, false).0, forbids, "no state received yet");
    assert_eq!(read(20, true), (good, at(20)));
    assert_eq!(read(80, false), (good, at(20)), "the state is missing");
    assert_eq!(read(90, true), (good, at(90)));
    let without_states = SHIPPED_DBC.replace("EMERGENCY_STOP", "SPARE").replace(" ALARM", " OTHER");
    let without_states = BridgeConfig {
        table: SignalTable::parse(&without_states).unwrap(),
        ..config(&[AxisName::X])
    };
    let shown = without_states.describe("can://memory").unwrap().shown;
    let expected = ShownStates { referenced: true, ..ShownStates::NONE };
    assert_eq!(shown, expected);
}

/// After a silence the last positions, state and applied correction are returned with the arrival times of their
/// frames, whatever their age and without waiting for new frames.
#[test]
fn values_keep_their_arrival_times() {
    let bus = Bus::default();
    let table = shipped();
    let mut controller = CanController::new(bus.clone(), &config(&[AxisName::X])).unwrap();
    let began = Instant::now();
    let at = |ms: u64| began + Duration::from_millis(ms);
    let deliver = |frame: Frame, ms: u64| {
        let received = Received::Frame(frame, at(ms));
        bus.state().incoming.push_back(received);
    };
    let applied = [("X_APPLIED", 40.0), ("REFERENCED", 1.0)];
    deliver(frame_of(&table, "STATE", &applied, 1), 5);
    deliver(frame_of(&table, "POSITION_XY", &[("X_POS", 5.0)], 1), 7);
    std::thread::sleep(Duration::from_millis(250));
    let deadline = Instant::now() + Duration::from_secs(600);
    for _ in 0..2 {
        let snapshot = controller.read(deadline).unwrap();
        assert!((snapshot.positions[0] - 5.0).abs() < 1e-9);
        assert_eq!(snapshot.taken, at(7));
        assert_eq!(snapshot.uncertainty, Duration::ZERO);
        assert!(snapshot.state.referenced);
        assert!((snapshot.applied.unwrap()[0] - 0.040).abs() < 1e-12);
        let others = [snapshot.state_taken, snapshot.correction_taken];
        assert_eq!((others, snapshot.youngest()), ([at(5); 2], at(7)));
    }
    // New positions must not refresh the time of the applied correction. A refreshed time, 60 to 100 ms wrong, causes a
    // step of 28 µm and a fault.
    deliver(frame_of(&table, "POSITION_XY", &[("X_POS", 6.0)], 2), 240);
    let snapshot = controller.read(deadline).unwrap();
    assert_eq!((snapshot.taken, snapshot.correction_taken), (at(240), at(5)));
}

/// Counters of up to 64 bits: frames are new across the end of the counter, and gaps are counted.
#[test]
fn wide_counters_wrap() {
    for bits in [4_u32, 8, 16, 60, 61, 63, 64] {
        let last = u64::MAX >> (64 - bits);
        let dbc = format!(
            "VERSION \"\"\nBU_: A\nBO_ 256 M: 12 A\n SG_ X_POS : 64|32@1- (0.001,0) [0|0] \"mm\" A\n SG_ M_CNT : 0|{bits}@1+ (1,0) [0|0] \"\" A\n"
        );
        let bus = Bus::default();
        let reads = vec![AxisName::X];
        let config = BridgeConfig { reads, ..crate::config(&dbc, &[]) };
        let mut controller = CanController::new(bus.clone(), &config).unwrap();
        for (x, counter) in [(1.0, last - 1), (2.0, last), (3.0, 0), (4.0, 3)] {
            bus.deliver(frame_of(&config.table, "M", &[("X_POS", x)], counter));
            let found = controller.read(soon()).unwrap().positions[0];
            assert!((found - x).abs() < 1e-9, "{bits} bits: {found} at {counter}");
        }
        let health = controller.health();
        assert_eq!((health.lost, health.repeated), (2, 0), "{bits} bits");
    }
}

#[test]
fn queued_frames_keep_their_age() {
    let bus = Bus::default();
    let table = shipped();
    let mut controller = CanController::new(bus.clone(), &config(&[AxisName::X])).unwrap();
    for counter in 0..10 {
        let x = f64::from(u32::try_from(counter).unwrap());
        bus.deliver(frame_of(&table, "POSITION_XY", &[("X_POS", x)], counter));
    }
    let came = Instant::now();
    std::thread::sleep(Duration::from_millis(20));
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.positions[0] - 9.0).abs() < 1e-9);
    assert!(snapshot.taken <= came);
}

#[test]
fn a_late_correction_is_not_sent() {
    let bus = Bus::default();
    let mut controller = CanController::new(bus.clone(), &config(&[AxisName::X])).unwrap();
    let late = controller.apply(&PerChannel([0.01; 9]), Instant::now());
    assert_eq!((late, bus.sent()), (Err(Fault::TimedOut), vec![]));
}

#[test]
fn units_of_any_table_are_checked() {
    for [signal, unit, expected] in &cases(
        "
X_APPLIED |  | signal X_APPLIED: found no unit, expected mm or um
X_CORR | urad | signal X_CORR: found the unit `urad`, expected mm or um
C_POS | mm | signal C_POS: found the unit `mm`, expected deg, rad or urad
EMERGENCY_STOP | V | signal EMERGENCY_STOP: found the unit `V`, expected no unit or bool
",
    ) {
        let mut config = config(&[AxisName::X, AxisName::C]);
        let (message, place) = config.table.find(signal).unwrap();
        unit.clone_into(&mut config.table.messages[message].signals[place].unit);
        let refused = config.describe("can://memory").unwrap_err().to_string();
        assert!(refused.contains(expected), "{refused}");
    }
}

/// One big-endian FD frame with all axes is decoded and encoded.
#[test]
fn a_custom_fd_frame() {
    let text = "VERSION \"\"\nBU_: A\n\
        BO_ 2566848769 ALL: 16 A\n SG_ X_POS : 7|32@0- (0.0001,0) [0|0] \"mm\" A\n SG_ Y_POS : 39|32@0- (0.0001,0) [0|0] \"mm\" A\n SG_ ALL_CNT : 71|4@0+ (1,0) [0|0] \"\" A\n SG_ ALL_CRC : 127|8@0+ (1,0) [0|0] \"\" A\n\n\
        BO_ 2566848770 GO: 12 A\n SG_ X_CORR : 7|16@0- (0.1,0) [0|0] \"um\" A\n SG_ Y_CORR : 23|16@0- (0.1,0) [0|0] \"um\" A\n SG_ GO_CNT : 39|4@0+ (1,0) [0|0] \"\" A\n";
    let table = SignalTable::parse(text).unwrap();
    let bus = Bus::default();
    let mut controller = CanController::new(
        bus.clone(),
        &BridgeConfig { table: table.clone(), ..config(&[AxisName::X, AxisName::Y]) },
    )
    .unwrap();
    let frame = frame_of(&table, "ALL", &[("X_POS", 1234.5678), ("Y_POS", -0.0001)], 1);
    assert!(frame.fd && frame.extended && frame.data().len() == 16);
    // Big-endian: the high byte is first.
    assert_eq!(frame.data()[..4], 12_345_678_i32.to_be_bytes());
    bus.deliver(frame);
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.positions[0] - 1234.5678).abs() < 1e-9);
    assert!((snapshot.positions[1] + 0.0001).abs() < 1e-12);
    assert_eq!(snapshot.applied, None, "the table has no applied correction");
    controller.apply(&PerChannel::leading([0.0001, -0.0002]), soon()).unwrap();
    let sent = bus.sent()[0];
    assert_eq!((sent.fd, &sent.data()[..4]), (true, &[0, 1, 0xff, 0xfe][..]));
}

/// Axes that are not corrected get the value zero. Its raw bits may differ from 0, as for Z with an offset of −2048 µm.
#[test]
fn an_uncorrected_axis_gets_zero() {
    let (from, to) = ("Z_CORR : 24|12@1- (1,0)", "Z_CORR : 24|12@1+ (1,-2048)");
    assert!(SHIPPED_DBC.contains(from));
    let table = SignalTable::parse(&SHIPPED_DBC.replace(from, to)).unwrap();
    let config = BridgeConfig { table: table.clone(), ..config(&[AxisName::X, AxisName::Y]) };
    let bus = Bus::default();
    let mut controller = CanController::new(bus.clone(), &config).unwrap();
    controller.apply(&PerChannel::ZERO, soon()).unwrap();
    let frame = *bus.sent().last().unwrap();
    let (message, place) = table.find("Z_CORR").unwrap();
    let found = table.messages[message].signals[place].value(frame.data());
    assert_eq!(found.abs(), 0.0, "µm");
}

/// A frame that is overtaken or repeated, for example by a bridge between two buses, is ignored. It does not clear an
/// emergency stop, and its old position does not count as new.
#[test]
fn an_overtaken_frame_is_ignored() {
    let table = shipped();
    let bus = Bus::default();
    let mut controller = CanController::new(bus.clone(), &config(&[AxisName::X])).unwrap();
    let deliver = |counter, x, stop| {
        let state = [("REFERENCED", 1.0), ("EMERGENCY_STOP", stop)];
        bus.deliver(frame_of(&table, "POSITION_XY", &[("X_POS", x)], counter));
        bus.deliver(frame_of(&table, "STATE", &state, counter));
    };
    deliver(5, 10.0, 0.0);
    assert!(!controller.read(soon()).unwrap().state.emergency_stop);
    deliver(6, 11.0, 1.0);
    assert!(controller.read(soon()).unwrap().state.emergency_stop);
    deliver(5, 10.0, 0.0);
    let found = controller.read(soon()).unwrap();
    assert!(found.state.emergency_stop);
    assert!((found.positions[0] - 11.0).abs() < 1e-9, "{}", found.positions[0]);
    assert_eq!(controller.health().repeated, 2);
    deliver(7, 12.0, 0.0);
    assert!(!controller.read(soon()).unwrap().state.emergency_stop);
    // After a silence the number of missed frames is unknown.
    std::thread::sleep(Duration::from_millis(120));
    deliver(3, 13.0, 1.0);
    assert!(controller.read(soon()).unwrap().state.emergency_stop);
}
