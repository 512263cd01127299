//! Readings in another unit than the positions of the machine are refused before anything is fitted.

use volcomp_document::{CsvTable, InputError};
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::Machine;

use crate::{
    observations::{Row, Seen, SetUp, Stand},
    span::Span,
};

/// Targets that spread so many times more or less than the tool moves are in another unit: a metre is a thousand, an inch
/// twenty-five, and a target on a long arm of a rotary axis spreads a few times more.
const ANOTHER_UNIT: f64 = 15.0;
/// A tool that moves less than this says nothing of the unit, mm.
const MOVES_MM: f64 = 1.0;
/// A length between two poses that is further from the nominal one is in another unit, or between others: mm (of usual machine
/// tools), and mm for each mm of the length, which no machine misses by.
const APART_MM: f64 = 5.0;
const APART_SHARE: f64 = 2e-3;
/// No ballbar and no tracer reaches so many times the diagonal of the travels.
const FAR_AWAY: f64 = 20.0;

/// Refuses the rows of one file where their unit cannot be mm.
pub(crate) fn check_units(
    table: &CsvTable,
    machine: &Machine,
    rows: &[Row],
    setup: &SetUp,
) -> Result<(), InputError> {
    let nominal = |stand: &Stand| stand.ideal_tip_mm(machine.chain());
    // A machine that only turns has arms of unknown length.
    let diagonal = Some(machine.diagonal_of_travels_mm()).filter(|d| *d > 0.0);
    let diagonal = diagonal.unwrap_or(f64::INFINITY);
    let apart_mm = Span::of(machine, rows.iter()).limit_mm(APART_MM);
    let mut seen = Vec::new();
    for row in rows {
        match &row.seen {
            Seen::Point { at_mm, .. } => seen.push((*at_mm, nominal(&row.stand))),
            Seen::Pair {
                from,
                dead,
                length_mm,
            } => {
                let dead = &setup.numbers[*dead];
                let expected = (nominal(&row.stand) - nominal(from)).norm();
                let found = length_mm + dead.value.unwrap_or_default();
                if !dead.unknown && (found - expected).abs() > apart_mm + APART_SHARE * expected {
                    let message = format!(
                        "found a length of {length_mm} mm between poses that are nominally {expected:.3} mm apart: is it another unit, or are they other poses?"
                    );
                    return Err(table.error_at(row.line, message));
                }
            }
            Seen::Distance { length_mm, .. } if *length_mm > FAR_AWAY * diagonal => {
                let message = format!(
                    "found a length of {length_mm} mm at a machine whose travels are {diagonal:.0} mm from corner to corner, expected mm: is it another unit?"
                );
                return Err(table.error_at(row.line, message));
            }
            _ => {}
        }
    }
    let spread = |points: &mut dyn Iterator<Item = Vector3<f64>>| {
        let points: Vec<Vector3<f64>> = points.collect();
        let count = points.len().max(1) as f64;
        let middle = points.iter().sum::<Vector3<f64>>() / count;
        let squares = points.iter().map(|point| (point - middle).norm_squared());
        (squares.sum::<f64>() / count).sqrt()
    };
    let found = spread(&mut seen.iter().map(|(found, _)| *found));
    let moved = spread(&mut seen.iter().map(|(_, nominal)| *nominal));
    let ratio = found / moved;
    if moved > MOVES_MM && !(1.0 / ANOTHER_UNIT..=ANOTHER_UNIT).contains(&ratio) {
        return Err(table.header_error(format!(
            "found x, y, z that spread by {found:.3} where the tool spreads by {moved:.3} mm, expected mm: are they in another unit?"
        )));
    }
    Ok(())
}
