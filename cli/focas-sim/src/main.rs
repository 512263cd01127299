//! A simulated FANUC control on the wire, for gateways and programs that have no real one at hand.

use std::{io::Write, process::ExitCode, sync::Arc, time::Duration};

use clap::Parser;
use volcomp_focas::simulator::{Options, Simulator, World};

/// A simulated FANUC control: axes that move to and fro, memory, and shifts that show in the positions
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// Address and port; port 0 takes a free one
    #[arg(long, default_value = "127.0.0.1:8193")]
    listen: String,
    /// Letters of the axes
    #[arg(long, value_delimiter = ',', default_value = "X,Y,Z")]
    axes: Vec<char>,
    /// Version in its answers: 2 (16i), 3 (0i), 4 (31i)
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u16).range(2..=4))]
    version_of_answers: u16,
    /// PMC memory is served one point at a time
    #[arg(long)]
    one_point: bool,
    /// Commands for control and PMC in one frame are refused
    #[arg(long)]
    refuses_mix: bool,
    /// Answers come in pieces of so many bytes
    #[arg(long, default_value_t = 0)]
    fragment: usize,
    /// Answers take so many milliseconds
    #[arg(long, default_value_t = 0.0)]
    latency_ms: f64,
    /// What is written is read back only so many milliseconds later
    #[arg(long, default_value_t = 0.0)]
    readback_ms: f64,
    /// How far the axes move to and fro, mm
    #[arg(long, default_value_t = 0.0)]
    stroke_mm: f64,
    /// How long to and fro takes, s
    #[arg(long, default_value_t = 10.0)]
    period_s: f64,
}

fn main() -> ExitCode {
    let mut arguments: Vec<String> = std::env::args().collect();
    // `--version 3` is the version of the answers; `--version` alone is the program's.
    for i in 1..arguments.len().saturating_sub(1) {
        if arguments[i] == "--version" && arguments[i + 1].parse::<u16>().is_ok() {
            "--version-of-answers".clone_into(&mut arguments[i]);
        }
    }
    match run(&Arguments::parse_from(arguments)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::from(2)
        }
    }
}

fn milliseconds(found: f64, what: &str) -> Result<Duration, String> {
    Duration::try_from_secs_f64(found * 1e-3)
        .map_err(|_| format!("{what}: found {found}, expected a number of milliseconds"))
}

fn run(arguments: &Arguments) -> Result<(), String> {
    let count = arguments.axes.len();
    let mut world = World::new(&arguments.axes);
    world.readback_delay = milliseconds(arguments.readback_ms, "--readback-ms")?;
    world.shift.in_positions = true;
    let (stroke_mm, period_s) = (arguments.stroke_mm, arguments.period_s);
    if !(period_s > 0.0 && stroke_mm.is_finite()) {
        return Err(format!(
            "--period-s: found {period_s}, expected a positive number"
        ));
    }
    world.motion = Arc::new(move |elapsed| {
        let turn = std::f64::consts::TAU * elapsed.as_secs_f64() / period_s;
        let place = |axis: usize| {
            // Whole numbers of periods each, so that all are at 0 together.
            let speed = f64::from(u8::try_from(axis + 1).unwrap_or(u8::MAX));
            0.5 * stroke_mm * (1.0 - (turn * speed).cos())
        };
        (0..count).map(place).collect()
    });
    let options = Options {
        version: arguments.version_of_answers,
        slots: if arguments.version_of_answers == 2 {
            8
        } else {
            32
        },
        one_point: arguments.one_point,
        refuses_mix: arguments.refuses_mix,
        fragment: arguments.fragment,
        latency: milliseconds(arguments.latency_ms, "--latency-ms")?,
        ..Options::default()
    };
    let simulator = Simulator::start(&arguments.listen, options, world)
        .map_err(|e| format!("--listen {}: {e}", arguments.listen))?;
    println!("listening on {}", simulator.address());
    // Whoever waits for the line may read it through a pipe.
    std::io::stdout()
        .flush()
        .map_err(|e| format!("standard output: {e}"))?;
    loop {
        std::thread::park();
    }
}
