//! The tests that every implementation of a trait passes, to be called from its own tests. Each panics with
//! what is wrong.

use std::time::{Duration, Instant};

use volcomp_vocabulary::PerChannel;

use crate::{Controller, DigitalIo, Quality, Thermometer};

const PATIENCE: Duration = Duration::from_secs(2);

fn soon() -> Instant {
    Instant::now() + PATIENCE
}

/// Reads until the condition holds; some devices show what was written only a little later.
fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let until = soon();
    while !holds() {
        assert!(Instant::now() < until, "{what}: not within {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A controller that is connected and stands still: what it describes, reads and applies fits together.
///
/// # Panics
/// With what is wrong.
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
    let beyond = &first.positions[description.axes.len()..];
    assert!(beyond.iter().all(|p| *p == 0.0), "numbers beyond the axes");

    let mut wanted = PerChannel::ZERO;
    for (index, axis) in description.axes.iter().enumerate() {
        let steps = [7.0, -5.0, 3.0][index % 3];
        wanted[index] = steps * axis.step();
    }
    for corrections in [wanted, PerChannel::ZERO] {
        device
            .apply(&corrections, soon())
            .expect("it takes corrections");
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
    // A deadline that has passed fails in time and leaves the device usable.
    let begun = Instant::now();
    let _ = device.read(begun);
    assert!(
        begun.elapsed() < PATIENCE,
        "a passed deadline must end the call"
    );
    eventually("it reads again after a passed deadline", || {
        device.read(soon()).is_ok()
    });
}

/// A digital port whose outputs come back on its inputs where `wired`, line by line.
///
/// # Panics
/// With what is wrong.
pub fn digital_io(device: &mut impl DigitalIo, wired: bool) {
    assert!(!device.device().is_empty());
    assert!(device.inputs() <= 64 && device.outputs() <= 64);
    let outputs = device.outputs();
    let all = |lines: u32| u64::MAX.checked_shr(64 - lines).unwrap_or(0);
    let both = device.inputs().min(outputs);
    for levels in [0, 0x5555_5555_5555_5555, 0xaaaa_aaaa_aaaa_aaaa, u64::MAX, 0] {
        device
            .write(levels & all(outputs), soon())
            .expect("it writes");
        let found = device.read(soon()).expect("it reads");
        assert_eq!(found & !all(device.inputs()), 0, "bits beyond the inputs");
        if wired {
            eventually("outputs come back on the inputs", || {
                device
                    .read(soon())
                    .is_ok_and(|found| (found ^ levels) & all(both) == 0)
            });
        }
    }
}

/// A thermometer whose sensors are all well, in the end.
///
/// # Panics
/// With what is wrong.
pub fn thermometer(device: &mut impl Thermometer) {
    assert!(!device.device().is_empty() && !device.names().is_empty());
    let mut names = device.names().to_vec();
    assert_eq!(device.latest().len(), names.len());
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), device.names().len(), "a name stands twice");
    eventually("every sensor is good", || {
        device.latest().iter().all(|t| t.quality == Quality::Good)
    });
    for temperature in device.latest() {
        let degc = temperature.degc.expect("good, so there is a number");
        assert!((-273.15..2000.0).contains(&degc), "{degc}");
        assert!(
            temperature
                .taken
                .is_some_and(|taken| taken <= Instant::now())
        );
    }
}
