use volcomp_calibrate::{CalibrationFile, Line, Method};
use volcomp_metrology::{
    Edition, MotionKind, UncertaintyInputs, Vdi3441, evaluate, positioning_uncertainty, vdi_3441,
};
use volcomp_vocabulary::Direction;

use crate::{
    curves::runs_of,
    report::{FigureUncertainty, Positioning},
};

pub(crate) fn positioning(file: &CalibrationFile, edition: Edition) -> Vec<Positioning> {
    let lines = file.measurements.iter();
    let tests = lines.filter(|line| {
        MotionKind::of(line.setup.error) == MotionKind::Positioning
            && line.setup.method == Method::Direct
    });
    let test = |line: &Line| {
        let error = line.setup.error;
        // Lines that cannot be evaluated are skipped; they cannot be calibrated either.
        let result = evaluate(&line.readings).ok()?;
        Some(Positioning {
            file: line.file.display().to_string(),
            error: error.to_string(),
            x_unit: error.axis.kind().coordinate_unit().to_owned(),
            unit: error.component.symbol().to_owned(),
            runs: runs_of(&line.readings, |_, _, reading| Some(reading)),
            edition: edition.year(),
            vdi: vdi_3441(&result),
            uncertainties: uncertainties(file, line),
            result,
        })
    };
    tests.filter_map(test).collect()
}

/// Expanded uncertainties of the figures, from the contributions of the instrument in the calibration file: the scale contribution is
/// proportional to the length, the other applies to each reading. Both are common to all readings at a target, and cancel in B and R.
fn uncertainties(file: &CalibrationFile, line: &Line) -> Vec<FigureUncertainty> {
    let of = &file.uncertainty;
    let targets = line.readings.targets();
    let ends = targets.first().zip(targets.last());
    let travel = ends.map_or(0.0, |(first, last)| last - first);
    let positive = |standard: f64| (standard > 0.0).then_some(2.0 * standard);
    let (inputs, length) = if line.setup.error.component.is_angular() {
        // The reading uncertainty of an angle is in µrad and independent of the length.
        let device_um = positive(of.reading_urad);
        (UncertaintyInputs { device_um, ..UncertaintyInputs::default() }, 1.0)
    } else {
        let inputs = UncertaintyInputs {
            device_um_per_m: positive(of.laser_um_per_m),
            device_um: positive(of.reading_um),
            ..UncertaintyInputs::default()
        };
        (inputs, 1e-3 * travel)
    };
    let runs = Direction::BOTH.map(|direction| line.readings.runs(direction).len());
    let fewest = runs.into_iter().filter(|runs| *runs > 0).min().unwrap_or(1);
    // With a single target there is no length, and so no uncertainty.
    let Ok(found) = positioning_uncertainty(&inputs, length, fewest) else {
        return Vec::new();
    };
    let symbols = Edition::symbols().into_iter();
    symbols
        .filter_map(|symbol| {
            Some(FigureUncertainty { symbol: symbol.to_owned(), expanded: found.of(symbol)? })
        })
        .collect()
}

impl Positioning {
    /// Value of a figure by its symbol in ISO 230-2 or VDI/DGQ 3441; `None` if the runs do not determine it.
    pub fn figure(&self, symbol: &str) -> Option<f64> {
        let iso = Edition::default().quantities(&self.result);
        let vdi = Vdi3441::quantities(self.vdi.as_ref());
        let found = iso.iter().chain(&vdi).find(|q| q.symbol == symbol)?;
        found.value
    }

    /// Expanded uncertainty of a figure; `None` if the calibration file states no contribution to it.
    pub fn uncertainty(&self, symbol: &str) -> Option<f64> {
        let found = self.uncertainties.iter().find(|of| of.symbol == symbol);
        found.map(|of| of.expanded)
    }
}
