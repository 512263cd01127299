//! A simulated FANUC control on the network, for rehearsals with a gateway or another program.

mod arguments;
mod error;
mod measure;
mod operator;
mod pmc;
mod program;
mod report;
mod truth;

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

use volcomp_focas::simulator::{Motion, Simulator, World};
use volcomp_port::simulated::Path;
use volcomp_vocabulary::AxisName;

use crate::{
    arguments::Arguments,
    error::{SimError, letters, outside},
    measure::{Measurement, Sheet},
    operator::Command,
    program::{Program, Walk},
    report::{AxisLog, Reporter, Steps},
    truth::Truth,
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

/// Starts a thread that runs one measurement for each request. An error ends the program.
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
    let (motion, walk) = motion(arguments, axes)?;
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
    operator::lines(|line| {
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

/// Motion of the machine by the arguments. For a measurement, also the [`Walk`] that determines this motion; otherwise
/// `None`.
pub(crate) fn motion(
    arguments: &Arguments,
    axes: &[AxisName],
) -> Result<(Motion, Option<Arc<Walk>>), SimError> {
    let stands = match &arguments.at {
        None => vec![0.0; axes.len()],
        Some(at) => position(at, axes)?,
    };
    match &arguments.program {
        Some(file) => {
            let program = Program::read(file, axes, &stands)?;
            let acceleration = arguments.acceleration_mm_s2()?;
            if arguments.report.is_none() {
                let path = Path::new(&program.moves, acceleration);
                return Ok((along(axes, path), None));
            }
            let walk = Arc::new(Walk::new(program, acceleration));
            Ok((walk.motion(axes), Some(walk)))
        }
        None if arguments.at.is_some() => Ok((Arc::new(move |_| stands.clone()), None)),
        None => {
            let motion = to_and_fro(arguments.stroke_mm, arguments.period_s, axes.len())?;
            Ok((motion, None))
        }
    }
}

fn position(text: &str, axes: &[AxisName]) -> Result<Vec<f64>, SimError> {
    let mut stands = vec![None; axes.len()];
    for item in text.split(',').filter(|item| !item.trim().is_empty()) {
        let wrong = |expected: String| SimError::input("--at", format!("`{item}`"), expected);
        let form = || wrong("an axis letter, = and a number, such as X=100".to_owned());
        let (name, number) = item.split_once('=').ok_or_else(form)?;
        let name: AxisName = name.trim().parse().map_err(|_| form())?;
        let place = axes.iter().position(|axis| *axis == name);
        let place = place.ok_or_else(|| wrong(format!("an axis of {}", letters(axes))))?;
        let number: f64 = number.trim().parse().map_err(|_| form())?;
        if !number.is_finite() {
            return Err(form());
        }
        if stands[place].replace(number).is_some() {
            return Err(wrong("every axis once".to_owned()));
        }
    }
    Ok(stands.into_iter().map(Option::unwrap_or_default).collect())
}

fn to_and_fro(stroke: f64, period_s: f64, axes: usize) -> Result<Motion, SimError> {
    if !(period_s > 0.0 && period_s.is_finite()) {
        let found = period_s.to_string();
        return Err(SimError::input("--period-s", found, "a positive number"));
    }
    if !stroke.is_finite() {
        let found = stroke.to_string();
        return Err(SimError::input("--stroke-mm", found, "a number"));
    }
    Ok(Arc::new(move |elapsed: Duration| {
        let turn = std::f64::consts::TAU * elapsed.as_secs_f64() / period_s;
        let place = |axis: usize| {
            // Each axis makes a whole number of periods, so that all axes return to 0 at the same time.
            let speed = f64::from(u8::try_from(axis + 1).unwrap_or(u8::MAX));
            0.5 * stroke * (1.0 - (turn * speed).cos())
        };
        (0..axes).map(place).collect()
    }))
}

fn along(axes: &[AxisName], path: Path) -> Motion {
    let axes = axes.to_vec();
    Arc::new(move |elapsed| outside(&axes, &path.at(elapsed)))
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
