use volcomp_port::{Axis, Description, Heartbeat, ShownStates, UnfitAxes};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, Mm, Rad};

fn of(axes: Vec<Axis>) -> Result<(), UnfitAxes> {
    description(axes).check()
}

fn description(axes: Vec<Axis>) -> Description {
    Description {
        device: "bench".to_owned(),
        channel: "bench".to_owned(),
        axes,
        reads: Vec::new(),
        heartbeat: Heartbeat::Watched,
        barrier: false,
        tells_applied: true,
        shown: ShownStates::ALL,
        sees_other_gateways: true,
        shortest_cycle: std::time::Duration::from_millis(1),
    }
}

fn axis(name: AxisName, resolution: Displacement) -> Axis {
    Axis { name, includes_correction: false, resolution, largest: None }
}

#[test]
fn descriptions_are_checked() {
    let one = |name: AxisName| axis(name, Displacement::new(name.kind(), 1e-3));
    assert_eq!(of(AxisName::ALL.map(one).to_vec()), Ok(()));
    assert_eq!(of(Vec::new()), Err(UnfitAxes::Count(0)));
    let ten = [AxisName::ALL.map(one).to_vec(), vec![one(AxisName::X)]].concat();
    assert_eq!(of(ten), Err(UnfitAxes::Count(10)));
    let twice = vec![one(AxisName::X), one(AxisName::C), one(AxisName::X)];
    assert_eq!(of(twice), Err(UnfitAxes::Twice(AxisName::X)));
    let mut reads = Description {
        reads: vec![AxisName::A, AxisName::X],
        ..description(vec![one(AxisName::X)])
    };
    assert_eq!(reads.check(), Err(UnfitAxes::Twice(AxisName::X)));
    reads.reads = vec![AxisName::A, AxisName::C];
    assert_eq!(reads.check(), Ok(()));
    assert!(reads.shows(AxisName::A) && reads.shows(AxisName::X) && !reads.shows(AxisName::Y));
    assert_eq!(reads.index_of(AxisName::A), None, "it is not written");
    reads.axes.clear();
    assert_eq!(reads.check(), Ok(()), "it only reports positions");
    // A length for a rotary axis, and an angle for a linear axis.
    let length = Displacement::Length(Mm(0.001));
    let found = of(vec![axis(AxisName::B, length)]);
    let expected =
        "axis B: found a resolution of 1 µm, expected an angle, since the axis is rotary";
    assert_eq!(found.unwrap_err().to_string(), expected);
    let angle = Displacement::Angle(Rad(5e-6));
    let found = of(vec![axis(AxisName::Z, angle)]);
    let expected =
        "axis Z: found a resolution of 5 µrad, expected a length, since the axis is linear";
    assert_eq!(found.unwrap_err().to_string(), expected);
    for step in [0.0, -1e-3, f64::NAN, f64::INFINITY] {
        let resolution = Displacement::new(AxisKind::Linear, step);
        let found = of(vec![axis(AxisName::X, resolution)]);
        assert!(matches!(found, Err(UnfitAxes::Resolution { .. })), "{step}");
    }
}
