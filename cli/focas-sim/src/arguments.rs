//! Command-line options, and their effect on the simulated control.

use std::{path::PathBuf, time::Duration};

use clap::Parser;
use volcomp_focas::simulator::Options;
use volcomp_vocabulary::AxisName;

use crate::{
    error::{SimError, duration},
    measure::Settling,
    pmc::BarrierArguments,
};

const EXAMPLES: &str = "\
Commands on standard input, one per line:
  alarm on|off          set or clear an alarm
  estop on|off          press the emergency stop, which stops the axes, or release it
  unreferenced on|off   make the axes unreferenced, or referenced again
  pause SECONDS         stop answering for this time
  disconnect            cut all connections
  clear                 set all shifts to zero, as after a power cycle
  power                 power-cycle the control: close connections, clear R memory
  reset                 restart the control's program; keep memory and axes
  write R200 BYTE...    write bytes, 0 to 255, to R memory, like a faulty program in the control
  freeze on|off         freeze the reported positions, or report the true ones again
  steps                 print the largest step of each axis in one scan so far
  steps reset           reset these steps
  report                print the present state
  run                   run the program, with --report
  help                  print these commands
  quit                  end the simulator

Examples:
  focas-sim --axes X,Y,Z --at X=100,Y=50 --machine-number 4711
      A control with stationary axes on 127.0.0.1:8193, with the barrier of machine 4711.
  focas-sim --truth examples/table-tilting.toml --program examples/table-tilting-moves.csv
      Five moving axes on a machine with the errors of the machine file. Each second a line shows
      positions (mm, deg) and the tool error without → with the correction, tip (µm) and axis (µrad), before alignment:
      it includes a rigid motion of the work space, which the workpiece zero compensates.
  focas-sim --truth T.toml --program diagonals.csv --report targets.csv --wait
      Waits for the command `run`, runs the program once, and stops at each target until the correction has settled;
      targets.csv gets a row for each. `volcomp diagonals --targets diagonals.csv` writes such a program.";

/// Simulate a FANUC control: moving axes, PMC memory, and machine zero point shifts that move the axes
///
/// The shifts are from R100 on. A barrier in the control reads frames from R200 on, publishes its report from R240 on,
/// and alone writes the shifts; with --no-barrier they are written over the network as they come. At its end the
/// simulator prints the largest step of each axis shift between scans.
///
/// It prints `listening on ADDRESS` when it is ready and runs until SIGINT (Ctrl-C), SIGTERM or the typed command `quit`.
/// Exit status: 0 it was ended, 1 the work failed, 2 the call or a file is wrong.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES)]
#[expect(clippy::struct_excessive_bools, reason = "independent switches")]
pub(crate) struct Arguments {
    /// Address and port; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8193")]
    pub(crate) listen: String,
    /// Axis letters in the control's order [default: the axes of --truth, else X,Y,Z]
    #[arg(long, value_name = "LETTERS", value_delimiter = ',')]
    axes: Vec<AxisName>,
    /// Axis positions, mm and deg: X=100,C=30; others 0
    #[arg(long, value_name = "POSITION", conflicts_with = "stroke_mm")]
    pub(crate) at: Option<String>,
    /// CSV file of moves to repeat: axis letters (mm, deg), optionally feed (mm/min or deg/min; default 2000), dwell_s
    /// and line (see --report)
    #[arg(long, value_name = "FILE", conflicts_with = "stroke_mm")]
    pub(crate) program: Option<PathBuf>,
    /// Acceleration of these moves, mm/s² (rad/s² if only rotary axes move): 1 to 1000000
    #[arg(long, value_name = "MM_PER_S2", default_value_t = 1000.0, requires = "program")]
    acceleration_mm_s2: f64,
    /// Move every axis to and fro by this stroke, mm or deg
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    pub(crate) stroke_mm: f64,
    /// Period of that movement, s
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    pub(crate) period_s: f64,
    /// Machine file with the true errors; lines show the tool error without → with the correction, before alignment, at
    /// the reference temperature
    #[arg(long, value_name = "MACHINE")]
    pub(crate) truth: Option<PathBuf>,
    /// Run the program once and write positions, corrections and tool error at each target to this file: .csv, or .json
    /// for documents, one a line
    #[arg(long, value_name = "FILE", requires = "program", requires = "truth")]
    pub(crate) report: Option<PathBuf>,
    /// Wait at the end of the first move until `run` is typed
    #[arg(long, requires = "report")]
    pub(crate) wait: bool,
    /// Time without change after which a correction has settled, s
    #[arg(long, value_name = "S", default_value_t = 0.2, requires = "report")]
    settle_s: f64,
    /// Settling timeout of a target, s
    #[arg(long, value_name = "S", default_value_t = 10.0, requires = "report")]
    settle_at_most_s: f64,
    /// Interval of the lines of --truth, s; 0 prints none [default: 1 with --truth, else 0]
    #[arg(long, value_name = "S")]
    report_s: Option<f64>,
    /// Print the lines as JSON documents, one per line
    #[arg(long)]
    pub(crate) json: bool,
    /// CSV file with a line for each scan in which a correction changed
    #[arg(long, value_name = "FILE")]
    pub(crate) axis_log: Option<PathBuf>,
    /// Start with an alarm on
    #[arg(long)]
    pub(crate) alarm: bool,
    /// Start with the emergency stop pressed
    #[arg(long)]
    pub(crate) estop: bool,
    /// Start with axes not referenced (bits of F120)
    #[arg(long)]
    pub(crate) unreferenced: bool,
    /// Answer nothing for this time at the end of every --pause-every-s, s
    #[arg(long, value_name = "S")]
    pause_s: Option<f64>,
    /// Interval of these pauses, s
    #[arg(long, value_name = "S", default_value_t = 30.0, requires = "pause_s")]
    pause_every_s: f64,
    /// Answer one point of PMC memory and one axis position per command; refuse more (EW_NUMBER)
    #[arg(long)]
    one_point: bool,
    /// Reject requests that combine commands for the control and for the PMC
    #[arg(long)]
    refuses_mix: bool,
    /// Refuse requests that combine commands
    #[arg(long)]
    one_command: bool,
    /// Version in its answers: 2 (16i), 3 (0i), 4 (31i); also as --version 3
    #[arg(long, value_name = "VERSION", default_value_t = 3, value_parser = clap::value_parser!(u16).range(2..=4))]
    version_of_answers: u16,
    /// Send answers in pieces of this number of bytes; 0: whole
    #[arg(long, value_name = "BYTES", default_value_t = 0)]
    fragment: usize,
    /// Delay of an answer, ms
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    latency_ms: f64,
    /// Time until a written value can be read back, ms
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    readback_ms: f64,
    #[command(flatten)]
    pub(crate) barrier: BarrierArguments,
}

impl Arguments {
    pub(crate) fn read() -> Self {
        let mut arguments: Vec<String> = std::env::args().collect();
        // `--version 3` is the version of the responses; `--version` alone is the program's.
        for i in 1..arguments.len().saturating_sub(1) {
            if arguments[i] == "--version" && arguments[i + 1].parse::<u16>().is_ok() {
                "--version-of-answers".clone_into(&mut arguments[i]);
            }
        }
        Self::parse_from(arguments)
    }

    pub(crate) fn typed_commands() -> &'static str {
        EXAMPLES.split("\n\n").next().unwrap_or(EXAMPLES)
    }

    /// Axes of the control; `default` if none are named.
    pub(crate) fn axes(&self, default: &[AxisName]) -> Result<Vec<AxisName>, SimError> {
        let axes = if self.axes.is_empty() { default.to_vec() } else { self.axes.clone() };
        for (index, name) in axes.iter().enumerate() {
            if axes[..index].contains(name) {
                return Err(SimError::input(
                    "--axes",
                    format!("the axis {name} twice"),
                    "every axis once",
                ));
            }
        }
        Ok(axes)
    }

    pub(crate) fn options(&self) -> Result<Options, SimError> {
        Ok(Options {
            version: self.version_of_answers,
            slots: if self.version_of_answers == 2 { 8 } else { 32 },
            one_point: self.one_point,
            one_axis: self.one_point,
            refuses_mix: self.refuses_mix,
            one_command: self.one_command,
            fragment: self.fragment,
            latency: duration("--latency-ms", self.latency_ms, 1e-3)?,
            ..Options::default()
        })
    }

    pub(crate) fn read_back_delay(&self) -> Result<Duration, SimError> {
        duration("--readback-ms", self.readback_ms, 1e-3)
    }

    pub(crate) fn acceleration_mm_s2(&self) -> Result<f64, SimError> {
        let found = self.acceleration_mm_s2;
        if (1.0..=1e6).contains(&found) {
            Ok(found)
        } else {
            Err(SimError::input("--acceleration-mm-s2", found.to_string(), "1 to 1000000"))
        }
    }

    pub(crate) fn settling(&self, axes: &[AxisName]) -> Result<Settling, SimError> {
        Ok(Settling {
            stands: duration("--settle-s", self.settle_s, 1.0)?,
            at_most: duration("--settle-at-most-s", self.settle_at_most_s, 1.0)?,
            barrier: self.barrier.reports(axes)?,
        })
    }

    /// Interval of the report lines; `None`: no lines.
    pub(crate) fn report_period(&self) -> Result<Option<Duration>, SimError> {
        let default = if self.truth.is_some() { 1.0 } else { 0.0 };
        let period = duration("--report-s", self.report_s.unwrap_or(default), 1.0)?;
        Ok((!period.is_zero()).then_some(period))
    }

    pub(crate) fn pauses(&self) -> Result<Option<(Duration, Duration)>, SimError> {
        let Some(pause_s) = self.pause_s else {
            return Ok(None);
        };
        let pause = duration("--pause-s", pause_s, 1.0)?;
        let every = duration("--pause-every-s", self.pause_every_s, 1.0)?;
        if pause.is_zero() || pause >= every {
            return Err(SimError::input(
                "--pause-s",
                pause_s.to_string(),
                format!("more than 0 and less than --pause-every-s {}", self.pause_every_s),
            ));
        }
        Ok(Some((pause, every)))
    }
}
