//! The quantities that other systems are told: one list for all of them, made for a machine once and read from its state at
//! any time.

mod list;
mod reading;

use volcomp_vocabulary::AxisName;

pub(super) use list::key_of;
pub use list::quantities;
pub(crate) use reading::{length, reasons};

/// The parts of a gateway that decide which quantities there are. They stay the same while it runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shape {
    /// The name of the machine.
    pub machine: String,
    /// The letters of its axes in the order X Y Z A B C U V W.
    pub axes: Vec<AxisName>,
    /// The names of its temperatures in the order of the configuration.
    pub sensors: Vec<String>,
    /// The number of its controllers.
    pub controllers: usize,
}

/// What a quantity tells. Numbers are places in the order of the configuration, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// The state of the gateway in one word.
    State,
    /// Its reasons, one after the other.
    Reasons,
    /// Whether it corrects, or will again by itself.
    Armed,
    /// Whether the machine is the built-in simulation.
    Simulated,
    /// The age of what is told.
    Age,
    /// The controller that corrects.
    ActiveController,
    /// Whether the correction that the control applies is known.
    CorrectionKnown,
    /// Exchanges with controllers that failed so far.
    Faults,
    /// Periods that were missed so far.
    Overruns,
    /// The name of the machine.
    Machine,
    /// The checksum of the machine file.
    MachineFile,
    /// The position of an axis without the correction.
    Position(AxisName),
    /// The correction that the control applies.
    Correction(AxisName),
    /// The correction that the model asks for.
    Wanted(AxisName),
    /// The correction that was sent last.
    Sent(AxisName),
    /// The length of the position error of the tool without correction.
    Error,
    /// The length of the position error that the correction leaves.
    Residual,
    /// The length of the direction error of the tool axis without correction.
    AxisError,
    /// The length of the direction error that the correction leaves.
    AxisResidual,
    /// A temperature.
    Temperature(usize),
    /// The time since a controller answered last.
    Answered(usize),
    /// The age of the positions of a controller.
    PositionsAge(usize),
    /// The time since the correction of a controller was confirmed last.
    Confirmed(usize),
    /// Whether a controller applies a correction other than zero.
    HoldsCorrection(usize),
    /// Whether a barrier in the control takes the correction.
    Barrier(usize),
}

/// The unit of a quantity that is a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Millimetres.
    Mm,
    /// Degrees.
    Deg,
    /// Micrometres.
    Um,
    /// Microradians.
    Urad,
    /// Degrees Celsius.
    Degc,
    /// Milliseconds.
    Ms,
}

impl Unit {
    /// The unit as people read it.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Mm => "mm",
            Self::Deg => "deg",
            Self::Um => "µm",
            Self::Urad => "µrad",
            Self::Degc => "°C",
            Self::Ms => "ms",
        }
    }
}

/// The type of the value of a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A number in a unit.
    Number(Unit),
    /// A whole number.
    Whole,
    /// Yes or no.
    Truth,
    /// A text.
    Text,
}

/// The value of a quantity.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A finite number in the unit of the quantity.
    Number(f64),
    /// A whole number.
    Whole(u64),
    /// Yes or no.
    Truth(bool),
    /// A text.
    Text(String),
}

/// What a value is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quality {
    /// It is so.
    Good,
    /// It is used, and something speaks against it.
    Doubtful,
    /// It was so; what is so now is not known.
    Stale,
    /// Nothing is known.
    Unknown,
}

/// One quantity at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// The value; `None` exactly where nothing is known.
    pub value: Option<Value>,
    /// What it is worth.
    pub quality: Quality,
    /// How old it is, ms.
    pub age_ms: f64,
}

/// A quantity: what it is called and what it means.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// What it tells.
    pub what: What,
    /// A name of small letters, digits and `_` that begins with a letter; no two quantities have the same.
    pub key: String,
    /// Where it stands for people: folders from the outermost on.
    pub folder: Vec<String>,
    /// Its name in its folder.
    pub name: &'static str,
    /// The type of its values.
    pub kind: Kind,
    /// Its meaning in words.
    pub help: &'static str,
}
