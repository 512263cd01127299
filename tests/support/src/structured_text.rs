//! An interpreter for the subset of Structured Text (IEC 61131-3) used by the shipped programs: DINT, INT and BOOL,
//! zero-based arrays of them, assignments, IF, FOR, the usual operators and ABS. A value out of range, an index out of
//! bounds, and a division by zero or with a negative operand are errors, so a program that runs here does not depend on
//! how a control handles them.

use std::{collections::HashMap, ops::RangeInclusive};

#[derive(Clone, Debug, PartialEq)]
enum Token {
    Word(String),
    Number(i64),
    Sign(&'static str),
}

const SIGNS: [&str; 20] = [
    ":=", "<>", "<=", ">=", "..", "+", "-", "*", "/", "(", ")", "[", "]", ";", ":", ",", "=", "<",
    ">", ".",
];

fn tokens(text: &str) -> Result<Vec<Token>, String> {
    let mut rest = text;
    let mut tokens = Vec::new();
    loop {
        rest = rest.trim_start();
        let Some(first) = rest.chars().next() else {
            return Ok(tokens);
        };
        if let Some(comment) = rest.strip_prefix("(*") {
            let end = comment.find("*)").ok_or("a comment does not end")?;
            rest = &comment[end + 2..];
        } else if first.is_ascii_alphabetic() {
            let end =
                rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len());
            tokens.push(Token::Word(rest[..end].to_owned()));
            rest = &rest[end..];
        } else if first.is_ascii_digit() {
            let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
            tokens.push(Token::Number(rest[..end].parse().map_err(|e| format!("{e}"))?));
            rest = &rest[end..];
        } else {
            let sign = SIGNS.iter().find(|s| rest.starts_with(**s)).ok_or(format!("{first:?}"))?;
            tokens.push(Token::Sign(sign));
            rest = &rest[sign.len()..];
        }
    }
}

#[derive(Clone, Debug)]
enum Expression {
    Number(i64),
    Place(usize, Option<Box<Expression>>),
    Abs(Box<Expression>),
    Not(Box<Expression>),
    Minus(Box<Expression>),
    Two(String, Box<Expression>, Box<Expression>),
}

#[derive(Clone, Debug)]
enum Statement {
    Assign(usize, Option<Expression>, Expression),
    If(Vec<(Expression, Vec<Statement>)>, Vec<Statement>),
    For(usize, Expression, Expression, Vec<Statement>),
}

/// A variable; a scalar is an array of one element.
#[derive(Clone, Debug)]
struct Variable {
    name: String,
    range: RangeInclusive<i64>,
    places: Vec<i64>,
}

const DINT: RangeInclusive<i64> = i32::MIN as i64..=i32::MAX as i64;
const INT: RangeInclusive<i64> = i16::MIN as i64..=i16::MAX as i64;
const BOOL: RangeInclusive<i64> = 0..=1;

/// A function block with its variables.
#[derive(Clone, Debug)]
pub struct Block {
    variables: Vec<Variable>,
    named: HashMap<String, usize>,
    body: Vec<Statement>,
}

impl Block {
    /// Parses a function block.
    ///
    /// # Errors
    /// Text outside the subset, and undeclared names.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut parser = Parser { tokens: tokens(text)?, at: 0, named: HashMap::new() };
        parser.word("FUNCTION_BLOCK")?;
        parser.name()?;
        let mut variables: Vec<Variable> = Vec::new();
        while parser.peek_word().is_some_and(|word| word.starts_with("VAR")) {
            parser.at += 1;
            if parser.peek_word() == Some("RETAIN") {
                parser.at += 1;
            }
            while parser.peek_word() != Some("END_VAR") {
                let name = parser.name()?;
                parser.sign(":")?;
                let (range, length) = parser.type_()?;
                parser.sign(";")?;
                let slot = variables.len();
                if parser.named.insert(name.clone(), slot).is_some() {
                    return Err(format!("{name} is declared twice"));
                }
                let places = vec![0; length];
                variables.push(Variable { name, range, places });
            }
            parser.at += 1;
        }
        let body = parser.statements(&["END_FUNCTION_BLOCK"])?;
        parser.word("END_FUNCTION_BLOCK")?;
        let named = parser.named;
        Ok(Self { variables, named, body })
    }

    /// Sets an element of a variable; a scalar has element 0.
    pub fn set(&mut self, name: &str, at: usize, value: i64) {
        let slot = self.slot(name);
        let variable = &mut self.variables[slot];
        assert!(variable.range.contains(&value), "{name} := {value}");
        variable.places[at] = value;
    }

    /// Reads an element of a variable; a scalar has element 0.
    pub fn get(&self, name: &str, at: usize) -> i64 {
        self.variables[self.slot(name)].places[at]
    }

    /// Runs the body once.
    ///
    /// # Errors
    /// Operations whose result depends on the control: see the top of this file.
    pub fn run(&mut self) -> Result<(), String> {
        run(&self.body, &mut self.variables)
    }

    fn slot(&self, name: &str) -> usize {
        *self.named.get(name).expect("a variable of the text")
    }
}

struct Parser {
    tokens: Vec<Token>,
    at: usize,
    named: HashMap<String, usize>,
}

impl Parser {
    fn next(&mut self) -> Option<Token> {
        self.at += 1;
        self.tokens.get(self.at - 1).cloned()
    }

    fn peek_word(&self) -> Option<&str> {
        match self.tokens.get(self.at) {
            Some(Token::Word(word)) => Some(word),
            _ => None,
        }
    }

    fn takes(&mut self, sign: &str) -> bool {
        let found = matches!(self.tokens.get(self.at), Some(Token::Sign(s)) if *s == sign);
        self.at += usize::from(found);
        found
    }

    fn sign(&mut self, sign: &str) -> Result<(), String> {
        if self.takes(sign) {
            return Ok(());
        }
        Err(format!("expected {sign}, found {:?}", self.tokens.get(self.at)))
    }

    fn word(&mut self, expected: &str) -> Result<(), String> {
        match self.next() {
            Some(Token::Word(word)) if word == expected => Ok(()),
            found => Err(format!("expected {expected}, found {found:?}")),
        }
    }

    fn name(&mut self) -> Result<String, String> {
        match self.next() {
            Some(Token::Word(word)) => Ok(word),
            found => Err(format!("expected a name, found {found:?}")),
        }
    }

    fn declared(&self, name: &str) -> Result<usize, String> {
        let slot = self.named.get(name).copied();
        slot.ok_or(format!("{name} is not declared"))
    }

    /// Parses `DINT`, `INT`, `BOOL` or `ARRAY[0..n] OF` one of them: the range of values and the number of elements.
    fn type_(&mut self) -> Result<(RangeInclusive<i64>, usize), String> {
        match self.name()?.as_str() {
            "DINT" => Ok((DINT, 1)),
            "INT" => Ok((INT, 1)),
            "BOOL" => Ok((BOOL, 1)),
            "ARRAY" => {
                self.sign("[")?;
                let (first, dots, last) = (self.next(), self.next(), self.next());
                self.sign("]")?;
                self.word("OF")?;
                let (range, _) = self.type_()?;
                match (first, dots, last) {
                    (
                        Some(Token::Number(0)),
                        Some(Token::Sign("..")),
                        Some(Token::Number(last)),
                    ) => {
                        let length = usize::try_from(last + 1).map_err(|e| e.to_string())?;
                        Ok((range, length))
                    }
                    found => Err(format!("{found:?}")),
                }
            }
            other => Err(format!("type {other}")),
        }
    }

    fn statements(&mut self, ends: &[&str]) -> Result<Vec<Statement>, String> {
        let mut statements = Vec::new();
        while !self.peek_word().is_some_and(|word| ends.contains(&word)) {
            statements.push(self.statement()?);
        }
        Ok(statements)
    }

    fn statement(&mut self) -> Result<Statement, String> {
        let name = self.name()?;
        match name.as_str() {
            "IF" => {
                let mut cases = Vec::new();
                let mut otherwise = Vec::new();
                loop {
                    let condition = self.expression(0)?;
                    self.word("THEN")?;
                    cases.push((condition, self.statements(&["ELSIF", "ELSE", "END_IF"])?));
                    match self.name()?.as_str() {
                        "ELSIF" => {}
                        "ELSE" => {
                            otherwise = self.statements(&["END_IF"])?;
                            self.word("END_IF")?;
                            break;
                        }
                        _ => break,
                    }
                }
                self.sign(";")?;
                Ok(Statement::If(cases, otherwise))
            }
            "FOR" => {
                let name = self.name()?;
                let variable = self.declared(&name)?;
                self.sign(":=")?;
                let from = self.expression(0)?;
                self.word("TO")?;
                let to = self.expression(0)?;
                self.word("DO")?;
                let body = self.statements(&["END_FOR"])?;
                self.word("END_FOR")?;
                self.sign(";")?;
                Ok(Statement::For(variable, from, to, body))
            }
            _ => {
                let variable = self.declared(&name)?;
                let place = self.place()?;
                self.sign(":=")?;
                let value = self.expression(0)?;
                self.sign(";")?;
                Ok(Statement::Assign(variable, place, value))
            }
        }
    }

    fn place(&mut self) -> Result<Option<Expression>, String> {
        if !self.takes("[") {
            return Ok(None);
        }
        let at = self.expression(0)?;
        self.sign("]")?;
        Ok(Some(at))
    }

    fn expression(&mut self, level: usize) -> Result<Expression, String> {
        const LEVELS: [&[&str]; 5] = [
            &["OR"],
            &["AND"],
            &["=", "<>", "<", ">", "<=", ">="],
            &["+", "-"],
            &["*", "/", "MOD"],
        ];
        let Some(operators) = LEVELS.get(level) else {
            return self.single();
        };
        let mut left = self.expression(level + 1)?;
        loop {
            let found = match self.tokens.get(self.at) {
                Some(Token::Sign(sign)) => sign,
                Some(Token::Word(word)) => word.as_str(),
                _ => return Ok(left),
            };
            if !operators.contains(&found) {
                return Ok(left);
            }
            let operator = found.to_owned();
            self.at += 1;
            let right = self.expression(level + 1)?;
            left = Expression::Two(operator, Box::new(left), Box::new(right));
        }
    }

    fn single(&mut self) -> Result<Expression, String> {
        match self.next() {
            Some(Token::Number(number)) => Ok(Expression::Number(number)),
            Some(Token::Sign("-")) => Ok(Expression::Minus(Box::new(self.single()?))),
            Some(Token::Sign("(")) => {
                let inner = self.expression(0)?;
                self.sign(")")?;
                Ok(inner)
            }
            Some(Token::Word(word)) => match word.as_str() {
                "TRUE" => Ok(Expression::Number(1)),
                "FALSE" => Ok(Expression::Number(0)),
                "NOT" => Ok(Expression::Not(Box::new(self.single()?))),
                "ABS" => {
                    self.sign("(")?;
                    let inner = self.expression(0)?;
                    self.sign(")")?;
                    Ok(Expression::Abs(Box::new(inner)))
                }
                _ => {
                    let variable = self.declared(&word)?;
                    Ok(Expression::Place(variable, self.place()?.map(Box::new)))
                }
            },
            found => Err(format!("expected a value, found {found:?}")),
        }
    }
}

/// Checks an index and returns the element.
fn place(variable: &Variable, at: i64) -> Result<usize, String> {
    let place = usize::try_from(at).ok();
    place
        .filter(|place| *place < variable.places.len())
        .ok_or(format!("{}[{at}] is outside of the array", variable.name))
}

fn run(statements: &[Statement], variables: &mut [Variable]) -> Result<(), String> {
    for statement in statements {
        match statement {
            Statement::Assign(slot, at, expression) => {
                let at = at.as_ref().map_or(Ok(0), |at| value(at, variables))?;
                let new = value(expression, variables)?;
                let variable = &mut variables[*slot];
                let place = place(variable, at)?;
                if !variable.range.contains(&new) {
                    return Err(format!("{} := {new}", variable.name));
                }
                variable.places[place] = new;
            }
            Statement::If(cases, otherwise) => {
                let mut chosen = otherwise;
                for (condition, body) in cases {
                    if value(condition, variables)? != 0 {
                        chosen = body;
                        break;
                    }
                }
                run(chosen, variables)?;
            }
            Statement::For(slot, from, to, body) => {
                let (from, to) = (value(from, variables)?, value(to, variables)?);
                for at in from..=to {
                    variables[*slot].places[0] = at;
                    run(body, variables)?;
                }
            }
        }
    }
    Ok(())
}

fn value(expression: &Expression, variables: &[Variable]) -> Result<i64, String> {
    let result = match expression {
        Expression::Number(number) => *number,
        Expression::Place(slot, at) => {
            let at = at.as_ref().map_or(Ok(0), |at| value(at, variables))?;
            let variable = &variables[*slot];
            variable.places[place(variable, at)?]
        }
        Expression::Abs(inner) => value(inner, variables)?.abs(),
        Expression::Not(inner) => i64::from(value(inner, variables)? == 0),
        Expression::Minus(inner) => -value(inner, variables)?,
        Expression::Two(operator, left, right) => {
            // Always evaluate both sides: a control need not short-circuit.
            let (left, right) = (value(left, variables)?, value(right, variables)?);
            match operator.as_str() {
                "OR" => i64::from(left != 0 || right != 0),
                "AND" => i64::from(left != 0 && right != 0),
                "=" => i64::from(left == right),
                "<>" => i64::from(left != right),
                "<" => i64::from(left < right),
                ">" => i64::from(left > right),
                "<=" => i64::from(left <= right),
                ">=" => i64::from(left >= right),
                "+" => left + right,
                "-" => left - right,
                "*" => left * right,
                // Controls disagree on the sign of a remainder, so the programs avoid negative operands.
                "/" | "MOD" if right <= 0 || left < 0 => {
                    return Err(format!("{left} {operator} {right}"));
                }
                "/" => left / right,
                "MOD" => left % right,
                other => return Err(format!("operator {other}")),
            }
        }
    };
    if DINT.contains(&result) { Ok(result) } else { Err(format!("{result} is no DINT")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interpreter_reckons_as_the_language_does() {
        let text = "FUNCTION_BLOCK T VAR a : DINT; b : ARRAY[0..2] OF DINT; c : BOOL; d : ARRAY[0..1] OF INT; END_VAR
            a := 2 + 3 * -4; (* a comment *)
            FOR a := 1 TO 2 DO b[a] := 7 MOD (a + 1) + 10 / 4; END_FOR;
            IF a = 3 OR a > 5 THEN b[0] := 1; ELSIF NOT (a <> 2) AND TRUE THEN b[0] := 2; ELSE b[0] := 3; END_IF;
            c := ABS(-3) = 3;
            d[1] := -32768;
            END_FUNCTION_BLOCK";
        let mut block = Block::parse(text).expect("a program");
        block.run().expect("runs");
        let b: Vec<i64> = (0..3).map(|at| block.get("b", at)).collect();
        assert_eq!((b, block.get("c", 0)), (vec![2, 3, 3], 1));
        assert_eq!([block.get("d", 0), block.get("d", 1)], [0, -32768]);
    }

    #[test]
    fn what_controls_do_differently_is_refused() {
        let parsed = |body: &str| {
            Block::parse(&format!(
                "FUNCTION_BLOCK T VAR a : DINT; b : ARRAY[0..2] OF DINT; c : BOOL; d : INT; END_VAR {body} END_FUNCTION_BLOCK"
            ))
        };
        for wrong in [
            "a := 2147483647 + 1;",
            "a := 1 / 0;",
            "b[3] := 0;",
            "a := b[0 - 1];",
            "a := (0 - 7) MOD 2;",
            "c := 2;",
            "d := 32768;",
        ] {
            assert!(parsed(wrong).expect("a program").run().is_err(), "{wrong}");
        }
        for unknown in ["x := 1;", "a := x;", "FOR x := 0 TO 1 DO END_FOR;", "WHILE TRUE DO"] {
            assert!(parsed(unknown).is_err(), "{unknown}");
        }
    }
}
