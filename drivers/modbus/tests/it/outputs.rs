//! Outputs on a module of our own, over TCP: it can be silent or refuse, and counts what it was told.

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

/// What the module holds, and how it behaves.
#[derive(Default)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "ways to misbehave that do not exclude one another"
)]
struct Inside {
    inputs: u8,
    coils: u8,
    /// The levels of every write that came, in order.
    writes: Vec<u8>,
    /// Takes requests and answers none.
    silent: bool,
    /// Refuses writes with exception 4.
    refuses: bool,
    /// What it does with questions for its coils, the next one first; afterwards it answers.
    coils_asked: VecDeque<Asked>,
    /// How often it was asked for them.
    questions: u32,
    /// Takes writes and does not answer them.
    mute_writes: bool,
    /// How long reading the inputs of unit 2 takes.
    slow: Duration,
    /// For so long as it is so, reading the inputs of unit 2 takes, and whether somebody waits for it.
    held: bool,
    waits: bool,
    /// Connections that the other side ended with a reset, and those that it closed.
    resets: u32,
    closes: u32,
}

/// What the module does with a question for its coils.
#[derive(Clone, Copy, PartialEq)]
enum Asked {
    /// Ends the connection.
    Breaks,
    /// Refuses it with this exception.
    Refuses(u8),
    /// Tells these levels.
    Tells(u8),
}

#[derive(Clone, Default)]
struct Module(Arc<Mutex<Inside>>);

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

    fn set(&self, change: impl FnOnce(&mut Inside)) {
        change(&mut self.0.lock().unwrap());
    }

    fn get<T>(&self, what: impl FnOnce(&Inside) -> T) -> T {
        what(&self.0.lock().unwrap())
    }

    /// Answers one connection until it ends.
    fn serve(&self, mut stream: TcpStream) {
        stream
            .set_read_timeout(Some(Duration::from_millis(5)))
            .unwrap();
        let mut request = Vec::new();
        let mut byte = [0; 64];
        loop {
            match stream.read(&mut byte) {
                Ok(0) => return self.set(|inside| inside.closes += 1),
                Ok(count) => request.extend(&byte[..count]),
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(e) if e.kind() == ErrorKind::ConnectionReset => {
                    return self.set(|inside| inside.resets += 1);
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
                    let next = self.0.lock().unwrap().coils_asked.front().copied();
                    if next == Some(Asked::Breaks) {
                        self.set(|inside| {
                            inside.coils_asked.pop_front();
                            inside.questions += 1;
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
            std::thread::sleep(self.get(|inside| inside.slow));
            while self.get(|inside| inside.held) {
                self.set(|inside| inside.waits = true);
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        let mut inside = self.0.lock().unwrap();
        if inside.silent {
            return None;
        }
        let body = match function {
            1 => {
                inside.questions += 1;
                match inside.coils_asked.pop_front() {
                    Some(Asked::Refuses(exception)) => vec![0x81, exception],
                    Some(Asked::Tells(levels)) => vec![1, 1, levels],
                    Some(Asked::Breaks) | None => vec![1, 1, inside.coils],
                }
            }
            2 => vec![2, 1, inside.inputs],
            15 if inside.mute_writes => return None,
            15 if inside.refuses => vec![0x8f, 4],
            15 => {
                inside.coils = request[13];
                inside.writes.push(request[13]);
                request[7..12].to_vec()
            }
            other => panic!("function {other}"),
        };
        let length = u8::try_from(body.len() + 1).unwrap();
        Some([&request[..4], &[0, length, unit], &body].concat())
    }
}

fn open(address: SocketAddr, units: &[u8]) -> ModbusDigital {
    open_patient(address, units, Duration::from_millis(80))
}

/// A module may take so long for an answer.
fn open_patient(address: SocketAddr, units: &[u8], within: Duration) -> ModbusDigital {
    let profile = Profile::named("WAVESHARE-IO-8CH").unwrap();
    let modules: Vec<_> = units
        .iter()
        .map(|unit| DigitalModule {
            unit: *unit,
            profile: profile.clone(),
        })
        .collect();
    let bus = Bus::Tcp {
        host: address.ip().to_string(),
        port: address.port(),
    };
    let quick = Backoff {
        first: Duration::from_millis(5),
        most: Duration::from_millis(20),
    };
    ModbusDigital::new(bus, &modules, within, quick).unwrap()
}

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(1)
}

fn reads(port: &mut ModbusDigital) -> bool {
    port.read(soon()).is_ok()
}

/// Each write goes out once and is confirmed; before the first one the levels that the module has are known.
#[test]
fn a_write_goes_out_once_and_is_confirmed() {
    let (module, address) = Module::start();
    module.set(|inside| inside.coils = 0xa5);
    let mut port = open(address, &[1]);
    assert_eq!(port.confirmed(), None);
    until("it reads", || reads(&mut port));
    assert_eq!(port.confirmed(), Some(0xa5));
    assert_eq!(port.write(0x5a, soon()), Ok(()));
    until("it is confirmed", || {
        reads(&mut port);
        port.confirmed() == Some(0x5a)
    });
    // Many exchanges later it was written once, and a deadline that has passed is not.
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(port.write(0x11, Instant::now()), Err(Fault::TimedOut));
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(module.get(|inside| inside.writes.clone()), [0x5a]);
}

/// A module that is slow to tell its inputs holds a write up: once the deadline of the write has passed it is not sent any
/// more, and the next call tells that. It was sent for up to two exchanges after that.
#[test]
fn a_write_that_was_held_up_past_its_deadline_is_not_sent() {
    const LONG: Duration = Duration::from_secs(600);
    let (module, address) = Module::start();
    let mut port = open_patient(address, &[1, 2, 3, 4, 5, 6, 7, 8], LONG);
    until("it reads", || reads(&mut port));
    module.set(|inside| inside.held = true);
    until("the exchange is held up", || {
        module.get(|inside| inside.waits)
    });
    let deadline = Instant::now() + Duration::from_millis(20);
    // Where this thread was away for so long, it is too late already.
    let was_in_time = port.write(0x77, deadline).is_ok();
    std::thread::sleep(deadline.saturating_duration_since(Instant::now()));
    let released = Instant::now();
    module.set(|inside| inside.held = false);
    until("two exchanges later", || {
        (port.read(soon())).is_ok_and(|found| found.taken > released)
    });
    let seen = port.read(soon()).unwrap().taken;
    until("three exchanges later", || {
        port.read(soon()).is_ok_and(|found| found.taken > seen)
    });
    assert!(module.get(|inside| inside.writes.is_empty()));
    let told = port.write(0, soon());
    assert_eq!(told.is_err(), was_in_time, "{told:?}");
}

/// Over TCP a write that was not answered at its deadline resets its connection: nothing of it is left in a queue. The
/// module would have been waited for much longer.
#[test]
fn a_write_that_is_not_answered_at_its_deadline_resets_its_connection() {
    let (module, address) = Module::start();
    let mut port = open_patient(address, &[1], Duration::from_secs(600));
    until("it reads", || reads(&mut port));
    module.set(|inside| inside.mute_writes = true);
    until("it is reset", || {
        let _ = port.write(1, Instant::now() + Duration::from_millis(30));
        module.get(|inside| inside.resets > 0)
    });
    assert_eq!(module.get(|inside| inside.closes), 0);
}

/// Inputs of a module that has become silent are told as they were, with the time at which they came.
#[test]
fn inputs_are_told_with_their_age() {
    let (module, address) = Module::start();
    module.set(|inside| inside.inputs = 0x3c);
    let mut port = open_patient(address, &[1, 2], Duration::from_secs(600));
    until("it reads", || reads(&mut port));
    module.set(|inside| inside.held = true);
    until("the exchange is held up", || {
        module.get(|inside| inside.waits)
    });
    let silent = Instant::now();
    std::thread::sleep(Duration::from_millis(200));
    let found = port.read(soon()).unwrap();
    assert_eq!(found.levels, 0x3c3c);
    assert!(found.taken <= silent);
    module.set(|inside| inside.held = false);
    until("it reads again", || {
        port.read(soon()).is_ok_and(|found| found.taken > silent)
    });
}

/// A write that the module refuses or does not answer is told as failed by a later call, and confirms nothing.
#[test]
fn a_write_that_was_not_acknowledged_has_failed() {
    let (module, address) = Module::start();
    let mut port = open(address, &[1]);
    until("it reads", || reads(&mut port));
    module.set(|inside| inside.refuses = true);
    assert_eq!(port.write(1, soon()), Ok(()), "nothing is known yet");
    std::thread::sleep(Duration::from_millis(60));
    for _ in 0..3 {
        let refused = Err(Fault::Refused {
            code: 4,
            what: "server device failure",
        });
        assert_eq!(port.write(1, soon()), refused);
        std::thread::sleep(Duration::from_millis(60));
    }
    assert_eq!(port.confirmed(), Some(0));
    module.set(|inside| inside.refuses = false);
    // The failure of the write before, then none.
    assert!(port.write(2, soon()).is_err());
    until("it is confirmed", || {
        reads(&mut port);
        port.confirmed() == Some(2)
    });
    assert_eq!(port.write(3, soon()), Ok(()));
}

/// What was asked for before the connection was lost is not written over the next one, and the lost connection is reset,
/// so that the kernel sends nothing of it later.
#[test]
fn nothing_old_is_written_over_a_new_connection() {
    let (module, address) = Module::start();
    let mut port = open(address, &[1]);
    until("it reads", || reads(&mut port));
    port.write(7, soon()).unwrap();
    until("it is confirmed", || {
        reads(&mut port);
        port.confirmed() == Some(7)
    });
    module.set(|inside| inside.silent = true);
    port.write(8, soon()).unwrap();
    until("the loss is told", || {
        port.read(soon()) == Err(Fault::NotConnected)
    });
    assert_eq!(port.write(9, soon()), Err(Fault::NotConnected));
    until("it is reset", || module.get(|inside| inside.resets > 0));
    // Switched off and on: the outputs are zero, and stay so until somebody writes.
    module.set(|inside| {
        inside.coils = 0;
        inside.silent = false;
        inside.writes.clear();
    });
    until("it reads again", || reads(&mut port));
    std::thread::sleep(Duration::from_millis(60));
    assert!(module.get(|inside| inside.writes.is_empty()));
    assert_eq!(port.confirmed(), Some(0));
    assert_eq!(port.write(10, soon()), Ok(()), "its loss was told already");
    until("it writes", || module.get(|inside| inside.writes == [10]));
    assert_eq!(module.get(|inside| inside.closes), 0);
}

/// The question for the coils goes wrong: it is asked again, over this connection or a later one, until the levels are
/// known; of a module that refuses it as a function that it does not have they stay unknown, which is told. They were never
/// asked again, and outputs that carry nothing were switched off.
#[test]
fn outputs_are_asked_for_until_they_are_known() {
    use Asked::{Breaks, Refuses, Tells};
    for (asked, known) in [
        (vec![Breaks; 2], Some(0xa5)),
        // After three that broke one connection does without; it breaks for another reason below.
        (vec![Breaks; 5], Some(0xa5)),
        // Busy, and one wrong answer.
        (vec![Refuses(6), Tells(0xff)], Some(0xa5)),
        (vec![Refuses(1)], None),
    ] {
        let (module, address) = Module::start();
        let wrong = asked.len();
        module.set(|inside| {
            inside.coils = 0xa5;
            inside.coils_asked = asked.into();
        });
        let mut port = open(address, &[1]);
        if wrong == 5 {
            until("it reads without asking", || reads(&mut port));
            assert_eq!((port.confirmed(), port.tells_outputs()), (None, true));
            assert_eq!(module.get(|inside| inside.questions), 3);
            module.set(|inside| inside.silent = true);
            until("the loss is told", || !reads(&mut port));
            module.set(|inside| inside.silent = false);
        }
        until("it is known", || {
            reads(&mut port) && (port.confirmed().is_some() || !port.tells_outputs())
        });
        assert_eq!(port.confirmed(), known);
        assert_eq!(port.tells_outputs(), known.is_some());
    }
}

/// The time of an image is the arrival of its oldest part: a second module that takes long makes it older.
#[test]
fn an_image_is_as_old_as_its_oldest_part() {
    let (module, address) = Module::start();
    module.set(|inside| {
        inside.inputs = 0x3c;
        inside.slow = Duration::from_millis(15);
    });
    let mut port = open(address, &[1, 2]);
    until("it reads", || reads(&mut port));
    let mut before: Option<InputLevels> = None;
    let mut seen = 0;
    until("twenty readings", || {
        std::thread::sleep(Duration::from_millis(7));
        // A machine with other work may lose the connection.
        let Ok(found) = port.read(soon()) else {
            return false;
        };
        assert_eq!(found.levels, 0x3c3c);
        let age = found.taken.elapsed();
        assert!(
            age >= Duration::from_millis(14),
            "the first part is older than the second took: {age:?}"
        );
        assert!(before.is_none_or(|before| before.taken <= found.taken));
        before = Some(found);
        seen += 1;
        seen == 20
    });
}
