use std::time::Duration;

use volcomp_guard::{Rejected, SensorCheck, SensorLimits};

fn at(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

#[test]
fn every_way_to_be_wrong() {
    let limits = SensorLimits::default();
    let mut sensor = SensorCheck::default();
    let mut check = |now: u64, degc: Option<f64>, taken: u64| {
        sensor.check(at(now), degc, Some(at(taken)), &limits)
    };
    assert_eq!(check(1, Some(21.0), 1), Ok(21.0));
    assert_eq!(check(2, None, 2), Err(Rejected::Broken));
    assert_eq!(check(3, Some(f64::NAN), 3), Err(Rejected::OutOfRange));
    assert_eq!(check(4, Some(850.0), 4), Err(Rejected::OutOfRange));
    assert_eq!(check(5, Some(23.0), 5), Err(Rejected::Jumping));
    assert_eq!(check(40, Some(21.0), 5), Err(Rejected::Stale));
    // 5 K in a minute is fast enough for that.
    assert_eq!(check(65, Some(25.0), 65), Ok(25.0));
    // The same reading again and again is fine.
    assert_eq!(check(66, Some(25.0), 65), Ok(25.0));
    let never = SensorCheck::default().check(at(1), Some(20.0), None, &limits);
    assert_eq!(never, Err(Rejected::Broken));
}
