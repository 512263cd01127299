//! Program of the simulated machine: the moves of a CSV file, and the lines along which the machine is measured.
//!
//! The moves run one by one on request.

use std::{
    path::Path as FilePath,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use volcomp_document::CsvTable;
use volcomp_focas::simulator::Motion;
use volcomp_port::simulated::{Move, Path};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, PerChannel};

use crate::error::{SimError, letters, outside};

/// Default feed of a row, mm/min or deg/min.
const DEFAULT_FEED_PER_MIN: f64 = 2000.0;

pub(crate) struct Program {
    pub(crate) moves: Vec<Move>,
    pub(crate) stops: Vec<Stop>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Stop {
    /// A target that is measured, with the name of its measurement line; `None` if the program has no column `line`.
    Target(Option<String>),
    /// An intermediate point, which is not measured: its cell in the column `line` is empty.
    OnTheWay,
}

impl Program {
    /// Reads a program into moves in mm and rad. An axis without a column stays at its position in `stands` (mm, deg).
    pub(crate) fn read(
        file: &FilePath,
        axes: &[AxisName],
        stands: &[f64],
    ) -> Result<Self, SimError> {
        let name = file.display().to_string();
        let text = std::fs::read_to_string(file)
            .map_err(|source| SimError::Read { file: name.clone(), source })?;
        let table = CsvTable::parse(&name, &text)?;
        let letters_of_axes: Vec<String> = axes.iter().map(AxisName::to_string).collect();
        let mut known: Vec<&str> = letters_of_axes.iter().map(String::as_str).collect();
        known.extend(["feed", "dwell_s", "line"]);
        if let Some(unknown) = table.names_besides(&known).first() {
            let message = format!(
                "found the column `{unknown}`, expected {}, feed, dwell_s or line",
                letters(axes)
            );
            return Err(table.header_error(message).into());
        }
        let columns = letters_of_axes.iter().map(|name| table.column(name));
        let columns = columns.collect::<Result<Vec<_>, _>>()?;
        let (feeds, dwells) = (table.column("feed")?, table.column("dwell_s")?);
        let of_lines = table.column("line")?;
        let mut program = Self { moves: Vec::new(), stops: Vec::new() };
        let mut coordinates: Vec<Vec<f64>> = Vec::new();
        for row in table.rows() {
            let mut to = stands.to_vec();
            for (coordinate, column) in to.iter_mut().zip(&columns) {
                if let Some(column) = column {
                    *coordinate = row.cell(*column).number()?;
                }
            }
            let feed_per_min = feeds.map_or(Ok(DEFAULT_FEED_PER_MIN), |column| {
                let cell = row.cell(column);
                match cell.number()? {
                    feed if feed > 0.0 => Ok(feed),
                    feed => Err(cell.error(format!("found {feed}, expected a positive number"))),
                }
            })?;
            let dwell = dwells.map_or(Ok(Duration::ZERO), |column| {
                let (cell, seconds) = (row.cell(column), row.cell(column).number()?);
                let wrong = |_| cell.error(format!("found {seconds}, expected a time, s"));
                Duration::try_from_secs_f64(seconds).map_err(wrong)
            })?;
            let line = of_lines.map(|column| row.cell(column).text().trim());
            program.stops.push(match line {
                Some("") => Stop::OnTheWay,
                line => Stop::Target(line.map(str::to_owned)),
            });
            program.moves.push(Move {
                to: inside(axes, &to),
                // Feed in mm/min or deg/min; converted once the start of the move is known.
                feed_per_s: feed_per_min,
                dwell,
            });
            coordinates.push(to);
        }
        if program.moves.is_empty() {
            let message = "found no rows, expected at least one position";
            return Err(table.header_error(message).into());
        }
        let before = coordinates.iter().cycle().skip(coordinates.len() - 1);
        for (step, (from, to)) in program.moves.iter_mut().zip(before.zip(&coordinates)) {
            step.feed_per_s = feed_per_s(axes, from, to, step.feed_per_s);
        }
        Ok(program)
    }
}

/// Converts coordinates in mm and deg to mm and rad.
fn inside(axes: &[AxisName], coordinates: &[f64]) -> PerChannel<f64> {
    let mut values = PerChannel::ZERO;
    for ((value, axis), coordinate) in values.iter_mut().zip(axes).zip(coordinates) {
        *value = Displacement::from_coordinate(axis.kind(), *coordinate).mm_or_rad();
    }
    values
}

/// The feed of a move in mm/s, or in rad/s if only rotary axes move.
fn feed_per_s(axes: &[AxisName], from: &[f64], to: &[f64], feed_per_min: f64) -> f64 {
    let mut moved = axes.iter().zip(from.iter().zip(to));
    let slides = moved.any(|(axis, (from, to))| !axis.is_rotary() && from != to);
    let kind = if slides { AxisKind::Linear } else { AxisKind::Rotary };
    Displacement::from_coordinate(kind, feed_per_min / 60.0).mm_or_rad()
}

/// Progress through a program. Times are motion times, without emergency stops.
pub(crate) struct Walk {
    pub(crate) stops: Vec<Stop>,
    /// Minimum time at rest at the end of each move.
    pub(crate) dwells: Vec<Duration>,
    /// The moves without their dwell times.
    path: Path,
    leg: Mutex<Leg>,
}

/// A section of the path from the end of one move to the end of the next.
#[derive(Clone, Copy)]
struct Leg {
    left: Duration,
    /// Path times at the two ends of the section.
    from: Duration,
    to: Duration,
}

impl Walk {
    /// Creates the progress of a machine that is at rest at the end of the first move.
    pub(crate) fn new(program: Program, acceleration: f64) -> Self {
        let dwells = program.moves.iter().map(|step| step.dwell).collect();
        let passing = |step: Move| Move { dwell: Duration::ZERO, ..step };
        let moves: Vec<Move> = program.moves.into_iter().map(passing).collect();
        let path = Path::new(&moves, acceleration);
        let first = path.arrival(0).unwrap_or_default();
        Self {
            stops: program.stops,
            dwells,
            path,
            leg: Mutex::new(Leg { left: Duration::ZERO, from: first, to: first }),
        }
    }

    pub(crate) fn motion(self: &Arc<Self>, axes: &[AxisName]) -> Motion {
        let (walk, axes) = (Arc::clone(self), axes.to_vec());
        Arc::new(move |moved_for| outside(&axes, &walk.path.at(walk.leg().reached(moved_for))))
    }

    /// Starts the move `index`, counted from 0; `moved_for` is the present motion time.
    pub(crate) fn go_to(&self, index: usize, moved_for: Duration) {
        let mut leg = self.leg();
        let at = leg.reached(moved_for);
        let to = self.path.arrival(index).unwrap_or(at);
        *leg = Leg {
            left: moved_for,
            // After the last move the path starts again.
            from: if at <= to { at } else { Duration::ZERO },
            to,
        };
    }

    pub(crate) fn has_arrived(&self, moved_for: Duration) -> bool {
        let leg = self.leg();
        leg.reached(moved_for) == leg.to
    }

    fn leg(&self) -> MutexGuard<'_, Leg> {
        self.leg.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Leg {
    fn reached(&self, moved_for: Duration) -> Duration {
        let gone = moved_for.saturating_sub(self.left);
        self.from.saturating_add(gone).min(self.to)
    }
}
