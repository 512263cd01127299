use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use volcomp_digital_io::{
    Coherence, CorrectionCode, CorrectionWord, DigitalAxis, DigitalController, PositionCode,
    PositionWord, Wiring,
};
use volcomp_port::{Controller, DigitalIo, Fault, InputLevels, ShownStates, contract};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, Mm, PerChannel, Urad};

fn soon() -> Instant {
    Instant::now() + Duration::from_millis(200)
}

/// A control on the other side of the lines: shows axis after axis and takes corrections for the one it
/// shows.
struct Control {
    wiring: Wiring,
    axes: Vec<DigitalAxis>,
    positions: Vec<f64>,
    corrections: Vec<f64>,
    shown: usize,
    readings: usize,
    hold: usize,
    /// The levels of its inputs.
    levels: u64,
    /// Whether writes fail.
    refuses: bool,
}

#[derive(Clone)]
struct Panel(Arc<Mutex<Control>>);

impl Panel {
    fn new(wiring: Wiring, axes: Vec<DigitalAxis>) -> Self {
        let count = axes.len();
        Self(Arc::new(Mutex::new(Control {
            wiring,
            axes,
            positions: vec![0.0; count],
            corrections: vec![0.0; count],
            shown: 0,
            readings: 0,
            hold: 5,
            levels: 0,
            refuses: false,
        })))
    }
}

impl DigitalIo for Panel {
    fn device(&self) -> &'static str {
        "panel"
    }

    fn inputs(&self) -> u32 {
        20
    }

    fn outputs(&self) -> u32 {
        10
    }

    fn shortest_cycle(&self) -> Duration {
        Duration::from_micros(10)
    }

    fn read(&mut self, _: Instant) -> Result<InputLevels, Fault> {
        let mut control = self.0.lock().unwrap();
        control.readings += 1;
        if control.readings.is_multiple_of(control.hold) {
            control.shown = (control.shown + 1) % control.axes.len();
        }
        let shown = control.shown;
        let word = control.axes[shown]
            .position
            .encode(control.positions[shown]);
        let number = u32::try_from(shown).unwrap();
        Ok(InputLevels::now(control.wiring.control_outputs(
            word.unwrap_or(0),
            number,
            true,
        )))
    }

    fn write(&mut self, levels: u64, _: Instant) -> Result<(), Fault> {
        let mut control = self.0.lock().unwrap();
        if control.refuses {
            return Err(Fault::Disconnected);
        }
        let turned = control.levels ^ levels;
        control.levels = levels;
        let latch = control.wiring.latch.map_or(0, |line| 1 << line);
        if latch != 0 {
            if turned & latch == 0 {
                return Ok(());
            }
            assert_eq!(turned, latch, "the latch turns alone");
        }
        let (word, axis) = control.wiring.control_inputs(levels);
        let shown = control.shown;
        // The ladder takes it only for the axis that it shows.
        if usize::try_from(axis).unwrap() == shown {
            control.corrections[shown] = control.axes[shown].correction.decode(word).unwrap();
        }
        Ok(())
    }

    fn confirmed(&self) -> Option<u64> {
        Some(self.0.lock().unwrap().levels)
    }
}

#[test]
fn the_published_scheme() {
    let axis = DigitalAxis::published(AxisName::X);
    let panel = Panel::new(Wiring::published(), vec![axis]);
    let mut controller = DigitalController::new(
        panel.clone(),
        "lines",
        Wiring::published(),
        Coherence::TwoAgree,
        vec![axis],
    )
    .unwrap();
    contract::controller(&mut controller);
    // 1000 mm and back; a correction of 100 um a metre.
    for step in 0..=200 {
        let place = 1000.0 - 10.0 * f64::from(i32::abs(step - 100));
        panel.0.lock().unwrap().positions[0] = place;
        let snapshot = controller.read(soon()).unwrap();
        assert!((snapshot.positions[0] - place).abs() <= 1.0 / 64.0);
        let mut wanted = PerChannel::ZERO;
        wanted[0] = -1e-4 * snapshot.positions[0];
        controller.apply(&wanted, soon()).unwrap();
        let sent = panel.0.lock().unwrap().corrections[0];
        // Half a micrometre, and what 1/64 mm of position makes.
        assert!(
            (sent + 1e-4 * place).abs() <= 0.000_5 + 1e-4 / 64.0,
            "{sent} at {place}"
        );
        assert_eq!(controller.sent().unwrap()[0], sent);
    }
    assert_eq!(controller.saturated(), 0);
    controller.apply(&PerChannel([0.2; 9]), soon()).unwrap();
    assert_eq!(controller.saturated(), 1);
    assert!((panel.0.lock().unwrap().corrections[0] - 0.127).abs() < 1e-12);
}

/// Three axes in turn over the same lines, each corrected only while it is shown.
#[test]
fn several_axes_take_turns() {
    let wiring = Wiring {
        position: (0..15).collect(),
        select: vec![15, 16],
        parity: Some(17),
        correction: (0..7).collect(),
        echo: vec![7, 8],
        inverted_inputs: 0b1010,
        inverted_outputs: 0b1,
        ..Wiring::default()
    };
    let axis = |name| DigitalAxis {
        correction: CorrectionWord {
            bits: 7,
            code: CorrectionCode::SignMagnitude,
            step: Displacement::Length(Mm(0.001)),
        },
        ..DigitalAxis::published(name)
    };
    let axes = vec![axis(AxisName::X), axis(AxisName::Y), axis(AxisName::Z)];
    let panel = Panel::new(wiring.clone(), axes.clone());
    panel.0.lock().unwrap().positions = vec![10.0, 20.0, 30.0];
    let mut controller =
        DigitalController::new(panel.clone(), "lines", wiring, Coherence::TwoAgree, axes).unwrap();
    let wanted = PerChannel::leading([0.011, -0.022, 0.033]);
    let snapshot = controller.read(soon()).unwrap();
    assert_eq!(snapshot.positions[..4], [10.0, 20.0, 30.0, 0.0]);
    assert_eq!(snapshot.applied, None, "lines cannot be asked");
    for _ in 0..20 {
        controller.read(soon()).unwrap();
        controller.apply(&wanted, soon()).unwrap();
    }
    let taken = panel.0.lock().unwrap().corrections.clone();
    for (taken, wanted) in taken.iter().zip(wanted) {
        assert!((taken - wanted).abs() < 1e-12, "{taken:?}");
    }
    // A control that stops at one axis: the others grow old.
    panel.0.lock().unwrap().hold = usize::MAX;
    let first = controller.read(soon()).unwrap().taken;
    std::thread::sleep(Duration::from_millis(5));
    assert_eq!(controller.read(soon()).unwrap().taken, first);
}

#[test]
fn low_bits_follow_a_long_axis() {
    let axis = DigitalAxis {
        position: PositionWord {
            bits: 8,
            code: PositionCode::Gray,
            step: Displacement::Length(Mm(0.01)),
            zero: Displacement::Length(Mm(0.0)),
        },
        low_bits_from: Some(Displacement::Length(Mm(0.0))),
        ..DigitalAxis::published(AxisName::X)
    };
    let wiring = Wiring {
        position: (0..8).collect(),
        correction: (0..8).collect(),
        ..Wiring::default()
    };
    let panel = Panel::new(wiring.clone(), vec![axis]);
    let mut controller = DigitalController::new(
        panel.clone(),
        "lines",
        wiring,
        Coherence::TwoAgree,
        vec![axis],
    )
    .unwrap();
    for step in 0..5000 {
        let place = f64::from(step);
        panel.0.lock().unwrap().positions[0] = place % 2.56;
        let found = controller.read(soon()).unwrap().positions[0];
        assert!((found - place).abs() < 0.011, "{found} at {place}");
    }
}

#[test]
fn an_axis_that_is_not_configured_is_a_fault() {
    let wiring = Wiring {
        position: (0..15).collect(),
        select: vec![15, 16],
        correction: (0..7).collect(),
        echo: vec![7, 8],
        ..Wiring::default()
    };
    let mut axis = DigitalAxis::published(AxisName::X);
    axis.correction.bits = 7;
    let panel = Panel::new(wiring.clone(), vec![axis; 3]);
    let mut controller = DigitalController::new(
        panel,
        "lines",
        wiring.clone(),
        Coherence::TwoAgree,
        [AxisName::X, AxisName::Y]
            .map(|name| DigitalAxis { name, ..axis })
            .to_vec(),
    )
    .unwrap();
    let mut faults = Vec::new();
    for _ in 0..20 {
        faults.extend(controller.read(soon()).err());
    }
    assert!(faults.contains(&Fault::Protocol("an axis is shown that is not configured")));
    let strobe = DigitalController::new(
        Panel::new(wiring.clone(), vec![axis]),
        "lines",
        wiring,
        Coherence::Strobe,
        vec![axis],
    );
    let message = strobe.err().unwrap().to_string();
    assert!(message.contains("no strobe line is named"), "{message}");
}

/// Steps are lengths or angles by the kind of the axis: a rotary axis with the published words, which are lengths, is
/// refused, and one with steps in angles is described and corrected in rad.
#[test]
fn units_follow_the_kind_of_the_axis() {
    let new = |axis: DigitalAxis| {
        let wiring = Wiring::published();
        let panel = Panel::new(wiring.clone(), vec![axis]);
        DigitalController::new(panel, "lines", wiring, Coherence::TwoAgree, vec![axis])
    };
    let lengths = DigitalAxis::published(AxisName::C);
    let message = new(lengths).err().unwrap().to_string();
    assert!(
        message.contains("axis C: found a resolution of 1 µm, expected an angle"),
        "{message}"
    );
    let mut half = lengths;
    half.correction.step = Displacement::Angle(Urad(5.0).to_rad());
    let message = new(half).err().unwrap().to_string();
    assert!(
        message.contains("axis C: found a position step"),
        "{message}"
    );
    let mut angles = half;
    angles.position.step = Displacement::from_coordinate(AxisKind::Rotary, 0.01);
    angles.position.zero = Displacement::from_coordinate(AxisKind::Rotary, 0.0);
    let mut controller = new(angles).unwrap();
    let axis = controller.description().axes[0];
    assert_eq!(axis.resolution, Displacement::Angle(Urad(5.0).to_rad()));
    controller.read(soon()).unwrap();
    // 7 µrad are wanted: one step of 5 µrad is sent.
    controller
        .apply(&PerChannel::leading([7e-6]), soon())
        .unwrap();
    assert!((controller.sent().unwrap()[0] - 5e-6).abs() < 1e-18);
}

/// With a latch the control takes a correction at its edge only, which comes with the write after the word; what counts as
/// sent is what the control took. Lines that carry nothing keep their levels.
#[test]
fn a_latch_turns_one_write_after_the_word() {
    let axis = DigitalAxis::published(AxisName::X);
    let wiring = Wiring {
        latch: Some(8),
        ..Wiring::published()
    };
    let panel = Panel::new(wiring.clone(), vec![axis]);
    // As another program left the lines: the latch at 1, a tenth line that is not ours.
    panel.0.lock().unwrap().levels = 0x305;
    let coherence = Coherence::TwoAgree;
    let mut controller =
        DigitalController::new(panel.clone(), "lines", wiring, coherence, vec![axis]).unwrap();
    controller.read(soon()).unwrap();
    assert_eq!(controller.sent(), None);
    let mut apply = |um: f64| {
        let applied = controller.apply(&PerChannel::leading([um * 1e-3]), soon());
        let control = panel.0.lock().unwrap();
        let taken = (control.corrections[0] * 1e3).round();
        let sent = controller.sent().map(|sent| (sent[0] * 1e3).round());
        (applied.is_ok(), control.levels, taken, sent)
    };
    assert_eq!(apply(7.0), (true, 0x307, 0.0, None), "the word alone");
    assert_eq!(apply(8.0), (true, 0x207, 7.0, Some(7.0)), "the latch alone");
    assert_eq!(apply(9.0), (true, 0x209, 7.0, Some(7.0)));
    panel.0.lock().unwrap().refuses = true;
    let mut apply = |um: f64| {
        let applied = controller.apply(&PerChannel::leading([um * 1e-3]), soon());
        let sent = controller.sent().map(|sent| (sent[0] * 1e3).round());
        (applied, panel.0.lock().unwrap().levels, sent)
    };
    for _ in 0..3 {
        assert_eq!(apply(20.0), (Err(Fault::Disconnected), 0x209, Some(7.0)));
    }
    panel.0.lock().unwrap().refuses = false;
    assert_eq!(apply(20.0), (Ok(()), 0x309, Some(9.0)));
    assert_eq!(apply(20.0), (Ok(()), 0x314, Some(9.0)));
    assert_eq!(apply(20.0), (Ok(()), 0x214, Some(20.0)));
}

/// A write that failed changes nothing of what counts as sent, and a write whose deadline has passed is not made.
#[test]
fn a_write_that_failed_was_not_sent() {
    let axis = DigitalAxis::published(AxisName::X);
    let wiring = Wiring::published();
    let panel = Panel::new(wiring.clone(), vec![axis]);
    let coherence = Coherence::TwoAgree;
    let mut controller =
        DigitalController::new(panel.clone(), "lines", wiring, coherence, vec![axis]).unwrap();
    assert_eq!(controller.description().shown, ShownStates::NONE);
    let um = |um: f64| PerChannel::leading([um * 1e-3]);
    controller.apply(&um(40.0), soon()).unwrap();
    panel.0.lock().unwrap().refuses = true;
    let refused = controller.apply(&um(41.0), soon());
    assert_eq!(refused, Err(Fault::Disconnected));
    assert!((controller.sent().unwrap()[0] - 0.040).abs() < 1e-12);
    panel.0.lock().unwrap().refuses = false;
    let late = controller.apply(&um(42.0), Instant::now());
    assert_eq!(late, Err(Fault::TimedOut));
    assert_eq!(panel.0.lock().unwrap().levels, 40);
    assert!((controller.sent().unwrap()[0] - 0.040).abs() < 1e-12);
}
