#![doc = include_str!("../README.md")]

mod band;
mod between;
mod bspline;
mod choose;
mod error;
mod fit;
mod mls;
mod polynomial;
mod readings;
#[cfg(feature = "serde")]
mod serialised;
mod thermal;

pub use band::{Band, BandOptions, BandSource, MeanScatter, band, band_of_means, band_places};
pub use between::{Between, unevenness};
pub use bspline::fit_bspline;
pub use choose::{
    AutoFit, Choice, FitOptions, Method, Reason, Score, choose, choose_and_fit, fit_auto,
};
pub use error::FitError;
pub use fit::Fit;
pub use mls::{MLS_ORDERS, MlsTrial, choose_mls, fit_mls, fit_mls_auto, scan_mls};
pub use polynomial::{
    fit_chebyshev, fit_cubic_table, fit_fourier, fit_linear_table, fit_polynomial,
};
pub use readings::{Noise, student_widening};
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
