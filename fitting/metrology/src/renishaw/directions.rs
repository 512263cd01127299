//! Directions of the passes, and detection of passes without measurement.

use std::collections::BTreeMap;

use super::sections::{Row, Targets};
use crate::number::Place;
use crate::runs::alignment_notes;
use crate::{Direction, MetrologyError, Reading};

/// Assigns directions and run numbers to the readings, with notes for the user.
///
/// The order of the targets in a pass determines its direction: ascending is forward. The direction is compared with
/// the second flag of the file. A file that states "bidirectional" but has passes of only one order is rejected,
/// because its reverse passes may have been sorted. For any other difference there is a note, and the order of the
/// targets is used. Reverse (even) passes that contain only zeros, beside forward passes with values, are omitted, with
/// a note.
pub(super) fn readings(
    file: &str,
    rows: Vec<Row>,
    targets: &Targets,
) -> Result<(Vec<Reading>, Vec<String>), MetrologyError> {
    let mut passes: BTreeMap<u32, Vec<Row>> = BTreeMap::new();
    for row in rows {
        passes.entry(row.pass).or_default().push(row);
    }
    let mut notes: Vec<String> =
        leave_out_zero_filled(&mut passes, targets.values.len()).into_iter().collect();
    notes.extend(zero_passes(&passes));
    let directions = passes
        .iter()
        .map(|(pass, rows)| Ok((*pass, direction_of(file, *pass, rows, targets)?)))
        .collect::<Result<Vec<_>, MetrologyError>>()?;
    notes.extend(compare_with_flags(file, &directions, targets)?);
    let readings = numbered(&passes, &directions);
    notes.extend(alignment_notes(&readings));
    Ok((readings, notes))
}

fn is_zero(rows: &[Row]) -> bool {
    rows.iter().all(|row| row.deviation == 0.0)
}

fn leave_out_zero_filled(
    passes: &mut BTreeMap<u32, Vec<Row>>,
    target_count: usize,
) -> Option<String> {
    let is_reverse = |pass: &u32| pass.is_multiple_of(2);
    let reverse: Vec<u32> = passes.keys().copied().filter(is_reverse).collect();
    let reverse_is_filled = passes.iter().all(|(pass, rows)| !is_reverse(pass) || is_zero(rows));
    let forward_is_real = passes.iter().any(|(pass, rows)| !is_reverse(pass) && !is_zero(rows));
    if reverse.is_empty() || target_count < 2 || !reverse_is_filled || !forward_is_real {
        return None;
    }
    passes.retain(|pass, _| !is_reverse(pass));
    Some(format!(
        "reverse {} left out: nothing but zeros, as written for a unidirectional test",
        runs_text(&reverse)
    ))
}

fn zero_passes(passes: &BTreeMap<u32, Vec<Row>>) -> Option<String> {
    let zero: Vec<u32> = passes
        .iter()
        .filter(|(_, rows)| rows.len() > 1 && is_zero(rows))
        .map(|(p, _)| *p)
        .collect();
    let suspicious = !zero.is_empty() && zero.len() < passes.len();
    suspicious.then(|| format!("{} kept, though nothing but zeros", runs_text(&zero)))
}

fn direction_of(
    file: &str,
    pass: u32,
    rows: &[Row],
    targets: &Targets,
) -> Result<Direction, MetrologyError> {
    let mut pairs = rows.windows(2);
    if rows.len() < 2 {
        let reverse = targets.unidirectional != Some(true) && pass.is_multiple_of(2);
        return Ok(if reverse { Direction::Negative } else { Direction::Positive });
    }
    let ascends = rows[0].target < rows[1].target;
    match pairs.find(|pair| (pair[0].target < pair[1].target) != ascends) {
        None if ascends => Ok(Direction::Positive),
        None => Ok(Direction::Negative),
        Some(pair) => {
            let found = format!("target {} after {} in run {pass}", pair[1].target, pair[0].target);
            let expected = "the targets of a run in the order of travel, ascending or descending";
            let place = Place::new(file, pair[1].line);
            Err(place.contradictory("order of targets", found, expected))
        }
    }
}

fn compare_with_flags(
    file: &str,
    directions: &[(u32, Direction)],
    targets: &Targets,
) -> Result<Option<String>, MetrologyError> {
    let one_way = directions.windows(2).all(|pair| pair[0].1 == pair[1].1);
    match targets.unidirectional {
        Some(false) if one_way && directions.len() > 1 && directions.iter().any(|(pass, _)| pass.is_multiple_of(2)) => {
            let place = Place::new(file, targets.flags_line);
            let found = format!("flags of a bidirectional test, and all {} runs in one direction", directions.len());
            let expected = "reverse runs in the order of travel, or a second flag of 1";
            Err(place.contradictory("Flags", found, expected))
        }
        Some(true) if !one_way => {
            Ok(Some("the flags say unidirectional, the order of the targets shows both directions: the order is believed".into()))
        }
        _ => Ok(None),
    }
}

/// Readings with their run numbers. The number of a run counts the passes of its direction.
fn numbered(passes: &BTreeMap<u32, Vec<Row>>, directions: &[(u32, Direction)]) -> Vec<Reading> {
    let mut readings = Vec::new();
    let mut runs: BTreeMap<Direction, u32> = BTreeMap::new();
    for (rows, (_, direction)) in passes.values().zip(directions) {
        let run = runs.entry(*direction).or_insert(0);
        *run += 1;
        let reading = |row: &Row| Reading {
            target: row.target,
            run: *run,
            direction: *direction,
            deviation: row.deviation,
        };
        readings.extend(rows.iter().map(reading));
    }
    readings
}

fn runs_text(passes: &[u32]) -> String {
    let list: Vec<String> = passes.iter().map(u32::to_string).collect();
    format!("run{} {}", if passes.len() == 1 { "" } else { "s" }, list.join(", "))
}
