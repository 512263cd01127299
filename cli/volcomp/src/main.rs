//! The `volcomp` command: measure, model and remove the volumetric error of machine tools.
//!
//! Results of `write!` to a `String` are ignored, because they are always `Ok`.

mod arguments;
mod commands;
mod compensation;
mod failure;
mod listing;
mod output;
mod table;

use std::{ffi::OsStr, io::IsTerminal, process::ExitCode};

use anstyle::{AnsiColor, Style};
use clap::{
    CommandFactory, Parser, Subcommand,
    builder::Styles,
    error::{ContextKind, ContextValue},
};

use crate::{commands::Answer, failure::Failure, table::folded};

const STYLES: Styles = Styles::styled()
    .header(Style::new().bold().underline())
    .usage(Style::new().bold().underline())
    .literal(AnsiColor::Cyan.on_default().bold())
    .placeholder(AnsiColor::Cyan.on_default())
    .error(AnsiColor::Red.on_default().bold())
    .valid(AnsiColor::Green.on_default())
    .invalid(AnsiColor::Yellow.on_default());

const NOTE: Style = AnsiColor::Yellow.on_default().bold();

/// Version with commit and date in released programs (see `.github/release`). A packaged crate has no repository from
/// which to read commit and date.
const VERSION: &str = match option_env!("VOLCOMP_VERSION") {
    Some(version) => version,
    None => env!("CARGO_PKG_VERSION"),
};

/// Measure, model and remove the volumetric error of machine tools.
///
/// Positions are in mm and deg, errors in µm and µrad, temperatures in °C.
/// Exit status: 0 done, 1 the work failed, 2 the input or the call is wrong, 3 a stated tolerance is not met or not proven to be met, 130 ended by Ctrl-C.
#[derive(Parser)]
#[command(version = VERSION, propagate_version = true, styles = STYLES, max_term_width = 80)]
#[command(
    after_help = "volcomp COMMAND --help shows what a command reads and writes, with examples."
)]
struct Cli {
    /// Print one JSON document instead of tables; an error is one JSON object on standard error
    #[arg(long, global = true)]
    json: bool,
    /// Log the files read, choices made and files written on standard error
    #[arg(long, short, global = true)]
    verbose: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Check(commands::check::CheckArguments),
    Error(commands::error::ErrorArguments),
    Correct(commands::correct::CorrectArguments),
    Diagonals(commands::diagonals::DiagonalsArguments),
    Map(commands::map::MapArguments),
    MapTable(commands::map_table::MapTableArguments),
    Export(commands::export::ExportArguments),
    Import(commands::import::ImportArguments),
    Axes(commands::axes::AxesArguments),
    Dh(commands::dh::DhArguments),
    Sensitivity(commands::sensitivity::SensitivityArguments),
    Expression(commands::expression::ExpressionArguments),
    Fit(commands::fit::FitArguments),
    FitThermal(commands::fit_thermal::FitThermalArguments),
    Iso230(commands::iso230::Iso230Arguments),
    Straightness(commands::straightness::StraightnessArguments),
    Squareness(commands::squareness::SquarenessArguments),
    Form(commands::form::FormArguments),
    Calibrate(commands::calibrate::CalibrateArguments),
    Studio(commands::studio::StudioArguments),
    Report(commands::report::ReportArguments),
    Identify(commands::identify::IdentifyArguments),
    Simulate(commands::simulate::SimulateArguments),
    Age(commands::age::AgeArguments),
    Demo(commands::demo::DemoArguments),
    Nc(commands::nc::NcArguments),
    Inspect(commands::inspect::InspectArguments),
    Probe(commands::probe::ProbeArguments),
    Compile(commands::compile::CompileArguments),
    Completions(commands::completions::CompletionsArguments),
    #[command(hide = true)]
    Schema(commands::schema::SchemaArguments),
}

fn main() -> ExitCode {
    let arguments = match Cli::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return not_parsed(&without_hidden(error)),
    };
    if arguments.verbose {
        tracing_subscriber::fmt()
            .with_writer(std::io::stderr)
            .with_max_level(tracing::Level::DEBUG)
            .with_ansi(std::io::stderr().is_terminal())
            .with_target(false)
            .without_time()
            .init();
    }
    output::clean_up_when_interrupted();
    let answer = match &arguments.command {
        Command::Check(a) => commands::check::run(a),
        Command::Error(a) => commands::error::run(a, arguments.json),
        Command::Correct(a) => commands::correct::run(a, arguments.json),
        Command::Diagonals(a) => commands::diagonals::run(a),
        Command::Map(a) => commands::map::run(a),
        Command::MapTable(a) => commands::map_table::run(a),
        Command::Export(a) => commands::export::run(a),
        Command::Import(a) => commands::import::run(a),
        Command::Axes(a) => commands::axes::run(a),
        Command::Dh(a) => commands::dh::run(a),
        Command::Sensitivity(a) => commands::sensitivity::run(a),
        Command::Expression(a) => commands::expression::run(a),
        Command::Fit(a) => commands::fit::run(a),
        Command::FitThermal(a) => commands::fit_thermal::run(a),
        Command::Iso230(a) => commands::iso230::run(a),
        Command::Straightness(a) => commands::straightness::run(a),
        Command::Squareness(a) => commands::squareness::run(a),
        Command::Form(a) => commands::form::run(a),
        Command::Calibrate(a) => commands::calibrate::run(a),
        Command::Studio(a) => commands::studio::run(a),
        Command::Report(a) => commands::report::run(a),
        Command::Identify(a) => commands::identify::run(a),
        Command::Simulate(a) => commands::simulate::run(a),
        Command::Age(a) => commands::age::run(a),
        Command::Demo(a) => commands::demo::run(a),
        Command::Nc(a) => commands::nc::run(a),
        Command::Inspect(a) => commands::inspect::run(a),
        Command::Probe(a) => commands::probe::run(a),
        Command::Compile(a) => commands::compile::run(a),
        Command::Completions(a) => commands::completions::run(a, &mut Cli::command()),
        Command::Schema(a) => commands::schema::run(a),
    };
    let answered = answer.and_then(|mut answer| {
        print(&mut answer, arguments.json)?;
        answer.failed.map_or(Ok(answer.tolerances_met), Err)
    });
    match answered {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(3),
        Err(failure) => {
            failure.report(arguments.json);
            ExitCode::from(failure.status())
        }
    }
}

fn without_hidden(mut error: clap::Error) -> clap::Error {
    let alike = match error.get(ContextKind::SuggestedSubcommand) {
        Some(ContextValue::Strings(names)) => names.clone(),
        Some(ContextValue::String(name)) => vec![name.clone()],
        _ => return error,
    };
    let command = Cli::command();
    let shown = alike.into_iter().filter(|name| {
        let found = command.find_subcommand(name);
        !found.is_some_and(clap::Command::is_hide_set)
    });
    let shown: Vec<String> = shown.collect();
    if shown.is_empty() {
        error.remove(ContextKind::SuggestedSubcommand);
    } else {
        let shown = ContextValue::Strings(shown);
        error.insert(ContextKind::SuggestedSubcommand, shown);
    }
    error
}

/// Prints help and version on standard output, and an invalid call on standard error, as JSON if requested.
fn not_parsed(error: &clap::Error) -> ExitCode {
    let json = std::env::args_os().any(|argument| argument == OsStr::new("--json"));
    if !(json && error.use_stderr()) {
        // A failed write to a closed stream cannot be reported.
        let _ = error.print();
        return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
    }
    let text = error.render().to_string();
    let paragraphs = text.trim().split("\n\n");
    let said = paragraphs.filter(|p| !p.starts_with("Usage:") && !p.starts_with("For more"));
    let said = said.collect::<Vec<_>>().join("\n\n");
    let failure = Failure::Call(said.trim_start_matches("error: ").to_owned());
    failure.report(true);
    ExitCode::from(failure.status())
}

fn print(answer: &mut Answer, json: bool) -> Result<(), Failure> {
    for note in &answer.notes {
        let text = folded(&format!("note: {note}"), "");
        let text = text.trim_start_matches("note:");
        anstream::eprint!("{NOTE}note:{NOTE:#}{text}");
    }
    if let Some(listing) = &mut answer.listing {
        return listing.print(&answer.text);
    }
    if json {
        return output::print(&format!("{}\n", answer.json));
    }
    output::print(&answer.text)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn every_option_has_help_for_its_man_page() {
        volcomp_test_support::man_pages::write(super::Cli::command(), "1", "");
    }

    #[test]
    fn options_are_those_of_the_book() {
        volcomp_test_support::options::compare(super::Cli::command());
    }
}
