//! What stands in a report: plain data. Numbers are in the units that people read: coordinates in mm or deg, errors in µm or
//! µrad.

use serde::{Deserialize, Serialize};
use volcomp_fit::BandSource;
use volcomp_metrology::{Iso230Part2, Vdi3441, Verdict};
use volcomp_vocabulary::{Direction, ErrorName};

/// A report of a calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Which machine, when, by whom, with what.
    pub head: Head,
    /// The figures that have a tolerance; empty where none is stated.
    pub checks: Vec<Check>,
    /// What a reader must know before any number.
    pub warnings: Vec<Warning>,
    /// Every error curve.
    pub curves: Vec<Curve>,
    /// Positioning tests by ISO 230-2.
    pub positioning: Vec<Positioning>,
    /// The angles between the linear axes.
    pub squareness: Vec<Square>,
    /// Other location errors of the machine.
    pub locations: Vec<Location>,
    /// The body diagonals of ISO 230-6.
    pub diagonals: Option<Diagonals>,
    /// The error over the working space.
    pub volume: Option<Volume>,
    /// How uncertain it is.
    pub uncertainty: Option<Uncertainty>,
    /// The errors that nothing measured, and what each can do.
    pub not_measured: Vec<String>,
    /// The errors that the measurements do not bear out: curves that do not follow their readings, lines that contradict each other, unknowns that
    /// observations leave open or that do not describe them.
    pub undecided: Vec<String>,
    /// The errors whose curves cover a part of the travel only.
    pub partly_measured: Vec<String>,
    /// Whether axes have assembly errors: a squareness or location is then more than its location error.
    pub has_assembly: bool,
    /// What was found from observations of the whole machine.
    pub identified: Option<Identified>,
    /// The version of volcomp that made the report.
    pub version: String,
}

/// Which machine, when, by whom, with what. `None`: neither a file nor an option states it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// The file that the report is made from.
    pub source: String,
    /// The name of the machine.
    pub machine: Option<String>,
    /// Its serial number.
    pub serial: Option<String>,
    /// The date of the measurement.
    pub date: Option<String>,
    /// Who measured.
    pub operator: Option<String>,
    /// The instrument.
    pub instrument: Option<String>,
    /// The lowest and the highest temperature of the air, °C.
    pub air_degc: Option<[f64; 2]>,
    /// The lowest and the highest temperature of the material, °C.
    pub material_degc: Option<[f64; 2]>,
    /// The structure code of the machine.
    pub structure: String,
    /// The axes and their travels.
    pub axes: Vec<AxisTravel>,
    /// The tip of the tool for which volumetric errors hold, mm.
    pub tool_tip_mm: [f64; 3],
    /// The measurement files.
    pub files: Vec<SourceFile>,
}

/// An axis and its travel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxisTravel {
    /// The letter.
    pub axis: String,
    /// Both ends of the travel, mm or deg.
    pub travel: [f64; 2],
    /// `mm` or `deg`.
    pub unit: String,
}

/// A measurement file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceFile {
    /// The file as it was named.
    pub file: String,
    /// What it measures: an error, or the kind of an observation.
    pub measures: String,
    /// How many targets, or rows.
    pub targets: usize,
    /// How many runs forward and backward; `None` for observations.
    pub runs: Option<[usize; 2]>,
    /// The date that it states.
    pub date: Option<String>,
}

/// What a figure is of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckOf {
    /// Of what its symbol says.
    Symbol,
    /// Of the measured errors alone, where others were not measured.
    MeasuredAlone,
    /// Of an error on the part of the travel that its curve covers.
    Part,
    /// Of errors of which the measurements do not bear one out.
    NotBorneOut,
    /// Of what the correction leaves, while the figures of tests are of the machine without it.
    Corrected,
    /// Of the machine at the reference temperature: its thermal terms are left out.
    AtReference,
    /// Of a positioning test.
    Test {
        /// The error that it measures.
        error: String,
        /// The measurement file.
        file: String,
    },
}

/// In words; nothing where the symbol says it.
impl core::fmt::Display for CheckOf {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Symbol => Ok(()),
            Self::MeasuredAlone => f.write_str("the measured errors alone"),
            Self::Part => f.write_str("the part of the travel that its curve covers"),
            Self::NotBorneOut => f.write_str("errors that the measurements do not bear out"),
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
    /// What it is of.
    pub of: CheckOf,
    /// The value of the figure; `None` where the measurements do not give it.
    pub value: Option<f64>,
    /// The most that is allowed.
    pub limit: f64,
    /// `µm` or `µrad`.
    pub unit: String,
    /// Its expanded uncertainty (k = 2) of what is stated; `None` where nothing is.
    pub uncertainty: Option<f64>,
    /// How it stands: by ISO 14253-1 where an uncertainty is stated.
    pub outcome: Verdict,
}

/// A line such as `V of the measured errors alone: 3.13 ± 0.40 µm, allowed 5.00 µm: pass`.
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
            f.write_str(" (no uncertainty given)")?;
        }
        Ok(())
    }
}

/// What a warning is about, the gravest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WarningKind {
    /// Measurements of one error say different things.
    Contradiction,
    /// Fewer targets or runs than ISO 230-2 asks for.
    Few,
    /// Far from 20 °C, or temperatures that nobody states.
    Temperature,
    /// A run or a reading that differs from the others.
    Outlier,
    /// Errors that nothing measured.
    NotMeasured,
    /// What reading and calibrating told besides.
    Note,
}

/// What a reader must know before any number.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// What it is about.
    pub kind: WarningKind,
    /// The sentence, in English.
    pub text: String,
}

/// One error: its readings and its curves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// The name: `EXX`.
    pub error: String,
    /// The axis that moves.
    pub axis: String,
    /// `mm` or `deg`.
    pub x_unit: String,
    /// `µm` or `µrad`.
    pub unit: String,
    /// The travel of the axis.
    pub travel: [f64; 2],
    /// The measured lines; none where the machine file states the curve.
    pub lines: Vec<CurveLine>,
    /// One curve for both directions, or one for each.
    pub branches: Vec<Branch>,
    /// The smallest and the largest value of the curve over the travels of all axes that it depends on.
    pub range: [f64; 2],
    /// Whether it depends on other axes than its own.
    pub has_other_axes: bool,
}

/// One measured line as its curve follows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurveLine {
    /// The file; `None` where the error was found from several other lines.
    pub file: Option<String>,
    /// Single runs; none where only means are known.
    pub runs: Vec<Run>,
    /// Mean readings forward and backward.
    pub means: [Vec<(f64, f64)>; 2],
}

/// One run: targets and deviations, targets ascending.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// The direction of travel.
    pub direction: Direction,
    /// Its number among those of its direction.
    pub number: u32,
    /// Targets and deviations.
    pub points: Vec<(f64, f64)>,
}

/// A curve and how well it follows its readings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Branch {
    /// The direction; `None`: both.
    pub direction: Option<Direction>,
    /// The curve over the travel.
    pub points: Vec<(f64, f64)>,
    /// Mean readings minus curve.
    pub residuals: Vec<(f64, f64)>,
    /// A band about the curve.
    pub band: Option<Band>,
    /// How it was fitted; `None` where the machine file states it.
    pub fit: Option<FitNumbers>,
}

/// A band that holds the true curve with a probability of 95 %, at each place by itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// Coordinates, ascending.
    pub x: Vec<f64>,
    /// The lower edge.
    pub low: Vec<f64>,
    /// The upper edge.
    pub high: Vec<f64>,
    /// What was resampled for it.
    pub source: BandSource,
}

/// How a curve was fitted and how well it follows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FitNumbers {
    /// The kind of curve, as the machine file names it.
    pub kind: String,
    /// How many mean readings.
    pub readings: usize,
    /// Readings minus curve.
    pub residual: Residual,
    /// The leave-one-out error; `None` where a reading cannot be predicted from the others.
    pub leave_one_out: Option<f64>,
    /// The largest difference forward − backward of the curves.
    pub reversal: Option<f64>,
}

/// How far readings lie from their curve: readings minus curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    /// The smallest.
    pub min: f64,
    /// The largest.
    pub max: f64,
    /// The root mean square.
    pub rms: f64,
}

/// A positioning test by ISO 230-2.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Positioning {
    /// The measurement file.
    pub file: String,
    /// The error that it measures.
    pub error: String,
    /// `mm` or `deg`.
    pub x_unit: String,
    /// `µm` or `µrad`.
    pub unit: String,
    /// Every run as it was read.
    pub runs: Vec<Run>,
    /// The year of the edition of ISO 230-2.
    pub edition: u16,
    /// The figures.
    pub result: Iso230Part2,
    /// Those of VDI/DGQ 3441; `None` where it cannot be evaluated.
    pub vdi: Option<Vdi3441>,
    /// Uncertainties of figures, of the contributions that the calibration file states.
    pub uncertainties: Vec<FigureUncertainty>,
}

/// The uncertainty of a figure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FigureUncertainty {
    /// The symbol of the figure.
    pub symbol: String,
    /// Its expanded uncertainty (k = 2), in the unit of the figure.
    pub expanded: f64,
}

/// The angle between two linear axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Square {
    /// The axis from which the angle is counted.
    pub first: String,
    /// The axis to which it is counted.
    pub second: String,
    /// The angle less 90°, µrad.
    pub angle_urad: f64,
    /// The location errors that make it.
    pub from: Vec<Tilt>,
    /// Whether the calibration gives it; else the machine file states it.
    pub measured: bool,
}

/// A location error that is a part of a squareness.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tilt {
    /// Its name.
    pub error: String,
    /// Its value, µrad.
    pub urad: f64,
    /// Its standard uncertainty, of what is stated, µrad; `None` where nothing is.
    pub uncertainty: Option<f64>,
}

/// A location error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Location {
    /// Its name.
    pub error: String,
    /// Its value.
    pub value: f64,
    /// `µm` or `µrad`.
    pub unit: String,
    /// The standard uncertainty (k = 1) that is stated for it.
    pub uncertainty: Option<f64>,
}

/// Where the errors of a state come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// The errors that this calibration found.
    Found,
    /// Those of the machine file that was given as the state before.
    GivenBefore,
    /// Those of the machine file that was given as the truth, without correction.
    Truth,
    /// Those of the truth with the correction of the machine of this report.
    TruthCorrected,
}

/// What is found of a state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OfState<T> {
    /// Where its errors come from.
    pub state: State,
    /// What they make.
    pub found: T,
}

/// The body diagonals of ISO 230-6.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Diagonals {
    /// The state before a compensation, or the only one that is known.
    pub before: OfState<Vec<Diagonal>>,
    /// The state after it.
    pub after: Option<OfState<Vec<Diagonal>>>,
}

/// One diagonal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Diagonal {
    /// `PPP`, `NPP`, `PNP`, `PPN`.
    pub name: String,
    /// Places along it (mm) and deviations (µm).
    pub points: Vec<(f64, f64)>,
    /// The largest less the smallest deviation, µm.
    pub range_um: f64,
}

/// The error of the tool over the working space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Volume {
    /// The state before a compensation, or the only one that is known.
    pub before: OfState<Size>,
    /// The state after it.
    pub after: Option<OfState<Size>>,
    /// Whether a machine has thermal terms, which are left out.
    pub has_thermal: bool,
    /// Whether curves of the machine of the last state cover a part of the travel only.
    pub is_partly_measured: bool,
    /// The errors of the machine whose errors the last state has that the measurements do not bear out.
    pub undecided: Vec<String>,
    /// Whether the machine of the last state states any error.
    pub knows_errors: bool,
    /// Planes through the middle of the working space.
    pub slices: Vec<Slice>,
    /// The ends of the travels of X, Y and Z, mm; of an axis that is not there twice 0.
    pub travels_mm: [[f64; 2]; 3],
    /// Places in space with the error of each state.
    pub vectors: Vec<Vector>,
    /// Number of poses of all axes over which the workpiece was aligned.
    pub poses: usize,
    /// The axes that stand still in the maps and vectors, and where.
    pub standing: Vec<Standing>,
}

/// An axis that stands still.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Standing {
    /// The letter.
    pub axis: String,
    /// Where it stands: deg of a rotary axis, else mm.
    pub at: f64,
}

/// The volumetric error over poses of all axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Size {
    /// Largest error of the tip before alignment, µm.
    pub max_um: f64,
    /// Root mean square before alignment, µm.
    pub rms_um: f64,
    /// Largest error of the tip after best-fit rigid-body alignment of the workpiece, µm.
    pub form_max_um: f64,
    /// Root mean square after alignment, µm.
    pub form_rms_um: f64,
    /// Largest tilt of the tool axis after alignment, µrad.
    pub tilt_urad: f64,
    /// The pose of the largest error of the tip after alignment.
    pub at: Vec<Standing>,
    /// The tool with which it is reached; empty: the one in the spindle.
    pub tool: String,
}

impl Size {
    /// The pose of the largest error of the tip and its tool, such as `X 500.0, C 90.0, T5`.
    pub fn place(&self) -> String {
        let pose = place(&self.at);
        if self.tool.is_empty() {
            pose
        } else {
            format!("{pose}, {}", self.tool)
        }
    }
}

/// A pose, such as `X 500.0, C 90.0`.
pub(crate) fn place(at: &[Standing]) -> String {
    let parts: Vec<String> = at
        .iter()
        .map(|Standing { axis, at }| format!("{axis} {at:.1}"))
        .collect();
    parts.join(", ")
}

/// The length of the error over a plane, after alignment of the workpiece.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Slice {
    /// The axis to the right.
    pub across: String,
    /// The axis upwards.
    pub up: String,
    /// The axis that is held; `None` on a machine that has no third one.
    pub held: Option<Standing>,
    /// The nodes to the right, mm.
    pub x: Vec<f64>,
    /// The nodes upwards, mm.
    pub y: Vec<f64>,
    /// The length of the error before, µm; to the right fastest.
    pub before_um: Vec<f64>,
    /// The length of the error after, µm.
    pub after_um: Option<Vec<f64>>,
}

/// The errors at a place, after alignment of the workpiece.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vector {
    /// The place, mm.
    pub at_mm: [f64; 3],
    /// The error before, µm.
    pub before_um: [f64; 3],
    /// The error after, µm.
    pub after_um: Option<[f64; 3]>,
}

/// How uncertain the error over the working space is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// What machines tell that the measurements allow; `None` where none was drawn.
    pub drawn: Option<Drawn>,
    /// Contributions that the calibration file states.
    pub stated: Vec<Contribution>,
    /// What it does not count, in sentences.
    pub not_counted: Vec<String>,
}

/// A contribution to the uncertainty, as the calibration file states it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contribution {
    /// Its key in `[uncertainty]`.
    pub key: String,
    /// The standard uncertainty (k = 1).
    pub standard: f64,
    /// The unit: `µm/m`, `µm` or `µrad`.
    pub unit: String,
}

/// The spread of machines that the measurements allow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drawn {
    /// How many machines were drawn, 2 at the least.
    pub trials: u64,
    /// The seed of the draws.
    pub seed: u64,
    /// Root mean square of the standard uncertainty (k = 1) of the position error over poses of all axes, µm.
    pub rms_um: f64,
    /// The largest, µm.
    pub max_um: f64,
    /// The pose of the largest.
    pub at: Vec<Standing>,
}

/// What was found from observations of the whole machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identified {
    /// The unknowns.
    pub parameters: Vec<Parameter>,
    /// How many combinations the observations determine.
    pub rank: usize,
    /// Of how many unknowns that count.
    pub of: usize,
    /// How well those that are determined can be told apart: 1 is best.
    pub score: f64,
    /// How many times larger the uncertainties are than stated, by what is left of the rows.
    pub excess: f64,
    /// What is left of the fitted rows.
    pub residual: Left,
    /// What is left of rows that were left out of the fit.
    pub left_out: Option<Left>,
    /// What is left of rows that are only predicted.
    pub judged: Option<Left>,
    /// Combinations that move nothing in the observations.
    pub null_space: Vec<Vec<Weighted>>,
    /// Unknowns that are zero by convention.
    pub redundant: Vec<String>,
    /// The pose that would help most, in words.
    pub next: Option<String>,
}

impl Identified {
    /// The coefficients of an error.
    fn of_error<'a>(&'a self, error: &'a str) -> impl Iterator<Item = &'a Parameter> {
        let all = self.parameters.iter();
        all.filter(move |of| of.name.split(' ').next() == Some(error))
    }

    /// Whether the observations leave an error open: one of its coefficients, or one that has to be zero for those that were found.
    pub fn leaves_open(&self, error: &str) -> bool {
        self.of_error(error).any(|of| {
            self.left_open()
                .any(|open| open == of.name || of.given_zero.iter().any(|zero| zero == open))
        })
    }

    /// The coefficients of errors that the observations leave open and that are zero by no convention.
    pub fn left_open(&self) -> impl Iterator<Item = &str> {
        let open = self.parameters.iter().filter(|of| of.uncertainty.is_none());
        let names = open.map(|of| of.name.as_str());
        names.filter(|name| {
            let error = name.split(' ').next().unwrap_or(name);
            error.parse::<ErrorName>().is_ok() && !self.redundant.iter().any(|zero| zero == name)
        })
    }
}

/// What a model leaves of rows of observations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Left {
    /// The root mean square, µm.
    pub rms_um: f64,
    /// The largest, µm.
    pub max_um: f64,
    /// How many rows.
    pub rows: usize,
}

/// An unknown in a combination.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Weighted {
    /// Its name.
    pub name: String,
    /// Its weight.
    pub weight: f64,
}

/// One unknown.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its standard uncertainty (k = 1); `None`: not determined.
    pub uncertainty: Option<f64>,
    /// The unit.
    pub unit: String,
    /// The unknowns that have to be zero for this value to hold.
    pub given_zero: Vec<String>,
}
