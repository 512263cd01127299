//! Constant correction through work offsets: the mean over all positions where a program cuts, or over the measured errors of a row of
//! balls.

use std::io::{BufRead, Write};

use volcomp_model::{
    Lengths,
    kinematics::nalgebra::{Matrix3, Vector3},
};

use crate::{
    Job, NcError,
    control::{Control, Dialect},
    coordinates::{Axes, Frame, LETTERS, each},
    correction::{Bounds, Corrector},
    flow::{OLine, o_line},
    line::{NewWord, Script, end_of_added, leader_of, split_lines},
    modal::{NUMBERED, SYSTEMS, name_of_offset},
    motion::{ExecutedMotion, MotionReceiver, Path, at_height},
    notes::Note,
    number::Number,
    program::run_in_parallel,
    setup::SetUp,
};

/// Mean correction over the positions where a program cuts with one work offset: the ends of lines and arcs, and half the depth of holes.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
#[non_exhaustive]
pub struct Average {
    /// The work offset, `G54` to `G59.3`.
    #[cfg_attr(feature = "schema", serde(rename = "work_offset"))]
    pub system: String,
    /// Number of positions over which the error is averaged.
    pub places: u64,
    /// Error of the machine at the zero of the work offset; `None` if it rounds to zero.
    #[cfg_attr(feature = "schema", serde(skip))]
    pub off_at_zero: Option<Note>,
    #[cfg_attr(feature = "schema", serde(skip))]
    pub(crate) off_at_zero_mm: [f64; 3],
    /// Mean correction of X, Y and Z, mm; 0 for an axis that is not corrected.
    pub mean_mm: [f64; 3],
    /// Maximum and RMS of the deviations that remain after the mean correction, µm.
    pub left_um: [f64; 2],
    /// Maximum and RMS of the deviations without correction, µm.
    pub before_um: [f64; 2],
    /// The work offset plus the mean correction, mm in machine coordinates, rounded to the decimals of the job.
    pub offset_mm: [f64; 3],
}

/// A measured error of the machine: deviation of the tip along a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Unit direction, in workpiece axes.
    pub direction: [f64; 3],
    /// Actual minus nominal tip position along the direction, mm.
    pub error_mm: f64,
}

/// Data that the mean correction is computed from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MeanOf<'a> {
    /// Corrections of the machine model at the positions where the program cuts.
    Places,
    /// Measured errors, by least squares; directions without measurement stay uncorrected.
    Readings(&'a [Reading]),
}

/// Tolerance, mm, within which the work offset must move a position by the mean correction.
const REACHED_MM: f64 = 1e-6;

/// Minimum eigenvalue, relative to the largest, of a direction that counts as measured.
const NOT_MEASURED: f64 = 1e-6;

/// Offsets of X, Y and Z that compensate the mean error of the readings (least squares), mm, and the maximum and RMS of
/// the readings, first with and then without these offsets, µm. `None` for a machine with rotary axes.
fn mean_of(readings: &[Reading], corrector: &Corrector) -> Option<([f64; 3], [[f64; 2]; 2])> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for reading in readings {
        let along = Vector3::from(reading.direction);
        normal += along * along.transpose();
        right += along * reading.error_mm;
    }
    let of = normal.symmetric_eigen();
    let least = NOT_MEASURED * of.eigenvalues.max();
    let mut mean = Vector3::zeros();
    for (value, along) in of.eigenvalues.iter().zip(of.eigenvectors.column_iter()) {
        if *value > least {
            mean += along * (along.dot(&right) / value);
        }
    }
    let [by, corrected] = corrector.offsets_against_mm(mean.into())?;
    let sums = [corrected.into(), Vector3::zeros()].map(|by| {
        let mut sums = Sums::default();
        for reading in readings {
            let left = reading.error_mm - by.dot(&Vector3::from(reading.direction));
            sums.take([left, 0.0, 0.0]);
        }
        sums.um()
    });
    Some((by, sums))
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    places: u64,
    sum: [f64; 3],
    lengths: Lengths,
}

impl Sums {
    fn take(&mut self, of: [f64; 3]) {
        self.places += 1;
        self.lengths.take(&of.into());
        for (sum, of) in self.sum.iter_mut().zip(of) {
            *sum += of;
        }
    }

    /// Maximum and root mean square length of the errors, µm.
    fn um(&self) -> [f64; 2] {
        [1e3 * self.lengths.max(), 1e3 * self.lengths.rms()]
    }
}

fn with_rotary_axes() -> NcError {
    NcError::not_compensated(
        1,
        "a mean correction needs a machine without rotary axes: otherwise it depends on the angle",
    )
}

/// Writes the program with lines (G10 L2, or G10 L20 for G54.1 P) at its start that set its work offsets to those of
/// the set-up plus the mean correction. Nothing else changes.
///
/// # Errors
/// The program cannot be executed; the machine has rotary axes; the program sets work offsets itself or uses one that the set-up does not
/// state; positions are unknown because the set-up does not state the start position.
pub fn average(
    program: &[u8],
    output: &mut impl Write,
    job: Job<'_>,
    of: MeanOf<'_>,
) -> Result<Vec<Average>, NcError> {
    if !job.corrector.only_linear {
        return Err(with_rotary_axes());
    }
    let is_printer = job.setup.control().is_some_and(Control::is_printer);
    if job.dialect != Dialect::Rs274 || is_printer {
        return Err(NcError::not_compensated(
            1,
            "a mean correction is written into work offsets by G10, which only RS-274 controls other than printers have",
        ));
    }
    let mut sums = vec![Sums::default(); SYSTEMS];
    // For each work offset, the error at its zero; `None` if the program never cuts from the zero that the set-up
    // states.
    let mut off_mm = [None; SYSTEMS].to_vec();
    at_places(program, job, None, |corrector, place| {
        if place.from_stated_zero {
            let off = || corrector.off_at_zero_mm(&place.frame.of_offset());
            off_mm[place.system].get_or_insert_with(off);
        }
        sums[place.system].take(place.delta);
        Ok(())
    })?;
    let measured = match of {
        MeanOf::Places => None,
        MeanOf::Readings(readings) => {
            Some(mean_of(readings, job.corrector).ok_or_else(with_rotary_axes)?)
        }
    };
    let mean = |of: &Sums| match &measured {
        _ if of.places == 0 => [0.0; 3],
        None => of.sum.map(|sum| sum / of.places as f64),
        Some((mean, _)) => *mean,
    };
    let means: Vec<[f64; 3]> = sums.iter().map(mean).collect();
    if measured.is_some() {
        // With readings, the error at each zero is the mean error of the readings.
        for (off, mean) in off_mm.iter_mut().zip(&means) {
            *off = off.map(|_| mean.map(|mm| -mm));
        }
    }
    let mut left = vec![Sums::default(); SYSTEMS];
    let bounds = Bounds::new(job.corrector, job.limit);
    let moved = job.setup.with_offsets_moved(&means);
    at_places(program, job, Some(&moved), |_, place| {
        let mean = means[place.system];
        let lacks = |axis: &usize| (place.moved[*axis] - mean[*axis]).abs() > REACHED_MM;
        if let Some(axis) = (0..3).find(lacks) {
            let letter = char::from(LETTERS[axis]);
            let offset = name_of_offset(place.system);
            let what = format!(
                "the mean correction of {offset} does not reach {letter} here, because its position, or the start of its G91 move or its G92 zero, was not programmed in G90 under {offset}: program {letter} there first"
            );
            return Err(NcError::not_compensated(place.line, &what));
        }
        let by = each(|axis| mean.get(axis).copied().unwrap_or(0.0));
        if let Some(violation) = bounds.violation(&[true; 9], &place.at, &by) {
            return Err(NcError::OutOfBounds { line: place.line, violation });
        }
        left[place.system].take(std::array::from_fn(|i| place.delta[i] - mean[i]));
        Ok(())
    })?;
    let (mut averages, mut offsets) = (Vec::new(), Vec::new());
    let unit = job.setup.modal.unit_mm;
    for system in 0..SYSTEMS {
        let of = &sums[system];
        if of.places == 0 {
            continue;
        }
        let Some(offset) = job.setup.offset(system) else {
            let what = format!(
                "the set-up file does not state the work offset {}, which receives the mean correction",
                name_of_offset(system)
            );
            return Err(NcError::not_compensated(1, what));
        };
        let words: [Option<Number>; 3] = std::array::from_fn(|i| {
            let value = (offset[i] + means[system][i]) / unit;
            Number::nearest(value, job.decimals.of(i, unit))
        });
        averages.push(Average {
            system: name_of_offset(system),
            places: of.places,
            off_at_zero: off_mm[system].and_then(|off| Note::off_at_zero(system, off)),
            off_at_zero_mm: off_mm[system].unwrap_or_default(),
            mean_mm: means[system],
            left_um: measured.map_or_else(|| left[system].um(), |(_, [left, _])| left),
            before_um: measured.map_or_else(|| of.um(), |(_, [_, before])| before),
            offset_mm: std::array::from_fn(|i| {
                // A value converted from inches to mm has one more decimal.
                let decimals = job.decimals.of(i, unit) + u8::from(unit != 1.0);
                let power = 10_f64.powi(i32::from(decimals));
                let mm = |word: Number| (unit * word.value() * power).round() / power;
                words[i].map_or(f64::NAN, mm)
            }),
        });
        offsets.push((system, words));
    }
    write(program, output, &offsets, unit)?;
    Ok(averages)
}

struct CutPlace {
    line: usize,
    system: usize,
    /// Machine coordinates, mm.
    at: Axes,
    delta: [f64; 3],
    /// Displacement of the cutting position, mm, in a run under the set-up with the mean corrections.
    moved: [f64; 3],
    frame: Frame,
    from_stated_zero: bool,
}

/// Executes the program in parallel with a run under the set-up `moved`. Calls `take` with each position at which the program cuts, and the
/// correction of the active tool there.
fn at_places(
    program: &[u8],
    job: Job<'_>,
    moved: Option<&SetUp>,
    mut take: impl FnMut(&Corrector, CutPlace) -> Result<(), NcError>,
) -> Result<(), NcError> {
    let mut corrector = job.corrector.clone();
    corrector.start_at(&job.setup.start().0);
    let (mut own, mut again) = (program, program);
    let mut programs: Vec<(&mut (dyn BufRead + Send), _)> = vec![(&mut own, job.setup)];
    if let Some(setup) = moved {
        programs.push((&mut again, setup));
    }
    let limits = (Dialect::Rs274, job.most_blocks);
    let (machine, temperatures) = (&job.corrector.machine, &job.corrector.temperatures);
    let (found, failed) = run_in_parallel(machine, temperatures, limits, programs, |motions| {
        while let Ok(made) = motions[0].recv() {
            let beside = match motions.get(1).map(MotionReceiver::recv) {
                Some(Ok(beside)) if beside.line == made.line => Some(beside),
                Some(_) => {
                    let what = "the program reads its work offsets (such as #5221), so the mean correction in them changes its motions";
                    return Err(NcError::not_compensated(made.line, what));
                }
                None => None,
            };
            corrector.take_tool(&made.tool)?;
            // The correction is constant: the drives move as programmed.
            let mut from = made.motion.from;
            let mut go = |corrector: &mut Corrector, to: &Axes| {
                corrector.move_uncorrected(to, [&from, to]);
                from = *to;
            };
            let from_unknown = &made.motion.arrives_from_unknown;
            let hole = heights_of_hole(&made);
            let delta = if let Some([plane, half, bottom]) = &hole {
                // The hole is cut on the way down from the plane R.
                corrector.begin_motion(from_unknown);
                go(&mut corrector, plane);
                go(&mut corrector, half);
                let delta = corrector.at(half).delta;
                go(&mut corrector, bottom);
                go(&mut corrector, &made.motion.to);
                delta
            } else {
                for to in made.motion.stops() {
                    corrector.begin_motion(from_unknown);
                    go(&mut corrector, to);
                }
                corrector.at(&made.motion.to).delta
            };
            let Some(at) = cuts_at(&made) else { continue };
            let moved_at = beside.as_ref().and_then(cuts_at).unwrap_or(at);
            let stated = job.setup.offset(made.system);
            if stated.is_some_and(|stated| made.frame.work[..3] != stated[..3]) {
                return Err(NcError::not_compensated(
                    made.line,
                    "the program has set its work offset itself (G10 L2, L20): the mean correction would be lost there",
                ));
            }
            if !made.known {
                return Err(NcError::not_compensated(
                    made.line,
                    "the positions of X, Y and Z are unknown here: state [start] in the set-up file",
                ));
            }
            let place = CutPlace {
                line: made.line,
                system: made.system,
                at,
                delta: std::array::from_fn(|i| delta[i]),
                moved: std::array::from_fn(|i| moved_at[i] - at[i]),
                from_stated_zero: made.cuts_from_stated_zero,
                frame: made.frame,
            };
            take(&corrector, place)?;
        }
        Ok(())
    })?;
    found.and(failed.map_or(Ok(()), Err))
}

/// Position where a motion cuts, in machine coordinates: its end, or half-way down a hole; `None` if it does not cut.
fn cuts_at(made: &ExecutedMotion) -> Option<Axes> {
    let motion = &made.motion;
    match motion.path {
        _ if motion.in_machine => None,
        Path::Line | Path::Arc(_) => Some(motion.to),
        Path::Hole { .. } => heights_of_hole(made).map(|[_, half, _]| half),
        Path::Rapid | Path::Home { .. } | Path::Spline | Path::Other => None,
    }
}

/// Positions at the plane R, half-way down and at the bottom of a hole, in machine coordinates; `None` for other motions.
fn heights_of_hole(made: &ExecutedMotion) -> Option<[Axes; 3]> {
    let Path::Hole { bottom, clearance, depth } = made.motion.path else {
        return None;
    };
    let hole = made.frame.to_program(&made.motion.to);
    let heights = [clearance, 0.5 * (bottom + clearance), bottom];
    Some(heights.map(|height| made.frame.to_machine(&at_height(&hole, depth, height))))
}

/// Writes the program with lines that set its work offsets, after the leading percent sign, program number and comments.
fn write(
    program: &[u8],
    output: &mut impl Write,
    offsets: &[(usize, [Option<Number>; 3])],
    unit_mm: f64,
) -> Result<(), NcError> {
    let (leader, program) = program.split_at(leader_of(program));
    output.write_all(leader)?;
    let mut lines = split_lines(program).into_iter().peekable();
    let mut end: &[u8] = b"\n";
    while let Some((line, of_line)) = lines.next_if(|(line, end)| {
        let text = line.trim_ascii();
        let is_comment = text.starts_with(b"(") && text.ends_with(b")");
        // In FANUC programs only comments and a percent sign may precede the program number.
        let is_number = matches!(o_line(text), Some(OLine::Program(_)));
        !end.is_empty() && (text.is_empty() || text.starts_with(b"%") || is_comment || is_number)
    }) {
        output.write_all(line)?;
        output.write_all(of_line)?;
        end = end_of_added(of_line).unwrap_or(end);
    }
    let mut text = Vec::new();
    if !offsets.is_empty() {
        // Modes of the inserted lines: in incremental mode, left active by an earlier program, G10 would add to the stored offsets.
        let modes: &[u8] = if unit_mm == 1.0 { b"G21 G90" } else { b"G20 G90" };
        text.extend_from_slice(modes);
        text.extend_from_slice(end);
    }
    for (system, words) in offsets {
        let code = match system.checked_sub(NUMBERED) {
            Some(place) => format!("G10 L20 P{}", place + 1),
            None => format!("G10 L2 P{}", system + 1),
        };
        text.extend_from_slice(code.as_bytes());
        for (letter, number) in LETTERS.into_iter().zip(words) {
            if let Some(number) = number {
                let word = NewWord::plain((letter, *number));
                Script::default().write_word(&word, &mut text);
            }
        }
        text.extend_from_slice(end);
    }
    output.write_all(&text)?;
    for (line, end) in lines {
        output.write_all(line)?;
        output.write_all(end)?;
    }
    Ok(())
}
