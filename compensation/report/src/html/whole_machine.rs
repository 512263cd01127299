//! Uncertainty, what was not measured, and what observations of the whole machine determine.

use super::write::{Cell, Page};
use crate::{
    plot::{escaped, short},
    report::{Report, Weighted, place},
    texts::{Language, Texts},
};

/// So many combinations of the null space are written out.
const MOST_COMBINATIONS: usize = 40;
/// Parts of a combination that are smaller than this share of its largest are left out.
const LEAST_WEIGHT: f64 = 0.02;

fn list(page: &mut Page, texts: &[String], t: &Texts) {
    let lang = if t.language == Language::En {
        ""
    } else {
        " lang=\"en\""
    };
    page.put("<ul>");
    for text in texts {
        page.put(&format!("<li{lang}>{}</li>", escaped(text)));
    }
    page.put("</ul>");
}

pub(super) fn uncertainty(page: &mut Page, report: &Report, t: &Texts) {
    let Some(found) = &report.uncertainty else {
        page.paragraph("lead", t.no_uncertainty);
        return;
    };
    if let Some(drawn) = &found.drawn {
        page.paragraph("lead", t.uncertainty_lead);
        let columns = [
            String::new(),
            format!(">{}, µm", t.uncertainty_k1),
            format!(">{}, µm", t.expanded),
            t.at.to_owned(),
        ];
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let at = place(&drawn.at);
        let row = |name: &str, um: f64, at: String| {
            vec![
                Cell::text(name),
                Cell::number(um, 2),
                Cell::number(2.0 * um, 2),
                Cell::Fixed(at),
            ]
        };
        page.table(
            &columns,
            [
                row(t.rms, drawn.rms_um, String::new()),
                row(t.largest, drawn.max_um, at),
            ],
        );
        page.paragraph(
            "note",
            &format!("{} {}, {} {}", drawn.trials, t.trials, t.seed, drawn.seed),
        );
    } else {
        page.paragraph("lead", t.not_drawn);
    }
    if !found.stated.is_empty() {
        page.heading(4, t.contributions, "");
        let rows = found.stated.iter().map(|of| {
            let words = match of.key.as_str() {
                "laser_um_per_m" => t.c_laser,
                "square_urad" => t.c_square,
                "reading_um" => t.c_reading,
                "reading_urad" => t.c_reading_angle,
                other => other,
            };
            vec![
                Cell::text(words),
                Cell::number(of.standard, 2),
                Cell::text(&of.unit),
            ]
        });
        page.table(&["", &format!(">{}", t.value), ""], rows);
    }
    if !found.not_counted.is_empty() {
        page.heading(4, t.not_counted, "");
        list(page, &found.not_counted, t);
    }
}

pub(super) fn open(page: &mut Page, report: &Report, t: &Texts) {
    let is_machine_file = report.head.files.is_empty();
    if report.not_measured.is_empty() {
        page.paragraph(
            "lead",
            if is_machine_file {
                t.open_machine
            } else {
                t.open_nothing
            },
        );
        return;
    }
    page.paragraph("", t.open_lead);
    list(page, &report.not_measured, t);
}

pub(super) fn identified(page: &mut Page, report: &Report, t: &Texts) {
    let Some(found) = &report.identified else {
        return;
    };
    page.paragraph("lead", t.identified_lead);
    page.put(&format!(
        "<p><b>{} {} {} {}</b>; {} {}. <span class=\"lead\">{}</span></p>",
        escaped(t.rank),
        found.rank,
        escaped(t.of_unknowns),
        found.of,
        escaped(t.score),
        escaped(&power(found.score)),
        escaped(t.score_note)
    ));
    let digits = |unit: &str| match unit {
        "mm" => 4,
        "deg" => 6,
        _ => 2,
    };
    let columns = [
        t.unknown.to_owned(),
        format!(">{}", t.value),
        format!(">{}", t.uncertainty_k1),
        t.unit.to_owned(),
        t.given_zero.to_owned(),
    ];
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let rows = found.parameters.iter().map(|parameter| {
        let digits = digits(&parameter.unit);
        let (value, uncertainty) = match parameter.uncertainty {
            Some(u) => (
                Cell::number(parameter.value, digits),
                Cell::number(u, digits),
            ),
            None => (Cell::Number(None, 0), Cell::text(t.not_found)),
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
    let columns = [
        t.what_is_left.to_owned(),
        format!(">{}", t.rms),
        format!(">{}", t.largest),
        format!(">{}", t.rows),
    ];
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let left = [
        (t.fitted_rows, Some(found.residual)),
        (t.left_rows, found.left_out),
        (t.judged_rows, found.judged),
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
    page.heading(4, t.null_space, "");
    if found.null_space.is_empty() {
        page.paragraph("", t.null_nothing);
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
        page.heading(4, t.redundant, "");
        page.paragraph("", &found.redundant.join(", "));
    }
    if let Some(next) = &found.next {
        page.heading(4, t.next, "");
        page.paragraph("", next);
    }
}

/// `EXX constant + 0.50 EX0C`.
fn combined(parts: &[Weighted]) -> String {
    let largest = parts
        .iter()
        .map(|part| part.weight.abs())
        .fold(0.0, f64::max);
    let kept = parts
        .iter()
        .filter(|part| part.weight.abs() >= LEAST_WEIGHT * largest);
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

/// 0.0013 as 1.3 · 10⁻³ would be read as it is: three digits.
fn power(value: f64) -> String {
    if value == 0.0 || (1e-3..1e3).contains(&value.abs()) {
        short(value, 3)
    } else if value.is_finite() {
        format!("{value:.1e}")
    } else {
        "–".to_owned()
    }
}
