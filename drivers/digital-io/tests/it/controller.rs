use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use volcomp_digital_io::{
    Coherence, CorrectionCode, CorrectionWord, DigitalAxis, DigitalController, LowBits, Panel,
    PositionCode, PositionWord, Wiring,
};
use volcomp_port::{
    Controller, Fault, MockDigitalIo, ShownStates, contract,
    inject::{Faults, Faulty, Injection},
};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, Mm, PerChannel, Urad};

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(60)
}

fn on_panel(wiring: &Wiring, axes: &[DigitalAxis]) -> (Panel, DigitalController<Panel>) {
    let panel = Panel::new(wiring.clone(), axes.to_vec());
    let controller = DigitalController::new(
        panel.clone(),
        "lines",
        wiring.clone(),
        Coherence::TwoAgree,
        axes.to_vec(),
    );
    (panel, controller.unwrap())
}

#[test]
fn the_published_scheme_corrects_an_axis() {
    let axis = DigitalAxis::published(AxisName::X);
    let (panel, mut controller) = on_panel(&Wiring::published(), &[axis]);
    contract::controller(&mut controller);
    // The axis moves to 1000 mm and back, with a correction of 100 µm/m.
    for step in 0..=200 {
        let place = 1000.0 - 10.0 * f64::from(i32::abs(step - 100));
        panel.shows(0, place);
        let snapshot = controller.read(soon()).unwrap();
        assert!((snapshot.positions[0] - place).abs() <= 1.0 / 64.0);
        let mut requested = PerChannel::ZERO;
        requested[0] = -1e-4 * snapshot.positions[0];
        controller.apply(&requested, soon()).unwrap();
        let sent = panel.correction().unwrap();
        // The tolerance is 0.5 µm, plus the effect of 1/64 mm of position.
        assert!((sent + 1e-4 * place).abs() <= 0.000_5 + 1e-4 / 64.0, "{sent} at {place}");
        assert_eq!(controller.sent()[0], Some(sent));
    }
    assert_eq!(controller.saturated(), 0);
    controller.apply(&PerChannel([0.2; 9]), soon()).unwrap();
    assert_eq!(controller.saturated(), 1);
    assert!((panel.correction().unwrap() - 0.127).abs() < 1e-12);
}

#[test]
fn several_axes_share_the_lines() {
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
    let (panel, mut controller) = on_panel(&wiring, &axes);
    let requested = PerChannel::leading([0.011, -0.022, 0.033]);
    for (axis, place) in [10.0, 20.0, 30.0].into_iter().enumerate() {
        panel.shows(axis, place);
        let snapshot = controller.read(Instant::now() + Duration::from_millis(10));
        assert_eq!(snapshot.is_ok(), axis == 2, "not all axes were selected before");
    }
    let snapshot = controller.read(soon()).unwrap();
    assert_eq!(snapshot.positions[..4], [10.0, 20.0, 30.0, 0.0]);
    assert_eq!(snapshot.applied, None, "the lines carry only one of the axes");
    for (axis, place) in [10.0, 20.0, 30.0].into_iter().enumerate() {
        panel.shows(axis, place);
        controller.read(soon()).unwrap();
        let written = controller.apply(&requested, soon());
        let expected = if axis == 2 { Ok(()) } else { Err(Fault::Unfinished) };
        assert_eq!(written, expected, "axis {axis}");
        assert_eq!(panel.word().axis, axis);
        assert!((panel.correction().unwrap() - requested[axis]).abs() < 1e-12);
    }
    // The axes that are not selected have not yet received the new corrections.
    let others = PerChannel::leading([0.011, -0.022, 0.034]);
    assert_eq!(controller.apply(&others, soon()), Ok(()));
    assert_eq!(controller.apply(&requested.map(|x| -x), soon()), Err(Fault::Unfinished));
    // If the control stays at one axis, the positions of the others age.
    let first = controller.read(soon()).unwrap().taken;
    std::thread::sleep(Duration::from_millis(5));
    assert_eq!(controller.read(soon()).unwrap().taken, first);
}

/// An axis whose word has 8 bits of 0.01 mm, so the word wraps every 2.56 mm. `most_per_s` is its maximum speed, mm/s.
fn low_bits(most_per_s: f64) -> (Panel, DigitalController<Panel>) {
    let axis = DigitalAxis {
        position: PositionWord {
            bits: 8,
            code: PositionCode::Gray,
            step: Displacement::Length(Mm(0.01)),
            zero: Displacement::Length(Mm(0.0)),
        },
        low_bits: Some(LowBits {
            from: Displacement::Length(Mm(0.0)),
            most_per_s: Displacement::Length(Mm(most_per_s)),
        }),
        ..DigitalAxis::published(AxisName::X)
    };
    let wiring = Wiring { position: (0..8).collect(), ..Wiring::published() };
    on_panel(&wiring, &[axis])
}

#[test]
fn low_bits_follow_a_long_axis() {
    // At this speed, half of 2.56 mm takes 12.8 s.
    let (panel, mut controller) = low_bits(0.1);
    for step in 0..5000 {
        let place = f64::from(step);
        panel.shows(0, f64::from(step * 100 % 256) * 0.01);
        let found = controller.read(soon()).unwrap().positions[0];
        assert!((found - place).abs() < 0.011, "{found} at {place}");
    }
}

/// After a pause in which the axis may have moved by half the word's range, the position is unknown until the axis is
/// referenced again.
#[test]
fn a_long_pause_makes_the_position_unknown() {
    // The axis can move 1.28 mm in 32 ms.
    let (panel, mut controller) = low_bits(40.0);
    assert!(controller.read(soon()).is_ok());
    std::thread::sleep(Duration::from_millis(35));
    panel.shows(0, 1.0);
    for _ in 0..2 {
        let found = controller.read(soon());
        let text = found.unwrap_err().to_string();
        assert!(text.contains("must be referenced again"), "{text}");
    }
}

#[test]
fn an_unconfigured_axis_is_a_fault() {
    let wiring = Wiring {
        position: (0..15).collect(),
        select: vec![15, 16],
        correction: (0..7).collect(),
        echo: vec![7, 8],
        ..Wiring::default()
    };
    let mut axis = DigitalAxis::published(AxisName::X);
    axis.correction.bits = 7;
    let three = [AxisName::X, AxisName::Y, AxisName::Z].map(|name| DigitalAxis { name, ..axis });
    let panel = Panel::new(wiring.clone(), three.to_vec());
    let mut controller = DigitalController::new(
        panel.clone(),
        "lines",
        wiring.clone(),
        Coherence::TwoAgree,
        three[..2].to_vec(),
    )
    .unwrap();
    panel.shows(2, 0.0);
    let unknown = Fault::Protocol("the selected axis is not configured");
    assert_eq!(controller.read(soon()), Err(unknown));
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

/// The published words are lengths and do not fit a rotary axis. With angular steps the axis is described and corrected
/// in rad.
#[test]
fn units_must_match_the_kind_of_the_axis() {
    let new = |axis: DigitalAxis| {
        let wiring = Wiring::published();
        let panel = Panel::new(wiring.clone(), vec![axis]);
        DigitalController::new(panel, "lines", wiring, Coherence::TwoAgree, vec![axis])
    };
    let lengths = DigitalAxis::published(AxisName::C);
    let message = new(lengths).err().unwrap().to_string();
    assert!(message.contains("axis C: found a resolution of 1 µm, expected an angle"), "{message}");
    let mut half = lengths;
    half.correction.step = Displacement::Angle(Urad(5.0).to_rad());
    let message = new(half).err().unwrap().to_string();
    assert!(message.contains("axis C: found a position step"), "{message}");
    let mut angles = half;
    angles.position.step = Displacement::from_coordinate(AxisKind::Rotary, 0.01);
    angles.position.zero = Displacement::from_coordinate(AxisKind::Rotary, 0.0);
    let mut controller = new(angles).unwrap();
    let axis = controller.description().axes[0];
    assert_eq!(axis.resolution, Displacement::Angle(Urad(5.0).to_rad()));
    controller.read(soon()).unwrap();
    // Of the requested 7 µrad, one step of 5 µrad is sent.
    controller.apply(&PerChannel::leading([7e-6]), soon()).unwrap();
    assert!((controller.sent()[0].unwrap() - 5e-6).abs() < 1e-18);
}

/// The latch toggles one write after the word, because the control accepts a correction at the edge of the latch. Only
/// accepted corrections count as sent. Unused lines keep their levels.
#[test]
fn the_latch_toggles_one_write_after_the_word() {
    let axis = DigitalAxis::published(AxisName::X);
    let wiring = Wiring { latch: Some(8), ..Wiring::published() };
    let panel = Panel::new(wiring.clone(), vec![axis]);
    // Another program has left two lines at 1: the latch, and the tenth line, which the wiring does not use.
    panel.left_at(0x305);
    let taken = Arc::new(Mutex::new((panel.word(), 0)));
    let takes = Arc::clone(&taken);
    panel.on_write(move |word| {
        let (before, taken) = &mut *takes.lock().unwrap();
        if word.latch != before.latch {
            assert_eq!(word.counts, before.counts, "the latch toggles alone");
            *taken = word.counts.unwrap();
        }
        *before = word;
    });
    let port = Faulty::new(panel.clone(), Faults::default(), 1);
    let wire = port.remote();
    let coherence = Coherence::TwoAgree;
    let mut controller =
        DigitalController::new(port, "lines", wiring, coherence, vec![axis]).unwrap();
    controller.read(soon()).unwrap();
    assert_eq!(controller.sent()[0], None);
    let mut apply = |um: f64| {
        let applied = controller.apply(&PerChannel::leading([um * 1e-3]), soon());
        let sent = controller.sent()[0].map(|sent| (sent * 1e3).round());
        (applied.is_ok(), panel.levels(), taken.lock().unwrap().1, sent)
    };
    assert_eq!(apply(7.0), (true, 0x307, 0, None), "the word alone");
    assert_eq!(apply(8.0), (true, 0x207, 7, Some(7.0)), "the latch alone");
    assert_eq!(apply(9.0), (true, 0x209, 7, Some(7.0)));
    wire.inject(Injection::Disconnect { calls: 3 });
    for _ in 0..3 {
        assert_eq!(apply(20.0), (false, 0x209, 7, Some(7.0)));
    }
    assert_eq!(apply(20.0), (true, 0x309, 9, Some(9.0)));
    assert_eq!(apply(20.0), (true, 0x314, 9, Some(9.0)));
    assert_eq!(apply(20.0), (true, 0x214, 20, Some(20.0)));
}

/// A word is written, then a pause follows before its latch edge, or the edge fails. The control may have gone to zero
/// in the pause, so the earlier word is not latched after it.
#[test]
fn a_word_from_before_a_pause_is_not_latched() {
    for fails in [0, 1] {
        let axis = DigitalAxis::published(AxisName::X);
        let wiring = Wiring { latch: Some(8), ..Wiring::published() };
        let panel = Panel::new(wiring.clone(), vec![axis]);
        let taken = Arc::new(Mutex::new((panel.word(), 0)));
        let takes = Arc::clone(&taken);
        panel.on_write(move |word| {
            let (before, taken) = &mut *takes.lock().unwrap();
            if word.latch != before.latch {
                assert_eq!(word.counts, before.counts, "the latch toggles alone");
                *taken = word.counts.unwrap();
            }
            *before = word;
        });
        let port = Faulty::new(panel.clone(), Faults::default(), 1);
        let wire = port.remote();
        let coherence = Coherence::TwoAgree;
        let mut controller =
            DigitalController::new(port, "lines", wiring, coherence, vec![axis]).unwrap();
        controller.read(soon()).unwrap();
        let mut apply = |um: f64, within: Duration| {
            let _ = controller.apply(&PerChannel::leading([um * 1e-3]), Instant::now() + within);
            (panel.levels(), taken.lock().unwrap().1)
        };
        let short = Duration::from_millis(10);
        assert_eq!(apply(30.0, short), (0x01e, 0));
        for _ in 0..fails {
            wire.inject(Injection::Disconnect { calls: 1 });
            apply(30.0, short);
        }
        std::thread::sleep(Duration::from_millis(60));
        let long = Duration::from_secs(60);
        assert_eq!(apply(1.0, long), (0x001, 0), "{fails}");
        assert_eq!(apply(2.0, long), (0x101, 1));
    }
}

/// A module that confirms writes later than the next one, or reports one as failed that it still executes: only the word that was sent last is
/// latched, so that none is on its way when the latch toggles.
#[test]
fn no_other_word_is_sent_until_one_is_confirmed() {
    let axis = DigitalAxis::published(AxisName::X);
    for fails in [false, true] {
        let state = Arc::new(Mutex::new((Vec::new(), 0_u64)));
        let (written, confirmed) = (Arc::clone(&state), Arc::clone(&state));
        let mut port = MockDigitalIo::new();
        port.expect_device().return_const("lines".to_owned());
        port.expect_inputs().return_const(15_u32);
        port.expect_outputs().return_const(9_u32);
        port.expect_shortest_cycle().return_const(Duration::ZERO);
        port.expect_reports_outputs().return_const(true);
        port.expect_confirmed().returning(move || Some(confirmed.lock().unwrap().1));
        port.expect_write().returning(move |levels, _| {
            written.lock().unwrap().0.push(levels);
            if fails { Err(Fault::TimedOut) } else { Ok(()) }
        });
        let wiring = Wiring { latch: Some(8), ..Wiring::published() };
        let coherence = Coherence::Latched;
        let mut controller =
            DigitalController::new(port, "lines", wiring, coherence, vec![axis]).unwrap();
        let deadline = Instant::now() + Duration::from_secs(60);
        let mut apply = |um: f64| {
            let _ = controller.apply(&PerChannel::leading([um * 1e-3]), deadline);
        };
        for um in [5.0, 6.0, 5.0] {
            apply(um);
        }
        state.lock().unwrap().1 = 5;
        apply(6.0);
        state.lock().unwrap().1 = 0x105;
        apply(6.0);
        assert_eq!(state.lock().unwrap().0, [5, 5, 5, 0x105, 0x106], "{fails}");
    }
}

/// A module that executes a word only after its time limit: other words were requested meanwhile, so it is not latched.
#[test]
fn a_word_that_is_sent_again_keeps_its_time_limit() {
    let axis = DigitalAxis::published(AxisName::X);
    let state = Arc::new(Mutex::new((Vec::new(), 0_u64)));
    let (written, confirmed) = (Arc::clone(&state), Arc::clone(&state));
    let mut port = MockDigitalIo::new();
    port.expect_device().return_const("lines".to_owned());
    port.expect_inputs().return_const(15_u32);
    port.expect_outputs().return_const(9_u32);
    port.expect_shortest_cycle().return_const(Duration::ZERO);
    port.expect_reports_outputs().return_const(true);
    port.expect_confirmed().returning(move || Some(confirmed.lock().unwrap().1));
    port.expect_write().returning(move |levels, _| {
        written.lock().unwrap().0.push(levels);
        Ok(())
    });
    let wiring = Wiring { latch: Some(8), ..Wiring::published() };
    let coherence = Coherence::Latched;
    let mut controller =
        DigitalController::new(port, "lines", wiring, coherence, vec![axis]).unwrap();
    let mut apply = |um: f64| {
        let deadline = Instant::now() + Duration::from_millis(10);
        let _ = controller.apply(&PerChannel::leading([um * 1e-3]), deadline);
    };
    apply(5.0);
    for _ in 0..4 {
        std::thread::sleep(Duration::from_millis(15));
        apply(0.0);
    }
    state.lock().unwrap().1 = 5;
    apply(0.0);
    let written = &state.lock().unwrap().0;
    assert!(!written.contains(&0x105), "{written:x?}");
}

#[test]
fn a_failed_write_does_not_count_as_sent() {
    let axis = DigitalAxis::published(AxisName::X);
    let wiring = Wiring::published();
    let panel = Panel::new(wiring.clone(), vec![axis]);
    let port = Faulty::new(panel.clone(), Faults::default(), 1);
    let wire = port.remote();
    let coherence = Coherence::TwoAgree;
    let mut controller =
        DigitalController::new(port, "lines", wiring, coherence, vec![axis]).unwrap();
    assert_eq!(controller.description().shown, ShownStates::NONE);
    let um = |um: f64| PerChannel::leading([um * 1e-3]);
    controller.apply(&um(40.0), soon()).unwrap();
    wire.inject(Injection::Disconnect { calls: 1 });
    let refused = controller.apply(&um(41.0), soon());
    assert_eq!(refused, Err(Fault::NotConnected));
    assert!((controller.sent()[0].unwrap() - 0.040).abs() < 1e-12);
    let late = controller.apply(&um(42.0), Instant::now());
    assert_eq!(late, Err(Fault::TimedOut));
    assert_eq!(panel.levels(), 40);
    assert!((controller.sent()[0].unwrap() - 0.040).abs() < 1e-12);
}

/// Nothing is written while the levels of unused lines are unknown, because these would be switched off, unless the device cannot report
/// levels. Nothing is written while the level of the latch is unknown, because it could toggle together with the word.
#[test]
fn nothing_is_written_while_other_outputs_or_the_latch_are_unknown() {
    let axis = DigitalAxis::published(AxisName::X);
    for (outputs, latch, reports, is_written) in [
        (9_u32, None, true, false),
        (9, None, false, true),
        (8, None, true, true),
        (9, Some(8), true, false),
        (9, Some(8), false, false),
    ] {
        let writes = Arc::new(Mutex::new(0));
        let written = Arc::clone(&writes);
        let mut port = MockDigitalIo::new();
        port.expect_device().return_const("lines".to_owned());
        port.expect_inputs().return_const(15_u32);
        port.expect_outputs().return_const(outputs);
        port.expect_shortest_cycle().return_const(Duration::ZERO);
        port.expect_confirmed().return_const(None);
        port.expect_reports_outputs().return_const(reports);
        port.expect_write().returning(move |_, _| {
            *written.lock().unwrap() += 1;
            Ok(())
        });
        let wiring = Wiring { latch, ..Wiring::published() };
        let coherence = Coherence::Latched;
        let controller = DigitalController::new(port, "lines", wiring, coherence, vec![axis]);
        let applied = controller.unwrap().apply(&PerChannel::ZERO, soon());
        assert_eq!(applied.is_ok(), is_written, "{outputs} {latch:?} {reports}: {applied:?}");
        assert_eq!(*writes.lock().unwrap(), u32::from(is_written));
    }
}
