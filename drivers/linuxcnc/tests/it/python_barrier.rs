//! The barrier of the bridge in user space against the reference, scan by scan: on frames that are right, old, foreign, torn
//! and random, with and without the stop of the axes.

use std::{
    fmt::Write as _,
    io::Write as _,
    path::Path,
    process::{Command, Stdio},
};

use proptest::prelude::*;
use volcomp_guard::barrier::{Barrier, Counts, REPORT_WORDS};
use volcomp_test_support::peers;
use volcomp_vocabulary::PerChannel;

use crate::frames::{boxes_of, posts, settings};

/// Reads the settings, then one line for each scan: whether the axes hold, and the words of each mailbox. Prints the report.
const PROGRAM: &str = r#"
import sys
sys.path.insert(0, sys.argv[1])
from barrier import Barrier, Settings
barrier = None
for line in sys.stdin:
    kind, *rest = line.split()
    if kind == "start":
        axes, numbers = rest[0], [int(n) for n in rest[1:]]
        n = len(axes)
        machine, step, hold, time_out, epoch, tick = numbers[:6]
        limit, rate, applied = (numbers[6 + k * n:6 + (k + 1) * n] for k in range(3))
        settings = Settings(list(axes), machine, limit, rate, step, hold, time_out)
        barrier = Barrier(settings, epoch, tick, applied)
    else:
        mailboxes = [[int(w) for w in box.split(",") if w] for box in rest]
        print(*barrier.scan(mailboxes, kind == "hold"))
"#;

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn both_say_the_same_at_every_scan(
        machine in 0_u16..=65_534,
        epoch in prop_oneof![Just(0_u16), Just(u16::MAX), any::<u16>()],
        tick: u16,
        limit in [1_i16..200, 1_i16..i16::MAX],
        rate in [1_i16..20, 1_i16..300],
        (step, hold) in (1_u16..4, 1_u16..20),
        applied in [any::<i16>().boxed(), (-30_i16..30).boxed()],
        scans in prop::collection::vec((prop::bool::weighted(0.1), posts(), posts(), 1_usize..30), 1..150),
    ) {
        let settings = settings(machine, limit, rate, [step, hold]);
        let applied: Counts = PerChannel::leading(applied);
        let mut barrier = Barrier::start(settings, epoch, tick, &applied).unwrap();
        let mut input = format!(
            "start XC {machine} {step} {hold} {} {epoch} {tick} {} {} {} {} {} {}\n",
            2 * hold + 3, limit[0], limit[1], rate[0], rate[1], applied[0], applied[1]
        );
        let mut expected = Vec::new();
        for (holds, first, second, times) in scans {
            for repeat in 0..times {
                let last = barrier.report();
                let boxes = boxes_of([first, second], repeat, &last);
                input += if holds { "hold" } else { "go" };
                for words in &boxes {
                    let words: Vec<String> = words.iter().map(u16::to_string).collect();
                    write!(input, " {}", words.join(",")).unwrap();
                }
                input.push('\n');
                let boxes: Vec<&[u16]> = boxes.iter().map(Vec::as_slice).collect();
                let mut report = [0; REPORT_WORDS];
                let length = barrier.scan(&boxes, holds).encode(&mut report);
                expected.push(report[..length].to_vec());
            }
        }
        let Some(python) = peers::python() else { return Ok(()) };
        let bridge = Path::new(env!("CARGO_MANIFEST_DIR")).join("bridge");
        let mut child = Command::new(python).args(["-c", PROGRAM]).arg(bridge)
            .stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut stdin = child.stdin.take().unwrap();
        let writer = std::thread::spawn(move || stdin.write_all(input.as_bytes()));
        let output = child.wait_with_output().unwrap();
        writer.join().unwrap().unwrap();
        prop_assert!(output.status.success());
        let text = String::from_utf8(output.stdout).unwrap();
        let found: Vec<Vec<u16>> = text.lines()
            .map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect())
            .collect();
        prop_assert_eq!(found.len(), expected.len());
        for (scan, (found, expected)) in found.iter().zip(&expected).enumerate() {
            prop_assert_eq!(found, expected, "scan {}", scan);
        }
    }
}
