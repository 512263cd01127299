//! The parameters of a search: numbers of the set-ups, how they drift, and coefficients of errors.

use crate::observations::{Quantity, SetUp};

/// A frame, a point or a number of a set-up, by its place among those of its kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Part {
    /// Six numbers: small displacements along the axes (mm), then rotations about them (rad).
    Frame(usize),
    /// Three coordinates, mm.
    Point(usize),
    /// One number, mm or mm/mm.
    Number(usize),
}

/// What one parameter is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Param {
    /// A component of a part of a set-up.
    SetUp {
        part: Part,
        /// Which of its numbers.
        place: usize,
        /// 0: the number itself; above: how it grows with the Legendre polynomial of this order over time.
        order: usize,
    },
    /// A coefficient of an error.
    Coefficient(usize),
}

/// Where a component of a part stands among all parameters.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    pub(crate) param: usize,
    pub(crate) place: usize,
    pub(crate) order: usize,
}

/// All parameters, and where those of each part stand.
#[derive(Clone, Debug)]
pub(crate) struct Params {
    all: Vec<Param>,
    frames: Vec<Vec<Column>>,
    points: Vec<Vec<Column>>,
    numbers: Vec<Vec<Column>>,
    setup: usize,
    highest_order: usize,
}

/// What is to be found of the parts of one kind with so many numbers each: the numbers themselves, and their drifts.
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
    /// The parameters of the set-ups and of so many coefficients, in the order in which they are kept where some cannot be
    /// told apart: numbers before drifts before coefficients.
    pub(crate) fn new(setup: &SetUp, coefficients: usize) -> Self {
        let kinds = [
            of_kind(&setup.frames, Part::Frame, 6),
            of_kind(&setup.numbers, Part::Number, 1),
            of_kind(&setup.points, Part::Point, 3),
        ];
        let parts = |drifts: usize| kinds.iter().flat_map(move |kind| kind[drifts].clone());
        let mut params = Self {
            all: parts(0).chain(parts(1)).collect(),
            frames: vec![Vec::new(); setup.frames.len()],
            points: vec![Vec::new(); setup.points.len()],
            numbers: vec![Vec::new(); setup.numbers.len()],
            setup: 0,
            highest_order: 0,
        };
        params.setup = params.all.len();
        for (column, param) in params.all.iter().enumerate() {
            let Param::SetUp { part, place, order } = *param else {
                continue;
            };
            let columns = match part {
                Part::Frame(index) => &mut params.frames[index],
                Part::Point(index) => &mut params.points[index],
                Part::Number(index) => &mut params.numbers[index],
            };
            columns.push(Column {
                param: column,
                place,
                order,
            });
            params.highest_order = params.highest_order.max(order);
        }
        params.all.extend((0..coefficients).map(Param::Coefficient));
        params
    }

    pub(crate) fn len(&self) -> usize {
        self.all.len()
    }

    /// How many belong to the set-ups: these stand before those of the errors.
    pub(crate) fn setup(&self) -> usize {
        self.setup
    }

    /// The highest order of a drift.
    pub(crate) fn highest_order(&self) -> usize {
        self.highest_order
    }

    pub(crate) fn at(&self, param: usize) -> Param {
        self.all[param]
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = Param> + '_ {
        self.all.iter().copied()
    }

    /// Where the numbers of a part stand.
    pub(crate) fn of(&self, part: Part) -> &[Column] {
        match part {
            Part::Frame(index) => &self.frames[index],
            Part::Point(index) => &self.points[index],
            Part::Number(index) => &self.numbers[index],
        }
    }
}

/// The name of a number of a set-up in answers.
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

/// The unit of a number of a set-up in answers, and its number for one mm or rad.
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
