//! A rehearsal as a table that fits a terminal of 60 columns.

use std::fmt::Write;

use volcomp_vocabulary::{AxisKind, AxisName};

use super::judge::unit;
use crate::documents::{Excursion, RehearsalDocument, RehearsedFault, RehearsedPath};

const COLUMNS: usize = 60;

const LEGEND: &str = "\
No device was opened and nothing was sent: a simulated
machine took the place of the configured devices. Each fault
begins once while compensating, once in the middle of the
ramp.
state     the worst state until it compensated again
again     how long after the fault that was
held      how many scans (without a barrier: writes) moved
          an axis in emergency stop, alarm or unreferenced
change    the largest change of the correction from one scan
          (without a barrier: from one write) to the next
furthest  the largest correction
";
const BOUNDED: &str = "\
*         without a barrier nobody can notice this; only the
          limit bounds the step
";
const HIDDEN: &str = "\
+         the gateway is not shown that the machine must
          stand; without a barrier the axes may move then
";

/// The table of a rehearsal.
pub fn text(document: &RehearsalDocument) -> String {
    let mut text = String::new();
    let mut line = |label: &str, value: &str| {
        // Writing to a string never fails.
        let _ = writeln!(text, "{label:<14}{value}");
    };
    line("machine", &document.machine);
    let start: String = document.hash.chars().take(23).collect();
    line("checksum", &format!("{start}…"));
    line("configuration", &document.config);
    line("cycle", &format!("{} ms", document.cycle_ms));
    line("seed", &document.seed.to_string());
    line("simulated", &format!("{:.0} s", document.simulated_s));
    text.push('\n');
    text.push_str(LEGEND);
    let faults = || document.controllers.iter().flat_map(|path| &path.faults);
    if faults().any(|fault| fault.bounded_by_limit) {
        text.push_str(BOUNDED);
    }
    if faults().any(|fault| fault.interlock_hidden) {
        text.push_str(HIDDEN);
    }
    for path in &document.controllers {
        controller(&mut text, path);
    }
    text.push_str("\nNot rehearsed:\n");
    for what in &document.not_rehearsed {
        wrapped(&mut text, "- ", what);
    }
    let count = faults().count();
    let broken = faults().filter(|fault| !fault.passed).count();
    let _ = match broken {
        0 => writeln!(text, "\npassed: {count} of {count} broke no rule"),
        _ => writeln!(text, "\nfailed: {broken} of {count} broke a rule"),
    };
    text
}

fn controller(text: &mut String, path: &RehearsedPath) {
    let scheme = match path.scheme.as_str() {
        "barrier" => "with the reference barrier in its control",
        "plain" => "plain values that can be read back, no barrier",
        _ => "plain values that cannot be read back, no barrier",
    };
    let _ = writeln!(text, "\n{}\n  simulated: {scheme}", path.url);
    let _ = writeln!(
        text,
        "\n  {:<14}{:<14}{:>9}{:>6}  verdict",
        "while", "state", "again", "held"
    );
    let _ = writeln!(
        text,
        "    {:<8}{:>9}{:>9}{:>10}{:>10}",
        "axis", "change", "allowed", "furthest", "limit"
    );
    for phases in path.faults.chunk_by(|a, b| a.fault == b.fault) {
        fault(text, phases);
    }
    if !path.left_out.is_empty() {
        let names = path.left_out.join(", ");
        wrapped(
            text,
            "",
            &format!("left out, since no thermometer is configured: {names}"),
        );
    }
}

/// One fault: how it went in each phase, and the larger ones of what the axes did.
fn fault(text: &mut String, phases: &[RehearsedFault]) {
    let Some(first) = phases.first() else {
        return;
    };
    let star = if first.bounded_by_limit { "*" } else { "" };
    let plus = if first.interlock_hidden { "+" } else { "" };
    let title = format!("{}{star}{plus}: {}", first.fault, first.meaning);
    wrapped(text, "", &title);
    for phase in phases {
        let again = phase
            .compensating_after_s
            .map_or_else(|| "never".to_owned(), |s| format!("{s:.2} s"));
        let verdict = if phase.passed { "pass" } else { "FAIL" };
        let _ = writeln!(
            text,
            "  {:<14}{:<14}{again:>9}{:>6}  {verdict}",
            phase.phase, phase.state, phase.moved_while_held
        );
        if !phase.needed.is_empty() {
            let _ = writeln!(text, "    by hand: {}", phase.needed.join(", "));
        }
        for rule in &phase.broken {
            wrapped(text, "    broken: ", rule);
        }
    }
    for (place, axis) in first.axes.iter().enumerate() {
        let found = phases.iter().filter_map(|phase| {
            let axis = phase.axes.get(place)?;
            axis.excursion().copied()
        });
        let kind = if axis.um.is_some() {
            AxisKind::Linear
        } else {
            AxisKind::Rotary
        };
        if let Some(found) = found.reduce(larger) {
            row(text, axis.axis, kind, &found);
        }
    }
}

fn row(text: &mut String, axis: AxisName, kind: AxisKind, found: &Excursion) {
    let label = format!("{axis} {}", unit(kind));
    let _ = writeln!(
        text,
        "    {label:<8}{:>9.2}{:>9.2}{:>10.2}{:>10.2}",
        found.largest_change, found.allowed_change, found.furthest, found.limit
    );
}

fn larger(a: Excursion, b: Excursion) -> Excursion {
    Excursion {
        largest_change: a.largest_change.max(b.largest_change),
        furthest: a.furthest.max(b.furthest),
        ..a
    }
}

/// Words behind a head, lines of 60 columns at the most; further lines begin below the first word.
fn wrapped(text: &mut String, head: &str, words: &str) {
    let indent = head.chars().count();
    let mut column = indent;
    text.push_str(head);
    for (index, word) in words.split(' ').enumerate() {
        let length = word.chars().count();
        if index > 0 && column + 1 + length > COLUMNS {
            text.push('\n');
            text.extend(std::iter::repeat_n(' ', indent));
            column = indent;
        } else if index > 0 {
            text.push(' ');
            column += 1;
        }
        text.push_str(word);
        column += length;
    }
    text.push('\n');
}
