//! Sends a map and keeps it valid until a signal ends it.
//!
//! Nothing here waits for a disk while a map is in use: its validity would run out. Records go to the [`Log`], and one that
//! does not answer keeps only another map from being taken.

use std::{
    io::Write as _,
    sync::mpsc::Receiver,
    time::{Duration, Instant},
};

use volcomp_devices::{
    map::{MapDevice, MapError, MapWords},
    map_device,
};
use volcomp_port::Clock;
use volcomp_tables::{
    Exchange, SendError, Sender, Step,
    control::{FRAME_WORDS, REPORT_WORDS},
};

use super::{
    Checked,
    log::{Log, RECORD},
    replace::{Another, fits, watch},
};
use crate::{
    audit::clerk::Receipt,
    error::GatewayError,
    lock,
    signals::{Heard, Signal},
};

/// How long until the next try where a control cannot be reached.
const AGAIN: Duration = Duration::from_secs(1);
/// How long until the next look at a control that has not scanned.
const SOON: Duration = Duration::from_millis(5);
/// So much longer than the control's time-out something is waited for that its end should bring, s.
const PATIENCE_S: f64 = 2.0;

/// An open session to a control.
struct Words(Box<dyn MapWords>);

impl Exchange for Words {
    type Error = MapError;

    fn report(&mut self) -> Result<Vec<u16>, MapError> {
        self.0.report(REPORT_WORDS)
    }

    fn write(&mut self, frame: &[u16; FRAME_WORDS]) -> Result<(), MapError> {
        self.0.write(frame)
    }

    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, MapError> {
        self.0.buffer(buffer, count)
    }
}

/// What is known of another sender.
struct Other {
    sequence: u16,
    since: Instant,
}

/// Another map whose record is on its way to the disk. Nothing of it is sent before.
struct Recording {
    checked: Checked,
    receipt: Receipt,
    until: Instant,
}

struct Sending {
    /// The clock by which records, other senders and a control that stands are given up.
    clock: Clock,
    checked: Checked,
    place: MapDevice,
    sender: Sender,
    /// Maps that were confirmed while it runs.
    others: Receiver<Another>,
    recording: Option<Recording>,
    /// The map in use while another one is brought in its place.
    before: Option<Checked>,
    words: Option<Words>,
    log: Log,
    /// The number of the map in use; that of the map before while another one is brought.
    in_use: Option<u16>,
    other: Option<Other>,
    /// What went wrong last, which is told once.
    told: String,
}

/// Sends the map and keeps it valid until a signal ends it. After that the control goes to zero by itself, and it is
/// waited for that; a second signal ends it at once.
///
/// # Errors
/// Another gateway or sender has the control, the control allows more than the sender or refuses the map, the first record
/// cannot be written, or nobody knows whether the corrections came to zero.
pub fn run(checked: &Checked) -> Result<(), GatewayError> {
    let config = &checked.config;
    let place = map_device(&config.keys).map_err(GatewayError::Device)?;
    let _locks = lock::lock_sender(&config.keys.url, &config.keys.audit.dir)?;
    let in_folder = |e| GatewayError::system(config.keys.audit.dir.display().to_string(), e);
    let clock = Clock::system();
    let log = Log::begin(&config.keys.audit.dir, clock.clone()).map_err(in_folder)?;
    let mut number = [0; 2];
    rustix::rand::getrandom(&mut number, rustix::rand::GetRandomFlags::empty())
        .map_err(|e| GatewayError::system("random numbers", e.into()))?;
    let owner = u16::from_le_bytes(number).max(1);
    let map = checked.map.clone();
    let sender = Sender::new(map, config.keys.number, owner, config.allowed);
    let others = watch(checked).map_err(|e| GatewayError::system("thread of files", e))?;
    let mut sending = Sending {
        clock,
        checked: checked.clone(),
        place,
        sender: sender.map_err(|e| ended(checked, &e.to_string()))?,
        others,
        recording: None,
        before: None,
        words: None,
        log,
        in_use: None,
        other: None,
        told: String::new(),
    };
    let heard = Heard::new(|| ())?;
    let begun = sending.log.wait_for_first(checked, &heard);
    if !begun.map_err(in_folder)? {
        return Ok(());
    }
    let outcome = sending.keep(&heard);
    let silent = sending.fall_silent(&heard);
    sending.log.end();
    match (outcome, silent) {
        // The cause is what ends the program; what came of it is told beside it.
        (Err(cause), Err(error)) => {
            tracing::error!("{error}");
            Err(cause)
        }
        (outcome, silent) => outcome.and(silent),
    }
}

impl Checked {
    /// How long a control in which nothing changes is waited for.
    fn patience(&self) -> Duration {
        Duration::from_secs_f64(PATIENCE_S + self.config.allowed.zero_after_s)
    }
}

fn ended(checked: &Checked, what: &str) -> GatewayError {
    GatewayError::failed(format!("{}: {what}", checked.config.keys.url))
}

impl Sending {
    /// Hands over a record about the map that is sent.
    fn record(&self, what: &str) {
        let _ = self.log.record(&self.checked, what);
    }

    /// Until a signal comes, or something is wrong that does not pass.
    fn keep(&mut self, heard: &Heard) -> Result<(), GatewayError> {
        loop {
            if let Ok(another) = self.others.try_recv() {
                self.take(another);
            }
            self.go_over();
            self.log.look_after(&self.checked);
            let wait = self.step()?;
            if heard.next(wait) == Some(Signal::Stop) {
                return Ok(());
            }
        }
    }

    /// Begins to write down that a map which was confirmed meanwhile is going to be sent.
    fn take(&mut self, another: Another) {
        let made = another.and_then(|another| {
            if self.in_use.is_none() || self.before.is_some() || self.recording.is_some() {
                return Err("the map before is not in use yet".to_owned());
            }
            fits(&self.checked, &another)?;
            let admitted = another.config.allowed.admits(&another.map);
            admitted.map_err(|e| e.to_string())?;
            Ok(*another)
        });
        match made {
            Ok(checked) => {
                let receipt = self.log.record(&checked, "another map is going to be sent");
                self.recording = Some(Recording {
                    checked,
                    receipt,
                    until: self.clock.now() + RECORD,
                });
            }
            Err(why) => self.refuse(&why),
        }
    }

    fn refuse(&mut self, why: &str) {
        self.tell(format!("another map is not sent: {why}"));
        self.record("another map was refused");
    }

    /// Goes over to another map once that is on record. The one in use stays so until the control has all of the other; then
    /// the control goes from value to value at its rate.
    fn go_over(&mut self) {
        let Some(recording) = self.recording.take() else {
            return;
        };
        match recording.receipt.written() {
            Some(true) => match self.sender.replace(recording.checked.map.clone()) {
                Ok(_) => {
                    let before = std::mem::replace(&mut self.checked, recording.checked);
                    self.before = Some(before);
                }
                Err(unfit) => self.refuse(&unfit.to_string()),
            },
            Some(false) => self.refuse("the audit log cannot be written"),
            None if self.clock.now() < recording.until => self.recording = Some(recording),
            // The record may come onto the disk later: the one behind it tells what became of it.
            None => self.refuse(&format!(
                "the disk of the audit log has not answered for {} s: confirm it again once it does",
                RECORD.as_secs()
            )),
        }
    }

    /// The map before stays where the control does not take the other: whether there was one.
    fn go_back(&mut self, why: &str) -> bool {
        let Some(checked) = self.before.take() else {
            return false;
        };
        // It was in use: it is as allowed as it was.
        if self.sender.replace(checked.map.clone()).is_err() {
            return false;
        }
        self.tell(format!("another map is not sent: {why}"));
        self.record("another map was refused by the control");
        self.checked = checked;
        true
    }

    /// One exchange; how long to wait until the next.
    fn step(&mut self) -> Result<Duration, GatewayError> {
        let Some(words) = &mut self.words else {
            return Ok(self.connect());
        };
        let step = self.sender.step(words);
        if let Ok(Step::Kept | Step::Loading) = step {
            self.other = None;
            self.look_at_use();
        }
        match step {
            Ok(Step::Kept) => {
                self.before = None;
                let number = self.checked.map.header().counter;
                if self.in_use != Some(number) {
                    self.in_use = Some(number);
                    self.record("the map is in use");
                    say(&format!("map {number} is in use"))?;
                }
                self.told.clear();
                Ok(self.place.period)
            }
            Ok(Step::Loading) => Ok(Duration::ZERO),
            Ok(Step::Stands) => Ok(SOON),
            Ok(Step::Unreadable) => {
                self.tell("the report is torn, or of another machine".to_owned());
                Ok(SOON)
            }
            Err(SendError::Exchange(error)) => {
                self.tell(error.to_string());
                // Dropped: what is still under way is thrown away with the connection.
                self.words = None;
                Ok(SOON)
            }
            Err(SendError::Held { by, sequence }) if self.is_waited_for(sequence) => {
                self.tell(format!("it is waited until sender {by} has let go"));
                Ok(self.place.period)
            }
            Err(error) => {
                let why = error.to_string();
                if self.go_back(&why) {
                    return Ok(SOON);
                }
                Err(ended(&self.checked, &why))
            }
        }
    }

    /// Whether the control still has the map that was in use, also while another one is brought.
    fn look_at_use(&mut self) {
        if is_lost(
            self.in_use,
            self.checked.map.header().counter,
            self.sender.in_use(),
        ) {
            self.in_use = None;
            self.tell("the control has lost the map, and is sent it again".to_owned());
            self.record("the control has lost the map");
        }
    }

    fn connect(&mut self) -> Duration {
        match (self.place.open)() {
            Ok(words) => {
                self.words = Some(Words(words));
                Duration::ZERO
            }
            Err(error) => {
                self.tell(error.to_string());
                AGAIN
            }
        }
    }

    /// Whether another sender is waited for: one that is gone lets go of the control when its time is out; one that sends is
    /// left alone.
    fn is_waited_for(&mut self, sequence: u16) -> bool {
        let now = self.clock.now();
        let other = (self.other).get_or_insert(Other {
            sequence,
            since: now,
        });
        other.sequence == sequence && now - other.since <= self.checked.patience()
    }

    /// Warns of what is new.
    fn tell(&mut self, what: String) {
        if self.told != what {
            tracing::warn!("{}: {what}", self.checked.config.keys.url);
            self.told = what;
        }
    }

    /// Sends nothing any more, and waits until the control says that its corrections are zero.
    fn fall_silent(&mut self, heard: &Heard) -> Result<(), GatewayError> {
        let still = self.checked.patience();
        let (mut last, mut since) = (None, self.clock.now());
        let mut is_zero = false;
        while !is_zero && self.clock.now() - since < still {
            let Some(words) = &mut self.words else {
                let wait = self.connect();
                if heard.next(wait) == Some(Signal::Stop) {
                    break;
                }
                continue;
            };
            match words.report().map(|words| self.sender.seen(&words)) {
                Ok(Some(seen)) => {
                    let applied = seen.of.applied;
                    if last.replace(applied) != Some(applied) {
                        since = self.clock.now();
                    }
                    is_zero = !seen.valid && applied.iter().all(|steps| *steps == 0);
                }
                Ok(None) => {}
                Err(_) => self.words = None,
            }
            if heard.next(self.place.period) == Some(Signal::Stop) {
                break;
            }
        }
        if let Some(words) = self.words.take() {
            words.0.close();
        }
        if !is_zero {
            let what =
                "nothing is sent any more, but it is not known that the corrections are zero";
            self.record(what);
            return Err(ended(&self.checked, what));
        }
        self.record("the corrections are zero");
        say("the corrections are zero")
    }
}

/// Whether a map that was in use is not any more; it may have given way to the one that is sent.
fn is_lost(was: Option<u16>, sent: u16, is: Option<u16>) -> bool {
    was.is_some() && is != was && is != Some(sent)
}

/// A line to standard output; a reader that has gone away is no failure.
fn say(text: &str) -> Result<(), GatewayError> {
    let mut output = std::io::stdout().lock();
    match writeln!(output, "{text}").and_then(|()| output.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(GatewayError::system("standard output", e))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_lost_also_while_another_one_is_brought() {
        // Map 7 is kept; then map 8 is brought, and takes its place.
        assert!(!is_lost(None, 7, None));
        assert!(!is_lost(Some(7), 7, Some(7)));
        assert!(!is_lost(Some(7), 8, Some(7)));
        assert!(!is_lost(Some(7), 8, Some(8)));
        // The control has none, or one of somebody else.
        assert!(is_lost(Some(7), 7, None));
        assert!(is_lost(Some(7), 8, None));
        assert!(is_lost(Some(7), 7, Some(9)));
    }
}
