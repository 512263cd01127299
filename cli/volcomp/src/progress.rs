//! Progress bars, drawn on standard error if it is a terminal.

use std::{fmt::Write, time::Duration};

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};

pub(crate) fn bar(count: usize, what: &str) -> ProgressBar {
    let bar = ProgressBar::new(count as u64);
    let template = format!("{{bar:30}} {{pos}}/{{len}} {what} {{left}}");
    styled(bar, &template)
}

/// Runs an operation with a progress bar. The operation reports the number of finished steps and of all steps.
pub(crate) fn with_bar<T, E>(
    what: &str,
    work: impl FnOnce(&mut dyn FnMut(usize, usize)) -> Result<T, E>,
) -> Result<T, E> {
    let bar = bar(0, what);
    let done = work(&mut |done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    done
}

pub(crate) fn byte_bar(bytes: u64) -> ProgressBar {
    let bar = ProgressBar::new(bytes);
    styled(bar, "{bar:30} {bytes}/{total_bytes} {left}")
}

fn styled(bar: ProgressBar, template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template);
    let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style.with_key("left", |state: &ProgressState, out: &mut dyn Write| {
        // A failure to draw the bar cannot be reported.
        let _ = out.write_str(&left(state.pos(), state.eta()));
    }))
}

/// The remaining time as text; empty before the first step is finished.
fn left(done: u64, eta: Duration) -> String {
    match done {
        0 => String::new(),
        _ => format!("{:#} left", HumanDuration(eta)),
    }
}
