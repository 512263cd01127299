//! `volcomp iso230`: tests of the parts 2, 4 and 6 of ISO 230, and of the standards beside part 2.

pub(crate) mod circle;
pub(crate) mod diagonals;
pub(crate) mod judged;
mod options;
pub(crate) mod positioning;
pub(crate) mod rows;

use std::path::PathBuf;

use clap::ValueEnum;
use volcomp_metrology::{Edition, MotionKind};
use volcomp_vocabulary::{AxisName, ErrorName};

use super::Answer;
use crate::{failure::Failure, unit::Unit};

/// Evaluates tests by ISO 230: positioning, circles, diagonals
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Measurement files: .csv, .rtl, .rta, .pos, a report or a log; of circles .csv
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Part of ISO 230: 2 (positioning of an axis), 4 (circles), 6 (diagonals)
    #[arg(long, default_value_t = 2, value_parser = parse_part)]
    part: u8,
    /// Edition of ISO 230-2: 1997, 2006 or 2014, without it 2014
    #[arg(long, value_parser = parse_edition)]
    edition: Option<u16>,
    /// Standard of a positioning test; all: each of them
    #[arg(long, default_value = "iso")]
    standard: Standard,
    /// Unit of the deviations in a file that does not state it (.csv), without it µm; the answer is in µm or µrad
    #[arg(long)]
    unit: Option<Unit>,
    /// The axis, for what the standard asks of the test; without it the one that the file names, else a linear one
    #[arg(long)]
    axis: Option<AxisName>,
    /// The error that the file measures, where its title names another that is none of positioning: EXX
    #[arg(long, value_parser = parse_positioning)]
    error: Option<ErrorName>,
    /// Limits by symbol, µm or µrad: A=10,E=8,B=2
    #[arg(long, value_name = "LIMITS")]
    tolerance: Option<String>,
    /// Write a CSV file, a row for each file that is read
    #[arg(long, short = 'o', value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    uncertainty: options::UncertaintyOptions,
    #[command(flatten)]
    diagonals: diagonals::DiagonalOptions,
    #[command(flatten)]
    circle: circle::CircleOptions,
}

/// A standard for positioning tests.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Standard {
    /// ISO 230-2
    Iso,
    /// VDI/DGQ 3441
    Vdi,
    /// ASME B5.54
    Asme,
    /// All of them
    All,
}

fn parse_part(text: &str) -> Result<u8, String> {
    match text {
        "2" => Ok(2),
        "4" => Ok(4),
        "6" => Ok(6),
        _ => Err("expected 2, 4 or 6".to_owned()),
    }
}

fn parse_positioning(text: &str) -> Result<ErrorName, String> {
    let error: Option<ErrorName> = text.to_ascii_uppercase().parse().ok();
    error
        .filter(|error| !error.location && MotionKind::of(*error) == MotionKind::Positioning)
        .ok_or_else(|| "expected the positioning of an axis: EXX, EYY, ECC …".to_owned())
}

pub(crate) fn parse_edition(text: &str) -> Result<u16, String> {
    let year = text.parse().ok().and_then(Edition::of_year);
    let edition =
        year.ok_or("expected 1997, 2006 or 2014; that of 1988, with 3 s, is not evaluated")?;
    Ok(edition.year())
}

impl Arguments {
    /// The axis that the call states, by itself or by its error.
    fn axis(&self) -> Option<AxisName> {
        self.axis.or(self.error.map(|error| error.axis))
    }

    fn edition(&self) -> Edition {
        // The parser let no other year through.
        self.edition.and_then(Edition::of_year).unwrap_or_default()
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let part = arguments.part;
    let refuse = |option: &str, expected: &str| {
        Err(Failure::Input(format!(
            "{option}: found --part {part}, expected --part {expected}"
        )))
    };
    if part != 4
        && let Some(option) = arguments.circle.given()
    {
        return refuse(option, "4");
    }
    if part != 6
        && let Some(option) = arguments.diagonals.given()
    {
        return refuse(option, "6");
    }
    if part != 2 && arguments.uncertainty.stated() {
        return refuse("options of the measurement uncertainty", "2");
    }
    if part != 2 && arguments.edition.is_some() {
        return refuse("--edition", "2");
    }
    if part != 2 && arguments.standard != Standard::Iso {
        return refuse("--standard", "2");
    }
    if part != 2 && arguments.axis.is_some() {
        return refuse("--axis", "2");
    }
    if part != 2 && arguments.error.is_some() {
        return refuse("--error", "2");
    }
    if let (Some(axis), Some(error)) = (arguments.axis, arguments.error)
        && axis != error.axis
    {
        let message = format!("--error: found {error}, expected an error of --axis {axis}");
        return Err(Failure::Input(message));
    }
    if part == 4 && arguments.unit.is_some() {
        return refuse("--unit", "2 or 6: circles state units in their header");
    }
    if arguments.uncertainty.stated() && arguments.standard == Standard::Vdi {
        let message = "options of the measurement uncertainty: found --standard vdi, which states none, expected iso, asme or all";
        return Err(Failure::Input(message.to_owned()));
    }
    if arguments.uncertainty.stated() && !arguments.edition().states_uncertainty() {
        let message = "options of the measurement uncertainty: found --edition 1997, expected 2006 or 2014, which have the annex on it";
        return Err(Failure::Input(message.to_owned()));
    }
    match part {
        4 => circle::run(arguments),
        6 => diagonals::run(arguments),
        _ => positioning::run(arguments),
    }
}
