//! A laser along body diagonals.

use std::fmt::Write;

use volcomp_kinematics::{State, nalgebra::Vector3};
use volcomp_vocabulary::AxisName;

use super::{Made, Observer, across, from_one_side, number, push_row};
use crate::{error::ObservationError, poses::actual_tip};

impl Observer<'_> {
    pub(super) fn diagonals(&mut self, names: &[String]) -> Result<Made, ObservationError> {
        let mut made = Made { files: Vec::new(), tables: String::new() };
        for name in names {
            let (file, text, direction) = self.diagonal(name)?;
            let mut tables = self.table("line", &file, self.what.uncertainty_um());
            let [x, y, z] = direction.map(number).into();
            let slope =
                if self.what.instrument.alignment.0 > 0.0 { "slope = \"unknown\"\n" } else { "" };
            let _ = write!(tables, "direction = [{x}, {y}, {z}]\noffset = \"unknown\"\n{slope}");
            made.tables.push_str(&tables);
            made.files.push((file, text));
        }
        Ok(made)
    }

    fn diagonal(&mut self, name: &str) -> Result<(String, String, Vector3<f64>), ObservationError> {
        let targets = self.what.instrument.targets;
        let mut ends = [self.what.at.clone(), self.what.at.clone()];
        for (axis, sense) in [AxisName::X, AxisName::Y, AxisName::Z].into_iter().zip(name.chars()) {
            let travel = self.truth.axes()[self.truth.index_of(axis)?].travel;
            let [from, to] = if sense == 'N' { [travel[1], travel[0]] } else { travel };
            ends[0].push((axis, from));
            ends[1].push((axis, to));
        }
        let [from, to] = ends;
        let (from, to) = (self.truth.state(&from)?, self.truth.state(&to)?);
        let place = |target: usize| {
            let share = target as f64 / (targets.max(2) - 1) as f64;
            let mut state = from;
            for (q, end) in state.q.iter_mut().zip(&to.q) {
                *q += (end - *q) * share;
            }
            state
        };
        let tip = |state: &State| self.truth.chain().ideal_tip_mm(state);
        let way = tip(&to) - tip(&from);
        let along = way.try_normalize(1e-12).ok_or(ObservationError::NoDirection)?;
        let axes = across(&along);
        let first = tip(&from);
        let tilt = 1e-6 * self.what.instrument.alignment.0;
        let tilted = Vector3::new(1.0, tilt * self.normal(), tilt * self.normal());
        let sight = (axes * tilted).normalize();
        let passes = self.passes(targets);
        let rows = passes.len() * targets;
        let mut text = format!("{}deviation_um\n", self.axes_header());
        self.approach = from_one_side(&mut self.sides);
        for (row, target) in passes.into_iter().flatten().enumerate() {
            let mut state = place(target);
            self.approach.to(&mut state, self.truth);
            let actual = actual_tip(self.truth, &state, &Vector3::zeros());
            let nominal = way.norm() * target as f64 / (targets.max(2) - 1) as f64;
            let drift = self.drift_mm(&Vector3::x(), row, rows).x;
            let read = self.read(sight.dot(&(actual - first)) - nominal + drift);
            let at = self.coordinates(&state);
            push_row(&mut text, &at, &[1e3 * read]);
        }
        let file = format!("{}-{}.csv", self.what.name, name.to_lowercase());
        Ok((file, text, along))
    }
}
