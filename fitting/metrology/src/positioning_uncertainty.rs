//! Measurement uncertainty of a positioning test, by ISO/TR 230-9 and the annex of ISO 230-2:2006 and 2014.
//! Uncertainties are expanded with k = 2, and in µm.

use crate::MetrologyError;

/// Conditions of the test. Unknown conditions (`None`) contribute nothing, and are listed in
/// [`PositioningUncertainty::left_out`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct UncertaintyInputs {
    /// Expanded uncertainty (k = 2) of the instrument from its calibration, µm/m: the part that is proportional to the
    /// length.
    pub device_um_per_m: Option<f64>,
    /// Expanded uncertainty (k = 2) of the instrument from its calibration, µm: the constant part.
    pub device_um: Option<f64>,
    /// Range of the misalignment between beam and axis over the measured length, mm.
    pub misalignment_mm: Option<f64>,
    /// Range R(θ) of the error of the machine temperature, K.
    pub temperature_range_k: Option<f64>,
    /// Expansion coefficient α of the machine, µm/(m·K).
    pub expansion_um_per_m_k: Option<f64>,
    /// Range R(α) of the error of the expansion coefficient, µm/(m·K).
    pub expansion_range_um_per_m_k: Option<f64>,
    /// Difference of the machine temperature from 20 °C, K, with either sign.
    pub from_20_degc_k: Option<f64>,
    /// Environment variation E_VE, µm: range of a drift test that takes as long as the positioning test.
    pub environment_um: Option<f64>,
}

/// One contribution to the uncertainty, expanded with k = 2.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Contribution {
    /// Symbol in plain letters: `U_DEVICE`.
    pub symbol: &'static str,
    /// Name of the contribution, with its formula.
    pub name: &'static str,
    /// Contribution over the length, µm; `None`: not stated and not included.
    pub u_um: Option<f64>,
}

/// Expanded uncertainties (k = 2) of the quantities of ISO 230-2, µm.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PositioningUncertainty {
    /// Measured length for which the uncertainties are stated, m.
    pub length_m: f64,
    /// Number of runs in each direction.
    pub runs: usize,
    /// The contributions in the order of the annex.
    pub contributions: Vec<Contribution>,
    /// U(A), also valid for U(A↑) and U(A↓).
    pub a_um: f64,
    /// U(E), also valid for U(E↑) and U(E↓).
    pub e_um: f64,
    /// U(M), of the mean bidirectional positioning deviation.
    pub m_um: f64,
    /// U(B), of the reversal value.
    pub b_um: f64,
    /// U(R), of the bidirectional repeatability.
    pub r_um: f64,
    /// U(R↑) and U(R↓), of the unidirectional repeatabilities.
    pub r_unidirectional_um: f64,
    /// Contributions that were not stated and are not included, one text each; empty if all were
    /// stated.
    pub left_out: Vec<String>,
}

/// Factor from a range R to the expanded uncertainty. A uniform distribution has the standard uncertainty R/(2√3), and
/// so the expanded uncertainty R/√3. The annex rounds this to 0.6 R, which is 4 % more.
const EXPANDED_OF_RANGE: f64 = 0.577_350_269_189_625_8;

/// Evaluates the uncertainty for a measured length (m) and this number of runs in each direction.
///
/// # Errors
/// A length or number of runs that is not above zero, or an input that is negative or not finite.
pub fn positioning_uncertainty(
    inputs: &UncertaintyInputs,
    length_m: f64,
    runs: usize,
) -> Result<PositioningUncertainty, MetrologyError> {
    check(inputs, length_m, runs)?;
    let device = match (inputs.device_um_per_m, inputs.device_um) {
        (None, None) => None,
        (per_m, fixed) => Some(per_m.unwrap_or(0.0) * length_m + fixed.unwrap_or(0.0)),
    };
    // A beam that is misaligned by r over the length L measures r²/(2L) too little, which is the range of a uniform
    // distribution. With r in mm and L in m the result is in µm.
    let misalignment = inputs.misalignment_mm.map(|r| EXPANDED_OF_RANGE * r * r / (2.0 * length_m));
    let temperature = (inputs.expansion_um_per_m_k.zip(inputs.temperature_range_k))
        .map(|(alpha, range)| EXPANDED_OF_RANGE * alpha * length_m * range);
    let expansion = (inputs.from_20_degc_k.zip(inputs.expansion_range_um_per_m_k))
        .map(|(difference, range)| EXPANDED_OF_RANGE * difference.abs() * length_m * range);
    let environment = inputs.environment_um.map(|e| EXPANDED_OF_RANGE * e);
    let contributions = vec![
        Contribution { symbol: "U_DEVICE", name: "instrument, by its calibration", u_um: device },
        Contribution {
            symbol: "U_MISALIGNMENT",
            name: "beam along the axis, R²/(2√3 L)",
            u_um: misalignment,
        },
        Contribution {
            symbol: "U_M",
            name: "temperature of the machine, α L R(θ)/√3",
            u_um: temperature,
        },
        Contribution {
            symbol: "U_E",
            name: "expansion coefficient, ΔT L R(α)/√3",
            u_um: expansion,
        },
        Contribution {
            symbol: "U_EVE", name: "environment variation, E_VE/√3", u_um: environment
        },
    ];
    // Contributions that are equal for all readings at a target cancel in B and R.
    let common: f64 =
        [device, misalignment, temperature, expansion].iter().flatten().map(|u| u * u).sum();
    let eve = environment.unwrap_or(0.0).powi(2);
    let n = runs as f64;
    Ok(PositioningUncertainty {
        length_m,
        runs,
        a_um: (common + (4.0 + 2.0 / n) * eve).sqrt(),
        e_um: (common + 2.0 / n * eve).sqrt(),
        m_um: (common + eve / n).sqrt(),
        b_um: (2.0 / n * eve).sqrt(),
        r_um: ((4.0 + 2.0 / n) * eve).sqrt(),
        r_unidirectional_um: 2.0 * eve.sqrt(),
        left_out: left_out(inputs, &contributions),
        contributions,
    })
}

impl PositioningUncertainty {
    /// Expanded uncertainty of the quantity with this symbol, µm. `None` if no uncertainty is defined for the symbol,
    /// or if no input to it is known.
    pub fn of(&self, symbol: &str) -> Option<f64> {
        let u = match symbol {
            "A" | "A_forward" | "A_backward" => self.a_um,
            "E" | "E_forward" | "E_backward" => self.e_um,
            "M" => self.m_um,
            "B" => self.b_um,
            "R" => self.r_um,
            "R_forward" | "R_backward" => self.r_unidirectional_um,
            _ => return None,
        };
        (u > 0.0).then_some(u)
    }
}

fn check(inputs: &UncertaintyInputs, length_m: f64, runs: usize) -> Result<(), MetrologyError> {
    let refuse = |what: &str, found: String, expected: &str| {
        MetrologyError::readings("measurement uncertainty", what, found, expected)
    };
    if !(length_m.is_finite() && length_m > 0.0) {
        let found = format!("{length_m} m");
        return Err(refuse("length", found, "a length above zero"));
    }
    if runs == 0 {
        return Err(refuse("runs", "0".into(), "at least one"));
    }
    let named = [
        ("instrument", inputs.device_um_per_m),
        ("instrument", inputs.device_um),
        ("misalignment", inputs.misalignment_mm),
        ("range of the temperature", inputs.temperature_range_k),
        ("expansion coefficient", inputs.expansion_um_per_m_k),
        ("range of the expansion coefficient", inputs.expansion_range_um_per_m_k),
        ("difference to 20 °C", inputs.from_20_degc_k.map(f64::abs)),
        ("environment variation", inputs.environment_um),
    ];
    for (what, value) in named {
        if let Some(value) = value
            && !(0.0..=crate::number::LARGEST).contains(&value)
        {
            let expected = "a finite number of at least 0";
            return Err(refuse(what, value.to_string(), expected));
        }
    }
    Ok(())
}

fn left_out(inputs: &UncertaintyInputs, contributions: &[Contribution]) -> Vec<String> {
    let lacking = |symbol: &str| -> Vec<&str> {
        let pairs: Vec<(&str, bool)> = match symbol {
            "U_DEVICE" => vec![("uncertainty of the instrument", false)],
            "U_MISALIGNMENT" => vec![("misalignment", false)],
            "U_M" => vec![
                ("expansion coefficient", inputs.expansion_um_per_m_k.is_some()),
                ("range of the temperature", inputs.temperature_range_k.is_some()),
            ],
            "U_E" => vec![
                ("difference to 20 °C", inputs.from_20_degc_k.is_some()),
                ("range of the expansion coefficient", inputs.expansion_range_um_per_m_k.is_some()),
            ],
            _ => vec![("environment variation", false)],
        };
        let lacking = pairs.into_iter().filter(|(_, stated)| !stated);
        lacking.map(|(name, _)| name).collect()
    };
    let open = contributions.iter().filter(|c| c.u_um.is_none());
    open.map(|c| format!("{}: {} not stated", c.symbol, lacking(c.symbol).join(" and "))).collect()
}
