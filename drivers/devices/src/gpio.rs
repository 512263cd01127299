//! Lines of the Linux GPIO character device.

use std::time::{Duration, Instant};

use volcomp_digital_io::{GpioPort, LineSet, PositionWord, Wiring};
use volcomp_port::{DeviceError, DigitalIo, UnopenedLines};
use volcomp_vocabulary::{AxisKind, Displacement};

use crate::{address::Address, driver::Driver, lines, probe::Probe};

pub(crate) const DRIVER: Driver = Driver {
    devices: |address| {
        let keys = ["position", "correction"].into_iter();
        keys.filter_map(|key| address.get(key)).map(chip).collect()
    },
    controller: |address, own| lines::controller(address, own, gpio_port, unopened),
    example: "gpio://?position=gpiochip0:0-14&correction=gpiochip1:0-7",
    first: |address, machine| lines::first(unopened(address).ok(), "binary", machine),
    probe,
    ..lines::LINES
};

/// Canonical name of the chip in `CHIP:LINES`: its device file, because a chip also has a label and a name.
fn chip(lines: &str) -> String {
    let file = LineSet::parse(lines).and_then(|set| set.chip_file());
    let named = || lines.rsplit_once(':').map_or(lines, |(chip, _)| chip);
    let chip = file.map_or_else(|_| named().to_owned(), |file| file.display().to_string());
    format!("gpio {chip}")
}

/// Opens the lines of a URL. The keys are named from the control's side: `position` names outputs of the control,
/// `correction` its inputs. Errors: missing keys, or lines that cannot be requested.
fn gpio_port(address: &Address) -> Result<GpioPort, DeviceError> {
    let [position, correction] = line_sets(address)?;
    GpioPort::open(&position, &correction)
}

/// Describes the port of `gpio_port` without opening it.
fn unopened(address: &Address) -> Result<UnopenedLines, DeviceError> {
    let [position, correction] = line_sets(address)?;
    Ok(GpioPort::describe(&position, &correction))
}

fn line_sets(address: &Address) -> Result<[LineSet; 2], DeviceError> {
    let lines = |key: &str| {
        let text = address.get(key).ok_or_else(|| {
            let remedy = "expected gpio://?position=CHIP:LINES&correction=CHIP:LINES";
            address.wrong(format!("{key} is missing"), remedy)
        })?;
        LineSet::parse(text)
    };
    Ok([lines("position")?, lines("correction")?])
}

/// Reads the inputs. The outputs are requested with their present levels and then released.
fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let mut port = gpio_port(address)?;
    let read = port.read(Instant::now() + at_most);
    let levels = read.map_err(|fault| address.failed(fault, "check the chip"))?.levels;
    let mut probe = Probe::of(&address.text);
    probe.inputs = (0..port.inputs()).map(|line| levels >> line & 1 == 1).collect();
    if port.inputs() == 15 {
        // 15 lines are the layout of [`PositionWord::PUBLISHED`], so the levels are decoded by it.
        let word = Wiring::published().position_word(levels);
        if let Some(word) = word {
            let position = PositionWord::PUBLISHED.decode(word).position;
            let at = Displacement::new(AxisKind::Linear, position);
            probe.add_position("published".to_owned(), at);
        }
    }
    Ok(probe)
}
