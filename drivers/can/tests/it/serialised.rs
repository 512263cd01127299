//! Plain data through serde: what is written is read as it was.

use std::fmt::Debug;

use serde::{Serialize, de::DeserializeOwned};
use volcomp_can::{
    BridgeConfig, Health,
    canopen::{Channel, NmtCommand, NodeState, Number, SdoAnswer, Telegram},
};
use volcomp_vocabulary::AxisName;

use crate::{frame_of, shipped};

fn round<T: Serialize + DeserializeOwned + PartialEq + Debug>(value: &T) -> T {
    let text = serde_json::to_string(value).unwrap();
    let read = serde_json::from_str::<T>(&text).unwrap();
    assert_eq!(read, *value, "{text}");
    read
}

#[test]
fn what_is_written_is_read_as_it_was() {
    let config = BridgeConfig {
        table: shipped(),
        channel: "bridge".to_owned(),
        axes: vec![AxisName::X, AxisName::C],
        reads: vec![AxisName::A],
        includes_correction: false,
    };
    // The places of the bits come along: what was read makes the same frames.
    let read = round(&config);
    let values = [("X_POS", 123.25), ("Y_POS", -4.5)];
    assert_eq!(
        frame_of(&read.table, "POSITION_XY", &values, 3),
        frame_of(&config.table, "POSITION_XY", &values, 3)
    );
    round(&Health {
        broken: 1,
        bus_off: true,
        ..Health::default()
    });
    round(&Channel {
        name: "bed".to_owned(),
        node: 5,
        pdo: 1,
        at: 2,
        number: Number::I16 { decimals: 1 },
        status_at: Some(7),
    });
    round(&Telegram::Heartbeat {
        node: 5,
        state: NodeState::Other(9),
    });
    round(&Telegram::Sdo {
        node: 5,
        answer: SdoAnswer::Aborted {
            object: (0x6130, 1),
            code: 0x0602_0000,
        },
    });
    round(&NmtCommand::PreOperational);
}
