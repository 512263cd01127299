//! The result of a thermal fit as text for people and for a machine file.

use std::fmt::Write;

use volcomp_model::ErrorName;

use super::Channel;
use crate::commands::{table, table_text};

impl Channel {
    /// Whether the displacement is a rotation in µrad and not a translation in µm.
    pub(super) fn is_angular(&self) -> bool {
        self.name.ends_with("_urad")
    }
}

/// The terms as `[[thermal.drift]]`, and the constant that belongs to them.
pub(super) fn terms_toml(
    channel: &Channel,
    sensors: &[String],
    error: ErrorName,
    reference_degc: f64,
) -> String {
    let (unit, symbol) = if channel.is_angular() {
        ("urad", "µrad")
    } else {
        ("um", "µm")
    };
    let mut text = format!(
        "# With {reference_degc} °C as [thermal] reference the constant\n# {:.3} {symbol} belongs to the curve of {error}.\n",
        channel.terms.constant_at(reference_degc)
    );
    for term in &channel.terms.terms {
        let weighted = sensors
            .iter()
            .zip(&term.per_k)
            .filter(|(_, per_k)| **per_k != 0.0);
        let weights: Vec<String> = weighted
            .map(|(name, per_k)| format!("{name} = {per_k:.6}"))
            .collect();
        // Writing to a string never fails.
        let _ = write!(
            text,
            "[[thermal.drift]]\nerror = \"{error}\"\nsensors = {{ {} }}\n{unit}_per_k = 1.0\nlag_s = {:.1}\n",
            weights.join(", "),
            term.lag_s
        );
    }
    text
}

/// The root mean square errors of the prediction, without and with time constants.
pub(super) fn comparison(channels: &[Channel]) -> String {
    let mut lines = table(&[
        "RMS of prediction",
        "no lag",
        "with lags",
        "",
        "worst",
        "from h",
        "lags s",
        "sensors",
    ]);
    for channel in channels {
        let (plain, lagged) = (&channel.plain, &channel.lagged);
        let lags = lagged.fit.terms.iter().map(|term| term.lag_s);
        let [shortest, longest] = [
            lags.clone().fold(f64::INFINITY, f64::min),
            lags.fold(0.0, f64::max),
        ];
        let worst = lagged.worst.as_ref();
        lines.add_row([
            channel.name.clone(),
            format!("{:.2}", plain.rms),
            format!("{:.2}", lagged.rms),
            format!("{:.0} %", 100.0 * (lagged.rms / plain.rms - 1.0)),
            worst.map_or(String::new(), |w| format!("{:.2}", w.rms)),
            worst.map_or(String::new(), |w| format!("{:.1}", w.from_s / 3600.0)),
            if shortest.is_finite() {
                format!("{shortest} to {longest}")
            } else {
                "none".to_owned()
            },
            format!("{}", lagged.fit.sensors().len()),
        ]);
    }
    table_text(&lines)
        + "\nThe prediction is of the last part of the time, in the unit of the column\n(µm or µrad).\n"
}
