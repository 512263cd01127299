//! Reports of the simulated machine, and the log of its axis corrections.
//!
//! A separate thread writes them, so that a scan never waits for a disk.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{BufWriter, Write},
    path::Path,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;
use volcomp_focas::simulator::{Scan, ScanLog, Simulator};
use volcomp_vocabulary::{AxisKind, AxisName, Direction, Displacement};

use crate::{
    error::{SimError, count},
    truth::{Miss, Place, Truth},
};

/// Rounding difference between the end of one move and the start of the next that does not count as travel, mm or deg.
const NO_TRAVEL: f64 = 1e-9;

/// Values by axis letter, in the unit at the end of the field name. Linear and rotary axes have separate maps.
pub(crate) type ByLetter = BTreeMap<AxisName, f64>;

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Report {
    pub(crate) time_s: f64,
    pub(crate) positions_mm: ByLetter,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub(crate) positions_deg: ByLetter,
    pub(crate) correction_um: ByLetter,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub(crate) correction_urad: ByLetter,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) error: Option<Miss>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) residual: Option<Miss>,
    /// Tool tip of the ideal machine in workpiece axes, mm; zero if the machine is unknown.
    #[serde(skip)]
    pub(crate) ideal_tip_mm: [f64; 3],
}

/// Largest change of each axis's shift between two scans of the control.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Steps {
    largest_step_um: ByLetter,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    largest_step_urad: ByLetter,
}

impl Steps {
    pub(crate) fn of(axes: &[AxisName], simulator: &Simulator) -> Self {
        let counts = simulator.world().largest_steps().to_vec();
        let of_kind = |kind: AxisKind| {
            let steps = axes.iter().zip(&counts);
            steps
                .filter(|(axis, _)| axis.kind() == kind)
                .map(|(axis, step)| (*axis, rounded(*step as f64 * count(kind).um_or_urad())))
                .collect()
        };
        Self {
            largest_step_um: of_kind(AxisKind::Linear),
            largest_step_urad: of_kind(AxisKind::Rotary),
        }
    }

    pub(crate) fn text(&self) -> String {
        let of = |steps: &ByLetter, unit: &str| {
            let of = |(axis, step): (&AxisName, &f64)| format!("{axis} {step:.1} {unit}");
            steps.iter().map(of).collect::<Vec<_>>()
        };
        let mut items = of(&self.largest_step_um, "µm");
        items.extend(of(&self.largest_step_urad, "µrad"));
        wrapped("largest step of an axis in one scan:", &items)
    }
}

/// Generates report lines. Call `watch` often enough to sample the axes between any two reversals.
pub(crate) struct Reporter {
    axes: Vec<AxisName>,
    truth: Option<Arc<Truth>>,
    last: Vec<f64>,
    approach: Vec<Option<Direction>>,
}

impl Reporter {
    pub(crate) fn new(axes: Vec<AxisName>, truth: Option<Arc<Truth>>) -> Self {
        Self { last: Vec::new(), approach: vec![None; axes.len()], axes, truth }
    }

    /// Commanded positions and applied shifts, mm and deg. Also records the direction in which each axis has moved
    /// since the previous call.
    fn look(&mut self, simulator: &Simulator) -> [Vec<f64>; 2] {
        let (commanded, shifts) = {
            let mut world = simulator.world();
            (world.commanded(), world.shifts())
        };
        for (approach, (now, before)) in
            self.approach.iter_mut().zip(commanded.iter().zip(&self.last))
        {
            if *now > before + NO_TRAVEL {
                *approach = Some(Direction::Positive);
            } else if *now < before - NO_TRAVEL {
                *approach = Some(Direction::Negative);
            }
        }
        self.last.clone_from(&commanded);
        [commanded, shifts]
    }

    pub(crate) fn watch(&mut self, simulator: &Simulator) {
        self.look(simulator);
    }

    pub(crate) fn report(&mut self, simulator: &Simulator) -> Report {
        let time_s = simulator.world().elapsed().as_secs_f64();
        let [commanded, shifts] = self.look(simulator);
        let place = Place {
            axes: &self.axes,
            commanded: &commanded,
            shifts: &shifts,
            approach: &self.approach,
        };
        let truth = self.truth.as_ref();
        let misses = truth.map(|truth| truth.misses(&place));
        let by_letter = |rotary: bool, values: &[f64], number: &dyn Fn(Displacement) -> f64| {
            let pairs = self.axes.iter().zip(values);
            pairs
                .filter(|(axis, _)| axis.is_rotary() == rotary)
                .map(|(axis, value)| {
                    let value = Displacement::from_coordinate(axis.kind(), *value);
                    (*axis, rounded(number(value)))
                })
                .collect::<ByLetter>()
        };
        let positions = |rotary| by_letter(rotary, &commanded, &Displacement::mm_or_deg);
        let corrections = |rotary| by_letter(rotary, &shifts, &Displacement::um_or_urad);
        Report {
            time_s: rounded(time_s),
            positions_mm: positions(false),
            positions_deg: positions(true),
            correction_um: corrections(false),
            correction_urad: corrections(true),
            error: misses.map(|[error, _]| rounded_miss(error)),
            residual: misses.map(|[_, residual]| rounded_miss(residual)),
            ideal_tip_mm: truth.map_or([0.0; 3], |truth| truth.ideal_tip_mm(&place)),
        }
    }
}

impl Report {
    /// Formats the positions, and the tool error without and with the correction. If the error is unknown, formats the
    /// positions and the corrections. Lines have at most 80 columns.
    pub(crate) fn text(&self) -> String {
        let mut items = Vec::new();
        let kinds = [
            (&self.positions_mm, &self.correction_um, "µm"),
            (&self.positions_deg, &self.correction_urad, "µrad"),
        ];
        for (positions, corrections, unit) in kinds {
            for ((letter, position), correction) in positions.iter().zip(corrections.values()) {
                items.push(if self.error.is_none() {
                    format!("{letter} {position:.1} ({correction:+.1} {unit})")
                } else {
                    format!("{letter} {position:.1}")
                });
            }
        }
        if let (Some(error), Some(residual)) = (self.error, self.residual) {
            items.push(format!(
                " tool error, unaligned {:.1} → {:.1} µm, {:.1} → {:.1} µrad",
                error.distance_um(),
                residual.distance_um(),
                error.tool_axis_urad,
                residual.tool_axis_urad,
            ));
        }
        wrapped(&format!("{:7.1} s ", self.time_s), &items)
    }
}

/// Serializes a line as JSON. This cannot fail, because keys are letters and names, and numbers are finite.
pub(crate) fn json(line: &impl Serialize) -> String {
    serde_json::to_string(line).unwrap_or_default()
}

/// Formats items after a prefix, separated by blanks, in lines of at most 80 columns.
pub(crate) fn wrapped(head: &str, items: &[String]) -> String {
    const COLUMNS: usize = 80;
    let (mut text, mut column) = (head.to_owned(), head.chars().count());
    for item in items {
        let length = 1 + item.chars().count();
        if column + length > COLUMNS {
            text += "\n";
            text.extend(std::iter::repeat_n(' ', head.chars().count()));
            column = head.chars().count();
        }
        text += " ";
        text += item;
        column += length;
    }
    text
}

/// Rounds to three decimals.
pub(crate) fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

fn rounded_miss(miss: Miss) -> Miss {
    Miss {
        position_um: miss.position_um.map(rounded),
        tool_axis_urad: rounded(miss.tool_axis_urad),
    }
}

const FLUSH: Duration = Duration::from_millis(50);

/// One line of the log: monotonic time, ns; whether the control was power-cycled; the shift of each axis, counts.
struct Line {
    time_ns: i128,
    switched_on: bool,
    shifts: Vec<i64>,
}

pub(crate) struct AxisLog {
    writer: JoinHandle<std::io::Result<()>>,
    file: String,
}

impl AxisLog {
    /// Creates the file and the scan callback. Dropping the callback ends the log.
    pub(crate) fn create(path: &Path, axes: &[AxisName]) -> Result<(ScanLog, Self), SimError> {
        let file = path.display().to_string();
        let mut output = BufWriter::new(File::create(path).map_err(SimError::write(&file))?);
        let heads = axes.iter().map(|axis| match axis.kind() {
            AxisKind::Linear => format!(",{axis}_um"),
            AxisKind::Rotary => format!(",{axis}_urad"),
        });
        let heads: String = heads.collect();
        writeln!(output, "monotonic_s,switched_on{heads}").map_err(SimError::write(&file))?;
        let scales: Vec<f64> = (axes.iter()).map(|axis| count(axis.kind()).um_or_urad()).collect();
        let (line_sender, lines) = channel();
        let writer = thread::Builder::new()
            .name("focas-sim axes".to_owned())
            .spawn(move || write(output, &lines, &scales))
            .map_err(SimError::thread)?;
        Ok((scan_log(line_sender), Self { writer, file }))
    }

    pub(crate) fn end(self) -> Result<(), SimError> {
        // The panic of the thread has already printed its message.
        let written = self.writer.join().unwrap_or(Ok(()));
        written.map_err(SimError::write(&self.file))
    }
}

/// Forwards the first scan, scans in which an axis moved, and scans after a power cycle.
fn scan_log(line_sender: Sender<Line>) -> ScanLog {
    let mut last: Option<Vec<i64>> = None;
    Box::new(move |scan: Scan<'_>| {
        if !scan.switched_on && last.as_deref() == Some(scan.shifts) {
            return;
        }
        let now = clock_gettime(ClockId::Monotonic);
        // The writer drops the receiver only after a write error, which `end` returns.
        let _ = line_sender.send(Line {
            time_ns: i128::from(now.tv_sec) * 1_000_000_000 + i128::from(now.tv_nsec),
            switched_on: scan.switched_on,
            shifts: scan.shifts.to_vec(),
        });
        last = Some(scan.shifts.to_vec());
    })
}

fn write(
    mut output: BufWriter<File>,
    lines: &Receiver<Line>,
    scales: &[f64],
) -> std::io::Result<()> {
    loop {
        match lines.recv_timeout(FLUSH) {
            Ok(line) => {
                let seconds = line.time_ns as f64 * 1e-9;
                write!(output, "{seconds:.6},{}", u8::from(line.switched_on))?;
                for (shift, scale) in line.shifts.iter().zip(scales) {
                    write!(output, ",{:.3}", *shift as f64 * scale)?;
                }
                writeln!(output)?;
            }
            Err(RecvTimeoutError::Timeout) => output.flush()?,
            Err(RecvTimeoutError::Disconnected) => return output.flush(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six axes far from zero, with and without a known tool error.
    #[test]
    fn lines_fit_into_eighty_columns() {
        let all = |names: [AxisName; 3], value: f64| names.map(|name| (name, value)).into();
        let linear = [AxisName::X, AxisName::Y, AxisName::Z];
        let rotary = [AxisName::A, AxisName::B, AxisName::C];
        let miss = Miss { position_um: [-1234.5, 1234.5, -1234.5], tool_axis_urad: 12345.6 };
        for truth in [None, Some(miss)] {
            let report = Report {
                time_s: 12345.6,
                positions_mm: all(linear, -12345.6),
                positions_deg: all(rotary, -359.9),
                correction_um: all(linear, -1234.5),
                correction_urad: all(rotary, -1234.5),
                error: truth,
                residual: truth,
                ideal_tip_mm: [0.0; 3],
            };
            let text = report.text();
            for line in text.lines() {
                assert!(line.chars().count() <= 80, "{text}");
            }
            for part in ["X -12345.6", "C -359.9"] {
                assert!(text.contains(part), "{text}");
            }
        }
    }
}
