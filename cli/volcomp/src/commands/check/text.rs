//! The machine as it is understood, for people.

use std::fmt::Write;

use volcomp_vocabulary::ErrorName;

use crate::{
    answers::check::{Check, Place, Size},
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
        text += &super::provenance::text(provenance);
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
            axis.unit.clone(),
            axis.carries.clone(),
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
        let errors = |names: &[ErrorName]| {
            let names: Vec<String> = names.iter().map(ToString::to_string).collect();
            names.join(" ")
        };
        let mut said = format!(
            "thermal terms, zero at {} °C, sensors {}",
            thermal.reference_degc,
            thermal.sensors.join(" ")
        );
        if !thermal.expansion.is_empty() {
            // Writing to a string never fails.
            let _ = write!(said, "; expansion of {}", errors(&thermal.expansion));
        }
        if !thermal.drift.is_empty() {
            let _ = write!(said, "; drift of {}", errors(&thermal.drift));
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
    let names: Vec<String> = names.iter().map(ToString::to_string).collect();
    folded(&format!("{what}: {}", names.join(" ")), " ")
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
        let outside = &check.home.outside_travel;
        let outside: Vec<String> = outside.iter().map(ToString::to_string).collect();
        let _ = writeln!(
            text,
            " Home lies outside the travel of {}.",
            outside.join(" ")
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
