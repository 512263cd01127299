//! Rows that no machine like the nominal one can have given, and what they may be in place of it.

use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{
    error::{Cause, IdentifyError},
    judge::median,
    observations::{Observations, Row, Seen, Stand},
    prepared::Rows,
    start::start,
    system::System,
    values::Values,
};

/// Machines miss by micrometres to tenths of a millimetre, one that was just put together by a few millimetres. What is
/// further away is another sphere, tool, unit or sign.
const LIMIT_MM: f64 = 10.0;
/// A cause is named where it leaves less than this share of what there is without it.
const EXPLAINED: f64 = 0.1;
/// More rows than this share beyond the limit are no slips.
const SLIPS: f64 = 0.25;
const MM_PER_INCH: f64 = 25.4;
const MM_PER_M: f64 = 1000.0;

/// Refuses rows that are further from the nominal machine than machines are, once set-ups were found without any error of
/// the machine (`values`).
pub(crate) fn plausible(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: &Values,
) -> Result<(), IdentifyError> {
    let sizes = sizes(system, rows, values);
    let far = sizes.iter().filter(|size| **size > LIMIT_MM).count();
    let largest = sizes.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
    let Some((worst, &found_mm)) = largest.filter(|_| far > 0) else {
        return Ok(());
    };
    let file = file_of(observations, worst);
    let line = rows.get(worst).line;
    if (far as f64) < SLIPS * sizes.len() as f64 {
        return Err(IdentifyError::FarRow {
            file,
            line,
            found_mm,
            limit_mm: LIMIT_MM,
        });
    }
    let typical_mm = median(&sizes);
    let mut best: Option<(f64, Cause)> = None;
    for cause in causes(&system.machine, rows) {
        let tip_mm = match &cause {
            Cause::Tool(name) => system.machine.tip_of(name).ok(),
            _ => None,
        };
        let tried = rows
            .iter()
            .map(|row| with_cause(row, &cause, tip_mm, &system.machine));
        let tried: Vec<Row> = tried.collect();
        let rows = system.prepare(tried.iter());
        let Ok(values) = start(system, observations, &rows) else {
            continue;
        };
        let left_mm = median(&self::sizes(system, &rows, &values));
        if left_mm < EXPLAINED * typical_mm
            && best.as_ref().is_none_or(|(least, _)| left_mm < *least)
        {
            best = Some((left_mm, cause));
        }
    }
    Err(IdentifyError::FarRows {
        file,
        line,
        rows: far,
        of: sizes.len(),
        typical_mm,
        limit_mm: LIMIT_MM,
        cause: best.map(|(_, cause)| cause),
    })
}

/// A note where all linear axes keep to a small part of their travel: coordinates and readings in inches alike fit as well as in
/// mm where nothing of the machine has a length.
pub(crate) fn small_moves(machine: &Machine, rows: &Rows) -> Option<String> {
    const SMALL: f64 = 1.0 / 20.0;
    let mut largest: Option<(f64, AxisName, f64)> = None;
    for (place, axis) in machine.axes().iter().enumerate() {
        if axis.name.kind() != AxisKind::Linear {
            continue;
        }
        let at = || rows.iter().map(|row| row.stand.state.q[place]);
        let span = at().fold(f64::NEG_INFINITY, f64::max) - at().fold(f64::INFINITY, f64::min);
        let share = span / (axis.travel[1] - axis.travel[0]);
        if share > SMALL {
            return None;
        }
        if share > 0.0 && largest.is_none_or(|(most, ..)| share > most) {
            largest = Some((share, axis.name, span));
        }
    }
    let (share, name, span) = largest?;
    Some(format!(
        "the rows move the linear axes over {:.1} % of their travel at the most ({name}: {span:.1} mm): are they mm?",
        100.0 * share
    ))
}

/// How far each row is from what the machine is at these values, mm.
fn sizes(system: &System, rows: &Rows, values: &Values) -> Vec<f64> {
    let residuals = system.residuals(rows, values);
    residuals.iter().map(Vector3::norm).collect()
}

/// The file of a fitted row.
fn file_of(observations: &Observations, row: usize) -> String {
    let of = observations.fitted().find(|(_, own)| own.contains(&row));
    of.map_or_else(String::new, |(observation, _)| observation.file.clone())
}

/// What may make all rows wrong at once: an axis that counts the other way, another unit, another tool.
fn causes(machine: &Machine, rows: &Rows) -> Vec<Cause> {
    let moves = |place: usize| rows.iter().any(|row| row.stand.state.q[place] != 0.0);
    let axes = machine.axes().iter().enumerate();
    let moving: Vec<AxisName> = axes
        .filter(|(k, _)| moves(*k))
        .map(|(_, a)| a.name)
        .collect();
    let mut causes: Vec<Cause> = moving.iter().map(|axis| Cause::Reversed(*axis)).collect();
    if moving.iter().any(|axis| axis.kind() == AxisKind::Rotary) {
        causes.push(Cause::Radians);
    }
    causes.extend([Cause::Inches, Cause::Metres]);
    causes.extend(moving.iter().map(|axis| match axis.kind() {
        AxisKind::Rotary => Cause::RadiansOf(*axis),
        AxisKind::Linear => Cause::InchesOf(*axis),
    }));
    let named = machine.tools().keys();
    causes.extend(named.map(|name| Cause::Tool(name.clone())));
    causes
}

/// The row as it would be if this were the cause; `tip_mm` is that of another tool.
fn with_cause(row: &Row, cause: &Cause, tip_mm: Option<Vector3<f64>>, machine: &Machine) -> Row {
    let stand = |stand: &Stand| {
        let mut stand = *stand;
        for (axis, q) in machine.axes().iter().zip(&mut stand.state.q) {
            match (cause, axis.name.kind()) {
                (Cause::Reversed(name), _) if *name == axis.name => *q = -*q,
                (Cause::Radians, AxisKind::Rotary) => *q = q.to_degrees(),
                (Cause::RadiansOf(name), _) if *name == axis.name => *q = q.to_degrees(),
                (Cause::InchesOf(name), _) if *name == axis.name => *q *= MM_PER_INCH,
                (Cause::Inches, AxisKind::Linear) => *q *= MM_PER_INCH,
                (Cause::Metres, AxisKind::Linear) => *q *= MM_PER_M,
                _ => {}
            }
        }
        stand.tip_mm = tip_mm.unwrap_or(stand.tip_mm);
        stand
    };
    let mut row = Row {
        stand: stand(&row.stand),
        ..row.clone()
    };
    if let Seen::Pair { from, .. } = &mut row.seen {
        *from = stand(from);
    }
    row
}
