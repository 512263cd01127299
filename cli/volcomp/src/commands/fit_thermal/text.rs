//! The result of a thermal fit as text for people.

use std::fmt::Write as _;

use volcomp_fit::ThermalVerdict;

use super::{
    Arguments, Channel,
    document::{FitThermal, Number},
};
use crate::{
    commands::{fixed, table, table_text},
    table::folded,
};

/// The errors of the prediction, the numbers, and what belongs into the machine file.
pub(super) fn text(
    channels: &[Channel],
    document: &FitThermal<'_>,
    arguments: &Arguments,
) -> String {
    let mut text = comparison(channels, arguments);
    for (channel, of) in channels.iter().zip(&document.displacements) {
        let paste = match channel.judged.verdict() {
            ThermalVerdict::Good => format!("# {}\n{}", channel.name, of.toml),
            verdict => worse(channel, verdict),
        };
        // Writing to a string never fails.
        let _ = write!(
            text,
            "\n{}\n{}\n{}\n{paste}",
            channel.name,
            numbers(&of.numbers),
            sizes(channel)
        );
    }
    text
}

/// Why there are no terms to paste.
fn worse(channel: &Channel, verdict: ThermalVerdict) -> String {
    let unit = channel.symbol();
    let judged = &channel.judged;
    let few = fixed(judged.few.rms, 2);
    let decides = |by: (f64, f64)| {
        let [by, error] = [by.0, by.1].map(|square| fixed(square, 2));
        let parts = if judged.left_out.is_empty() {
            "stretches"
        } else {
            "files"
        };
        format!(
            "(mean squares differ by {by} {unit}², with a standard error over the {parts} of {error} {unit}²)"
        )
    };
    let why = if verdict == ThermalVerdict::WorseThanPlain {
        let plain = fixed(judged.plain.rms, 2);
        format!(
            "they predict worse ({few} {unit}) than regression without time constants ({plain} {unit}) {}. Try `--lags 0`, or take more tests.",
            decides(judged.loss())
        )
    } else {
        let none = fixed(judged.none_rms, 2);
        let by = judged.gain();
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
        let judged = &channel.judged;
        let few = &judged.few;
        let worst = few.worst.as_ref();
        let or_nothing = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
        lines.add_row([
            channel.name.clone(),
            fixed(judged.plain.rms, 2),
            or_nothing(judged.dense.as_ref().map(|dense| fixed(dense.rms, 2))),
            fixed(few.rms, 2),
            or_nothing(worst.map(|w| fixed(w.rms, 2))),
            or_nothing(worst.map(|w| fixed(w.from_s / 3600.0, 1))),
            judged.terms.numbers.len().to_string(),
            judged.terms.sensors().len().to_string(),
            judged.terms.lags_s().len().to_string(),
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
fn numbers(numbers: &[Number]) -> String {
    let mut lines = table(&["sensor", "lag s", "value", "+/-", "unit"]);
    for number in numbers {
        let unit = match number.unit {
            "um_per_m_k" => "µm/(m·K)",
            "urad_per_k" => "µrad/K",
            _ => "µm/K",
        };
        lines.add_row([
            number.sensor.clone(),
            number
                .lag_s
                .map_or("-".to_owned(), |lag_s| lag_s.to_string()),
            fixed(number.value, 3),
            fixed(number.uncertainty, 3),
            unit.to_owned(),
        ]);
    }
    table_text(&lines)
}

/// The error of validation against the number of numbers.
fn sizes(channel: &Channel) -> String {
    let mut lines = table(&["numbers", "RMS of validation", "+/-"]);
    let terms = &channel.judged.terms;
    for size in terms.path.iter().rev() {
        let mark = if size.numbers == terms.numbers.len() {
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
