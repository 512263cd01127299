//! Positions at which curves are evaluated outside their range, or axes are outside their travel.

use numpy::IntoPyArray;
use pyo3::{prelude::*, types::PyDict};
use volcomp_model::{
    Axis, Machine,
    curve::ErrorCurve,
    vocabulary::{ErrorName, PerAxis},
};

use crate::positions::{PIECE, Piece};

/// Index of the first axis bit; the bits below it are those of the errors, at most six for each of nine axes.
const AXES: usize = 54;

/// Ranges of the curves, and travels of the axes, of a machine.
pub(crate) struct Ranges<'a> {
    machine: &'a Machine,
    errors: Vec<(ErrorName, usize, &'a ErrorCurve)>,
}

impl<'a> Ranges<'a> {
    pub(crate) fn new(machine: &'a Machine) -> Self {
        let structure = machine.chain().structure();
        let own = |name: ErrorName| structure.index_of(name.axis).unwrap_or(0);
        let errors = machine.errors();
        let mut errors: Vec<_> = errors.map(|(name, curve)| (name, own(name), curve)).collect();
        errors.sort_unstable_by_key(|(name, ..)| name.to_string());
        Self { machine, errors }
    }

    /// Returns a bit mask for each position, with the errors and axes that are outside their range; `None` if
    /// everything is within range.
    pub(crate) fn flags(&self, piece: &Piece) -> Option<Vec<u64>> {
        // Ranges are boxes of coordinates. A range that contains both corners therefore contains all positions.
        if self.corners(piece).iter().all(|corner| self.at(corner) == 0) {
            return None;
        }
        let at = |state| self.at(&self.machine.curve_coordinates(&state));
        Some(piece.states().map(at).collect())
    }

    /// Lowest and highest coordinate of every axis. An axis with a modulo may be anywhere in its travel. If the travel
    /// is shorter than the modulo, the axis may also be outside. Its corners are then NaN, which no range contains.
    fn corners(&self, piece: &Piece) -> [PerAxis<f64>; 2] {
        let mut corners = piece.ends().map(|end| self.machine.curve_coordinates(&end));
        for (index, axis) in self.machine.axes().iter().enumerate() {
            let [low, high] = axis.travel;
            let ends = match axis.modulo {
                None => continue,
                Some(period) if high - low >= period => [low, high],
                Some(_) => [f64::NAN; 2],
            };
            for (corner, end) in corners.iter_mut().zip(ends) {
                corner[index] = end;
            }
        }
        corners
    }

    /// Bit mask of the errors and axes outside their range at `coordinates` (mm, deg; within the travel for an axis
    /// with a modulo).
    fn at(&self, coordinates: &PerAxis<f64>) -> u64 {
        let mut bits = 0;
        for (bit, (_, own, curve)) in self.errors.iter().enumerate() {
            bits |= u64::from(!curve.contains(*own, &coordinates[..])) << bit;
        }
        let axes = self.machine.axes().iter().zip(coordinates);
        for (bit, (axis, coordinate)) in axes.enumerate() {
            bits |= u64::from(!axis.may_stand_at(*coordinate)) << (AXES + bit);
        }
        bits
    }

    /// Adds `outside_range` and `outside_travel`. Each maps the names of errors or axes that are outside at some
    /// position to one truth value per position.
    pub(crate) fn add_to(
        &self,
        result: &Bound<'_, PyDict>,
        count: usize,
        flags: &[Option<Vec<u64>>],
    ) -> PyResult<()> {
        let any = flags.iter().flatten().flatten().fold(0, |all, bits| all | bits);
        let column = |bit: usize| -> Vec<bool> {
            let mut column = vec![false; count];
            for (places, flags) in column.chunks_mut(PIECE).zip(flags) {
                for (place, bits) in places.iter_mut().zip(flags.iter().flatten()) {
                    *place = bits >> bit & 1 == 1;
                }
            }
            column
        };
        let errors = self.errors.iter().map(|(name, ..)| name.to_string());
        let axes = self.machine.axes().iter();
        let axes = axes.map(|axis: &Axis| axis.name.to_string());
        let errors: Vec<_> = errors.enumerate().collect();
        let axes: Vec<_> = axes.enumerate().map(|(bit, name)| (AXES + bit, name)).collect();
        for (key, names) in [("outside_range", errors), ("outside_travel", axes)] {
            let found = PyDict::new(result.py());
            for (bit, name) in names {
                if any >> bit & 1 == 1 {
                    found.set_item(name, column(bit).into_pyarray(result.py()))?;
                }
            }
            result.set_item(key, found)?;
        }
        Ok(())
    }
}
