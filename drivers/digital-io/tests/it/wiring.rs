use std::time::{Duration, Instant};

use proptest::prelude::*;
use volcomp_digital_io::{Coherence, DigitalAxis, Wiring};
use volcomp_port::{DigitalIo, Fault, InputLevels, MockDigitalIo};
use volcomp_vocabulary::{AxisName, Displacement, Mm};

fn soon() -> Instant {
    Instant::now() + Duration::from_millis(50)
}

fn axis() -> DigitalAxis {
    DigitalAxis::published(AxisName::X)
}

fn checked(wiring: &Wiring, inputs: u32, outputs: u32, axes: usize) -> Result<(), String> {
    let words = vec![(axis().position, axis().correction); axes];
    wiring.check(inputs, outputs, axes, &words).map_err(|e| e.to_string())
}

#[test]
fn invalid_wirings_are_rejected() {
    let good = Wiring::published();
    assert_eq!(checked(&good, 15, 8, 1), Ok(()));
    assert_eq!(
        checked(&good, 14, 8, 1),
        Err("inputs: found 14, expected a line below 14".to_owned())
    );
    assert_eq!(
        checked(&good, 15, 7, 1),
        Err("outputs: found 7, expected a line below 7".to_owned())
    );
    let mut twice = good.clone();
    twice.position[3] = 2;
    assert!(checked(&twice, 15, 8, 1).unwrap_err().contains("each line once"));
    let mut short = good.clone();
    short.position.pop();
    assert_eq!(
        checked(&short, 15, 8, 1),
        Err("lines of the position: found 14, expected 15, the bits of the word".to_owned())
    );
    assert!(checked(&good, 15, 8, 2).unwrap_err().contains("axes: found 2, expected 1 to 1"));
    let latch = Wiring { latch: Some(7), ..good.clone() };
    assert_eq!(
        checked(&latch, 15, 8, 1),
        Err("outputs: found 7, expected each line once".to_owned())
    );
    let select = Wiring { select: vec![15], ..good.clone() };
    let message = checked(&select, 16, 8, 2).unwrap_err();
    assert!(message.contains("must name its axis"), "{message}");
    let mut words = [(axis().position, axis().correction)];
    words[0].0.step = Displacement::Length(Mm(f64::NAN));
    let message = good.check(15, 8, 1, &words).unwrap_err().to_string();
    assert_eq!(message, "step of the position: found NaN, expected a positive number");
}

fn read_coherent(
    io: &mut impl DigitalIo,
    wiring: &Wiring,
    coherence: Coherence,
    deadline: Instant,
) -> Result<u64, Fault> {
    let found = volcomp_digital_io::read_coherent(io, wiring, coherence, deadline);
    found.map(|found| found.levels)
}

/// A port that returns these readings in turn, and then repeats the last reading.
fn port(readings: Vec<u64>) -> MockDigitalIo {
    let mut port = MockDigitalIo::new();
    let mut rest = readings.into_iter().peekable();
    port.expect_read().returning(move |_| {
        let next = rest.next().unwrap_or(0);
        if rest.peek().is_none() {
            rest = vec![next].into_iter().peekable();
        }
        Ok(InputLevels::now(next))
    });
    port
}

#[test]
fn lines_are_read_until_two_agree() {
    let wiring = Wiring::published();
    let read = |readings, coherence| read_coherent(&mut port(readings), &wiring, coherence, soon());
    // Between 0x0fff and 0x1000 the skewed lines pass through other words.
    let skewed = vec![0x0fff, 0x1fff, 0x1f00, 0x1000];
    assert_eq!(read(skewed.clone(), Coherence::TwoAgree), Ok(0x1000));
    assert_eq!(read(skewed, Coherence::Latched), Ok(0x0fff));
    // Lines outside the word are ignored.
    assert_eq!(read(vec![0x8005, 0x0005], Coherence::TwoAgree), Ok(5));
}

#[test]
fn lines_that_keep_changing_time_out() {
    let mut port = MockDigitalIo::new();
    let mut count = 0;
    port.expect_read().returning(move |_| {
        count += 1;
        Ok(InputLevels::now(count))
    });
    let wiring = Wiring::published();
    let found = read_coherent(&mut port, &wiring, Coherence::TwoAgree, soon());
    assert_eq!(found, Err(Fault::TimedOut));
    let mut gone = MockDigitalIo::new();
    gone.expect_read().returning(|_| Err(Fault::Disconnected));
    let found = read_coherent(&mut gone, &wiring, Coherence::TwoAgree, soon());
    assert_eq!(found, Err(Fault::Disconnected));
}

/// With parity and strobe lines, words are rejected until both are correct, even if two readings agree.
#[test]
fn parity_and_strobe_are_waited_for() {
    let wiring = Wiring {
        position: (0..15).collect(),
        parity: Some(15),
        strobe: Some(16),
        correction: (0..8).collect(),
        ..Wiring::default()
    };
    let still = wiring.control_outputs(0x1234, 0, true);
    let moving = wiring.control_outputs(0x1235, 0, false);
    let broken = still ^ 1;
    let readings = vec![moving, moving, broken, broken, still, still];
    let found = read_coherent(&mut port(readings), &wiring, Coherence::Strobe, soon());
    assert_eq!(found, Ok(still));
}

proptest! {
    #[test]
    fn words_pass_unchanged_through_any_wiring(
        lines in Just((0..40_u32).collect::<Vec<_>>()).prop_shuffle(),
        inverted_inputs: u64, inverted_outputs: u64, word in 0_u32..0x8000, axis in 0_u32..4, sent in 0_u32..256,
        flipped in 0_usize..17,
    ) {
        let wiring = Wiring {
            position: lines[..15].to_vec(),
            select: lines[15..17].to_vec(),
            parity: Some(lines[17]),
            strobe: Some(lines[18]),
            correction: lines[20..28].to_vec(),
            echo: lines[30..32].to_vec(),
            latch: Some(lines[33]),
            inverted_inputs,
            inverted_outputs,
        };
        let words = vec![(self::axis().position, self::axis().correction); 4];
        prop_assert!(wiring.check(40, 40, 4, &words).is_ok());
        let levels = wiring.control_outputs(word, axis, true);
        let read = |levels| read_coherent(&mut port(vec![levels; 3]), &wiring, Coherence::Strobe, Instant::now() + Duration::from_millis(1));
        prop_assert!(read(levels).is_ok());
        // A single wrong line is detected.
        prop_assert_eq!(read(levels ^ 1 << lines[flipped]), Err(Fault::TimedOut));
        prop_assert_eq!(wiring.control_inputs(wiring.levels(sent, axis)), (sent, axis));
    }
}

#[test]
fn line_sets_are_parsed() {
    use volcomp_digital_io::LineSet;
    let set = LineSet::parse("panel-out:0-3,9,7").unwrap();
    assert_eq!((set.chip.as_str(), &set.lines[..]), ("panel-out", &[0, 1, 2, 3, 9, 7][..]));
    for wrong in ["", "panel", ":0", "panel:", "panel:3-1", "panel:0-99", "panel:x"] {
        let message = LineSet::parse(wrong).unwrap_err().to_string();
        assert!(message.contains(&format!("found `{wrong}`")), "{message}");
    }
    for (twice, line) in [("panel:0,0,1", 0), ("panel:0-7,7-14", 7)] {
        let message = LineSet::parse(twice).unwrap_err().to_string();
        let expected = format!("found line {line} twice in `{twice}`");
        assert!(message.contains(&expected), "{message}");
    }
}
