//! The ideal machine between the coordinates of its axes and those of the centre point of its tool, and its tool.

use std::{cell::RefCell, sync::Arc};

use volcomp_model::{
    Machine, Tool,
    kinematics::{
        Chain, Pose,
        nalgebra::{Matrix3, Vector3},
    },
    vocabulary::AxisKind,
};

use crate::{
    NcError,
    coordinates::{Axes, AxisPlaces},
};

/// The centre point of the tool on the ideal machine. Its coordinates are those of the tip as the workpiece sees it, from where
/// it is with all axes at zero: while the rotary axes stand at zero they are the coordinates of X, Y and Z.
#[derive(Clone, Debug)]
pub(crate) struct Tip {
    chain: Chain,
    places: AxisPlaces,
    at_zero_mm: Vector3<f64>,
}

/// The centre point where rotary axes stand somewhere: it goes as X, Y and Z go, whose directions are turned.
#[derive(Clone, Debug)]
struct Turned {
    /// The axes besides X, Y and Z.
    others: [f64; 6],
    /// The centre point with X, Y and Z at zero.
    base_mm: Vector3<f64>,
    /// How it goes with X, Y and Z, and back.
    columns: Matrix3<f64>,
    inverse: Matrix3<f64>,
}

/// A motion asks for its two ends many times, each with its correction and without.
const KEPT: usize = 4;

/// The centre point in a frame. State: the kinematics for the last places of the rotary axes, and which of them is the last one.
#[derive(Clone, Debug)]
pub(crate) struct TipFrame {
    tip: Arc<Tip>,
    last: RefCell<([Option<Turned>; KEPT], usize)>,
}

impl TipFrame {
    pub(crate) fn new(tip: Arc<Tip>) -> Self {
        Self {
            tip,
            last: RefCell::default(),
        }
    }

    pub(crate) fn tip(&self) -> &Tip {
        &self.tip
    }

    fn with<T>(&self, axes: &Axes, take: impl FnOnce(&Turned) -> T) -> T {
        let (turned, last) = &mut *self.last.borrow_mut();
        let is_it = |of: &usize| (turned[*of].as_ref()).is_some_and(|it| it.others == axes[3..]);
        // The last one first; what was there before the next ones goes.
        let back = (0..KEPT).map(|back| (*last + KEPT - back) % KEPT);
        if let Some(found) = back.into_iter().find(is_it) {
            *last = found;
        } else {
            *last = (*last + 1) % KEPT;
            turned[*last] = None;
        }
        take(turned[*last].get_or_insert_with(|| self.tip.turned_to(axes)))
    }

    /// Coordinates of the axes as those of the centre point, mm and deg. Those of rotary axes stay.
    pub(crate) fn of_axes(&self, axes: &Axes) -> Axes {
        let [x, y, z, ..] = *axes;
        let at = self.with(axes, |turned| {
            turned.base_mm + turned.columns * Vector3::new(x, y, z)
        });
        let mut tip = *axes;
        tip[..3].copy_from_slice(at.as_slice());
        tip
    }

    /// Coordinates of the centre point as those of the axes, mm and deg.
    pub(crate) fn to_axes(&self, tip: &Axes) -> Axes {
        let [x, y, z, ..] = *tip;
        let at = self.with(tip, |turned| {
            let at = turned.inverse * (Vector3::new(x, y, z) - turned.base_mm);
            // What that lost to rounding.
            let missing = Vector3::new(x, y, z) - turned.base_mm - turned.columns * at;
            at + turned.inverse * missing
        });
        let mut axes = *tip;
        axes[..3].copy_from_slice(at.as_slice());
        axes
    }
}

impl Tip {
    /// `None` for a machine without rotary axes, without X, Y and Z, or with a rotary axis between these: no control
    /// moves the centre point of its tool.
    pub(crate) fn new(machine: &Machine) -> Option<Self> {
        let chain = machine.chain().clone();
        let places = AxisPlaces::of(machine);
        let [Some(x), Some(y), Some(z)] = [0, 1, 2].map(|axis| places.of_axis(axis)) else {
            return None;
        };
        let (first, last) = (x.min(y).min(z), x.max(y).max(z));
        let is_rotary = |place: usize| chain.joints()[place].kind == AxisKind::Rotary;
        let any = (0..chain.joints().len()).any(is_rotary);
        if !any || (first..=last).any(is_rotary) {
            return None;
        }
        let at_zero_mm = chain.ideal_tip_mm(&places.state(&[0.0; 9]));
        Some(Self {
            chain,
            places,
            at_zero_mm,
        })
    }

    /// The kinematics where the axes besides X, Y and Z stand as `axes` says.
    fn turned_to(&self, axes: &Axes) -> Turned {
        let mut at = *axes;
        at[..3].fill(0.0);
        let state = self.places.state(&at);
        let joints = self.chain.joints();
        // Each of X, Y and Z leads where the rotary axes before it have turned it; they are next to each other in the chain.
        let places = [0, 1, 2].map(|axis| self.places.of_axis(axis).unwrap_or_default());
        let first = places.into_iter().min().unwrap_or_default();
        let (mut pose, mut turned) = (Pose::identity(), Matrix3::identity());
        let mut moves_nothing = true;
        for (place, (joint, q)) in joints.iter().zip(state.q).enumerate() {
            if place == first {
                turned = pose.rotation;
            }
            if joint.kind == AxisKind::Linear && q == 0.0 {
                continue;
            }
            let motion = joint.motion(q);
            pose = if moves_nothing { motion } else { pose * motion };
            moves_nothing = false;
        }
        let columns = Matrix3::from_columns(&places.map(|place| turned * joints[place].direction));
        let [.., a, b, c, d, e, f] = at;
        Turned {
            others: [a, b, c, d, e, f],
            base_mm: pose.transform_point(&self.chain.tool_tip_mm())
                - self.chain.workpiece_origin_mm()
                - self.at_zero_mm,
            columns,
            // Independent wherever the rotary axes stand, since none of them is between the linear ones.
            inverse: (columns.try_inverse()).unwrap_or(Matrix3::repeat(f64::NAN)),
        }
    }

    /// The angle (rad) by which the rotary axes turn between two places, all together.
    pub(crate) fn turned(&self, from: &Axes, to: &Axes) -> f64 {
        let turns = (3..6).filter(|axis| self.places.of_axis(*axis).is_some());
        turns
            .map(|axis| (to[axis] - from[axis]).abs().to_radians())
            .sum()
    }
}

/// The machine with a tool of the program's tool table in its spindle: `offset` is what the control adds to the coordinates for it,
/// so that the tip is that far below the gauge point. Where the machine file states no gauge point, or the offset is zero, the
/// tool is that of the machine file.
pub(crate) fn with_tool(machine: &Machine, offset: &Axes) -> Result<Machine, NcError> {
    let mut machine = machine.clone();
    if offset[..3] != [0.0; 3] {
        let tool = Tool {
            length_mm: Some(0.0),
            offset_mm: Some([-offset[0], -offset[1], -offset[2]]),
            ..Tool::default()
        };
        machine.set_tool(&tool)?;
    }
    Ok(machine)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MACHINE: &str = "name = \"m\"\nstructure = \"w C' A' b X Y Z t\"\n[axes.X]\ntravel = [-500, 500]\n[axes.Y]\ntravel = [-500, 500]\n[axes.Z]\ntravel = [-500, 500]\n[axes.A]\ntravel = [-120, 120]\npoint = [10, 20, -30]\n[axes.C]\ntravel = [-360, 360]\npoint = [10, 20, 0]\n[tool]\ngauge = [0, 0, 0]\nlength = 100\n";

    fn tip(offset: f64) -> TipFrame {
        let machine = Machine::parse(MACHINE, "m.toml").expect("a good machine");
        let mut of_tool = [0.0; 9];
        of_tool[2] = offset;
        let tip = Tip::new(&with_tool(&machine, &of_tool).expect("a tool"));
        TipFrame::new(Arc::new(tip.expect("five axes")))
    }

    /// A' and C' turn the table by the negative angles about lines through points that are given: written out.
    #[test]
    fn a_table_that_tilts_and_turns() {
        for offset in [0.0, 60.0] {
            let tip = tip(offset);
            let length = if offset == 0.0 { 100.0 } else { offset };
            let axes = [31.0, -42.0, 53.0, 30.0, 0.0, -70.0, 0.0, 0.0, 0.0];
            let (a, c) = (30.0_f64.to_radians(), (-70.0_f64).to_radians());
            // Seen from the table, the tool turns by +A about X through (.., 20, -30), then by +C about Z through (10, 20).
            let at = [31.0, -42.0, 53.0 - length];
            let [y, z] = [at[1] - 20.0, at[2] + 30.0];
            let at = [
                at[0],
                20.0 + a.cos() * y - a.sin() * z,
                -30.0 + a.sin() * y + a.cos() * z,
            ];
            let [x, y] = [at[0] - 10.0, at[1] - 20.0];
            let at = [
                10.0 + c.cos() * x - c.sin() * y,
                20.0 + c.sin() * x + c.cos() * y,
                at[2] + length,
            ];
            let found = tip.of_axes(&axes);
            for i in 0..3 {
                assert!((found[i] - at[i]).abs() < 1e-10, "{found:?} {at:?}");
            }
            let back = tip.to_axes(&found);
            assert!(
                (0..9).all(|i| (back[i] - axes[i]).abs() < 1e-10),
                "{back:?}"
            );
        }
    }

    #[test]
    fn with_rotary_axes_at_zero_it_is_the_axes() {
        let tip = tip(0.0);
        let axes = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let found = tip.of_axes(&axes);
        assert!((0..9).all(|i| (found[i] - axes[i]).abs() < 1e-12));
    }
}
