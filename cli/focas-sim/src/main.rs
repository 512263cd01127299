//! A simulated FANUC control on the network, for rehearsals with a gateway or another program.

mod arguments;
mod axis_log;
mod barrier;
mod error;
mod map;
mod measure;
mod motion;
mod operator;
mod program;
mod quantities;
mod report;
mod standard_input;
mod targets;
mod truth;
mod walk;

use std::{
    io::Write,
    process::ExitCode,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    },
    thread,
    time::{Duration, Instant},
};

use volcomp_focas::simulator::{Simulator, World};
use volcomp_vocabulary::AxisName;

use crate::{
    arguments::Arguments,
    axis_log::AxisLog,
    error::SimError,
    measure::Measurement,
    operator::Command,
    report::{Reporter, Steps},
    targets::Sheet,
    truth::Truth,
    walk::Walk,
};

const POLL_INTERVAL: Duration = Duration::from_millis(50);

fn main() -> ExitCode {
    match run(&Arguments::read()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.status())
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), SimError> {
    let truth = arguments.truth.as_deref().map(Truth::read).transpose()?;
    let default = match &truth {
        Some(truth) => truth.axes(),
        None => vec![AxisName::X, AxisName::Y, AxisName::Z],
    };
    let axes = arguments.axes(&default)?;
    if let Some(truth) = &truth {
        truth.check(&axes)?;
    }
    let truth = truth.map(Arc::new);
    let (mut world, walk) = world(arguments, &axes)?;
    let measurement = measurement(arguments, &axes, walk, truth.clone())?;
    let mut axis_log = None;
    if let Some(path) = &arguments.axis_log {
        let (log, writer) = AxisLog::create(path, &axes)?;
        world.scan_log = Some(log);
        axis_log = Some(writer);
    }
    let options = arguments.options()?;
    let (period, pauses) = (arguments.report_period()?, arguments.pauses()?);
    // Set the handler before printing that the simulator is ready: a program that reads this line may end the simulator
    // immediately.
    let (end, ended) = channel();
    let interrupted = end.clone();
    ctrlc::set_handler(move || {
        // The receiver is already dropped if the program is ending.
        let _ = interrupted.send(Ok(()));
    })
    .map_err(|e| SimError::System { what: "signals", source: std::io::Error::other(e) })?;
    let simulator = Simulator::start(&arguments.listen, options, world)
        .map_err(|source| SimError::Listen { address: arguments.listen.clone(), source })?;
    let simulator = Arc::new(simulator);
    print(&format!("listening on {}", simulator.address()));

    let (now, report_requests) = channel();
    let (run, run_requests) = channel();
    if let Some(measurement) = measurement {
        if !arguments.wait {
            // The receiver exists, so this cannot fail.
            let _ = run.send(());
        }
        measure(measurement, &simulator, run_requests, end.clone())?;
    }
    start("focas-sim typed", {
        let receivers = CommandReceivers { now: now.clone(), run: run.clone(), end };
        let simulator = Arc::clone(&simulator);
        let (axes, json) = (axes.clone(), arguments.json);
        move || {
            typed(&simulator, &receivers, || {
                print_steps(&axes, &simulator, json);
            });
        }
    })?;
    start("focas-sim report", {
        let simulator = Arc::clone(&simulator);
        let reporter = Reporter::new(axes.clone(), truth);
        let json = arguments.json;
        move || report(&simulator, reporter, period, &report_requests, json)
    })?;
    if let Some((pause, every)) = pauses {
        let simulator = Arc::clone(&simulator);
        start("focas-sim pause", move || {
            loop {
                thread::sleep(every.saturating_sub(pause));
                simulator.world().pause(pause);
                thread::sleep(pause);
            }
        })?;
    }
    // Keep the senders after the end of standard input, because the report ends when all senders are dropped.
    let _asks = (now, run);
    // An error means that every sender was dropped. The program then ends as well.
    let ended = ended.recv().unwrap_or(Ok(()));
    print_steps(&axes, &simulator, arguments.json);
    simulator.world().scan_log = None;
    ended.and(axis_log.map_or(Ok(()), AxisLog::end))
}

fn measurement(
    arguments: &Arguments,
    axes: &[AxisName],
    walk: Option<Arc<Walk>>,
    truth: Option<Arc<Truth>>,
) -> Result<Option<Measurement>, SimError> {
    let (Some(file), Some(walk)) = (&arguments.report, walk) else {
        return Ok(None);
    };
    Ok(Some(Measurement {
        walk,
        settling: arguments.settling(axes)?,
        reporter: Reporter::new(axes.to_vec(), truth),
        sheet: Sheet::create(file, axes)?,
        json: arguments.json,
    }))
}

/// Starts a thread that measures on every request. An error ends the program.
fn measure(
    measurement: Measurement,
    simulator: &Arc<Simulator>,
    run_requests: Receiver<()>,
    end: Sender<Result<(), SimError>>,
) -> Result<(), SimError> {
    let simulator = Arc::clone(simulator);
    start("focas-sim measure", move || {
        if let Err(error) = measurement.run(&simulator, &run_requests) {
            // The receiver is already dropped if the program is ending.
            let _ = end.send(Err(error));
        }
    })
}

struct CommandReceivers {
    now: Sender<()>,
    run: Sender<()>,
    end: Sender<Result<(), SimError>>,
}

fn print_steps(axes: &[AxisName], simulator: &Simulator, json: bool) {
    let steps = Steps::of(axes, simulator);
    print(&if json { report::json(&steps) } else { steps.text() });
}

/// Prints a line to standard output; a broken pipe is ignored.
fn print(line: &str) {
    let mut output = std::io::stdout();
    let _ = writeln!(output, "{line}").and_then(|()| output.flush());
}

fn world(arguments: &Arguments, axes: &[AxisName]) -> Result<(World, Option<Arc<Walk>>), SimError> {
    let letters: Vec<char> = axes.iter().map(|axis| axis.letter()).collect();
    let mut world = World::new(&letters);
    world.readback_delay = arguments.read_back_delay()?;
    world.shift.in_positions = true;
    let (motion, walk) = motion::motion(arguments, axes)?;
    world.motion = motion;
    world.scan = arguments.barrier.scan()?;
    world.ladder = arguments.barrier.ladder(axes)?;
    Command::Alarm(arguments.alarm).change(&mut world);
    Command::EmergencyStop(arguments.estop).change(&mut world);
    Command::Unreferenced(arguments.unreferenced).change(&mut world);
    Ok((world, walk))
}

fn start(name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), SimError> {
    let started = thread::Builder::new().name(name.to_owned()).spawn(work);
    started.map(drop).map_err(SimError::thread)
}

/// Executes typed commands. `steps` prints the largest steps.
fn typed(simulator: &Simulator, receivers: &CommandReceivers, steps: impl Fn()) {
    standard_input::lines(|line| {
        match line.parse::<Command>() {
            Err(message) => eprintln!("error: {message}"),
            Ok(Command::Help) => eprintln!("{}", Arguments::typed_commands()),
            Ok(Command::Report) => {
                // The receiver exists until the program ends.
                let _ = receivers.now.send(());
            }
            Ok(Command::Run) => {
                if receivers.run.send(()).is_err() {
                    eprintln!("error: found `run`, expected it with --report only");
                }
            }
            Ok(Command::Steps) => steps(),
            Ok(Command::Quit) => {
                let _ = receivers.end.send(Ok(()));
                return false;
            }
            Ok(command) => command.act(simulator),
        }
        true
    });
}

/// Prints a report line every `period` and on every request, until all senders are dropped.
fn report(
    simulator: &Simulator,
    mut reporter: Reporter,
    period: Option<Duration>,
    report_requests: &Receiver<()>,
    json: bool,
) {
    let mut due = period.map(|period| Instant::now() + period);
    loop {
        let is_requested = match report_requests.recv_timeout(POLL_INTERVAL) {
            Ok(()) => true,
            Err(RecvTimeoutError::Timeout) => false,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        reporter.watch(simulator);
        let is_due = due.is_some_and(|due| Instant::now() >= due);
        if !is_requested && !is_due {
            continue;
        }
        if let (true, Some(period)) = (is_due, period) {
            due = Some(Instant::now() + period);
        }
        let report = reporter.report(simulator);
        print(&if json { report::json(&report) } else { report.text() });
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn every_option_has_help_for_its_man_page() {
        volcomp_test_support::man_pages::write(super::Arguments::command(), "1", "");
    }

    #[test]
    fn options_are_those_of_the_book() {
        volcomp_test_support::options::compare(super::Arguments::command());
    }
}
