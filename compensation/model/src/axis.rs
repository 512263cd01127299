use volcomp_document::{split_head, unit_named};
use volcomp_kinematics::MotionFrame;
use volcomp_vocabulary::{AxisName, brought_into, is_within};

/// One axis as defined in the machine file.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Axis {
    pub name: AxisName,
    /// Lower and upper end of travel, mm (linear) or deg (rotary).
    pub travel: [f64; 2],
    /// Period of a rotary axis, deg: coordinates are moved into the travel by whole periods before curves are evaluated. `None`: no reduction.
    pub modulo: Option<f64>,
    /// Direction of positive motion of the tool relative to the workpiece, in the machine coordinate system at machine zero; not
    /// necessarily a unit vector. `None`: the direction of the letter.
    pub direction: Option<[f64; 3]>,
    /// A point on the axis line (rotary), or the point of the carriage to which its errors apply (linear), mm in the machine coordinate
    /// system at machine zero; `None`: the origin.
    pub point_mm: Option<[f64; 3]>,
    /// The frame of the error motions of a rotary axis. The error motions of a linear axis are in the non-rotating
    /// frame and move with the carriage.
    pub motion_frame: MotionFrame,
}

impl Axis {
    /// The coordinate at which curves are evaluated, mm or deg: `coordinate` moved into the travel by whole periods of
    /// `modulo`; unchanged without `modulo`.
    pub(crate) fn looked_up(&self, coordinate: f64) -> f64 {
        match self.modulo {
            Some(period) => brought_into(self.travel, period, coordinate),
            None => coordinate,
        }
    }

    /// The travel converted from radians to deg, if it looks as if it had been entered in radians. `Some` only for a
    /// rotary axis: both ends, read as radians, are common fractions of a turn rounded to a few digits (3.14, 1.571,
    /// 6.2832), and at least one end is not 0.
    pub fn travel_as_if_in_radians(&self) -> Option<[f64; 2]> {
        // Common angles, deg. The tolerance below admits π rounded to 3.14, which is 0.05 % too small.
        const USUAL: [f64; 13] =
            [0.0, 30.0, 45.0, 60.0, 90.0, 120.0, 135.0, 150.0, 180.0, 210.0, 240.0, 270.0, 360.0];
        let usual = |end: f64| {
            let deg = end.to_degrees();
            let near = |usual: &&f64| (deg.abs() - **usual).abs() <= 6e-4 * **usual;
            USUAL.iter().find(near).map(|usual| usual.copysign(deg))
        };
        if !self.name.is_rotary() {
            return None;
        }
        let [low, high] = self.travel;
        Some([usual(low)?, usual(high)?])
    }

    /// Whether the travel of a rotary axis is at least 359 deg: a full turn, which controls also describe as 0 to 359.999 deg.
    pub fn turns_round(&self) -> bool {
        const NEARLY_DEG: f64 = 359.0;
        self.name.is_rotary() && self.travel[1] - self.travel[0] >= NEARLY_DEG
    }

    /// Whether the travel has ends: the axis has no `modulo`, and its travel is less than a full turn.
    pub fn has_ends(&self) -> bool {
        self.modulo.is_none() && !self.turns_round()
    }

    /// The part of the travel, mm or deg, that covers every pose of the axis: for a full turn or more, one turn about the middle of the
    /// travel, otherwise the whole travel.
    pub fn all_poses(&self) -> [f64; 2] {
        let [low, high] = self.travel;
        if self.turns_round() {
            let middle = 0.5 * (low + high);
            return [middle - 180.0, middle + 180.0];
        }
        [low, high]
    }

    /// `count` evenly spaced coordinates over the travel for a grid of poses, mm or deg, including both ends; a count
    /// of 1 gives the middle. For a travel of a full turn or more, the coordinates cover one turn. Its end is omitted,
    /// because that is the same pose as its start.
    pub fn nodes(&self, count: usize) -> Vec<f64> {
        let [low, high] = self.all_poses();
        if count == 1 {
            return vec![0.5 * (low + high)];
        }
        let parts = if self.turns_round() { count } else { count.saturating_sub(1) };
        let node = |place: usize| low + (high - low) * place as f64 / parts as f64;
        (0..count).map(node).collect()
    }

    /// 0, or the end of travel nearest to it, mm or deg.
    pub fn nearest_zero(&self) -> f64 {
        let [low, high] = self.travel;
        0.0_f64.max(low).min(high)
    }

    /// Distance of a coordinate beyond the travel, mm or deg, after reduction by `modulo`; negative within the travel.
    pub fn beyond_travel(&self, coordinate: f64) -> f64 {
        let [low, high] = self.travel;
        let at = self.looked_up(coordinate);
        (low - at).max(at - high)
    }

    /// Whether a coordinate, mm or deg, is within the travel, with a tolerance for rounding.
    pub fn contains(&self, coordinate: f64) -> bool {
        is_within(self.travel, coordinate)
    }

    /// Whether the axis can be at a coordinate, mm or deg: within the travel after reduction by `modulo`, with a tolerance for rounding.
    pub fn may_stand_at(&self, coordinate: f64) -> bool {
        self.contains(self.looked_up(coordinate))
    }

    /// Checks that the axis can be at a coordinate, mm or deg.
    ///
    /// # Errors
    /// A message that starts with "found" and names the coordinate, its unit and the travel.
    pub fn check_coordinate(&self, coordinate: f64) -> Result<(), String> {
        if self.may_stand_at(coordinate) {
            return Ok(());
        }
        let ([low, high], unit) = (self.travel, self.name.kind().coordinate_unit());
        Err(format!(
            "found {coordinate} {unit}, expected a position within the travel of {}, {low} to {high} {unit}",
            self.name
        ))
    }
}

/// The axis in a column header: its letter, alone or with the unit of the coordinates: `X`, `X mm`, `X_mm`, `C [deg]`, `C°`. `None` for other
/// headers. Case matters: `x` is not an axis.
pub fn axis_of_head(head: &str) -> Option<AxisName> {
    let (name, unit) = split_head(head);
    let axis: AxisName = name.parse().ok()?;
    let is_own = unit_named(unit) == Some(axis.kind().coordinate_unit());
    (head == name || is_own).then_some(axis)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(name: AxisName, travel: [f64; 2]) -> Axis {
        Axis {
            name,
            travel,
            modulo: None,
            direction: None,
            point_mm: None,
            motion_frame: MotionFrame::Fixed,
        }
    }

    /// A linear axis has ends at any length. A rotary travel of 0 to 359.999 deg is a full turn.
    #[test]
    fn what_turns_all_the_way_round_has_no_ends() {
        for (name, travel, modulo, has_ends) in [
            (AxisName::X, [0.0, 4000.0], None, true),
            (AxisName::C, [0.0, 350.0], None, true),
            (AxisName::C, [0.0, 350.0], Some(360.0), false),
            (AxisName::C, [0.0, 359.999], None, false),
            (AxisName::C, [-180.0, 180.0], None, false),
            (AxisName::A, [-3600.0, 3600.0], None, false),
        ] {
            let axis = Axis { modulo, ..axis(name, travel) };
            assert_eq!(axis.has_ends(), has_ends, "{axis:?}");
        }
    }

    /// All nodes are at different angles, even if the travel has several turns.
    #[test]
    fn nodes_of_several_turns_are_different_poses() {
        for turns in [1.0, 2.0, 4.0, 8.0, 100.0] {
            for travel in [[-360.0 * turns, 360.0 * turns], [0.0, 360.0 * turns]] {
                let mut nodes = axis(AxisName::C, travel).nodes(8);
                assert!(nodes.iter().all(|at| (travel[0]..=travel[1]).contains(at)));
                for at in &mut nodes {
                    *at = at.rem_euclid(360.0);
                }
                nodes.sort_by(f64::total_cmp);
                assert_eq!(nodes, [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]);
            }
        }
    }

    #[test]
    fn other_axes_have_nodes_from_end_to_end() {
        assert_eq!(axis(AxisName::X, [0.0, 600.0]).nodes(3), [0.0, 300.0, 600.0]);
        assert_eq!(axis(AxisName::A, [-100.0, 30.0]).nodes(2), [-100.0, 30.0]);
        assert_eq!(axis(AxisName::A, [-100.0, 30.0]).nodes(1), [-35.0]);
        assert_eq!(axis(AxisName::X, [0.0, 1.0]).nodes(0), [0.0; 0]);
    }
}
