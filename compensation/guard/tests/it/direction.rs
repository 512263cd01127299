use volcomp_guard::DirectionMemory;
use volcomp_vocabulary::Direction;

#[test]
fn it_turns_only_after_the_threshold_from_the_last_extreme() {
    let mut memory = DirectionMemory::default();
    let mut at = |position: f64| memory.at(position, 0.005);
    assert_eq!(at(10.0), None);
    assert_eq!(at(10.004), None, "noise");
    assert_eq!(at(10.006), Some(Direction::Positive));
    assert_eq!(at(20.0), Some(Direction::Positive));
    assert_eq!(
        at(19.996),
        Some(Direction::Positive),
        "back by less than the threshold"
    );
    assert_eq!(at(20.001), Some(Direction::Positive), "a new extreme");
    assert_eq!(at(19.997), Some(Direction::Positive));
    assert_eq!(at(f64::NAN), Some(Direction::Positive));
    assert_eq!(at(19.9955), Some(Direction::Negative));
    assert_eq!(at(20.0), Some(Direction::Negative));
    assert_eq!(at(20.0006), Some(Direction::Positive));
}
