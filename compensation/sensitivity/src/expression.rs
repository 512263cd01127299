//! First-order volumetric error as a formula, each error with its lever arm, as printed in papers.

use core::fmt;
use std::collections::BTreeMap;

use volcomp_kinematics::nalgebra::Vector3;
use volcomp_kinematics::{Chain, ErrorSource, Joint, State};
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName};

use crate::term::{ErrorTerm, twists};

/// Components along X, Y and Z.
type Vector = [Polynomial; 3];

/// Left-hand sides: displacement of the tool tip along X, Y and Z, rotation of the tool about them.
const LEFT: [&str; 6] = ["dX", "dY", "dZ", "dA", "dB", "dC"];

/// Errors that have the same lever arm, except for the sign.
#[derive(Clone, Debug, PartialEq)]
pub struct Grouped {
    /// Lever arm: mm of displacement per rad, or a dimensionless number.
    pub lever: Polynomial,
    /// Errors, each with `true` if its sign is negative.
    pub errors: Vec<(ErrorTerm, bool)>,
}

/// First-order volumetric error of a chain in workpiece axes: six sums of errors times lever arms. Lengths are in mm,
/// angles in rad. The coordinates of the tool tip are `Xt`, `Yt` and `Zt`; a coordinate that is 0 is omitted.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    components: [Vec<Grouped>; 6],
    tool_tip_mm: [f64; 3],
}

impl Expression {
    /// Derives the formula of a chain with these errors; errors of missing axes are omitted.
    pub fn of(chain: &Chain, terms: &[ErrorTerm]) -> Self {
        let made_of: Vec<_> = terms.iter().map(|&term| twists(chain, term)).collect();
        let tip = chain.tool_tip_mm();
        let mut point: Vector = core::array::from_fn(|place| {
            let symbol = Factor::Tool(place);
            Polynomial::factor(symbol, f64::from(u8::from(tip[place] != 0.0)))
        });
        let mut columns: Vec<[Vector; 2]> = vec![<[Vector; 2]>::default(); terms.len()];
        // From the tool to the workpiece, as in the sum of twists.
        for gap in (0..=chain.joints().len()).rev() {
            for (column, twists) in columns.iter_mut().zip(&made_of) {
                for twist in twists.iter().filter(|twist| twist.gap == gap) {
                    let [displacement, rotation] = column;
                    let levered = cross(&twist.angular, &point);
                    for k in 0..3 {
                        displacement[k].add(&Polynomial::number(twist.linear[k]), 1.0);
                        displacement[k].add(&levered[k], 1.0);
                        rotation[k].add(&Polynomial::number(twist.angular[k]), 1.0);
                    }
                }
            }
            let Some(joint) = gap.checked_sub(1).map(|place| &chain.joints()[place]) else {
                continue;
            };
            match joint.kind {
                AxisKind::Linear => {
                    let coordinate = Polynomial::factor(Factor::Coordinate(joint.name), 1.0);
                    for (sum, &u) in point.iter_mut().zip(joint.direction.iter()) {
                        sum.add(&coordinate, u);
                    }
                }
                AxisKind::Rotary => {
                    let turn = turn(joint);
                    shift(&mut point, &joint.point_mm, -1.0);
                    point = turned(&turn, &point);
                    shift(&mut point, &joint.point_mm, 1.0);
                    for part in columns.iter_mut().flatten() {
                        *part = turned(&turn, part);
                    }
                }
            }
        }
        let components = core::array::from_fn(|component| {
            let lever = |column: &[Vector; 2]| column[component / 3][component % 3].clone();
            grouped(terms.iter().copied().zip(columns.iter().map(lever)))
        });
        Self { components, tool_tip_mm: tip.into() }
    }

    /// Errors of each component with their lever arms: displacements along X, Y, Z, then rotations about X, Y, Z.
    pub fn components(&self) -> &[Vec<Grouped>; 6] {
        &self.components
    }

    /// Values of the tool tip coordinates `Xt`, `Yt` and `Zt` in the formula, mm.
    pub fn tool_tip_mm(&self) -> [f64; 3] {
        self.tool_tip_mm
    }

    /// Formats the six formulas, `dX = …` to `dC = …`, in a syntax accepted by Python and spreadsheets.
    pub fn text(&self) -> [String; 6] {
        core::array::from_fn(|place| {
            let sum = written(&self.components[place], false, ErrorTerm::to_string);
            format!("{} = {sum}", LEFT[place])
        })
    }

    /// Formats the six formulas in LaTeX, each with `&` before the equals sign.
    pub fn latex(&self) -> [String; 6] {
        let name = |term: &ErrorTerm| {
            let text = term.to_string();
            let (kind, index) = text.split_at(1);
            format!("{kind}_{{{index}}}")
        };
        core::array::from_fn(|place| {
            let letter = LEFT[place][1..].to_lowercase();
            let sum = written(&self.components[place], true, name);
            format!("\\Delta {letter} &= {sum}")
        })
    }

    /// Evaluates the six formulas at a state, mm and rad, with the errors of `source`.
    pub fn value<S: ErrorSource>(&self, chain: &Chain, source: &S, state: &State) -> [f64; 6] {
        let value_of = |factor: Factor| {
            let at = |axis| chain.structure().index_of(axis).map_or(0.0, |place| state.q[place]);
            match factor {
                Factor::Coordinate(axis) => at(axis),
                Factor::Cos(axis) => at(axis).cos(),
                Factor::Sin(axis) => at(axis).sin(),
                Factor::Tool(place) => self.tool_tip_mm[place.min(2)],
            }
        };
        core::array::from_fn(|component| {
            let group = |group: &Grouped| {
                let signed = |&(term, negative): &(ErrorTerm, bool)| {
                    let error = error_of(chain, source, state, term);
                    if negative { -error } else { error }
                };
                group.lever.value(value_of) * group.errors.iter().map(signed).sum::<f64>()
            };
            self.components[component].iter().map(group).sum()
        })
    }
}

/// Value of an error in a source, mm or rad; 0 if the chain lacks its axis.
fn error_of<S: ErrorSource>(chain: &Chain, source: &S, state: &State, term: ErrorTerm) -> f64 {
    let Some(axis) = chain.structure().index_of(term.axis()) else {
        return 0.0;
    };
    let motion = match term {
        ErrorTerm::Assembly(..) => source.assembly(axis),
        ErrorTerm::Named(ErrorName { location: true, .. }) => source.location(axis),
        ErrorTerm::Named(_) => source.error_motion(axis, state),
    };
    let component = term.component();
    let part = if component.is_angular() { motion.angular_rad } else { motion.linear_mm };
    part[component.mcs_index()]
}

fn cross(a: &Vector3<f64>, b: &Vector) -> Vector {
    core::array::from_fn(|k| {
        let (next, last) = ((k + 1) % 3, (k + 2) % 3);
        let mut sum = Polynomial::default();
        sum.add(&b[last], a[next]);
        sum.add(&b[next], -a[last]);
        sum
    })
}

fn shift(point: &mut Vector, by: &Vector3<f64>, sign: f64) {
    for (sum, &by) in point.iter_mut().zip(by.iter()) {
        sum.add(&Polynomial::number(by), sign);
    }
}

/// Rotation matrix of a rotary axis: u·uᵀ + cos·(I − u·uᵀ) + sin·u^.
fn turn(joint: &Joint) -> [Vector; 3] {
    let u = &joint.direction;
    let hat = u.cross_matrix();
    core::array::from_fn(|row| {
        core::array::from_fn(|column| {
            let along = u[row] * u[column];
            let unit = f64::from(u8::from(row == column));
            let mut sum = Polynomial::number(along);
            sum.add(&Polynomial::factor(Factor::Cos(joint.name), 1.0), unit - along);
            sum.add(&Polynomial::factor(Factor::Sin(joint.name), 1.0), hat[(row, column)]);
            sum
        })
    })
}

fn turned(turn: &[Vector; 3], vector: &Vector) -> Vector {
    core::array::from_fn(|row| {
        let mut sum = Polynomial::default();
        for (entry, part) in turn[row].iter().zip(vector) {
            sum.add(&entry.times(part), 1.0);
        }
        sum
    })
}

/// Groups errors whose lever arms are equal except for the sign, in the order of the first error of each group.
fn grouped(levers: impl Iterator<Item = (ErrorTerm, Polynomial)>) -> Vec<Grouped> {
    let mut groups: Vec<Grouped> = Vec::new();
    for (term, lever) in levers.filter(|(_, lever)| !lever.is_zero()) {
        let (lever, negative) = lever.positive();
        match groups.iter_mut().find(|group| group.lever == lever) {
            Some(group) => group.errors.push((term, negative)),
            None => groups.push(Grouped { lever, errors: vec![(term, negative)] }),
        }
    }
    groups
}

/// Formats a sum of errors times lever arms; `name` formats an error.
fn written(groups: &[Grouped], latex: bool, name: impl Fn(&ErrorTerm) -> String) -> String {
    let mut text = String::new();
    let mut add = |negative: bool, what: &str| {
        text += match (text.is_empty(), negative) {
            (true, false) => "",
            (true, true) => "-",
            (false, false) => " + ",
            (false, true) => " - ",
        };
        text += what;
    };
    for group in groups {
        if group.lever.is_one() {
            for (term, negative) in &group.errors {
                add(*negative, &name(term));
            }
            continue;
        }
        // The sign of the first error is written before the lever arm.
        let turned = group.errors.first().is_some_and(|(_, negative)| *negative);
        let mut sum = String::new();
        for (place, (term, negative)) in group.errors.iter().enumerate() {
            if place > 0 {
                sum += if *negative == turned { " + " } else { " - " };
            }
            sum += &name(term);
        }
        if group.errors.len() > 1 {
            sum = format!("({sum})");
        }
        let times = if latex { "\\," } else { "*" };
        add(turned, &format!("{}{times}{sum}", group.lever.as_factor(latex)));
    }
    if text.is_empty() { "0".to_owned() } else { text }
}

/// A factor of a product in a lever arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Factor {
    /// The coordinate of a linear axis, mm: `x`.
    Coordinate(AxisName),
    /// The cosine of the coordinate of a rotary axis: `cos(a)`.
    Cos(AxisName),
    /// The sine of the coordinate of a rotary axis: `sin(a)`.
    Sin(AxisName),
    /// X, Y or Z coordinate (0, 1, 2) of the tool tip at machine zero, mm: `Xt`.
    Tool(usize),
}

impl Factor {
    fn letter(axis: AxisName) -> char {
        axis.letter().to_ascii_lowercase()
    }

    fn latex(self) -> String {
        match self {
            Self::Coordinate(axis) => Self::letter(axis).to_string(),
            Self::Cos(axis) => format!("\\cos {}", Self::letter(axis)),
            Self::Sin(axis) => format!("\\sin {}", Self::letter(axis)),
            Self::Tool(place) => format!("{}_t", ['X', 'Y', 'Z'][place.min(2)]),
        }
    }
}

impl fmt::Display for Factor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Coordinate(axis) => write!(f, "{}", Self::letter(axis)),
            Self::Cos(axis) => write!(f, "cos({})", Self::letter(axis)),
            Self::Sin(axis) => write!(f, "sin({})", Self::letter(axis)),
            Self::Tool(place) => write!(f, "{}t", ['X', 'Y', 'Z'][place.min(2)]),
        }
    }
}

/// A sum of products with numeric coefficients; no factor is repeated in a product.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Polynomial(BTreeMap<Vec<Factor>, f64>);

impl Polynomial {
    pub(crate) fn number(value: f64) -> Self {
        let mut sum = Self::default();
        sum.add_product(&[], value);
        sum
    }

    pub(crate) fn factor(factor: Factor, value: f64) -> Self {
        let mut sum = Self::default();
        sum.add_product(&[factor], value);
        sum
    }

    /// Whether the polynomial is zero: it has no products.
    pub fn is_zero(&self) -> bool {
        self.0.is_empty()
    }

    /// Products, each with its coefficient.
    pub fn products(&self) -> impl Iterator<Item = (&[Factor], f64)> {
        self.0.iter().map(|(factors, &number)| (&factors[..], number))
    }

    fn add_product(&mut self, factors: &[Factor], value: f64) {
        if value == 0.0 {
            return;
        }
        let sum = self.0.entry(factors.to_vec()).or_insert(0.0);
        *sum += value;
        // Cancellation is exact, because the numbers are equal with opposite signs.
        if *sum == 0.0 {
            self.0.remove(factors);
        }
    }

    fn add(&mut self, other: &Self, number: f64) {
        for (factors, &value) in &other.0 {
            self.add_product(factors, value * number);
        }
    }

    fn times(&self, other: &Self) -> Self {
        let mut product = Self::default();
        for (left, &a) in &self.0 {
            for (right, &b) in &other.0 {
                let mut factors: Vec<Factor> = left.iter().chain(right).copied().collect();
                factors.sort_unstable();
                product.add_product(&factors, a * b);
            }
        }
        product
    }

    /// Evaluates the sum; `value_of` returns the value of a factor.
    pub fn value(&self, value_of: impl Fn(Factor) -> f64) -> f64 {
        let product = |(factors, number): (&Vec<Factor>, &f64)| {
            factors.iter().fold(*number, |product, &factor| product * value_of(factor))
        };
        self.0.iter().map(product).sum()
    }

    /// Products in reading order, with the constant last.
    fn ordered(&self) -> Vec<(&[Factor], f64)> {
        let mut products: Vec<_> = self.products().collect();
        products.sort_by_key(|(factors, _)| factors.is_empty());
        products
    }

    /// Returns the polynomial or its negative, whichever has a positive first coefficient, and whether it was negated.
    pub(crate) fn positive(mut self) -> (Self, bool) {
        let negative = self.ordered().first().is_some_and(|(_, number)| *number < 0.0);
        if negative {
            for number in self.0.values_mut() {
                *number = -*number;
            }
        }
        (self, negative)
    }

    fn is_one(&self) -> bool {
        *self == Self::number(1.0)
    }

    /// Formats the polynomial as a factor, with a sum in parentheses.
    fn as_factor(&self, latex: bool) -> String {
        let text = if latex { self.latex() } else { self.to_string() };
        if self.0.len() > 1 { format!("({text})") } else { text }
    }

    /// Writes the polynomial as a LaTeX formula.
    pub fn latex(&self) -> String {
        self.written("\\,", Factor::latex)
    }

    fn written(&self, times: &str, name: impl Fn(Factor) -> String) -> String {
        let mut text = String::new();
        for (place, (factors, number)) in self.ordered().into_iter().enumerate() {
            text += match (place, number < 0.0) {
                (0, false) => "",
                (0, true) => "-",
                (_, false) => " + ",
                (_, true) => " - ",
            };
            let mut parts: Vec<String> = factors.iter().map(|&factor| name(factor)).collect();
            let size = number.abs();
            if size != 1.0 || parts.is_empty() {
                // Write all digits: the formula must be as accurate as the model.
                parts.insert(0, size.to_string());
            }
            text += &parts.join(times);
        }
        if text.is_empty() { "0".to_owned() } else { text }
    }
}

impl fmt::Display for Polynomial {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.written("*", |factor| factor.to_string()))
    }
}
