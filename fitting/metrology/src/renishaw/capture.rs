//! Dynamic captures `.rtx`: an ASCII header, followed by the samples as little-endian f64.

use volcomp_document::quoted;

use super::document::key_value;
use crate::encoding::decode;
use crate::number::Place;
use crate::{Metadata, MetrologyError};

const DATA: &[u8] = b"Data:";
const END: &[u8] = b"EOF::";

/// Dynamic capture: samples over time, without targets. The file does not state the unit of the samples.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Capture {
    /// Name of the source file, for messages.
    pub name: String,
    pub metadata: Metadata,
    /// Sample rate from the header, Hz. If the header has a nominal and an actual rate, the actual rate.
    pub sample_rate_hz: Option<f64>,
    /// Samples in the order of time, in the unit of the program that captured them.
    pub samples: Vec<f64>,
    /// Notes for the user on how the file was read.
    pub notes: Vec<String>,
}

impl Capture {
    /// Duration of the capture, s; `None` without a sample rate.
    pub fn duration_s(&self) -> Option<f64> {
        let intervals = self.samples.len().saturating_sub(1) as f64;
        self.sample_rate_hz.map(|rate| intervals / rate)
    }
}

/// Reads a Renishaw dynamic capture (`.rtx`).
///
/// # Errors
/// No `Data:` line, no `EOF::` after the samples, another number of samples than `Sample no` states, bytes that are not
/// a whole number of samples, or a sample that is not finite.
pub fn parse_rtx(bytes: &[u8], name: &str) -> Result<Capture, MetrologyError> {
    let Some((head, data, data_line)) = split(bytes) else {
        let end = bytes.len().min(400);
        let (text, _) = decode(&bytes[..end], name)?;
        let first = text.lines().next().unwrap_or_default();
        let expected = "`HEADER::`, its keys, and a line `Data:` before the samples";
        return Err(Place::new(name, 1).wrong_kind(quoted(first), expected));
    };
    let (text, encoding_note) = decode(head, name)?;
    let header = Header::of(&text, name)?;
    let place = Place::new(name, data_line);
    let body = without_end(data, header.count).ok_or_else(|| {
        let found = format!("{} bytes and no `EOF::` where it should stand", data.len());
        let expected = match header.count {
            Some(count) => format!("{count} samples of 8 bytes, then `EOF::`"),
            None => "samples of 8 bytes, then `EOF::`".to_owned(),
        };
        place.truncated("Data", found, expected)
    })?;
    let (chunks, _) = body.as_chunks::<8>();
    let samples: Vec<f64> = chunks.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect();
    if samples.is_empty() {
        return Err(MetrologyError::Empty {
            file: name.into(),
            expected: "at least one sample behind `Data:`".into(),
        });
    }
    if let Some(bad) = samples.iter().position(|sample| !sample.is_finite()) {
        let found = format!("{} as sample {}", samples[bad], bad + 1);
        return Err(place.not_a_number("Data", found, "finite numbers"));
    }
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    notes.push("the file does not state the unit of its samples, and has no targets".into());
    Ok(Capture {
        name: name.into(),
        metadata: header.metadata,
        sample_rate_hz: header.rate_hz,
        samples,
        notes,
    })
}

/// Splits a file into the header, the bytes after the line `Data:`, and the number of that line.
fn split(bytes: &[u8]) -> Option<(&[u8], &[u8], usize)> {
    let mut start = 0;
    let mut number = 0;
    while let Some(length) = bytes.get(start..)?.iter().position(|byte| *byte == b'\n') {
        number += 1;
        let line = &bytes[start..start + length];
        let next = start + length + 1;
        if line.trim_ascii() == DATA {
            return Some((&bytes[..start], &bytes[next..], number));
        }
        start = next;
    }
    None
}

/// Samples without the end mark. The mark is at the position that follows from the stated number of samples. Without
/// this number it is the last mark in the file.
fn without_end(data: &[u8], count: Option<usize>) -> Option<&[u8]> {
    let is_end = |rest: &[u8]| rest.trim_ascii() == END;
    if let Some(count) = count {
        let length = count.checked_mul(8)?;
        let rest = data.get(length..)?;
        return is_end(rest).then(|| &data[..length]);
    }
    // Samples may contain any bytes, including blanks. So the mark must follow a whole number of samples.
    let mark = data.windows(END.len()).rposition(|window| window == END)?;
    let is_blank = |end: &usize| data[*end..mark].iter().all(u8::is_ascii_whitespace);
    let end = (mark.saturating_sub(2)..=mark).rev().find(|end| end % 8 == 0 && is_blank(end))?;
    is_end(&data[mark..]).then(|| &data[..end])
}

struct Header {
    metadata: Metadata,
    rate_hz: Option<f64>,
    count: Option<usize>,
}

impl Header {
    fn of(text: &str, file: &str) -> Result<Self, MetrologyError> {
        let mut header = Self { metadata: Metadata::default(), rate_hz: None, count: None };
        let mut has_actual = false;
        for (index, line) in text.lines().enumerate() {
            let place = Place::new(file, index + 1);
            let Some((key, value)) = key_value(line).filter(|(_, value)| !value.is_empty()) else {
                continue;
            };
            let meta = &mut header.metadata;
            let field = match key.as_str() {
                "filetype" => &mut meta.format,
                "owner" => &mut meta.owner,
                "versionno" => &mut meta.version,
                "machine" => &mut meta.machine,
                "serialno" => &mut meta.serial,
                "date" => &mut meta.date,
                "by" => &mut meta.by,
                "axis" => &mut meta.axis,
                "location" => &mut meta.location,
                "title" => &mut meta.title,
                "sampleno" => {
                    header.count = Some(place.count("Sample no", value)? as usize);
                    continue;
                }
                "samplerate" | "actualsamplerate" => {
                    let is_actual = key == "actualsamplerate";
                    if is_actual || !has_actual {
                        header.rate_hz = Some(rate(place, value)?);
                    }
                    has_actual |= is_actual;
                    continue;
                }
                _ => continue,
            };
            *field = Some(value.to_owned());
        }
        Ok(header)
    }
}

/// Parses a rate, Hz. A unit may follow the number.
fn rate(place: Place<'_>, value: &str) -> Result<f64, MetrologyError> {
    let number = value.split_ascii_whitespace().next().unwrap_or_default();
    let rate = place.number("Sample rate", number)?;
    if rate > 0.0 {
        return Ok(rate);
    }
    Err(place.not_a_number("Sample rate", quoted(value), "a rate above 0 Hz"))
}
