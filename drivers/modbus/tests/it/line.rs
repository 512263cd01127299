//! Tests with simulated modules on a serial line that answer late, wrongly or not at all.

use std::{
    fs::{File, OpenOptions},
    io::{Read, Write},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use volcomp_modbus::{DigitalModule, ModbusDigital, Profile, poll_temperatures};
use volcomp_port::{Backoff, DigitalIo, Fault, Published, Quality, Reason, Thermometer};

use crate::{Wire, config, until};

fn crc(bytes: &[u8]) -> [u8; 2] {
    let mut crc = 0xffff_u16;
    for byte in bytes {
        crc ^= u16::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0xa001 } else { crc >> 1 };
        }
    }
    crc.to_le_bytes()
}

/// Returns the response of a module to a request, and its delay; `None` for no response. A delayed response is not sent if the next request
/// is there before it: a busy computer made it later than the line is watched for.
type Behaviour = dyn FnMut(&[u8]) -> Option<(Duration, Vec<u8>)> + Send;

/// Simulated modules at the far end of the serial line.
struct Modules {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Modules {
    fn start(wire: &Wire, behaviour: Box<Behaviour>) -> Self {
        Self::start_with_echo(wire, false, behaviour)
    }

    /// Starts the modules. If `echoes`, they are behind an adapter that echoes each request.
    fn start_with_echo(wire: &Wire, echoes: bool, mut behaviour: Box<Behaviour>) -> Self {
        let mut port: File = OpenOptions::new().read(true).write(true).open(&wire.theirs).unwrap();
        let mut reader = port.try_clone().unwrap();
        let (sender, bytes) = mpsc::channel();
        std::thread::spawn(move || {
            let mut byte = [0; 1];
            while reader.read(&mut byte).is_ok_and(|count| count == 1) {
                if sender.send(byte[0]).is_err() {
                    return;
                }
            }
        });
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut request = Vec::new();
            while let Ok(byte) = bytes.recv() {
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                request.push(byte);
                if echoes {
                    port.write_all(&[byte]).unwrap();
                }
                // A read request has eight bytes; the length of a write request depends on its byte count.
                let length = match request.get(1) {
                    Some(15) => request.get(6).map_or(usize::MAX, |n| 9 + usize::from(*n)),
                    _ => 8,
                };
                if request.len() < length {
                    continue;
                }
                let asked = std::mem::take(&mut request);
                let (frame, sum) = asked.split_at(length - 2);
                assert_eq!(sum, crc(frame), "a corrupted request");
                if let Some((wait, mut answer)) = behaviour(frame) {
                    std::thread::sleep(wait);
                    if let Ok(next) = bytes.try_recv() {
                        request.push(next);
                        continue;
                    }
                    answer.extend(crc(&answer));
                    port.write_all(&answer).unwrap();
                }
            }
        });
        Self { stop, thread: Some(thread) }
    }
}

impl Drop for Modules {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // The thread ends when the line closes, or at the next request.
        drop(self.thread.take());
    }
}

/// A response with the registers of four channels: 20.1 °C for the first channel of unit 0, plus 1 °C per unit number
/// and 0.1 °C per channel.
fn registers(request: &[u8]) -> Vec<u8> {
    let unit = request[0];
    let mut answer = vec![unit, request[1], 8];
    for channel in 1..=4_u16 {
        answer.extend((200 + 10 * u16::from(unit) + channel).to_be_bytes());
    }
    answer
}

/// The echo of an adapter is skipped. If no response follows, the echo is reported.
#[test]
fn the_echo_of_an_adapter_is_not_a_response() {
    let Some(wire) = Wire::new() else { return };
    let silent = Arc::new(AtomicBool::new(false));
    let is_silent = Arc::clone(&silent);
    let _modules = Modules::start_with_echo(
        &wire,
        true,
        Box::new(move |request| {
            if is_silent.load(Ordering::Relaxed) {
                return None;
            }
            Some((Duration::ZERO, registers(request)))
        }),
    );
    let mut thermometer = poll_temperatures(config(wire.bus(), &[1])).unwrap();
    until("it is good", || thermometer.latest()[0].quality == Quality::Good);
    let degc = thermometer.latest()[0].degc.unwrap();
    assert!((degc - 21.1).abs() < 1e-9, "{degc}");
    silent.store(true, Ordering::Relaxed);
    until("the echo is named", || thermometer.latest()[0].quality == Quality::Bad(Reason::Echo));
    silent.store(false, Ordering::Relaxed);
    until("it is good again", || thermometer.latest()[0].quality == Quality::Good);
}

#[test]
fn exceptions_are_named() {
    let Some(wire) = Wire::new() else { return };
    let code = Arc::new(Mutex::new(0));
    let coded = Arc::clone(&code);
    let _modules = Modules::start(
        &wire,
        Box::new(move |request| {
            let code = *coded.lock().unwrap();
            let refusal = vec![request[0], request[1] | 0x80, code];
            Some((Duration::ZERO, refusal))
        }),
    );
    let mut thermometer = poll_temperatures(config(wire.bus(), &[1])).unwrap();
    for (exception, name) in [
        (1, "the device refuses: exception 01, illegal function"),
        (2, "the device refuses: exception 02, illegal data address"),
        (3, "the device refuses: exception 03, illegal data value"),
        (6, "the device refuses: exception 06, server device busy"),
        (11, "the device refuses: exception 11, gateway target device failed to respond"),
    ] {
        *code.lock().unwrap() = exception;
        let reason = Reason::Refused { code: exception };
        until("the reason is reported", || thermometer.latest()[0].quality == Quality::Bad(reason));
        assert_eq!(reason.to_string(), name);
    }
}

#[test]
fn units_on_one_line_are_polled_in_turn() {
    let Some(wire) = Wire::new() else { return };
    let polled = Arc::new(Mutex::new(Vec::new()));
    let recorded = Arc::clone(&polled);
    let _modules = Modules::start(
        &wire,
        Box::new(move |request| {
            recorded.lock().unwrap().push(request[0]);
            Some((Duration::ZERO, registers(request)))
        }),
    );
    let mut thermometer = poll_temperatures(config(wire.bus(), &[1, 2, 3])).unwrap();
    until("all are good", || thermometer.latest().iter().all(|t| t.quality == Quality::Good));
    let degc: Vec<f64> = thermometer.latest().iter().filter_map(|t| t.degc).collect();
    for (found, expected) in degc.iter().zip([21.1, 21.2, 21.3, 21.4, 22.1, 22.2, 22.3, 22.4, 23.1])
    {
        assert!((found - expected).abs() < 1e-9, "{degc:?}");
    }
    until("some rounds", || polled.lock().unwrap().len() > 30);
    let polled = polled.lock().unwrap();
    assert!(polled.windows(3).all(|w| w[0] != w[1] && w[1] != w[2]), "{polled:?}");
}

/// Unit 1 responds after the timeout with data that any unit could send. The response is neither accepted for unit 2
/// nor for the next request to unit 1.
#[test]
fn a_late_response_is_never_taken_for_another() {
    let Some(wire) = Wire::new() else { return };
    let late = Arc::new(AtomicBool::new(true));
    let is_late = Arc::clone(&late);
    let count = Arc::new(Mutex::new(0_u16));
    let counted = Arc::clone(&count);
    let _modules = Modules::start(
        &wire,
        Box::new(move |request| {
            if request[0] == 1 && is_late.load(Ordering::Relaxed) {
                // The late response has the address of unit 2 and contains 99 °C. It comes in the middle of the time from the timeout
                // to the end of the silence that is waited for.
                *counted.lock().unwrap() += 1;
                let mut answer = vec![2, 3, 8];
                answer.extend([990_u16; 4].iter().flat_map(|word| word.to_be_bytes()));
                return Some((Duration::from_millis(750), answer));
            }
            Some((Duration::ZERO, registers(request)))
        }),
    );
    let mut config = config(wire.bus(), &[1, 2]);
    config.answer_within = Duration::from_millis(500);
    let mut thermometer = poll_temperatures(config).unwrap();
    until("several late responses", || {
        for (sensor, found) in thermometer.latest().iter().enumerate() {
            if let Some(degc) = found.degc {
                assert!(sensor >= 4 && (22.0..22.5).contains(&degc), "{sensor}: {degc}");
            }
        }
        *count.lock().unwrap() > 4
    });
    assert_eq!(thermometer.latest()[0].quality, Quality::Bad(Reason::NoAnswer));
    late.store(false, Ordering::Relaxed);
    until("unit 1 is back", || thermometer.latest()[0].quality == Quality::Good);
    assert!((thermometer.latest()[0].degc.unwrap() - 21.1).abs() < 1e-9);
}

/// A module that answers twice: the second answer, which comes while the line is idle, is not taken for that to the next request.
#[test]
fn a_second_response_is_discarded() {
    let Some(wire) = Wire::new() else { return };
    let port = OpenOptions::new().write(true).open(&wire.theirs).unwrap();
    let asked = Arc::new(Mutex::new(0_u16));
    let counted = Arc::clone(&asked);
    let _modules = Modules::start(
        &wire,
        Box::new(move |request| {
            let mut asked = counted.lock().unwrap();
            *asked += 1;
            let mut answer = vec![request[0], request[1], 8];
            answer.extend([*asked; 4].iter().flat_map(|word| word.to_be_bytes()));
            let mut again = answer.clone();
            again.extend(crc(&answer));
            let mut port = port.try_clone().unwrap();
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(20));
                port.write_all(&again).unwrap();
            });
            Some((Duration::ZERO, answer))
        }),
    );
    let mut config = config(wire.bus(), &[1]);
    config.interval = Duration::from_millis(500);
    let mut thermometer = poll_temperatures(config).unwrap();
    for request in 2..=4 {
        until("the response to the last request", || {
            let number = *asked.lock().unwrap();
            let expected = f64::from(number) * 0.1;
            let found = thermometer.latest()[0].degc;
            number >= request && found.is_some_and(|degc| (degc - expected).abs() < 1e-9)
        });
    }
}

/// A response with too few or too many values, or one that confirms another write, is refused: missing inputs would be read as off, and a sensor
/// without its fault bit as good.
#[test]
fn a_response_to_another_request_is_refused() {
    let profile = "name = \"x\"\n[digital]\ninputs = 12\noutputs = 8\n";
    let profile = Profile::parse(profile).unwrap();
    for (inputs, coils, confirmation, levels, confirmed) in [
        (&[1, 2, 2, 0x34, 0x12][..], &[1, 1, 1, 7][..], &[1, 15, 0, 0, 0, 8][..], Ok(0x234), true),
        (&[1, 2, 2, 0x34, 0x12], &[1, 1, 1, 7], &[1, 15, 0, 9, 0, 8], Ok(0x234), false),
        (&[1, 2, 2, 0x34, 0x12], &[1, 1, 1, 7], &[1, 15, 0, 0, 0, 3], Ok(0x234), false),
        (&[1, 2, 1, 0x34], &[1, 1, 1, 7], &[1, 15, 0, 0, 0, 8], Err(()), false),
        (&[1, 2, 3, 0x34, 0x12, 0], &[1, 1, 1, 7], &[1, 15, 0, 0, 0, 8], Err(()), false),
    ] {
        let Some(wire) = Wire::new() else { return };
        let answers = [inputs, coils, confirmation].map(<[u8]>::to_vec);
        let asked = Arc::new(Mutex::new([0_u32; 3]));
        let counted = Arc::clone(&asked);
        let _modules = Modules::start(
            &wire,
            Box::new(move |request| {
                let which = [2, 1, 15].iter().position(|function| *function == request[1]).unwrap();
                counted.lock().unwrap()[which] += 1;
                Some((Duration::ZERO, answers[which].clone()))
            }),
        );
        let modules = [DigitalModule { unit: 1, profile: profile.clone() }];
        let within = Duration::from_millis(100);
        let mut port =
            ModbusDigital::new(wire.bus(), &modules, within, Backoff::default()).unwrap();
        let now = Instant::now();
        until("the inputs are read", || asked.lock().unwrap()[0] > 3);
        if levels.is_ok() {
            until("a read succeeds", || port.read(now).is_ok());
            until("a write is sent", || {
                let _ = port.write(0xa5, Instant::now() + Duration::from_secs(5));
                let _ = port.read(now);
                asked.lock().unwrap()[2] > 3
            });
        }
        if let Ok(levels) = levels {
            until("these levels", || port.read(now).is_ok_and(|found| found.levels == levels));
        } else {
            assert!(port.read(now).is_err());
        }
        if confirmed {
            until("it is confirmed", || {
                let _ = port.write(0xa5, Instant::now() + Duration::from_secs(5));
                let _ = port.read(now);
                port.confirmed() == Some(0xa5)
            });
        } else {
            assert_ne!(port.confirmed(), Some(0xa5), "{confirmation:?}");
        }
    }
    let Some(wire) = Wire::new() else { return };
    let registers = [1, 4, 12, 0, 200, 0, 201, 0, 202, 0, 203, 0, 204, 0, 205];
    let _modules = Modules::start(
        &wire,
        Box::new(move |request| {
            let answer = if request[1] == 4 { registers.to_vec() } else { vec![1, 2, 0] };
            Some((Duration::ZERO, answer))
        }),
    );
    let mut config = config(wire.bus(), &[1]);
    config.units[0].profile = Profile::named("ICP-DAS-M-7015").unwrap();
    let mut thermometer = poll_temperatures(config).unwrap();
    until("an answer", || thermometer.latest()[0].taken.is_some());
    assert_eq!(thermometer.latest()[0].quality, Quality::Bad(Reason::NoAnswer));
}

/// A line on which bytes never cease makes the temperatures bad.
#[test]
fn a_line_that_is_never_silent_is_reported() {
    let Some(wire) = Wire::new() else { return };
    let mut noise = OpenOptions::new().write(true).open(&wire.theirs).unwrap();
    std::thread::spawn(move || {
        // As fast as the line takes it, so that some always wait.
        while noise.write_all(&[0x55; 64]).is_ok() {}
    });
    let mut thermometer = poll_temperatures(config(wire.bus(), &[1])).unwrap();
    until("the reason is reported", || {
        thermometer.latest()[0].quality == Quality::Bad(Reason::NoAnswer)
    });
}

/// A truncated response and a response with a wrong checksum give no value; the next response is good.
#[test]
fn corrupted_responses_are_rejected() {
    let Some(wire) = Wire::new() else { return };
    let turn = Arc::new(Mutex::new(0_usize));
    let counted = Arc::clone(&turn);
    let _modules = Modules::start(
        &wire,
        Box::new(move |request| {
            let mut turn = counted.lock().unwrap();
            *turn += 1;
            let mut answer = registers(request);
            if turn.is_multiple_of(2) {
                return Some((Duration::ZERO, answer));
            }
            // The response loses at least two of its eleven bytes; then one byte and a valid checksum are added. Only
            // the byte count reveals the truncation.
            answer.truncate((*turn / 2) % 10);
            answer.push(0xee);
            Some((Duration::ZERO, answer))
        }),
    );
    let mut config = config(wire.bus(), &[1]);
    config.answer_within = Duration::from_millis(30);
    let mut thermometer = poll_temperatures(config).unwrap();
    until("every truncation", || {
        for (sensor, found) in thermometer.latest().iter().enumerate() {
            if let Some(degc) = found.degc {
                #[expect(clippy::cast_precision_loss, reason = "four sensors")]
                let expected = 21.1 + 0.1 * sensor as f64;
                assert!((degc - expected).abs() < 1e-9, "{sensor}: {degc}");
            }
        }
        *turn.lock().unwrap() > 40
    });
}

#[test]
fn an_unplugged_adapter_reconnects() {
    let Some(wire) = Wire::new() else { return };
    let bus = wire.bus();
    let answer = || Box::new(|request: &[u8]| Some((Duration::ZERO, registers(request))));
    let modules = Modules::start(&wire, answer());
    let mut thermometer = poll_temperatures(config(bus, &[1])).unwrap();
    let good = |t: &mut Published| t.latest()[0].quality == Quality::Good;
    until("it responds", || good(&mut thermometer));
    let (ours, theirs) = (wire.ours.clone(), wire.theirs.clone());
    drop(wire);
    drop(modules);
    until("the reason is reported", || {
        thermometer.latest()[0].quality == Quality::Bad(Reason::NoAnswer)
    });
    // Connects the adapter again under its old device name.
    std::fs::create_dir_all(ours.parent().unwrap()).unwrap();
    let again = Wire {
        _socat: crate::socat(&ours, &theirs),
        _folder: tempfile::tempdir().unwrap(),
        ours,
        theirs,
    };
    until("the ports are back", || again.ours.exists() && again.theirs.exists());
    let _modules = Modules::start(&again, answer());
    until("it responds again", || good(&mut thermometer));
    std::fs::remove_dir_all(again.ours.parent().unwrap()).unwrap();
}

/// Reads and writes never wait for the line: a read returns the last inputs received, a write queues the outputs to be
/// sent next.
#[test]
fn digital_modules_form_one_port() {
    let Some(wire) = Wire::new() else { return };
    let outputs = Arc::new(Mutex::new([0xf1, 0xf2]));
    let taken = Arc::clone(&outputs);
    let requests = Arc::new(Mutex::new(0_u32));
    let polled = Arc::clone(&requests);
    let power = Arc::new(AtomicBool::new(true));
    let has_power = Arc::clone(&power);
    let _modules = Modules::start(
        &wire,
        Box::new(move |request| {
            let unit = request[0];
            *polled.lock().unwrap() += 1;
            let coils = &mut *taken.lock().unwrap();
            if unit == 2 && !has_power.load(Ordering::Relaxed) {
                coils[1] = 0;
                return None;
            }
            let answer = if request[1] == 2 {
                vec![unit, 2, 1, 0x30 + unit]
            } else if request[1] == 1 {
                vec![unit, 1, 1, coils[usize::from(unit - 1)]]
            } else {
                coils[usize::from(unit - 1)] = request[7];
                request[..6].to_vec()
            };
            Some((Duration::ZERO, answer))
        }),
    );
    let profile = Profile::named("WAVESHARE-IO-8CH").unwrap();
    let modules = [1, 2].map(|unit| DigitalModule { unit, profile: profile.clone() });
    let within = Duration::from_secs(1);
    let mut port = ModbusDigital::new(wire.bus(), &modules, within, Backoff::default()).unwrap();
    assert_eq!((port.inputs(), port.outputs()), (16, 16));
    // 2 · (14 + 18) characters of 11 bits at 19200 Bd, plus pauses between frames.
    let cycle = port.shortest_cycle().as_secs_f64() * 1e3;
    assert!((40.0..70.0).contains(&cycle), "{cycle} ms");
    let soon = Instant::now() + Duration::from_secs(600);
    until("a read succeeds", || port.read(soon).is_ok_and(|found| found.levels == 0x3231));
    assert_eq!(port.confirmed(), Some(0xf2f1), "as reported by the modules");
    let before = *requests.lock().unwrap();
    for _ in 0..1000 {
        port.read(soon).unwrap();
        port.write(0xa55a, soon).unwrap();
    }
    let exchanged = *requests.lock().unwrap() - before;
    assert!(exchanged < 500, "a thousand calls waited for {exchanged} requests");
    until("the write arrives", || *outputs.lock().unwrap() == [0x5a, 0xa5]);
    // When a module that lost power answers again, its outputs are read back.
    power.store(false, Ordering::Relaxed);
    // While the module is off, its last inputs are returned with their age.
    let off = Instant::now();
    until("the output levels are unknown", || {
        port.read(soon).unwrap();
        port.confirmed().is_none()
    });
    let found = port.read(soon).unwrap();
    assert!(found.levels == 0x3231 && found.taken <= off);
    power.store(true, Ordering::Relaxed);
    let on = Instant::now();
    until("a read succeeds again", || port.read(soon).unwrap().taken >= on);
    until("the outputs are known", || port.read(soon).is_ok() && port.confirmed() == Some(0x005a));
    drop(wire);
    until("the disconnection is reported", || port.read(soon) == Err(Fault::NotConnected));
}

#[test]
fn invalid_configurations_are_rejected() {
    let bus = || volcomp_modbus::Bus::Tcp { host: "127.0.0.1".to_owned(), port: 1 };
    let message = |change: fn(&mut volcomp_modbus::ThermometerConfig)| {
        let mut config = config(bus(), &[1, 2]);
        change(&mut config);
        poll_temperatures(config).err().unwrap().to_string()
    };
    assert!(message(|c| c.units.clear()).contains("modbus://127.0.0.1:1: no sensor is named"));
    assert!(
        message(|c| c.units[1].names[0] = "a1".to_owned())
            .contains("the sensor a1 is listed twice")
    );
    assert!(
        message(|c| c.units[0].names.push("e".to_owned()))
            .contains("5 names for the 4 channels of PTA8C04")
    );
    assert!(
        message(|c| c.units[0].profile = Profile::named("ADAM-6050").unwrap())
            .contains("ADAM-6050 has no temperatures")
    );
    let module = DigitalModule { unit: 1, profile: Profile::named("PTA8C04").unwrap() };
    let refused = ModbusDigital::new(bus(), &[module], Duration::ZERO, Backoff::default());
    assert!(refused.err().unwrap().to_string().contains("has no digital lines"));
    // Without a server, the sensors are bad, but starting succeeds.
    let mut thermometer = poll_temperatures(config(bus(), &[1])).unwrap();
    until("the reason is reported", || {
        thermometer.latest()[0].quality == Quality::Bad(Reason::NoAnswer)
    });
}
