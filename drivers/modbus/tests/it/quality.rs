use std::time::{Duration, Instant};

use volcomp_modbus::{Judge, Limits};
use volcomp_port::{Quality, Reason, Temperature};

fn limits() -> Limits {
    Limits {
        stuck_after: Some(Duration::from_secs(60)),
        neighbours_k: Some(3.0),
        ..Limits::default()
    }
}

#[test]
fn jumps_are_bad_until_time_allows_them() {
    let start = Instant::now();
    let mut judge = Judge::new(limits(), 1);
    let mut see = |seconds: u64, degc: f64| {
        let taken = start + Duration::from_secs(seconds);
        judge
            .see(0, Some(degc), Temperature::good(degc, taken))
            .quality
    };
    assert_eq!(see(0, 20.0), Quality::Good);
    assert_eq!(see(1, 20.4), Quality::Good, "a step of the module");
    assert_eq!(see(2, 60.0), Quality::Bad(Reason::TooFast));
    assert_eq!(see(3, 20.5), Quality::Good, "it was a disturbance");
    assert_eq!(see(4, 30.0), Quality::Bad(Reason::TooFast));
    // 9.5 K need 108 s at 5 K/min.
    assert_eq!(see(100, 30.0), Quality::Bad(Reason::TooFast));
    assert_eq!(see(115, 30.0), Quality::Good);
    assert_eq!(see(116, 200.0), Quality::Bad(Reason::OutOfRange));
    assert_eq!(see(117, -40.0), Quality::Bad(Reason::OutOfRange));
}

#[test]
fn the_same_digits_for_too_long_are_uncertain() {
    let start = Instant::now();
    let mut judge = Judge::new(limits(), 1);
    let mut see = |seconds: u64, raw: f64| {
        let taken = start + Duration::from_secs(seconds);
        judge.see(0, Some(raw), Temperature::good(raw * 0.1, taken))
    };
    assert_eq!(see(0, 201.0).quality, Quality::Good);
    assert_eq!(see(59, 201.0).quality, Quality::Good);
    let stuck = see(60, 201.0);
    assert_eq!(
        (stuck.quality, stuck.degc),
        (Quality::Uncertain(Reason::Stuck), Some(20.1))
    );
    assert_eq!(see(61, 202.0).quality, Quality::Good);
    // What is bad already stays what it is.
    let bad = Temperature::bad(Reason::Open, start);
    assert_eq!(judge.see(0, None, bad), bad);
}

#[test]
fn a_sensor_apart_from_the_others_is_uncertain() {
    let now = Instant::now();
    let judge = Judge::new(limits(), 4);
    let compared = |degc: &[f64]| {
        let mut all: Vec<Temperature> = degc.iter().map(|t| Temperature::good(*t, now)).collect();
        judge.compare(&mut all);
        all.iter()
            .map(|t| t.quality == Quality::Uncertain(Reason::Disagrees))
            .collect::<Vec<_>>()
    };
    assert_eq!(compared(&[20.0, 21.0, 22.0, 22.9]), [false; 4]);
    assert_eq!(
        compared(&[20.0, 21.0, 27.0, 22.0]),
        [false, false, true, false]
    );
    assert_eq!(
        compared(&[20.0, 40.0]),
        [false; 2],
        "two cannot tell who is wrong"
    );
    assert_eq!(compared(&[20.0, f64::NAN, 40.0]), [false; 3]);
}
