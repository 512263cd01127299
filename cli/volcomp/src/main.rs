//! The `volcomp` command: measure, model and remove the volumetric error of machine tools.

mod commands;
mod demo;
mod failure;
mod output;
mod points;
mod progress;

use std::{io::IsTerminal, process::ExitCode};

use clap::{Parser, Subcommand};

use crate::{commands::Answer, failure::Failure};

/// Measure, model and remove the volumetric error of machine tools.
///
/// Positions in mm and deg, errors in um and urad, temperatures in degC.
/// Exit status: 0 done, 1 the work failed, 2 the input or the call is wrong.
#[derive(Parser)]
#[command(version, propagate_version = true)]
struct Arguments {
    /// Print one JSON document on standard output instead of tables
    #[arg(long, global = true)]
    json: bool,
    /// Say on standard error what is read, chosen and written
    #[arg(long, short, global = true)]
    verbose: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Error(commands::error::Arguments),
    Correct(commands::correct::Arguments),
    Diagonals(commands::diagonals::Arguments),
    Map(commands::map::Arguments),
    Fit(commands::fit::Arguments),
    FitThermal(commands::fit_thermal::Arguments),
    Iso230(commands::iso230::Arguments),
    Calibrate(commands::calibrate::Arguments),
    Simulate(commands::simulate::Arguments),
    Demo(commands::demo::Arguments),
    Inspect(commands::inspect::Arguments),
    Probe(commands::probe::Arguments),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
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
        Command::Error(a) => commands::error::run(a),
        Command::Correct(a) => commands::correct::run(a),
        Command::Diagonals(a) => commands::diagonals::run(a),
        Command::Map(a) => commands::map::run(a),
        Command::Fit(a) => commands::fit::run(a),
        Command::FitThermal(a) => commands::fit_thermal::run(a),
        Command::Iso230(a) => commands::iso230::run(a),
        Command::Calibrate(a) => commands::calibrate::run(a),
        Command::Simulate(a) => commands::simulate::run(a),
        Command::Demo(a) => commands::demo::run(a),
        Command::Inspect(a) => commands::inspect::run(a),
        Command::Probe(a) => commands::probe::run(a),
    };
    match answer.and_then(|answer| print(&answer, arguments.json)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            failure.report();
            ExitCode::from(failure.status())
        }
    }
}

fn print(answer: &Answer, json: bool) -> Result<(), Failure> {
    for note in &answer.notes {
        eprintln!("note: {note}");
    }
    let text = if json {
        format!("{}\n", answer.json)
    } else {
        answer.text.clone()
    };
    output::print(&text)
}
