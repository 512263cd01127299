//! A laser tracker that follows a target on the tool.

use std::fmt::Write;

use volcomp_document::toml_string;
use volcomp_kinematics::nalgebra::{Rotation3, Vector3};
use volcomp_vocabulary::AxisKind;

use super::{Made, Observer, number, push_row};
use crate::{observation::Poses, poses::actual_tip};

/// Standard uncertainty (k = 1) of the target position on the tool if measured with a ruler, mm.
const RULER_MM: f64 = 1.0;

impl Observer<'_> {
    pub(super) fn points(
        &mut self,
        poses: &Poses,
        frame: &[f64; 6],
        target: Option<[f64; 3]>,
    ) -> Made {
        let [a, b, c] = [frame[3], frame[4], frame[5]].map(f64::to_radians);
        let rotation = Rotation3::from_euler_angles(a, b, c);
        let place = Vector3::new(frame[0], frame[1], frame[2]);
        let offset = Vector3::from(target.unwrap_or_default());
        let states = self.everywhere(poses);
        let poses = states.len();
        let middle =
            states.iter().map(|state| self.truth.chain().ideal_tip_mm(state)).sum::<Vector3<f64>>()
                / poses.max(1) as f64;
        let (shift, turn) = (self.direction(), self.direction());
        let turn = turn * (1e-6 * self.what.instrument.angle.drift.0);
        let mut text = format!("{}{}x,y,z\n", self.axes_header(), self.tool_header());
        for (pose, mut state) in states.into_iter().enumerate() {
            self.approach.to(&mut state, self.truth);
            let tip = actual_tip(self.tools.machine(pose), &state, &offset);
            // A tracker that is displaced by +d measures every point displaced by −d.
            let share = pose as f64 / poses.saturating_sub(1).max(1) as f64;
            let drifted = self.drift_mm(&shift, pose, poses) + turn.cross(&(tip - middle)) * share;
            let seen = rotation.inverse() * (tip - drifted - place);
            let read = seen.map(|x| self.read(x));
            let (at, tool) = (self.coordinates(&state), self.tools.cell(pose));
            push_row(&mut text, &format!("{at}{tool}"), read.as_slice());
        }
        let file = format!("{}.csv", self.what.name);
        let mut tables = self.table("points", &file, self.what.uncertainty_um());
        tables.push_str("frame = \"unknown\"\n");
        if target.is_some() {
            let is_found = self.tells_targets();
            let what = self.what;
            let mut of_tool = || {
                if is_found {
                    return "\"unknown\"".to_owned();
                }
                let by_ruler = target.unwrap_or_default().map(|x| {
                    let read = x + RULER_MM * self.normal();
                    number((10.0 * read).round() / 10.0)
                });
                format!("[{}]", by_ruler.join(", "))
            };
            let by_tool: Vec<String> = what
                .tools
                .iter()
                .map(|tool| format!("{} = {}", toml_string(tool), of_tool()))
                .collect();
            let targets = if by_tool.is_empty() {
                of_tool()
            } else {
                format!("{{ {} }}", by_tool.join(", "))
            };
            let _ = writeln!(tables, "target = {targets}");
            if !is_found {
                let _ = writeln!(tables, "target_within_mm = {}", number(RULER_MM));
            }
        }
        Made { files: vec![(file, text)], tables }
    }

    /// Whether a tracker determines the target position on the tool, which requires two rotary axes.
    fn tells_targets(&self) -> bool {
        let rotary = self.truth.axes().iter();
        let rotary = rotary.filter(|axis| axis.name.kind() == AxisKind::Rotary);
        rotary.count() >= 2
    }
}
