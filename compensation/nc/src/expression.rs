//! Numbers, parameters and formulas: in square brackets after the letter of a word (RS-274), in round ones (SINUMERIK, HEIDENHAIN). Angles
//! are in degrees.

use std::cell::Cell;

use crate::{
    block::Scanner,
    codes::whole,
    coordinates::Axes,
    error::{Column, Fault},
    interpreter::{Interpreter, axis_of_name, axis_of_place},
    number::Digits,
    parameters::{HAS_RETURNED, MOST, RETURNED, Value},
};

const MAX_CALL_DEPTH: u32 = 50;

/// Value of a word, and the decimals if it is a plain number (`None`: computed).
pub(crate) type WordValue = (Value, Option<u8>);

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Reads {
    /// Axes whose positions were read; the control reads corrected positions.
    pub(crate) axes: Axes<bool>,
    pub(crate) returned: bool,
}

type Functions = &'static [(&'static str, fn(f64) -> f64)];
const FUNCTIONS: Functions = &[
    ("ABS", f64::abs),
    ("ACOS", |x| x.acos().to_degrees()),
    ("ASIN", |x| x.asin().to_degrees()),
    ("COS", |x| x.to_radians().cos()),
    ("EXP", f64::exp),
    ("LN", f64::ln),
    ("SIN", |x| x.to_radians().sin()),
    ("SQRT", f64::sqrt),
    ("TAN", |x| x.to_radians().tan()),
];
const RS274_FUNCTIONS: Functions =
    &[("FIX", f64::floor), ("FUP", f64::ceil), ("ROUND", f64::round)];

/// Operators grouped by precedence, the strongest last.
const OPERATORS: [&[(&str, Operator)]; 5] = [
    &[("AND", Operator::And), ("XOR", Operator::Xor), ("OR", Operator::Or)],
    &[
        ("EQ", Operator::Equal),
        ("NE", Operator::NotEqual),
        ("GT", Operator::Greater),
        ("GE", Operator::GreaterOrEqual),
        ("LT", Operator::Less),
        ("LE", Operator::LessOrEqual),
    ],
    &[("+", Operator::Plus), ("-", Operator::Minus)],
    &[("*", Operator::Times), ("/", Operator::Over), ("MOD", Operator::Modulo)],
    &[("**", Operator::Power)],
];

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Operator {
    And,
    Xor,
    Or,
    Equal,
    NotEqual,
    Greater,
    GreaterOrEqual,
    Less,
    LessOrEqual,
    Plus,
    Minus,
    Times,
    Over,
    Modulo,
    Power,
    /// Integer quotient.
    WholeOver,
    /// Remainder, with the sign of the dividend.
    Rest,
}

/// Evaluates the values of a block; parameters have their values from before the block.
pub(crate) struct Expressions<'p> {
    interpreter: &'p Interpreter,
    pub(crate) reads: Cell<Reads>,
}

impl<'p> Expressions<'p> {
    pub(crate) fn new(interpreter: &'p Interpreter) -> Self {
        Self { interpreter, reads: Cell::default() }
    }

    fn reads_place(&self, axis: Option<usize>) {
        if let Some(axis) = axis {
            let mut reads = self.reads.get();
            reads.axes[axis] = true;
            self.reads.set(reads);
        }
    }

    /// Reads the value at the cursor; `None` without one.
    pub(crate) fn read(&self, scanner: &mut Scanner<'_>) -> Result<Option<WordValue>, Fault> {
        if let Some((value, decimals)) = scanner.number() {
            return Ok(Some((Some(value), Some(decimals))));
        }
        let value = self.value(scanner, 0)?;
        Ok(value.map(|value| (value, None)))
    }

    fn value(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Option<Value>, Fault> {
        if let Some((value, _)) = scanner.number() {
            return Ok(Some(Some(value)));
        }
        let column = scanner.column();
        if depth > MAX_CALL_DEPTH {
            return Err(column.malformed("the expression is nested too deeply"));
        }
        match scanner.peek() {
            Some(b'[') => {
                scanner.next();
                self.bracket(scanner, depth + 1).map(Some)
            }
            Some(b'#') => {
                scanner.next();
                self.parameter(scanner, depth + 1).map(Some)
            }
            Some(sign @ (b'+' | b'-')) => {
                scanner.next();
                let value = self.value(scanner, depth + 1)?;
                Ok(value.map(|value| value.map(|x| if sign == b'-' { -x } else { x })))
            }
            Some(b'A'..=b'Z') => self.function(scanner, depth + 1),
            _ => Ok(None),
        }
    }

    fn bracket(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Value, Fault> {
        let value = self.operation(scanner, 0, depth)?;
        if scanner.takes(b']') {
            return Ok(value);
        }
        Err(scanner.column().malformed("expected an operator or ] here"))
    }

    /// Evaluates the left-associative operators of precedence `strength`; their operands are of higher precedence.
    fn operation(
        &self,
        scanner: &mut Scanner<'_>,
        strength: usize,
        depth: u32,
    ) -> Result<Value, Fault> {
        let Some(operators) = OPERATORS.get(strength) else {
            let column = scanner.column();
            let value = self.value(scanner, depth)?;
            return value
                .ok_or(column.malformed("expected a number, a parameter or a function here"));
        };
        let mut value = self.operation(scanner, strength + 1, depth)?;
        loop {
            let column = scanner.column();
            let before = scanner.at();
            let found = operators.iter().find(|(letters, _)| scanner.takes_all(letters));
            let Some((_, operator)) = found else {
                return Ok(value);
            };
            if *operator == Operator::Times && scanner.peek() == Some(b'*') {
                // The power operator binds more strongly: leave it to the next level.
                scanner.go_to(before);
                return Ok(value);
            }
            let other = self.operation(scanner, strength + 1, depth)?;
            value = match (value, other) {
                (Some(a), Some(b)) => Some(operate(*operator, a, b, column)?),
                _ => None,
            };
        }
    }

    fn parameter(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Value, Fault> {
        if scanner.takes(b'<') {
            let name = scanner.name()?;
            return self.named(&name).ok_or(Fault::NoParameter { name });
        }
        Ok(match self.parameter_number(scanner, depth)? {
            Some(number) => {
                let interpreter = self.interpreter;
                self.reads_place(axis_of_place(number));
                let provided = interpreter.numbered(number);
                provided.unwrap_or_else(|| interpreter.parameters.numbered(number))
            }
            None => None,
        })
    }

    fn named(&self, name: &str) -> Option<Value> {
        if name == RETURNED || name == HAS_RETURNED {
            let mut reads = self.reads.get();
            reads.returned = true;
            self.reads.set(reads);
        }
        let set = self.interpreter.parameters.named(name);
        set.or_else(|| {
            self.reads_place(axis_of_name(name));
            self.interpreter.provided(name)
        })
    }

    /// Reads the number of a parameter after its `#`; `None` if it is only known at the machine.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the range was checked before"
    )]
    pub(crate) fn parameter_number(
        &self,
        scanner: &mut Scanner<'_>,
        depth: u32,
    ) -> Result<Option<u32>, Fault> {
        let column = scanner.column();
        let wrong = || {
            column.malformed(
                "expected the number of a parameter, 1 to 99999, or its name between < and >",
            )
        };
        let Some(number) = self.value(scanner, depth)?.ok_or_else(wrong)? else {
            return Ok(None);
        };
        let whole = number.round();
        if (number - whole).abs() > 1e-4 || !(1.0..f64::from(MOST)).contains(&whole) {
            return Err(wrong());
        }
        Ok(Some(whole as u32))
    }

    fn function(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Option<Value>, Fault> {
        let column = scanner.column();
        let special = ["ATAN", "EXISTS"];
        let special = special.into_iter().find(|name| scanner.takes_all(name));
        let mut functions = FUNCTIONS.iter().chain(RS274_FUNCTIONS);
        let function = match special {
            Some(_) => None,
            None => match functions.find(|(name, _)| scanner.takes_all(name)) {
                Some((_, function)) => Some(function),
                None => return Ok(None),
            },
        };
        if !scanner.takes(b'[') {
            return Err(scanner.column().malformed("expected [ after the name of a function"));
        }
        if special == Some("EXISTS") {
            let is_named = scanner.takes_all("#<");
            let exists = is_named && self.named(&scanner.name()?).is_some();
            if !is_named || !scanner.takes(b']') {
                return Err(column.malformed("expected EXISTS[#<name>]"));
            }
            return Ok(Some(Some(f64::from(u8::from(exists)))));
        }
        let value = self.bracket(scanner, depth)?;
        let Some(function) = function else {
            if !scanner.takes_all("/[") {
                return Err(column.malformed("expected ATAN[y]/[x]"));
            }
            let x = self.bracket(scanner, depth)?;
            return Ok(Some(value.zip(x).map(|(y, x)| y.atan2(x).to_degrees())));
        };
        let value = value.map(|x| finite(function(x), column)).transpose()?;
        Ok(Some(value))
    }
}

pub(crate) fn finite(value: f64, column: Column) -> Result<f64, Fault> {
    if value.is_finite() {
        return Ok(value);
    }
    Err(column.malformed(
        "this calculation has no result (a division by zero, or a function outside its range)",
    ))
}

pub(crate) fn operate(operator: Operator, a: f64, b: f64, column: Column) -> Result<f64, Fault> {
    let truth = |truth: bool| f64::from(u8::from(truth));
    // Tolerance for the rounding of computed numbers.
    let equal = (a - b).abs() < 1e-6;
    let value = match operator {
        Operator::And => truth(a != 0.0 && b != 0.0),
        Operator::Or => truth(a != 0.0 || b != 0.0),
        Operator::Xor => truth((a != 0.0) != (b != 0.0)),
        Operator::Equal => truth(equal),
        Operator::NotEqual => truth(!equal),
        Operator::Greater => truth(a > b),
        Operator::GreaterOrEqual => truth(a >= b),
        Operator::Less => truth(a < b),
        Operator::LessOrEqual => truth(a <= b),
        Operator::Plus => a + b,
        Operator::Minus => a - b,
        Operator::Times => a * b,
        Operator::Over => a / b,
        Operator::Modulo => {
            // The result is never negative.
            let rest = a % b;
            if rest < 0.0 { rest + b.abs() } else { rest }
        }
        Operator::Power => a.powf(b),
        Operator::WholeOver => (a / b).trunc(),
        Operator::Rest => a % b,
    };
    finite(value, column)
}

type Equals = &'static [(&'static str, Operator)];

type Pairs = &'static [(&'static str, fn(f64, f64) -> f64)];

pub(crate) trait Formulas {
    /// Operators, the weakest precedence first.
    const OPERATORS: &'static [Equals];
    /// Functions of one argument in addition to the common ones; functions of two arguments are in [`Self::PAIRS`].
    const FUNCTIONS: Functions;
    const PAIRS: Pairs;

    /// Reads an unsigned number; returns its value and number of decimals, `None` without a number.
    fn number(&self, scanner: &mut Scanner<'_>) -> Option<(f64, u8)>;
    /// Reads a parameter or a constant at this bracket depth; `None` without one.
    fn parameter(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Option<Value>, Fault>;

    /// Reads the value at the cursor; `None` without one. A plain number keeps its decimals.
    fn read(&self, scanner: &mut Scanner<'_>) -> Result<Option<WordValue>, Fault> {
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
        // `2*R1` begins with a number but is an expression.
        if let Some((value, decimals)) = number
            && self.operator(scanner, Self::OPERATORS).is_none()
        {
            scanner.go_to(end);
            let value = if sign == Some(b'-') { -value } else { value };
            return Ok(Some((Some(value), Some(decimals))));
        }
        scanner.go_to(before);
        let value = self.operation(scanner, 0, 0)?;
        Ok(value.map(|value| (value, None)))
    }

    fn operator(&self, scanner: &mut Scanner<'_>, of: &[Equals]) -> Option<Operator> {
        let mut all = of.iter().flat_map(|equals| equals.iter());
        let found = all.find(|(name, _)| takes_name(scanner, name));
        found.map(|(_, operator)| *operator)
    }

    /// Evaluates the left-associative operators of one precedence; their operands are of higher precedence.
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
            let other = other
                .ok_or(column.malformed(
                    "expected a number, a parameter or a function after this operator",
                ))?;
            value = match (value, other) {
                (Some(a), Some(b)) => Some(operate(operator, a, b, column)?),
                _ => None,
            };
        }
    }

    fn operand(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Option<Value>, Fault> {
        if depth > MAX_CALL_DEPTH {
            return Err(scanner.column().malformed("the expression is nested too deeply"));
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
        let mut functions = FUNCTIONS.iter().chain(Self::FUNCTIONS);
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

    /// Reads the argument of a function: in brackets, or a plain operand.
    fn argument(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Value, Fault> {
        let column = scanner.column();
        let value = self.operand(scanner, depth)?;
        value.ok_or(column.malformed("expected the argument of the function here"))
    }

    fn arguments(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<[Value; 2], Fault> {
        let wrong = |column: Column| column.malformed("expected two arguments: (1, 2)");
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

    fn bracket(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Value, Fault> {
        let value = self.operation(scanner, 0, depth)?;
        match (value, scanner.takes(b')')) {
            (Some(value), true) => Ok(value),
            _ => {
                Err(scanner.column().malformed("expected a value or an operator, and ) after them"))
            }
        }
    }
}

/// Consumes this name if it is next and not followed by a letter or digit.
pub(crate) fn takes_name(scanner: &mut Scanner<'_>, name: &str) -> bool {
    scanner.peek();
    let (at, rest) = (scanner.at(), scanner.rest());
    let is_next = scanner.is_next(name);
    let is_letter = name.ends_with(|c: char| c.is_ascii_alphanumeric());
    let goes_on =
        rest.get(name.len()).is_some_and(|byte| byte.is_ascii_alphanumeric() || *byte == b'_');
    if !is_next || is_letter && goes_on {
        return false;
    }
    scanner.go_to(at + name.len());
    true
}

/// Reads an unsigned whole number. A number above `most` is consumed and yields `None`.
pub(crate) fn whole_number(scanner: &mut Scanner<'_>, most: u32) -> Option<u32> {
    whole(plain_number(scanner, b"")?.0, most)
}

/// Reads an unsigned decimal number without blanks; returns its value and decimals. `points` are the characters accepted as decimal point.
pub(crate) fn plain_number(scanner: &mut Scanner<'_>, points: &[u8]) -> Option<(f64, u8)> {
    scanner.peek();
    let (at, rest) = (scanner.at(), scanner.rest());
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
