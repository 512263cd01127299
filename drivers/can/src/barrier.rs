//! Transport of the barrier's words in the signals `FRAME_0`, `FRAME_1`, … and `REPORT_0`, `REPORT_1`, … This module
//! does not interpret the words. It only takes the size of a count from unit and factor of the value words. Words in
//! several messages belong together if the messages have the same counter.

use std::time::Instant;

use volcomp_port::{Fault, MOST_WORDS, Words};
use volcomp_vocabulary::AxisName;

use crate::{
    frame::{CanPort, Frame},
    quantity::Quantity,
    receiver::{ReceivedMessage, ReceivedSignal, subscribe},
    signals::{Message, Signal, SignalTable},
};

/// Number of words of a frame before its values: epoch, tick, sequence, owner.
const FRAME_HEADER_WORDS: usize = 4;
/// Number of words of a report before its axes: epoch, tick, owner, sequence, refusal, scans per step, hold, timeout.
const REPORT_HEADER_WORDS: usize = 8;
/// Number of words per axis of a report: applied correction, limit, rate.
const REPORT_WORDS_PER_AXIS: usize = 3;
/// Number of checksum words at the end of frames and reports.
const CHECKSUM_WORDS: usize = 2;

struct OutgoingMessage {
    message: Message,
    frame: Frame,
}

struct Word {
    sent: usize,
    signal: Signal,
}

/// Transport of a barrier's words on a bus.
pub(crate) struct Barrier {
    frame: Vec<Word>,
    sent: Vec<OutgoingMessage>,
    report: Vec<ReceivedSignal>,
    /// The last complete report, and the arrival time of its oldest message.
    last: Option<(Words, Instant)>,
    counter: u64,
}

const LARGEST_COUNT: f64 = 32767.0;

/// Size of one count and largest correction of an axis, mm or rad.
pub(crate) struct Count {
    pub(crate) step: f64,
    pub(crate) largest: f64,
}

impl Barrier {
    /// Finds the signals for these axes in a table. Returns `None` if the table has no barrier words.
    ///
    /// Errors: missing words, too few or too many words for the axes, a word that has not 16 bits, a unit that does not
    /// match its axis.
    pub(crate) fn of(
        table: &SignalTable,
        axes: &[AxisName],
        messages: &mut Vec<ReceivedMessage>,
    ) -> Result<Option<(Self, Vec<Count>)>, String> {
        let frame = words(table, "FRAME")?;
        let report = words(table, "REPORT")?;
        if frame.is_empty() && report.is_empty() {
            return Ok(None);
        }
        let count = axes.len();
        check_word_count(&frame, "FRAME", FRAME_HEADER_WORDS + count + CHECKSUM_WORDS, count)?;
        let expected = REPORT_HEADER_WORDS + REPORT_WORDS_PER_AXIS * count + CHECKSUM_WORDS;
        check_word_count(&report, "REPORT", expected, count)?;
        let signal = |at: &(usize, usize)| &table.messages[at.0].signals[at.1];
        let mut counts = Vec::new();
        for (index, name) in axes.iter().enumerate() {
            let value = signal(&frame[FRAME_HEADER_WORDS + index]);
            counts.push(axis_count(value, *name)?);
            for at in &report[REPORT_HEADER_WORDS + REPORT_WORDS_PER_AXIS * index..][..2] {
                check_same_count(signal(at), value)?;
            }
        }
        let is_value =
            |index: usize| (FRAME_HEADER_WORDS..FRAME_HEADER_WORDS + count).contains(&index);
        let counted = |index: usize| {
            let of_axes = index.checked_sub(REPORT_HEADER_WORDS);
            of_axes.is_some_and(|at| {
                at < REPORT_WORDS_PER_AXIS * count && at % REPORT_WORDS_PER_AXIS != 2
            })
        };
        for (index, at) in frame.iter().enumerate() {
            check(signal(at), is_value(index))?;
        }
        for (index, at) in report.iter().enumerate() {
            check(signal(at), counted(index))?;
        }
        check_shared_counter(table, &frame)?;
        check_shared_counter(table, &report)?;
        let mut sent: Vec<OutgoingMessage> = Vec::new();
        let mut parts = Vec::new();
        // The message with the last word is sent last, because the control takes the frame as complete when that
        // message arrives.
        let mut order: Vec<usize> = Vec::new();
        for (message, _) in frame.iter().rev() {
            if !order.contains(message) {
                order.insert(0, *message);
            }
        }
        for index in &order {
            let message = &table.messages[*index];
            let frame = message
                .frame()
                .ok_or_else(|| format!("{} does not form a valid frame", message.name))?;
            sent.push(OutgoingMessage { message: message.clone(), frame });
        }
        for at in &frame {
            let place = order.iter().position(|message| *message == at.0);
            parts.push(Word {
                // The order contains every message with a word, so the position exists.
                sent: place.unwrap_or(0),
                signal: signal(at).clone(),
            });
        }
        let report = report.iter().map(|at| subscribe(table, messages, *at));
        let barrier = Self {
            frame: parts,
            sent,
            report: report.collect::<Result<_, _>>()?,
            last: None,
            counter: 0,
        };
        Ok(Some((barrier, counts)))
    }

    /// Writes the words of a frame into their messages and sends the messages. The message with the last word is sent
    /// last.
    pub(crate) fn post(
        &mut self,
        port: &mut impl CanPort,
        words: &Words,
        deadline: Instant,
    ) -> Result<(), Fault> {
        let words = words.as_slice();
        if words.len() != self.frame.len() {
            return Err(Fault::Unsupported("a frame of another number of words"));
        }
        for (place, word) in self.frame.iter().zip(words) {
            let data = self.sent[place.sent].frame.data_mut();
            place.signal.put_raw(data, u64::from(*word));
        }
        self.counter = (self.counter + 1) % 16;
        for OutgoingMessage { message, frame } in &mut self.sent {
            message.seal(frame.data_mut(), self.counter);
            send(port, frame, deadline)?;
        }
        Ok(())
    }

    /// Processes a new valid message: if all messages of the report now have the same counter, stores the report.
    pub(crate) fn process(&mut self, messages: &[ReceivedMessage], index: usize) {
        if !self.report.iter().any(|signal| signal.message == index) {
            return;
        }
        let counter = messages[index].counter();
        let mut words = [0; MOST_WORDS];
        let Some(mut oldest) = messages[index].taken else {
            return;
        };
        for (word, place) in words.iter_mut().zip(&self.report) {
            let part = &messages[place.message];
            let Some(taken) = part.taken.filter(|_| part.counter() == counter) else {
                return;
            };
            oldest = oldest.min(taken);
            // The signal has 16 bits, so the conversion cannot fail.
            *word = u16::try_from(place.signal.raw(part.data())).unwrap_or(0);
        }
        let words = words.get(..self.report.len()).and_then(Words::new);
        self.last = words.map(|words| (words, oldest)).or(self.last);
    }

    /// The last complete report, and the arrival time of its oldest message.
    pub(crate) fn report(&self) -> Option<(Words, Instant)> {
        self.last
    }
}

pub(crate) fn send(port: &mut impl CanPort, frame: &Frame, deadline: Instant) -> Result<(), Fault> {
    if Instant::now() >= deadline {
        return Err(Fault::TimedOut);
    }
    port.send(frame, deadline)
}

/// Message and signal index of the words `PREFIX_0`, `PREFIX_1` and so on, in order.
fn words(table: &SignalTable, prefix: &str) -> Result<Vec<(usize, usize)>, String> {
    let mut found = Vec::new();
    for (message, of_message) in table.messages.iter().enumerate() {
        for (place, signal) in of_message.signals.iter().enumerate() {
            let number = signal.name.strip_prefix(prefix);
            let number = number.and_then(|rest| rest.strip_prefix('_'));
            if let Some(number) = number.and_then(|number| number.parse::<usize>().ok()) {
                found.push((number, (message, place)));
            }
        }
    }
    found.sort_unstable();
    for (expected, (number, _)) in found.iter().enumerate() {
        if expected != *number {
            return Err(format!(
                "found the signal {prefix}_{number}, expected {prefix}_{expected}: each word once, counted from 0"
            ));
        }
    }
    Ok(found.into_iter().map(|(_, at)| at).collect())
}

fn check_word_count(
    found: &[(usize, usize)],
    prefix: &str,
    expected: usize,
    axes: usize,
) -> Result<(), String> {
    if found.len() == expected {
        return Ok(());
    }
    Err(format!(
        "found {} words {prefix}_0, {prefix}_1, …, expected {expected} for a barrier of {axes} axes",
        found.len()
    ))
}

/// Checks that, if the words come in several messages, each message has a counter. The counter distinguishes words of
/// different times; the checksum of the words alone does not detect all mixtures of three or more frames.
fn check_shared_counter(table: &SignalTable, words: &[(usize, usize)]) -> Result<(), String> {
    let messages = || words.iter().map(|(message, _)| *message);
    let is_one = messages().all(|message| Some(message) == messages().next());
    for message in messages().map(|index| &table.messages[index]) {
        if !is_one && message.counter.is_none() {
            let name = &message.name;
            return Err(format!(
                "message {name}: found no signal {name}_CNT, expected one, since the words come in several messages"
            ));
        }
    }
    Ok(())
}

/// Size of one count of an axis in mm or rad, from unit and factor of its value word.
fn axis_count(signal: &Signal, name: AxisName) -> Result<Count, String> {
    let unit = Quantity::Of(name).factor(&signal.unit);
    let unit = unit.map_err(|unit| {
        let word = &signal.name;
        format!("signal {word}: {unit}; unit and factor define a count of {name}")
    })?;
    let step = signal.factor * unit;
    if step <= 0.0 {
        let found = signal.factor;
        let word = &signal.name;
        return Err(format!(
            "signal {word}: found the factor {found}, expected a positive one, the size of a count"
        ));
    }
    Ok(Count { step, largest: LARGEST_COUNT * step })
}

fn check_same_count(found: &Signal, expected: &Signal) -> Result<(), String> {
    #[expect(clippy::float_cmp, reason = "both are in one file")]
    let same = found.unit == expected.unit && found.factor == expected.factor;
    if same {
        return Ok(());
    }
    Err(format!(
        "signal {}: found a count of {} {}, expected {} {} as in {}",
        found.name, found.factor, found.unit, expected.factor, expected.unit, expected.name
    ))
}

/// Checks that a signal transports a word unchanged: 16 bits and no offset. Only a `counted` signal may have a unit and
/// a factor.
fn check(signal: &Signal, counted: bool) -> Result<(), String> {
    let word = &signal.name;
    if signal.bits != 16 {
        return Err(format!("signal {word}: found {} bits, expected 16", signal.bits));
    }
    #[expect(clippy::float_cmp, reason = "as written in the file")]
    let plain = signal.offset == 0.0 && (counted || signal.factor == 1.0);
    if !plain || !(counted || signal.unit.is_empty()) {
        return Err(format!(
            "signal {word}: found the factor {}, the offset {} and the unit `{}`, expected {}",
            signal.factor,
            signal.offset,
            signal.unit,
            if counted { "the offset 0" } else { "1, 0 and no unit: it is a plain word" }
        ));
    }
    Ok(())
}
