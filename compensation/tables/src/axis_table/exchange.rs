//! Tables into files and back, by format.

use volcomp_vocabulary::{
    AxisKind, AxisName, Coordinate, CorrectionLimit, Displacement, bounds::is_plausible_error,
};

use super::{
    AxisNumbers, AxisTable, ErrorTables, ExchangeError, Facts, Format, TextFile, csv, facts, fanuc,
    heidenhain, isg_csv, linuxcnc, siemens,
};

/// Tables of one kind.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// Tables of one axis over one axis.
    Axes(Vec<AxisTable>),
    /// The component errors themselves.
    Errors(ErrorTables),
}

/// A table in the units of JSON documents.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct ListedTable {
    /// The axis over which it goes.
    pub input: AxisName,
    /// The letter of the axis that deviates, or the name of an error.
    pub output: String,
    /// The positions, mm or deg.
    pub positions: Vec<f64>,
    /// The values after positive motion, or of both.
    pub forward: Vec<f64>,
    /// The values after negative motion; `None`: as `forward`.
    pub backward: Option<Vec<f64>>,
    /// The unit of the values: `um` or `urad`.
    pub unit: &'static str,
    /// Whether the positions repeat with the length of the table.
    pub modulo: bool,
}

impl ListedTable {
    fn new(
        input: AxisName,
        output: (String, AxisKind),
        positions: &[f64],
        forward: &[f64],
    ) -> Self {
        let (output, kind) = output;
        let edge = |at: &f64| Displacement::new(input.kind(), *at).mm_or_deg();
        Self {
            input,
            output,
            positions: positions.iter().map(edge).collect(),
            forward: micro(kind, forward),
            backward: None,
            unit: micro_unit(kind),
            modulo: false,
        }
    }
}

fn micro(kind: AxisKind, values: &[f64]) -> Vec<f64> {
    let of = |value: &f64| Displacement::new(kind, *value).um_or_urad();
    values.iter().map(of).collect()
}

/// The unit of a deviation in documents.
pub(super) fn micro_unit(kind: AxisKind) -> &'static str {
    match kind {
        AxisKind::Linear => "um",
        AxisKind::Rotary => "urad",
    }
}

/// A value of tables, and where it is.
pub(super) struct Entry {
    pub(super) what: String,
    pub(super) value: Displacement,
}

impl Content {
    /// The tables in the units of documents, in their order; location errors are not among them.
    pub fn listed(&self) -> Vec<ListedTable> {
        match self {
            Self::Axes(tables) => (tables.iter())
                .map(|table| {
                    let kind = table.output.kind();
                    let output = (table.output.to_string(), kind);
                    ListedTable {
                        backward: table.backward.as_ref().map(|values| micro(kind, values)),
                        modulo: table.modulo,
                        ..ListedTable::new(table.input, output, &table.positions, &table.forward)
                    }
                })
                .collect(),
            Self::Errors(errors) => (errors.curves.iter())
                .map(|table| {
                    let output = (table.name.to_string(), table.name.component.kind());
                    ListedTable::new(table.name.axis, output, &table.positions, &table.values)
                })
                .collect(),
        }
    }

    /// The first value that is not allowed; NaN is for the caller to refuse.
    pub(super) fn first_refused(&self, allows: impl Fn(Displacement) -> bool) -> Option<Entry> {
        let refused = |kind: AxisKind, value: &f64| {
            let value = Displacement::new(kind, *value);
            (!allows(value)).then_some(value)
        };
        match self {
            Self::Axes(tables) => tables.iter().find_map(|table| {
                let kind = table.output.kind();
                let sides = [Some(&table.forward), table.backward.as_ref()];
                let mut values = (sides.into_iter().flatten())
                    .flat_map(|side| side.iter().zip(&table.positions));
                values.find_map(|(value, at)| {
                    let at = Coordinate(Displacement::new(table.input.kind(), *at));
                    Some(Entry {
                        value: refused(kind, value)?,
                        what: format!("the deviation of {} at {} {at}", table.output, table.input),
                    })
                })
            }),
            Self::Errors(errors) => {
                let mut curves = errors.curves.iter();
                let of_curves = curves.find_map(|table| {
                    let kind = table.name.component.kind();
                    let mut values = table.values.iter().zip(&table.positions);
                    values.find_map(|(value, at)| {
                        let axis = table.name.axis;
                        let at = Coordinate(Displacement::new(axis.kind(), *at));
                        Some(Entry {
                            value: refused(kind, value)?,
                            what: format!("{} at {axis} {at}", table.name),
                        })
                    })
                });
                let mut locations = errors.locations.iter();
                of_curves.or_else(|| {
                    locations.find_map(|(name, value)| {
                        Some(Entry {
                            value: refused(name.component.kind(), value)?,
                            what: name.to_string(),
                        })
                    })
                })
            }
        }
    }

    /// Refuses values that no machine tool has.
    fn check_plausible(&self, files: &[&TextFile]) -> Result<(), ExchangeError> {
        self.first_refused(is_plausible_error)
            .map_or(Ok(()), |entry| {
                Err(ExchangeError::Implausible {
                    files: files.iter().map(|file| file.name.clone()).collect(),
                    most: CorrectionLimit::LARGEST.of(entry.value.kind()),
                    what: entry.what,
                    found: entry.value,
                })
            })
    }
}

/// What a writer has to know besides the tables.
#[derive(Clone, Debug, PartialEq)]
pub struct WriteOptions {
    /// Where the tables come from.
    pub facts: Facts,
    /// The numbers of the axes in the control.
    pub axes: AxisNumbers,
    /// The encoder whose table `$AA_ENC_COMP` is written: 0 or 1.
    pub encoder: u8,
    /// The detection unit of a FANUC, mm and deg.
    pub detection_unit: f64,
}

/// What a reader has to know besides the files.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadOptions {
    /// The numbers of the axes in the control, where they are known.
    pub axes: AxisNumbers,
    /// The encoder whose table `$AA_ENC_COMP` is read; `None`: that of which there is a table.
    pub encoder: Option<u8>,
    /// The detection unit of a FANUC, mm and deg.
    pub detection_unit: f64,
}

impl Default for WriteOptions {
    fn default() -> Self {
        Self {
            facts: Facts::default(),
            axes: AxisNumbers::default(),
            encoder: 0,
            detection_unit: 0.001,
        }
    }
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            axes: AxisNumbers::default(),
            encoder: None,
            detection_unit: 0.001,
        }
    }
}

/// Files that were made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// The files.
    pub files: Vec<TextFile>,
    /// What the files do not hold, and what the control has to be told besides.
    pub notes: Vec<String>,
    /// The tables that were left out, by their outputs and inputs; a note says why.
    pub left_out: Vec<(AxisName, AxisName)>,
}

impl Written {
    /// Leaves tables out, with a note that says why.
    pub(crate) fn leave_out(&mut self, why: &str, tables: &[&AxisTable]) {
        if tables.is_empty() {
            return;
        }
        let names = tables
            .iter()
            .map(|table| format!("{} over {}", table.output, table.input));
        let names: Vec<String> = names.collect();
        self.notes
            .push(format!("left out, as {why}: {}", names.join(", ")));
        let pairs = tables.iter().map(|table| (table.output, table.input));
        self.left_out.extend(pairs);
    }
}

/// Something odd in a file that was read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// The file.
    pub file: String,
    /// The line, from 1; `None` where the whole file is meant.
    pub line: Option<usize>,
    /// What is odd, and what was made of it.
    pub text: String,
}

impl core::fmt::Display for Warning {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}:{line}: {}", self.file, self.text),
            None => write!(f, "{}: {}", self.file, self.text),
        }
    }
}

impl Warning {
    pub(crate) fn at(file: &TextFile, line: usize, text: impl Into<String>) -> Self {
        Self {
            file: file.name.clone(),
            line: Some(line),
            text: text.into(),
        }
    }

    pub(crate) fn whole(file: &TextFile, text: impl Into<String>) -> Self {
        Self {
            file: file.name.clone(),
            line: None,
            text: text.into(),
        }
    }
}

/// What was read.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadTables {
    /// The tables.
    pub content: Content,
    /// What was odd.
    pub warnings: Vec<Warning>,
}

/// Writes tables for a control.
///
/// # Errors
/// No tables, tables of another kind than the format holds, numbers that it cannot hold.
pub fn write(
    format: Format,
    content: &Content,
    options: &WriteOptions,
) -> Result<Written, ExchangeError> {
    let refusal = match content {
        Content::Axes(tables) => tables.iter().find_map(AxisTable::refusal),
        Content::Errors(errors) => errors.curves.iter().find_map(super::ErrorTable::refusal),
    };
    if let Some(refusal) = refusal {
        return Err(ExchangeError::NoCurves(refusal));
    }
    content.check_plausible(&[])?;
    let options = &WriteOptions {
        facts: options.facts.with_tables(content),
        ..options.clone()
    };
    let mut written = match (format, content) {
        (Format::Csv, Content::Axes(tables)) => csv::write(tables, options),
        (Format::Linuxcnc, Content::Axes(tables)) => {
            linuxcnc::write(tables, linuxcnc::Type::Positions)?
        }
        (Format::LinuxcncType1, Content::Axes(tables)) => {
            linuxcnc::write(tables, linuxcnc::Type::Trims)?
        }
        (Format::Siemens840d, Content::Axes(tables)) => siemens::write(tables, options)?,
        (Format::HeidenhainTnc640, Content::Axes(tables)) => heidenhain::write_tnc640(tables)?,
        (Format::Fanuc, Content::Axes(tables)) => fanuc::write(tables, options)?,
        (Format::IsgCsv, Content::Errors(errors)) => isg_csv::write(errors, options),
        (format, _) => {
            return Err(ExchangeError::Unfit {
                format,
                what: "tables".to_owned(),
                found: "tables of another kind".to_owned(),
                expected: "what this format holds".to_owned(),
            });
        }
    };
    if written.files.is_empty() {
        return Err(ExchangeError::Unfit {
            format,
            what: "tables".to_owned(),
            found: if written.notes.is_empty() {
                "none that is not zero at its positions".to_owned()
            } else {
                format!("none that it holds ({})", written.notes.join("; "))
            },
            expected: "one at the least; errors that are zero at every position of a table, such as those that repeat with the step, need another --step".to_owned(),
        });
    }
    if !format.has_comments() {
        let notes = written.notes.clone();
        let facts = facts::file(format, options, &written.files, &notes);
        written.files.push(facts);
    }
    Ok(written)
}

/// Reads the tables of a control. The file with the facts is no table; the numbers of the axes that it, or the head of a table, states
/// count where the caller states none.
///
/// # Errors
/// A line that is not of the format, numbers that contradict each other, no tables.
pub fn read(
    format: Format,
    files: &[TextFile],
    options: &ReadOptions,
) -> Result<ReadTables, ExchangeError> {
    let mut warnings = Vec::new();
    let mut options = options.clone();
    // The heads of a SINUMERIK's files are compared by its own reader.
    if options.axes.iter().next().is_none()
        && format != Format::Siemens840d
        && let Some((file, numbers)) = facts::stated_numbers(format, files)
    {
        let named = numbers
            .iter()
            .map(|(name, number)| format!("{name}={number}"));
        let named: Vec<String> = named.collect();
        let text = format!(
            "the numbers of the axes are taken from here: {}",
            named.join(",")
        );
        warnings.push(Warning::whole(file, text));
        options.axes = numbers;
    }
    let options = &options;
    let files: Vec<&TextFile> = files
        .iter()
        .filter(|file| !super::is_facts_file(file.base()))
        .collect();
    let content = match format {
        Format::Csv => Content::Axes(csv::read(&files)?),
        Format::Linuxcnc => Content::Axes(linuxcnc::read(
            &files,
            linuxcnc::Type::Positions,
            &mut warnings,
        )?),
        Format::LinuxcncType1 => Content::Axes(linuxcnc::read(
            &files,
            linuxcnc::Type::Trims,
            &mut warnings,
        )?),
        Format::Siemens840d => Content::Axes(siemens::read(&files, options, &mut warnings)?),
        Format::HeidenhainTnc640 => Content::Axes(heidenhain::read_tnc640(&files, &mut warnings)?),
        Format::Fanuc => Content::Axes(fanuc::read(&files, options, &mut warnings)?),
        Format::IsgCsv => Content::Errors(isg_csv::read(&files)?),
    };
    let refusal = match &content {
        Content::Axes(tables) => tables.iter().find_map(AxisTable::refusal),
        Content::Errors(_) => None,
    };
    if let Some(refusal) = refusal {
        let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
        return Err(ExchangeError::NoCurves(format!(
            "{}: {refusal}",
            names.join(", ")
        )));
    }
    content.check_plausible(&files)?;
    let is_empty = match &content {
        Content::Axes(tables) => tables.is_empty(),
        Content::Errors(errors) => errors.curves.is_empty() && errors.locations.is_empty(),
    };
    if is_empty {
        let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
        return Err(ExchangeError::NoCurves(format!(
            "{}: found no table, expected one of the format {format}{}",
            names.join(", "),
            warnings
                .last()
                .map_or_else(String::new, |warning: &Warning| format!(
                    " ({})",
                    warning.text
                ))
        )));
    }
    Ok(ReadTables { content, warnings })
}

/// A position as files of a control state it, rounded as they round it: mm or deg.
pub(crate) fn edge_of(table: &AxisTable) -> impl Iterator<Item = f64> {
    table.positions.iter().map(|at| table.input_at_edge(*at))
}

/// A deviation that stands in a file as mm or deg.
pub(crate) fn deviation_from_edge(output: volcomp_vocabulary::AxisName, mm_or_deg: f64) -> f64 {
    Displacement::from_coordinate(output.kind(), mm_or_deg).mm_or_rad()
}

/// An evenly spaced table: first position and spacing, mm or deg.
pub(crate) fn even(format: Format, table: &AxisTable) -> Result<(f64, f64), ExchangeError> {
    let (Some(spacing), Some(first)) = (table.spacing(), table.positions.first()) else {
        return Err(ExchangeError::Unfit {
            format,
            what: format!("table {} over {}", table.output, table.input),
            found: "positions at different distances".to_owned(),
            expected: "the same distance everywhere".to_owned(),
        });
    };
    Ok((table.input_at_edge(*first), table.input_at_edge(spacing)))
}
