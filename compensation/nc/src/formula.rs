//! Formulas with round brackets, as other languages than RS-274 have them; what their operands are each language says.

use crate::{
    expression::{Operator, Read, finite, operate},
    fault::Fault,
    number::Digits,
    parameters::Value,
    scan::Scanner,
};

/// Brackets in brackets, so many at the most.
const DEEPEST: u32 = 50;

/// Operators that bind equally, and their names.
type Equals = &'static [(&'static str, Operator)];

/// Functions of one value and of two, and their names.
type Functions = &'static [(&'static str, fn(f64) -> f64)];
type Pairs = &'static [(&'static str, fn(f64, f64) -> f64)];

/// What the formulas of a language are made of.
pub(crate) trait Formulas {
    /// The operators, those that bind the least first.
    const OPERATORS: &'static [Equals];
    /// The functions of one value and their names; those of two are in [`Self::PAIRS`].
    const FUNCTIONS: Functions;
    const PAIRS: Pairs;

    /// A number without a sign.
    fn number(&self, scanner: &mut Scanner<'_>) -> Option<(f64, u8)>;
    /// A parameter or a constant, in so many brackets; `None`: there is none.
    fn parameter(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Option<Value>, Fault>;

    /// The value that begins here; `None`: there is none. A plain number keeps its decimals.
    fn read(&self, scanner: &mut Scanner<'_>) -> Result<Option<Read>, Fault> {
        let before = scanner.at();
        let sign = match scanner.peek() {
            Some(sign @ (b'+' | b'-')) => {
                scanner.next();
                Some(sign)
            }
            _ => None,
        };
        let number = self.number(scanner);
        let end = scanner.at();
        // `2*R1` begins with a number, but is none.
        if let Some((value, decimals)) = number
            && self.operator(scanner, Self::OPERATORS).is_none()
        {
            scanner.go_to(end);
            let value = if sign == Some(b'-') { -value } else { value };
            return Ok(Some(Read {
                value: Some(value),
                decimals: Some(decimals),
            }));
        }
        scanner.go_to(before);
        let value = self.operation(scanner, 0, 0)?;
        Ok(value.map(|value| Read {
            value,
            decimals: None,
        }))
    }

    /// Passes one of these operators.
    fn operator(&self, scanner: &mut Scanner<'_>, of: &[Equals]) -> Option<Operator> {
        let mut all = of.iter().flat_map(|equals| equals.iter());
        let found = all.find(|(name, _)| takes_name(scanner, name));
        found.map(|(_, operator)| *operator)
    }

    /// Operators of one strength, from the left; between them what binds more strongly.
    fn operation(
        &self,
        scanner: &mut Scanner<'_>,
        strength: usize,
        depth: u32,
    ) -> Result<Option<Value>, Fault> {
        let Some(equals) = Self::OPERATORS.get(strength) else {
            return self.operand(scanner, depth);
        };
        let Some(mut value) = self.operation(scanner, strength + 1, depth)? else {
            return Ok(None);
        };
        loop {
            scanner.peek();
            let column = scanner.column();
            let Some(operator) = self.operator(scanner, &[equals]) else {
                return Ok(Some(value));
            };
            let other = self.operation(scanner, strength + 1, depth)?;
            let other = other.ok_or(Fault::Expression {
                column,
                what: "expected a number, a parameter or a function after this operator",
            })?;
            value = match (value, other) {
                (Some(a), Some(b)) => Some(operate(operator, a, b, column)?),
                _ => None,
            };
        }
    }

    fn operand(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Option<Value>, Fault> {
        if depth > DEEPEST {
            return Err(Fault::Expression {
                column: scanner.column(),
                what: "the expression is nested too deeply",
            });
        }
        if let Some((value, _)) = self.number(scanner) {
            return Ok(Some(Some(value)));
        }
        match scanner.peek() {
            Some(sign @ (b'+' | b'-')) => {
                scanner.next();
                let value = self.operand(scanner, depth + 1)?;
                return Ok(value.map(|value| value.map(|x| if sign == b'-' { -x } else { x })));
            }
            Some(b'(') => {
                scanner.next();
                return self.bracket(scanner, depth + 1).map(Some);
            }
            _ => {}
        }
        let column = scanner.column();
        let mut functions = Self::FUNCTIONS.iter();
        if let Some((_, function)) = functions.find(|(name, _)| takes_name(scanner, name)) {
            let x = self.argument(scanner, depth + 1)?;
            let value = x.map(|x| finite(function(x), column)).transpose()?;
            return Ok(Some(value));
        }
        let mut pairs = Self::PAIRS.iter();
        if let Some((_, function)) = pairs.find(|(name, _)| takes_name(scanner, name)) {
            let [a, b] = self.arguments(scanner, depth + 1)?;
            let value = a.zip(b).map(|(a, b)| finite(function(a, b), column));
            return Ok(Some(value.transpose()?));
        }
        self.parameter(scanner, depth + 1)
    }

    /// The argument of a function: in brackets, or an operand.
    fn argument(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Value, Fault> {
        let column = scanner.column();
        let value = self.operand(scanner, depth)?;
        value.ok_or(Fault::Expression {
            column,
            what: "expected the argument of the function here",
        })
    }

    /// Two arguments in brackets.
    fn arguments(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<[Value; 2], Fault> {
        let wrong = |column| Fault::Expression {
            column,
            what: "expected two arguments: (1, 2)",
        };
        if !scanner.takes(b'(') {
            return Err(wrong(scanner.column()));
        }
        let first = self.operation(scanner, 0, depth)?;
        if !scanner.takes(b',') {
            return Err(wrong(scanner.column()));
        }
        let second = self.operation(scanner, 0, depth)?;
        let (Some(first), Some(second), true) = (first, second, scanner.takes(b')')) else {
            return Err(wrong(scanner.column()));
        };
        Ok([first, second])
    }

    /// What is in brackets, the first of which is passed.
    fn bracket(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Value, Fault> {
        let value = self.operation(scanner, 0, depth)?;
        match (value, scanner.takes(b')')) {
            (Some(value), true) => Ok(value),
            _ => Err(Fault::Expression {
                column: scanner.column(),
                what: "expected a value or an operator, and ) behind them",
            }),
        }
    }
}

/// Passes this name where it is next and no letter or digit goes on with it.
pub(crate) fn takes_name(scanner: &mut Scanner<'_>, name: &str) -> bool {
    scanner.peek();
    let at = scanner.at();
    let rest = scanner.bytes().get(at..).unwrap_or_default();
    let is_next = rest
        .get(..name.len())
        .is_some_and(|next| next.eq_ignore_ascii_case(name.as_bytes()));
    let is_letter = name.ends_with(|c: char| c.is_ascii_alphanumeric());
    let goes_on = rest
        .get(name.len())
        .is_some_and(|byte| byte.is_ascii_alphanumeric() || *byte == b'_');
    if !is_next || is_letter && goes_on {
        return false;
    }
    scanner.go_to(at + name.len());
    true
}

/// A decimal number without a sign and without blanks in it, and its decimals; `points` are the characters that stand for the
/// decimal point.
pub(crate) fn plain_number(scanner: &mut Scanner<'_>, points: &[u8]) -> Option<(f64, u8)> {
    scanner.peek();
    let at = scanner.at();
    let rest = scanner.bytes().get(at..).unwrap_or_default();
    let mut digits = Digits::default();
    let mut length = 0;
    for byte in rest {
        let byte = if points.contains(byte) { b'.' } else { *byte };
        let is_point = byte == b'.' && points.is_empty();
        if is_point || !digits.take(byte) {
            break;
        }
        length += 1;
    }
    let value = digits.value()?;
    scanner.go_to(at + length);
    Some((value, digits.decimals()))
}
