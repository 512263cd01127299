//! The shipped Structured Text, run by a small interpreter, gives the same words as the reference for the same frames.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_tables::{
    GRID_AXES, HEADER_WORDS, Header, OUTPUTS,
    control::{Body, DATA_WORDS, FRAME_WORDS, Frame, Lookup, REPORT_WORDS, Settings},
    protocol::{Head, Refusal},
};
use volcomp_test_support::{cases, structured_text::Block};

use crate::world;

const TEXT: &str = include_str!("../../../../docs/src/plc/map.st");

struct Control(Block);

impl Control {
    fn new(block: &Block, settings: &Settings, epoch: u16) -> Self {
        let mut block = block.clone();
        let count = |count: usize| i64::try_from(count).expect("few");
        block.set("axes", 0, count(settings.grid.count()));
        block.set("gridLayout", 0, settings.grid.number().into());
        block.set("outputs", 0, count(settings.outputs.axes.count()));
        block.set("layout", 0, settings.outputs.axes.number().into());
        block.set("machine", 0, settings.outputs.machine.into());
        for axis in 0..GRID_AXES {
            let step = settings.position_step_millionths[axis];
            block.set("positionStep", axis, step.into());
            block.set("turned", axis, settings.turned[axis].into());
        }
        for output in 0..OUTPUTS {
            block.set("outputStep", output, settings.output_step_nm[output].into());
            block.set("limit", output, settings.outputs.limit[output].into());
            block.set("rate", output, settings.outputs.rate[output].into());
        }
        block.set("capacity", 0, settings.capacity.into());
        block.set("stepScans", 0, settings.outputs.step_scans.into());
        block.set("holdScans", 0, settings.outputs.hold_scans.into());
        block.set("timeOutScans", 0, settings.outputs.time_out_scans.into());
        block.set("epoch", 0, epoch.into());
        Self(block)
    }

    /// Prepares the first scan after a power-up or reset.
    fn begins(&mut self, tick: u16, applied: [i16; OUTPUTS]) {
        for (output, applied) in applied.into_iter().enumerate() {
            self.0.set("atStart", output, applied.into());
        }
        self.0.set("tickAtStart", 0, tick.into());
        self.0.set("start", 0, 1);
    }

    fn scan(
        &mut self,
        mailbox: &[u16; FRAME_WORDS],
        steps: &[i32; GRID_AXES],
        holds: bool,
    ) -> Result<Vec<u16>, String> {
        for (at, word) in mailbox.iter().enumerate() {
            self.0.set("frame", at, (*word).into());
        }
        for (axis, steps) in steps.iter().enumerate() {
            self.0.set("position", axis, (*steps).into());
        }
        self.0.set("holds", 0, holds.into());
        self.0.run()?;
        self.0.set("start", 0, 0);
        let count = self.0.get("words", 0);
        (0..usize::try_from(count).expect("no negative count"))
            .map(|at| u16::try_from(self.0.get("report", at)).map_err(|e| e.to_string()))
            .collect()
    }
}

fn random_map(rng: &mut ChaCha8Rng, settings: &Settings, counter: u16) -> Vec<u16> {
    let map = world::map(rng, settings, counter);
    let mut words = map.words().to_vec();
    let axes = settings.grid.count();
    let at = 11 + 7 * rng.random_range(0..axes);
    match rng.random_range(0..26) {
        0 => words[rng.random_range(0..HEADER_WORDS)] = rng.random(),
        1 | 14..=17 => words[rng.random_range(0..11)] ^= 1,
        2 => words[at + 1] = rng.random(),
        3 => words[at + 2] = [0, 32767, 32768][rng.random_range(0..3)],
        4 => words[at + 3] = [0, 32767, 32768][rng.random_range(0..3)],
        5 => words[at + 4] = [0, 1, 32767, 32768][rng.random_range(0..4)],
        6 => words[at + rng.random_range(5..7)] ^= 1,
        7 | 18 => {
            let output = rng.random_range(0..settings.outputs.axes.count());
            let beyond = i32::from(settings.outputs.limit[output]) * i32::from(words[9]) + 1;
            let place = 46 + 3 * rng.random_range(0..axes) + output;
            words[place] = i16::try_from(beyond).unwrap_or(i16::MIN).cast_unsigned();
        }
        8 => words[61 + rng.random_range(0..6)] ^= 1,
        9 => {
            let at = rng.random_range(HEADER_WORDS..words.len());
            words[at] = rng.random();
        }
        10 => words[9] = [0, 64, 65, 65535][rng.random_range(0..4)],
        11 => words.push(0),
        // The header has the actual number of words, but not that of its lines.
        12 => {
            words.push(0);
            words[10] += 1;
        }
        19..=20 => words[10] ^= 1,
        // An axis with a single line, and the number of values that fits to it.
        13 => {
            words[at + 4] = 1;
            let lines = (0..axes).map(|axis| usize::from(words[15 + 7 * axis]));
            let values = settings.outputs.axes.count() * lines.product::<usize>();
            words.truncate(HEADER_WORDS + values);
            words[10] = u16::try_from(words.len()).expect("few");
        }
        _ => {}
    }
    words
}

/// A sender whose frames have every kind of error.
struct Sender {
    map: Vec<u16>,
    counter: u16,
    header: Header,
}

impl Sender {
    fn frame(&mut self, rng: &mut ChaCha8Rng, settings: &Settings, lookup: &Lookup) -> Vec<u16> {
        let now = lookup.report();
        let of = now.of;
        if rng.random_bool(0.03) {
            *self = Self::new(rng, settings);
        }
        let words = u16::try_from(self.map.len()).expect("few");
        let counter = self.counter;
        let mut body = match now.loading {
            Some((loading, next)) if loading == counter && next < words => {
                let mut data = [0; DATA_WORDS];
                let from = usize::from(next);
                for (into, word) in data.iter_mut().zip(&self.map[from..]) {
                    *into = *word;
                }
                Body::Words { place: next, data }
            }
            Some((loading, _)) if loading == counter => {
                let check = checksum(settings, &self.map);
                Body::Swap { counter, check }
            }
            _ if now.valid && now.counter == counter => Body::Keep { counter },
            _ => Body::Begin { counter, words },
        };
        match rng.random_range(0..40) {
            0 => body = Body::Begin { counter: rng.random_range(0..3), words: rng.random() },
            1 => body = Body::Words { place: rng.random_range(0..300), data: rng.random() },
            2 => body = Body::Swap { counter, check: rng.random() },
            3 => body = Body::Keep { counter: rng.random_range(0..5) },
            4 => {
                let check = checksum(settings, &self.map);
                body = Body::Swap { counter, check };
            }
            // One of the two checksum words is wrong.
            6 | 7 => {
                if let Body::Swap { check, .. } = &mut body {
                    check[rng.random_range(0..2)] ^= 1;
                }
            }
            5 => {
                body = Body::Begin {
                    counter: [0, counter][rng.random_range(0..2)],
                    words: [68, 69, 300, 301][rng.random_range(0..4)],
                };
            }
            _ => {}
        }
        let mut head = Head {
            epoch: of.epoch,
            tick: of.tick.wrapping_sub(rng.random_range(0..3)),
            sequence: of.sequence.wrapping_add(1),
            owner: if of.owner == 0 { rng.random_range(0..30) } else { of.owner },
        };
        match rng.random_range(0..40) {
            0 => head.epoch = head.epoch.wrapping_sub(rng.random_range(0..3)),
            1 => head.tick = rng.random(),
            2 => head.sequence = rng.random(),
            3 => head.owner = rng.random_range(0..3),
            _ => {}
        }
        let outputs = &settings.outputs;
        let mut words = (Frame { head, body }).encode(outputs.machine, outputs.axes).to_vec();
        match rng.random_range(0..40) {
            0 => {
                let at = rng.random_range(0..words.len());
                words[at] = rng.random();
            }
            // An unknown kind of frame.
            1 => {
                words[4] = rng.random_range(0..7);
                let check = checksum(settings, &words[..FRAME_WORDS - 2]);
                words[FRAME_WORDS - 2..].copy_from_slice(&check);
            }
            _ => {}
        }
        words
    }

    fn new(rng: &mut ChaCha8Rng, settings: &Settings) -> Self {
        let counter = rng.random_range(1..5);
        let map = random_map(rng, settings, counter);
        let header =
            Header::decode(&map).unwrap_or_else(|_| *world::map(rng, settings, counter).header());
        Self { map, counter, header }
    }
}

fn checksum(settings: &Settings, words: &[u16]) -> [u16; 2] {
    let layout = u64::from(settings.outputs.axes.number());
    let first = u64::from(settings.outputs.machine) + layout / 65535;
    let (mut sum, mut of_sums) = (first % 65535, layout % 65535);
    for word in words {
        sum = (sum + u64::from(*word)) % 65535;
        of_sums = (of_sums + sum) % 65535;
    }
    [sum, of_sums].map(|sum| u16::try_from(sum).expect("below 65535"))
}

/// Runs a text in parallel with the reference. Returns the number of activated maps and of each refusal, or the first difference.
fn compare(text: &str) -> Result<(usize, [usize; 11]), String> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let block = Block::parse(text)?;
    let (mut swaps, mut refused) = (0, [0; 11]);
    for _ in 0..110 {
        let settings = world::settings(&mut rng);
        let (mut epoch, tick) = (rng.random(), rng.random());
        let mut applied = if rng.random_bool(0.5) { [0; OUTPUTS] } else { rng.random() };
        for applied in applied.iter_mut().skip(settings.outputs.axes.count()) {
            *applied = 0;
        }
        let mut lookup = Lookup::start(settings, epoch, tick, applied).expect("sensible");
        let mut control = Control::new(&block, &settings, epoch);
        control.begins(tick, applied);
        let mut sender = Sender::new(&mut rng, &settings);
        let often = [0.95, 0.95, 0.5, 0.02][rng.random_range(0..4)];
        let mut mailbox = [0; FRAME_WORDS];
        let mut steps = world::somewhere(&mut rng, &sender.header);
        let (mut holds, mut moves) = (false, true);
        for scan in 0..150 {
            if rng.random_bool(often) {
                let words = sender.frame(&mut rng, &settings, &lookup);
                // Some frames are torn: a part of the previous frame remains.
                let torn = rng.random_bool(0.02);
                let until = if torn { rng.random_range(0..FRAME_WORDS) } else { FRAME_WORDS };
                mailbox[..until].copy_from_slice(&words[..until]);
            }
            if rng.random_bool(0.05) {
                steps = world::somewhere(&mut rng, &sender.header);
            }
            moves ^= rng.random_bool(0.05);
            for steps in steps.iter_mut().filter(|_| moves) {
                *steps = steps.saturating_add(rng.random_range(-30..=30));
            }
            if scan > 0 && rng.random_bool(0.01) {
                let before = lookup.memory();
                (epoch, applied) = (before.link.epoch, before.applied);
                let tick = rng.random();
                lookup = Lookup::start(settings, epoch, tick, applied).expect("sensible");
                control.begins(tick, applied);
            }
            holds ^= rng.random_bool(0.05);
            let counter = lookup.report().counter;
            let report = lookup.scan(&mailbox, &steps, holds);
            swaps += usize::from(report.valid && report.counter != counter);
            // Look-ups have no refusals for digital lines, so those numbers are skipped.
            let kind = report.of.refusal as usize;
            refused[kind - usize::from(kind > Refusal::Lines as usize)] += 1;
            let mut expected = [0; REPORT_WORDS];
            let count = report.encode(&mut expected);
            let found = control.scan(&mailbox, &steps, holds)?;
            if found != expected[..count] {
                return Err(format!(
                    "scan {scan} of {settings:?}: {found:?}, not {:?}",
                    &expected[..count]
                ));
            }
        }
        // The words that a sender reads back equal those of the reference.
        let memory = lookup.memory();
        let words = memory.used.as_ref().map_or(0, Header::words);
        let base = memory.buffer * usize::from(settings.capacity);
        for (at, word) in lookup.buffer(memory.buffer)[..words].iter().enumerate() {
            let found = control.0.get("map", base + at);
            if found != i64::from(word.cast_signed()) {
                return Err(format!("word {at} of the map in use: {found}, not {word}"));
            }
        }
    }
    Ok((swaps, refused))
}

#[test]
fn the_structured_text_matches_the_reference() {
    let (swaps, refused) = compare(TEXT).expect("the same words");
    assert!(swaps > 60, "{swaps} maps came into use, refused {refused:?}");
    assert!(refused.iter().all(|count| *count > 20), "{refused:?}");
}

/// Parts of the text, each with a mutation that the comparison must detect.
const MISTAKES: &str = r"
sum := (machine + layout / 65535) MOD 65535; | sum := 0;
FOR at := 0 TO 69 DO | FOR at := 0 TO 68 DO
frame[0] <> epoch | FALSE
epoch := (epoch + 1) MOD 65536;\n    tick | tick
epoch := (epoch + 1) MOD 65536;\n        owner | owner
frame[3] = 0 OR | FALSE OR
frame[3] <> owner | FALSE
MOD 65536 > holdScans | MOD 65536 >= holdScans
MOD 65536 > 32767 | MOD 65536 > 32000
frame[1] = foundTick AND | FALSE AND
IF verdict <> 1 THEN | IF verdict = 0 THEN
foundTick := -1; |
frame[6] = 0 OR frame[7] < 69 | frame[7] < 69
frame[7] < 69 | frame[7] < 68
frame[7] > capacity | frame[7] > capacity + 1
IF frame[5] = next AND | IF
AND next < newWords |
base := (1 - buffer) * capacity | base := buffer * capacity
IF frame[6] = newCounter AND | IF
AND next = newWords THEN | THEN
IF mapSum <> frame[7] OR | IF
mapOfSums <> frame[8] THEN\n                verdict := 9;\n                loading := FALSE; | mapOfSums <> frame[8] THEN\n                verdict := 9;
ABS(value) > limit[(next + at - 68) MOD outputs] * head[9] | FALSE
(next + at - 68) MOD outputs | 0
head[1] <> 1 OR |
head[2] <> newCounter OR |
head[10] <> newWords | FALSE
head[9] > 64 | head[9] > 65
head[at + 2] < 1 | FALSE
head[at + 4] < 2 | head[at + 4] < 1
head[at + 5] <> positionStep[axis] MOD 65536 | FALSE
head[at + 6] <> positionStep[axis] / 65536 | FALSE
value > 1000000000 OR value < -1000000000 OR head | head
ABS(value) > limit[output] * head[9] | FALSE
IF count + 68 <> newWords | IF FALSE
head[61 + 2 * output] <> outputStep[output] MOD 65536 | FALSE
buffer := 1 - buffer; |
valid := TRUE; |
reversal[3 * axis + output] := value; | reversal[3 * axis + output] := 0;
IF NOT valid OR frame[6] | IF frame[6]
OR frame[6] <> counter |
IF verdict = 6 OR verdict = 8 THEN | IF verdict = 8 THEN
silent := silent + 1;\n    IF silent = timeOutScans | silent := silent + 1;\n    IF silent = timeOutScans - 1
loading := FALSE;\n        valid := FALSE; | loading := FALSE;
loading := FALSE;\n        valid := FALSE; | valid := FALSE;
value >= turned[axis] | value > turned[axis]
direction[axis] >= 0 AND value <= -turned | direction[axis] > 0 AND value <= -turned
moved := FALSE; |
(direction[axis] = 1 AND value > 0) OR |
cell[axis] > lines[axis] - 2 | FALSE
+ part[axis] / 2) / part[axis] | ) / part[axis]
rest[axis] > parts[axis] | FALSE
bits MOD 2 | 0
node * lines[axis] + | node +
buffer * capacity + 68 + node | 68 + node
+ parts[axis] / 2) / parts[axis] | ) / parts[axis]
value + direction[axis] * reversal | value - direction[axis] * reversal
> 6 * scale | > 5 * scale
+ scale / 2) / scale | ) / scale
goal[output] < -limit[output] | FALSE
IF NOT holds THEN | IF TRUE THEN
waited >= stepScans | waited > stepScans
+ rate[output] - 1) / rate | ) / rate
IF value > movements | IF output = 0
value := -value;\n            END_IF;\n            applied | END_IF;\n            applied
applied[output] := atStart[output]; |
";

#[test]
fn every_mutation_of_the_text_is_detected() {
    let mistakes = cases(MISTAKES);
    for [right, _] in &mistakes {
        assert!(TEXT.contains(right.as_str()), "{right}");
    }
    let found = |[right, wrong]: &[String; 2]| {
        let text = TEXT.replacen(right.as_str(), wrong, 1);
        compare(&text).is_err()
    };
    // Two at a time in parallel, because these take most of the test time.
    let (first, second) = mistakes.split_at(mistakes.len() / 2);
    let missed_in = |part: &[[String; 2]]| -> Vec<String> {
        let missed = part.iter().filter(|mistake| !found(mistake));
        missed.map(|[right, _]| right.clone()).collect()
    };
    let missed = std::thread::scope(|scope| {
        let other = scope.spawn(|| missed_in(second));
        [missed_in(first), other.join().expect("no panic")].concat()
    });
    assert!(missed.is_empty(), "not found: {missed:#?}");
}
