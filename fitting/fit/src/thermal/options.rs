use crate::FitError;

#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalOptions {
    /// Time constants, s; 0 for no lag. Each single time constant and each pair is tried.
    pub lags_s: Vec<f64>,
    /// Penalties of the ridge regression, as fractions of the variance of a feature.
    pub penalties: Vec<f64>,
    /// Whether sensors are removed one after the other, as long as the forward validation does not get worse.
    pub select_sensors: bool,
    /// Number of the best choices that are averaged, because their ranking is partly chance. 0 counts as 1.
    pub mean_of: usize,
}

impl Default for ThermalOptions {
    fn default() -> Self {
        Self {
            lags_s: vec![0.0, 120.0, 300.0, 600.0, 900.0, 1200.0, 1800.0, 2700.0, 3600.0, 5400.0],
            penalties: vec![1e-5, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1],
            select_sensors: false,
            mean_of: 20,
        }
    }
}

impl ThermalOptions {
    /// Ridge regression on temperature differences without lags. The penalty is also chosen by forward validation. It
    /// is the baseline for fits with lags.
    pub fn plain() -> Self {
        Self { lags_s: vec![0.0], mean_of: 1, ..Self::default() }
    }
}

impl ThermalOptions {
    pub(super) fn check(&self) -> Result<(), FitError> {
        let wrong = |what, value, expected| Err(FitError::Parameter { what, value, expected });
        if self.lags_s.is_empty() || self.penalties.is_empty() {
            return wrong("number of lags or penalties", 0.0, "at least one of each");
        }
        if let Some(&lag) = self.lags_s.iter().find(|lag| !(**lag >= 0.0 && lag.is_finite())) {
            return wrong("lag, s", lag, "0 or more");
        }
        match self.penalties.iter().find(|p| !(**p > 0.0 && p.is_finite())) {
            Some(&penalty) => wrong("penalty", penalty, "a positive number"),
            None => Ok(()),
        }
    }
}
