#![doc = include_str!("../README.md")]

mod band;
mod between;
mod bspline;
mod candidates;
mod choice;
mod choose;
mod error;
mod fit;
mod fourier;
mod least_squares;
mod method;
mod mls;
mod polynomial;
mod readings;
#[cfg(feature = "serde")]
mod serialised;
mod statistics;
mod table;
mod thermal;
mod triangle;

pub use band::{Band, BandOptions, BandSource, MeanScatter, band, band_of_means, band_places};
pub use between::{Between, unevenness};
pub use bspline::fit_bspline;
pub use choice::{AutoFit, Choice, FitOptions, Reason, Score};
pub use choose::{choose, choose_and_fit, fit_auto};
pub use error::FitError;
pub use fit::Fit;
pub use fourier::fit_fourier;
pub use method::Method;
pub use mls::{MLS_ORDERS, MlsTrial, choose_mls, fit_mls, fit_mls_auto, scan_mls};
pub use polynomial::{fit_chebyshev, fit_polynomial};
pub use statistics::{Noise, student_widening};
pub use table::{fit_cubic_table, fit_linear_table};
pub use thermal::{
    CoarseRows, JudgedThermal, TestedRange, ThermalChoice, ThermalEffect, ThermalFit, ThermalGap,
    ThermalNumber, ThermalOptions, ThermalPrediction, ThermalRecord, ThermalRun, ThermalSearch,
    ThermalSegment, ThermalSize, ThermalTerm, ThermalTerms, ThermalVerdict, fit_thermal,
    judge_thermal_rows, judge_thermal_runs, left_out_runs, search_thermal, search_thermal_rows,
};
pub use volcomp_curve as curve;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
