//! One axis under the guard: its correction while positions are missing, and after the control was reset.
//!
//! `cargo run -p volcomp-guard --example faults`

use std::time::Duration;

use volcomp_guard::{
    AxisLimits, CorrectionReport, Guard, Inputs, Limits, LimitsError, ReadBack, Reading, Request,
    RequestedCorrection, State,
    vocabulary::{AxisKind, MAX_AXES, PerChannel},
};

const PERIOD: Duration = Duration::from_millis(4);

fn main() -> Result<(), LimitsError> {
    let mut axes = [AxisLimits::NONE; MAX_AXES];
    axes[0] = AxisLimits {
        kind: AxisKind::Linear,
        limit: 0.050, // mm
        warn: 0.040,
        slew_per_s: 0.2,
        accel_per_s2: f64::INFINITY,
        resolution: 0.001,
        includes_correction: false,
    };
    let limits = Limits {
        axes,
        count: 1,
        period: PERIOD,
        hold: Duration::from_millis(50),
        zero_after: Duration::from_millis(400),
        ramp: Duration::from_millis(200),
        test_shift: PerChannel::ZERO,
        read_back_cycles: 1,
        only_thermal: false,
    };
    let mut guard = Guard::new(limits)?;
    let mut read_back = ReadBack::plain(Duration::ZERO);

    // The model requests 30 µm in every cycle; the control applies every write.
    let mut applied = PerChannel::ZERO;
    let mut target = PerChannel::ZERO;
    target[0] = 0.030;
    let (mut last_state, mut largest_step) = (State::Disarmed, 0.0_f64);
    for cycle in 1..=750_u32 {
        let now = PERIOD * cycle;
        if cycle == 500 {
            println!("{:6.3} s  the control is reset: it applies 0", now.as_secs_f64());
            applied = PerChannel::ZERO;
        }
        // No positions from 0.8 s to 1.6 s.
        let answers = !(200..400).contains(&cycle);
        let told =
            if answers { CorrectionReport::Values(applied) } else { CorrectionReport::Missing };
        read_back.receive(now, now, &told, &limits);
        let output = guard.cycle(&Inputs {
            now,
            reading: answers.then_some(Reading { taken: now, positions: PerChannel::ZERO }),
            read_back: *read_back.status(),
            requested: Some(RequestedCorrection::linear(target)),
            // Three equal readings, one path delay apart, confirm the applied correction.
            request: (cycle == 10).then_some(Request::Arm),
            ..Inputs::default()
        });
        if output.write {
            largest_step = largest_step.max((output.correction[0] - applied[0]).abs());
            applied = output.correction;
            read_back.sent(now, &output.correction, true);
        }
        if output.state != last_state {
            last_state = output.state;
            let why: Vec<&str> = output.reasons.texts().collect();
            println!(
                "{:6.3} s  {:12} {:5.1} µm  {}",
                now.as_secs_f64(),
                output.state.name(),
                1e3 * applied[0],
                why.join(", ")
            );
        }
    }
    println!("largest step that reached the axis: {:.0} µm", 1e3 * largest_step);
    // Slew of 0.2 mm/s in a cycle of 4 ms: below one output step of the control.
    assert!(largest_step < 0.0021 && guard.state() == State::Compensating);
    Ok(())
}
