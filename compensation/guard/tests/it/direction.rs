use volcomp_guard::DirectionMemory;

#[test]
fn it_turns_only_after_the_threshold_from_the_last_extreme() {
    let mut memory = DirectionMemory::default();
    let mut at = |position: f64| memory.at(position, 0.005);
    assert_eq!(at(10.0), None);
    assert_eq!(at(10.004), None, "noise");
    assert_eq!(at(10.006), Some(true));
    assert_eq!(at(20.0), Some(true));
    assert_eq!(at(19.996), Some(true), "back by less than the threshold");
    assert_eq!(at(20.001), Some(true), "a new extreme");
    assert_eq!(at(19.997), Some(true));
    assert_eq!(at(f64::NAN), Some(true));
    assert_eq!(at(19.9955), Some(false));
    assert_eq!(at(20.0), Some(false));
    assert_eq!(at(20.0006), Some(true));
}
