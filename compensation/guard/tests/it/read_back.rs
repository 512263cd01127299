//! Age of corrections that are reported in separate messages.

use std::time::Duration;

use volcomp_guard::{ControlTimeOut, CorrectionReport, ReadBack, ReadBackStatus};
use volcomp_vocabulary::PerChannel;

use crate::world::{PERIOD, STEP, limits};

const MS: Duration = Duration::from_millis(1);

/// Receives the same values in several cycles, each dated `late` before the cycle; returns the last status and its time.
fn received(read_back: &mut ReadBack, late: Duration) -> (ReadBackStatus, Duration) {
    let (limits, values) = (limits(), PerChannel::leading([5.0 * STEP]));
    let mut now = Duration::from_secs(1);
    for _ in 0..20 {
        now += PERIOD;
        read_back.receive(
            now,
            now.saturating_sub(late),
            &CorrectionReport::Values(values),
            &limits,
        );
    }
    (*read_back.status(), now)
}

/// A reading confirms the correction at the time of the reading, also if it is received later; a reading older than
/// `hold` confirms no correction.
#[test]
fn a_reading_confirms_as_of_its_own_time() {
    let hold = limits().hold;
    for late in [Duration::ZERO, 7 * MS, hold] {
        let (known, now) = received(&mut ReadBack::plain(Duration::ZERO), late);
        let confirmed = known.confirmed.expect("three equal readings");
        assert_eq!(confirmed.at, now.saturating_sub(late));
        assert!((confirmed.values[0] - 5.0 * STEP).abs() < 1e-12);
    }
    let (known, _) = received(&mut ReadBack::plain(Duration::ZERO), hold + MS);
    assert_eq!((known.confirmed, known.writable), (None, false));
}

/// A repeated reading ages and permits no write. Only time in which readings arrive counts towards the time of missing
/// corrections.
#[test]
fn a_repeated_reading_ages() {
    let limits = limits();
    let mut read_back = ReadBack::plain(Duration::ZERO);
    let (known, last) = received(&mut read_back, Duration::ZERO);
    let values = known.confirmed.expect("confirmed").values;
    let mut now = last;
    for _ in 0..2000 {
        now += PERIOD;
        read_back.receive(now, last, &CorrectionReport::Values(values), &limits);
        read_back.sent(now, &PerChannel::leading([6.0 * STEP]), true);
    }
    let known = read_back.status();
    assert_eq!(known.confirmed.map(|confirmed| confirmed.at), Some(last));
    assert!(!known.writable);
    let unlanded = known.unlanded_since.map(|since| now.saturating_sub(since));
    assert!(unlanded.is_some_and(|time| time < limits.zero_after), "{unlanded:?}");
}

#[test]
fn late_readings_reveal_the_levels_of_lines() {
    let control = ControlTimeOut { after: 200 * MS, to_zero: 100 * MS };
    for control in [None, Some(control)] {
        let mut read_back = ReadBack::no_read_back(control);
        let unknown = PerChannel::from_fn(|_| f64::NAN);
        read_back.restore(Duration::ZERO, &unknown, Duration::ZERO, &limits());
        assert_eq!(read_back.status().confirmed, None);
        let (known, now) = received(&mut read_back, 7 * MS);
        let at = known.confirmed.map(|confirmed| confirmed.at);
        // Lines do not show whether their control has ramped to zero.
        let expected = if control.is_none() { now.saturating_sub(7 * MS) } else { now };
        assert_eq!(at, Some(expected), "{control:?}");
        assert!(known.writable);
    }
}

#[test]
fn extreme_times_and_counts_do_not_panic() {
    use volcomp_guard::{
        BarrierLink, ControlTimeOut, Limits, barrier::Settings, barrier_misfits, scans_fit,
    };
    let limits = Limits { count: 1000, ..crate::world::limits() };
    let settings = Settings {
        axes: crate::world::layout(),
        machine: 1,
        limit: PerChannel([1; 9]),
        rate: PerChannel([0; 9]),
        step_scans: u16::MAX,
        hold_scans: u16::MAX,
        time_out_scans: u16::MAX,
    };
    let endless = Duration::MAX;
    assert!(barrier_misfits(&settings, endless, &limits).count() > 0);
    assert!(!scans_fit(u32::MAX, Duration::from_secs(1), endless));
    let time_out = ControlTimeOut { after: endless, to_zero: endless };
    for mut read_back in [
        ReadBack::plain(endless),
        ReadBack::no_read_back(Some(time_out)),
        ReadBack::barrier(BarrierLink::new(1, 2, crate::world::layout(), endless)),
    ] {
        for now in [Duration::ZERO, endless] {
            let values = PerChannel([0.001; 9]);
            read_back.receive(now, now, &CorrectionReport::Values(values), &limits);
            read_back.restore(now, &values, endless, &limits);
            read_back.sent(now, &values, true);
            read_back.receive(now, endless, &CorrectionReport::Barrier(&[u16::MAX; 60]), &limits);
            read_back.take_over(now, false);
            read_back.acknowledge(now);
            let _ = (read_back.zero_after_last_write(&limits), read_back.status().holds(&limits));
        }
    }
}
