//! Tests of the decoding of responses, and of invalid configurations.

use std::time::{Duration, Instant};

use volcomp_sinumerik::{
    Nodes, Reading, Security, Server, SinumerikConfig, SinumerikError, Value, lag,
};
use volcomp_vocabulary::AxisName;

fn config() -> SinumerikConfig {
    let mut config = SinumerikConfig::new(Server::new("opc.tcp://192.0.2.7:4840"), &[AxisName::X]);
    config.reads = vec![AxisName::C];
    config.nodes.referenced = Some("/Plc/DB{db}.DBX60.4".to_owned());
    config.nodes.alarm = Some("/Alarm".to_owned());
    config
}

fn values(numbers: &[f64]) -> Vec<Value> {
    let of = |number: &f64| Value { number: Some(*number), age: None };
    numbers.iter().map(of).collect()
}

#[test]
fn responses_are_decoded_in_order() {
    let reading = Reading::new(&config());
    assert_eq!(
        reading.nodes(),
        [
            "/Channel/MachineAxis/actToolBasePos[u1,1]",
            "/Channel/MachineAxis/actToolBasePos[u1,2]",
            "/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u1]",
            "/NC/_N_AX_TEA_ACX/$MA_TEMP_COMP_TYPE[u1]",
            "/Plc/DB31.DBX60.4",
            "/Plc/DB32.DBX60.4",
            "/Alarm",
        ]
    );
    let now = Instant::now();
    let later = now + Duration::from_millis(20);
    let good = values(&[12.5, 180.0, -0.01, 1.0, 1.0, 1.0, 0.0]);
    let snapshot = reading.snapshot(&good, now, later).unwrap();
    assert_eq!(snapshot.positions[0], 12.5);
    assert!((snapshot.positions[1] - std::f64::consts::PI).abs() < 1e-12);
    assert_eq!(snapshot.applied.unwrap()[0], -0.01);
    assert_eq!(snapshot.taken, now + Duration::from_millis(10));
    assert!(snapshot.state.referenced && !snapshot.state.alarm && !snapshot.state.emergency_stop);

    // The oldest position determines the time of the snapshot; the age of a setting has no influence.
    let mut aged = good.clone();
    aged[1].age = Some(Duration::from_millis(7));
    aged[2].age = Some(Duration::from_secs(1000));
    let snapshot = reading.snapshot(&aged, now, later).unwrap();
    assert_eq!(snapshot.taken, now + Duration::from_millis(3));
    assert_eq!(snapshot.correction_taken, now + Duration::from_millis(10));

    // Unknown state values forbid the correction.
    let mut missing = good.clone();
    missing[5].number = None;
    missing[6].number = None;
    let state = reading.snapshot(&missing, now, later).unwrap().state;
    assert!(!state.referenced && state.alarm);
    // A snapshot needs a number for each position and each setting.
    for place in [0, 1, 2, 3] {
        for number in [None, Some(f64::NAN)] {
            let mut missing = good.clone();
            missing[place].number = number;
            let error = reading.snapshot(&missing, now, later).unwrap_err();
            assert!(matches!(error, SinumerikError::Node { .. }), "{place}: {error}");
        }
    }
    for kind in [0.0, 2.0, 4.0, -1.0, 1e300] {
        let mut off = good.clone();
        off[3].number = Some(kind);
        let error = reading.snapshot(&off, now, later).unwrap_err();
        assert!(matches!(error, SinumerikError::SwitchedOff { .. }), "{kind}: {error}");
    }
    assert!(reading.snapshot(&good[1..], now, later).is_err());
}

#[test]
fn invalid_configurations_are_rejected() {
    assert!(config().describe().is_ok());
    let refused = |change: &dyn Fn(&mut SinumerikConfig)| {
        let mut config = config();
        change(&mut config);
        config.describe().unwrap_err().to_string()
    };
    let period = refused(&|c| c.server.period = Duration::from_millis(50));
    assert_eq!(
        period,
        "period: found 50 ms, expected 100 ms or more: the server of the control samples no faster"
    );
    let secured = refused(&|c| c.server.security = Security::SignAndEncrypt);
    assert!(secured.contains("without a folder of certificates"), "{secured}");
    let one = refused(&|c| c.nodes.setting = "/NC/$SA".to_owned());
    assert!(one.contains("nodes.setting: found \"/NC/$SA\", expected {axis} or {db}"), "{one}");
    let geometry = "/Channel/GeometricAxis/actToolBasePos[u1,{axis}]";
    let geometry = refused(&|c| c.nodes.position = geometry.to_owned());
    assert!(geometry.contains("expected machine coordinates"), "{geometry}");
    assert!(refused(&|c| c.nodes.kind = String::new()).contains("nodes.kind: found an empty text"));
    for numbers in [vec![1], vec![1, 1], vec![0, 1], vec![1, 2, 3]] {
        assert!(
            refused(&|c| c.numbers.clone_from(&numbers)).contains("expected 2 different numbers")
        );
    }
    assert!(refused(&|c| c.reads = vec![AxisName::X]).contains("found twice"));
    assert!(
        refused(&|c| c.server.time_out = Duration::from_millis(1)).contains("time-out: found 1 ms")
    );
    assert_eq!(Nodes::of_axis("/Plc/DB{db}.DBX{axis}.0", 4), "/Plc/DB34.DBX4.0");
}

#[test]
fn lag_is_speed_times_period() {
    // 10 m/min for 100 ms give 16.667 mm.
    let lag = lag(10_000.0 / 60.0, Duration::from_millis(100));
    assert!((lag.0 - 16.667).abs() < 1e-3);
}
