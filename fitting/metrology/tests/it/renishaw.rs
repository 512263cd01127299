use volcomp_metrology::{
    DeviationUnit, Direction, Measurement, MetrologyError, RenishawKind, StartEnd, parse_renishaw,
    write_renishaw,
};

use crate::samples::{BIDIRECTIONAL_RTL, rtl_with};

fn rtl(text: &str) -> Result<Measurement, MetrologyError> {
    parse_renishaw(text.as_bytes(), "x.rtl", RenishawKind::Linear)
}

fn readings(m: &Measurement) -> Vec<(f64, u32, char, f64)> {
    let sign = |d| if d == Direction::Forward { '+' } else { '-' };
    m.readings
        .iter()
        .map(|r| (r.target, r.run, sign(r.direction), r.deviation))
        .collect()
}

#[test]
fn readings_belong_to_their_target_numbers_and_directions_to_the_order_of_travel() {
    let m = rtl(BIDIRECTIONAL_RTL).unwrap();
    assert_eq!(m.unit, Some(DeviationUnit::Um));
    assert_eq!(
        readings(&m),
        [
            (-100.0, 1, '+', 1.0),
            (0.0, 1, '+', 2.5),
            (250.5, 1, '+', -3.0),
            (250.5, 1, '-', -2.0),
            (0.0, 1, '-', 3.5),
            (-100.0, 1, '-', 4.0),
            (-100.0, 2, '+', 1.2),
            (0.0, 2, '+', 2.7),
            (250.5, 2, '+', -2.8),
            (250.5, 2, '-', -1.8),
            (0.0, 2, '-', 3.7),
            (-100.0, 2, '-', 4.2),
        ]
    );
    assert_eq!(m.notes, [""; 0]);
    assert_eq!(m.targets(), [-100.0, 0.0, 250.5]);
    assert_eq!(m.runs(Direction::Backward), [1, 2]);
    assert!((m.mean_at(-100.0, Direction::Backward).unwrap() - 4.1).abs() < 1e-12);
    assert!((m.mean_of_directions_at(0.0).unwrap() - 3.1).abs() < 1e-12);
}

#[test]
fn header_texts_and_surroundings_are_kept() {
    let m = rtl(BIDIRECTIONAL_RTL).unwrap();
    assert_eq!(m.metadata.format.as_deref(), Some("rtl"));
    assert_eq!(m.metadata.machine.as_deref(), Some("Gantry 8000"));
    assert_eq!(m.metadata.location.as_deref(), Some("Hall: 2"));
    assert_eq!(m.metadata.by, None);
    let pressure = StartEnd {
        start: 99.039005,
        end: 99.049346,
        unit_code: Some(1),
    };
    assert_eq!(m.environment.air_pressure, Some(pressure));
    let material = StartEnd {
        start: 20.203292,
        end: 20.321342,
        unit_code: Some(0),
    };
    assert_eq!(
        m.environment.material_temperature,
        [Some(material), None, None]
    );
    assert_eq!(m.environment.environment_factor.unwrap().start, 0.31641096);
}

#[test]
fn written_files_read_back_as_they_were() {
    let m = rtl(BIDIRECTIONAL_RTL).unwrap();
    assert_eq!(rtl(&write_renishaw(&m)).unwrap(), m);
}
