//! Uncertainty, unmeasured errors, and results of observations of the whole machine.

use super::write::{Cell, Page};
use crate::{
    plot::{escaped, short},
    report::{Report, Weighted, place},
};

const MOST_COMBINATIONS: usize = 40;
/// Minimum weight of a listed unknown in a combination, relative to the largest weight.
const LEAST_WEIGHT: f64 = 0.02;

fn list(page: &mut Page, texts: &[String]) {
    page.put("<ul>");
    for text in texts {
        page.put(&format!("<li>{}</li>", escaped(text)));
    }
    page.put("</ul>");
}

pub(super) fn uncertainty(page: &mut Page, report: &Report) {
    let Some(found) = &report.uncertainty else {
        page.paragraph(
            "lead",
            "Not evaluated: no contributions are stated and no machines were drawn.",
        );
        return;
    };
    if let Some(drawn) = &found.drawn {
        page.paragraph("lead", "Of the position error over poses of all axes: the readings are drawn again from their scatter and from the stated contributions, and the spread of the machines that they give is the standard uncertainty (JCGM 101).");
        let columns = ["", ">standard uncertainty, µm", ">expanded, k = 2, µm", "at"];
        let at = place(&drawn.at);
        let row = |name: &str, um: f64, at: String| {
            vec![Cell::text(name), Cell::number(um, 2), Cell::number(2.0 * um, 2), Cell::Fixed(at)]
        };
        page.table(
            &columns,
            [row("rms", drawn.rms_um, String::new()), row("largest", drawn.max_um, at)],
        );
        page.paragraph("note", &format!("{} machines drawn, seed {}", drawn.trials, drawn.seed));
    } else {
        page.paragraph(
            "lead",
            "The volumetric error's uncertainty was not computed (no machines were drawn).",
        );
    }
    if !found.stated.is_empty() {
        page.heading(4, "Stated contributions (standard uncertainty, k = 1)", "");
        let rows = found.stated.iter().map(|of| {
            let words = match of.key.as_str() {
                "laser_um_per_m" => "scale of the laser, material temperature included",
                "square_urad" => "reference angle of each squareness",
                "reading_um" => "mean linear reading at a target",
                "reading_urad" => "mean angular reading at a target",
                other => other,
            };
            vec![Cell::text(words), Cell::number(of.standard, 2), Cell::text(&of.unit)]
        });
        page.table(&["", ">value", ""], rows);
    }
    if !found.not_counted.is_empty() {
        page.heading(4, "Not counted", "");
        list(page, &found.not_counted);
    }
}

pub(super) fn open(page: &mut Page, report: &Report) {
    let is_machine_file = report.head.files.is_empty();
    if is_machine_file {
        page.paragraph("lead", "This report is of a machine file: nothing was measured here.");
    }
    if report.not_measured.is_empty() {
        if !is_machine_file {
            page.paragraph("lead", "Every error of the structure was measured or found.");
        }
        return;
    }
    page.paragraph("", "An error that nothing measured is taken as the machine file has it, or as 0. The model then does not contain it, a compensation cannot remove it, and neither the volumetric error nor its uncertainty above counts it.");
    list(page, &report.not_measured);
}

pub(super) fn identified(page: &mut Page, report: &Report) {
    let Some(found) = &report.identified else {
        return;
    };
    page.paragraph("lead", "Found from observations of the whole machine.");
    page.put(&format!("<p><b>rank {} of {}</b>; score of what is determined {}. <span class=\"lead\">1 is best. An unknown may be 1/score times as uncertain as if all others were known.</span></p>", found.rank, found.of, escaped(&power(found.score))));
    let digits = |unit: &str| match unit {
        "mm" => 4,
        "deg" => 6,
        _ => 2,
    };
    let columns = ["unknown", ">value", ">standard uncertainty", "unit", "holds if zero"];
    let rows = found.parameters.iter().map(|parameter| {
        let digits = digits(&parameter.unit);
        let (value, uncertainty) = match parameter.uncertainty {
            Some(u) => (Cell::number(parameter.value, digits), Cell::number(u, digits)),
            None => (Cell::Number(None, 0), Cell::text("not determined")),
        };
        vec![
            Cell::text(&parameter.name),
            value,
            uncertainty,
            Cell::text(&parameter.unit),
            Cell::text(parameter.given_zero.join(", ")),
        ]
    });
    page.table(&columns, rows);
    let columns = ["what is left, µm", ">rms", ">largest", ">rows"];
    let left = [
        ("fitted rows", Some(found.residual)),
        ("rows left out", found.left_out),
        ("judged rows", found.judged),
    ];
    let rows = left.into_iter().filter_map(|(name, of)| {
        let left = of?;
        Some(vec![
            Cell::text(name),
            Cell::number(left.rms_um, 2),
            Cell::number(left.max_um, 2),
            Cell::number(left.rows as f64, 0),
        ])
    });
    page.table(&columns, rows);
    page.heading(4, "Null space: changes that the observations do not see", "");
    if found.null_space.is_empty() {
        page.paragraph("", "Empty: every unknown is determined.");
    } else {
        page.put("<ul>");
        for combination in found.null_space.iter().take(MOST_COMBINATIONS) {
            page.put(&format!("<li>{}</li>", escaped(&combined(combination))));
        }
        page.put("</ul>");
        if found.null_space.len() > MOST_COMBINATIONS {
            page.paragraph("note", &format!("… {}", found.null_space.len()));
        }
    }
    if !found.redundant.is_empty() {
        page.heading(4, "Zero by convention, and not counted", "");
        page.paragraph("", &found.redundant.join(", "));
    }
    if let Some(next) = &found.next {
        page.heading(4, "Measure next", "");
        page.paragraph("", next);
    }
}

/// Formats a combination: `EXX constant + 0.50 EX0C`.
fn combined(parts: &[Weighted]) -> String {
    let largest = parts.iter().map(|part| part.weight.abs()).fold(0.0, f64::max);
    let kept = parts.iter().filter(|part| part.weight.abs() >= LEAST_WEIGHT * largest);
    let mut text = String::new();
    for Weighted { name, weight } in kept {
        let sign = match (text.is_empty(), *weight < 0.0) {
            (true, false) => "",
            (true, true) => "− ",
            (false, false) => " + ",
            (false, true) => " − ",
        };
        text += sign;
        let size = weight.abs() / if largest > 0.0 { largest } else { 1.0 };
        if (size - 1.0).abs() > 0.005 {
            text += &short(size, 2);
            text.push(' ');
        }
        text += name;
    }
    text
}

/// Formats a value of magnitude 0.001 to 1000 with three decimals, others in scientific notation.
fn power(value: f64) -> String {
    if value == 0.0 || (1e-3..1e3).contains(&value.abs()) {
        short(value, 3)
    } else if value.is_finite() {
        format!("{value:.1e}")
    } else {
        "–".to_owned()
    }
}
