//! Conformance tests for the traits of this crate, for the tests of each implementation. They panic with the rule that
//! is violated.

use std::time::{Duration, Instant};

use volcomp_vocabulary::PerChannel;

use crate::{Controller, DigitalIo, Fault, Quality, Snapshot, Thermometer, Words};

const PATIENCE: Duration = Duration::from_secs(2);

fn soon() -> Instant {
    Instant::now() + PATIENCE
}

/// Polls until the condition holds, because some devices report a write with a delay. Panics after a timeout of 2 s.
fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let until = soon();
    while !holds() {
        assert!(Instant::now() < until, "{what}: not within {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Checks a connected controller at standstill: description, readings and writes must be consistent.
///
/// # Panics
/// If a rule of the trait is violated. The message names the rule.
pub fn controller(device: &mut impl Controller) {
    let description = device.description().clone();
    assert!(!description.device.is_empty() && !description.channel.is_empty());
    if let Err(unfit) = description.check() {
        panic!("{}: {unfit}", description.device);
    }
    let before = Instant::now();
    let first = device.read(soon()).expect("a connected controller reads");
    let within = first.taken + first.uncertainty >= before
        && first.taken <= Instant::now() + first.uncertainty;
    assert!(within, "the time stamp is not of this call");
    assert!(first.positions.iter().all(|p| p.is_finite()));
    let beyond = &first.positions[description.shown_axes().count()..];
    assert!(beyond.iter().all(|p| *p == 0.0), "numbers beyond the axes");

    if description.barrier {
        barrier(device, &first);
    } else {
        plain_values(device, &first);
    }
    // A call with an expired deadline must end in time, and leave the device usable.
    let begun = Instant::now();
    let _ = device.read(begun);
    assert!(begun.elapsed() < PATIENCE, "a passed deadline must end the call");
    eventually("it reads again after a passed deadline", || device.read(soon()).is_ok());
}

/// Checks that a controller without a barrier applies written corrections and, if it has a read-back, reports them.
fn plain_values(device: &mut impl Controller, first: &Snapshot) {
    let description = device.description().clone();
    assert_eq!(first.report, None, "a report, but no barrier");
    assert!(
        matches!(device.post(&Words::EMPTY, soon()), Err(Fault::Unsupported(_))),
        "a frame was taken, but there is no barrier"
    );
    let mut small_steps = PerChannel::ZERO;
    for (index, axis) in description.axes.iter().enumerate() {
        let steps = [7.0, -5.0, 3.0][index % 3];
        small_steps[index] = steps * axis.step();
    }
    for corrections in [small_steps, PerChannel::ZERO] {
        device.apply(&corrections, soon()).expect("it takes corrections");
        let close = |applied: &PerChannel<f64>| {
            description.axes.iter().enumerate().all(|(index, axis)| {
                (applied[index] - corrections[index]).abs() <= 0.51 * axis.step()
            })
        };
        if first.applied.is_some() {
            eventually("what was applied is read back", || {
                let applied = device.read(soon()).ok().and_then(|s| s.applied);
                applied.as_ref().is_some_and(close)
            });
        }
    }
}

/// Checks a controller with a barrier. Reports must arrive and advance. Invalid frames must be sent like valid ones,
/// because only the barrier rejects them. Plain corrections must be rejected.
fn barrier(device: &mut impl Controller, first: &Snapshot) {
    assert_eq!(first.applied, None, "with a barrier only its reports show the applied correction");
    let mut earlier = None;
    eventually("reports move on", || {
        let report = device.read(soon()).ok().and_then(|s| s.report);
        report.is_some_and(|report| report != *earlier.get_or_insert(report))
    });
    let senseless = Words::new(&[0x5555; 12]).expect("few words");
    device.post(&senseless, soon()).expect("it carries frames");
    assert!(
        matches!(device.apply(&PerChannel::ZERO, soon()), Err(Fault::Unsupported(_))),
        "plain values were taken in spite of the barrier"
    );
}

/// Checks a digital port. If `wired` is set, each output is connected to the input of the same number.
///
/// # Panics
/// If a rule of the trait is violated. The message names the rule.
pub fn digital_io(device: &mut impl DigitalIo, wired: bool) {
    assert!(!device.device().is_empty());
    assert!(device.inputs() <= 64 && device.outputs() <= 64);
    let outputs = device.outputs();
    let all = |lines: u32| u64::MAX.checked_shr(64 - lines).unwrap_or(0);
    let both = device.inputs().min(outputs);
    for levels in [0, 0x5555_5555_5555_5555, 0xaaaa_aaaa_aaaa_aaaa, u64::MAX, 0] {
        device.write(levels & all(outputs), soon()).expect("it writes");
        let found = device.read(soon()).expect("it reads");
        assert!(found.taken <= Instant::now(), "levels are not of the future");
        assert_eq!(found.levels & !all(device.inputs()), 0, "bits beyond the inputs");
        if device.confirmed().is_some() {
            eventually("what was written is confirmed", || {
                let _ = device.read(soon());
                device.confirmed() == Some(levels & all(outputs))
            });
        }
        if wired {
            eventually("outputs come back on the inputs", || {
                device.read(soon()).is_ok_and(|found| (found.levels ^ levels) & all(both) == 0)
            });
        }
    }
}

/// Checks that the names of a thermometer are unique, and that every sensor becomes good within 2 s.
///
/// # Panics
/// If a rule of the trait is violated. The message names the rule.
pub fn thermometer(device: &mut impl Thermometer) {
    assert!(!device.device().is_empty() && !device.names().is_empty());
    let mut names = device.names().to_vec();
    assert_eq!(device.latest().len(), names.len());
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), device.names().len(), "a name is listed twice");
    eventually("every sensor is good", || {
        device.latest().iter().all(|t| t.quality == Quality::Good)
    });
    for temperature in device.latest() {
        let degc = temperature.degc.expect("good, so there is a number");
        assert!((-273.15..2000.0).contains(&degc), "{degc}");
        assert!(temperature.taken.is_some_and(|taken| taken <= Instant::now()));
    }
}
