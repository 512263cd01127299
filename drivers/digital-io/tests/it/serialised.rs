//! Plain data through serde: what is written is read as it was.

use std::fmt::Debug;

use serde::{Serialize, de::DeserializeOwned};
use volcomp_digital_io::{Coherence, CorrectionCode, DigitalAxis, LowBits, PositionCode, Wiring};
use volcomp_vocabulary::{AxisName, Displacement, Mm};

fn round<T: Serialize + DeserializeOwned + PartialEq + Debug>(value: &T) {
    let text = serde_json::to_string(value).unwrap();
    assert_eq!(serde_json::from_str::<T>(&text).unwrap(), *value, "{text}");
}

#[test]
fn what_is_written_is_read_as_it_was() {
    let mut axis = DigitalAxis::published(AxisName::X);
    round(&axis);
    axis.position.code = PositionCode::Gray;
    axis.correction.code = CorrectionCode::SignMagnitude;
    axis.low_bits = Some(LowBits {
        from: Displacement::Length(Mm(512.0)),
        most_per_s: Displacement::Length(Mm(500.0)),
    });
    round(&axis);
    round(&Wiring {
        parity: Some(15),
        select: vec![16, 17],
        inverted_inputs: 1 << 63,
        ..Wiring::published()
    });
    for coherence in [Coherence::TwoAgree, Coherence::Strobe, Coherence::Latched] {
        round(&coherence);
    }
    #[cfg(feature = "gpio")]
    round(&volcomp_digital_io::LineSet::parse("panel-out:0-14").unwrap());
    round(&axis.correction.encode(-0.0384));
    round(&axis.position.decode(7));
}
