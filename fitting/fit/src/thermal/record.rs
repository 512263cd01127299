//! A thermal test: temperatures and one displacement over time.

use crate::FitError;

/// A thermal test: temperatures and one displacement over time.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalRecord {
    /// Time of each row, s, increasing.
    pub time_s: Vec<f64>,
    /// Temperature of each sensor in each row, °C: `degc[sensor][row]`.
    pub degc: Vec<Vec<f64>>,
    /// Displacement in each row, µm or µrad.
    pub displacement: Vec<f64>,
}

impl ThermalRecord {
    /// The number of rows.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    pub(super) fn check(&self) -> Result<(), FitError> {
        let named = [("time", &self.time_s), ("displacement", &self.displacement)];
        let all = named
            .into_iter()
            .chain(self.degc.iter().map(|column| ("temperature", column)));
        for (what, column) in all {
            if column.len() != self.len() {
                return Err(FitError::Lengths {
                    abscissae: self.len(),
                    readings: column.len(),
                });
            }
            if let Some((index, &value)) = column.iter().enumerate().find(|(_, x)| !x.is_finite()) {
                return Err(FitError::NotFinite { what, index, value });
            }
        }
        match self.time_s.windows(2).find(|pair| pair[1] <= pair[0]) {
            Some(pair) => Err(FitError::Parameter {
                what: "time, s",
                value: pair[1],
                expected: "later than the row before",
            }),
            None => Ok(()),
        }
    }
}
