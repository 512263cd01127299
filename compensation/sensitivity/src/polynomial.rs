//! Sums of products of coordinates, sines, cosines and tool offsets: the lever arms in a formula.

use core::fmt;
use std::collections::BTreeMap;

use volcomp_vocabulary::AxisName;

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

    pub(crate) fn add(&mut self, other: &Self, number: f64) {
        for (factors, &value) in &other.0 {
            self.add_product(factors, value * number);
        }
    }

    pub(crate) fn times(&self, other: &Self) -> Self {
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

    pub(crate) fn is_one(&self) -> bool {
        *self == Self::number(1.0)
    }

    /// Formats the polynomial as a factor, with a sum in parentheses.
    pub(crate) fn as_factor(&self, latex: bool) -> String {
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
