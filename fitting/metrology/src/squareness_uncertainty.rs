//! The measurement uncertainty of a squareness from two straightness lines: expanded uncertainties with k = 2, µrad.

use crate::MetrologyError;

/// What is known of how two straightness lines were measured. What is not stated contributes nothing, and is named in
/// [`SquarenessUncertainty::left_out`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SquarenessInputs {
    /// Expanded uncertainty (k = 2) of the angle between the references, by the calibration of the square, µrad.
    pub square_urad: Option<f64>,
    /// Expanded uncertainty (k = 2) of the straight edge or straightness optics at any place, by its calibration, µm.
    pub straight_edge_um: Option<f64>,
    /// Range of the angle between the axes by changes of temperature, over as long as the test, µrad.
    pub temperature_urad: Option<f64>,
}

/// Expanded uncertainties (k = 2) of a squareness, µrad; `None` is not stated, and left out.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SquarenessUncertainty {
    /// Of both slopes, by what their lines leave.
    pub scatter_urad: f64,
    /// Of the square.
    pub square_urad: Option<f64>,
    /// Of the straight edge under both lines.
    pub straight_edge_urad: Option<f64>,
    /// Of changes of temperature.
    pub temperature_urad: Option<f64>,
    /// Of all together.
    pub whole_urad: f64,
    /// What was not stated, in words.
    pub left_out: Vec<String>,
}

/// Evaluates the uncertainty. `slopes_urad` are the standard uncertainties of the two slopes by their residuals, `lengths_mm` the
/// lengths of the two lines.
///
/// The square counts as calibrated. A straight edge that is wrong by U at both ends of a line of length L, independently, turns it by
/// √2 U/L. A range R of the angle by temperature is that of a uniform distribution, R/√3.
///
/// # Errors
/// A length that is not above zero, a number that is negative or not finite.
pub fn squareness_uncertainty(
    inputs: &SquarenessInputs,
    slopes_urad: [f64; 2],
    lengths_mm: [f64; 2],
) -> Result<SquarenessUncertainty, MetrologyError> {
    const URAD_PER_UM_PER_MM: f64 = 1e3;
    let refuse = |what: &str, found: f64, expected: &str| MetrologyError::Readings {
        name: "measurement uncertainty".into(),
        what: what.into(),
        found: found.to_string(),
        expected: expected.into(),
    };
    for length in lengths_mm {
        if !(length.is_finite() && length > 0.0) {
            return Err(refuse("length of a line, mm", length, "one above zero"));
        }
    }
    for (what, value) in [
        ("uncertainty of the square, µrad", inputs.square_urad),
        (
            "uncertainty of the straight edge, µm",
            inputs.straight_edge_um,
        ),
        ("range by temperature, µrad", inputs.temperature_urad),
        ("uncertainty of a slope, µrad", Some(slopes_urad[0])),
        ("uncertainty of a slope, µrad", Some(slopes_urad[1])),
    ] {
        if let Some(value) = value
            && !(0.0..=crate::number::LARGEST).contains(&value)
        {
            return Err(refuse(what, value, "a finite number of at least 0"));
        }
    }
    let [a, b] = slopes_urad;
    let scatter_urad = 2.0 * a.hypot(b);
    let straight_edge_urad = inputs.straight_edge_um.map(|u| {
        let turn = |length: f64| 2.0_f64.sqrt() * u / length * URAD_PER_UM_PER_MM;
        turn(lengths_mm[0]).hypot(turn(lengths_mm[1]))
    });
    let temperature_urad = inputs.temperature_urad.map(|range| range / 3.0_f64.sqrt());
    let named = [
        ("square", inputs.square_urad),
        ("straight edge", straight_edge_urad),
        ("temperature", temperature_urad),
    ];
    let whole_urad = named
        .iter()
        .filter_map(|(_, u)| *u)
        .fold(scatter_urad, f64::hypot);
    let left_out = named.iter().filter(|(_, u)| u.is_none());
    Ok(SquarenessUncertainty {
        scatter_urad,
        square_urad: inputs.square_urad,
        straight_edge_urad,
        temperature_urad,
        whole_urad,
        left_out: left_out.map(|(name, _)| (*name).to_owned()).collect(),
    })
}
