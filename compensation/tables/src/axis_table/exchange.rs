//! Writes tables as files of a format, and reads them back.

use volcomp_vocabulary::{CorrectionLimit, bounds::is_plausible_error};

use super::{
    csv, fanuc,
    format::Format,
    heidenhain, isg_csv, linuxcnc,
    options::{
        ReadOptions, WriteOptions, Written, facts_with, is_facts_file, stated_format,
        stated_numbers,
    },
    siemens,
    table::Content,
    text::{ExchangeError, TextFile, Warning},
};

impl Format {
    /// Detects the format from the header that volcomp wrote into the facts files if they agree, otherwise from the
    /// text of the tables. `None` if the text is ambiguous, as for LinuxCNC, whose table files do not contain their
    /// type.
    pub fn of_files(files: &[TextFile]) -> Option<Self> {
        let (facts, tables): (Vec<_>, Vec<_>) =
            (files.iter()).partition(|file| is_facts_file(file.base()));
        // The format stated in facts files takes precedence, if they agree.
        let mut stated: Vec<Self> = facts.iter().filter_map(|file| stated_format(file)).collect();
        stated.dedup();
        match stated[..] {
            [only] => Some(only),
            _ => tables.iter().find_map(|file| Self::of_file(&file.text)),
        }
    }

    /// Format stated in the header of a file that volcomp wrote; `None` for any other file.
    pub fn stated_in(file: &TextFile) -> Option<Self> {
        stated_format(file)
    }

    fn of_file(text: &str) -> Option<Self> {
        let has = |word: &str| text.contains(word);
        let mut lines = text
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty() && !line.starts_with('#') && !line.starts_with("//"));
        let first = lines.next().unwrap_or("");
        if has("$AN_CEC") || has("$AA_ENC_COMP") {
            Some(Self::Siemens840d)
        } else if first.starts_with("BEGIN ") {
            Some(Self::HeidenhainTnc640)
        } else if first.starts_with("input,output,position") {
            Some(Self::Csv)
        } else if first.starts_with('%') {
            Some(Self::Fanuc)
        } else if isg_csv::is_head(first) {
            Some(Self::IsgCsv)
        } else {
            None
        }
    }
}

impl Content {
    pub(crate) fn check_plausible(&self, files: &[&TextFile]) -> Result<(), ExchangeError> {
        self.first_refused(is_plausible_error).map_or(Ok(()), |entry| {
            Err(ExchangeError::Implausible {
                files: files.iter().map(|file| file.name.clone()).collect(),
                most: CorrectionLimit::LARGEST.of(entry.value.kind()),
                what: entry.what,
                found: entry.value,
            })
        })
    }
}

/// Tables read from files.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadTables {
    /// The tables: either axis tables or component errors.
    pub content: Content,
    /// Anomalies found in the files.
    pub warnings: Vec<Warning>,
}

/// Writes tables for a control.
///
/// # Errors
/// There are no tables, the format cannot hold this kind of table, or a number is out of its range.
pub fn write(
    format: Format,
    content: &Content,
    options: &WriteOptions,
) -> Result<Written, ExchangeError> {
    if let Some(refusal) = content.refusal() {
        return Err(ExchangeError::NoCurves(refusal));
    }
    content.check_plausible(&[])?;
    let options = &WriteOptions { facts: options.facts.with_tables(content), ..options.clone() };
    let mut written = match (format, content) {
        (Format::Csv, Content::Axes(tables)) => csv::write(tables, options),
        (Format::Linuxcnc | Format::LinuxcncType1, Content::Axes(tables)) => {
            linuxcnc::write(tables, format)?
        }
        (Format::Siemens840d, Content::Axes(tables)) => siemens::write(tables, options)?,
        (Format::HeidenhainTnc640, Content::Axes(tables)) => heidenhain::write_tnc640(tables)?,
        (Format::Fanuc, Content::Axes(tables)) => fanuc::write(tables, options)?,
        (Format::IsgCsv, Content::Errors(errors)) => isg_csv::write(errors, options),
        (format, _) => {
            return Err(ExchangeError::not_representable(
                format,
                "tables",
                "tables of another kind",
                "what this format holds",
            ));
        }
    };
    if written.files.is_empty() {
        let found = match written.notes.join("; ").as_str() {
            "" => "none that is not zero at its positions".to_owned(),
            notes => format!("none that it holds ({notes})"),
        };
        let expected = "at least one; errors that are zero at every position of a table, such as those with the period of the step, need another --step";
        return Err(ExchangeError::not_representable(format, "tables", found, expected));
    }
    if !format.has_comments() {
        let facts = facts_with(format, options, &written);
        written.files.push(facts);
    }
    Ok(written)
}

/// Reads the tables of a control; the facts file is not a table. If the options state no axis numbers, those of the facts file or of a
/// table header apply.
///
/// # Errors
/// A line that does not match the format, contradictory numbers, no tables.
pub fn read(
    format: Format,
    files: &[TextFile],
    options: &ReadOptions,
) -> Result<ReadTables, ExchangeError> {
    let mut warnings = Vec::new();
    let mut options = options.clone();
    // The SINUMERIK reader compares the headers of its files itself.
    if options.axes.iter().next().is_none()
        && format != Format::Siemens840d
        && let Some((file, numbers)) = stated_numbers(format, files)
    {
        let named = numbers.iter().map(|(name, number)| format!("{name}={number}"));
        let named = named.collect::<Vec<_>>().join(",");
        let text = format!("the numbers of the axes are taken from here: {named}");
        warnings.push(file.whole().warning(text));
        options.axes = numbers;
    }
    let options = &options;
    let files: Vec<&TextFile> = files.iter().filter(|file| !is_facts_file(file.base())).collect();
    let content = match format {
        Format::Csv => Content::Axes(csv::read(&files)?),
        Format::Linuxcnc | Format::LinuxcncType1 => {
            Content::Axes(linuxcnc::read(&files, format, &mut warnings)?)
        }
        Format::Siemens840d => Content::Axes(siemens::read(&files, options, &mut warnings)?),
        Format::HeidenhainTnc640 => Content::Axes(heidenhain::read_tnc640(&files, &mut warnings)?),
        Format::Fanuc => Content::Axes(fanuc::read(&files, options, &mut warnings)?),
        Format::IsgCsv => Content::Errors(isg_csv::read(&files)?),
    };
    let in_files = |what: String| {
        let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
        ExchangeError::NoCurves(format!("{}: {what}", names.join(", ")))
    };
    // The reader of component errors has already rejected invalid tables with their line.
    if let Some(refusal) = content.refusal() {
        return Err(in_files(refusal));
    }
    content.check_plausible(&files)?;
    let is_empty = match &content {
        Content::Axes(tables) => tables.is_empty(),
        Content::Errors(errors) => errors.curves.is_empty() && errors.locations.is_empty(),
    };
    if is_empty {
        let last = warnings.last();
        let why = last.map_or_else(String::new, |warning| format!(" ({})", warning.text));
        return Err(in_files(format!("found no table, expected one of the format {format}{why}")));
    }
    Ok(ReadTables { content, warnings })
}
