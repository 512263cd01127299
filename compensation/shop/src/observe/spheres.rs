//! Simulated readings of a touch probe or an R-test on spheres.

use volcomp_kinematics::{
    State,
    nalgebra::{Matrix3, Vector3},
};

use super::{Made, Observer, push_offset};
use crate::{
    error::ObservationError,
    observation::{Poses, Reads},
    plan::Plan,
    poses::actual_tip,
};

/// Maximum distance of the commanded tip from a sphere, mm: the range of an R-test is one or two millimetres.
const NEAR_MM: f64 = 2.0;

impl Observer<'_> {
    pub(super) fn spheres(
        &mut self,
        poses: &Poses,
        centres: &[[f64; 3]],
        reads: Reads,
    ) -> Result<Made, ObservationError> {
        let offsets = match reads {
            Reads::Coordinates => "",
            Reads::Offset => ",dx_um,dy_um,dz_um",
        };
        let mut text = format!("{}{}sphere{offsets}\n", self.axes_header(), self.tool_header());
        match poses {
            &Poses::Drawn(poses) => {
                for (sphere, centre) in centres.iter().enumerate() {
                    let drift = self.direction();
                    let states = self.around(sphere, (*centre).into(), poses)?;
                    for (pose, state) in states.into_iter().enumerate() {
                        let centre = Vector3::from(*centre) + self.drift_mm(&drift, pose, poses);
                        text.push_str(&self.at_sphere(pose, state, sphere, &centre, reads)?);
                    }
                }
            }
            Poses::Planned(plan) => {
                let drifts: Vec<_> = centres.iter().map(|_| self.direction()).collect();
                let states = self.free_axes.planned(self.truth, plan);
                let rows = states.len();
                for (pose, (state, planned)) in states.into_iter().zip(&plan.poses).enumerate() {
                    let sphere = planned.sphere;
                    let (Some(centre), Some(drift)) = (centres.get(sphere), drifts.get(sphere))
                    else {
                        return Err(ObservationError::NoSphere {
                            found: sphere + 1,
                            most: centres.len(),
                        });
                    };
                    let centre = Vector3::from(*centre);
                    let state = self.to_sphere(pose, state, sphere, &centre, plan)?;
                    let centre = centre + self.drift_mm(drift, pose, rows);
                    text.push_str(&self.at_sphere(pose, state, sphere, &centre, reads)?);
                }
            }
        }
        let file = format!("{}.csv", self.what.name);
        let tables = self.table("sphere", &file, self.what.uncertainty_um());
        Ok(Made { files: vec![(file, text)], tables })
    }

    fn around(
        &mut self,
        sphere: usize,
        centre: Vector3<f64>,
        poses: usize,
    ) -> Result<Vec<State>, ObservationError> {
        let tools = &self.tools;
        self.free_axes
            .around(poses, |pose| tools.machine(pose), |_, _| centre, &mut self.random)
            .map_err(|found| ObservationError::Reach {
                what: format!("sphere S{}", sphere + 1),
                at: centre.into(),
                found,
                poses,
            })
    }

    /// State of a planned pose with the ideal tip at the sphere. If the plan commands no linear axes, these are solved for; otherwise the commanded
    /// tip must be near the sphere.
    fn to_sphere(
        &self,
        pose: usize,
        state: State,
        sphere: usize,
        centre: &Vector3<f64>,
        plan: &Plan,
    ) -> Result<State, ObservationError> {
        let machine = self.tools.machine(pose);
        if plan.is_rotary() {
            let found = self.free_axes.ideal(machine, state, centre);
            return found.ok_or_else(|| ObservationError::PlannedReach {
                pose: pose + 1,
                sphere: sphere + 1,
                at: (*centre).into(),
            });
        }
        let apart_mm = (machine.chain().ideal_tip_mm(&state) - centre).norm();
        if apart_mm > NEAR_MM {
            return Err(ObservationError::PlannedApart {
                pose: pose + 1,
                sphere: sphere + 1,
                apart_mm,
                most_mm: NEAR_MM,
            });
        }
        Ok(state)
    }

    fn at_sphere(
        &mut self,
        pose: usize,
        state: State,
        sphere: usize,
        centre: &Vector3<f64>,
        reads: Reads,
    ) -> Result<String, ObservationError> {
        let (state, read) = self.at_centre(pose, state, centre, &Matrix3::identity(), reads)?;
        let (at, tool) = (self.coordinates(&state), self.tools.cell(pose));
        let mut row = String::new();
        let number = self.spheres.get(sphere).copied().unwrap_or(sphere + 1);
        push_offset(&mut row, &format!("{at}{tool}S{number}"), read);
        Ok(row)
    }

    /// Measures a centre, starting from the nominal pose. Returns the recorded coordinates, and the offset along `axes`, mm.
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
                    found.ok_or(ObservationError::NotReached { at: (*centre).into() })
                };
                // The approach direction follows from the actual motion, so that it agrees with the recorded coordinates.
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
