//! The sections of the page: curves, positioning tests, squareness, diagonals and maps, and results of the whole
//! machine.

use volcomp_fit::BandSource;
use volcomp_metrology::{Approach, TargetRow};

use super::{Cell, Page};
use crate::{
    curves::described,
    pictures::{
        self, Maps, curve_plot, diagonal_plots, direction_word, exaggeration, positioning_plot,
        residual_plot, sketch,
    },
    plot::{
        Arrow, Quiver, colour_bar, escaped, finite, heat_map, quiver, round_below, short,
        square_sketch, xy,
    },
    report::{Curve, Diagonal, Positioning, Report, Residual, State, Volume, place},
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

pub(super) fn squareness(page: &mut Page, report: &Report) {
    if report.squareness.is_empty() {
        page.paragraph("lead", "No squareness is known.");
    } else {
        page.paragraph(
            "lead",
            "The angle of each pair of axes less 90°, drawn much larger than it is; dashed: 90°.",
        );
        let exaggeration = exaggeration(report.squareness.iter().map(|of| of.angle_urad));
        page.put("<div class=\"squares\">");
        for square in &report.squareness {
            let axes = [square.first.clone(), square.second.clone()];
            let sketch = square_sketch(&sketch(&axes, square.angle_urad, exaggeration));
            page.put(&format!("<figure>{sketch}</figure>"));
        }
        page.put("</div>");
        let rows = report.squareness.iter().map(|square| {
            let from = square.from.iter();
            let from: Vec<String> =
                from.map(|tilt| format!("{} = {}", tilt.error, short(tilt.urad, 2))).collect();
            vec![
                Cell::text(format!("{}{}", square.first, square.second)),
                Cell::number(square.angle_urad, 2),
                Cell::text(from.join(", ")),
                Cell::text(if square.measured { "this calibration" } else { "the machine file" }),
            ]
        });
        page.table(&["pair", ">angle − 90°, µrad", "from", "known from"], rows);
    }
    if !report.locations.is_empty() {
        page.heading(4, "Other location errors", "");
        let columns = ["error", ">value", ">standard uncertainty", ""];
        let rows = report.locations.iter().map(|location| {
            vec![
                Cell::text(&location.error),
                Cell::number(location.value, 2),
                Cell::Number(location.uncertainty, 2),
                Cell::text(&location.unit),
            ]
        });
        page.table(&columns, rows);
    }
}

fn state_words(state: State, has_before: bool) -> &'static str {
    match state {
        State::Found if has_before => "the errors that were found",
        State::Found => "the errors that were found, without compensation",
        State::GivenBefore => "the errors of the machine file that was stated as the state before",
        State::Truth => {
            "the errors of the machine file that was stated as the truth, without compensation"
        }
        State::TruthCorrected => "what the compensation by this model leaves of the stated truth",
    }
}

fn states(page: &mut Page, before: State, after: Option<State>) {
    let line = |name: &str, words: &str| format!("<b>{}</b>: {}", escaped(name), escaped(words));
    let mut all = Vec::new();
    if let Some(after) = after {
        all.push(line("before", state_words(before, false)));
        all.push(line("after", state_words(after, true)));
    } else {
        all.push(escaped(state_words(before, false)) + ".");
        all.push("What a compensation leaves is not shown: the model against itself would prove nothing. It needs a truth or a second measurement.".to_owned());
    }
    page.put(&format!("<p class=\"lead\">{}</p>", all.join("<br>")));
}

pub(super) fn diagonals(page: &mut Page, report: &Report) {
    let Some(found) = &report.diagonals else {
        page.paragraph("lead", "Not computed: they need the axes X, Y and Z.");
        return;
    };
    page.paragraph("lead", "Computed from the model: the deviation along each diagonal of the travels, zero at its first target.");
    if let Some(volume) = &report.volume {
        standing(page, volume);
    }
    states(page, found.before.state, found.after.as_ref().map(|after| after.state));
    page.put("<div class=\"maps two\">");
    for panel in diagonal_plots(found) {
        page.figure(&panel.svg, &panel.heading);
    }
    page.put("</div>");
    let after_of = |name: &str| -> Option<&Diagonal> {
        let after = found.after.as_ref()?;
        after.found.iter().find(|diagonal| diagonal.name == name)
    };
    let columns: &[&str] = if found.after.is_some() {
        &["diagonal", ">range before, µm", ">range after, µm"]
    } else {
        &["diagonal", ">range, µm"]
    };
    let rows = found.before.found.iter().map(|diagonal| {
        let mut row = vec![Cell::text(&diagonal.name), Cell::number(diagonal.range_um, 2)];
        if found.after.is_some() {
            row.push(Cell::Number(after_of(&diagonal.name).map(|of| of.range_um), 2));
        }
        row
    });
    page.table(columns, rows);
}

pub(super) fn volume(page: &mut Page, report: &Report) {
    let Some(volume) = &report.volume else {
        page.paragraph("lead", "A map needs two of the axes X, Y and Z.");
        return;
    };
    page.paragraph("lead", "Length of the error of the tool tip after best-fit rigid-body alignment of the workpiece, on planes through the middle of the working space, with the error in the plane as arrows. One colour scale for all maps.");
    states(page, volume.before.state, volume.after.as_ref().map(|after| after.state));
    let columns = [
        "state",
        ">largest, µm",
        "at",
        ">rms, µm",
        ">largest tilt of the tool axis, µrad",
        ">before alignment: largest, µm",
        ">rms, µm",
    ];
    let mut states = vec![("before", &volume.before.found)];
    states.extend(volume.after.iter().map(|after| ("after", &after.found)));
    if volume.after.is_none() {
        states[0].0 = "uncompensated";
    }
    let rows = states.into_iter().map(|(name, size)| {
        vec![
            Cell::Fixed(name.to_owned()),
            Cell::number(size.form_max_um, 2),
            Cell::Fixed(size.place()),
            Cell::number(size.form_rms_um, 2),
            Cell::number(size.tilt_urad, 2),
            Cell::number(size.max_um, 2),
            Cell::number(size.rms_um, 2),
        ]
    });
    page.table(&columns, rows);
    page.paragraph(
        "note",
        &format!("{} poses over the travels of all axes. The workpiece is aligned once for all poses and tools (best-fit rigid body: three shifts and three small rotations by least squares): where it lies is a convention and no error of the machine. Largest values are searched from the worst poses. The last two columns are before alignment.", volume.poses),
    );
    standing(page, volume);
    maps(page, volume);
    vectors(page, volume);
}

/// Lists the axes at fixed coordinates, and the errors that the maps therefore omit.
fn standing(page: &mut Page, volume: &Volume) {
    if volume.standing.is_empty() {
        return;
    }
    let at = volume.standing.iter();
    let at: Vec<String> = at
        .map(|(axis, at)| {
            let unit = if axis.is_rotary() { "°" } else { " mm" };
            format!("{axis} {}{unit}", short(*at, 3))
        })
        .collect();
    page.paragraph(
        "note",
        &format!("Axes that do not move in the pictures over X, Y and Z: {}. The table and the verdict cover poses of all axes; these pictures show this one.", at.join(", ")),
    );
}

/// Writes the maps before, then those after compensation, with a common colour scale.
fn maps(page: &mut Page, volume: &Volume) {
    let Maps { before, after, most_um } = pictures::maps(volume);
    let class = match volume.slices.len() {
        1 => "maps one",
        2 | 4 => "maps two",
        _ => "maps",
    };
    for maps in [before, after].iter().filter(|maps| !maps.is_empty()) {
        page.put(&format!("<div class=\"{class}\">"));
        for map in maps {
            page.put(&heat_map(map));
        }
        page.put("</div>");
    }
    let bar = colour_bar(pictures::COLOURS, most_um);
    page.put(&format!("<div class=\"colours\">{bar}</div>"));
}

/// A slider for the smallest error that is shown, µm. It is hidden until the script runs.
fn level(picture: &Quiver) -> String {
    let lengths = picture.arrows.iter().map(|arrow| {
        let [x, y, z] = arrow.error_um;
        x.hypot(y).hypot(z)
    });
    let longest = lengths.filter(|um| um.is_finite()).fold(0.0, f64::max);
    let step = round_below(longest / 50.0).max(0.01);
    // The longest vector is shown at the last step as well.
    let end = finite(step * (longest / step).floor());
    format!(
        "<label class=\"level\" hidden>Show errors of at least <input type=\"range\" min=\"0\" max=\"{end}\" step=\"{step}\" value=\"0\"> <output></output></label>"
    )
}

fn vectors(page: &mut Page, volume: &Volume) {
    let arrows = volume.vectors.iter().flat_map(|vector| {
        let arrow = |error_um, after| Arrow { at_mm: vector.at_mm, error_um, after };
        let after = vector.after_um.map(|error| arrow(error, true));
        core::iter::once(arrow(vector.before_um, false)).chain(after)
    });
    let picture = Quiver {
        words: "Error vectors".to_owned(),
        travels_mm: volume.travels_mm,
        arrows: arrows.collect(),
        scale_word: "an error of".to_owned(),
    };
    page.put("<div class=\"keep whole\">");
    page.heading(3, "Error vectors", "");
    page.paragraph("note", "Each line begins with a dot at its place and points along the error, enlarged as the rule says.");
    page.paragraph("note screen", "Drag to turn, or use the arrow keys.");
    if volume.after.is_some() {
        page.put("<div class=\"legend\"><span><i class=\"b\"></i>before</span><span><i class=\"f\"></i>after</span></div>");
    }
    page.figure(&quiver(&picture), "");
    page.put(&level(&picture));
    page.put("</div>");
}

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
fn combined(parts: &[(String, f64)]) -> String {
    let largest = parts.iter().map(|(_, weight)| weight.abs()).fold(0.0, f64::max);
    let kept = parts.iter().filter(|(_, weight)| weight.abs() >= LEAST_WEIGHT * largest);
    let mut text = String::new();
    for (name, weight) in kept {
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
