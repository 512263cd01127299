//! Writes tables as files of a format, and reads such files.
//!
//! It also reads bed meshes of printers and height maps of routers, which are Z heights of a surface over X and Y.

use volcomp_document::quoted;
use volcomp_vocabulary::bounds::is_plausible_error;
use volcomp_vocabulary::{AxisName, Component, CorrectionLimit, ErrorName};

use super::options::{
    ReadOptions, WriteOptions, Written, facts_with, is_facts_file, stated_format, stated_numbers,
};
use super::table::{Content, ErrorTable, ErrorTables};
use super::text::{ExchangeError, FilePosition, Format, TextFile, Warning, number, short};
use super::{csv, fanuc, heidenhain, isg_csv, linuxcnc, siemens};

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
    fn check_plausible(&self, files: &[&TextFile]) -> Result<(), ExchangeError> {
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

/// Reads a mesh as the straightness curves `EZX` and `EZY`.
///
/// The first row is `mm` and the positions of X; each further row is a position of Y and the heights there, all in mm.
/// A height is the Z at which the tool touches a plane: where Z is high, the tool is low, so the errors have the
/// opposite sign. `EZX` and `EZY` are the least-squares fit of f(x) + g(y) to the heights minus their mean; a warning
/// states the residual.
///
/// # Errors
/// A row that is not of this form, positions that do not increase, implausible heights.
pub fn read_mesh(file: &TextFile) -> Result<ReadTables, ExchangeError> {
    let (xs, ys, heights) = rows(file)?;
    let mean =
        |values: &mut dyn Iterator<Item = f64>, count: usize| values.sum::<f64>() / count as f64;
    let whole = mean(&mut heights.iter().flatten().copied(), xs.len() * ys.len());
    let of_x: Vec<f64> = (0..xs.len())
        .map(|x| mean(&mut heights.iter().map(|row| row[x]), ys.len()) - whole)
        .collect();
    let of_y: Vec<f64> =
        (heights.iter()).map(|row| mean(&mut row.iter().copied(), xs.len()) - whole).collect();
    let (mut largest, mut squares) = ((0.0, 0.0, 0.0), 0.0);
    for (row, (at_y, y)) in heights.iter().zip(of_y.iter().zip(&ys)) {
        for (height, (at_x, x)) in row.iter().zip(of_x.iter().zip(&xs)) {
            let left: f64 = height - whole - at_x - at_y;
            squares += left * left;
            if left.abs() > largest.0 {
                largest = (left.abs(), *x, *y);
            }
        }
    }
    let rms = (squares / (xs.len() * ys.len()) as f64).sqrt();
    let um = |mm: f64| short(mm * 1e3, 1);
    let warnings = vec![
        file.whole().warning(format!(
            "the mean height of {} um is left out: it is the offset of Z",
            um(whole)
        )),
        file.whole().warning(format!(
            "EZX and EZY leave up to {} um (X={} Y={}), {} um rms: what depends on X and Y together, such as a twisted bed, is no curve of one axis",
            um(largest.0),
            short(largest.1, 3),
            short(largest.2, 3),
            um(rms)
        )),
    ];
    let curve = |axis, positions, values: Vec<f64>| ErrorTable {
        name: ErrorName::motion(Component::EZ, axis),
        positions,
        values: values.into_iter().map(|height| 0.0 - height).collect(),
    };
    let content = Content::Errors(ErrorTables {
        curves: vec![curve(AxisName::X, xs, of_x), curve(AxisName::Y, ys, of_y)],
        locations: Vec::new(),
    });
    content.check_plausible(&[file])?;
    Ok(ReadTables { content, warnings })
}

type Rows = (Vec<f64>, Vec<f64>, Vec<Vec<f64>>);

fn rows(file: &TextFile) -> Result<Rows, ExchangeError> {
    let lines = file.text.lines().enumerate();
    let mut lines = lines
        .map(|(index, line)| (file.at(index + 1), line.trim().trim_start_matches('\u{feff}')))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let head = lines.next();
    let expected = "`mm` and at least two positions of X: mm,10,110,210";
    let Some((here, line)) = head else {
        return Err(file.whole().error("nothing", expected));
    };
    let (first, xs) = cells(line);
    let Some(xs) = xs.filter(|xs| first.eq_ignore_ascii_case("mm") && xs.len() > 1) else {
        return Err(here.error(quoted(line), expected));
    };
    increasing(here, AxisName::X, &xs)?;
    let (mut ys, mut heights) = (Vec::new(), Vec::new());
    for (here, line) in lines {
        let (y, row) = cells(line);
        let (Some(y), Some(row)) = (number(y), row.filter(|row| row.len() == xs.len())) else {
            let expected = format!("a position of Y and {} heights in mm", xs.len());
            return Err(here.error(quoted(line), expected));
        };
        ys.push(y);
        increasing(here, AxisName::Y, &ys)?;
        heights.push(row);
    }
    if ys.len() < 2 {
        let found = format!("{} rows of heights", ys.len());
        return Err(file.whole().error(found, "at least 2"));
    }
    Ok((xs, ys, heights))
}

/// First cell of a line, and the numbers after it; `None` if one of these is not a number.
fn cells(line: &str) -> (&str, Option<Vec<f64>>) {
    let mut cells = line.split([',', ';', '\t']).map(str::trim);
    let first = cells.next().unwrap_or("");
    (first, cells.map(number).collect())
}

fn increasing(here: FilePosition<'_>, axis: AxisName, at: &[f64]) -> Result<(), ExchangeError> {
    let Some(pair) = at.windows(2).find(|pair| pair[0] >= pair[1]) else {
        return Ok(());
    };
    let found = format!("{axis}={} after {axis}={}", pair[1], pair[0]);
    Err(here.error(found, "increasing positions"))
}
