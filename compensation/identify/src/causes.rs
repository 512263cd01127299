//! What may make the rows of a file wrong at once: an axis or an instrument that counts the other way, another unit, columns that
//! are exchanged, another tool.

use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{
    error::Cause,
    observations::{Row, Seen, Stand},
};

const MM_PER_INCH: f64 = 25.4;
const MM_PER_M: f64 = 1000.0;

/// The causes that would change these rows. A cause of one axis that is the only one of its kind to move is that of all of
/// them, and stands there once.
pub(crate) fn causes(machine: &Machine, rows: &[&Row]) -> Vec<Cause> {
    let stands = || {
        rows.iter().flat_map(|row| {
            let from = match &row.seen {
                Seen::Pair { from, .. } => Some(from),
                _ => None,
            };
            core::iter::once(&row.stand).chain(from)
        })
    };
    let moves = |place: usize| stands().any(|stand| stand.state.q[place] != 0.0);
    let axes = machine.axes().iter().enumerate();
    let moving: Vec<AxisName> = axes
        .filter(|(place, _)| moves(*place))
        .map(|(_, axis)| axis.name)
        .collect();
    let of = |kind: AxisKind| moving.iter().filter(move |axis| axis.kind() == kind);
    let mut causes: Vec<Cause> = moving.iter().map(|axis| Cause::Reversed(*axis)).collect();
    if of(AxisKind::Rotary).count() > 0 {
        causes.push(Cause::Radians);
    }
    if of(AxisKind::Linear).count() > 0 {
        causes.extend([Cause::Inches, Cause::Metres]);
    }
    if of(AxisKind::Rotary).count() > 1 {
        causes.extend(of(AxisKind::Rotary).map(|axis| Cause::RadiansOf(*axis)));
    }
    if of(AxisKind::Linear).count() > 1 {
        causes.extend(of(AxisKind::Linear).map(|axis| Cause::InchesOf(*axis)));
    }
    for (place, one) in moving.iter().enumerate() {
        let others = moving[place + 1..].iter();
        let alike = others.filter(|other| other.kind() == one.kind());
        causes.extend(alike.map(|other| Cause::Exchanged(*one, *other)));
    }
    let is_seen = |is: fn(&Seen) -> bool| rows.iter().any(|row| is(&row.seen));
    if is_seen(|seen| matches!(seen, Seen::Point { .. })) {
        causes.push(Cause::Mirrored);
    }
    if is_seen(|seen| matches!(seen, Seen::Distance { .. } | Seen::Pair { .. })) {
        causes.push(Cause::LengthsInInches);
    }
    if rows.iter().any(|row| {
        let mut turned = row.seen.clone();
        turned.turn();
        turned != row.seen
    }) {
        causes.push(Cause::Turned);
    }
    let mut used: Vec<(&String, Vector3<f64>)> = Vec::new();
    for name in machine.tools().keys() {
        let Ok(tip_mm) = machine.tip_of(name) else {
            continue;
        };
        if stands().any(|stand| stand.tip_mm != tip_mm) {
            causes.push(Cause::Tool(name.clone()));
        }
        if stands().any(|stand| stand.tip_mm == tip_mm) {
            for (other, its_mm) in &used {
                if *its_mm != tip_mm {
                    causes.push(Cause::ToolsExchanged((*other).clone(), name.clone()));
                }
            }
            used.push((name, tip_mm));
        }
    }
    causes
}

/// The row as it would be if this were the cause.
pub(crate) fn with_cause(row: &Row, cause: &Cause, machine: &Machine) -> Row {
    let tip_mm = match cause {
        Cause::Tool(name) => machine.tip_of(name).ok(),
        _ => None,
    };
    let exchanged = match cause {
        Cause::ToolsExchanged(one, other) => {
            let [one, other] = [one, other].map(|name| machine.tip_of(name).ok());
            one.zip(other).map(|(one, other)| [one, other])
        }
        _ => None,
    };
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
        if let Cause::Shifted(shifts) = cause {
            for (axis, um) in shifts {
                if let Ok(place) = machine.index_of(*axis) {
                    stand.state.q[place] += *um as f64 * 1e-3;
                }
            }
        }
        if let Cause::Exchanged(one, other) = cause {
            let place = |name: &AxisName| machine.index_of(*name).ok();
            if let (Some(one), Some(other)) = (place(one), place(other)) {
                stand.state.q.swap(one, other);
            }
        }
        if let Some([one, other]) = exchanged {
            if stand.tip_mm == one {
                stand.tip_mm = other;
            } else if stand.tip_mm == other {
                stand.tip_mm = one;
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
    match (cause, &mut row.seen) {
        (Cause::Turned, seen) => seen.turn(),
        (Cause::Mirrored, Seen::Point { at_mm, .. }) => at_mm.x = -at_mm.x,
        (
            Cause::LengthsInInches,
            Seen::Distance { length_mm, .. } | Seen::Pair { length_mm, .. },
        ) => *length_mm *= MM_PER_INCH,
        _ => {}
    }
    row
}
