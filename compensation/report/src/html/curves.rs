//! The section of each error: readings, curve and band, the residuals below, and figures.

use volcomp_fit::BandSource;

use super::write::{Cell, Page};
use crate::{
    described::described,
    pictures::{curve_plot, direction_word, residual_plot},
    plot::xy,
    report::{Curve, Report, Residual},
};

pub(super) fn curves(page: &mut Page, report: &Report) {
    let (measured, stated): (Vec<&Curve>, Vec<&Curve>) =
        report.curves.iter().partition(|curve| !curve.lines.is_empty());
    if report.curves.is_empty() {
        page.paragraph("lead", "None.");
    }
    if !measured.is_empty() {
        page.paragraph("lead", "Readings are shown where their curve is: without what tilts add over their lever (Abbe), a straightness without its line, zero at the reference.");
    }
    let mut sources: Vec<BandSource> = Vec::new();
    for curve in &measured {
        one(page, curve);
        let bands = curve.branches.iter().filter_map(|b| b.band.as_ref());
        sources.extend(bands.map(|band| band.source));
    }
    if !measured.is_empty() {
        page.paragraph("note", "Residual: mean reading minus curve. Leave-one-out: root mean square of what the curve misses of readings that were left out of its fit one at a time.");
    }
    if !sources.is_empty() {
        page.paragraph("note", "The band holds the true curve with a probability of 95 % at each single place: the runs are drawn again as a whole (bootstrap), with Student's t for few of them, and what the curve misses of readings that are left out is added.");
    }
    if sources.contains(&BandSource::Residuals) {
        page.paragraph("note", "With one run its residuals are drawn again: what differs from run to run is not in the band.");
    }
    if !stated.is_empty() {
        page.heading(3, "the machine file", "");
        page.paragraph(
            "lead",
            "These curves are stated by the machine file; no readings belong to them here.",
        );
        for curve in stated {
            one(page, curve);
        }
    }
}

fn one(page: &mut Page, curve: &Curve) {
    page.put("<div class=\"keep curve\">");
    page.heading(3, &curve.error, &described(&curve.error));
    let files: Vec<&str> = curve.lines.iter().filter_map(|line| line.file.as_deref()).collect();
    page.figure(&xy(&curve_plot(curve)), &files.join(", "));
    if curve.branches.iter().any(|branch| !branch.residuals.is_empty()) {
        page.figure(&xy(&residual_plot(curve)), "");
    }
    numbers(page, curve);
    for line in &curve.lines {
        if line.file.is_none() {
            page.paragraph("note", "Found from several parallel lines of other errors.");
        } else if line.runs.is_empty() {
            page.paragraph("note", "Tilts of a bridge, summed up: only means are shown.");
        }
    }
    let has_readings = !curve.lines.is_empty();
    if has_readings && curve.branches.iter().all(|branch| branch.band.is_none()) {
        page.paragraph("note", "No band: the readings of this curve are no runs of their own (tilts of a bridge that are summed up, or lines of other errors), or too few to be drawn again.");
    }
    page.put("</div>");
}

fn numbers(page: &mut Page, curve: &Curve) {
    let fits: Vec<_> = curve
        .branches
        .iter()
        .filter_map(|branch| Some((branch.direction, branch.fit.as_ref()?)))
        .collect();
    if fits.is_empty() {
        return;
    }
    let unit = &curve.unit;
    let number = |name: &str| format!(">{name}");
    let columns = [
        format!("residual, {unit}"),
        "curve".to_owned(),
        number("readings"),
        number("smallest"),
        number("largest"),
        number("rms"),
        number("leave-one-out"),
        number("reversal"),
    ];
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let rows = fits.into_iter().map(|(direction, fit)| {
        let Residual { min, max, rms } = fit.residual;
        vec![
            Cell::text(direction_word(direction)),
            Cell::Fixed(fit.kind.clone()),
            Cell::number(fit.readings as f64, 0),
            Cell::number(min, 2),
            Cell::number(max, 2),
            Cell::number(rms, 2),
            Cell::Number(fit.leave_one_out, 2),
            Cell::Number(fit.reversal, 2),
        ]
    });
    page.table(&columns, rows);
}
