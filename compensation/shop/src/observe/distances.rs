//! A laser tracer or a ballbar at a point on the table.

use volcomp_kinematics::nalgebra::Vector3;

use super::{Made, Observer, direction, push_row};
use crate::{error::ObservationError, observation::Poses, poses::actual_tip};

impl Observer<'_> {
    pub(super) fn distances(
        &mut self,
        poses: &Poses,
        point: Vector3<f64>,
        dead_length_mm: f64,
        radius_mm: Option<f64>,
    ) -> Result<Made, ObservationError> {
        let states = match (radius_mm, poses) {
            (None, _) | (_, Poses::Planned(_)) => self.everywhere(poses),
            (Some(radius), &Poses::Drawn(poses)) => self
                .free_axes
                .around(
                    poses,
                    |pose| self.tools.machine(pose),
                    |_, random| point + direction(random) * radius,
                    &mut self.random,
                )
                .map_err(|found| ObservationError::Reach {
                    what: format!("poses at {radius} mm from the point"),
                    at: point.into(),
                    found,
                    poses,
                })?,
        };
        let poses = states.len();
        let drift = self.direction();
        let mut text = format!("{}{}length_mm\n", self.axes_header(), self.tool_header());
        for (pose, mut state) in states.into_iter().enumerate() {
            self.approach.to(&mut state, self.truth);
            let tip = actual_tip(self.tools.machine(pose), &state, &Vector3::zeros());
            let point = point + self.drift_mm(&drift, pose, poses);
            let read = self.read((tip - point).norm() - dead_length_mm);
            let (at, tool) = (self.coordinates(&state), self.tools.cell(pose));
            push_row(&mut text, &format!("{at}{tool}"), &[read]);
        }
        let file = format!("{}.csv", self.what.name);
        let mut tables = self.table("distance", &file, self.what.uncertainty_um());
        tables.push_str("point = \"unknown\"\n");
        if dead_length_mm != 0.0 {
            tables.push_str("dead_length = \"unknown\"\n");
        }
        Ok(Made { files: vec![(file, text)], tables })
    }
}
