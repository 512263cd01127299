//! Builds a map from a field: checks the request, converts it to whole steps, finds the smallest grid within the error bound, and evaluates
//! the error of the map.

use volcomp_guard::{ceiling, protocol::Layout};
use volcomp_model::{ModelError, halton};
use volcomp_vocabulary::{AxisName, Direction};

use crate::map::{
    GRID_AXES, HEADER_WORDS, Header, Lines, MAX_POSITION_STEPS, MAX_WORDS, Map, MapError, OUTPUTS,
    Position, SCALES,
};

/// Correction over the work space, added to each output, mm. It depends on the coordinates of the grid axes (mm or deg) and on the
/// direction of approach of each (`None`: mean of both).
pub trait Field {
    /// Correction of each output, mm.
    fn correction_mm(
        &self,
        at: &[f64; GRID_AXES],
        directions: &[Option<Direction>; GRID_AXES],
    ) -> [f64; OUTPUTS];

    /// Whether the correction depends on the direction of approach.
    fn is_bidirectional(&self) -> bool {
        false
    }
}

impl<F: Fn(&[f64; GRID_AXES]) -> [f64; OUTPUTS]> Field for F {
    fn correction_mm(
        &self,
        at: &[f64; GRID_AXES],
        _: &[Option<Direction>; GRID_AXES],
    ) -> [f64; OUTPUTS] {
        self(at)
    }
}

/// An input axis of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridAxis {
    /// Letter of the axis, linear or rotary.
    pub name: AxisName,
    /// Travel, mm or deg.
    pub travel: [f64; 2],
    /// Resolution of the position in the control's program, mm or deg.
    pub step: f64,
}

/// An axis corrected by a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// Name of the linear axis.
    pub name: AxisName,
    /// Resolution of the axis's correction, mm.
    pub step_mm: f64,
    /// Maximum correction, mm; at most 2 mm, the maximum of the guard.
    pub limit_mm: f64,
}

/// Requirements on a map: axes, error bound and memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// Input axes, one to five.
    pub axes: Vec<GridAxis>,
    /// Corrected axes, one to three.
    pub outputs: Vec<Output>,
    /// Maximum error of the map relative to the field, mm.
    pub within_mm: f64,
    /// Memory of the control for one map, words.
    pub words: usize,
    /// Number of the map, 1 to 65535.
    pub counter: u16,
    /// Identifier of the model, see [`Header::model`].
    pub model: u32,
}

/// A map with its error.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// The map to be sent to a control.
    pub map: Map,
    /// Error at dense samples on and between the lines, in both directions of approach.
    pub misfit: Misfit,
    /// Maximum slope of a correction along an axis of the grid, mm per mm or deg.
    pub steepest: f64,
}

impl Request {
    /// Travel of each axis, mm or deg.
    pub(crate) fn travels(&self) -> Vec<[f64; 2]> {
        self.axes.iter().map(|axis| axis.travel).collect()
    }
}

/// Reasons why a map cannot be built.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TablesError {
    /// The model cannot be evaluated.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Lines and values do not form a valid map.
    #[error(transparent)]
    Map(#[from] MapError),
    #[error("axis {axis} is rotary: a map corrects linear axes only")]
    Rotary { axis: AxisName },
    #[error(
        "axis {axis} has a modulo: outside its travel of {lower} to {upper} a map holds the value of its end, where the machine \
         has that of the turned position; expected an axis that does not roll over, or a machine file without the modulo where \
         the control reports positions within the travel only"
    )]
    RollsOver { axis: AxisName, lower: f64, upper: f64 },
    /// A step, bound, limit or travel is out of its range, or a step is not a multiple of one millionth.
    #[error("{what} is {found}, expected {expected}")]
    Number { what: String, found: f64, expected: &'static str },
    #[error("the correction of {axis} is {found_um:.1} µm {at}, expected at most {limit_um} µm")]
    BeyondLimit { axis: AxisName, found_um: f64, limit_um: f64, at: String },
    #[error(
        "no grid keeps {within_um} µm: the steps of the values alone leave {rounding_um:.3} µm, and a reversal that is not the same \
         everywhere {reversal_um:.3} µm"
    )]
    Unreachable { within_um: f64, rounding_um: f64, reversal_um: f64 },
    #[error(
        "{within_um} µm need {} ({lines}), expected at most {words}, the available memory{}",
        needed.map_or_else(|| "more words than a map can have, 32767".to_owned(), |needed| format!("{needed} words for a map")),
        reached_um.map_or_else(String::new, |um| format!(": with this many the error is {um:.3} µm"))
    )]
    Memory {
        within_um: f64,
        /// Size of the map, words; `None`: more than 32767.
        needed: Option<usize>,
        lines: String,
        words: usize,
        /// Error of the best map that fits into the memory; `None` if none fits.
        reached_um: Option<f64>,
    },
}

/// Euclidean norm of the values of all outputs, in their unit.
pub(crate) fn norm(values: &[f64; OUTPUTS]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Points of a regular lattice with coordinates from 0 to 1, ends included: up to `most` points
/// along each of `axes` axes; the first axis varies fastest.
pub(crate) fn lattice(axes: usize, most: usize) -> impl Iterator<Item = [f64; GRID_AXES]> {
    // Fewer points per axis if there are many axes.
    let places = if axes > 3 { most.min(5) } else { most };
    let count = (0..axes).fold(1, |count, _| count * places);
    (0..count).map(move |number| {
        let mut shares = [0.0; GRID_AXES];
        let mut rest = number;
        for share in shares.iter_mut().take(axes) {
            *share = (rest % places) as f64 / (places - 1) as f64;
            rest /= places;
        }
        shares
    })
}

/// All combinations of directions of approach along these axes, if the field depends on them.
pub(crate) fn directions_of<F: Field>(
    field: &F,
    axes: usize,
) -> impl Iterator<Item = [Option<Direction>; GRID_AXES]> + use<F> {
    let bidirectional = field.is_bidirectional();
    let count = if bidirectional { 1 << axes } else { 1 };
    (0..count).map(move |number: usize| {
        core::array::from_fn(|axis| {
            (bidirectional && axis < axes).then(|| Direction::BOTH[number >> axis & 1])
        })
    })
}

/// Euclidean norm of the difference of two corrections, in the unit of their values.
pub(crate) fn distance(one: [f64; OUTPUTS], other: [f64; OUTPUTS]) -> f64 {
    norm(&core::array::from_fn(|output| one[output] - other[output]))
}

/// A request converted to whole steps.
struct ScaledRequest {
    grid: Layout,
    outputs: Layout,
    /// First position and travel, in steps, and the step in millionths of a mm or deg, for each axis of the grid.
    travels: Vec<(i32, i32, u32)>,
    output_step_nm: [u32; OUTPUTS],
    limits: [f64; OUTPUTS],
    scale: u16,
    reversal: [[i16; OUTPUTS]; GRID_AXES],
}

/// Converts a number to whole millionths of its unit. Errors: a number that is not whole or out of range.
fn millionths(what: String, found: f64) -> Result<u32, TablesError> {
    let number = (found * 1e6).round();
    let is_whole = (number - found * 1e6).abs() <= 1e-6 * number;
    if !((1.0..=2e9).contains(&number) && is_whole) {
        return Err(TablesError::Number {
            what,
            found,
            expected: "whole millionths of a mm or deg, 0.000001 to 2000",
        });
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within 1 to 2e9")]
    Ok(number as u32)
}

/// Rounds to a whole number; 0 for NaN.
#[expect(clippy::cast_possible_truncation, reason = "it saturates")]
fn nearest_i32(number: f64) -> i32 {
    number.round() as i32
}

#[expect(clippy::cast_possible_truncation, reason = "it saturates")]
fn nearest_i16(number: f64) -> i16 {
    number.round() as i16
}

impl ScaledRequest {
    fn new(request: &Request) -> Result<Self, TablesError> {
        let layout = |names: Vec<AxisName>, most: usize| {
            if names.len() > most {
                return Err(MapError::Axes);
            }
            Layout::of(names).map_err(|_| MapError::Axes)
        };
        let grid = layout(request.axes.iter().map(|axis| axis.name).collect(), GRID_AXES)?;
        let outputs = layout(request.outputs.iter().map(|o| o.name).collect(), OUTPUTS)?;
        let mut output_step_nm = [0; OUTPUTS];
        let mut limits = [0.0; OUTPUTS];
        for (place, output) in request.outputs.iter().enumerate() {
            if output.name.is_rotary() {
                return Err(TablesError::Rotary { axis: output.name });
            }
            output_step_nm[place] = millionths(format!("step of {}", output.name), output.step_mm)?;
            let most = (output.step_mm * 32767.0).min(ceiling::LIMIT.0);
            if !(output.limit_mm > 0.0 && output.limit_mm <= most) {
                return Err(TablesError::Number {
                    what: format!("limit of {} (mm)", output.name),
                    found: output.limit_mm,
                    expected: "above 0, at most 32767 steps of the output and 2 mm",
                });
            }
            limits[place] = output.limit_mm;
        }
        let bound = request.within_mm;
        if !(bound > 0.0 && bound.is_finite()) {
            return Err(TablesError::Number {
                what: "bound (mm)".to_owned(),
                found: bound,
                expected: "a number above 0",
            });
        }
        let mut travels = Vec::new();
        for axis in &request.axes {
            let step = millionths(format!("step of the position of {}", axis.name), axis.step)?;
            let [low, high] = axis.travel.map(|end| end / axis.step);
            let most = f64::from(MAX_POSITION_STEPS) / 2.0;
            // Written so that NaN is rejected too.
            if !(low < high && low >= -most && high <= most) {
                return Err(TablesError::Number {
                    what: format!("travel of {}, in steps of its position,", axis.name),
                    found: high - low,
                    expected: "a low end below a high one, both within 500 million steps",
                });
            }
            let first = nearest_i32(low.floor());
            travels.push((first, (nearest_i32(high.ceil()) - first).max(1), step));
        }
        Ok(Self {
            grid,
            outputs,
            travels,
            output_step_nm,
            limits,
            scale: 1,
            reversal: [[0; OUTPUTS]; GRID_AXES],
        })
    }

    fn step_mm(&self, output: usize) -> f64 {
        f64::from(self.output_step_nm[output]) * 1e-6
    }

    fn is_beyond(&self, output: usize, found_mm: f64) -> bool {
        found_mm.is_nan() || found_mm.abs() > self.limits[output]
    }

    fn coordinate(&self, axis: usize, steps: f64) -> f64 {
        let (first, _, step) = self.travels[axis];
        (f64::from(first) + steps) * f64::from(step) * 1e-6
    }

    /// Samples the work space, and returns the largest correction of each output, mm. Errors: a correction beyond its limit.
    fn survey(&self, request: &Request, field: &impl Field) -> Result<[f64; OUTPUTS], TablesError> {
        let mut largest = [0.0_f64; OUTPUTS];
        for shares in lattice(self.travels.len(), 9) {
            let at = self.place(&shares);
            for directions in directions_of(field, self.travels.len()) {
                let found = field.correction_mm(&at, &directions);
                for (output, requested) in request.outputs.iter().enumerate() {
                    if self.is_beyond(output, found[output]) {
                        let axes = request.axes.iter().zip(&at);
                        let at: Vec<String> =
                            axes.map(|(axis, at)| format!("{}={at}", axis.name)).collect();
                        return Err(TablesError::BeyondLimit {
                            axis: requested.name,
                            found_um: found[output] * 1e3,
                            limit_um: self.limits[output] * 1e3,
                            at: format!("at {}", at.join(",")),
                        });
                    }
                    largest[output] = largest[output].max(found[output].abs());
                }
            }
        }
        Ok(largest)
    }

    fn place(&self, shares: &[f64; GRID_AXES]) -> [f64; GRID_AXES] {
        core::array::from_fn(|axis| match self.travels.get(axis) {
            Some((_, steps, _)) => self.coordinate(axis, shares[axis] * f64::from(*steps)),
            None => 0.0,
        })
    }

    /// Chooses the largest scale (parts per step) at which the values fit into 16 bits with a margin of 10 %.
    fn choose_scale(&mut self, largest: [f64; OUTPUTS]) {
        let mut scale = SCALES[0];
        let steps = (0..self.outputs.count()).map(|output| largest[output] / self.step_mm(output));
        let most = 1.1 * steps.fold(0.0, f64::max);
        while scale > 1 && most * f64::from(scale) > 32767.0 {
            scale /= 2;
        }
        self.scale = scale;
    }

    /// Maximum error by rounding the values and the interpolation along each axis, mm.
    fn rounding_mm(&self) -> f64 {
        let roundings = 0.5 * (1.0 + self.travels.len() as f64);
        let steps = (0..self.outputs.count()).map(|output| self.step_mm(output).powi(2));
        roundings * steps.sum::<f64>().sqrt() / f64::from(self.scale)
    }

    /// Stores half the reversal value of each axis: the middle of its range over the work space. Returns the sum over
    /// all axes of the largest deviation from this middle, mm.
    fn store_reversals(&mut self, field: &impl Field) -> f64 {
        if !field.is_bidirectional() {
            return 0.0;
        }
        let axes = self.travels.len();
        let mut left = 0.0;
        for axis in 0..axes {
            let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; OUTPUTS];
            for shares in lattice(axes, 9) {
                let at = self.place(&shares);
                let mut directions = [None; GRID_AXES];
                directions[axis] = Some(Direction::Positive);
                let forward = field.correction_mm(&at, &directions);
                directions[axis] = Some(Direction::Negative);
                let backward = field.correction_mm(&at, &directions);
                for (output, [low, high]) in range.iter_mut().enumerate() {
                    let half = 0.5 * (forward[output] - backward[output]);
                    *low = low.min(half);
                    *high = high.max(half);
                }
            }
            let mut varying = [0.0; OUTPUTS];
            for output in 0..self.outputs.count() {
                let [low, high] = range[output];
                let parts = 0.5 * (low + high) / self.step_mm(output) * f64::from(self.scale);
                self.reversal[axis][output] = nearest_i16(parts);
                varying[output] = 0.5 * (high - low);
            }
            left += norm(&varying);
        }
        left
    }

    /// Spreads `count` lines over the travel of an axis. A control interpolates at a whole number
    /// of places per pitch, so the last line may be slightly outside the travel.
    fn lines(&self, axis: usize, count: u16) -> Lines {
        let (origin, steps, step_millionths) = self.travels[axis];
        let gaps = i32::from(count) - 1;
        let pitch = (steps + gaps - 1) / gaps;
        let mut best = (i32::MAX, 1, 1);
        // Tries numbers of places per pitch, from the maximum of a control down to a quarter of it,
        // for one with which the last line is at the end of travel.
        let least = pitch.div_euclid(32767) + 1;
        for part in (least..=(pitch / 8192).clamp(least, 32767)).take(2000) {
            let parts = (pitch + part - 1) / part;
            let over = part * parts - pitch;
            if over < best.0 {
                best = (over, part, parts);
            }
        }
        Lines {
            origin,
            part: u16::try_from(best.1).unwrap_or(1),
            parts: u16::try_from(best.2).unwrap_or(1),
            count,
            step_millionths,
        }
    }

    fn words(&self, counts: &[u16]) -> usize {
        let nodes = counts.iter().map(|count| usize::from(*count));
        nodes.fold(self.outputs.count(), usize::saturating_mul).saturating_add(HEADER_WORDS)
    }

    fn map(
        &self,
        request: &Request,
        counts: &[u16],
        field: &impl Field,
    ) -> Result<Map, TablesError> {
        let mut lines = [Lines::default(); GRID_AXES];
        for (axis, count) in counts.iter().enumerate() {
            lines[axis] = self.lines(axis, *count);
        }
        let header = Header {
            counter: request.counter,
            model: request.model,
            grid: self.grid,
            outputs: self.outputs,
            scale: self.scale,
            lines,
            reversal: self.reversal,
            output_step_nm: self.output_step_nm,
        };
        header.check()?;
        let mut values = Vec::with_capacity(header.values());
        let nodes: usize = counts.iter().map(|count| usize::from(*count)).product();
        for node in 0..nodes {
            let mut at = [0.0; GRID_AXES];
            let mut rest = node;
            for axis in (0..counts.len()).rev() {
                let count = usize::from(counts[axis]);
                let line = u16::try_from(rest % count).unwrap_or(0);
                at[axis] = lines[axis].at(line);
                rest /= count;
            }
            let found = field.correction_mm(&at, &[None; GRID_AXES]);
            for (output, requested) in request.outputs.iter().enumerate() {
                if self.is_beyond(output, found[output]) {
                    return Err(TablesError::BeyondLimit {
                        axis: requested.name,
                        found_um: found[output] * 1e3,
                        limit_um: self.limits[output] * 1e3,
                        at: "on a line of the grid".to_owned(),
                    });
                }
                values.push(nearest_i16(
                    found[output] / self.step_mm(output) * f64::from(self.scale),
                ));
            }
        }
        Ok(Map::new(header, &values)?)
    }
}

/// Builds the smallest map within the error bound.
///
/// The number of lines along each axis follows from interpolation errors of the field along lines through the work space. Then the map is
/// compared with the field at dense samples between its lines, and lines are added if the error exceeds the bound.
///
/// # Errors
/// Invalid numbers, a correction beyond its limit, a bound that no grid meets or that needs more words than available.
pub fn build(request: &Request, field: &impl Field) -> Result<Table, TablesError> {
    let mut scaled = ScaledRequest::new(request)?;
    let largest = scaled.survey(request, field)?;
    scaled.choose_scale(largest);
    let rounding_mm = scaled.rounding_mm();
    let reversal_mm = scaled.store_reversals(field);
    let rest_mm = request.within_mm - rounding_mm - reversal_mm;
    if rest_mm <= 0.0 {
        return Err(TablesError::Unreachable {
            within_um: request.within_mm * 1e3,
            rounding_um: rounding_mm * 1e3,
            reversal_um: reversal_mm * 1e3,
        });
    }
    let refinements: Vec<Vec<Refinement>> =
        (0..request.axes.len()).map(|axis| scaled.refinements(axis, field, rest_mm)).collect();
    let found = scaled.smallest(request, &refinements, field)?;
    let best = match found {
        Some(table) if table.map.words().len() <= request.words => return Ok(table),
        _ => scaled.best_within(request, &refinements, field)?,
    };
    match best {
        Some(table) if table.misfit.max_mm <= request.within_mm => Ok(table),
        best => Err(TablesError::Memory {
            within_um: request.within_mm * 1e3,
            needed: found.as_ref().map(|table| table.map.words().len()),
            lines: lines_text(request, found.as_ref()),
            words: request.words,
            reached_um: best.map(|table| table.misfit.max_mm * 1e3),
        }),
    }
}

/// Formats the number of lines: `lines along X 21, Y 11`.
fn lines_text(request: &Request, table: Option<&Table>) -> String {
    let Some(table) = table else {
        return "more lines than a grid has".to_owned();
    };
    let lines = &table.map.header().lines;
    let each: Vec<String> = request
        .axes
        .iter()
        .zip(lines)
        .map(|(axis, lines)| format!("{} {}", axis.name, lines.count))
        .collect();
    format!("lines along {}", each.join(", "))
}

/// Number of lines along an axis, and the error due to this axis alone, mm.
#[derive(Clone, Copy, Debug)]
struct Refinement {
    count: u16,
    error_mm: f64,
}

/// Finds the smallest grid whose combined error meets the target: lines are added where they reduce the error most per word. `None` if none does.
fn lines_for(refinements: &[Vec<Refinement>], target_mm: f64) -> Option<Vec<u16>> {
    let mut at = vec![0; refinements.len()];
    loop {
        let current = refinements.iter().zip(&at).map(|(refinements, at)| refinements.get(*at));
        let current: Vec<&Refinement> = current.collect::<Option<_>>()?;
        if current.iter().map(|refinement| refinement.error_mm).sum::<f64>() <= target_mm {
            return Some(current.iter().map(|refinement| refinement.count).collect());
        }
        let gain = |axis: usize| {
            let here = current[axis];
            let above = refinements[axis].iter().enumerate().skip(at[axis] + 1);
            let (next, refinement) =
                above.into_iter().find(|(_, refinement)| refinement.error_mm < here.error_mm)?;
            let growth = (f64::from(refinement.count) / f64::from(here.count)).ln();
            Some((axis, next, (here.error_mm - refinement.error_mm) / growth))
        };
        let best = (0..refinements.len()).filter_map(gain);
        let (axis, next, _) = best.max_by(|a, b| a.2.total_cmp(&b.2))?;
        at[axis] = next;
    }
}

impl ScaledRequest {
    fn refinements(&self, axis: usize, field: &impl Field, within_mm: f64) -> Vec<Refinement> {
        let mut refinements = Vec::new();
        let mut count = 2_u16;
        // Maximum number of lines that a control can index if every other axis has two.
        let most = MAX_WORDS / (self.outputs.count() << (self.travels.len() - 1));
        loop {
            let error_mm = self.error_along(axis, count, field);
            refinements.push(Refinement { count, error_mm });
            count += (count / 12).max(1);
            if error_mm <= 0.02 * within_mm || usize::from(count) > most {
                return refinements;
            }
        }
    }

    /// Largest linear interpolation error with this number of lines along an axis, sampled at 1/4, 1/2 and 3/4 of every pitch.
    fn error_along(&self, axis: usize, count: u16, field: &impl Field) -> f64 {
        const WITHIN: [f64; 3] = [0.25, 0.5, 0.75];
        let axes = self.travels.len();
        let lines = self.lines(axis, count);
        let pitch = f64::from(lines.pitch());
        let mut largest = 0.0_f64;
        let others = lattice(axes - 1, if axes <= 3 { 3 } else { 2 });
        for shares in others {
            let mut shares = shares;
            // Inserts an entry for the axis itself, whose coordinate `look` sets.
            shares[axis..].rotate_right(1);
            let mut at = self.place(&shares);
            let mut look = |steps: f64| {
                at[axis] = self.coordinate(axis, steps);
                field.correction_mm(&at, &[None; GRID_AXES])
            };
            let mut before = look(0.0);
            for line in 1..count {
                let start = f64::from(line - 1) * pitch;
                let after = look(start + pitch);
                for share in WITHIN {
                    let found = look(start + share * pitch);
                    let error = core::array::from_fn(|output| {
                        let straight = before[output] + share * (after[output] - before[output]);
                        found[output] - straight
                    });
                    largest = largest.max(norm(&error));
                }
                before = after;
            }
        }
        largest
    }

    /// Finds the smallest map within the bound, regardless of the available words; `None` if it has too many words for any control.
    ///
    /// The errors of the single axes add up to more than the error of the map. The target is
    /// therefore loosened while the map is better than required, and tightened while it is worse.
    fn smallest(
        &self,
        request: &Request,
        refinements: &[Vec<Refinement>],
        field: &impl Field,
    ) -> Result<Option<Table>, TablesError> {
        let mut best: Option<Table> = None;
        let mut target_mm = request.within_mm;
        let mut before = Vec::new();
        for _ in 0..10 {
            let Some(counts) = lines_for(refinements, target_mm) else {
                break;
            };
            if counts == before || self.words(&counts) > MAX_WORDS {
                break;
            }
            let table = self.table(request, &counts, field)?;
            let share = request.within_mm / table.misfit.max_mm.max(0.01 * request.within_mm);
            let words = table.map.words().len();
            let keeps = share >= 1.0;
            if keeps && best.as_ref().is_none_or(|best| words < best.map.words().len()) {
                best = Some(table);
            }
            target_mm *= if keeps { share.clamp(1.02, 2.0) } else { 0.97 * share.max(0.5) };
            before = counts;
        }
        Ok(best)
    }

    fn table(
        &self,
        request: &Request,
        counts: &[u16],
        field: &impl Field,
    ) -> Result<Table, TablesError> {
        let map = self.map(request, counts, field)?;
        let misfit = evaluate_misfit(&map, field, &request.travels());
        let steepest = steepest(&map);
        Ok(Table { map, misfit, steepest })
    }

    /// Finds the best map that fits into the available words; `None` if none fits.
    fn best_within(
        &self,
        request: &Request,
        refinements: &[Vec<Refinement>],
        field: &impl Field,
    ) -> Result<Option<Table>, TablesError> {
        let fits = |counts: &Vec<u16>| self.words(counts) <= request.words.min(MAX_WORDS);
        // A target that two lines along each axis meet.
        let most = refinements
            .iter()
            .filter_map(|refinements| refinements.first())
            .map(|refinement| refinement.error_mm);
        let (mut low, mut high) = (0.0, most.sum::<f64>());
        let mut best = lines_for(refinements, high).filter(fits);
        for _ in 0..30 {
            let middle = 0.5 * (low + high);
            match lines_for(refinements, middle).filter(fits) {
                Some(counts) => {
                    best = Some(counts);
                    high = middle;
                }
                None => low = middle,
            }
        }
        best.map(|counts| self.table(request, &counts, field)).transpose()
    }
}

const MAX_LATTICE_POSITIONS: usize = 400_000;
/// Number of positions of the Halton sequence at which a map is also evaluated.
const HALTON_POSITIONS: u32 = 20_000;

/// Error of a map: norm of the difference between the control's look-up and the field over all outputs. The rounding of the applied correction to
/// output steps, at most 0.6 steps, is not included.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Misfit {
    /// Maximum error, mm.
    pub max_mm: f64,
    /// RMS error, mm.
    pub rms_mm: f64,
    /// Position of the maximum, mm or deg along the axes of the grid.
    pub at: [f64; GRID_AXES],
    /// Directions of approach at the maximum.
    pub directions: [Option<Direction>; GRID_AXES],
    /// Number of evaluated positions.
    pub positions: usize,
}

#[derive(Default)]
struct MisfitSum {
    found: Misfit,
    squares: f64,
}

impl MisfitSum {
    fn add(&mut self, map: &Map, field: &impl Field, position: &Position) {
        let lines = &map.header().lines;
        let at =
            core::array::from_fn(|axis| lines[axis].coordinate(f64::from(position.steps[axis])));
        let exact = field.correction_mm(&at, &position.directions);
        let looked_up = map.correction_mm(position);
        let outputs = map.header().outputs.count();
        let squares = (0..OUTPUTS.min(outputs)).map(|o| (looked_up[o] - exact[o]).powi(2));
        let square: f64 = squares.sum();
        self.squares += square;
        self.found.positions += 1;
        if square.sqrt() > self.found.max_mm {
            self.found.max_mm = square.sqrt();
            self.found.at = at;
            self.found.directions = position.directions;
        }
    }
}

/// Evaluates the error of a map within these travels (mm or deg): on its lines and half-way between them, in all directions of approach, and at
/// positions distributed over the work space.
fn evaluate_misfit(map: &Map, field: &impl Field, travels: &[[f64; 2]]) -> Misfit {
    let axes = travels.len();
    let lines = &map.header().lines;
    let directions: Vec<_> = directions_of(field, axes).collect();
    // Positions are whole steps within the travel, as in the control.
    let ends: Vec<[i32; 2]> = (0..axes)
        .map(|axis| {
            let step = lines[axis].coordinate(1.0);
            let [low, high] = travels[axis].map(|end| end / step);
            [nearest_i32(low.ceil()), nearest_i32(high.floor())]
        })
        .collect();
    let counts: Vec<usize> = lines[..axes].iter().map(|l| 2 * usize::from(l.count) - 1).collect();
    let all: usize = counts.iter().product();
    let stride = (all * directions.len()).div_ceil(MAX_LATTICE_POSITIONS);
    let mut sum = MisfitSum::default();
    for number in (0..all).step_by(stride.max(1)) {
        let mut position = Position::default();
        let mut rest = number;
        for axis in 0..axes {
            let half = i32::try_from(rest % counts[axis]).unwrap_or(0);
            rest /= counts[axis];
            let pitch = lines[axis].pitch();
            let at = lines[axis].origin + half / 2 * pitch + half % 2 * (pitch / 2);
            position.steps[axis] = at.max(ends[axis][0]).min(ends[axis][1]);
        }
        for directions in &directions {
            position.directions = *directions;
            sum.add(map, field, &position);
        }
    }
    for number in 1..=HALTON_POSITIONS {
        let mut position = Position {
            directions: directions[number as usize % directions.len()],
            ..Position::default()
        };
        for (axis, [low, high]) in ends.iter().copied().enumerate() {
            let share = halton(number, axis);
            let at = f64::from(low) + share * (f64::from(high) - f64::from(low));
            position.steps[axis] = nearest_i32(at);
        }
        sum.add(map, field, &position);
    }
    let mean = sum.squares / sum.found.positions as f64;
    sum.found.rms_mm = mean.sqrt();
    sum.found
}

/// Maximum slope of an output between neighbouring lines of one axis, mm per mm or deg.
fn steepest(map: &Map) -> f64 {
    let header = map.header();
    let (axes, outputs) = (header.grid.count(), header.outputs.count());
    let values = &map.words()[HEADER_WORDS..];
    let mut steepest = 0.0_f64;
    for axis in 0..axes {
        let lines = &header.lines[axis];
        let pitch = lines.coordinate(f64::from(lines.pitch()));
        let behind = header.lines[axis + 1..axes].iter();
        let step = behind.fold(outputs, |step, lines| step * usize::from(lines.count));
        for (place, word) in values.iter().enumerate() {
            let line = place / step % usize::from(lines.count);
            let Some(next) = values.get(place + step).filter(|_| line + 1 < lines.count.into())
            else {
                continue;
            };
            let parts = f64::from(next.cast_signed()) - f64::from(word.cast_signed());
            let step_mm = f64::from(header.output_step_nm[place % outputs]) * 1e-6;
            let slope = parts / f64::from(header.scale) * step_mm / pitch;
            steepest = steepest.max(slope.abs());
        }
    }
    steepest
}
