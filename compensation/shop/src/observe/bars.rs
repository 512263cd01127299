//! Bars with marks: a step gauge, a row of balls.

use std::fmt::Write;

use volcomp_document::toml_string;
use volcomp_kinematics::{
    State,
    nalgebra::{Matrix3, Vector3},
};

use super::{Made, Observer, across, number, push_offset};
use crate::{
    error::ObservationError,
    observation::{Bar, Reads},
};

struct TrueBar {
    origin: Vector3<f64>,
    /// Matrix whose columns are the nominal directions along and across the bar.
    axes: Matrix3<f64>,
    along: Vector3<f64>,
    distances: Vec<f64>,
}

struct AtMark {
    pass: usize,
    mark: usize,
    state: State,
    read: Option<Vector3<f64>>,
}

impl Observer<'_> {
    /// Draws the actual bar on the table: tilted, with distances that deviate according to their calibration.
    fn true_bar(&mut self, bar: &Bar) -> Result<TrueBar, ObservationError> {
        let along = Vector3::from(bar.direction)
            .try_normalize(1e-12)
            .ok_or(ObservationError::NoDirection)?;
        let axes = across(&along);
        let tilt = 1e-6 * self.what.instrument.alignment.0;
        let tilted = Vector3::new(1.0, tilt * self.normal(), tilt * self.normal());
        let mut distances = Vec::new();
        for &distance in &bar.distances {
            let by = self.normal() * 1e-3 * bar.calibration.0;
            distances.push(if distance == 0.0 { 0.0 } else { distance + by });
        }
        Ok(TrueBar {
            origin: bar.origin.into(),
            axes,
            along: (axes * tilted).normalize(),
            distances,
        })
    }

    /// Measures the marks of a bar, forward and, if requested, back.
    fn along(
        &mut self,
        bar: &Bar,
        real: &TrueBar,
        reads: Reads,
    ) -> Result<Vec<AtMark>, ObservationError> {
        let passes = self.passes(bar.distances.len());
        let rows = passes.len() * bar.distances.len();
        let drift = self.direction();
        let mut found = Vec::with_capacity(rows);
        for (pass, marks) in passes.into_iter().enumerate() {
            for mark in marks {
                let nominal = real.origin + real.axes.column(0) * bar.distances[mark];
                let held = self.free_axes.ideal(self.tools.machine(pass), self.held()?, &nominal);
                let state = held.ok_or(ObservationError::NotReached { at: nominal.into() })?;
                let drifted = self.drift_mm(&drift, found.len(), rows);
                let place = real.origin + drifted + real.along * real.distances[mark];
                let (state, read) = self.at_centre(pass, state, &place, &real.axes, reads)?;
                found.push(AtMark { pass, mark, state, read });
            }
        }
        Ok(found)
    }

    /// Measures a step gauge. Its faces are recorded like balls that are read only along the bar. Lengths of one run share their first face,
    /// and all runs share the calibration.
    pub(super) fn step_gauge(&mut self, bar: &Bar) -> Result<Made, ObservationError> {
        let real = self.true_bar(bar)?;
        let rows = self.along(bar, &real, Reads::Coordinates)?;
        Ok(self.row_of(bar, &real, &rows, "F", [",along_um", ",0"]))
    }

    pub(super) fn ball_row(&mut self, bar: &Bar, reads: Reads) -> Result<Made, ObservationError> {
        let real = self.true_bar(bar)?;
        let rows = self.along(bar, &real, reads)?;
        let offsets = match reads {
            Reads::Coordinates => "",
            Reads::Offset => ",along_um,side1_um,side2_um",
        };
        Ok(self.row_of(bar, &real, &rows, "B", [offsets, ""]))
    }

    /// Creates the row files of a bar. `letter` names its balls or faces. `head` is the header of the offset columns, and `always` the constant
    /// reading in the last of them.
    fn row_of(
        &self,
        bar: &Bar,
        real: &TrueBar,
        rows: &[AtMark],
        letter: &str,
        [head, always]: [&str; 2],
    ) -> Made {
        let mut text = format!("{}{}ball{head}\n", self.axes_header(), self.tool_header());
        for AtMark { pass, mark, state, read } in rows {
            let (at, tool) = (self.coordinates(state), self.tools.cell(*pass));
            push_offset(&mut text, &format!("{at}{tool}{letter}{}{always}", mark + 1), *read);
        }
        let mut row = String::from("ball,distance_mm,uncertainty_um\n");
        for (mark, &distance) in bar.distances.iter().enumerate() {
            let uncertainty = if distance == 0.0 { 0.0 } else { bar.calibration.0 };
            let _ =
                writeln!(row, "{letter}{},{},{}", mark + 1, number(distance), number(uncertainty));
        }
        let name = &self.what.name;
        let (file, row_file) = (format!("{name}.csv"), format!("{name}-row.csv"));
        let mut tables = self.table("ball-row", &file, self.what.uncertainty_um());
        let side: Vec<String> = real.axes.column(1).iter().map(|x| number(*x)).collect();
        let _ = writeln!(tables, "row = {}\nside1 = [{}]", toml_string(&row_file), side.join(", "));
        Made { files: vec![(file, text), (row_file, row)], tables }
    }
}
