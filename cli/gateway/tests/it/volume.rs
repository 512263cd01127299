//! The figure that counts: what is left of the error over the whole volume, moving and warming up.

use std::time::Duration;

use volcomp_vocabulary::PerAxis;

use crate::bench::{Bench, PERIOD};

/// Lengths of the true error before and after, um, cycle by cycle; before an exchange the machine has moved on, so
/// the residual holds what a cycle of delay costs, too.
#[test]
fn the_error_goes_over_the_whole_volume_moving_and_warming_up() {
    let mut bench = Bench::compensating();
    // Well into the warming up, then through the whole program.
    bench.run(Duration::from_secs(5));
    let (mut before, mut after) = (Vec::new(), Vec::new());
    let mut above_floor = 0.0_f64;
    let (mut squares_before, mut squares_after) = (0.0, 0.0);
    for cycle in 0..(600_000 / 4) {
        // Channels and chain both begin with X, Y, Z.
        let applied = PerAxis(bench.applied().0);
        let report = bench.step(PERIOD, None);
        assert_eq!(report.state.name(), "compensating");
        if cycle % 50 != 0 {
            continue;
        }
        let degc: Vec<f64> = report
            .sensors
            .iter()
            .map_while(|sensor| sensor.degc)
            .collect();
        let positions = report.positions;
        // What was applied when the machine came here.
        let b = bench.truth.error(&positions, &degc).norm() * 1e3;
        let a = bench.truth.residual(&positions, &applied, &degc).norm() * 1e3;
        // What noise of the instrument and steps of 1 um allow: the same model at this very place, rounded.
        let rounded = report.wanted.map(|mm| (mm * 1e3).round() * 1e-3);
        let floor = bench.truth.residual(&positions, &rounded, &degc).norm() * 1e3;
        above_floor = above_floor.max(a - floor);
        (squares_before, squares_after) = (squares_before + b * b, squares_after + a * a);
        before.push(b);
        after.push(a);
    }
    let count = before.len() as f64;
    let rms = [
        (squares_before / count).sqrt(),
        (squares_after / count).sqrt(),
    ];
    let largest = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
    println!(
        "before: rms {:.1} um, largest {:.1}; after: rms {:.2}, largest {:.2}; {:.1} %; at most {above_floor:.2} um above the floor",
        rms[0],
        largest(&before),
        rms[1],
        largest(&after),
        100.0 * (rms[1] / rms[0] - 1.0)
    );
    assert!(rms[1] < 0.05 * rms[0], "{rms:?}");
    assert!(above_floor < 2.0, "{above_floor}");
}
