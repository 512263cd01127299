//! Values of HEIDENHAIN: Q parameters and formulas; angles are in degrees.

use crate::{
    block::Parameter,
    expression::Operator,
    fault::Fault,
    formula::{Formulas, plain_number, takes_name},
    interpret::Interpreter,
    parameters::Value,
    scan::Scanner,
};

/// Values of a block.
pub(super) struct Values<'b> {
    pub(super) interpreter: &'b Interpreter,
}

impl Formulas for Values<'_> {
    const OPERATORS: &'static [&'static [(&'static str, Operator)]] = &[
        &[("+", Operator::Plus), ("-", Operator::Minus)],
        &[
            ("*", Operator::Times),
            ("/", Operator::Over),
            ("%", Operator::Rest),
        ],
        &[("^", Operator::Power)],
    ];
    const FUNCTIONS: &'static [(&'static str, fn(f64) -> f64)] = &[
        ("ABS", f64::abs),
        ("ACOS", |x| x.acos().to_degrees()),
        ("ASIN", |x| x.asin().to_degrees()),
        ("ATAN", |x| x.atan().to_degrees()),
        ("COS", |x| x.to_radians().cos()),
        ("EXP", f64::exp),
        ("FRAC", f64::fract),
        ("INT", f64::trunc),
        ("LN", f64::ln),
        ("LOG", f64::log10),
        ("NEG", |x| -x),
        ("SIN", |x| x.to_radians().sin()),
        ("SQ", |x| x * x),
        ("SQRT", f64::sqrt),
        ("TAN", |x| x.to_radians().tan()),
    ];
    const PAIRS: &'static [(&'static str, fn(f64, f64) -> f64)] = &[];

    fn number(&self, scanner: &mut Scanner<'_>) -> Option<(f64, u8)> {
        plain_number(scanner, b".,")
    }

    fn parameter(&self, scanner: &mut Scanner<'_>, _depth: u32) -> Result<Option<Value>, Fault> {
        if takes_name(scanner, "PI") {
            return Ok(Some(Some(std::f64::consts::PI)));
        }
        let parameters = &self.interpreter.parameters;
        Ok(q_parameter(scanner).map(|parameter| match parameter {
            Parameter::Numbered(number) => parameters.set_number(number).unwrap_or(None),
            Parameter::Named(name) => parameters.named(&name).unwrap_or(None),
        }))
    }
}

impl Values<'_> {
    /// A number or a Q parameter with a sign or without, as it stands behind the letter of a word.
    pub(super) fn of_word(
        &self,
        scanner: &mut Scanner<'_>,
    ) -> Result<Option<(Value, Option<u8>)>, Fault> {
        let before = scanner.at();
        let is_negative = scanner.takes(b'-');
        if !is_negative {
            scanner.takes(b'+');
        }
        let signed = |value: f64| if is_negative { -value } else { value };
        if let Some((value, decimals)) = self.number(scanner) {
            return Ok(Some((Some(signed(value)), Some(decimals))));
        }
        let value = self.parameter(scanner, 0)?;
        if value.is_none() {
            scanner.go_to(before);
        }
        Ok(value.map(|value| (value.map(signed), None)))
    }
}

/// `Q5`, `QL5` or `QR5`.
pub(super) fn q_parameter(scanner: &mut Scanner<'_>) -> Option<Parameter> {
    let before = scanner.at();
    if !scanner.takes(b'Q') {
        return None;
    }
    let kind = match scanner.peek() {
        Some(kind @ (b'L' | b'R')) => {
            scanner.next();
            Some(kind)
        }
        _ => None,
    };
    let number = plain_number(scanner, b"");
    let number = number.and_then(|(number, _)| crate::given::whole(number, 9999));
    let Some(number) = number else {
        scanner.go_to(before);
        return None;
    };
    Some(match kind {
        Some(kind) => Parameter::Named(format!("q{}{number}", char::from(kind))),
        None => Parameter::Numbered(number),
    })
}
