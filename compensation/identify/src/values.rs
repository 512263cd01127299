//! The values of all parameters, and what they make of frames, points and numbers at a time.

use volcomp_kinematics::{
    Pose,
    nalgebra::{DVector, Matrix3, Vector3},
    rotation_from_vector,
};

use crate::{
    observations::SetUp,
    params::{Param, Params, Part},
};

/// A frame with its drift: the pose of the tracker in workpiece axes.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub(crate) pose: Pose,
    /// The point about which it turns, mm in workpiece axes: the middle of what it saw.
    pub(crate) middle_mm: Vector3<f64>,
    /// Displacement (mm) and rotation (rad) for each Legendre polynomial of the time, from order 1.
    drift: Vec<[f64; 6]>,
}

/// The values of all parameters, mm and rad. Points and numbers have a value for each Legendre polynomial of the time: that
/// of order 0 is what does not drift.
#[derive(Clone, Debug)]
pub(crate) struct Values {
    pub(crate) frames: Vec<Frame>,
    pub(crate) points: Vec<Vec<Vector3<f64>>>,
    pub(crate) numbers: Vec<Vec<f64>>,
    pub(crate) coefficients: Vec<f64>,
    /// How large the reversal value of each coefficient may be where it is not known from which side its axis came; 0 of the
    /// others, and of all before they are looked for.
    pub(crate) reversals: Vec<f64>,
}

impl Values {
    /// What the files state of the set-ups; the middle of the frames at zero.
    pub(crate) fn stated(setup: &SetUp, coefficients: Vec<f64>) -> Self {
        let frames = setup.frames.iter().map(|frame| Frame {
            pose: pose_of(&in_rad(frame.value.unwrap_or_default())),
            middle_mm: Vector3::zeros(),
            drift: vec![[0.0; 6]; frame.drift],
        });
        let points = setup.points.iter().map(|point| {
            let mut values = vec![Vector3::zeros(); point.drift + 1];
            values[0] = Vector3::from(point.value.unwrap_or_default());
            values
        });
        let numbers = setup.numbers.iter().map(|number| {
            let mut values = vec![0.0; number.drift + 1];
            values[0] = number.value.unwrap_or_default();
            values
        });
        Self {
            frames: frames.collect(),
            points: points.collect(),
            numbers: numbers.collect(),
            reversals: vec![0.0; coefficients.len()],
            coefficients,
        }
    }

    /// A point at the time of these Legendre polynomials, mm.
    pub(crate) fn point_at(&self, place: usize, polynomials: &[f64]) -> Vector3<f64> {
        let terms = self.points[place].iter().zip(polynomials);
        terms.fold(Vector3::zeros(), |sum, (value, p)| sum + value * *p)
    }

    /// A number at the time of these Legendre polynomials.
    pub(crate) fn number_at(&self, place: usize, polynomials: &[f64]) -> f64 {
        let terms = self.numbers[place].iter().zip(polynomials);
        terms.map(|(value, p)| value * p).sum()
    }

    /// The value of a parameter, mm or rad.
    pub(crate) fn of(&self, param: Param) -> f64 {
        match param {
            Param::Coefficient(coefficient) => self.coefficients[coefficient],
            Param::SetUp { part, place, order } => match (part, order) {
                (Part::Frame(index), 0) => six_of(&self.frames[index].pose)[place],
                (Part::Frame(index), _) => self.frames[index].drift[order - 1][place],
                (Part::Point(index), _) => self.points[index][order][place],
                (Part::Number(index), _) => self.numbers[index][order],
            },
        }
    }

    /// Values moved by a step in the parameters.
    pub(crate) fn moved(&self, params: &Params, step: &DVector<f64>) -> Self {
        let mut moved = self.clone();
        let mut turns = vec![[0.0; 6]; moved.frames.len()];
        for (param, &by) in params.iter().zip(step) {
            match param {
                Param::SetUp { part, place, order } => match (part, order) {
                    (Part::Frame(index), 0) => turns[index][place] += by,
                    (Part::Frame(index), _) => moved.frames[index].drift[order - 1][place] += by,
                    (Part::Point(index), _) => moved.points[index][order][place] += by,
                    (Part::Number(index), _) => moved.numbers[index][order] += by,
                },
                Param::Coefficient(coefficient) => moved.coefficients[coefficient] += by,
            }
        }
        for (frame, six) in moved.frames.iter_mut().zip(turns) {
            let turn = rotation_from_vector(&Vector3::new(six[3], six[4], six[5]));
            let shift = Vector3::new(six[0], six[1], six[2]);
            frame.pose = Pose {
                rotation: turn * frame.pose.rotation,
                translation_mm: frame.middle_mm
                    + turn * (frame.pose.translation_mm - frame.middle_mm)
                    + shift,
            };
        }
        moved
    }
}

impl Frame {
    /// How far it has drifted at the time of these Legendre polynomials: displacement, mm, and rotation, rad.
    pub(crate) fn drifted(&self, polynomials: &[f64]) -> [Vector3<f64>; 2] {
        let orders = self.drift.iter().zip(&polynomials[1..]);
        orders.fold([Vector3::zeros(); 2], |[shift, turn], (six, p)| {
            let of = |first: usize| Vector3::new(six[first], six[first + 1], six[first + 2]) * *p;
            [shift + of(0), turn + of(3)]
        })
    }
}

/// A frame as a file states it, its angles in rad instead of deg.
fn in_rad([x, y, z, a, b, c]: [f64; 6]) -> [f64; 6] {
    [x, y, z, a.to_radians(), b.to_radians(), c.to_radians()]
}

/// A frame from x, y, z (mm) and a, b, c (rad): turned about X by a, then about the fixed Y by b, then about the
/// fixed Z by c.
fn pose_of(&[x, y, z, a, b, c]: &[f64; 6]) -> Pose {
    let about =
        |place: usize, angle: f64| rotation_from_vector(&(Vector3::ith(place, 1.0) * angle));
    Pose {
        rotation: about(2, c) * about(1, b) * about(0, a),
        translation_mm: Vector3::new(x, y, z),
    }
}

/// The inverse of [`pose_of`].
pub(crate) fn six_of(pose: &Pose) -> [f64; 6] {
    let r: &Matrix3<f64> = &pose.rotation;
    let t = &pose.translation_mm;
    let b = (-r[(2, 0)]).atan2(r[(0, 0)].hypot(r[(1, 0)]));
    let a = r[(2, 1)].atan2(r[(2, 2)]);
    let c = r[(1, 0)].atan2(r[(0, 0)]);
    [t.x, t.y, t.z, a, b, c]
}
