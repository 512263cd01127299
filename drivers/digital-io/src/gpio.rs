//! Lines of the Linux GPIO character device.

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use gpiocdev::{
    Chip, Request,
    line::{Offset, Value, Values},
    request::Config,
};
use volcomp_port::{DeviceError, DigitalIo, Fault, InputLevels, UnopenedLines};

/// Lines of one chip. The first line is the lowest bit.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LineSet {
    /// Label, name or path of the chip: `panel-out`, `gpiochip0`, `/dev/gpiochip0`.
    pub chip: String,
    /// Numbers of the lines on the chip. The first line is the lowest bit.
    pub lines: Vec<Offset>,
}

impl LineSet {
    /// Parses a text such as `panel-out:0-14` or `gpiochip0:3,5,9-11`.
    ///
    /// # Errors
    /// Any other text, or a line that is listed twice, which would be two bits of a word.
    pub fn parse(text: &str) -> Result<Self, DeviceError> {
        let wrong = || {
            let what = format!("found `{text}` as lines");
            DeviceError::option("gpio", what, "expected CHIP:LINES such as panel-out:0-14")
        };
        let (chip, list) = text.rsplit_once(':').ok_or_else(wrong)?;
        let mut lines = Vec::new();
        for part in list.split(',') {
            let (from, to) = part.split_once('-').unwrap_or((part, part));
            let number = |text: &str| text.parse::<Offset>().map_err(|_| wrong());
            let (from, to) = (number(from)?, number(to)?);
            if from > to || to - from >= 64 {
                return Err(wrong());
            }
            lines.extend(from..=to);
        }
        if chip.is_empty() || lines.len() > 64 {
            return Err(wrong());
        }
        let mut places = lines.iter().enumerate();
        if let Some((_, line)) = places.find(|(place, line)| lines[..*place].contains(line)) {
            let what = format!("found line {line} twice in `{text}`");
            return Err(DeviceError::option("gpio", what, "expected each line once"));
        }
        Ok(Self { chip: chip.to_owned(), lines })
    }

    /// Device file of the chip, found by label, name or path.
    ///
    /// # Errors
    /// The chip does not exist, or this user may not open it.
    pub fn chip_file(&self) -> Result<PathBuf, DeviceError> {
        find(self)
    }
}

/// A digital port whose inputs are lines of one chip, and whose outputs are lines of the same or another chip.
pub struct GpioPort {
    device: String,
    inputs: Request,
    input_lines: Vec<Offset>,
    outputs: Request,
    output_lines: Vec<Offset>,
    /// Preallocated storage for the levels of inputs and outputs, so that a cycle does not allocate.
    input_values: Values,
    output_values: Values,
    confirmed: u64,
}

/// Shortest duration of an exchange, which consists of system calls.
const SHORTEST_CYCLE: Duration = Duration::from_micros(50);

impl GpioPort {
    /// Describes a port on these lines without requesting them.
    pub fn describe(control_outputs: &LineSet, control_inputs: &LineSet) -> UnopenedLines {
        let count = |set: &LineSet| u32::try_from(set.lines.len()).unwrap_or(u32::MAX);
        UnopenedLines {
            device: device(control_outputs, control_inputs),
            inputs: count(control_outputs),
            outputs: count(control_inputs),
            shortest_cycle: SHORTEST_CYCLE,
        }
    }

    /// Requests the outputs of a control as inputs of this port, and the inputs of the control as outputs of this port.
    /// The present levels of the port's outputs are read first and then driven, so that the control sees no change.
    ///
    /// # Errors
    /// A chip or line that does not exist or is in use, or a chip that cannot read the present levels of output lines.
    /// Without these levels, driving the lines could cause a step of the correction.
    pub fn open(control_outputs: &LineSet, control_inputs: &LineSet) -> Result<Self, DeviceError> {
        let inputs = Request::builder()
            .on_chip(find(control_outputs)?)
            .with_consumer("volcomp")
            .with_lines(&control_outputs.lines)
            .as_input()
            .request()
            .map_err(|e| refused(control_outputs, &e))?;
        let outputs = Request::builder()
            .on_chip(find(control_inputs)?)
            .with_consumer("volcomp")
            .with_lines(&control_inputs.lines)
            .as_is()
            .request()
            .map_err(|e| refused(control_inputs, &e))?;
        let mut output_values = Values::from_offsets(&control_inputs.lines);
        outputs.values(&mut output_values).map_err(|e| {
            let what = format!(
                "the present levels of lines {:?} cannot be read: {e}",
                control_inputs.lines
            );
            let remedy = "use lines whose levels can be read back: driving these could change the correction in one step";
            DeviceError::open(format!("gpio {}", control_inputs.chip), what, remedy)
        })?;
        let mut as_found = Config::default();
        as_found.with_output_lines(&output_values);
        outputs.reconfigure(&as_found).map_err(|e| refused(control_inputs, &e))?;
        Ok(Self {
            device: device(control_outputs, control_inputs),
            confirmed: levels_of(&output_values, &control_inputs.lines),
            input_values: Values::from_offsets(&control_outputs.lines),
            output_values,
            inputs,
            input_lines: control_outputs.lines.clone(),
            outputs,
            output_lines: control_inputs.lines.clone(),
        })
    }
}

/// Levels of these lines as bits. The first line is the lowest bit.
fn levels_of(values: &Values, lines: &[Offset]) -> u64 {
    let mut levels = 0;
    for (bit, line) in lines.iter().enumerate() {
        levels |= u64::from(values.get(*line) == Some(Value::Active)) << bit;
    }
    levels
}

/// Sets the levels of these lines in `values`. To avoid an allocation, `values` must already contain all of the lines.
fn put_levels(values: &mut Values, lines: &[Offset], levels: u64) {
    for (bit, line) in lines.iter().enumerate() {
        values.set(*line, Value::from(levels >> bit & 1 == 1));
    }
}

fn device(control_outputs: &LineSet, control_inputs: &LineSet) -> String {
    format!("gpio {} and {}", control_outputs.chip, control_inputs.chip)
}

fn refused(set: &LineSet, error: &gpiocdev::Error) -> DeviceError {
    let what = format!("lines {:?} cannot be taken: {error}", set.lines);
    let remedy = "check the lines, the group of this user, and which program has them (gpioinfo)";
    DeviceError::open(format!("gpio {}", set.chip), what, remedy)
}

/// Finds the chip by label, name or path.
fn find(set: &LineSet) -> Result<PathBuf, DeviceError> {
    let missing = |what: String| {
        let remedy = "check its name (gpiodetect) and the group of this user";
        DeviceError::open(format!("gpio {}", set.chip), what, remedy)
    };
    let chips = gpiocdev::chip::chips().map_err(|e| missing(format!("no chip was found: {e}")))?;
    let mut known = Vec::new();
    for path in chips {
        let Ok(info) = Chip::from_path(&path).and_then(|chip| chip.info()) else {
            continue;
        };
        if path.to_string_lossy() == set.chip || info.name == set.chip || info.label == set.chip {
            return Ok(path);
        }
        known.push(info.label);
    }
    let found = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
    Err(missing(format!("there is no such chip, found {found}")))
}

impl DigitalIo for GpioPort {
    fn device(&self) -> &str {
        &self.device
    }

    fn inputs(&self) -> u32 {
        u32::try_from(self.input_lines.len()).unwrap_or(0)
    }

    fn outputs(&self) -> u32 {
        u32::try_from(self.output_lines.len()).unwrap_or(0)
    }

    fn shortest_cycle(&self) -> Duration {
        SHORTEST_CYCLE
    }

    /// Reads all lines with one system call. Whether the chip samples them at the same instant depends on the chip.
    fn read(&mut self, _deadline: Instant) -> Result<InputLevels, Fault> {
        let taken = Instant::now();
        let read = self.inputs.values(&mut self.input_values);
        read.map_err(|_| Fault::Disconnected)?;
        let levels = levels_of(&self.input_values, &self.input_lines);
        Ok(InputLevels { levels, taken })
    }

    fn write(&mut self, levels: u64, _deadline: Instant) -> Result<(), Fault> {
        put_levels(&mut self.output_values, &self.output_lines, levels);
        let set = self.outputs.set_values(&self.output_values);
        set.map_err(|_| Fault::Disconnected)?;
        self.confirmed = levels;
        Ok(())
    }

    fn confirmed(&self) -> Option<u64> {
        Some(self.confirmed)
    }
}

#[cfg(test)]
mod tests {
    use assert_no_alloc::{AllocDisabler, assert_no_alloc};

    use super::*;

    #[global_allocator]
    static ALLOCATOR: AllocDisabler = AllocDisabler;

    #[test]
    fn levels_are_put_without_allocating() {
        // The bits follow the order of `lines`, whatever the line numbers.
        let lines = [9, 3, 4, 31];
        let mut values = Values::from_offsets(&lines);
        assert_no_alloc(|| {
            for levels in 0..16 {
                put_levels(&mut values, &lines, levels);
                assert_eq!(levels_of(&values, &lines), levels);
            }
        });
        assert_eq!(values.len(), lines.len());
    }
}
