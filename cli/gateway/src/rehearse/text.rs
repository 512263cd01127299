//! Formats a rehearsal as a report for a terminal of 40 to 60 columns.

use std::fmt::Write;

use volcomp_vocabulary::{AxisKind, AxisName};

use super::judge::unit;
use crate::documents::{
    Excursion, RehearsalDocument, RehearsedFault, RehearsedLimits, RehearsedPath,
};

/// Maximum line length of a filed report, columns.
pub const COLUMNS: usize = 60;
/// Minimum line width, columns.
const NARROWEST: usize = 40;

const PREAMBLE: &str = "No device was opened and nothing was sent: a simulated machine took the place of the configured \
devices. Each fault begins once while compensating, once in the middle of the ramp.";
const LEGEND: [(&str, &str); 5] = [
    ("state", "the worst state until it compensated again"),
    ("again", "how long after the end of the fault that was; -: before its end"),
    (
        "held",
        "how many scans (without a barrier: writes) moved an axis in emergency stop, alarm or unreferenced",
    ),
    (
        "change",
        "the largest change of the correction from one scan (without a barrier: from one write) to the next",
    ),
    ("furthest", "the largest correction"),
];
const BOUNDED: (&str, &str) =
    ("*", "without a barrier this cannot be detected; only the limit bounds the step");
const HIDDEN: (&str, &str) = (
    "+",
    "the gateway is not shown that the machine must stand; without a barrier the axes may move then",
);

struct Page {
    text: String,
    columns: usize,
}

/// Formats the rehearsal report; `columns` is clamped to 40 to 60.
pub fn text(document: &RehearsalDocument, columns: usize) -> String {
    let mut page = Page { text: String::new(), columns: columns.clamp(NARROWEST, COLUMNS) };
    page.head(document);
    page.wrapped("\n", PREAMBLE);
    let faults = || document.controllers.iter().flat_map(|path| &path.faults);
    let bounded = faults().any(|fault| fault.bounded_by_limit);
    let hidden = faults().any(|fault| fault.interlock_hidden);
    let marks = [bounded.then_some(BOUNDED), hidden.then_some(HIDDEN)];
    for (label, meaning) in LEGEND.into_iter().chain(marks.into_iter().flatten()) {
        page.wrapped(&format!("{label:<10}"), meaning);
    }
    for path in &document.controllers {
        page.controller(path);
    }
    page.wrapped("\n", "Not rehearsed:");
    for what in &document.not_rehearsed {
        page.wrapped("- ", what);
    }
    let count = faults().count();
    let broken = faults().filter(|fault| !fault.passed).count();
    let verdict = match broken {
        0 => format!("passed: {count} of {count} broke no rule"),
        _ => format!("failed: {broken} of {count} broke a rule"),
    };
    let selection = match document.selection.len() {
        0 => String::new(),
        some => format!(" (a selection: {some} of {} faults)", document.catalogue),
    };
    page.wrapped("\n", &(verdict + &selection));
    page.text
}

impl Page {
    fn is_narrow(&self) -> bool {
        self.columns < COLUMNS
    }

    fn head(&mut self, document: &RehearsalDocument) {
        let start = |hash: &str| hash.chars().take(23).collect::<String>() + "…";
        // Omit the fraction of a second.
        let time = document.time.get(..19).unwrap_or(&document.time);
        let faults = match document.selection.len() {
            0 => format!("all {}", document.catalogue),
            some => format!("a selection: {some} of {}", document.catalogue),
        };
        for (label, value) in [
            ("rehearsed", format!("{} UTC", time.replace('T', " "))),
            ("by", format!("{} on {}", document.user, document.host)),
            ("program", format!("volcomp-gateway {}", document.version)),
            ("machine", document.machine.clone()),
            ("checksum", start(&document.hash)),
            ("configuration", document.config.clone()),
            ("checksum", start(&document.config_hash)),
            ("cycle", format!("{} ms", document.cycle_ms)),
            ("faults", faults),
            ("seed", document.seed.to_string()),
            ("simulated", format!("{:.0} s", document.simulated_s)),
        ] {
            self.wrapped(&format!("{label:<14}"), &value);
        }
    }

    fn controller(&mut self, path: &RehearsedPath) {
        let scheme = match path.scheme.as_str() {
            "barrier" => "with the reference barrier in its control",
            "plain" => "plain values that can be read back, no barrier",
            _ => "plain values that cannot be read back, no barrier",
        };
        self.wrapped("\n", &path.url);
        self.wrapped("  ", &format!("simulated: {scheme}"));
        self.wrapped(
            "  ",
            &format!(
                "positions: held when {} ms old, zeroed when {} ms old; ramp {} s",
                path.hold_ms, path.zero_after_ms, path.ramp_s
            ),
        );
        if let Some(barrier) = &path.barrier {
            self.wrapped(
                "  ",
                &format!(
                    "barrier: machine {}, scan {} ms, hold {} ms, time-out {} ms",
                    barrier.machine, barrier.scan_ms, barrier.hold_ms, barrier.time_out_ms
                ),
            );
        }
        for limits in &path.limits {
            self.limits(limits);
        }
        if self.is_narrow() {
            self.text.push('\n');
        } else {
            self.line(format_args!(
                "\n  {:<14}{:<14}{:>9}{:>6}  verdict",
                "while", "state", "again", "held"
            ));
        }
        self.columns_of("axis", ["change", "allowed", "furthest", "limit"]);
        for phases in path.faults.chunk_by(|a, b| a.fault == b.fault) {
            self.fault(phases);
        }
        if !path.left_out.is_empty() {
            let names = path.left_out.join(", ");
            let why = "left out, since no thermometer is configured";
            self.wrapped("", &format!("{why}: {names}"));
        }
    }

    fn limits(&mut self, limits: &RehearsedLimits) {
        let (bounds, unit) = match (&limits.um, &limits.urad) {
            (Some(bounds), _) => (bounds, unit(AxisKind::Linear)),
            (None, Some(bounds)) => (bounds, unit(AxisKind::Rotary)),
            (None, None) => return,
        };
        let mut words =
            format!("limit {} {unit}, slew {} {unit}/s", bounds.limit, bounds.slew_per_s);
        // Writing to a string never fails.
        if let Some(accel) = bounds.accel_per_s2 {
            let _ = write!(words, ", {accel} {unit}/s²");
        }
        let _ = write!(words, ", step {} {unit}", bounds.step);
        if let Some(rate) = bounds.barrier_per_s {
            let _ = write!(words, ", barrier {rate} {unit}/s");
        }
        self.wrapped(&format!("  {}: ", limits.axis), &words);
    }

    fn fault(&mut self, phases: &[RehearsedFault]) {
        let Some(first) = phases.first() else {
            return;
        };
        let star = if first.bounded_by_limit { "*" } else { "" };
        let plus = if first.interlock_hidden { "+" } else { "" };
        let title = format!("{}{star}{plus}: {}", first.fault, first.meaning);
        self.wrapped("", &title);
        for phase in phases {
            self.phase(phase);
        }
        for (place, axis) in first.axes.iter().enumerate() {
            let found = phases.iter().filter_map(|phase| {
                let axis = phase.axes.get(place)?;
                axis.excursion().copied()
            });
            let kind = if axis.um.is_some() { AxisKind::Linear } else { AxisKind::Rotary };
            if let Some(found) = found.reduce(larger) {
                self.row(axis.axis, kind, &found);
            }
        }
    }

    fn phase(&mut self, phase: &RehearsedFault) {
        let again = match phase.compensating_after_s {
            None => "never".to_owned(),
            Some(s) if s <= 0.0 => "-".to_owned(),
            Some(s) => format!("{s:.2} s"),
        };
        let verdict = if phase.passed { "pass" } else { "FAIL" };
        let (name, state, held) = (&phase.phase, &phase.state, phase.moved_while_held);
        if self.is_narrow() {
            let words = format!("{name}: {state}, again {again}, held {held}, {verdict}");
            self.wrapped("  ", &words);
        } else {
            self.line(format_args!("  {name:<14}{state:<14}{again:>9}{held:>6}  {verdict}"));
        }
        if !phase.needed.is_empty() {
            self.wrapped("    by hand: ", &phase.needed.join(", "));
        }
        for rule in &phase.broken {
            self.wrapped("    broken: ", rule);
        }
    }

    fn row(&mut self, axis: AxisName, kind: AxisKind, found: &Excursion) {
        let numbers = [found.largest_change, found.allowed_change, found.furthest, found.limit];
        let label = format!("{axis} {}", unit(kind));
        self.columns_of(&label, numbers.map(|number| format!("{number:.2}")));
    }

    fn columns_of(&mut self, label: &str, [a, b, c, d]: [impl AsRef<str>; 4]) {
        let [a, b, c, d] = [a.as_ref(), b.as_ref(), c.as_ref(), d.as_ref()];
        if self.is_narrow() {
            self.line(format_args!(" {label:<6}{a:>8}{b:>8}{c:>9}{d:>8}"));
        } else {
            self.line(format_args!("    {label:<8}{a:>9}{b:>9}{c:>10}{d:>10}"));
        }
    }

    fn line(&mut self, line: std::fmt::Arguments<'_>) {
        // Writing to a string never fails.
        let _ = writeln!(self.text, "{line}");
    }

    /// Appends wrapped words after a head. Continuation lines are aligned with the first word.
    fn wrapped(&mut self, head: &str, words: &str) {
        let indent = head.trim_start_matches('\n').chars().count();
        let mut column = indent;
        self.text.push_str(head);
        for (index, word) in words.split(' ').enumerate() {
            let length = word.chars().count();
            if index > 0 && column + 1 + length > self.columns {
                self.text.push('\n');
                self.text.extend(std::iter::repeat_n(' ', indent));
                column = indent;
            } else if index > 0 {
                self.text.push(' ');
                column += 1;
            }
            self.text.push_str(word);
            column += length;
        }
        self.text.push('\n');
    }
}

fn larger(a: Excursion, b: Excursion) -> Excursion {
    Excursion {
        largest_change: a.largest_change.max(b.largest_change),
        furthest: a.furthest.max(b.furthest),
        ..a
    }
}
