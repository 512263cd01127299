//! Lists of assignments on the command line: `X=100,Y=-5.5`, `X=+`, `spindle=24.5`.

use volcomp_vocabulary::AxisName;

use crate::failure::Failure;

/// The characters between assignments to axes.
pub(super) const AXES: &[char] = &[',', ';', ' ', '\t', '\n'];

/// The characters between assignments to sensors, whose names may have blanks.
pub(super) const SENSORS: &[char] = &[',', ';'];

/// The assignments of a list as names and values, with any of the `separators` between them. Blanks around names and
/// values count nothing. `example` is a single assignment for messages.
pub(super) fn assignments<'a>(
    option: &str,
    text: &'a str,
    separators: &[char],
    example: &str,
) -> Result<Vec<(&'a str, &'a str)>, Failure> {
    let is_separator = |c: char| separators.contains(&c);
    let is_between = |c: char| c.is_whitespace() || is_separator(c);
    let mut found: Vec<(&str, &str)> = Vec::new();
    let mut rest = text.trim_matches(is_between);
    while !rest.is_empty() {
        let (name, behind) = match rest.find(|c| c == '=' || is_separator(c)) {
            Some(end) => rest.split_at(end),
            None => (rest, ""),
        };
        let name = name.trim_end();
        let Some(behind) = behind.trim_start().strip_prefix('=') else {
            return Err(Failure::Input(no_assignment(option, name, &found, example)));
        };
        let behind = behind.trim_start();
        let (value, behind) = behind.split_at(behind.find(is_separator).unwrap_or(behind.len()));
        if name.is_empty() {
            let message = format!("{option}: found `={value}`, expected {example}");
            return Err(Failure::Input(message));
        }
        found.push((name, value.trim_end()));
        rest = behind.trim_start_matches(is_between);
    }
    Ok(found)
}

/// The message about a word without `=`. Digits behind a number are taken for those behind a decimal comma.
fn no_assignment(option: &str, word: &str, before: &[(&str, &str)], example: &str) -> String {
    if let Some((name, value)) = before.last()
        && word.bytes().all(|byte| byte.is_ascii_digit())
        && value.parse::<i64>().is_ok()
    {
        return format!(
            "{option}: found `{name}={value},{word}`, expected a decimal point: {name}={value}.{word}"
        );
    }
    format!("{option}: found `{word}`, expected {example}")
}

/// An axis by its letter, in upper or lower case.
pub(crate) fn axis(option: &str, name: &str) -> Result<AxisName, Failure> {
    name.to_ascii_uppercase().parse().map_err(|_| {
        Failure::Input(format!(
            "{option}: found axis `{name}`, expected one of X Y Z A B C U V W"
        ))
    })
}

/// The number of an assignment; `unit` is the one it is in, for the message.
pub(super) fn number(option: &str, name: &str, text: &str, unit: &str) -> Result<f64, Failure> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| {
        Failure::Input(format!(
            "{option}: found `{name}={text}`, expected a finite number of {unit}, without the unit"
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<(&str, &str)>, String> {
        assignments("--at", text, AXES, "X=100").map_err(|failure| match failure {
            Failure::Input(message) => message,
            other => format!("{other:?}"),
        })
    }

    #[test]
    fn commas_semicolons_and_blanks_separate() {
        let expected = Ok(vec![("X", "1"), ("y", "-2.5")]);
        for text in [
            "X=1,y=-2.5",
            " X = 1 , y = -2.5 ",
            "X=1 y=-2.5",
            "X=1;y=-2.5;",
            "X= 1\ty =-2.5",
        ] {
            assert_eq!(read(text), expected, "{text}");
        }
        assert_eq!(read(""), Ok(Vec::new()));
        assert_eq!(read("X="), Ok(vec![("X", "")]));
        let sensors = assignments(
            "--temperature",
            "bed left = 20,column=21 ",
            SENSORS,
            "NAME=°C",
        );
        assert_eq!(
            sensors.ok(),
            Some(vec![("bed left", "20"), ("column", "21")])
        );
    }

    #[test]
    fn messages_show_the_word_that_is_wrong() {
        for (text, expected) in [
            (
                "X=1,5",
                "--at: found `X=1,5`, expected a decimal point: X=1.5",
            ),
            ("X=1,Y", "--at: found `Y`, expected X=100"),
            ("5", "--at: found `5`, expected X=100"),
            ("=5", "--at: found `=5`, expected X=100"),
            ("X", "--at: found `X`, expected X=100"),
        ] {
            assert_eq!(read(text), Err(expected.to_owned()), "{text}");
        }
    }
}
