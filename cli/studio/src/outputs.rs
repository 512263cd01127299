//! Compensation tables for controls and NC programs from the fitted machine.

use std::{collections::BTreeMap, io::BufReader, path::Path};

use serde::{Deserialize, Serialize};
use volcomp_document::read_text;
use volcomp_model::Temperatures;
use volcomp_nc::{Corrector, Counts, Dialect, Job, NcError, NcNote, SetUp, compensate};
use volcomp_tables::axis_table::{
    AxisNumbers, Facts, Format, TableOptions, WriteOptions, loss, sampled, write,
};
use volcomp_vocabulary::{AxisName, CorrectionLimit};

use crate::{
    error::StudioError,
    folder::{Folder, PROGRAMS, SETUP, TABLES, name_of_upload},
};

/// Parameters of a table export.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableRequest {
    /// Name of the format, as in `volcomp export --format`.
    pub format: String,
    /// Spacing of positions along a linear axis, mm.
    pub step_mm: f64,
    /// Spacing of positions along a rotary axis, deg.
    pub step_deg: f64,
    /// Positions of the axes that a table does not cover, mm or deg by axis.
    pub at: BTreeMap<AxisName, f64>,
    /// Maximum correction of an axis, µm or µrad. If the machine needs more, nothing is written.
    pub limit_um: f64,
}

/// The written tables.
#[derive(Clone, Debug, Serialize)]
pub struct TableFiles {
    /// File names, relative to the folder.
    pub files: Vec<String>,
    /// Residual error of each axis.
    pub left: Vec<AxisResidual>,
    /// Settings that the files do not contain and that must be made at the control.
    pub notes: Vec<String>,
    /// Sign convention of the numbers in the files.
    pub sign: String,
    /// Evidence for the sign convention of the format.
    pub trust: String,
}

/// Residual error of an axis over the positions that the tables correct.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AxisResidual {
    pub axis: AxisName,
    /// `um` or `urad`.
    pub unit: &'static str,
    /// Largest error without the tables, in `unit`.
    pub without: f64,
    /// Largest error with the tables, in `unit`.
    pub largest: f64,
}

/// A compensated NC program.
#[derive(Clone, Debug, Serialize)]
pub struct NcProgram {
    /// File name of the program, relative to the folder.
    pub file: String,
    #[serde(flatten)]
    pub counts: Counts,
    /// Notes on lines of the program.
    pub notes: Vec<NcNote>,
}

impl Folder {
    /// Writes compensation tables to `result/tables/FORMAT/`.
    ///
    /// # Errors
    /// The format is unknown, a value is out of range, or the format cannot represent the errors of the machine.
    pub fn tables(&self, request: &TableRequest) -> Result<TableFiles, StudioError> {
        let wrong = |key, why: String| StudioError::Request { key, why };
        let format: Format =
            (request.format.parse()).map_err(|e: volcomp_tables::axis_table::UnknownFormat| {
                wrong("format", e.to_string())
            })?;
        let limit = CorrectionLimit::new(request.limit_um);
        let limit = limit.map_err(|e| wrong("limit_um", e.to_string()))?;
        let machine = self.fitted_machine()?;
        let none = Temperatures::new();
        let options = TableOptions {
            step_mm: request.step_mm,
            step_deg: request.step_deg,
            at: request.at.iter().map(|(axis, at)| (*axis, *at)).collect(),
            limit,
        };
        let reference = options.reference(&machine)?;
        let write_options = WriteOptions {
            facts: Facts::of(&machine, reference, String::new()),
            axes: AxisNumbers::of_machine(&machine),
            encoder: 0,
            detection_unit: 0.001,
        };
        let content = sampled(&machine, &none, &options, format)?;
        let written = write(format, &content, &write_options)?;
        let lost = loss(&machine, &none, &options, format, &write_options)?;
        self.interrupt.check()?;
        let mut files = Vec::new();
        for file in &written.files {
            let name = format!("{TABLES}/{format}/{}", file.name);
            self.write(&name, file.text.as_bytes())?;
            files.push(name);
        }
        let left = lost.axes.iter().map(|of| AxisResidual {
            axis: of.axis,
            unit: of.unit,
            without: of.correction,
            largest: of.largest,
        });
        Ok(TableFiles {
            files,
            left: left.collect(),
            notes: written.notes,
            sign: format.sign().to_owned(),
            trust: format.trust().to_owned(),
        })
    }

    /// Compensates an NC program and writes it to `result/nc/`. Work offsets, tool lengths and the start position come
    /// from `setup.toml`, if the folder has that file.
    ///
    /// # Errors
    /// The first line that cannot be parsed or compensated.
    pub fn nc(
        &self,
        name: &str,
        program: &[u8],
        tolerance_um: f64,
    ) -> Result<NcProgram, StudioError> {
        if !(1e-3..=1e3).contains(&tolerance_um) {
            let why = format!("found {tolerance_um}, expected µm from 0.001 to 1000");
            let key = "tolerance_um";
            return Err(StudioError::Request { key, why });
        }
        let name = name_of_upload(name)?;
        let wrong =
            |source: NcError| StudioError::Nc { name: name.clone(), source: Box::new(source) };
        let machine = self.fitted_machine()?;
        let path = self.at(SETUP);
        let setup = if path.exists() {
            let text = read_text(&path).map_err(|e| wrong_setup(&e))?;
            SetUp::parse(&text, SETUP).map_err(|e| wrong_setup(&e))?
        } else {
            SetUp::default()
        };
        let none = Temperatures::new();
        let corrector = Corrector::new(&machine, &none, 1e-3 * tolerance_um).map_err(wrong)?;
        let control = setup.control();
        let job = Job {
            dialect: control
                .map_or_else(|| Dialect::of_file(Path::new(&name)), volcomp_nc::Control::dialect),
            ..Job::new(&corrector, &setup)
        };
        let mut output = Vec::new();
        let mut input = BufReader::new(program);
        let summary = compensate(&mut input, &mut output, job, |_| Ok(())).map_err(wrong)?;
        let file = format!("{PROGRAMS}/{name}");
        self.interrupt.check()?;
        self.write(&file, &output)?;
        Ok(NcProgram { file, counts: summary.counts, notes: summary.notes.in_words() })
    }
}

fn wrong_setup(error: &dyn std::error::Error) -> StudioError {
    StudioError::Upload { name: SETUP.to_owned(), why: error.to_string() }
}
