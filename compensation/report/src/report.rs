//! The content of a report as plain data. Coordinates are in mm or deg, errors in µm or µrad.

use serde::{Deserialize, Serialize};
use volcomp_fit::BandSource;
use volcomp_identify::Figures;
use volcomp_metrology::{Edition, Iso230Part2, Vdi3441, Verdict};
use volcomp_vocabulary::{AxisName, Direction, ErrorName};

/// Symbol of the largest error of the tool tip over poses of all axes, after best-fit rigid-body alignment of the workpiece.
pub const VOLUME: &str = "V";

/// A report of a calibration, an identification or a machine file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Machine, date, operator, instrument.
    pub head: Head,
    /// Figures that have a tolerance, with their verdicts.
    pub checks: Vec<Check>,
    /// Warnings, shown before any number.
    pub warnings: Vec<Warning>,
    /// Curves of all errors, measured or from the machine file.
    pub curves: Vec<Curve>,
    /// Positioning tests to ISO 230-2.
    pub positioning: Vec<Positioning>,
    /// The angles between the linear axes.
    pub squareness: Vec<Square>,
    /// Other location errors of the machine.
    pub locations: Vec<Location>,
    /// The body diagonals of ISO 230-6.
    pub diagonals: Option<Diagonals>,
    pub volume: Option<Volume>,
    pub uncertainty: Option<Uncertainty>,
    /// Sentences on the errors that were not measured, with their possible effect.
    pub not_measured: Vec<String>,
    /// Number of errors of the machine's structure without a value; they count as 0.
    pub count_as_0: usize,
    /// Names of errors that the measurements do not determine: curves that do not follow their readings,
    /// contradictory lines, unknowns that the observations do not determine, and observations that the
    /// unknowns do not explain.
    pub undecided: Vec<String>,
    /// Files with a single run, whose scatter is unknown and therefore in no uncertainty.
    #[serde(default)]
    pub without_scatter: Vec<String>,
    /// Names of the errors whose curves cover only part of the travel.
    pub partly_measured: Vec<String>,
    /// Whether axes have assembly errors, so that a squareness or location differs from its location error.
    pub has_assembly: bool,
    /// Results of an identification from observations of the whole machine.
    pub identified: Option<Identified>,
    /// Version of volcomp that wrote the report.
    pub version: String,
}

impl Report {
    /// Sentence of a report whose tolerances are all met, without a full stop.
    pub fn all_met(&self) -> String {
        let met = "all stated tolerances are met";
        match self.count_as_0 {
            0 => met.to_owned(),
            1 => format!("{met}; 1 error was not measured and counts as 0"),
            more => format!("{met}; {more} errors were not measured and count as 0"),
        }
    }
}

/// The machine of a report, and the facts on its measurement.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// Name of the file from which the report is made.
    pub source: String,
    /// The facts; `None` if neither a file nor an option has the value.
    #[serde(flatten)]
    pub stated: Stated,
    /// Structure code of the machine, such as `w X' b Y Z t`.
    pub structure: String,
    /// Every axis of the machine, with both ends of its travel, mm or deg.
    pub axes: Vec<(AxisName, [f64; 2])>,
    /// The tool tip to which volumetric errors refer, mm.
    pub tool_tip_mm: [f64; 3],
    /// The measurement files, with their dates and numbers of runs.
    pub files: Vec<SourceFile>,
}

/// Facts on a machine and its measurement. Values from the caller override those in the files.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stated {
    /// Name of the machine.
    pub machine: Option<String>,
    pub serial: Option<String>,
    /// Date of the measurement, as written in the file or option.
    pub date: Option<String>,
    /// Name of the person who measured.
    pub operator: Option<String>,
    /// Name of the measuring instrument.
    pub instrument: Option<String>,
    pub customer: Option<String>,
    /// Number of the certificate.
    pub certificate: Option<String>,
    /// Minimum and maximum air temperature, °C.
    pub air_degc: Option<[f64; 2]>,
    /// Minimum and maximum material temperature, °C.
    pub material_degc: Option<[f64; 2]>,
    /// Edition of ISO 230-2 by which the tests are evaluated.
    pub edition: Edition,
}

/// A measurement file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceFile {
    /// The file as named by the user.
    pub file: String,
    /// The measured error, or the kind of an observation.
    pub measures: String,
    /// Number of targets or rows.
    pub targets: usize,
    /// Number of runs forward and backward; `None` for observations.
    pub runs: Option<[usize; 2]>,
    /// Date stated in the file.
    pub date: Option<String>,
}

/// Subject of a figure, or a restriction of its value.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckOf {
    /// The subject follows from the symbol.
    Symbol,
    /// The measured errors alone; other errors were not measured.
    MeasuredAlone,
    /// An error over the part of the travel that its curve covers.
    Part,
    /// Errors that the measurements do not determine, at least in part.
    NotConfirmed,
    /// A figure whose uncertainty lacks the scatter of a file with one run.
    ScatterUnknown,
    /// The residual after correction; figures of tests are of the uncorrected
    /// machine.
    Corrected,
    /// The machine at the reference temperature, without its thermal terms.
    AtReference,
    /// A positioning test.
    Test {
        /// The measured error.
        error: String,
        file: String,
    },
}

/// Formats the subject; empty if the symbol suffices.
impl core::fmt::Display for CheckOf {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Symbol => Ok(()),
            Self::MeasuredAlone => f.write_str("the measured errors alone"),
            Self::Part => f.write_str("the part of the travel that its curve covers"),
            Self::NotConfirmed => f.write_str("errors that the measurements do not confirm"),
            Self::ScatterUnknown => f.write_str("readings of one run, whose scatter is not known"),
            Self::Corrected => f.write_str("what the correction leaves"),
            Self::AtReference => f.write_str("the machine at the reference temperature alone"),
            Self::Test { error, file } => write!(f, "{error}, {file}"),
        }
    }
}

/// A figure and its tolerance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Check {
    /// The symbol of the figure: `A`, `E`, `EC0Y`, `V`.
    pub symbol: String,
    /// What the figure refers to.
    pub of: CheckOf,
    /// The value of the figure; `None` if the measurements do not determine it.
    pub value: Option<f64>,
    /// Upper limit of the absolute value.
    pub limit: f64,
    /// `µm` or `µrad`.
    pub unit: String,
    /// Expanded uncertainty (k = 2) from the known contributions; `None` without any.
    pub uncertainty: Option<f64>,
    /// Why the figure has no uncertainty, if it has none.
    pub without_uncertainty: String,
    /// The verdict, by ISO 14253-1 if the uncertainty is known.
    pub outcome: Verdict,
}

/// Formats a line such as `V of the measured errors alone: 3.13 ± 0.40 µm, allowed 5.00 µm: pass`.
impl core::fmt::Display for Check {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let unit = &self.unit;
        f.write_str(&self.symbol)?;
        if self.of != CheckOf::Symbol {
            write!(f, " of {}", self.of)?;
        }
        match (self.value, self.uncertainty) {
            (None, _) => f.write_str(": ")?,
            (Some(value), None) => write!(f, ": {value:.2} {unit}, ")?,
            (Some(value), Some(u)) => write!(f, ": {value:.2} ± {u:.2} {unit}, ")?,
        }
        write!(f, "allowed {:.2} {unit}: {}", self.limit, self.outcome)?;
        if self.value.is_some() && self.uncertainty.is_none() {
            write!(f, " ({})", self.without_uncertainty)?;
        }
        Ok(())
    }
}

/// Kind of a warning, most severe first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WarningKind {
    /// Measurements of one error contradict each other.
    Contradiction,
    /// Fewer targets or runs than ISO 230-2 requires.
    Few,
    /// Temperatures far from 20 °C, or unknown.
    Temperature,
    /// A run or a reading that differs from the others.
    Outlier,
    /// Errors that were not measured.
    NotMeasured,
    /// Other notes from reading and calibrating.
    Note,
}

/// A warning, shown before any number.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Kind, which determines the order of the warnings.
    pub kind: WarningKind,
    /// The message, in English.
    pub text: String,
}

/// One error: its readings and its curves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// The error name, such as `EXX`.
    pub error: String,
    /// The moving axis.
    pub axis: String,
    /// Unit of the coordinates: `mm` or `deg`.
    pub x_unit: String,
    /// Unit of the values: `µm` or `µrad`.
    pub unit: String,
    /// Ends of the travel of the axis, mm or deg.
    pub travel: [f64; 2],
    /// The measured lines; empty if the curve comes from the machine file.
    pub lines: Vec<CurveLine>,
    /// One curve for both directions, or one for each.
    pub branches: Vec<Branch>,
    /// Minimum and maximum of the curve over the travels of all axes on which it depends.
    pub range: [f64; 2],
    /// Whether the error depends on axes other than its own.
    pub has_other_axes: bool,
}

/// Readings of one measured line, shifted to its curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurveLine {
    /// Name of the file; `None` if the error was derived from several lines.
    pub file: Option<String>,
    /// Single runs; empty if only means are known.
    pub runs: Vec<Run>,
    /// Mean readings forward and backward: target and deviation.
    pub means: [Vec<(f64, f64)>; 2],
}

/// Readings of one run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    pub direction: Direction,
    /// Number of the run among the runs of its direction, from 1.
    pub number: u32,
    /// Target and deviation of each reading, targets ascending.
    pub points: Vec<(f64, f64)>,
}

/// A curve, and its residuals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Branch {
    /// Direction for which the curve holds; `None`: both.
    pub direction: Option<Direction>,
    /// Coordinate and value of each point of the curve over the travel.
    pub points: Vec<(f64, f64)>,
    /// Target and residual of each mean reading: reading minus curve.
    pub residuals: Vec<(f64, f64)>,
    pub band: Option<Band>,
    /// Fit results; `None` if the curve comes from the machine file.
    pub fit: Option<FitNumbers>,
}

/// A pointwise 95 % confidence band.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// Coordinates, ascending.
    pub x: Vec<f64>,
    /// Lower limit at each coordinate.
    pub low: Vec<f64>,
    /// Upper limit at each coordinate.
    pub high: Vec<f64>,
    /// Resampling method from which the band follows.
    pub source: BandSource,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FitNumbers {
    /// The kind of curve, named as in the machine file.
    pub kind: String,
    /// Number of mean readings that were fitted.
    pub readings: usize,
    /// Statistics of the readings minus the curve.
    pub residual: Residual,
    /// RMS error of predicting each reading from the others, in the unit of the curve; `None` if a reading cannot be predicted.
    pub leave_one_out: Option<f64>,
    /// Largest difference of the curves, forward − backward, with its sign, in the unit of the curve; `None` if one curve holds for both directions.
    pub reversal: Option<f64>,
}

/// Statistics of the residuals of a fit, readings minus curve, in the unit of the curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    /// Smallest residual, with its sign.
    pub min: f64,
    /// Largest residual, with its sign.
    pub max: f64,
    /// Root mean square of the residuals.
    pub rms: f64,
}

/// A positioning test to ISO 230-2.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Positioning {
    pub file: String,
    /// The measured error.
    pub error: String,
    /// Unit of the targets: `mm` or `deg`.
    pub x_unit: String,
    /// Unit of the readings: `µm` or `µrad`.
    pub unit: String,
    /// All runs, with raw readings.
    pub runs: Vec<Run>,
    /// Year of the edition of ISO 230-2 by which the test was evaluated.
    pub edition: u16,
    /// Results by ISO 230-2.
    pub result: Iso230Part2,
    /// Results by VDI/DGQ 3441; `None` if the test cannot be evaluated by it.
    pub vdi: Option<Vdi3441>,
    /// Uncertainties of the figures, from the contributions stated in the calibration file.
    pub uncertainties: Vec<FigureUncertainty>,
}

/// The expanded uncertainty of one figure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FigureUncertainty {
    /// Symbol of the figure, as in [`Check::symbol`].
    pub symbol: String,
    /// Expanded uncertainty (k = 2), in the unit of the figure.
    pub expanded: f64,
}

/// The angle between two linear axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Square {
    /// The axis from which the angle is counted.
    pub first: String,
    /// The axis to which the angle is counted.
    pub second: String,
    /// Angle between the axes minus 90°, µrad.
    pub angle_urad: f64,
    /// Location errors that add up to the squareness.
    pub from: Vec<Tilt>,
    /// Whether the angle was measured in this calibration; otherwise it comes from the machine file.
    pub measured: bool,
}

/// A location error that contributes to a squareness.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tilt {
    /// Name of the location error.
    pub error: String,
    /// Value of the location error, µrad.
    pub urad: f64,
    /// Standard uncertainty from the stated contributions and the slopes of the lines, with Student's t, µrad; `None` without any contribution.
    pub uncertainty: Option<f64>,
}

/// A location error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Location {
    /// Name of the location error.
    pub error: String,
    pub value: f64,
    /// `µm` or `µrad`.
    pub unit: String,
    /// Standard uncertainty (k = 1) from the calibration file; `None` if it states none.
    pub uncertainty: Option<f64>,
}

/// State of the machine whose errors are shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// The machine of this report: the identified errors, or those of its machine file.
    Found,
    /// The machine file that the user stated as the state before compensation.
    GivenBefore,
    /// The machine file that the user stated as the truth, without correction.
    Truth,
    /// The stated truth, corrected by the machine of this report.
    TruthCorrected,
}

/// A result and the state of the machine to which it belongs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OfState<T> {
    /// State of the machine that has this result.
    pub state: State,
    /// The result, such as the volumetric error.
    pub found: T,
}

/// The body diagonals of ISO 230-6.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Diagonals {
    /// The state before compensation, or the only known one.
    pub before: OfState<Vec<Diagonal>>,
    /// The state after compensation; `None` if it is not known.
    pub after: Option<OfState<Vec<Diagonal>>>,
}

/// Deviations along one body diagonal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Diagonal {
    /// Name by ISO 230-6: `PPP`, `NPP`, `PNP` or `PPN`.
    pub name: String,
    /// Distance along the diagonal (mm) and deviation (µm) of each target.
    pub points: Vec<(f64, f64)>,
    /// Maximum minus minimum deviation, µm.
    pub range_um: f64,
}

/// Volumetric error over the working space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Volume {
    /// The state before compensation, or the only known one.
    pub before: OfState<Size>,
    /// The state after compensation; `None` if it is not known.
    pub after: Option<OfState<Size>>,
    /// Whether the machine has thermal terms; they are not included.
    pub has_thermal: bool,
    /// Whether curves of the machine of the last state cover only part of the travel.
    pub is_partly_measured: bool,
    /// Names of the undetermined errors of the machine of the last state.
    pub undecided: Vec<String>,
    /// Whether the machine of the last state has any error.
    pub knows_errors: bool,
    /// Maps on planes through the middle of the working space, then over the first two rotary axes of a machine that has them, with X, Y
    /// and Z in the middle.
    pub slices: Vec<Slice>,
    /// The ends of the travels of X, Y and Z, mm; both 0 for a missing axis.
    pub travels_mm: [[f64; 2]; 3],
    /// Error vectors of each state at positions in the working space.
    pub vectors: Vec<Vector>,
    /// Number of poses of all axes at which the error was evaluated for the alignment of the workpiece.
    pub poses: usize,
    /// Axes at fixed coordinates (mm or deg) in the maps and vectors.
    pub standing: Vec<(AxisName, f64)>,
}

/// Size of the volumetric error over poses of all axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Size {
    /// Largest error of the tip before alignment, µm.
    pub max_um: f64,
    /// Root mean square of the error of the tip before alignment, µm.
    pub rms_um: f64,
    /// Largest error of the tip after best-fit rigid-body alignment of the workpiece, µm.
    pub form_max_um: f64,
    /// Root mean square of the error of the tip after alignment, µm.
    pub form_rms_um: f64,
    /// Largest tilt of the tool axis after alignment, µrad.
    pub tilt_urad: f64,
    /// Pose with the largest error of the tip after alignment, mm and deg.
    pub at: Vec<(AxisName, f64)>,
    /// Name of the tool with the largest error after alignment; empty: the tool in the spindle.
    pub tool: String,
}

impl Size {
    /// Formats pose and tool of the largest error of the tip, such as `X 500.0, C 90.0, T5`.
    pub fn place(&self) -> String {
        let pose = place(&self.at);
        if self.tool.is_empty() { pose } else { format!("{pose}, {}", self.tool) }
    }
}

/// Formats a pose, such as `X 500.0, C 90.0`.
pub(crate) fn place(at: &[(AxisName, f64)]) -> String {
    let parts: Vec<String> = at.iter().map(|(axis, at)| format!("{axis} {at:.1}")).collect();
    parts.join(", ")
}

/// The magnitude of the error over a plane, after alignment of the workpiece.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Slice {
    /// Axis drawn to the right.
    pub across: AxisName,
    /// Axis drawn upwards.
    pub up: AxisName,
    /// Axis at the fixed coordinate (mm) of the plane; `None` on a machine without a third axis, and for a map over rotary axes.
    pub held: Option<(AxisName, f64)>,
    /// Nodes on the axis to the right, mm or deg, ascending.
    pub x: Vec<f64>,
    /// Nodes on the upward axis, mm or deg, ascending.
    pub y: Vec<f64>,
    /// Magnitude of the error before compensation at each node, µm; the axis to the right varies fastest.
    pub before_um: Vec<f64>,
    /// Magnitude of the error after compensation at each node, µm; `None` if that state is not known.
    pub after_um: Option<Vec<f64>>,
    /// Error vectors at positions in the plane; empty for a map over rotary axes.
    #[serde(default)]
    pub vectors: Vec<Vector>,
}

/// Error vectors at a position, after alignment of the workpiece.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vector {
    /// Position in the working space, mm.
    pub at_mm: [f64; 3],
    /// The error before compensation, µm.
    pub before_um: [f64; 3],
    /// The error after compensation, µm; `None` if that state is not known.
    pub after_um: Option<[f64; 3]>,
}

/// Uncertainty of the volumetric error.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// Result of the Monte Carlo simulation; `None` if none was requested.
    pub drawn: Option<Drawn>,
    /// Contributions stated in the calibration file.
    pub stated: Vec<Contribution>,
    /// Sentences on contributions that are not included.
    pub not_counted: Vec<String>,
}

/// Contribution to the uncertainty, as stated in the calibration file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contribution {
    /// Key of the contribution in `[uncertainty]`.
    pub key: String,
    /// Standard uncertainty (k = 1), in `unit`.
    pub standard: f64,
    /// Unit of `standard`: `µm/m`, `µm` or `µrad`.
    pub unit: String,
}

/// Result of a Monte Carlo simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drawn {
    /// Number of Monte Carlo samples, at least 2.
    pub trials: u64,
    pub seed: u64,
    /// Root mean square of the standard uncertainty (k = 1) of the position error over poses of all axes, µm.
    pub rms_um: f64,
    /// Maximum standard uncertainty (k = 1) of the position error over these poses, µm.
    pub max_um: f64,
    /// Pose with the largest standard uncertainty, mm and deg.
    pub at: Vec<(AxisName, f64)>,
}

/// Results of an identification from observations of the whole machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identified {
    /// The unknowns with their values.
    pub parameters: Vec<Parameter>,
    /// Number of independent combinations of the unknowns that the observations determine.
    pub rank: usize,
    /// Number of unknowns that are not zero by convention.
    pub of: usize,
    /// Ratio of the smallest to the largest singular value of the determined unknowns: 0 to 1, 1 is best.
    pub score: f64,
    /// Factor by which the uncertainties exceed those from the stated uncertainties alone, because of the residuals.
    pub excess: f64,
    /// Residuals of the fitted rows.
    pub residual: Figures,
    /// Residuals of rows omitted from the fit (cross-validation); `None`: not computed.
    pub left_out: Option<Figures>,
    /// Residuals of rows that were only predicted; `None` without such rows.
    pub judged: Option<Figures>,
    /// Combinations of unknowns without effect on the observations: name and weight of each unknown.
    pub null_space: Vec<Vec<(String, f64)>>,
    /// Names of unknowns that are zero by convention.
    pub redundant: Vec<String>,
    /// Description of the pose whose measurement would reduce the uncertainty most; `None` if nothing is uncertain.
    pub next: Option<String>,
}

impl Identified {
    fn of_error<'a>(&'a self, error: &'a str) -> impl Iterator<Item = &'a Parameter> {
        let all = self.parameters.iter();
        all.filter(move |of| of.name.split(' ').next() == Some(error))
    }

    /// Whether the observations leave an error undetermined: one of its coefficients is undetermined, or
    /// its value holds only if an undetermined coefficient is zero.
    pub fn leaves_open(&self, error: &str) -> bool {
        self.of_error(error).any(|of| {
            self.left_open()
                .any(|open| open == of.name || of.given_zero.iter().any(|zero| zero == open))
        })
    }

    /// Names of the undetermined coefficients that are not zero by convention.
    pub fn left_open(&self) -> impl Iterator<Item = &str> {
        let open = self.parameters.iter().filter(|of| of.uncertainty.is_none());
        let names = open.map(|of| of.name.as_str());
        names.filter(|name| {
            let error = name.split(' ').next().unwrap_or(name);
            error.parse::<ErrorName>().is_ok() && !self.redundant.iter().any(|zero| zero == name)
        })
    }
}

/// Result for one unknown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name of the unknown, such as `ECZ legendre 1`.
    pub name: String,
    /// Value in `unit`.
    pub value: f64,
    /// Standard uncertainty (k = 1); `None`: the unknown is not determined.
    pub uncertainty: Option<f64>,
    /// Unit of value and uncertainty.
    pub unit: String,
    /// Names of the unknowns that must be zero for this value to hold.
    pub given_zero: Vec<String>,
}
