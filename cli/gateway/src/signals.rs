//! Process signals. A separate thread receives them, so that a stop takes effect immediately, even if the service is
//! busy.

use std::{
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::Duration,
};

use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    iterator::{Handle, Signals},
};

use crate::error::GatewayError;

/// The action requested by a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// SIGTERM or SIGINT: ramp the correction out and exit.
    Stop,
    /// SIGHUP: reload the configuration and the machine file.
    Reload,
}

/// Ends the program on SIGINT and SIGTERM, with status 130 like a shell.
///
/// # Errors
/// The operating system cannot deliver signals or create a thread.
pub fn exit_when_interrupted() -> Result<(), GatewayError> {
    let failed = |e| GatewayError::system("signals", e);
    let mut signals = Signals::new([SIGTERM, SIGINT]).map_err(failed)?;
    let wait = move || {
        if signals.forever().next().is_some() {
            eprintln!("interrupted");
            std::process::exit(130);
        }
    };
    let thread = thread::Builder::new().name("interrupts".to_owned()).spawn(wait);
    thread.map(drop).map_err(failed)
}

/// Receiver of signals, in the order of their arrival.
pub struct SignalReceiver {
    receiver: Receiver<Signal>,
    handle: Handle,
}

impl SignalReceiver {
    /// Starts receiving signals. Every stop signal calls `stop` immediately, on the receiving thread.
    ///
    /// # Errors
    /// The operating system cannot deliver signals or create a thread.
    pub fn new(stop: impl Fn() + Send + 'static) -> Result<Self, GatewayError> {
        let failed = |e| GatewayError::system("signals", e);
        let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP]).map_err(failed)?;
        let handle = signals.handle();
        let (tell, receiver) = channel();
        thread::Builder::new()
            .name("volcomp-signals".to_owned())
            .stack_size(64 * 1024)
            .spawn(move || {
                for signal in signals.forever() {
                    let signal = if signal == SIGHUP {
                        Signal::Reload
                    } else {
                        stop();
                        Signal::Stop
                    };
                    if tell.send(signal).is_err() {
                        return;
                    }
                }
            })
            .map_err(failed)?;
        Ok(Self { receiver, handle })
    }

    /// Waits at most `wait` for the next signal; `None` if none arrived.
    pub fn next(&self, wait: Duration) -> Option<Signal> {
        match self.receiver.recv_timeout(wait) {
            Ok(signal) => Some(signal),
            Err(RecvTimeoutError::Timeout) => None,
            // The receiving thread has ended, so no more signals arrive.
            Err(RecvTimeoutError::Disconnected) => {
                thread::sleep(wait);
                None
            }
        }
    }
}

impl Drop for SignalReceiver {
    fn drop(&mut self) {
        self.handle.close();
    }
}

#[cfg(test)]
mod tests {
    use std::{sync::mpsc, time::Duration};

    use super::*;

    /// A stop signal takes effect immediately, not at the next iteration of the service, which may be 50 ms later.
    #[test]
    fn a_stop_acts_without_a_reader() {
        let patience = Duration::from_secs(10);
        let (acted, acts) = mpsc::channel();
        let signals = SignalReceiver::new(move || {
            // The test may be over.
            let _ = acted.send(());
        })
        .expect("signals");
        for (number, signal) in
            [(SIGTERM, Signal::Stop), (SIGINT, Signal::Stop), (SIGHUP, Signal::Reload)]
        {
            signal_hook::low_level::raise(number).expect("a signal");
            if signal == Signal::Stop {
                acts.recv_timeout(patience).expect("it acts at once");
            }
            let receiver = signals.receiver.recv_timeout(patience);
            assert_eq!(receiver.expect("a signal"), signal);
        }
        assert!(acts.try_recv().is_err(), "a reload does not stop");
    }
}
