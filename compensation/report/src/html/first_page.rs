//! Head, verdict, warnings, and the list of files at the end.

use volcomp_metrology::Verdict;

use super::write::{Cell, Page};
use crate::{
    plot::{escaped, short},
    report::{CheckOf, Report, WarningKind},
    texts::{Language, Texts, described},
    tolerance::VOLUME,
};

pub(super) fn head(page: &mut Page, report: &Report, t: &Texts) {
    let head = &report.head;
    page.paragraph("kind", t.title);
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
    for (name, value) in [
        (t.machine, head.machine.clone()),
        (t.serial, head.serial.clone()),
        (t.date, head.date.clone()),
        (t.operator, head.operator.clone()),
        (t.instrument, head.instrument.clone()),
        (t.air, range(&head.air_degc)),
        (t.material, range(&head.material_degc)),
        (t.structure, Some(head.structure.clone())),
        (t.axes, Some(axes.join("\n"))),
        (t.tool, Some(format!("{tip} mm"))),
        (t.source, Some(head.source.clone())),
    ] {
        let value = match &value {
            Some(value) => escaped(value).replace('\n', "<br>"),
            None => format!("<span class=\"none\">{}</span>", escaped(t.not_stated)),
        };
        page.put(&format!(
            "<div class=\"fact\"><dt>{}</dt><dd>{value}</dd></div>",
            escaped(name)
        ));
    }
    page.put("</dl>");
}

/// A coordinate without zeros at its end.
fn plain(value: f64) -> String {
    let text = short(value, 3);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

pub(super) fn verdict(page: &mut Page, report: &Report, t: &Texts) {
    let whole = Verdict::of_all(report.checks.iter().map(|check| check.outcome));
    let (class, sign, sentence) = match whole {
        _ if report.checks.is_empty() => ("open", "–", t.no_tolerance),
        Verdict::Fail => ("fail", "✗", t.some_fail),
        Verdict::NotEvaluated => ("open", "?", t.some_missing),
        Verdict::Undecided => ("open", "?", t.some_undecided),
        Verdict::Pass => ("pass", "✓", t.all_pass),
    };
    page.put(&format!(
        "<div class=\"verdict {class}\"><span class=\"sign\" aria-hidden=\"true\">{sign}</span><strong>{}</strong></div>",
        escaped(sentence)
    ));
    if report.checks.is_empty() {
        page.paragraph("lead", t.no_tolerance_more);
        return;
    }
    let columns = [
        t.figure,
        // Where a small screen shows it, too.
        t.verdict,
        t.of,
        &format!(">{}", t.value),
        &format!(">{}", t.u_expanded),
        &format!(">{}", t.tolerance),
        "",
    ];
    let rows = report.checks.iter().map(|check| {
        let (class, sign, word) = match check.outcome {
            Verdict::Pass => ("pass", "✓", t.pass),
            Verdict::Fail => ("fail", "✗", t.fail),
            Verdict::Undecided => ("open", "?", t.undecided),
            Verdict::NotEvaluated => ("open", "–", t.not_evaluated),
        };
        vec![
            Cell::text(&check.symbol),
            Cell::Markup(format!(
                "<span class=\"out {class}\">{sign} {}</span>",
                escaped(word)
            )),
            Cell::Path(match &check.of {
                CheckOf::Symbol if check.symbol == VOLUME => t.largest_volume.to_owned(),
                CheckOf::Symbol => described(&check.symbol, t),
                CheckOf::MeasuredAlone => format!("{}; {}", t.largest_volume, t.measured_alone),
                CheckOf::Test { .. } => check.of.to_string(),
            }),
            Cell::Number(check.value, 2),
            match (check.value, check.uncertainty) {
                (Some(_), None) => Cell::text(t.no_u),
                (_, u) => Cell::Number(u, 2),
            },
            Cell::number(check.limit, 2),
            Cell::Fixed(check.unit.clone()),
        ]
    });
    page.table(&columns, rows);
    page.paragraph("note", t.rule);
}

pub(super) fn warnings(page: &mut Page, report: &Report, t: &Texts) {
    if report.warnings.is_empty() {
        page.paragraph("lead", t.no_warnings);
        return;
    }
    // The sentences are the programs' own, in English whatever the language of the heads.
    let lang = if t.language == Language::En {
        ""
    } else {
        " lang=\"en\""
    };
    page.put("<ul class=\"warnings\">");
    for warning in &report.warnings {
        let kind = match warning.kind {
            WarningKind::Contradiction => t.contradiction,
            WarningKind::Few => t.few,
            WarningKind::Temperature => t.temperature,
            WarningKind::Outlier => t.outlier,
            WarningKind::NotMeasured => t.unmeasured,
            WarningKind::Note => t.note,
        };
        page.put(&format!(
            "<li><b>{}</b><span{lang}>{}</span></li>",
            escaped(kind),
            escaped(&warning.text)
        ));
    }
    page.put("</ul>");
}

pub(super) fn files(page: &mut Page, report: &Report, t: &Texts) {
    let targets = format!(">{}", t.targets);
    let runs = format!("{} ↑ / ↓", t.runs);
    let columns = [t.file, t.measures, &targets, &runs, t.date];
    let rows = report.head.files.iter().map(|file| {
        let runs = file
            .runs
            .map(|[forward, backward]| format!("{forward} / {backward}"));
        vec![
            Cell::Path(file.file.clone()),
            Cell::text(&file.measures),
            Cell::number(file.targets as f64, 0),
            Cell::text(runs.unwrap_or_else(|| "–".to_owned())),
            Cell::text(file.date.clone().unwrap_or_else(|| t.not_stated.to_owned())),
        ]
    });
    page.table(&columns, rows);
}
