//! Parameters of a search, their values, and the set-up quantities (frames, points, numbers) at a given time.

use std::collections::BTreeMap;

use volcomp_kinematics::{
    Pose,
    nalgebra::{DVector, Matrix3, Vector3},
    rotation_from_vector,
};
use volcomp_vocabulary::{ErrorName, Um, Urad};

use crate::observations::{Part, Quantity, SetUp};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Param {
    SetUp {
        part: Part,
        /// Index of the component in its part.
        place: usize,
        /// Order of the Legendre polynomial over time whose coefficient this parameter is; 0 for the
        /// component itself.
        order: usize,
    },
    Coefficient(usize),
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    pub(crate) param: usize,
    pub(crate) place: usize,
    pub(crate) order: usize,
}

#[derive(Clone, Debug)]
pub(crate) struct Params {
    all: Vec<Param>,
    columns: BTreeMap<Part, Vec<Column>>,
    setup: usize,
    highest_order: usize,
}

/// Parameters of all quantities of one kind, with `numbers` components each. Returns the components, then their drifts.
fn of_kind<T>(
    quantities: &[Quantity<T>],
    part: impl Fn(usize) -> Part,
    numbers: usize,
) -> [Vec<Param>; 2] {
    let mut found = [Vec::new(), Vec::new()];
    for (index, quantity) in quantities.iter().enumerate() {
        let part = part(index);
        for order in 0..=quantity.drift {
            if order > 0 || quantity.unknown {
                let of_order = (0..numbers).map(|place| Param::SetUp { part, place, order });
                found[usize::from(order > 0)].extend(of_order);
            }
        }
    }
    found
}

impl Params {
    /// Parameters of the set-ups and of this number of error coefficients. If some parameters cannot be distinguished,
    /// the earlier ones are kept: components, then drifts, then coefficients.
    pub(crate) fn new(setup: &SetUp, coefficients: usize) -> Self {
        let kinds = [
            of_kind(&setup.frames, Part::Frame, 6),
            of_kind(&setup.numbers, Part::Number, 1),
            of_kind(&setup.points, Part::Point, 3),
        ];
        let parts = |drifts: usize| kinds.iter().flat_map(move |kind| kind[drifts].clone());
        let mut params = Self {
            all: parts(0).chain(parts(1)).collect(),
            columns: BTreeMap::new(),
            setup: 0,
            highest_order: 0,
        };
        params.setup = params.all.len();
        for (column, param) in params.all.iter().enumerate() {
            let Param::SetUp { part, place, order } = *param else {
                continue;
            };
            params.columns.entry(part).or_default().push(Column { param: column, place, order });
            params.highest_order = params.highest_order.max(order);
        }
        params.all.extend((0..coefficients).map(Param::Coefficient));
        params
    }

    pub(crate) fn len(&self) -> usize {
        self.all.len()
    }

    /// Number of set-up parameters; they precede the parameters of the errors.
    pub(crate) fn setup(&self) -> usize {
        self.setup
    }

    pub(crate) fn highest_order(&self) -> usize {
        self.highest_order
    }

    pub(crate) fn at(&self, param: usize) -> Param {
        self.all[param]
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = Param> + '_ {
        self.all.iter().copied()
    }

    pub(crate) fn of(&self, part: Part) -> &[Column] {
        self.columns.get(&part).map_or(&[], Vec::as_slice)
    }
}

pub(crate) fn name_of(setup: &SetUp, part: Part, place: usize, order: usize) -> String {
    const SIX: [&str; 6] = ["x", "y", "z", "a", "b", "c"];
    let name = match part {
        Part::Frame(index) => format!("{}.{}", setup.frames[index].name, SIX[place]),
        Part::Point(index) => format!("{}.{}", setup.points[index].name, SIX[place]),
        Part::Number(index) => setup.numbers[index].name.clone(),
    };
    match order {
        0 => name,
        _ => format!("{name} drift {order}"),
    }
}

/// Unit of a component of a set-up in results, and the factor from mm or rad to this unit.
pub(crate) fn unit_of(
    setup: &SetUp,
    part: Part,
    place: usize,
    order: usize,
) -> (&'static str, f64) {
    match (part, order) {
        (Part::Number(index), _) => {
            let kind = setup.number_kinds.get(index);
            kind.map_or(("mm", 1.0), |kind| kind.unit())
        }
        (Part::Frame(_), 0) if place >= 3 => ("deg", 1.0_f64.to_degrees()),
        (Part::Frame(_) | Part::Point(_), 0) => ("mm", 1.0),
        (Part::Frame(_), _) if place >= 3 => ("urad", 1e6),
        (Part::Frame(_) | Part::Point(_), _) => ("um", 1e3),
    }
}

/// A frame with its drift: the pose of the tracker in workpiece axes.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub(crate) pose: Pose,
    /// Centre of rotation in the search, mm in workpiece axes: the middle of the observed points.
    pub(crate) middle_mm: Vector3<f64>,
    /// Displacement (mm) and rotation (rad) for each Legendre polynomial of the time, from order 1.
    drift: Vec<[f64; 6]>,
}

/// Values of all parameters, mm and rad. Points and numbers have one coefficient for each Legendre polynomial over
/// time; the coefficient of order 0 is the value without drift.
#[derive(Clone, Debug)]
pub(crate) struct Values {
    pub(crate) frames: Vec<Frame>,
    pub(crate) points: Vec<Vec<Vector3<f64>>>,
    pub(crate) numbers: Vec<Vec<f64>>,
    pub(crate) coefficients: Vec<f64>,
    /// Assumed size of the reversal value of each coefficient whose axis has an unknown approach direction. 0 for other
    /// coefficients, and for all coefficients before sizes are estimated.
    pub(crate) reversals: Vec<f64>,
}

impl Values {
    /// Set-ups as stated in the files, with `middle_mm` of the frames at zero.
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

    /// Position of a point, mm, at the time at which the Legendre polynomials have these values.
    pub(crate) fn point_at(&self, place: usize, polynomials: &[f64]) -> Vector3<f64> {
        let terms = self.points[place].iter().zip(polynomials);
        terms.fold(Vector3::zeros(), |sum, (value, p)| sum + value * *p)
    }

    pub(crate) fn number_at(&self, place: usize, polynomials: &[f64]) -> f64 {
        let terms = self.numbers[place].iter().zip(polynomials);
        terms.map(|(value, p)| value * p).sum()
    }

    /// Value of a parameter, mm or rad.
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
    /// Drift of the frame, from the values of the Legendre polynomials at the time of a reading: displacement, mm, and
    /// rotation, rad.
    pub(crate) fn drifted(&self, polynomials: &[f64]) -> [Vector3<f64>; 2] {
        let orders = self.drift.iter().zip(&polynomials[1..]);
        orders.fold([Vector3::zeros(); 2], |[shift, turn], (six, p)| {
            let of = |first: usize| Vector3::new(six[first], six[first + 1], six[first + 2]) * *p;
            [shift + of(0), turn + of(3)]
        })
    }
}

fn in_rad([x, y, z, a, b, c]: [f64; 6]) -> [f64; 6] {
    [x, y, z, a.to_radians(), b.to_radians(), c.to_radians()]
}

/// Pose from x, y, z (mm) and a, b, c (rad): rotation about X by a, then about the fixed Y by b, then about the fixed Z by c.
fn pose_of(&[x, y, z, a, b, c]: &[f64; 6]) -> Pose {
    let about =
        |place: usize, angle: f64| rotation_from_vector(&(Vector3::ith(place, 1.0) * angle));
    Pose {
        rotation: about(2, c) * about(1, b) * about(0, a),
        translation_mm: Vector3::new(x, y, z),
    }
}

/// Inverse of [`pose_of`]: x, y, z (mm) and a, b, c (rad).
pub(crate) fn six_of(pose: &Pose) -> [f64; 6] {
    let r: &Matrix3<f64> = &pose.rotation;
    let t = &pose.translation_mm;
    let b = (-r[(2, 0)]).atan2(r[(0, 0)].hypot(r[(1, 0)]));
    let a = r[(2, 1)].atan2(r[(2, 2)]);
    let c = r[(1, 0)].atan2(r[(0, 0)]);
    [t.x, t.y, t.z, a, b, c]
}

/// Result for one unknown parameter.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Parameter {
    /// Name: `EX0C`, `EXX legendre 2`, `tracker.csv:frame.x`.
    pub name: String,
    /// Error to which the parameter belongs; `None` for a parameter of a set-up.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub error: Option<ErrorName>,
    /// Value in `unit`; 0 if it is not determined.
    pub value: f64,
    /// `um`, `urad`, `mm`, `deg` or `um_per_m`.
    pub unit: &'static str,
    /// Standard uncertainty (k = 1) in `unit`; `None` if it is not determined.
    pub uncertainty: Option<f64>,
    /// Whether the observations determine the parameter.
    pub determined: bool,
    /// Indistinguishable unknowns that were left at zero. The value holds only if they are zero.
    pub given_zero: Vec<String>,
}

/// Display symbol of a unit in a key: `µm/m` for `um_per_m`.
pub fn unit_symbol(unit: &str) -> &str {
    match unit {
        "um" => Um::SYMBOL,
        "urad" => Urad::SYMBOL,
        "um_per_m" => "µm/m",
        other => other,
    }
}
