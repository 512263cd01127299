//! A rehearsal as a table for a terminal of 80 columns.

use std::fmt::Write;

use volcomp_vocabulary::AxisKind;

use super::judge::unit;
use crate::documents::{RehearsalDocument, RehearsedFault, RehearsedPath};

const LEGEND: &str = "\
No device was opened and nothing was sent: this is a simulated machine.
again: when it compensated again after the fault was taken away.
needs: what a person had to do for that.
change: the largest change of the correction from one scan (without a barrier:
from one write) to the next. furthest: the largest correction.
held: how many scans moved an axis in emergency stop, alarm or unreferenced.
";
const BOUNDED: &str = "\
*: without a barrier nobody can notice this; only the limit bounds the step.
";

const HIDDEN: &str = "\
+: the gateway is not shown that the machine must stand. Without a barrier the
   axes may move then.
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
        "{:<18}{:<6}{:<13}{:>8}  {:<16}{:>4}  verdict",
        "fault", "phase", "state", "again", "needs", "held"
    );
    let _ = writeln!(
        text,
        "    {:<10}{:>12}{:>12}{:>14}{:>12}",
        "axis", "change", "allowed", "furthest", "limit"
    );
    for fault in &path.faults {
        of(text, fault);
    }
    if !path.left_out.is_empty() {
        let _ = writeln!(
            text,
            "left out, since no thermometer is configured: {}",
            path.left_out.join(", ")
        );
    }
}

fn of(text: &mut String, fault: &RehearsedFault) {
    let star = if fault.bounded_by_limit { "*" } else { "" };
    let plus = if fault.interlock_hidden { "+" } else { "" };
    let name = format!("{}{star}{plus}", fault.fault);
    let again = fault
        .compensating_after_s
        .map_or_else(|| "never".to_owned(), |s| format!("{s:.2} s"));
    let needs = match &fault.needed[..] {
        [] => "-".to_owned(),
        needed => needed.join(", "),
    };
    let verdict = if fault.passed { "pass" } else { "FAIL" };
    // Of "compensating" and "ramping" the first four letters.
    let phase: String = fault.phase.chars().take(4).collect();
    let _ = writeln!(
        text,
        "{name:<18}{phase:<6}{:<13}{again:>8}  {needs:<16}{:>4}  {verdict}",
        fault.state, fault.moved_while_held
    );
    for axis in &fault.axes {
        let Some(found) = axis.excursion() else {
            continue;
        };
        let kind = if axis.um.is_some() {
            AxisKind::Linear
        } else {
            AxisKind::Rotary
        };
        let label = format!("{} {}", axis.axis, unit(kind));
        let _ = writeln!(
            text,
            "    {label:<10}{:>12.2}{:>12.2}{:>14.2}{:>12.2}",
            found.largest_change, found.allowed_change, found.furthest, found.limit
        );
    }
    for rule in &fault.broken {
        let _ = writeln!(text, "    broken: {rule}");
    }
}
