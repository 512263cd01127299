//! A thread with the priority of a control thread that does nothing. It shows the wake-up latency of the computer
//! itself.
//!
//! `idle PERIOD_MS PRIORITY CPU SECONDS` prints for each second the second of the monotonic clock, the longest
//! wake-up (us) and the periods that were missed. `benches/soak` runs it together with the gateway.

use std::{io::Write, time::Duration};

use volcomp_runtime::{Realtime, schedule, tick};

fn main() {
    let arguments: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let [period_ms, priority, cpu, seconds] = arguments[..] else {
        eprintln!("expected PERIOD_MS PRIORITY CPU SECONDS");
        std::process::exit(2);
    };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "small numbers of a call"
    )]
    let config = Realtime { priority: priority as u8, cpu: Some(cpu as usize), reference: false };
    for lacking in schedule(config) {
        eprintln!("{lacking}");
    }
    let mut second = (0_u64, 0_u64, 0_u32);
    tick(
        Duration::from_secs_f64(period_ms * 1e-3),
        Duration::from_secs_f64(seconds),
        &mut |now, wake, missed| {
            if now.as_secs() != second.0 {
                if second.0 > 0 {
                    println!("{} {} {}", second.0, second.1 / 1000, second.2);
                    // The program that reads the output may have ended.
                    let _ = std::io::stdout().flush();
                }
                second = (now.as_secs(), 0, 0);
            }
            second.1 = second.1.max(u64::try_from(wake.as_nanos()).unwrap_or(u64::MAX));
            second.2 += missed;
        },
    );
}
