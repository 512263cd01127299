//! A touch probe or an R-test on spheres.

use volcomp_kinematics::{
    State,
    nalgebra::{Matrix3, Vector3},
};

use super::{Made, Observer, push_offset};
use crate::{error::ObservationError, observation::Reads, poses::actual_tip};

impl Observer<'_> {
    pub(super) fn spheres(
        &mut self,
        poses: usize,
        centres: &[[f64; 3]],
        reads: Reads,
    ) -> Result<Made, ObservationError> {
        let offsets = match reads {
            Reads::Coordinates => "",
            Reads::Offset => ",dx_um,dy_um,dz_um",
        };
        let mut text = format!(
            "{}{}sphere{offsets}\n",
            self.axes_header(),
            self.tool_header()
        );
        for (number, centre) in centres.iter().enumerate() {
            let centre = Vector3::from(*centre);
            let drift = self.direction();
            let tools = &self.tools;
            let states = self
                .free_axes
                .around(
                    poses,
                    |pose| tools.machine(pose),
                    |_, _| centre,
                    &mut self.random,
                )
                .map_err(|found| ObservationError::Reach {
                    what: format!("sphere S{}", number + 1),
                    at: centre.into(),
                    found,
                    poses,
                })?;
            for (pose, state) in states.into_iter().enumerate() {
                let centre = centre + self.drift_mm(&drift, pose, poses);
                let (state, read) =
                    self.at_centre(pose, state, &centre, &Matrix3::identity(), reads)?;
                let (at, tool) = (self.coordinates(&state), self.tools.cell(pose));
                let cells = format!("{at}{tool}S{}", number + 1);
                push_offset(&mut text, &cells, read);
            }
        }
        let file = format!("{}.csv", self.what.name);
        let tables = self.table("sphere", &file, self.what.uncertainty_um());
        Ok(Made {
            files: vec![(file, text)],
            tables,
        })
    }

    /// Goes to a centre from the pose at which it is nominally: the coordinates that are written, and the offset along
    /// `axes`, mm.
    pub(super) fn at_centre(
        &mut self,
        pose: usize,
        mut state: State,
        centre: &Vector3<f64>,
        axes: &Matrix3<f64>,
        reads: Reads,
    ) -> Result<(State, Option<Vector3<f64>>), ObservationError> {
        match reads {
            Reads::Offset => {
                self.approach.to(&mut state, self.truth);
                let tip = actual_tip(self.tools.machine(pose), &state, &Vector3::zeros());
                let offset = axes.transpose() * (tip - centre);
                Ok((state, Some(offset.map(|x| self.read(x)))))
            }
            Reads::Coordinates => {
                let machine = self.tools.machine(pose);
                let found = |state| {
                    let found = self.free_axes.actual(machine, state, centre);
                    found.ok_or(ObservationError::NotReached {
                        at: (*centre).into(),
                    })
                };
                // From which side an axis comes is told by where it really goes, as the coordinates that are written tell it.
                let mut state = found(state)?;
                self.approach.to(&mut state, self.truth);
                let mut state = found(state)?;
                let free_axes = self.free_axes.clone();
                free_axes.shift_linear(&mut state, |q| self.read(q));
                Ok((state, None))
            }
        }
    }
}
