//! The result of a thermal fit as text for people.

use std::fmt::Write as _;

use volcomp_fit::ThermalEffect;

use super::{
    Arguments, Channel, terms,
    verdict::{Verdict, difference},
};
use crate::{
    commands::{fixed, table, table_text},
    table::folded,
};

/// The errors of the prediction, the numbers, and what belongs into the machine file.
pub(super) fn text(channels: &[Channel], sensors: &[String], arguments: &Arguments) -> String {
    let mut text = comparison(channels, arguments);
    for channel in channels {
        let paste = match channel.verdict() {
            Verdict::Good => {
                let toml = terms::toml(channel, sensors, arguments.reference);
                format!("# {}\n{toml}", channel.name)
            }
            verdict => worse(channel, verdict),
        };
        // Writing to a string never fails.
        let _ = write!(
            text,
            "\n{}\n{}\n{}\n{paste}",
            channel.name,
            numbers(channel, sensors),
            sizes(channel)
        );
    }
    text
}

/// Why there are no terms to paste.
fn worse(channel: &Channel, verdict: Verdict) -> String {
    let unit = if channel.is_angular() { "µrad" } else { "µm" };
    let few = fixed(channel.few.rms, 2);
    let decides = |by: (f64, f64)| {
        let [by, error] = [by.0, by.1].map(|square| fixed(square, 2));
        let parts = if channel.left_out.is_empty() {
            "stretches"
        } else {
            "files"
        };
        format!(
            "(mean squares differ by {by} {unit}², with a standard error over the {parts} of {error} {unit}²)"
        )
    };
    let why = if verdict == Verdict::WorseThanPlain {
        let plain = fixed(channel.plain.rms, 2);
        format!(
            "they predict worse ({few} {unit}) than regression without time constants ({plain} {unit}) {}. Try `--lags 0`, or take more tests.",
            decides(difference(&channel.few.parts, &channel.plain.parts))
        )
    } else {
        let none = fixed(channel.none, 2);
        let by = difference(&channel.none_of_parts, &channel.few.parts);
        let how = if by.0 > 0.0 && by.0 <= by.1 {
            "not surely better"
        } else if by.0 > 0.0 {
            "hardly better"
        } else {
            "no better"
        };
        format!(
            "they predict tests that they have not seen ({few} {unit}) {how} than no terms at all ({none} {unit}) {}. Either these temperatures do not move what was measured, or it takes more tests to see that.",
            decides(by)
        )
    };
    folded(&format!("No terms are printed: {why}"), "")
}

/// The root mean square errors of the prediction, without and with time constants.
fn comparison(channels: &[Channel], arguments: &Arguments) -> String {
    let mut lines = table(&[
        "RMS of prediction",
        "no lag",
        "dense",
        "few terms",
        "worst",
        "from h",
        "numbers",
        "sensors",
        "lags",
    ]);
    for channel in channels {
        let few = &channel.few;
        let worst = few.worst.as_ref();
        let or_nothing = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
        lines.add_row([
            channel.name.clone(),
            fixed(channel.plain.rms, 2),
            or_nothing(channel.dense.as_ref().map(|dense| fixed(dense.rms, 2))),
            fixed(few.rms, 2),
            or_nothing(worst.map(|w| fixed(w.rms, 2))),
            or_nothing(worst.map(|w| fixed(w.from_s / 3600.0, 1))),
            channel.terms.numbers.len().to_string(),
            channel.terms.sensors().len().to_string(),
            channel.terms.lags_s().len().to_string(),
        ]);
    }
    let of_what = if let [_] = arguments.data[..] {
        format!(
            "The prediction is of the last {} % of the rows, by terms found from those before them, in the unit of the column (µm or µrad). Dense: all sensors with many time constants, as a measure of what few terms lose. Worst: the largest error of ten stretches of equally many rows; from h: where that stretch begins, in hours of the file.",
            fixed(100.0 * (1.0 - arguments.train), 0)
        )
    } else {
        "The prediction is of each file from all others, in the unit of the column (µm or µrad), both counted from the start of the file.".to_owned()
    };
    table_text(&lines) + "\n" + &folded(&of_what, "")
}

/// Every number with its uncertainty.
fn numbers(channel: &Channel, sensors: &[String]) -> String {
    let unit = if channel.is_angular() {
        "µrad/K"
    } else {
        "µm/K"
    };
    let mut lines = table(&["sensor", "lag s", "value", "+/-", "unit"]);
    for number in &channel.terms.numbers {
        let (lag, scale, unit) = match number.effect {
            ThermalEffect::Drift { lag_s } => (format!("{lag_s}"), 1.0, unit),
            ThermalEffect::Expansion => ("-".to_owned(), 1e3, "µm/(m·K)"),
        };
        lines.add_row([
            sensors.get(number.sensor).cloned().unwrap_or_default(),
            lag,
            fixed(number.value * scale, 3),
            fixed(number.uncertainty * scale, 3),
            unit.to_owned(),
        ]);
    }
    table_text(&lines)
}

/// The error of validation against the number of numbers.
fn sizes(channel: &Channel) -> String {
    let mut lines = table(&["numbers", "RMS of validation", "+/-"]);
    for size in channel.terms.path.iter().rev() {
        let mark = if size.numbers == channel.terms.numbers.len() {
            "*"
        } else {
            ""
        };
        lines.add_row([
            format!("{}{mark}", size.numbers),
            fixed(size.rms, 2),
            fixed(size.standard_error, 2),
        ]);
    }
    table_text(&lines) + "* taken: the fewest within one standard error of the best\n"
}
