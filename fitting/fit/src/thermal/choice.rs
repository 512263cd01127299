//! Choice of lags, sensors and penalty by forward validation: each block of time is predicted from the earlier blocks.

use nalgebra::DMatrix;

use super::{
    columns::ridge,
    columns::{BEFORE, Features, split},
    options::ThermalOptions,
    record::ThermalRecord,
};
use crate::FitError;

/// Maximum number of rows from which lags and penalty are chosen. Neighbouring rows are nearly equal, so more rows do
/// not change the choice.
const ROWS_TO_CHOOSE: usize = 2000;
/// Number of time blocks of the forward validation. The first two are used only for training.
pub(super) const BLOCKS: usize = 10;
/// Maximum ratio of the error of a choice to the error of the best choice. Worse choices are not averaged.
const MEAN_WITHIN: f64 = 1.25;

/// Lags, sensors and penalty of one regression.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalChoice {
    /// Indices of the time constants of this choice in [`ThermalOptions::lags_s`].
    pub lags: Vec<usize>,
    /// Indices of the sensors of this choice in [`ThermalRecord::degc`](crate::ThermalRecord::degc).
    pub sensors: Vec<usize>,
    /// Penalty of the ridge regression, as a fraction of the variance of a feature.
    pub penalty: f64,
    /// Root mean square prediction error over the blocks of the forward validation, µm or µrad.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub forward_rms: f64,
}

/// The best choices among all single lags and all pairs of lags, with every penalty. With sensor selection, they use
/// only the sensors that the best choice needs.
pub(super) fn best_choices(
    features: &Features,
    record: &ThermalRecord,
    train: &[usize],
    options: &ThermalOptions,
) -> Result<Vec<ThermalChoice>, FitError> {
    let stride = train.len().div_ceil(ROWS_TO_CHOOSE);
    let blocks: Vec<DMatrix<f64>> =
        split(train, BLOCKS).map(|rows| features.moments(record, rows, stride)).collect();
    let all: Vec<usize> = (0..features.sensors).collect();
    let mut choices = every_choice(features, &blocks, options, &all);
    if options.select_sensors
        && let Some(best) = choices.first()
    {
        let sensors = best.clone().without_needless(features, &blocks).sensors;
        choices = every_choice(features, &blocks, options, &sensors);
    }
    choices.truncate(options.mean_of.max(1));
    let most = choices.first().map_or(0.0, |best| MEAN_WITHIN * best.forward_rms);
    choices.retain(|choice| choice.forward_rms <= most);
    if choices.is_empty() {
        return Err(FitError::Undetermined { coefficients: features.sensors });
    }
    Ok(choices)
}

fn every_choice(
    features: &Features,
    blocks: &[DMatrix<f64>],
    options: &ThermalOptions,
    sensors: &[usize],
) -> Vec<ThermalChoice> {
    let pairs = (0..features.lags).flat_map(|a| (a..features.lags).map(move |b| (a, b)));
    let choice = |(a, b), &penalty: &f64| {
        let lags = if a == b { vec![a] } else { vec![a, b] };
        let mut choice =
            ThermalChoice { lags, sensors: sensors.to_vec(), penalty, forward_rms: f64::INFINITY };
        choice.forward_rms = choice.validated(features, blocks);
        choice
    };
    let tried =
        pairs.flat_map(|pair| options.penalties.iter().map(move |penalty| choice(pair, penalty)));
    let mut choices: Vec<ThermalChoice> =
        tried.filter(|choice| choice.forward_rms.is_finite()).collect();
    choices.sort_by(|a, b| a.forward_rms.total_cmp(&b.forward_rms));
    choices
}

impl ThermalChoice {
    pub(super) fn columns(&self, features: &Features) -> Vec<usize> {
        let column = |lag: &usize, sensor: &usize| BEFORE + lag * features.sensors + sensor;
        let of_lag = |lag| self.sensors.iter().map(move |sensor| column(lag, sensor));
        self.lags.iter().flat_map(of_lag).collect()
    }

    fn without_needless(mut self, features: &Features, blocks: &[DMatrix<f64>]) -> Self {
        while self.sensors.len() > 1 {
            let without = |place: usize| {
                let mut tried = self.clone();
                tried.sensors.remove(place);
                tried.forward_rms = tried.validated(features, blocks);
                tried
            };
            let tried = (0..self.sensors.len()).map(without);
            match tried.min_by(|a, b| a.forward_rms.total_cmp(&b.forward_rms)) {
                Some(better) if better.forward_rms <= self.forward_rms => self = better,
                _ => break,
            }
        }
        self
    }

    /// RMS error of predicting the third and every later block from the blocks before it; infinite if a fit fails.
    fn validated(&self, features: &Features, blocks: &[DMatrix<f64>]) -> f64 {
        let plan = self.columns(features);
        let mut past = &blocks[0] + &blocks[1];
        let (mut sum, mut count) = (0.0, 0.0);
        for block in &blocks[2..] {
            let Some(ridge) = ridge(&past, &plan, self.penalty) else {
                return f64::INFINITY;
            };
            sum += ridge.squared_error(block, &plan);
            count += block[(0, 0)];
            past += block;
        }
        (sum / count).sqrt()
    }
}
