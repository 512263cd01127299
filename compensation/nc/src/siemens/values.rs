//! Values of SINUMERIK: R parameters, variables of the program, formulas; angles are in degrees.

use crate::{
    block::{Assignment, Parameter},
    expression::Operator,
    fault::Fault,
    formula::{Formulas, plain_number, takes_name},
    interpret::Interpreter,
    parameters::{MOST, Value},
    scan::Scanner,
};

/// The number of a parameter; `None`: only the machine knows which.
type Number = Option<u32>;

/// Values of a block: parameters have the values that they had before it.
pub(super) struct Values<'b> {
    pub(super) interpreter: &'b Interpreter,
    /// What the block has set so far.
    pub(super) set: &'b [Assignment],
}

impl Formulas for Values<'_> {
    const OPERATORS: &'static [&'static [(&'static str, Operator)]] = &[
        &[("+", Operator::Plus), ("-", Operator::Minus)],
        &[
            ("*", Operator::Times),
            ("/", Operator::Over),
            ("DIV", Operator::WholeOver),
            ("MOD", Operator::Rest),
        ],
    ];
    const FUNCTIONS: &'static [(&'static str, fn(f64) -> f64)] = &[
        ("ABS", f64::abs),
        ("ACOS", |x| x.acos().to_degrees()),
        ("ASIN", |x| x.asin().to_degrees()),
        ("COS", |x| x.to_radians().cos()),
        ("EXP", f64::exp),
        ("LN", f64::ln),
        ("POT", |x| x * x),
        ("ROUND", f64::round),
        ("SIN", |x| x.to_radians().sin()),
        ("SQRT", f64::sqrt),
        ("TAN", |x| x.to_radians().tan()),
        ("TRUNC", f64::trunc),
    ];
    const PAIRS: &'static [(&'static str, fn(f64, f64) -> f64)] = &[
        ("ATAN2", |y, x| y.atan2(x).to_degrees()),
        ("MINVAL", f64::min),
        ("MAXVAL", f64::max),
    ];

    fn number(&self, scanner: &mut Scanner<'_>) -> Option<(f64, u8)> {
        let (value, decimals) = plain_number(scanner, b".")?;
        // 1.5EX-3
        let before = scanner.at();
        let rest = scanner.bytes().get(before..).unwrap_or_default();
        if !rest
            .get(..2)
            .is_some_and(|ex| ex.eq_ignore_ascii_case(b"EX"))
        {
            return Some((value, decimals));
        }
        scanner.go_to(before + 2);
        let sign = if scanner.takes(b'-') { -1 } else { 1 };
        scanner.takes(b'+');
        let digits = plain_number(scanner, b"");
        let power = digits.filter(|(power, _)| *power <= 300.0);
        // A power of ten up to 300.
        let power = power.and_then(|(power, _)| format!("{power:.0}").parse::<i32>().ok());
        let value = power.map(|power| value * 10_f64.powi(sign * power));
        value
            .filter(|value| value.is_finite())
            .map(|value| (value, 0))
    }

    fn parameter(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Option<Value>, Fault> {
        let column = scanner.column();
        let parameters = &self.interpreter.parameters;
        if let Some(number) = r_parameter(self, scanner, depth)? {
            self.is_settled(number.map(Parameter::Numbered).as_ref(), column)?;
            let value = number.and_then(|number| parameters.set_number(number));
            return Ok(Some(value.unwrap_or(None)));
        }
        if takes_name(scanner, "$PI") {
            return Ok(Some(Some(std::f64::consts::PI)));
        }
        let is_system = scanner.takes(b'$');
        let Some(name) = identifier(scanner) else {
            return Ok(None);
        };
        let is_element = passes_brackets(scanner, b'[', b']');
        let has_arguments = passes_brackets(scanner, b'(', b')');
        if is_system || is_element || has_arguments {
            // Only the control knows it.
            return Ok(Some(None));
        }
        let name = name.to_ascii_lowercase();
        self.is_settled(Some(&Parameter::Named(name.clone())), column)?;
        Ok(Some(match name.as_str() {
            "true" => Some(1.0),
            "false" => Some(0.0),
            _ => parameters.named(&name).unwrap_or(None),
        }))
    }
}

impl Values<'_> {
    /// Whether the block has not set the parameter: in which order it does so is not known here.
    fn is_settled(&self, parameter: Option<&Parameter>, column: usize) -> Result<(), Fault> {
        let is_set = |parameter: &Parameter| self.set.iter().any(|set| set.parameter == *parameter);
        if parameter.is_some_and(is_set) {
            return Err(Fault::Expression {
                column,
                what: "a parameter that the same block sets before: write the two in blocks of their own",
            });
        }
        Ok(())
    }
}

/// The number of an R parameter, `R5` or `R[5]`; the outer `None`: it is none, the inner: only the machine knows which.
pub(super) fn r_parameter(
    values: &Values<'_>,
    scanner: &mut Scanner<'_>,
    depth: u32,
) -> Result<Option<Number>, Fault> {
    let before = scanner.at();
    if !scanner.takes(b'R') {
        return Ok(None);
    }
    let column = scanner.column();
    let number = if scanner.takes(b'[') {
        let value = values.operation(scanner, 0, depth)?;
        match (value, scanner.takes(b']')) {
            (Some(value), true) => value,
            _ => {
                return Err(Fault::Expression {
                    column,
                    what: "expected the number of an R parameter, and ] behind it",
                });
            }
        }
    } else if let Some((number, _)) = plain_number(scanner, b"") {
        Some(number)
    } else {
        scanner.go_to(before);
        return Ok(None);
    };
    let Some(number) = number else {
        return Ok(Some(None));
    };
    let whole = crate::given::whole(number, MOST - 1);
    let whole = whole.ok_or(Fault::Expression {
        column,
        what: "expected the number of an R parameter, 0 to 99999",
    })?;
    Ok(Some(Some(whole)))
}

/// A name: letters, digits and underscores, in capitals. `None`: none begins here.
pub(super) fn identifier(scanner: &mut Scanner<'_>) -> Option<String> {
    let first = scanner.peek()?;
    if !first.is_ascii_alphabetic() && first != b'_' {
        return None;
    }
    let at = scanner.at();
    let rest = scanner.bytes().get(at..).unwrap_or_default();
    let is_of_name = |byte: &u8| byte.is_ascii_alphanumeric() || *byte == b'_';
    let length = rest.iter().take_while(|byte| is_of_name(byte)).count();
    scanner.go_to(at + length);
    let name = rest.iter().take(length).map(u8::to_ascii_uppercase);
    Some(name.map(char::from).collect())
}

/// Passes brackets with all that is in them, where they are next; strings in them may hold anything. Whether they were there.
pub(super) fn passes_brackets(scanner: &mut Scanner<'_>, opens: u8, closes: u8) -> bool {
    if scanner.peek() != Some(opens) {
        return false;
    }
    let (mut depth, mut in_text) = (0_u32, false);
    let at = scanner.at();
    let rest = scanner.bytes().get(at..).unwrap_or_default();
    for (place, byte) in rest.iter().enumerate() {
        match byte {
            b'"' => in_text = !in_text,
            _ if in_text => {}
            b';' => break,
            _ if *byte == opens => depth += 1,
            _ if *byte == closes => {
                depth -= 1;
                if depth == 0 {
                    scanner.go_to(at + place + 1);
                    return true;
                }
            }
            _ => {}
        }
    }
    false
}
