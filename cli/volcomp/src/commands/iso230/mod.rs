pub(crate) mod circle;
pub(crate) mod diagonals;
pub(crate) mod positioning;

use std::path::PathBuf;

use clap::ValueEnum;
use volcomp_metrology::{Edition, Environment, MotionKind, REFERENCE_DEGC, UncertaintyInputs};
use volcomp_vocabulary::{AxisName, ErrorName};

use super::{Answer, evaluation::with_csv};
use crate::{
    arguments::Unit,
    failure::Failure,
    output::{PlotArguments, PlotFile},
};

/// Evaluate tests to ISO 230: positioning, circles, diagonals
///
/// The standard of positioning requires at least, in each direction: linear axes up to 2000 mm, five targets a metre, at
/// least five, and five runs; longer ones a target every 250 mm and one run; rotary axes 3 targets up to 90°, 5 up to
/// 180°, 8 up to 360°, and five runs; above 360°, 8 targets a turn and one run. A contribution of the uncertainty that is
/// not stated counts as zero.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp iso230 exx.rtl --standard all --tolerance A=90,B=5
  volcomp --json iso230 circle.csv --part 4 --radius-mm 150")]
pub(crate) struct Iso230Arguments {
    /// Measurement files: .csv, .rtl, .rta, .pos, a report or a log; for circles .csv
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Part of ISO 230: 2 (positioning), 4 (circles) or 6 (diagonals)
    #[arg(long, default_value_t = 2, value_parser = parse_part)]
    part: u8,
    /// Edition of ISO 230-2: 1997, 2006 or 2014 [default: 2014]
    #[arg(long, value_parser = parse_edition)]
    edition: Option<u16>,
    /// Standard of a positioning test
    #[arg(long, default_value = "iso")]
    standard: Standard,
    /// Unit of deviations that the file (.csv) does not state; results are in µm or µrad [default: µm; µrad for tilts with
    /// --bridge-mm]
    #[arg(long)]
    unit: Option<Unit>,
    /// Axis, which decides the required targets and runs [default: as in the file, else a linear axis]
    #[arg(long)]
    axis: Option<AxisName>,
    /// Override the error name in the file title: EXX
    #[arg(long, value_parser = parse_positioning)]
    error: Option<ErrorName>,
    /// Limits by symbol, µm or µrad: A=10,E=8,B=2
    #[arg(long, value_name = "LIMITS")]
    tolerance: Option<String>,
    /// Write a CSV file with a row for each input file
    #[arg(long, short = 'o', value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    plot: PlotArguments,
    #[command(flatten)]
    uncertainty: UncertaintyOptions,
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

impl Iso230Arguments {
    fn plot_file(&self) -> Result<Option<PlotFile>, Failure> {
        self.plot.open(&with_csv(&self.files, self.csv.as_deref()))
    }

    fn axis(&self) -> Option<AxisName> {
        self.axis.or(self.error.map(|error| error.axis))
    }

    fn edition(&self) -> Edition {
        // clap has already rejected other years.
        self.edition.and_then(Edition::of_year).unwrap_or_default()
    }
}

pub(crate) fn run(arguments: &Iso230Arguments) -> Result<Answer, Failure> {
    let part = arguments.part;
    let uncertain = arguments.uncertainty.stated();
    // Each of these options belongs to one part.
    for (option, of) in [
        (arguments.circle.given(), 4),
        (arguments.diagonals.given(), 6),
        (uncertain.then_some("options of the measurement uncertainty"), 2),
        (arguments.edition.map(|_| "--edition"), 2),
        ((arguments.standard != Standard::Iso).then_some("--standard"), 2),
        (arguments.axis.map(|_| "--axis"), 2),
        (arguments.error.map(|_| "--error"), 2),
    ] {
        if let Some(option) = option
            && part != of
        {
            return Err(Failure::Input(format!(
                "{option}: found --part {part}, expected --part {of}"
            )));
        }
    }
    if let (Some(axis), Some(error)) = (arguments.axis, arguments.error)
        && axis != error.axis
    {
        let message = format!("--error: found {error}, expected an error of --axis {axis}");
        return Err(Failure::Input(message));
    }
    if part == 4 && arguments.unit.is_some() {
        let message =
            "--unit: found --part 4, expected --part 2 or 6: circles state units in their header";
        return Err(Failure::Input(message.to_owned()));
    }
    if uncertain && arguments.standard == Standard::Vdi {
        let message = "options of the measurement uncertainty: found --standard vdi, which states none, expected iso, asme or all";
        return Err(Failure::Input(message.to_owned()));
    }
    if uncertain && !arguments.edition().states_uncertainty() {
        let message = "options of the measurement uncertainty: found --edition 1997, expected 2006 or 2014, which have the annex on it";
        return Err(Failure::Input(message.to_owned()));
    }
    match part {
        4 => circle::run(arguments),
        6 => diagonals::run(arguments),
        _ => positioning::run(arguments),
    }
}

/// Inputs of the measurement uncertainty; what is not stated is left out, and said.
#[derive(clap::Args, Default, PartialEq)]
#[command(next_help_heading = "Measurement uncertainty")]
pub(crate) struct UncertaintyOptions {
    /// Calibration uncertainty of the instrument (k = 2): part proportional to length, µm/m
    #[arg(long, value_name = "UM_PER_M")]
    device_um_per_m: Option<f64>,
    /// Calibration uncertainty of the instrument (k = 2): constant part, µm
    #[arg(long, value_name = "UM")]
    device_um: Option<f64>,
    /// Largest lateral deviation of the beam from the axis over its length, mm
    #[arg(long, value_name = "MM")]
    misalignment_mm: Option<f64>,
    /// Range within which the machine temperature is known, K
    #[arg(long, value_name = "K")]
    temperature_range_k: Option<f64>,
    /// Expansion coefficient of the machine, µm/(m·K) [default: from the file]
    #[arg(long, value_name = "UM_PER_M_K")]
    expansion: Option<f64>,
    /// Range within which the expansion coefficient is known, µm/(m·K)
    #[arg(long, value_name = "UM_PER_M_K")]
    expansion_range: Option<f64>,
    /// Machine temperature, °C [default: the material temperature in the file farthest from 20 °C]
    #[arg(long, value_name = "DEGC", allow_hyphen_values = true)]
    machine_degc: Option<f64>,
    /// Range of a drift test as long as the measurement, µm
    #[arg(long, value_name = "UM")]
    environment_um: Option<f64>,
}

impl UncertaintyOptions {
    pub(crate) fn stated(&self) -> bool {
        *self != Self::default()
    }

    /// The inputs of the uncertainty, with the environment recorded in the file.
    pub(crate) fn inputs(&self, environment: &Environment) -> UncertaintyInputs {
        let sensors = environment.material_temperature.iter().flatten();
        let farthest = sensors
            .flat_map(|sensor| [sensor.start, sensor.end])
            .map(|degc| degc - REFERENCE_DEGC)
            .max_by(|a, b| a.abs().total_cmp(&b.abs()));
        let of_file = environment.expansion_coefficient.map(|c| c.start);
        UncertaintyInputs {
            device_um_per_m: self.device_um_per_m,
            device_um: self.device_um,
            misalignment_mm: self.misalignment_mm,
            temperature_range_k: self.temperature_range_k,
            // A file states the coefficient 0 for "no compensation", so 0 is not the coefficient of the material.
            expansion_um_per_m_k: self.expansion.or(of_file.filter(|c| *c > 0.0)),
            expansion_range_um_per_m_k: self.expansion_range,
            from_20_degc_k: self.machine_degc.map(|t| t - REFERENCE_DEGC).or(farthest),
            environment_um: self.environment_um,
        }
    }
}
