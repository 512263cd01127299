use volcomp_document::quoted;

use super::document::{Document, Section, key_value, section_name};
use super::environment::environment;
use super::{RenishawKind, directions, sections};
use crate::checks::environment_notes;
use crate::decimal_comma::with_points;
use crate::encoding::{decode, refuse_empty};
use crate::number::Place;
use crate::{Measurement, Metadata, MetrologyError, Reading};

const STRAIGHTNESS_NOT_PROVEN: &str = "deviations of .rts files are taken as µm, positive as the optics read them: no real file has proven unit and sign, so compare one with a known deviation";

/// Reads a Renishaw laser file.
///
/// Sections, keys (case, blanks and hyphens ignored) and numbers follow the grammar on which independent readers and
/// writers of the format agree. Unknown sections and keys are skipped. Targets are in mm or deg. Deviations are
/// measured value minus target: µm in `.rtl`; milliradian in `.rta`, converted to µrad; in `.rts` taken as µm
/// perpendicular to the axis, with a note.
///
/// - The middle column of DEVIATIONS is the number of the target in the list, from 1. If a cell cannot be such a number
///   (not whole, out of range) and every cell equals a target, the column contains the targets themselves. The order of
///   the rows never assigns a deviation to a target.
/// - The order of the targets of a run is its direction (ascending is forward), and the run number counts the passes of
///   its direction. The second flag is compared with the directions: "bidirectional" with all runs in one direction is
///   an error, because the reverse runs may have been sorted; "unidirectional" with runs in both directions is a note.
/// - Reverse (even) runs that contain only zeros, beside real forward runs, are omitted, with a note.
/// - Text that is not UTF-8 is read as GBK or Latin-1, with a note. Numbers are always ASCII.
///
/// # Errors
/// Any incomplete or inconsistent file: `EOF::` is missing, counts differ from the rows, readings, targets or sections
/// are repeated, numbers are not finite decimals, or the header names another file type. Each error names the file, the
/// line, what was found and what was expected.
pub fn parse_renishaw(
    bytes: &[u8],
    name: &str,
    kind: RenishawKind,
) -> Result<Measurement, MetrologyError> {
    let (text, encoding_note) = decode(bytes, name)?;
    refuse_empty(&text, name, "a Renishaw file from `HEADER::` to `EOF::`")?;
    let mut section = None;
    let text = with_points(&text, name, |line| {
        section = section_name(line.trim_ascii()).or(section.take());
        numbers_from(section.as_deref(), line)
    })?;
    let document = Document::split(&text, name)?;
    let metadata = metadata(&document, kind)?;
    let targets = sections::targets(&document)?;
    let rows = sections::rows(&document, &targets.values)?;
    let environment = environment(document.section("ENVIRONMENT"), name)?;
    let (readings, direction_notes) = directions::readings(name, rows, &targets)?;
    let in_memory = |r: Reading| Reading { deviation: r.deviation * kind.scale(), ..r };
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    notes.extend(direction_notes);
    if document.text_after_end {
        notes.push("text after `EOF::` was not read".into());
    }
    if kind == RenishawKind::Straightness {
        notes.push(STRAIGHTNESS_NOT_PROVEN.into());
    }
    notes.extend(environment_notes(&environment, kind.quantity()));
    Ok(Measurement {
        name: name.into(),
        format: Some(kind.format()),
        quantity: Some(kind.quantity()),
        unit: Some(kind.unit()),
        stated: None,
        target_unit: None,
        readings: readings.into_iter().map(in_memory).collect(),
        metadata,
        environment,
        notes,
    })
}

/// Byte at which the numbers of a line begin, which is after the key if there is one; `None` outside the sections with
/// numbers.
fn numbers_from(section: Option<&str>, line: &str) -> Option<usize> {
    let is_of_numbers = matches!(section?, "TARGET DATA" | "DEVIATIONS" | "ENVIRONMENT");
    // A date is not a number, although its hours may look like one.
    let is_date = key_value(line).is_some_and(|(key, _)| key.starts_with("date"));
    (is_of_numbers && !is_date).then(|| line.find(':').map_or(0, |at| at + 1))
}

fn metadata(document: &Document<'_>, kind: RenishawKind) -> Result<Metadata, MetrologyError> {
    let text_of = |section: Option<&Section<'_>>, key| -> Result<Option<String>, MetrologyError> {
        let value = section.map(|s| s.value(document.file, key)).transpose()?.flatten();
        Ok(value.map(|(_, text)| text.trim().to_owned()).filter(|text| !text.is_empty()))
    };
    let header = document.section("HEADER");
    let user = document.section("USER-TEXT");
    check_file_type(document, header, kind)?;
    Ok(Metadata {
        format: text_of(header, "filetype")?,
        owner: text_of(header, "owner")?,
        version: text_of(header, "versionno")?,
        machine: text_of(user, "machine")?,
        serial: text_of(user, "serialno")?,
        date: text_of(user, "date")?,
        by: text_of(user, "by")?,
        axis: text_of(user, "axis")?,
        location: text_of(user, "location")?,
        title: text_of(user, "title")?,
    })
}

fn check_file_type(
    document: &Document<'_>,
    header: Option<&Section<'_>>,
    kind: RenishawKind,
) -> Result<(), MetrologyError> {
    let stated = header.map(|h| h.value(document.file, "filetype")).transpose()?.flatten();
    match stated {
        Some((line, text))
            if !text.trim_start_matches('.').eq_ignore_ascii_case(kind.file_type()) =>
        {
            let expected = format!("`File type : {}`", kind.file_type());
            Err(Place::new(document.file, line).wrong_kind(quoted(text), &expected))
        }
        _ => Ok(()),
    }
}
