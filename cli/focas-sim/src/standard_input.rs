//! Reads lines from standard input. The kernel stops a background program that reads from its terminal; this module
//! avoids that.

use std::{
    io::{BufRead, BufReader, IsTerminal, Read},
    time::Duration,
};

use rustix::{process::getpgrp, termios::tcgetpgrp};

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
