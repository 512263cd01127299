use std::time::Duration;

use volcomp_can::{BridgeConfig, CanController, CanThermometer, Received, SignalTable};
use volcomp_port::{Controller, Fault, Quality, Reason, Thermometer, contract};
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{Bus, frame_of, shipped, soon};

fn config(axes: &[AxisName]) -> BridgeConfig {
    BridgeConfig {
        table: shipped(),
        channel: "bridge".to_owned(),
        axes: axes.to_vec(),
        includes_correction: false,
        stale_after: Duration::from_millis(200),
    }
}

/// The control sends where it is, and takes the correction that was sent last.
struct Control {
    bus: Bus,
    table: SignalTable,
    counter: u64,
    applied_um: f64,
}

impl Control {
    fn new(bus: &Bus) -> Self {
        Self {
            bus: bus.clone(),
            table: shipped(),
            counter: 0,
            applied_um: 0.0,
        }
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
        self.bus
            .comes(frame_of(&self.table, "POSITION_XY", &place, counter));
        let place = [("Z_POS", 0.5 * x_mm), ("C_POS", 90.0)];
        self.bus
            .comes(frame_of(&self.table, "POSITION_ZC", &place, counter));
        let applied = [("X_APPLIED", self.applied_um), ("REFERENCED", 1.0)];
        let state = [&applied[..], state].concat();
        self.bus
            .comes(frame_of(&self.table, "STATE", &state, counter));
    }
}

#[test]
fn positions_come_and_corrections_go() {
    let bus = Bus::default();
    let mut control = Control::new(&bus);
    let mut controller = CanController::new(
        bus.clone(),
        &config(&[AxisName::X, AxisName::Z, AxisName::C]),
    )
    .unwrap();
    assert_eq!(
        controller.read(soon()),
        Err(Fault::TimedOut),
        "nothing came yet"
    );
    control.sends(100.0, &[]);
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.positions[0] - 100.0).abs() < 1e-9);
    assert!((snapshot.positions[1] - 50.0).abs() < 1e-9);
    assert!((snapshot.positions[2] - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    assert!(snapshot.state.referenced && !snapshot.state.alarm);
    controller
        .apply(&PerChannel::leading([0.0123, -0.005, 2e-6]), soon())
        .unwrap();
    control.sends(101.0, &[("ALARM", 1.0), ("EMERGENCY_STOP", 1.0)]);
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.applied.unwrap()[0] - 0.012).abs() < 1e-12);
    assert!(snapshot.state.alarm && snapshot.state.emergency_stop);
    assert_eq!(controller.saturated(), 0);
    controller.apply(&PerChannel([5.0; 9]), soon()).unwrap();
    assert_eq!(controller.saturated(), 3);
}

/// With a control that answers at once.
#[test]
fn the_contract_of_controllers() {
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

/// Repeated counters, lost frames, wrong sums and lengths, error frames, bus off, an interface that is down:
/// states, and never a position.
#[test]
fn what_is_wrong_on_the_bus_is_a_state() {
    let bus = Bus::default();
    let table = shipped();
    let mut controller = CanController::new(bus.clone(), &config(&[AxisName::X])).unwrap();
    let xy = |x: f64, counter| frame_of(&table, "POSITION_XY", &[("X_POS", x)], counter);
    bus.comes(xy(1.0, 3));
    bus.comes(frame_of(&table, "STATE", &[], 3));
    let mut read = |expected: f64| {
        let found = controller.read(soon()).unwrap().positions[0];
        assert!((found - expected).abs() < 1e-9, "{found}");
        controller.health()
    };
    assert_eq!(read(1.0), volcomp_can::Health::default());
    bus.comes(xy(2.0, 3));
    assert_eq!(read(1.0).repeated, 1);
    bus.comes(xy(3.0, 7));
    assert_eq!(read(3.0).lost, 3);
    let mut wrong = xy(4.0, 8);
    wrong.data_mut()[0] ^= 1;
    bus.comes(wrong);
    bus.comes(volcomp_can::Frame::new(256, false, false, &[1, 2, 3]).unwrap());
    assert_eq!(read(3.0).broken, 2);
    bus.inside().coming.push_back(Received::Error);
    assert_eq!(read(3.0).errors, 1);
    bus.inside().coming.push_back(Received::BusOff);
    assert!(read(3.0).bus_off);
    // Stale by now: with the controller off the bus there is nothing to wait for.
    std::thread::sleep(Duration::from_millis(250));
    assert_eq!(controller.read(soon()), Err(Fault::Disconnected));
    bus.comes(xy(5.0, 9));
    bus.comes(frame_of(&table, "STATE", &[], 4));
    assert!((controller.read(soon()).unwrap().positions[0] - 5.0).abs() < 1e-9);
    assert!(!controller.health().bus_off);
    bus.inside().down = true;
    assert_eq!(controller.read(soon()), Err(Fault::Disconnected));
    assert_eq!(
        controller.apply(&PerChannel::ZERO, soon()),
        Err(Fault::Disconnected)
    );
}

#[test]
fn every_correction_has_a_new_counter_and_a_right_sum() {
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
fn configurations_that_make_no_sense_are_named() {
    let message = |axes: &[AxisName], change: fn(&mut BridgeConfig)| {
        let mut config = config(axes);
        change(&mut config);
        CanController::new(Bus::default(), &config)
            .err()
            .unwrap()
            .to_string()
    };
    assert!(
        message(&[AxisName::X, AxisName::B], |_| {})
            .contains("can://memory: there is no signal B_POS; correct the DBC")
    );
    assert!(message(&[], |_| {}).contains("found 0 axes"));
    assert!(message(&[AxisName::X, AxisName::X], |_| {}).contains("axis X: found twice"));
    let none = CanThermometer::new(
        Bus::default(),
        &SignalTable {
            messages: Vec::new(),
        },
        soon().elapsed(),
    );
    assert!(none.err().unwrap().to_string().contains("ends in _TEMP"));
}

#[test]
fn temperatures_come_in_frames() {
    let bus = Bus::default();
    let table = shipped();
    let mut thermometer =
        CanThermometer::new(bus.clone(), &table, Duration::from_millis(200)).unwrap();
    assert_eq!(thermometer.names(), ["bed", "column", "spindle", "scale_x"]);
    assert_eq!(
        thermometer.latest()[0].quality,
        Quality::Bad(Reason::NotRead)
    );
    let values = [
        ("BED_TEMP", 21.55),
        ("COLUMN_TEMP", -39.95),
        ("SPINDLE_TEMP", -40.0),
        ("SCALE_X_TEMP", 164.75),
    ];
    bus.comes(frame_of(&table, "TEMPERATURES", &values, 0));
    let latest = thermometer.latest().to_vec();
    assert!((latest[0].degc.unwrap() - 21.55).abs() < 1e-9);
    assert!((latest[1].degc.unwrap() + 39.95).abs() < 1e-9);
    assert_eq!(latest[2].quality, Quality::Bad(Reason::Short));
    assert_eq!(latest[3].quality, Quality::Bad(Reason::Open));
    std::thread::sleep(Duration::from_millis(250));
    assert_eq!(
        thermometer.latest()[0].quality,
        Quality::Bad(Reason::NoAnswer)
    );
}

/// One FD frame with all axes, big-endian, for who wants that.
#[test]
fn an_fd_frame_of_the_users_own() {
    let text = "VERSION \"\"\nBU_: A\n\
        BO_ 2566848769 ALL: 16 A\n SG_ X_POS : 7|32@0- (0.0001,0) [0|0] \"mm\" A\n SG_ Y_POS : 39|32@0- (0.0001,0) [0|0] \"mm\" A\n SG_ ALL_CNT : 71|4@0+ (1,0) [0|0] \"\" A\n SG_ ALL_CRC : 127|8@0+ (1,0) [0|0] \"\" A\n\n\
        BO_ 2566848770 GO: 12 A\n SG_ X_CORR : 7|16@0- (0.1,0) [0|0] \"um\" A\n SG_ Y_CORR : 23|16@0- (0.1,0) [0|0] \"um\" A\n SG_ GO_CNT : 39|4@0+ (1,0) [0|0] \"\" A\n";
    let table = SignalTable::parse(text).unwrap();
    let bus = Bus::default();
    let mut controller = CanController::new(
        bus.clone(),
        &BridgeConfig {
            table: table.clone(),
            ..config(&[AxisName::X, AxisName::Y])
        },
    )
    .unwrap();
    let frame = frame_of(
        &table,
        "ALL",
        &[("X_POS", 1234.5678), ("Y_POS", -0.0001)],
        1,
    );
    assert!(frame.fd && frame.extended && frame.data().len() == 16);
    // Highest byte first.
    assert_eq!(frame.data()[..4], 12_345_678_i32.to_be_bytes());
    bus.comes(frame);
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.positions[0] - 1234.5678).abs() < 1e-9);
    assert!((snapshot.positions[1] + 0.0001).abs() < 1e-12);
    assert_eq!(snapshot.applied, None, "it cannot be asked");
    controller
        .apply(&PerChannel::leading([0.0001, -0.0002]), soon())
        .unwrap();
    let sent = bus.sent()[0];
    assert_eq!(
        (sent.fd, &sent.data()[..4]),
        (true, &[0, 1, 0xff, 0xfe][..])
    );
}
