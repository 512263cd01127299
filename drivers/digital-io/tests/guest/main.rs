//! Lines of the kernel's simulated GPIO chips: `panel-out` has the control's 15 outputs, `panel-in` its 8 inputs. Run
//! by `./test` in the guest, or by `tests/guest/run`.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::{
    fs,
    path::PathBuf,
    sync::{LazyLock, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use volcomp_digital_io::{
    Coherence, DigitalAxis, DigitalController, GpioPort, LineSet, PositionCode, Wiring,
};
use volcomp_port::{Controller, DigitalIo};
use volcomp_vocabulary::{AxisName, PerChannel};

#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

fn panel() -> MutexGuard<'static, ()> {
    static PANEL: Mutex<()> = Mutex::new(());
    PANEL.lock().unwrap_or_else(PoisonError::into_inner)
}

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(2)
}

/// The gpio-sim folder of a chip. The test acts as the control through its files, which set and read levels.
fn bank(label: &str) -> PathBuf {
    let labelled = |chip: &PathBuf| {
        let info = gpiocdev::Chip::from_path(chip).and_then(|chip| chip.info());
        info.is_ok_and(|info| info.label == label)
    };
    let chip = gpiocdev::chip::chips().unwrap().into_iter().find(labelled);
    let name = chip.expect(label).file_name().unwrap().to_owned();
    let devices = fs::read_dir("/sys/devices/platform").unwrap().flatten();
    let mut banks = devices.map(|device| device.path().join(&name));
    banks.find(|bank| bank.join("sim_gpio0").is_dir()).expect(label)
}

fn simulated(label: &'static str, line: u32) -> PathBuf {
    static BANKS: LazyLock<[PathBuf; 2]> = LazyLock::new(|| ["panel-out", "panel-in"].map(bank));
    let bank = &BANKS[usize::from(label == "panel-in")];
    bank.join(format!("sim_gpio{line}"))
}

/// Sets the control's outputs one after the other, in the order of their numbers.
fn control_shows(levels: u64) {
    for line in 0..15 {
        let level = if levels >> line & 1 == 1 { "pull-up" } else { "pull-down" };
        fs::write(simulated("panel-out", line).join("pull"), level).unwrap();
    }
}

fn control_sees() -> u64 {
    let level = |line: u32| {
        let text = fs::read_to_string(simulated("panel-in", line).join("value")).unwrap();
        u64::from(text.trim() == "1") << line
    };
    (0..8).map(level).sum()
}

fn lines(text: &str) -> LineSet {
    LineSet::parse(text).unwrap()
}

fn port() -> GpioPort {
    GpioPort::open(&lines("panel-out:0-14"), &lines("panel-in:0-7")).unwrap()
}

#[test]
fn every_line_is_in_its_place() {
    let _panel = panel();
    let mut port = port();
    assert_eq!((port.inputs(), port.outputs()), (15, 8));
    for line in 0..15 {
        control_shows(1 << line);
        assert_eq!(port.read(soon()).unwrap().levels, 1 << line, "output {line} of the control");
    }
    for line in 0..8 {
        port.write(1 << line, soon()).unwrap();
        assert_eq!(control_sees(), 1 << line, "input {line} of the control");
    }
}

/// Opening changes no line: the levels of the outputs are kept and count as confirmed.
#[test]
fn opening_changes_no_line() {
    let _panel = panel();
    for levels in [0xa5, 0x5a, 0xff, 0] {
        let mut first = port();
        first.write(levels, soon()).unwrap();
        // The kernel may release closed lines, so the simulator's pulls set the levels that the control would hold.
        drop(first);
        for line in 0..8 {
            let level = if levels >> line & 1 == 1 { "pull-up" } else { "pull-down" };
            fs::write(simulated("panel-in", line).join("pull"), level).unwrap();
        }
        assert_eq!(control_sees(), levels);
        let again = port();
        assert_eq!((control_sees(), again.confirmed()), (levels, Some(levels)));
    }
}

#[test]
fn cycles_do_not_allocate() {
    let _panel = panel();
    let mut port = port();
    assert_no_alloc::assert_no_alloc(|| {
        for levels in 0..256 {
            port.write(levels, soon()).unwrap();
            port.read(soon()).unwrap();
        }
    });
    assert_eq!(port.confirmed(), Some(255));
}

/// Along the whole travel the position is read within 1/64 mm, and the correction written within half a step.
#[test]
fn a_ramp_of_positions_is_corrected() {
    let _panel = panel();
    for (code, inverted) in [(PositionCode::Binary, 0), (PositionCode::Gray, 0x5a5a)] {
        let mut axis = DigitalAxis::published(AxisName::X);
        axis.position.code = code;
        let wiring = Wiring {
            inverted_inputs: inverted & 0x7fff,
            inverted_outputs: inverted & 0xff,
            ..Wiring::published()
        };
        let mut controller = DigitalController::new(
            port(),
            "lines",
            wiring.clone(),
            Coherence::TwoAgree,
            vec![axis],
        )
        .unwrap();
        for step in 0..60 {
            let place = 1020.0 * f64::from(step) / 60.0;
            control_shows(wiring.control_outputs(axis.position.encode(place).unwrap(), 0, true));
            let found = controller.read(soon()).unwrap().positions[0];
            assert!((found - place).abs() <= 1.0 / 64.0, "{found} at {place}");
            let mut requested = PerChannel::ZERO;
            requested[0] = 0.1 * (place / 100.0).sin();
            controller.apply(&requested, soon()).unwrap();
            let (word, _) = wiring.control_inputs(control_sees());
            let taken = axis.correction.decode(word).unwrap();
            assert!((taken - requested[0]).abs() <= 0.000_501, "{taken} for {}", requested[0]);
        }
    }
}

#[test]
fn the_digital_port_contract() {
    let _panel = panel();
    volcomp_port::contract::digital_io(&mut port(), false);
}

/// A port opened with inputs and outputs swapped has too few lines.
#[test]
fn swapped_roles_are_rejected() {
    let _panel = panel();
    let swapped = GpioPort::open(&lines("panel-in:0-7"), &lines("panel-out:0-14")).unwrap();
    let refused = DigitalController::new(
        swapped,
        "lines",
        Wiring::published(),
        Coherence::TwoAgree,
        vec![DigitalAxis::published(AxisName::X)],
    );
    let message = refused.err().unwrap().to_string();
    assert!(message.contains("inputs: found 8, expected a line below 8"), "{message}");
}

#[test]
fn unavailable_chips_and_lines_are_named() {
    let _panel = panel();
    let missing = GpioPort::open(&lines("panel-up:0-14"), &lines("panel-in:0-7"));
    let message = missing.err().unwrap().to_string();
    assert!(
        message.contains("gpio panel-up: there is no such chip, found panel-")
            && message.contains("gpiodetect"),
        "{message}"
    );
    let _taken = port();
    let message = GpioPort::open(&lines("panel-out:0-14"), &lines("panel-in:0-7"));
    let message = message.err().unwrap().to_string();
    assert!(message.contains("cannot be taken") && message.contains("gpioinfo"), "{message}");
    let beyond = GpioPort::open(&lines("panel-out:0-20"), &lines("panel-in:0-7"));
    assert!(beyond.is_err());
}
