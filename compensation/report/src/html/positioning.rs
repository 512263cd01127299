//! Positioning tests to ISO 230-2: the usual plot, the figures, the table of the targets.

use volcomp_metrology::{Approach, TargetRow};

use super::write::{Cell, Page};
use crate::{
    described::described,
    pictures::positioning_plot,
    plot::xy,
    report::{Positioning, Report},
};

const MOST_ROWS: usize = 48;

pub(super) fn positioning(page: &mut Page, report: &Report) {
    if report.positioning.is_empty() {
        page.paragraph("lead", "No positioning test among the measurements.");
        return;
    }
    page.paragraph(
        "lead",
        "Readings as they are in the file. A, R, E, M and B are marked where they arise.",
    );
    for test in &report.positioning {
        page.put("<div class=\"keep\">");
        page.heading(3, &test.error, &described(&test.error));
        page.figure(&xy(&positioning_plot(test)), &test.file);
        figures(page, test);
        if test.result.a.is_none()
            && test.result.a_forward.is_none()
            && test.result.a_backward.is_none()
        {
            page.paragraph("note", "A and R need at least two runs in a direction.");
        }
        page.put("</div>");
        targets(page, test);
    }
}

fn figures(page: &mut Page, test: &Positioning) {
    let r = &test.result;
    let unit = &test.unit;
    let [e, m, b, mean_b] = if test.edition < 2014 {
        ["E systematic deviation", "M mean deviation", "B reversal value", "mean reversal value"]
    } else {
        ["E systematic error", "M mean error", "B reversal error", "mean reversal error"]
    };
    let columns = [
        &format!("ISO 230-2:{}, {unit}", test.edition),
        ">bidirectional",
        ">forward ↑",
        ">backward ↓",
    ];
    let all = [
        ("A accuracy", [r.a, r.a_forward, r.a_backward]),
        ("R repeatability", [r.r, r.r_forward, r.r_backward]),
        (e, [r.e, r.e_forward, r.e_backward]),
        (m, [r.m, None, None]),
        (b, [r.b, None, None]),
        (mean_b, [r.mean_b, None, None]),
    ];
    let rows = all.into_iter().map(|(name, values)| {
        let mut row = vec![Cell::text(name)];
        row.extend(values.map(|value| Cell::Number(value, 2)));
        row
    });
    page.table(&columns, rows);
    let Some(vdi) = &test.vdi else {
        page.paragraph("note", "VDI/DGQ 3441 is not evaluated: it needs both directions and at least two runs in each.");
        return;
    };
    let values = [vdi.p, vdi.pa, vdi.u_max, vdi.u_mean, vdi.ps_max, vdi.ps_mean];
    let columns = ["VDI/DGQ 3441", ">P", ">Pa", ">U max", ">Ū", ">Ps max", ">P̄s"];
    let mut row = vec![Cell::text(unit)];
    row.extend(values.map(|value| Cell::number(value, 2)));
    page.table(&columns, [row]);
    page.paragraph("note", "P positional uncertainty, Pa position deviation, U reversal, Ps scatter (6 s); a bar is the mean over the targets.");
}

fn targets(page: &mut Page, test: &Positioning) {
    let columns = [&format!(">target {}", test.x_unit), ">x̄ ↑", ">x̄ ↓", ">s ↑", ">s ↓", ">B", ">R"];
    let all = &test.result.targets;
    let shown = chosen(all);
    if shown.len() < all.len() {
        page.paragraph("note", &format!("{} targets in all; the table shows those with the extreme values and evenly spaced ones between.", all.len()));
    }
    let mean = |of: &Option<Approach>| Cell::Number(of.as_ref().map(|of| of.mean), 2);
    let s = |of: &Option<Approach>| Cell::Number(of.as_ref().and_then(|of| of.s), 2);
    let rows = shown.into_iter().map(|row| {
        vec![
            Cell::number(row.target, 3),
            mean(&row.forward),
            mean(&row.backward),
            s(&row.forward),
            s(&row.backward),
            Cell::Number(row.reversal, 2),
            Cell::Number(row.repeatability, 2),
        ]
    });
    page.table(&columns, rows);
}

/// Targets to list: all if there are few enough, otherwise evenly spaced ones and those that determine the figures.
fn chosen(all: &[TargetRow]) -> Vec<&TargetRow> {
    if all.len() <= MOST_ROWS {
        return all.iter().collect();
    }
    let step = all.len().div_ceil(MOST_ROWS - 8);
    let mut places: Vec<usize> = (0..all.len()).step_by(step).chain([all.len() - 1]).collect();
    let values: [fn(&TargetRow) -> Option<f64>; 4] = [
        |row| row.forward.map(|of| of.mean),
        |row| row.backward.map(|of| of.mean),
        |row| row.reversal.map(f64::abs),
        |row| row.repeatability,
    ];
    for value in values {
        let with = all.iter().enumerate().filter_map(|(place, row)| Some((place, value(row)?)));
        let with: Vec<(usize, f64)> = with.collect();
        let by = |a: &&(usize, f64), b: &&(usize, f64)| a.1.total_cmp(&b.1);
        places.extend(with.iter().min_by(by).map(|found| found.0));
        places.extend(with.iter().max_by(by).map(|found| found.0));
    }
    places.sort_unstable();
    places.dedup();
    places.into_iter().map(|place| &all[place]).collect()
}
