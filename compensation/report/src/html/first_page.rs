//! Header, verdict, warnings, and the list of files at the end.

use std::borrow::Cow;

use volcomp_metrology::Verdict;

use super::write::{Cell, Page};
use crate::{
    described::described,
    plot::{escaped, short},
    report::{CheckOf, Report, VOLUME, WarningKind},
};

pub(super) fn head(page: &mut Page, report: &Report) {
    let head = &report.head;
    page.paragraph("kind", "Calibration report");
    page.put(&format!(
        "<h1>{}</h1><dl class=\"facts\">",
        escaped(head.machine.as_deref().unwrap_or(&head.source))
    ));
    let range = |degc: &Option<[f64; 2]>| {
        degc.map(|[low, high]| {
            if high - low < 0.005 {
                format!("{} °C", short(low, 2))
            } else {
                format!("{} … {} °C", short(low, 2), short(high, 2))
            }
        })
    };
    let axes: Vec<String> = head
        .axes
        .iter()
        .map(|axis| {
            let [low, high] = axis.travel.map(plain);
            format!("{} {low} … {high} {}", axis.axis, axis.unit)
        })
        .collect();
    let tip = head.tool_tip_mm.map(plain).join(", ");
    for (name, value) in [("Customer", &head.customer), ("Certificate number", &head.certificate)] {
        if value.is_some() {
            fact(page, name, value.as_deref());
        }
    }
    for (name, value) in [
        ("Machine", head.machine.clone()),
        ("Serial number", head.serial.clone()),
        ("Date of measurement", head.date.clone()),
        ("Operator", head.operator.clone()),
        ("Instrument", head.instrument.clone()),
        ("Air temperature", range(&head.air_degc)),
        ("Material temperature", range(&head.material_degc)),
        ("Structure", Some(head.structure.clone())),
        ("Axes and travels", Some(axes.join("\n"))),
        ("Tool tip", Some(format!("{tip} mm"))),
        ("Made from", Some(head.source.clone())),
    ] {
        fact(page, name, value.as_deref());
    }
    page.put("</dl>");
    summary(page, report);
}

fn fact(page: &mut Page, name: &str, value: Option<&str>) {
    let value = match value {
        Some(value) => escaped(value).replace('\n', "<br>"),
        None => "<span class=\"none\">not stated</span>".to_owned(),
    };
    page.put(&format!("<div class=\"fact\"><dt>{}</dt><dd>{value}</dd></div>", escaped(name)));
}

/// Writes the figures of the first page and the line for the signature.
fn summary(page: &mut Page, report: &Report) {
    const MOST_ROWS: usize = 16;
    page.put("<div class=\"summary\"><h2>Summary</h2>");
    let (_, _, sentence) = verdict_words(report);
    page.put(&format!("<p><strong>{}</strong></p>", escaped(&sentence)));
    let with_unit = |value: f64, unit: &str| format!("{} {unit}", short(value, 2));
    let mut rows: Vec<Vec<Cell>> = Vec::new();
    for test in &report.positioning {
        let figures = [
            ("A", test.result.a),
            ("R", test.result.r),
            ("E", test.result.e),
            ("B", test.result.b),
        ];
        let known = figures.into_iter().filter_map(|(symbol, value)| {
            Some(format!("{symbol} {}", with_unit(value?, &test.unit)))
        });
        rows.push(vec![
            Cell::text(format!("{}, positioning (ISO 230-2:{})", test.error, test.edition)),
            Cell::text(known.collect::<Vec<_>>().join(", ")),
        ]);
    }
    for square in &report.squareness {
        rows.push(vec![
            Cell::text(format!(
                "squareness of {} and {}, angle − 90°",
                square.first, square.second
            )),
            Cell::text(with_unit(square.angle_urad, "µrad")),
        ]);
    }
    let more = rows.len().saturating_sub(MOST_ROWS);
    rows.truncate(MOST_ROWS);
    if more > 0 {
        rows.push(vec![Cell::text(format!("{more} further figures follow")), Cell::text("")]);
    }
    if let Some(volume) = &report.volume {
        let states = [Some(&volume.before), volume.after.as_ref()];
        let sizes = states.into_iter().flatten().map(|of| with_unit(of.found.form_max_um, "µm"));
        let name = match volume.after {
            Some(_) => format!("{LARGEST}, before and after"),
            None => LARGEST.to_owned(),
        };
        rows.push(vec![Cell::text(name), Cell::text(sizes.collect::<Vec<_>>().join(", "))]);
    }
    let missing = match report.count_as_0 {
        0 => "none".to_owned(),
        errors => format!("{errors}, which count as 0"),
    };
    rows.push(vec![Cell::text("errors that were not measured"), Cell::text(missing)]);
    rows.push(vec![Cell::text("warnings"), Cell::text(report.warnings.len().to_string())]);
    page.table(&["figure", "value"], rows);
    page.put(
        "<div class=\"signature\"><span>Place and date</span><span>Signature</span></div></div>",
    );
}

/// CSS class, sign and sentence of the verdict on all tolerances.
fn verdict_words(report: &Report) -> (&'static str, &'static str, Cow<'static, str>) {
    let whole = Verdict::of_all(report.checks.iter().map(|check| check.outcome));
    let (class, sign, sentence) = match whole {
        _ if report.checks.is_empty() => ("open", "–", "No tolerance stated."),
        Verdict::Fail => ("fail", "✗", "Not all stated tolerances are met."),
        Verdict::NotEvaluated => ("open", "?", "Not every stated tolerance could be evaluated."),
        Verdict::Undecided => ("open", "?", "Not every stated tolerance is decided."),
        Verdict::Pass => {
            let met = report.all_met().replacen('a', "A", 1) + ".";
            return ("pass", "✓", met.into());
        }
    };
    (class, sign, sentence.into())
}

/// Formats a coordinate with at most three decimals, without trailing zeros.
fn plain(value: f64) -> String {
    let text = short(value, 3);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

const LARGEST: &str = "largest volumetric error over all axes, after alignment";

pub(super) fn verdict(page: &mut Page, report: &Report) {
    let (class, sign, sentence) = verdict_words(report);
    page.put(&format!(
        "<div class=\"verdict {class}\"><span class=\"sign\" aria-hidden=\"true\">{sign}</span><strong>{}</strong></div>",
        escaped(&sentence)
    ));
    if report.checks.is_empty() {
        page.paragraph(
            "lead",
            "This report gives figures; it does not say whether they are good enough.",
        );
        return;
    }
    let columns = [
        "figure",
        // Columns that are also shown on a small screen.
        "Verdict",
        "of",
        ">value",
        ">U (k = 2)",
        ">tolerance",
        "",
    ];
    let rows = report.checks.iter().map(|check| {
        let (class, sign, word) = match check.outcome {
            Verdict::Pass => ("pass", "✓", "pass"),
            Verdict::Fail => ("fail", "✗", "fail"),
            Verdict::Undecided => ("open", "?", "undecided"),
            Verdict::NotEvaluated => ("open", "–", "not evaluated"),
        };
        vec![
            Cell::text(&check.symbol),
            Cell::Markup(format!("<span class=\"out {class}\">{sign} {}</span>", escaped(word))),
            Cell::Path(match &check.of {
                CheckOf::Symbol if check.symbol == VOLUME => LARGEST.to_owned(),
                CheckOf::Symbol => described(&check.symbol),
                CheckOf::Part | CheckOf::NotConfirmed | CheckOf::ScatterUnknown
                    if check.symbol != VOLUME =>
                {
                    format!("{}; of {}", described(&check.symbol), check.of)
                }
                CheckOf::MeasuredAlone
                | CheckOf::NotConfirmed
                | CheckOf::ScatterUnknown
                | CheckOf::Part
                | CheckOf::Corrected
                | CheckOf::AtReference => {
                    format!("{LARGEST}; of {}", check.of)
                }
                CheckOf::Test { .. } => check.of.to_string(),
            }),
            Cell::Number(check.value, 2),
            match (check.value, check.uncertainty) {
                (Some(_), None) => Cell::text(&check.without_uncertainty),
                (_, u) => Cell::Number(u, 2),
            },
            Cell::number(check.limit, 2),
            Cell::Fixed(check.unit.clone()),
        ]
    });
    page.table(&columns, rows);
    page.paragraph("note", "Where an uncertainty U (k = 2) is stated, by ISO 14253-1: a figure passes where it and U on top are at most the tolerance, fails where it less U is beyond, and is undecided between. Where none is stated the figure alone is compared. U contains what is stated and, for a squareness, the scatter of its lines, and nothing else.");
}

pub(super) fn warnings(page: &mut Page, report: &Report) {
    if report.warnings.is_empty() {
        page.paragraph("lead", "None.");
        return;
    }
    page.put("<ul class=\"warnings\">");
    for warning in &report.warnings {
        let kind = match warning.kind {
            WarningKind::Contradiction => "Contradiction",
            WarningKind::Few => "Few readings",
            WarningKind::Temperature => "Temperature",
            WarningKind::Outlier => "Outlier",
            WarningKind::NotMeasured => "Not measured",
            WarningKind::Note => "Note",
        };
        page.put(&format!(
            "<li><b>{}</b><span>{}</span></li>",
            escaped(kind),
            escaped(&warning.text)
        ));
    }
    page.put("</ul>");
}

pub(super) fn files(page: &mut Page, report: &Report) {
    let columns = ["file", "measures", ">targets", "runs ↑ / ↓", "Date of measurement"];
    let rows = report.head.files.iter().map(|file| {
        let runs = file.runs.map(|[forward, backward]| format!("{forward} / {backward}"));
        vec![
            Cell::Path(file.file.clone()),
            Cell::text(&file.measures),
            Cell::number(file.targets as f64, 0),
            Cell::text(runs.unwrap_or_else(|| "–".to_owned())),
            Cell::text(file.date.clone().unwrap_or_else(|| "not stated".to_owned())),
        ]
    });
    page.table(&columns, rows);
}
