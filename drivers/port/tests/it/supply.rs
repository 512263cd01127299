use std::{
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use assert_no_alloc::assert_no_alloc;
use volcomp_port::{
    Backoff, DeviceError, Fault, Quality, Reason, Supply, Temperature, Thermometer, published,
};

const QUICK: Backoff = Backoff { first: Duration::from_millis(1), most: Duration::from_millis(4) };

struct Connection(Arc<AtomicUsize>);

impl Connection {
    fn new(alive: &Arc<AtomicUsize>) -> Self {
        alive.fetch_add(1, Ordering::SeqCst);
        Self(Arc::clone(alive))
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

fn until(holds: impl Fn() -> bool) {
    let end = Instant::now() + Duration::from_secs(10);
    while !holds() {
        assert!(Instant::now() < end, "never");
        std::thread::sleep(Duration::from_micros(200));
    }
}

#[test]
fn a_lost_connection_is_reopened_and_dropped() {
    let alive = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&alive);
    let mut supply = Supply::new("test", QUICK, move || Ok(Connection::new(&counted))).unwrap();
    for round in 1..=300 {
        supply.wait(Duration::from_secs(5)).unwrap();
        assert!(supply.current().is_ok());
        assert_eq!(supply.opened(), round);
        assert!(alive.load(Ordering::SeqCst) <= 2);
        supply.lose();
    }
    drop(supply);
    until(|| alive.load(Ordering::SeqCst) == 0);
}

#[test]
fn the_delay_restarts_after_a_lasting_connection() {
    let backoff = Backoff { first: Duration::from_millis(5), most: Duration::from_secs(10) };
    let mut supply = Supply::new("test", backoff, || Ok(())).unwrap();
    for round in 0..14 {
        let connected = supply.wait(Duration::from_secs(2)).is_ok();
        assert!(connected, "not again within 2 s of loss {round}");
        std::thread::sleep(Duration::from_millis(20));
        supply.lose();
    }
    // While connecting fails, the delay doubles up to the maximum.
    let mut pause = Duration::ZERO;
    let pauses = [5, 10, 20].map(Duration::from_millis);
    for expected in pauses {
        pause = backoff.next(pause, Duration::ZERO);
        assert_eq!(pause, expected);
    }
    assert_eq!(backoff.next(backoff.most, Duration::ZERO), backoff.most);
    assert_eq!(backoff.next(backoff.most, 2 * backoff.first), backoff.first);
}

#[test]
fn the_real_time_thread_does_not_allocate_or_free() {
    let alive = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&alive);
    let open = move || Ok((Connection::new(&counted), vec![0_u8; 4096]));
    let mut supply = Supply::new("test", QUICK, open).unwrap();
    let mut lost = 0;
    assert_no_alloc(|| {
        let end = Instant::now() + Duration::from_secs(20);
        while lost < 50 {
            assert!(Instant::now() < end, "never");
            if supply.current().is_ok() {
                supply.lose();
                assert!(supply.current().is_err(), "it was given up");
                lost += 1;
            }
            // Without a connection `lose` has no effect.
            supply.lose();
        }
    });
    drop(supply);
    until(|| alive.load(Ordering::SeqCst) == 0);
}

#[test]
fn failures_are_reported_and_retried() {
    let tries = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&tries);
    let mut supply = Supply::new("camera://x", QUICK, move || {
        if counted.fetch_add(1, Ordering::SeqCst) < 5 {
            Err(DeviceError::open("camera://x", "no answer", "plug it in"))
        } else {
            Ok(7)
        }
    })
    .unwrap();
    assert_eq!(supply.current().map(|n| *n), Err(Fault::NotConnected));
    until(|| tries.load(Ordering::SeqCst) > 1);
    let text = supply.last_error().map(|e| e.to_string());
    assert!(text.is_none_or(|text| text == "camera://x: no answer; plug it in"));
    until(|| tries.load(Ordering::SeqCst) > 5);
    assert_eq!(supply.wait(Duration::from_secs(5)).map(|n| *n).unwrap(), 7);
    assert!(supply.last_error().is_none());
}

#[test]
fn the_thread_ends_with_the_supply() {
    let alive = Arc::new(AtomicUsize::new(0));
    let held = Connection::new(&alive);
    let supply = Supply::<()>::new("gone", QUICK, move || {
        let _ = &held;
        Err(DeviceError::open("gone", "nothing", "nothing"))
    })
    .unwrap();
    drop(supply);
    until(|| alive.load(Ordering::SeqCst) == 0);
}

#[test]
fn the_latest_temperatures_are_published() {
    let (mut publisher, mut thermometer) =
        published("modbus", vec!["bed".to_owned(), "column".to_owned()]);
    assert_eq!(thermometer.latest()[0].quality, Quality::Bad(Reason::NotRead));
    let now = Instant::now();
    for degc in [20.0, 21.0, 22.0] {
        let reading = [Temperature::good(degc, now), Temperature::good(f64::NAN, now)];
        publisher.publish(&reading);
    }
    let latest = thermometer.latest();
    assert_eq!(latest[0].degc, Some(22.0));
    assert_eq!(latest[1].quality, Quality::Bad(Reason::NotANumber));
    assert_eq!(latest[1].degc, None);
}
