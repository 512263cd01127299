//! Measurement files and ISO 230 evaluation: positioning, straightness, squareness, Abbe.
//!
//! - **Files** become a [`Measurement`], plain data: [`read_file`] takes Renishaw `.rtl` and `.rta` and the
//!   table `target,run,direction,deviation`; [`write_renishaw`] and [`write_csv`] write them.
//! - **ISO 230-2**: [`evaluate`] gives A, R, E, M and B with the per-target table, and [`OutlierHint`]s that point at
//!   runs and readings unlike the others.
//! - **Geometry**: straightness from bridge readings ([`angular_method_um`]), reference lines ([`ReferenceLine`]),
//!   squareness from two slopes ([`squareness()`]), and what angular errors add to a
//!   linear one measured off its point ([`lever_mm`], [`abbe_um`]).
//!
//! Targets are mm or deg, deviations µm or µrad and measured minus target, vectors `[f64; 3]` along the axes of the
//! machine coordinate system.
//!
//! ```
//! use volcomp_metrology::{evaluate, parse_csv};
//!
//! let table = b"target,run,direction,deviation
//! 0,1,+,1.0
//! 500,1,+,4.0
//! 500,1,-,6.0
//! 0,1,-,2.0
//! 0,2,+,1.2
//! 500,2,+,4.4
//! 500,2,-,6.4
//! 0,2,-,2.2
//! ";
//! let measurement = parse_csv(table, "x-axis.csv")?;
//! let result = evaluate(&measurement)?;
//! assert!((result.b.unwrap() - 2.0).abs() < 1e-12); // reversal value, at target 500
//! assert!((result.e.unwrap() - 5.1).abs() < 1e-12); // means from 1.1 (↑ at 0) to 6.2 (↓ at 500)
//!
//! let broken = parse_csv(b"target,deviation\n0,1.5\n500,nan\n", "x-axis.csv").unwrap_err();
//! assert!(broken.to_string().starts_with("x-axis.csv:3: deviation: found `nan`, expected"));
//! # Ok::<(), volcomp_metrology::MetrologyError>(())
//! ```
//!
//! Nothing is corrected in silence: what a reader passes over or decides (runs of zeros left out, text in another
//! encoding, an unfinished last line) stands in [`Measurement::notes`]; everything else that is wrong is a
//! [`MetrologyError`] with file, line, what was found and what was expected. No input panics.

mod abbe;
mod csv_file;
mod encoding;
mod error;
mod iso230_2;
mod measurement;
mod motion_kind;
mod number;
mod outliers;
mod read;
mod renishaw;
mod squareness;
mod straightness;

pub use abbe::{CarriedSide, Rides, Travel, abbe_um, lever_mm};
pub use csv_file::{parse_csv, write_csv};
pub use error::{Finding, MetrologyError};
pub use iso230_2::{Approach, Iso230Part2, TargetRow, evaluate};
pub use measurement::{DeviationUnit, Environment, Measurement, Metadata, Reading, StartEnd};
pub use motion_kind::MotionKind;
pub use outliers::{OutlierHint, outlier_hints};
pub use read::{READ_EXTENSIONS, read_file};
pub use renishaw::{RenishawKind, parse_renishaw, write_renishaw};
pub use squareness::{squareness, squareness_parts};
pub use straightness::{ReferenceLine, TiltReading, angular_method_um, tilt_sign};
pub use volcomp_vocabulary::Direction;

/// Holds the README's example, so that it is run as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
