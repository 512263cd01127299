//! The machine as it is understood, for people: tables, the chain as a drawing, axes and errors in words.

use std::fmt::Write;

use volcomp_kinematics::{Chain, Joint, MotionFrame, Side, along_machine_axis, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, Component, ErrorName};

use super::{Check, Place, Size};
use crate::{
    commands::outside::joined,
    table::{HEAD, fixed, folded, table, table_text, to_the_left},
};

/// The whole answer. Writing to a String cannot fail.
pub(super) fn text(check: &Check) -> String {
    let name = if check.name.is_empty() {
        "machine without a name"
    } else {
        &check.name
    };
    let mut text = format!(
        "{HEAD}{name}{HEAD:#}: {}\n\n{}\n",
        check.structure, check.sketch
    );
    text += &axes(check);
    text += &tool(check);
    text += &errors(check);
    if let Some(provenance) = &check.provenance {
        text += &provenance.text();
    }
    text += &places(check);
    text
}

fn head(text: &mut String, what: &str) {
    let _ = write!(text, "\n{HEAD}{what}{HEAD:#}\n");
}

fn axes(check: &Check) -> String {
    let mut text = String::new();
    let mut rows = table(&["axis", "from", "to", "unit", "carries", "point mm"]);
    to_the_left(&mut rows, &[3, 4, 5]);
    for axis in &check.axes {
        let [from, to] = axis.travel.map(|end| end.to_string());
        rows.add_row([
            axis.name.to_string(),
            from,
            to,
            axis.unit.to_owned(),
            axis.carries.to_owned(),
            vector(&axis.point_mm),
        ]);
    }
    text += &table_text(&rows);
    text.push('\n');
    for axis in &check.axes {
        text += &folded(&axis.motion, " ");
        if let Some(signs) = &axis.signs {
            text += &folded(signs, "   ");
        }
        if let Some(period) = axis.modulo {
            let _ = writeln!(
                text,
                "   {} goes round: its curves repeat after {period} deg",
                axis.name
            );
        }
    }
    text
}

fn tool(check: &Check) -> String {
    let mut text = String::new();
    head(
        &mut text,
        "Tool and workpiece at machine zero, in machine coordinates",
    );
    let tool = check.tool.name.as_deref().unwrap_or("[tool]");
    let _ = writeln!(
        text,
        " tool {tool}: tip {} mm, from the tip to the spindle {}",
        vector(&check.tool.tip_mm),
        vector(&check.tool.axis)
    );
    if !check.tools.is_empty() {
        text += &folded(
            &format!("other tools (--tool): {}", check.tools.join(" ")),
            " ",
        );
    }
    let _ = writeln!(
        text,
        " workpiece origin {} mm",
        vector(&check.workpiece_origin_mm)
    );
    text
}

fn errors(check: &Check) -> String {
    let mut text = String::new();
    head(&mut text, "Errors over travel");
    if check.errors.is_empty() {
        text += " none: every error is zero or not stated\n";
    } else {
        let mut rows = table(&["error", "", "min", "max", "unit", "largest at"]);
        to_the_left(&mut rows, &[1, 4, 5]);
        for size in &check.errors {
            rows.add_row([
                size.name.to_string(),
                size.meaning.clone(),
                fixed(size.smallest, 2),
                fixed(size.largest, 2),
                size.name.component.symbol().to_owned(),
                at(size),
            ]);
        }
        text += &table_text(&rows);
    }
    for assembly in &check.assembly {
        let _ = writeln!(
            text,
            " assembly of {}: {} µm, {} µrad",
            assembly.axis,
            vector(&assembly.position_um),
            vector(&assembly.rotation_urad)
        );
    }
    text += &names("stated as zero", &check.zero);
    text += &names("not stated, taken as zero", &check.not_stated);
    if let Some(thermal) = &check.thermal {
        let mut said = format!(
            "thermal terms, zero at {} °C, sensors {}",
            thermal.reference_degc,
            thermal.sensors.join(" ")
        );
        if !thermal.expansion.is_empty() {
            // Writing to a string never fails.
            let _ = write!(said, "; expansion of {}", joined(&thermal.expansion));
        }
        if !thermal.drift.is_empty() {
            let _ = write!(said, "; drift of {}", joined(&thermal.drift));
        }
        text += &folded(&said, " ");
    }
    text
}

fn at(size: &Size) -> String {
    let Some(at) = &size.at else {
        return String::new();
    };
    let at = at.iter().map(|(name, place)| format!("{name}={place:.0}"));
    at.collect::<Vec<_>>().join(" ")
}

fn names(what: &str, names: &[ErrorName]) -> String {
    if names.is_empty() {
        return String::new();
    }
    folded(&format!("{what}: {}", joined(names)), " ")
}

fn places(check: &Check) -> String {
    let mut text = String::new();
    head(&mut text, "Tool tip and its error, in workpiece axes");
    let mut rows = table(&[
        "", "x mm", "y mm", "z mm", "X µm", "Y µm", "Z µm", "A µrad", "B µrad", "C µrad",
    ]);
    let home = (String::from("home"), &check.home);
    let corners = check
        .corners
        .iter()
        .map(|place| (corner(check, place), place));
    for (name, place) in [home].into_iter().chain(corners) {
        let mut cells = vec![name];
        cells.extend(place.tip_mm.iter().map(|x| fixed(*x, 0)));
        cells.extend(place.position_um.iter().map(|x| fixed(*x, 1)));
        cells.extend(place.rotation_urad.iter().map(|x| fixed(*x, 1)));
        rows.add_row(cells);
    }
    text += &table_text(&rows);
    text += "\n Home is every axis at 0; a corner has X, Y, Z at an end of travel, others at 0.\n";
    if !check.home.outside_travel.is_empty() {
        let _ = writeln!(
            text,
            " Home lies outside the travel of {}.",
            joined(&check.home.outside_travel)
        );
    }
    text
}

/// `X- Y+ Z-`: which end of travel each axis stands at.
fn corner(check: &Check, place: &Place) -> String {
    let ends = check.axes.iter().filter_map(|axis| {
        let at = *place.at.get(&axis.name)?;
        let [low, high] = axis.travel;
        (axis.name.mcs_index() == axis.name.index()).then(|| {
            let end = if at == high && low != high { '+' } else { '-' };
            format!("{}{end}", axis.name)
        })
    });
    ends.collect::<Vec<_>>().join(" ")
}

fn vector([x, y, z]: &[f64; 3]) -> String {
    format!("[{x}, {y}, {z}]")
}

const LETTERS: [&str; 3] = ["X", "Y", "Z"];

/// A direction in MCS: `+X`, or its three numbers where it lies along none of X, Y, Z.
fn direction(u: &Vector3<f64>) -> String {
    match along_machine_axis(u) {
        Some((place, is_positive)) => {
            let sign = if is_positive { '+' } else { '−' };
            format!("{sign}{}", LETTERS[place])
        }
        None => format!("[{:.4}, {:.4}, {:.4}]", u.x, u.y, u.z),
    }
}

/// A description of a positive motion of an axis, as seen from the workpiece and in the workshop.
pub(super) fn motion(joint: &Joint) -> String {
    let name = joint.name;
    let (to, back) = (direction(&joint.direction), direction(&-joint.direction));
    let errors = match joint.motion_frame {
        MotionFrame::Fixed => "",
        MotionFrame::Turning => "; its error motions turn with it",
    };
    match (joint.kind, joint.side) {
        (AxisKind::Linear, Side::Workpiece) => format!(
            "+{name}: the tool moves to {to} seen from the workpiece; the table moves to {back}"
        ),
        (AxisKind::Linear, Side::Tool) => format!("+{name}: the tool moves to {to}"),
        (AxisKind::Rotary, Side::Workpiece) => format!(
            "+{name}: the tool turns right-handed about {to} seen from the workpiece; the table turns right-handed about {back}{errors}"
        ),
        (AxisKind::Rotary, Side::Tool) => {
            format!("+{name}: the tool turns right-handed about {to}{errors}")
        }
    }
}

/// A warning about the signs of the errors of an axis that does not count along its letter's direction: errors are
/// along and about the axes of MCS whatever the direction of the axis. `None` where both agree.
pub(super) fn signs(joint: &Joint) -> Option<String> {
    let (name, along) = (joint.name, joint.name.mcs_index());
    let found = along_machine_axis(&joint.direction);
    if found == Some((along, true)) {
        return None;
    }
    let letter = LETTERS[along];
    let component = Component::ALL.into_iter().find(|component| {
        component.mcs_index() == along && component.is_angular() == name.is_rotary()
    })?;
    let positioning = ErrorName::motion(component, name);
    let too_far = match joint.kind {
        AxisKind::Linear => "goes too far",
        AxisKind::Rotary => "turns too far",
    };
    Some(if found == Some((along, false)) {
        format!(
            "{name} counts against {letter} of the machine, its errors do not: where {name} {too_far} (a positive \
             deviation), {positioning} is negative"
        )
    } else {
        format!(
            "{name} lies aslant, its errors are along and about X, Y and Z of the machine: where {name} {too_far}, \
             more components than {positioning} change"
        )
    })
}

/// An error by what it is, in the words of the conventions: `straightness deviation of X in Y`, `pitch of X`. Pitch
/// and yaw are those of a horizontal axis; a vertical one has tilts.
pub(super) fn meaning(error: ErrorName) -> String {
    let axis = error.axis;
    let along = LETTERS[error.component.mcs_index()];
    let own = error.component.mcs_index() == axis.mcs_index();
    match (error.location, axis.kind(), error.component.is_angular()) {
        (true, AxisKind::Linear, _) => match (error.component, axis.letter()) {
            (Component::EC, 'Y') => "squareness of Y to X".to_owned(),
            (Component::EB, 'Z') => "squareness of Z to X".to_owned(),
            (Component::EA, 'Z') => "squareness of Z to Y".to_owned(),
            _ => format!("tilt of the line of {axis} about {along}"),
        },
        (true, AxisKind::Rotary, false) => format!("shift of the line of {axis} along {along}"),
        (true, AxisKind::Rotary, true) => format!("tilt of the line of {axis} about {along}"),
        (false, AxisKind::Linear, false) if own => format!("positioning deviation of {axis}"),
        (false, AxisKind::Linear, false) => format!("straightness deviation of {axis} in {along}"),
        (false, AxisKind::Linear, true) if own => format!("roll of {axis}"),
        (false, AxisKind::Linear, true) => match (axis.mcs_index(), error.component) {
            (0 | 1, Component::EC) => format!("yaw of {axis}"),
            (0, Component::EB) | (1, Component::EA) => format!("pitch of {axis}"),
            _ => format!("tilt of {axis} about {along}"),
        },
        (false, AxisKind::Rotary, false) if own => format!("axial motion of {axis}"),
        (false, AxisKind::Rotary, false) => format!("radial motion of {axis} along {along}"),
        (false, AxisKind::Rotary, true) if own => {
            format!("angular positioning deviation of {axis}")
        }
        (false, AxisKind::Rotary, true) => format!("tilt of {axis} about {along}"),
    }
}

/// Two lines from the workpiece to the tool: the letters, and below each what it does.
///
/// ```text
///   w-----C'----X'----b-----Y-----Z-----B-----t
///  work  turn slide  bed  slide slide turn  tool
/// ```
pub(super) fn sketch(chain: &Chain) -> String {
    let mut places = vec![("w".to_owned(), "work")];
    let mut on_bed = false;
    let bed = || ("b".to_owned(), "bed");
    for joint in chain.joints() {
        if joint.side == Side::Tool && !on_bed {
            on_bed = true;
            places.push(bed());
        }
        let prime = if joint.side == Side::Workpiece {
            "'"
        } else {
            ""
        };
        let does = match joint.kind {
            AxisKind::Linear => "slide",
            AxisKind::Rotary => "turn",
        };
        places.push((format!("{}{prime}", joint.name), does));
    }
    if !on_bed {
        places.push(bed());
    }
    places.push(("t".to_owned(), "tool"));
    let last = places.len() - 1;
    let (mut letters, mut words) = ("   ".to_owned(), " ".to_owned());
    for (index, (letter, word)) in places.iter().enumerate() {
        letters += letter;
        if index < last {
            letters += &"-".repeat(6 - letter.chars().count());
        }
        // Writing to a string never fails.
        let _ = write!(words, "{word:^5} ");
    }
    format!("{letters}\n{}\n", words.trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_element_stands_above_its_word() {
        let chain = |code: &str| Chain::new(code.parse().expect("a structure"));
        assert_eq!(
            sketch(&chain("w C' X' b Y Z B t")),
            "   w-----C'----X'----b-----Y-----Z-----B-----t\n work  turn  slide  bed  slide slide turn  tool\n"
        );
        let longest = sketch(&chain("w A' B' C' X' Y' Z' U' V' W' b t"));
        assert!(
            longest.lines().all(|line| line.chars().count() <= 80),
            "{longest}"
        );
        assert!(longest.contains("W'----b-----t"), "{longest}");
    }
}
