//! Selection of the few sensors that best predict the movement of all sensors.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::record::ThermalRun;

/// Level of noise, K. A sensor whose mean movement is smaller has less weight.
const NOISE_K: f64 = 0.05;
/// Movement below which a sensor counts as constant, K.
const STILL_K: f64 = 1e-3;
/// A sensor counts as redundant if the chosen sensors leave less than this fraction of its variance.
const MIN_SHARE: f64 = 1e-6;
const MAX_ROWS: usize = 2000;

/// Chooses sensors one after the other. Each time, the sensor is chosen that, together with the sensors chosen before,
/// explains most of the movement of all sensors, each scaled by its own movement. Displacements are ignored, because
/// among many correlated sensors they would select the sensor whose noise fits best by chance.
pub(super) fn representative_sensors(
    runs: &[(&ThermalRun, Range<usize>)],
    most: usize,
) -> Vec<usize> {
    let sensors = runs.first().map_or(0, |(run, _)| run.record.degc.len());
    let mut columns: Vec<DVector<f64>> = (0..sensors)
        .map(|sensor| {
            let moved = runs.iter().flat_map(|(run, rows)| {
                let step = rows.len().div_ceil(MAX_ROWS).max(1);
                let degc = &run.record.degc[sensor];
                let taken: Vec<f64> = rows.clone().step_by(step).map(|row| degc[row]).collect();
                let mean = taken.iter().sum::<f64>() / taken.len().max(1) as f64;
                taken.into_iter().map(move |degc| degc - mean)
            });
            let moved: Vec<f64> = moved.collect();
            let rms = (moved.iter().map(|x| x * x).sum::<f64>() / moved.len().max(1) as f64).sqrt();
            let scale = if rms > STILL_K { rms.max(NOISE_K) } else { f64::INFINITY };
            DVector::from_vec(moved) / scale
        })
        .collect();
    let mut chosen = Vec::new();
    let initial: Vec<f64> = columns.iter().map(DVector::norm_squared).collect();
    while chosen.len() < most {
        let products = DMatrix::from_fn(sensors, sensors, |i, j| columns[i].dot(&columns[j]));
        let left = |&sensor: &usize| {
            !chosen.contains(&sensor) && products[(sensor, sensor)] > MIN_SHARE * initial[sensor]
        };
        let explains =
            |sensor: usize| products.column(sensor).norm_squared() / products[(sensor, sensor)];
        let best = (0..sensors).filter(left).max_by(|a, b| explains(*a).total_cmp(&explains(*b)));
        let Some(best) = best else { break };
        let unit = columns[best].normalize();
        for column in &mut columns {
            let part = unit.dot(column);
            column.axpy(-part, &unit, 1.0);
        }
        chosen.push(best);
    }
    chosen
}
