/// A kind of measurement file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum FileFormat {
    /// Renishaw laser, linear optics (`.rtl`).
    RenishawLinear,
    /// Renishaw laser, angular optics (`.rta`).
    RenishawAngular,
    /// Renishaw laser, straightness optics (`.rts`).
    RenishawStraightness,
    /// Renishaw `.REN`: an export of compensation values.
    RenishawExport,
    /// API laser `.pos`: means over the runs.
    ApiPos,
    /// Text report of a HP, Agilent or Keysight 5529 or 5530: statistics of each target.
    KeysightReport,
    /// Log of EPICS `camonitor`, with readings taken at the standstills of the axis.
    Camonitor,
    /// The plain table `target,run,direction,deviation`.
    Table,
    /// A table with columns assigned by a mapping file.
    MappedTable,
}

impl FileFormat {
    /// Key of the format in documents and scripts.
    pub fn key(self) -> &'static str {
        match self {
            Self::RenishawLinear => "renishaw-linear",
            Self::RenishawAngular => "renishaw-angular",
            Self::RenishawStraightness => "renishaw-straightness",
            Self::RenishawExport => "renishaw-export",
            Self::ApiPos => "api-pos",
            Self::KeysightReport => "keysight-report",
            Self::Camonitor => "camonitor",
            Self::Table => "table",
            Self::MappedTable => "mapped-table",
        }
    }

    /// Instrument or program that writes this format.
    pub fn instrument(self) -> &'static str {
        match self {
            Self::RenishawLinear => "Renishaw laser, linear optics (.rtl)",
            Self::RenishawAngular => "Renishaw laser, angular optics (.rta)",
            Self::RenishawStraightness => "Renishaw laser, straightness optics (.rts)",
            Self::RenishawExport => "compensation values exported for a control (.REN)",
            Self::ApiPos => "API laser, means over the runs (.pos)",
            Self::KeysightReport => "report of a HP, Agilent or Keysight 5529/5530 laser",
            Self::Camonitor => "log of EPICS camonitor",
            Self::Table => "table of readings",
            Self::MappedTable => "table of readings, columns as stated",
        }
    }

    /// Sign convention of the deviations, in words.
    pub fn sign(self) -> &'static str {
        match self {
            Self::RenishawLinear | Self::ApiPos | Self::Camonitor => "measured minus target",
            Self::RenishawAngular => "as the optics were set up; measured minus target",
            Self::RenishawStraightness => "as the optics were set up; not proven by a real file",
            Self::RenishawExport => "not stated: compensation values, not deviations",
            Self::KeysightReport => {
                "laser reading minus machine reading, positive where the axis goes too far"
            }
            Self::Table | Self::MappedTable => {
                "measured minus target, unless the writer meant another"
            }
        }
    }
}

/// Kind of error that the readings of a file represent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Quantity {
    /// Deviation along the axis.
    Positioning,
    /// Deviation across the axis; the file does not state which of the two directions.
    Straightness,
    /// Angular deviation; the file does not state about which of the three axes.
    Angle,
}

impl Quantity {
    pub fn key(self) -> &'static str {
        match self {
            Self::Positioning => "positioning",
            Self::Straightness => "straightness",
            Self::Angle => "angle",
        }
    }
}
