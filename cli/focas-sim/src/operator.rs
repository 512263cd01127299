//! Commands of the operator from standard input.

use std::{
    io::{BufRead, BufReader, IsTerminal, Read},
    str::FromStr,
    time::Duration,
};

use rustix::{process::getpgrp, termios::tcgetpgrp};
use volcomp_focas::{
    PmcArea,
    simulator::{Simulator, World},
};

const ALARM: (i32, &str) = (1000, "SIMULATED ALARM");

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Command {
    Alarm(bool),
    EmergencyStop(bool),
    Unreferenced(bool),
    Pause(Duration),
    Disconnect,
    Clear,
    Power,
    Reset,
    /// Bytes to write into R memory from an offset on.
    Write(usize, Vec<u8>),
    Freeze(bool),
    Steps,
    ResetSteps,
    Report,
    Run,
    Help,
    Quit,
}

const FORMS: [(&str, &str); 14] = [
    ("alarm", "alarm on or alarm off"),
    ("estop", "estop on or estop off"),
    ("unreferenced", "unreferenced on or unreferenced off"),
    ("pause", "pause and a number of seconds, such as pause 0.5"),
    ("freeze", "freeze on or freeze off"),
    ("write", "write, a place and bytes, such as write R200 0 255"),
    ("steps", "steps or steps reset"),
    ("disconnect", "disconnect alone"),
    ("clear", "clear alone"),
    ("power", "power alone"),
    ("reset", "reset alone"),
    ("report", "report alone"),
    ("run", "run alone"),
    ("quit", "quit alone"),
];

const ANY_FORM: &str = "one of alarm, estop, unreferenced, pause, disconnect, clear, power, reset, write, freeze, steps, report, run, help, quit";

impl FromStr for Command {
    type Err = String;

    fn from_str(line: &str) -> Result<Self, String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let switch = |word: &str| match word {
            "on" => Ok(true),
            "off" => Ok(false),
            other => Err(format!("found `{other}`, expected on or off")),
        };
        match words[..] {
            ["alarm", word] => Ok(Self::Alarm(switch(word)?)),
            ["estop", word] => Ok(Self::EmergencyStop(switch(word)?)),
            ["unreferenced", word] => Ok(Self::Unreferenced(switch(word)?)),
            ["pause", seconds] => seconds
                .parse()
                .ok()
                .and_then(|seconds| Duration::try_from_secs_f64(seconds).ok())
                .map(Self::Pause)
                .ok_or_else(|| format!("found `{seconds}`, expected a number of seconds")),
            ["disconnect"] => Ok(Self::Disconnect),
            ["clear"] => Ok(Self::Clear),
            ["power"] => Ok(Self::Power),
            ["reset"] => Ok(Self::Reset),
            ["write", place, ref bytes @ ..] if !bytes.is_empty() => write(place, bytes),
            ["freeze", word] => Ok(Self::Freeze(switch(word)?)),
            ["steps"] => Ok(Self::Steps),
            ["steps", "reset"] => Ok(Self::ResetSteps),
            ["report"] => Ok(Self::Report),
            ["run"] => Ok(Self::Run),
            ["help"] => Ok(Self::Help),
            ["quit"] => Ok(Self::Quit),
            _ => {
                let mut forms = FORMS.iter();
                let form = forms.find(|(name, _)| words.first() == Some(name));
                let expected = form.map_or(ANY_FORM, |(_, form)| form);
                Err(format!("found `{}`, expected {expected}", line.trim()))
            }
        }
    }
}

/// Parses bytes for R memory: `R200` and decimal numbers.
fn write(place: &str, bytes: &[&str]) -> Result<Command, String> {
    let at = place.strip_prefix('R').and_then(|at| at.parse().ok());
    let at = at.ok_or_else(|| format!("found `{place}`, expected a place such as R200"))?;
    let byte = |text: &&str| {
        text.parse().map_err(|_| format!("found `{text}`, expected a byte, 0 to 255"))
    };
    let bytes = bytes.iter().map(byte).collect::<Result<_, _>>()?;
    Ok(Command::Write(at, bytes))
}

impl Command {
    /// Executes commands that change the simulated control. Other commands have no effect here.
    pub(crate) fn act(self, simulator: &Simulator) {
        match self {
            Self::Disconnect => simulator.disconnect_all(),
            Self::Power => simulator.power_up(),
            Self::Steps | Self::Report | Self::Run | Self::Help | Self::Quit => {}
            other => other.change(&mut simulator.world()),
        }
    }

    pub(crate) fn change(self, world: &mut World) {
        match self {
            Self::Alarm(on) => {
                let alarm = on.then(|| (ALARM.0, ALARM.1.to_owned()));
                world.alarms = alarm.into_iter().collect();
            }
            Self::EmergencyStop(on) => world.set_emergency_stop(on),
            Self::Unreferenced(on) => world.set_referenced(!on),
            Self::Pause(time) => world.pause(time),
            Self::Clear => world.clear_shifts(),
            Self::Freeze(on) => world.freeze_positions(on),
            Self::ResetSteps => world.reset_largest_steps(),
            Self::Reset => world.reset(),
            Self::Write(at, bytes) => world.set(PmcArea::R, at, &bytes),
            Self::Power => world.power_up(),
            Self::Disconnect | Self::Steps | Self::Report | Self::Run | Self::Help | Self::Quit => {
            }
        }
    }
}

/// Interval at which a background program checks whether it is in the foreground.
const POLL_INTERVAL: Duration = Duration::from_millis(300);
/// Maximum length of a line, bytes; longer lines are split.
const LONGEST: u64 = 1 << 16;

/// Calls `line` with every line until the input ends or `line` returns `false`.
///
/// The kernel stops a background program that reads from its terminal, so this function waits until the program is in
/// the foreground.
pub(crate) fn lines(mut line: impl FnMut(&str) -> bool) {
    let stdin = std::io::stdin();
    let is_terminal = stdin.is_terminal();
    let mut reader = BufReader::new(stdin.lock());
    let mut text = String::new();
    loop {
        while is_terminal && !in_foreground() {
            std::thread::sleep(POLL_INTERVAL);
        }
        if is_terminal && !readable() {
            continue;
        }
        text.clear();
        match reader.by_ref().take(LONGEST).read_line(&mut text) {
            Ok(count) if count > 0 => {
                if !text.trim().is_empty() && !line(&text) {
                    return;
                }
            }
            // End of input, or invalid UTF-8.
            _ => return,
        }
    }
}

fn in_foreground() -> bool {
    tcgetpgrp(rustix::stdio::stdin()).is_ok_and(|group| group == getpgrp())
}

/// Waits at most 300 ms for input, so that the caller checks regularly whether the program is in the foreground.
fn readable() -> bool {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let stdin = rustix::stdio::stdin();
    let time = Timespec { tv_sec: 0, tv_nsec: 300_000_000 };
    let mut events = [PollFd::new(&stdin, PollFlags::IN)];
    poll(&mut events, Some(&time)).is_ok_and(|ready| ready > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_understood_or_refused_in_words() {
        let parsed = |line: &str| line.parse::<Command>();
        assert_eq!(parsed(" alarm  on "), Ok(Command::Alarm(true)));
        assert_eq!(parsed("estop off"), Ok(Command::EmergencyStop(false)));
        let pause = Command::Pause(Duration::from_millis(1500));
        assert_eq!(parsed("pause 1.5"), Ok(pause));
        assert_eq!(parsed("steps reset"), Ok(Command::ResetSteps));
        assert_eq!(parsed("write R200 0 255"), Ok(Command::Write(200, vec![0, 255])));
        for (line, expected) in [
            (
                "write R200",
                "found `write R200`, expected write, a place and bytes, such as write R200 0 255",
            ),
            ("pause", "found `pause`, expected pause and a number of seconds"),
            ("write D1 0", "found `D1`, expected a place such as R200"),
            ("write R1 256", "found `256`, expected a byte"),
            ("alarm maybe", "found `maybe`, expected on or off"),
            ("pause -1", "found `-1`, expected a number of seconds"),
            ("pause 1e300", "found `1e300`"),
            ("stop", "found `stop`, expected one of alarm"),
            ("steps forget", "found `steps forget`, expected steps or steps reset"),
            ("freeze", "found `freeze`, expected freeze on or freeze off"),
        ] {
            let refused = parsed(line).err().unwrap_or_default();
            assert!(refused.contains(expected), "{line}: {refused}");
        }
    }
}
