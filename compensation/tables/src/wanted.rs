//! A request in whole steps: its numbers are checked, and everything that follows is what a control has.

use volcomp_guard::{ceiling, protocol::Layout};
use volcomp_vocabulary::{AxisName, Direction};

use crate::{
    Field, GRID_AXES, HEADER_WORDS, Header, Lines, Map, NoMap, OUTPUTS, Request, TablesError,
    header::FURTHEST,
    sample::{directions_of, lattice, norm},
};

/// A request whose numbers are whole steps.
pub(crate) struct Wanted {
    pub(crate) grid: Layout,
    pub(crate) outputs: Layout,
    /// First position, number of steps of the travel, size of a step in millionths.
    pub(crate) travels: Vec<(i32, i32, u32)>,
    output_step_nm: [u32; OUTPUTS],
    limits: [f64; OUTPUTS],
    scale: u16,
    reversal: [[i16; OUTPUTS]; GRID_AXES],
}

/// A number in millionths of its unit.
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
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "within 1 to 2e9"
    )]
    Ok(number as u32)
}

/// The nearest whole number; NaN is 0.
#[expect(clippy::cast_possible_truncation, reason = "it saturates")]
fn whole(number: f64) -> i32 {
    number.round() as i32
}

#[expect(clippy::cast_possible_truncation, reason = "it saturates")]
fn value(number: f64) -> i16 {
    number.round() as i16
}

impl Wanted {
    /// The request in whole steps.
    pub(crate) fn of(request: &Request) -> Result<Self, TablesError> {
        let layout = |names: Vec<AxisName>, most: usize| {
            if names.len() > most {
                return Err(NoMap::Axes);
            }
            Layout::of(names).map_err(|_| NoMap::Axes)
        };
        let grid = layout(
            request.axes.iter().map(|axis| axis.name).collect(),
            GRID_AXES,
        )?;
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
            let most = f64::from(FURTHEST) / 2.0;
            // Also refuses NaN.
            if !(low < high && low >= -most && high <= most) {
                return Err(TablesError::Number {
                    what: format!("travel of {}, in steps of its position,", axis.name),
                    found: high - low,
                    expected: "a low end below a high one, both within 500 million steps",
                });
            }
            let first = whole(low.floor());
            travels.push((first, (whole(high.ceil()) - first).max(1), step));
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

    pub(crate) fn step_mm(&self, output: usize) -> f64 {
        f64::from(self.output_step_nm[output]) * 1e-6
    }

    /// Whether a correction is beyond the limit of its output, or is no number.
    pub(crate) fn is_beyond(&self, output: usize, found_mm: f64) -> bool {
        found_mm.is_nan() || found_mm.abs() > self.limits[output]
    }

    pub(crate) fn coordinate(&self, axis: usize, steps: f64) -> f64 {
        let (first, _, step) = self.travels[axis];
        (f64::from(first) + steps) * f64::from(step) * 1e-6
    }

    /// Looks over the work space, and gives the largest correction of each output; one beyond its limit is refused.
    pub(crate) fn survey(
        &self,
        request: &Request,
        field: &impl Field,
    ) -> Result<[f64; OUTPUTS], TablesError> {
        let mut largest = [0.0_f64; OUTPUTS];
        for shares in lattice(self.travels.len(), 9) {
            let at = self.place(&shares);
            for directions in directions_of(field, self.travels.len()) {
                let found = field.correction_mm(&at, &directions);
                for (output, asked) in request.outputs.iter().enumerate() {
                    if self.is_beyond(output, found[output]) {
                        let axes = request.axes.iter().zip(&at);
                        let at: Vec<String> = axes
                            .map(|(axis, at)| format!("{}={at}", axis.name))
                            .collect();
                        return Err(TablesError::BeyondLimit {
                            axis: asked.name,
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

    /// Coordinates from shares of the travels.
    pub(crate) fn place(&self, shares: &[f64; GRID_AXES]) -> [f64; GRID_AXES] {
        core::array::from_fn(|axis| match self.travels.get(axis) {
            Some((_, steps, _)) => self.coordinate(axis, shares[axis] * f64::from(*steps)),
            None => 0.0,
        })
    }

    /// As many parts of a step as the values leave room for, with a tenth to spare.
    pub(crate) fn choose_scale(&mut self, largest: [f64; OUTPUTS]) {
        let mut scale = crate::SCALES[0];
        let steps = (0..self.outputs.count()).map(|output| largest[output] / self.step_mm(output));
        let most = 1.1 * steps.fold(0.0, f64::max);
        while scale > 1 && most * f64::from(scale) > 32767.0 {
            scale /= 2;
        }
        self.scale = scale;
    }

    /// The most that rounding leaves: of the values, of the way along each axis, and of the reversals.
    pub(crate) fn rounding_mm(&self) -> f64 {
        let roundings = 0.5 * (1.0 + self.travels.len() as f64);
        let steps = (0..self.outputs.count()).map(|output| self.step_mm(output).powi(2));
        roundings * steps.sum::<f64>().sqrt() / f64::from(self.scale)
    }

    /// Takes the reversals where they are constant, and gives what they are not, mm.
    pub(crate) fn take_reversals(&mut self, field: &impl Field) -> f64 {
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
            let mut beside = [0.0; OUTPUTS];
            for output in 0..self.outputs.count() {
                let [low, high] = range[output];
                let parts = 0.5 * (low + high) / self.step_mm(output) * f64::from(self.scale);
                self.reversal[axis][output] = value(parts);
                beside[output] = 0.5 * (high - low);
            }
            left += norm(&beside);
        }
        left
    }

    /// So many lines over the travel of an axis. From line to line it is a whole number of places, which a control can
    /// reckon with, so the last line may be a little beyond the end.
    pub(crate) fn lines(&self, axis: usize, count: u16) -> Lines {
        let (origin, steps, step_millionths) = self.travels[axis];
        let gaps = i32::from(count) - 1;
        let pitch = (steps + gaps - 1) / gaps;
        let mut best = (i32::MAX, 1, 1);
        // As many places as a control can reckon with, or a quarter of them, where that meets the end of the travel.
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

    pub(crate) fn words(&self, counts: &[u16]) -> usize {
        let nodes = counts.iter().map(|count| usize::from(*count));
        nodes
            .fold(self.outputs.count(), usize::saturating_mul)
            .saturating_add(HEADER_WORDS)
    }

    /// The map on these lines.
    pub(crate) fn map(
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
            for (output, asked) in request.outputs.iter().enumerate() {
                if self.is_beyond(output, found[output]) {
                    return Err(TablesError::BeyondLimit {
                        axis: asked.name,
                        found_um: found[output] * 1e3,
                        limit_um: self.limits[output] * 1e3,
                        at: "on a line of the grid".to_owned(),
                    });
                }
                values.push(value(
                    found[output] / self.step_mm(output) * f64::from(self.scale),
                ));
            }
        }
        Ok(Map::new(header, &values)?)
    }
}
