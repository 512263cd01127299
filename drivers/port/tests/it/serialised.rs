//! Plain data through serde: what is written is read as it was.

use std::{fmt::Debug, time::Duration};

use serde::{Serialize, de::DeserializeOwned};
use volcomp_port::{
    Axis, Backoff, ControllerState, Description, Heartbeat, Quality, Reason, ShownStates,
    UnopenedLines,
    inject::Faults,
    simulated::{Move, Warming},
};
use volcomp_vocabulary::{AxisName, Deg, Displacement, Mm, PerChannel};

fn round<T: Serialize + DeserializeOwned + PartialEq + Debug>(value: &T) {
    let text = serde_json::to_string(value).unwrap();
    assert_eq!(serde_json::from_str::<T>(&text).unwrap(), *value, "{text}");
}

#[test]
fn what_is_written_is_read_as_it_was() {
    let axis = |name: AxisName, resolution, largest| Axis {
        name,
        includes_correction: true,
        resolution,
        largest,
    };
    let micrometre = Displacement::Length(Mm(0.001));
    let description = Description {
        device: "focas://192.0.2.10:8193".to_owned(),
        channel: "emzps".to_owned(),
        axes: vec![
            axis(
                AxisName::X,
                micrometre,
                Some(Displacement::Length(Mm(0.127))),
            ),
            axis(AxisName::C, Displacement::Angle(Deg(0.001).to_rad()), None),
        ],
        reads: vec![AxisName::A],
        heartbeat: Heartbeat::Watched,
        barrier: false,
        tells_applied: true,
        shown: ShownStates::ALL,
        sees_other_gateways: true,
        shortest_cycle: Duration::from_micros(1500),
    };
    round(&description);
    let text = serde_json::to_string(&description.axes[0]).unwrap();
    assert_eq!(
        text,
        r#"{"name":"X","includes_correction":true,"resolution":{"mm":0.001},"largest":{"mm":0.127}}"#
    );
    round(&ControllerState {
        referenced: true,
        alarm: false,
        emergency_stop: true,
    });
    for quality in [
        Quality::Good,
        Quality::Uncertain(Reason::Reported),
        Quality::Bad(Reason::Open),
    ] {
        round(&quality);
    }
    round(&Backoff::default());
    round(&Faults {
        drop: 0.25,
        delay: Duration::from_millis(3),
        ..Faults::default()
    });
    // Documents from before there were faults that lie.
    let old = r#"{"delay":{"secs":0,"nanos":3000000},"jitter":false,"drop":0.25,"corrupt":0.0,"freeze":0.0,"disconnect":0.0,"calls":0}"#;
    let read: Faults = serde_json::from_str(old).unwrap();
    assert_eq!((read.drop, read.lie, read.lag), (0.25, 0.0, 0));
    round(&Move {
        to: PerChannel::leading([1.0, -2.5]),
        feed_per_s: 100.0,
        dwell: Duration::from_secs(1),
    });
    round(&Warming {
        name: "bed".to_owned(),
        start_degc: 20.0,
        rise_k: 3.0,
        time_constant_s: 600.0,
    });
    round(&UnopenedLines {
        device: "gpio".to_owned(),
        inputs: 15,
        outputs: 8,
        shortest_cycle: Duration::from_micros(50),
    });
}
