//! An axis as a machine file states it.

use volcomp_kinematics::MotionFrame;
use volcomp_vocabulary::{AxisName, brought_into, is_within};

/// One axis as the machine file states it.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Axis {
    /// The letter of the axis.
    pub name: AxisName,
    /// Lower and upper end of travel, mm (linear) or deg (rotary).
    pub travel: [f64; 2],
    /// Period that brings a rotary coordinate into travel before curves are looked up, deg.
    pub modulo: Option<f64>,
    /// Direction of positive motion of the tool relative to the workpiece, in the machine coordinate system at machine
    /// zero, of any length; `None`: the direction of the letter.
    pub direction: Option<[f64; 3]>,
    /// A point on the axis line (rotary), or the point of the carriage at which its errors are stated (linear), mm in the
    /// machine coordinate system at machine zero; `None`: the origin.
    pub point_mm: Option<[f64; 3]>,
    /// The frame in which the error motions of a rotary axis stay; that which does not turn for a linear axis, whose
    /// error motions ride with its carriage.
    pub motion_frame: MotionFrame,
}

impl Axis {
    /// The coordinate at which curves are looked up: brought into travel by `modulo`.
    pub(crate) fn looked_up(&self, coordinate: f64) -> f64 {
        match self.modulo {
            Some(period) => brought_into(self.travel, period, coordinate),
            None => coordinate,
        }
    }

    /// The travel in degrees that is meant if the file states that of a rotary axis in radians: where both ends are usual
    /// parts of a circle in radians, to the digits that people write (3.14, 1.571, 6.2832), and not 0.
    pub fn travel_as_if_in_radians(&self) -> Option<[f64; 2]> {
        // deg; what people write of π is off by 0.05 % at the most.
        const USUAL: [f64; 13] = [
            0.0, 30.0, 45.0, 60.0, 90.0, 120.0, 135.0, 150.0, 180.0, 210.0, 240.0, 270.0, 360.0,
        ];
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

    /// 0, or the end of the travel that is nearest to it, mm or deg.
    pub fn nearest_zero(&self) -> f64 {
        let [low, high] = self.travel;
        0.0_f64.max(low).min(high)
    }

    /// How far a coordinate, mm or deg, is beyond the travel, after whole periods of `modulo`; negative within it.
    pub fn beyond_travel(&self, coordinate: f64) -> f64 {
        let [low, high] = self.travel;
        let at = self.looked_up(coordinate);
        (low - at).max(at - high)
    }

    /// Whether a coordinate, mm or deg, lies in the travel, but for rounding.
    pub fn contains(&self, coordinate: f64) -> bool {
        is_within(self.travel, coordinate)
    }

    /// Whether the axis may stand at a coordinate, mm or deg: in its travel but for rounding, after whole periods of `modulo`.
    pub fn may_stand_at(&self, coordinate: f64) -> bool {
        self.contains(self.looked_up(coordinate))
    }

    /// What is wrong with a coordinate at which the axis may not stand, in words that follow "found".
    ///
    /// # Errors
    /// The coordinate, its unit and the travel.
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
