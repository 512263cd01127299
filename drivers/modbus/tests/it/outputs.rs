//! Tests of outputs on a simulated TCP module that delays or rejects requests and records writes.

use std::{
    collections::VecDeque,
    io::{ErrorKind, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use volcomp_modbus::{Bus, DigitalModule, ModbusDigital, Profile};
use volcomp_port::{Backoff, DigitalIo, Fault, InputLevels};

use crate::until;

#[derive(Default)]
#[expect(clippy::struct_excessive_bools, reason = "independent faults")]
struct ModuleState {
    inputs: u8,
    coils: u8,
    /// Levels of all writes received, in order.
    writes: Vec<u8>,
    /// If true, the module accepts requests, but sends no responses.
    silent: bool,
    /// If true, the module rejects writes with exception 4.
    rejects_writes: bool,
    /// If true, the module switches its outputs although it rejects the write.
    switches_rejected: bool,
    /// Responses to the next requests for coils; when the list is empty, the module responds normally.
    coil_responses: VecDeque<CoilResponse>,
    coil_requests: u32,
    /// If true, the module executes writes, but does not respond to them.
    ignores_writes: bool,
    /// Delay before the response with the inputs of unit 2.
    slow: Duration,
    /// While true, reading the inputs of unit 2 blocks; `is_blocked` is then true while a request waits.
    blocked: bool,
    is_blocked: bool,
    /// Number of connections that the client reset; `closes` counts those that it closed normally.
    resets: u32,
    closes: u32,
}

/// Response of the module to a request for its coils.
#[derive(Clone, Copy, PartialEq)]
enum CoilResponse {
    Disconnect,
    /// Rejection with this exception code.
    Reject(u8),
    Levels(u8),
}

#[derive(Clone, Default)]
struct Module(Arc<Mutex<ModuleState>>);

impl Module {
    fn start() -> (Self, SocketAddr) {
        let module = Self::default();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let serving = module.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let module = serving.clone();
                std::thread::spawn(move || module.serve(stream.unwrap()));
            }
        });
        (module, address)
    }

    fn set(&self, change: impl FnOnce(&mut ModuleState)) {
        change(&mut self.0.lock().unwrap());
    }

    fn get<T>(&self, what: impl FnOnce(&ModuleState) -> T) -> T {
        what(&self.0.lock().unwrap())
    }

    fn serve(&self, mut stream: TcpStream) {
        stream.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
        let mut request = Vec::new();
        let mut byte = [0; 64];
        loop {
            match stream.read(&mut byte) {
                Ok(0) => return self.set(|state| state.closes += 1),
                Ok(count) => request.extend(&byte[..count]),
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(e) if e.kind() == ErrorKind::ConnectionReset => {
                    return self.set(|state| state.resets += 1);
                }
                Err(e) => panic!("{e}"),
            }
            while request.len() >= 6 {
                let length = 6 + usize::from(request[5]);
                if request.len() < length {
                    break;
                }
                let rest = request.split_off(length);
                if request[7] == 1 {
                    let next = self.0.lock().unwrap().coil_responses.front().copied();
                    if next == Some(CoilResponse::Disconnect) {
                        self.set(|state| {
                            state.coil_responses.pop_front();
                            state.coil_requests += 1;
                        });
                        return;
                    }
                }
                if let Some(answer) = self.answer(&request) {
                    let _ = stream.write_all(&answer);
                }
                request = rest;
            }
        }
    }

    fn answer(&self, request: &[u8]) -> Option<Vec<u8>> {
        let (unit, function) = (request[6], request[7]);
        if unit == 2 && function == 2 {
            std::thread::sleep(self.get(|state| state.slow));
            while self.get(|state| state.blocked) {
                self.set(|state| state.is_blocked = true);
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        let mut state = self.0.lock().unwrap();
        if state.silent {
            return None;
        }
        let body = match function {
            1 => {
                state.coil_requests += 1;
                match state.coil_responses.pop_front() {
                    Some(CoilResponse::Reject(exception)) => vec![0x81, exception],
                    Some(CoilResponse::Levels(levels)) => vec![1, 1, levels],
                    Some(CoilResponse::Disconnect) | None => vec![1, 1, state.coils],
                }
            }
            2 => vec![2, 1, state.inputs],
            15 if state.ignores_writes => return None,
            15 if state.rejects_writes => {
                if state.switches_rejected {
                    state.coils = request[13];
                }
                vec![0x8f, 4]
            }
            15 => {
                state.coils = request[13];
                state.writes.push(request[13]);
                request[7..12].to_vec()
            }
            other => panic!("function {other}"),
        };
        let length = u8::try_from(body.len() + 1).unwrap();
        Some([&request[..4], &[0, length, unit], &body].concat())
    }
}

fn open(address: SocketAddr, units: &[u8]) -> ModbusDigital {
    open_with_timeout(address, units, Duration::from_secs(3))
}

fn open_with_timeout(address: SocketAddr, units: &[u8], within: Duration) -> ModbusDigital {
    let profile = Profile::named("WAVESHARE-IO-8CH").unwrap();
    let modules: Vec<_> =
        units.iter().map(|unit| DigitalModule { unit: *unit, profile: profile.clone() }).collect();
    let bus = Bus::Tcp { host: address.ip().to_string(), port: address.port() };
    let quick = Backoff { first: Duration::from_millis(5), most: Duration::from_millis(20) };
    ModbusDigital::new(bus, &modules, within, quick).unwrap()
}

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(600)
}

fn reads(port: &mut ModbusDigital) -> bool {
    port.read(soon()).is_ok()
}

/// Each write is sent once and confirmed. Before the first write, the levels are read back from the module.
#[test]
fn a_write_is_sent_once_and_confirmed() {
    let (module, address) = Module::start();
    module.set(|state| state.coils = 0xa5);
    let mut port = open(address, &[1]);
    assert_eq!(port.confirmed(), None);
    until("a read succeeds", || reads(&mut port));
    assert_eq!(port.confirmed(), Some(0xa5));
    assert_eq!(port.write(0x5a, soon()), Ok(()));
    until("it is confirmed", || {
        reads(&mut port);
        port.confirmed() == Some(0x5a)
    });
    // After many exchanges, the levels have been written once. A write is not sent after its deadline.
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(port.write(0x11, Instant::now()), Err(Fault::TimedOut));
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(module.get(|state| state.writes.clone()), [0x5a]);
}

/// A write that a slow read delays past its deadline is not sent; the next call reports the failure.
#[test]
fn a_write_delayed_past_its_deadline_is_not_sent() {
    const LONG: Duration = Duration::from_secs(600);
    let (module, address) = Module::start();
    let mut port = open_with_timeout(address, &[1, 2, 3, 4, 5, 6, 7, 8], LONG);
    until("a read succeeds", || reads(&mut port));
    module.set(|state| state.blocked = true);
    until("the exchange is blocked", || module.get(|state| state.is_blocked));
    let deadline = Instant::now() + Duration::from_millis(20);
    // The deadline may already have passed if this thread was suspended.
    let was_in_time = port.write(0x77, deadline).is_ok();
    std::thread::sleep(deadline.saturating_duration_since(Instant::now()));
    let released = Instant::now();
    module.set(|state| state.blocked = false);
    until("two exchanges later", || (port.read(soon())).is_ok_and(|found| found.taken > released));
    let seen = port.read(soon()).unwrap().taken;
    until("three exchanges later", || port.read(soon()).is_ok_and(|found| found.taken > seen));
    assert!(module.get(|state| state.writes.is_empty()));
    let result = port.write(0, soon());
    assert_eq!(result.is_err(), was_in_time, "{result:?}");
}

/// Over TCP, the connection is reset if a write is not acknowledged by its deadline, although the module's response
/// timeout is much longer. No part of the write then stays queued.
#[test]
fn an_unacknowledged_write_resets_the_connection_at_its_deadline() {
    let (module, address) = Module::start();
    let mut port = open_with_timeout(address, &[1], Duration::from_secs(600));
    until("a read succeeds", || reads(&mut port));
    module.set(|state| state.ignores_writes = true);
    until("it is reset", || {
        let _ = port.write(1, Instant::now() + Duration::from_millis(30));
        module.get(|state| state.resets > 0)
    });
    assert_eq!(module.get(|state| state.closes), 0);
}

#[test]
fn inputs_keep_their_time_of_arrival() {
    let (module, address) = Module::start();
    module.set(|state| state.inputs = 0x3c);
    let mut port = open_with_timeout(address, &[1, 2], Duration::from_secs(600));
    until("a read succeeds", || reads(&mut port));
    module.set(|state| state.blocked = true);
    until("the exchange is blocked", || module.get(|state| state.is_blocked));
    let silent = Instant::now();
    std::thread::sleep(Duration::from_millis(200));
    let found = port.read(soon()).unwrap();
    assert_eq!(found.levels, 0x3c3c);
    assert!(found.taken <= silent);
    module.set(|state| state.blocked = false);
    until("a read succeeds again", || port.read(soon()).is_ok_and(|found| found.taken > silent));
}

#[test]
fn a_rejected_write_is_reported_as_failed() {
    let (module, address) = Module::start();
    let mut port = open(address, &[1]);
    until("a read succeeds", || reads(&mut port));
    module.set(|state| state.rejects_writes = true);
    for _ in 0..4 {
        // The write is accepted until the response to the previous one is there.
        until("it is rejected", || {
            let written = port.write(1, soon());
            let refused = Err(Fault::Refused { code: 4, what: "server device failure" });
            assert!(written.is_ok() || written == refused, "{written:?}");
            written == refused
        });
    }
    assert_eq!(port.confirmed(), Some(0));
    module.set(|state| state.rejects_writes = false);
    until("it is confirmed", || {
        // The first call may report the failure of the previous write.
        let _ = port.write(2, soon());
        reads(&mut port);
        port.confirmed() == Some(2)
    });
    assert_eq!(port.write(3, soon()), Ok(()));
}

/// A module may switch its outputs before it rejects a write. Therefore the outputs are read back after a rejected
/// write.
#[test]
fn outputs_are_read_back_after_a_rejected_write() {
    let (module, address) = Module::start();
    let mut port = open(address, &[1]);
    until("a read succeeds", || reads(&mut port) && port.confirmed() == Some(0));
    module.set(|state| (state.rejects_writes, state.switches_rejected) = (true, true));
    port.write(5, soon()).unwrap();
    until("the levels are known", || reads(&mut port) && port.confirmed() == Some(5));
}

/// A write from before a disconnection is not sent over the next connection. The old connection is reset, so that the
/// kernel sends no queued data.
#[test]
fn an_old_write_is_not_sent_over_a_new_connection() {
    let (module, address) = Module::start();
    let mut port = open(address, &[1]);
    until("a read succeeds", || reads(&mut port));
    until("it is confirmed", || {
        let _ = port.write(7, soon());
        reads(&mut port);
        port.confirmed() == Some(7)
    });
    module.set(|state| state.silent = true);
    let _ = port.write(8, soon());
    until("the disconnection is reported", || port.read(soon()) == Err(Fault::NotConnected));
    assert_eq!(port.write(9, soon()), Err(Fault::NotConnected));
    until("it is reset", || module.get(|state| state.resets > 0));
    // After a power cycle of the module, its outputs are zero until the next write.
    module.set(|state| {
        state.coils = 0;
        state.silent = false;
        state.writes.clear();
    });
    until("a read succeeds again", || reads(&mut port));
    std::thread::sleep(Duration::from_millis(60));
    assert!(module.get(|state| state.writes.is_empty()));
    assert_eq!(port.confirmed(), Some(0));
    assert_eq!(port.write(10, soon()), Ok(()), "the loss was already reported");
    until("the write arrives", || module.get(|state| state.writes == [10]));
    assert_eq!(module.get(|state| state.closes), 0);
}

/// If reading the coils fails, it is repeated over this or a later connection until the levels are known; otherwise
/// unused outputs would be switched off. A module without this function is reported, and its levels stay unknown.
#[test]
fn the_read_back_of_outputs_is_repeated() {
    use CoilResponse::{Disconnect, Levels, Reject};
    for (responses, known) in [
        (vec![Disconnect; 2], Some(0xa5)),
        // After three failures, a connection gives up reading the coils; the test closes this connection below.
        (vec![Disconnect; 5], Some(0xa5)),
        // The module is busy, and then gives one wrong response.
        (vec![Reject(6), Levels(0xff)], Some(0xa5)),
        (vec![Reject(1)], None),
    ] {
        let (module, address) = Module::start();
        let wrong = responses.len();
        module.set(|state| {
            state.coils = 0xa5;
            state.coil_responses = responses.into();
        });
        let mut port = open(address, &[1]);
        if wrong == 5 {
            until("a read succeeds without read-back", || reads(&mut port));
            assert_eq!((port.confirmed(), port.reports_outputs()), (None, true));
            assert_eq!(module.get(|state| state.coil_requests), 3);
            module.set(|state| state.silent = true);
            until("the disconnection is reported", || !reads(&mut port));
            module.set(|state| state.silent = false);
        }
        until("the levels are known", || {
            reads(&mut port) && (port.confirmed().is_some() || !port.reports_outputs())
        });
        assert_eq!(port.confirmed(), known);
        assert_eq!(port.reports_outputs(), known.is_some());
    }
}

/// The outputs of a module that were read back once are requested until it answers, regardless of the number of failures
/// on a bad line.
#[test]
fn outputs_that_were_known_are_read_back_again() {
    let (module, address) = Module::start();
    module.set(|state| state.coils = 0xa5);
    let mut port = open(address, &[1]);
    until("the levels are known", || reads(&mut port) && port.confirmed() == Some(0xa5));
    module.set(|state| {
        state.coils = 0x5a;
        state.coil_responses = vec![CoilResponse::Disconnect; 5].into();
        state.silent = true;
    });
    until("the disconnection is reported", || !reads(&mut port));
    module.set(|state| state.silent = false);
    until("the levels are known again", || reads(&mut port) && port.confirmed() == Some(0x5a));
}

/// The output levels are read back once a module answers again, regardless of how many connections were made while it
/// was silent.
#[test]
fn outputs_are_read_back_after_any_silence() {
    for connections in 1..=8 {
        let (module, address) = Module::start();
        module.set(|state| {
            state.coils = 0xa5;
            state.silent = true;
        });
        let mut port = open_with_timeout(address, &[1], Duration::from_millis(100));
        until("it was connected to often", || module.get(|state| state.resets >= connections));
        module.set(|state| state.silent = false);
        until("a read succeeds", || reads(&mut port));
        until("the levels are known", || reads(&mut port) && port.confirmed() == Some(0xa5));
    }
}

/// The arrival time of the inputs is that of their oldest part: that of the first module while the second one is slow.
#[test]
fn inputs_are_as_old_as_their_oldest_part() {
    let (module, address) = Module::start();
    module.set(|state| {
        state.inputs = 0x3c;
        state.slow = Duration::from_millis(15);
    });
    let mut port = open(address, &[1, 2]);
    until("a read succeeds", || reads(&mut port));
    let mut before: Option<InputLevels> = None;
    let mut seen = 0;
    until("twenty readings", || {
        std::thread::sleep(Duration::from_millis(7));
        // On a busy computer the connection may be lost.
        let Ok(found) = port.read(soon()) else {
            return false;
        };
        assert_eq!(found.levels, 0x3c3c);
        let age = found.taken.elapsed();
        assert!(
            age >= Duration::from_millis(14),
            "the first part must be older than the second took: {age:?}"
        );
        assert!(before.is_none_or(|before| before.taken <= found.taken));
        before = Some(found);
        seen += 1;
        seen == 20
    });
}
