//! The result of a thermal fit as text for people.

use std::fmt::Write as _;

use volcomp_fit::ThermalEffect;
use volcomp_model::ErrorName;

use super::{Arguments, Channel, terms};
use crate::commands::{fixed, table, table_text};

/// The errors of the prediction, the numbers, and what belongs into the machine file.
pub(super) fn text(
    channels: &[Channel],
    sensors: &[String],
    arguments: &Arguments,
    error: ErrorName,
) -> String {
    let mut text = comparison(channels, arguments.data.len());
    for channel in channels {
        let found = &channel.terms;
        let toml = terms::toml(
            found,
            sensors,
            error,
            arguments.reference,
            channel.is_angular(),
        );
        // Writing to a string never fails.
        let _ = write!(
            text,
            "\n{}\n{}\n{}\n# {}\n{toml}",
            channel.name,
            numbers(channel, sensors),
            sizes(channel),
            channel.name
        );
    }
    text
}

/// The root mean square errors of the prediction, without and with time constants.
fn comparison(channels: &[Channel], files: usize) -> String {
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
    let of_what = if files == 1 {
        "The prediction is of the last part of the time, in the unit of the column (µm or\n\
         µrad). Dense: all sensors with many time constants, as a measure of what few\n\
         terms lose."
    } else {
        "The prediction is of each file from all others, in the unit of the column (µm or\n\
         µrad), both counted from the start of the file."
    };
    table_text(&lines) + "\n" + of_what + "\n"
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
