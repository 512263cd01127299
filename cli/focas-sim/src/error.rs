//! Errors of the program, and conversions between the units of the options, of the control and of this program.

use std::time::Duration;

use volcomp_document::InputError;
use volcomp_guard::barrier::SettingsError;
use volcomp_model::ModelError;
use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement, Mm, PerChannel};

#[derive(Debug, thiserror::Error)]
pub(crate) enum SimError {
    #[error("{place}: found {found}, expected {expected}")]
    Input { place: String, found: String, expected: String },
    #[error("{file}: cannot be read: {source}")]
    Read { file: String, source: std::io::Error },
    #[error("{file}: cannot be written: {source}")]
    Write { file: String, source: std::io::Error },
    #[error(transparent)]
    Place(#[from] InputError),
    #[error("--truth: {0}")]
    Model(#[from] ModelError),
    #[error("the barrier: {0}")]
    Barrier(#[from] SettingsError),
    #[error("--map-words: {0}")]
    Map(#[from] volcomp_tables::control::SettingsError),
    #[error("--listen {address}: {source}")]
    Listen { address: String, source: std::io::Error },
    #[error("{what}: {source}")]
    System { what: &'static str, source: std::io::Error },
}

impl SimError {
    pub(crate) fn input(
        place: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Input { place: place.into(), found: found.into(), expected: expected.into() }
    }

    pub(crate) fn write(file: &str) -> impl FnOnce(std::io::Error) -> Self {
        let file = file.to_owned();
        move |source| Self::Write { file, source }
    }

    pub(crate) fn thread(source: std::io::Error) -> Self {
        let what = "a thread";
        Self::System { what, source }
    }

    /// Exit status: 2 if the arguments or a file are invalid, 1 if the operation failed.
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Listen { source, .. } if source.kind() != std::io::ErrorKind::InvalidInput => 1,
            Self::System { .. } | Self::Write { .. } => 1,
            _ => 2,
        }
    }
}

/// Converts a number of units of `unit_s` seconds to a duration.
pub(crate) fn duration(place: &str, found: f64, unit_s: f64) -> Result<Duration, SimError> {
    Duration::try_from_secs_f64(found * unit_s)
        .map_err(|_| SimError::input(place, found.to_string(), "a time that is not negative"))
}

/// One count of an axis in the words of the simulated control: 1 µm and 0.001 deg.
pub(crate) fn count(kind: AxisKind) -> Displacement {
    match kind {
        AxisKind::Linear => Displacement::Length(Mm(0.001)),
        AxisKind::Rotary => Displacement::Angle(Deg(0.001).to_rad()),
    }
}

/// Axis letters, separated by commas.
pub(crate) fn letters(axes: &[AxisName]) -> String {
    let letters: Vec<String> = axes.iter().map(AxisName::to_string).collect();
    letters.join(",")
}

/// Converts a position in mm and rad to the control's units, mm and deg.
pub(crate) fn outside(axes: &[AxisName], place: &PerChannel<f64>) -> Vec<f64> {
    let of = |(axis, value): (&AxisName, &f64)| Displacement::new(axis.kind(), *value).mm_or_deg();
    axes.iter().zip(place.iter()).map(of).collect()
}
