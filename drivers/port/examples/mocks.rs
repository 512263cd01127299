//! Tests code that drives a machine without a machine: mocks of the three traits replace control, thermometer and
//! digital lines. Each mock answers as the test prescribes and fails the test on an unexpected call.
//!
//! ```text
//! cargo run -p volcomp-port --example mocks
//! ```

use std::time::{Duration, Instant};

use volcomp_port::{
    Controller, ControllerState, DigitalIo, Fault, InputLevels, MockController, MockDigitalIo,
    MockThermometer, Snapshot, Temperature, Thermometer, vocabulary::PerChannel,
};

/// Thermal expansion of the scale, 1/K.
const EXPANSION_PER_K: f64 = 11.5e-6;

/// The code under test: corrects the thermal expansion of the first axis while the first digital line permits
/// corrections.
fn correct_growth(
    controller: &mut impl Controller,
    thermometer: &mut impl Thermometer,
    lines: &mut impl DigitalIo,
    deadline: Instant,
) -> Result<f64, Fault> {
    let permitted = lines.read(deadline)?.levels & 1 == 1;
    let degc = thermometer.latest()[0].degc;
    let position_mm = controller.read(deadline)?.positions[0];
    let correction_mm = match degc {
        Some(degc) if permitted => -EXPANSION_PER_K * (degc - 20.0) * position_mm,
        _ => 0.0,
    };
    controller.apply(&PerChannel::leading([correction_mm]), deadline)?;
    Ok(correction_mm)
}

fn main() -> Result<(), Fault> {
    for (levels, degc, expected_mm) in [
        (1, Some(22.0), -0.0115),
        (1, None, 0.0), // the sensor is broken
        (0, Some(22.0), 0.0),
    ] {
        let now = Instant::now();

        let mut lines = MockDigitalIo::new();
        lines.expect_read().returning(move |_| Ok(InputLevels::now(levels)));

        let mut thermometer = MockThermometer::new();
        let reading = Temperature { degc, ..Temperature::good(20.0, now) };
        thermometer.expect_latest().return_const(vec![reading]);

        let mut controller = MockController::new();
        let snapshot = Snapshot {
            positions: PerChannel::leading([500.0]),
            taken: now,
            uncertainty: Duration::ZERO,
            state: ControllerState::default(),
            state_taken: now,
            applied: None,
            report: None,
            correction_taken: now,
        };
        controller.expect_read().returning(move |_| Ok(snapshot));
        controller
            .expect_apply()
            .withf(move |corrections, _| (corrections[0] - expected_mm).abs() < 1e-12)
            .times(1)
            .returning(|_, _| Ok(()));

        let deadline = now + Duration::from_millis(4);
        let correction_mm =
            correct_growth(&mut controller, &mut thermometer, &mut lines, deadline)?;
        println!("line {levels}, {degc:?} degC: correction {correction_mm:+.4} mm");
    }
    Ok(())
}
