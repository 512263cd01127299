//! Measurement at the targets of a program: the machine stops at each target until the correction has settled.
//!
//! The results are written to a file, with the tool error along each line.

use std::{
    fs::File,
    io::{BufWriter, Write},
    path::Path,
    sync::mpsc::Receiver,
    thread,
    time::{Duration, Instant},
};

use serde::Serialize;
use volcomp_focas::simulator::{Ladder, Simulator, World};
use volcomp_guard::{barrier::Report as BarrierReport, protocol::Layout};
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{
    error::SimError,
    print,
    program::{Stop, Walk},
    report::{Report, Reporter, json, rounded, wrapped},
    truth::Miss,
};

const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Number of frames that must be accepted without a change before a correction counts as settled. The first frames may
/// have been computed or queued before the machine stopped, and on a busy computer all frames are late.
const FRAMES: u16 = 10;

#[derive(Clone, Copy)]
pub(crate) struct Settling {
    pub(crate) stands: Duration,
    /// Timeout after which the target is recorded as not settled.
    pub(crate) at_most: Duration,
    pub(crate) barrier: Option<(u16, Layout)>,
}

pub(crate) struct Measurement {
    pub(crate) walk: std::sync::Arc<Walk>,
    pub(crate) settling: Settling,
    pub(crate) reporter: Reporter,
    pub(crate) sheet: Sheet,
    pub(crate) json: bool,
}

impl Measurement {
    /// Runs the program once for each message, until the channel is closed.
    pub(crate) fn run(
        mut self,
        simulator: &Simulator,
        run_requests: &Receiver<()>,
    ) -> Result<(), SimError> {
        let mut pass = 0;
        while run_requests.recv().is_ok() {
            pass += 1;
            let pass = self.pass(pass, simulator)?;
            print(&if self.json { json(&pass) } else { pass.text() });
        }
        Ok(())
    }

    fn pass(&mut self, pass: u32, simulator: &Simulator) -> Result<Pass, SimError> {
        let mut targets = Vec::new();
        for index in 0..self.walk.stops.len() {
            self.go_to(index, simulator);
            let dwell = self.walk.dwells.get(index).copied().unwrap_or_default();
            match self.walk.stops.get(index).cloned() {
                Some(Stop::Target(line)) => {
                    let (settled, waited) = self.settle(dwell, simulator);
                    let target = Target {
                        pass,
                        number: targets.len() + 1,
                        line,
                        settled,
                        stood_s: rounded(waited.as_secs_f64()),
                        report: self.reporter.report(simulator),
                    };
                    self.sheet.write(&target)?;
                    targets.push(target);
                }
                Some(Stop::OnTheWay) | None => thread::sleep(dwell),
            }
        }
        Ok(Pass {
            number: pass,
            targets: targets.len(),
            not_settled: targets.iter().filter(|target| !target.settled).count(),
            lines: Line::of(&targets),
        })
    }

    /// Moves to the end of the move `index`, and records the direction of each axis.
    fn go_to(&mut self, index: usize, simulator: &Simulator) {
        self.walk.go_to(index, simulator.world().moved_for());
        while !self.walk.has_arrived(simulator.world().moved_for()) {
            self.reporter.watch(simulator);
            thread::sleep(POLL_INTERVAL);
        }
        self.reporter.watch(simulator);
    }

    /// Returns whether the correction has settled, and the time waited.
    fn settle(&self, dwell: Duration, simulator: &Simulator) -> (bool, Duration) {
        let arrived = Instant::now();
        let mut stability = Stability::since(arrived, self.sample(simulator));
        loop {
            thread::sleep(POLL_INTERVAL);
            stability.update(self.sample(simulator));
            let settled = stability.is_settled(self.settling.stands);
            let waited = arrived.elapsed();
            if waited >= dwell && (settled || waited >= self.settling.at_most) {
                return (settled, waited);
            }
        }
    }

    fn sample(&self, simulator: &Simulator) -> Sample {
        let mut world = simulator.world();
        Sample {
            shifts: world.shift_counts(),
            sender: self.settling.barrier.and_then(|barrier| sender(&mut world, barrier)),
        }
    }
}

/// Owner number of the sender whose frames the barrier accepts, and the sequence number of its last accepted frame;
/// `None` without a sender.
fn sender(world: &mut World, (machine, axes): (u16, Layout)) -> Option<(u16, u16)> {
    let Some(Ladder::Barrier(ladder)) = &world.ladder else {
        return None;
    };
    let at = ladder.report;
    let words = world.words(at, BarrierReport::length(axes));
    let report = BarrierReport::decode(machine, axes, &words)?;
    (report.owner != 0).then_some((report.owner, report.sequence))
}

#[derive(Clone, Debug, PartialEq)]
struct Sample {
    shifts: Vec<i64>,
    sender: Option<(u16, u16)>,
}

/// Tracks how long the corrections have not changed.
struct Stability {
    since: Instant,
    sample: Sample,
    frames: u16,
}

impl Stability {
    fn since(since: Instant, sample: Sample) -> Self {
        let frames = 0;
        Self { since, sample, frames }
    }

    fn update(&mut self, sample: Sample) {
        let owner = |sample: &Sample| sample.sender.map(|(owner, _)| owner);
        if sample.shifts != self.sample.shifts || owner(&sample) != owner(&self.sample) {
            *self = Self::since(Instant::now(), sample);
        } else if sample != self.sample {
            self.frames = self.frames.saturating_add(1);
            self.sample = sample;
        }
    }

    fn is_settled(&self, stands: Duration) -> bool {
        let is_confirmed = self.sample.sender.is_none() || self.frames >= FRAMES;
        is_confirmed && self.since.elapsed() >= stands
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Target {
    /// Number of the pass through the program, from 1.
    pass: u32,
    /// Number of the target in the program, from 1.
    #[serde(rename = "target")]
    pub(crate) number: usize,
    pub(crate) line: Option<String>,
    pub(crate) settled: bool,
    stood_s: f64,
    #[serde(flatten)]
    pub(crate) report: Report,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Line {
    #[serde(rename = "line")]
    pub(crate) name: String,
    pub(crate) targets: usize,
    /// Range (largest minus smallest) of the deviation along the line without correction, µm.
    range_without_um: f64,
    /// Range of the deviation along the line with the applied correction, µm.
    range_um: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Pass {
    #[serde(rename = "pass")]
    pub(crate) number: u32,
    pub(crate) targets: usize,
    not_settled: usize,
    pub(crate) lines: Vec<Line>,
}

impl Line {
    /// The lines of these targets, in the order of their first targets.
    pub(crate) fn of(targets: &[Target]) -> Vec<Self> {
        let mut lines: Vec<(&str, Vec<&Report>)> = Vec::new();
        for target in targets {
            let Some(name) = target.line.as_deref() else {
                continue;
            };
            match lines.iter_mut().find(|(found, _)| *found == name) {
                Some((_, reports)) => reports.push(&target.report),
                None => lines.push((name, vec![&target.report])),
            }
        }
        let of = |(name, reports): (&str, Vec<&Report>)| {
            let unit = direction(&reports);
            let range = |miss: fn(&Report) -> Option<Miss>| {
                let along = reports.iter().filter_map(|report| miss(report));
                let along = along.map(|miss| dot(&miss.position_um, &unit));
                let ends = along.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| {
                    [low.min(at), high.max(at)]
                });
                rounded((ends[1] - ends[0]).max(0.0))
            };
            Self {
                name: name.to_owned(),
                targets: reports.len(),
                range_without_um: range(|report| report.error),
                range_um: range(|report| report.residual),
            }
        };
        lines.into_iter().map(of).collect()
    }
}

/// Unit vector from the first to the last target of a line; zero if the two coincide.
fn direction(reports: &[&Report]) -> [f64; 3] {
    let ends = reports.first().zip(reports.last());
    let way = ends.map_or([0.0; 3], |(from, to)| {
        std::array::from_fn(|i| to.ideal_tip_mm[i] - from.ideal_tip_mm[i])
    });
    let length = dot(&way, &way).sqrt();
    way.map(|part| if length > 0.0 { part / length } else { 0.0 })
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Pass {
    pub(crate) fn text(&self) -> String {
        let of = |line: &Line| {
            let (before, after) = (line.range_without_um, line.range_um);
            format!("{} {before:.1} → {after:.1} µm", line.name)
        };
        let targets = format!("{} targets", self.targets);
        let mut items = vec![match self.not_settled {
            0 => targets,
            count => format!("{targets}, {count} not settled"),
        }];
        items.extend(self.lines.iter().map(of));
        let last = items.len() - 1;
        for item in &mut items[..last] {
            item.push(';');
        }
        wrapped(&format!("pass {}:", self.number), &items)
    }
}

pub(crate) struct Sheet {
    output: BufWriter<File>,
    file: String,
    /// Axes with columns in the table; `None`: the file holds JSON documents, one per line.
    table: Option<Vec<AxisName>>,
}

impl Sheet {
    /// Creates the file: JSON documents if its name ends in `.json`, otherwise a table.
    pub(crate) fn create(path: &Path, axes: &[AxisName]) -> Result<Self, SimError> {
        let file = path.display().to_string();
        let made = File::create(path).map_err(SimError::write(&file))?;
        let is_json = path.extension().is_some_and(|ending| ending == "json");
        let mut sheet =
            Self { output: BufWriter::new(made), file, table: (!is_json).then(|| axes.to_vec()) };
        if let Some(axes) = &sheet.table {
            let head = head(axes);
            sheet.line(&head)?;
        }
        Ok(sheet)
    }

    pub(crate) fn write(&mut self, target: &Target) -> Result<(), SimError> {
        let line = match &self.table {
            Some(axes) => row(axes, target),
            None => json(target),
        };
        self.line(&line)
    }

    fn line(&mut self, line: &str) -> Result<(), SimError> {
        let written = writeln!(self.output, "{line}").and_then(|()| self.output.flush());
        written.map_err(SimError::write(&self.file))
    }
}

fn head(axes: &[AxisName]) -> String {
    let mut cells: Vec<String> =
        ["pass", "target", "line", "settled", "stood_s"].map(str::to_owned).into();
    cells.extend(axes.iter().map(AxisName::to_string));
    cells.extend(axes.iter().map(|axis| match axis.kind() {
        AxisKind::Linear => format!("{axis}_um"),
        AxisKind::Rotary => format!("{axis}_urad"),
    }));
    for miss in ["error", "residual"] {
        let parts = ["x_um", "y_um", "z_um", "axis_urad"];
        cells.extend(parts.map(|part| format!("{miss}_{part}")));
    }
    cells.join(",")
}

fn row(axes: &[AxisName], target: &Target) -> String {
    let report = &target.report;
    let mut cells = vec![
        target.pass.to_string(),
        target.number.to_string(),
        quoted(target.line.as_deref().unwrap_or_default()),
        u8::from(target.settled).to_string(),
        number(target.stood_s),
    ];
    for values in [
        [&report.positions_mm, &report.positions_deg],
        [&report.correction_um, &report.correction_urad],
    ] {
        cells.extend(axes.iter().map(|axis| {
            let value = values[usize::from(axis.is_rotary())].get(axis);
            number(value.copied().unwrap_or_default())
        }));
    }
    for miss in [report.error, report.residual].into_iter().flatten() {
        cells.extend(miss.position_um.map(number));
        cells.push(number(miss.tool_axis_urad));
    }
    cells.join(",")
}

fn number(value: f64) -> String {
    format!("{value:.3}")
}

/// Quotes a table cell if it contains separators.
fn quoted(text: &str) -> String {
    if text.contains([',', ';', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(shift: i64, sender: Option<(u16, u16)>) -> Sample {
        Sample { shifts: vec![shift], sender }
    }

    /// An unchanged correction without new frames is not settled. A change restarts the wait. Without a sender at a
    /// barrier only the time counts.
    #[test]
    fn a_settled_correction_was_confirmed_while_unchanged() {
        let none = Duration::ZERO;
        let mut stability = Stability::since(Instant::now(), sample(5, Some((9, 1))));
        stability.update(sample(5, Some((9, 1))));
        assert!(!stability.is_settled(none));
        for sequence in 0..FRAMES {
            assert!(!stability.is_settled(none));
            stability.update(sample(5, Some((9, 2 + sequence))));
        }
        assert!(stability.is_settled(none));
        assert!(!stability.is_settled(Duration::MAX));
        stability.update(sample(6, Some((9, 99))));
        assert!(!stability.is_settled(none));
        stability.update(sample(6, None));
        assert!(stability.is_settled(none));
    }

    fn target(line: Option<&str>, x_mm: f64, error_um: f64, residual_um: f64) -> Target {
        let miss =
            |x: f64| Some(Miss { position_um: [x, 1000.0 * x_mm, -7.0], tool_axis_urad: 0.0 });
        Target {
            pass: 1,
            number: 1,
            line: line.map(str::to_owned),
            settled: true,
            stood_s: 0.2,
            report: Report {
                error: miss(error_um),
                residual: miss(residual_um),
                ideal_tip_mm: [x_mm, 5.0, 0.0],
                ..Report::default()
            },
        }
    }

    /// Ranges along X ignore deviations across X, constant deviations, and targets that belong to no line.
    #[test]
    fn ranges_are_along_the_line_from_its_lowest_to_its_highest() {
        let targets = [
            target(Some("a"), 0.0, 10.0, 10.0),
            target(None, 50.0, 900.0, 900.0),
            target(Some("a"), 50.0, 4.0, 10.5),
            target(Some("b"), 50.0, 1.0, 1.0),
            target(Some("a"), 100.0, 30.0, 9.0),
        ];
        let lines = Line::of(&targets);
        let line = |name: &str, targets, range_without_um, range_um| Line {
            name: name.to_owned(),
            targets,
            range_without_um,
            range_um,
        };
        assert_eq!(lines, [line("a", 3, 26.0, 1.5), line("b", 1, 0.0, 0.0)]);
    }

    #[test]
    fn a_name_with_a_comma_is_one_cell() {
        let axes = [AxisName::X, AxisName::C];
        let row = row(&axes, &target(Some("a, \"b\""), 1.0, 2.0, 3.0));
        assert!(row.starts_with("1,1,\"a, \"\"b\"\"\",1,0.200,0.000,0.000,"), "{row}");
        assert_eq!(head(&axes).split(',').count(), 5 + 4 + 8);
    }
}
