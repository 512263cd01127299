use core::{fmt, str::FromStr};

/// Format of table files, by the control or software that reads them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Format {
    /// CSV, the format of volcomp.
    Csv,
    /// LinuxCNC, COMP_FILE_TYPE 0: nominal, actual forward, actual backward.
    Linuxcnc,
    /// LinuxCNC, COMP_FILE_TYPE 1: nominal, trim forward, trim backward.
    LinuxcncType1,
    /// SINUMERIK 840D: $AA_ENC_COMP and $AN_CEC.
    Siemens840d,
    /// HEIDENHAIN TNC 640: .com and .cma.
    HeidenhainTnc640,
    /// FANUC pitch error compensation as a parameter file.
    Fanuc,
    /// TwinCAT TF5280, volumetric compensation: the ISG CSV.
    IsgCsv,
}

/// An unknown format name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("found format `{found}`, expected one of: {}", Format::ALL.map(Format::name).join(", "))]
pub struct UnknownFormat {
    /// The unknown name.
    pub found: String,
}

impl Format {
    /// All formats, in the order in which messages list them.
    pub const ALL: [Self; 7] = [
        Self::Csv,
        Self::Linuxcnc,
        Self::LinuxcncType1,
        Self::Siemens840d,
        Self::HeidenhainTnc640,
        Self::IsgCsv,
        Self::Fanuc,
    ];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Linuxcnc => "linuxcnc",
            Self::LinuxcncType1 => "linuxcnc-type1",
            Self::Siemens840d => "siemens-840d",
            Self::HeidenhainTnc640 => "heidenhain",
            Self::Fanuc => "fanuc",
            Self::IsgCsv => "isg-csv",
        }
    }

    pub(crate) fn holds_errors(self) -> bool {
        self == Self::IsgCsv
    }

    /// Whether files of the format can contain comments; otherwise the facts are written to a separate file.
    pub fn has_comments(self) -> bool {
        matches!(self, Self::Csv | Self::Siemens840d | Self::IsgCsv)
    }

    /// Sign convention of the numbers in files of the format.
    pub fn sign(self) -> &'static str {
        match self {
            Self::Csv => {
                "a value is the deviation, actual - commanded of the output axis, in um (linear) or urad (rotary); positions are in mm or deg"
            }
            Self::Linuxcnc => {
                "a line is nominal, actual after positive motion, actual after negative motion; the control adds nominal - actual to the motor's command; mm or deg"
            }
            Self::LinuxcncType1 => {
                "a line is nominal, trim after positive motion, trim after negative motion; trim = commanded - actual, which the control adds to the motor's command; mm or deg"
            }
            Self::Siemens840d => {
                "a value is actual - commanded, in mm or deg: a positive value moves the axis in its negative direction"
            }
            Self::HeidenhainTnc640 => "a value is actual - commanded, in mm or deg",
            Self::Fanuc => {
                "the value of a point is the step of -(actual - commanded) from the point before, in detection units times the magnification"
            }
            Self::IsgCsv => {
                "a value is the error motion of the tool side relative to the workpiece side (ISO 230-1 names), in mm or rad; positions are in mm or deg"
            }
        }
    }

    /// Evidence for the sign. No format was tested on a machine; the LinuxCNC formats were tested
    /// in LinuxCNC with simulated drives.
    pub fn trust(self) -> &'static str {
        match self {
            Self::Csv => "Sign proven by definition: this is the format of volcomp itself.",
            Self::Linuxcnc | Self::LinuxcncType1 => {
                "Sign proven on a running LinuxCNC 2.9 with simulated drives and by its source text (usrmotintf.cc, control.c), not on a machine."
            }
            Self::Siemens840d => {
                "$AA_ENC_COMP: sign proven by an independent public program that writes it; a manual says the same; not on a machine. \
                 $AN_CEC: sign unproven: try with one small known value first."
            }
            Self::HeidenhainTnc640 => {
                "Sign unproven: try with one small known value first. Form of the file by public programs and a manual."
            }
            Self::Fanuc => {
                "Sign proven by one independent public program that writes such values, not on a machine. Numbering of the data (N10000 + point), \
                 the unit of 3624 and 3625 and the place of the data for negative motion are from memory: unproven, compare with a file that your \
                 control has put out, and try with one small known value first."
            }
            Self::IsgCsv => {
                "Sign unproven: try with one small known value first. Above all: whether an error of an axis that carries the workpiece is meant as its \
                 own motion, which has the other sign."
            }
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Format {
    type Err = UnknownFormat;

    fn from_str(text: &str) -> Result<Self, UnknownFormat> {
        let named = Self::ALL.into_iter().find(|format| format.name() == text);
        named.ok_or_else(|| UnknownFormat { found: text.to_owned() })
    }
}
