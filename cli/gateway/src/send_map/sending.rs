//! Sends a map and keeps it valid until a signal.
//!
//! Nothing here waits for a disk while a map is in use, because its validity would expire. Records go to the [`Log`]; a
//! disk that does not respond only prevents the map from being replaced.

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

/// Retry interval if a control is unreachable.
const AGAIN: Duration = Duration::from_secs(1);
/// Polling interval if the control has not scanned yet.
const SOON: Duration = Duration::from_millis(5);
/// Time added to the control's timeout when waiting for its effect, s.
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

/// The last observation of another sender.
struct Other {
    sequence: u16,
    since: Instant,
}

/// A replacement map whose record is being written. Nothing of it is sent before that.
struct Recording {
    checked: Checked,
    receipt: Receipt,
    until: Instant,
}

struct Sending {
    /// Clock for the timeouts of records, other senders and a stopped control.
    clock: Clock,
    checked: Checked,
    place: MapDevice,
    sender: Sender,
    /// Replacement maps confirmed while this sender runs.
    others: Receiver<Another>,
    recording: Option<Recording>,
    /// The map in use while its replacement is being loaded.
    before: Option<Checked>,
    words: Option<Words>,
    log: Log,
    /// Number of the map in use; while a replacement is loaded, that of the previous map.
    in_use: Option<u16>,
    other: Option<Other>,
    /// The last warning, which is logged once.
    told: String,
}

/// Sends the map and keeps it valid until a signal. Then waits until the control, after its timeout, has ramped to
/// zero; a second signal ends the wait.
///
/// # Errors
/// Another gateway or sender uses the control, the control permits more than the sender or refuses the map, the first
/// record cannot be written, or it is unknown whether the corrections reached zero.
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
        // Return the first error, which ended the program; log the second.
        (Err(cause), Err(error)) => {
            tracing::error!("{error}");
            Err(cause)
        }
        (outcome, silent) => outcome.and(silent),
    }
}

impl Checked {
    /// Timeout for a control in which nothing changes.
    fn patience(&self) -> Duration {
        Duration::from_secs_f64(PATIENCE_S + self.config.allowed.zero_after_s)
    }
}

fn ended(checked: &Checked, what: &str) -> GatewayError {
    GatewayError::failed(format!("{}: {what}", checked.config.keys.url))
}

impl Sending {
    /// Queues a record about the map being sent.
    fn record(&self, what: &str) {
        let _ = self.log.record(&self.checked, what);
    }

    /// Runs until a signal or a permanent error.
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

    /// Starts recording that a confirmed replacement map will be sent.
    fn take(&mut self, another: Another) {
        let made = another.and_then(|another| {
            if self.in_use.is_none() || self.before.is_some() || self.recording.is_some() {
                return Err("the map before is not in use yet".to_owned());
            }
            fits(&self.checked, &another)?;
            let admitted = another.config.allowed.check_map(&another.map);
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

    /// Starts loading the replacement map once its record is written. The map in use stays active until the control has
    /// the complete replacement; then the control moves from value to value at its rate.
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
            // The record may still be written later: the refusal recorded after it states the outcome.
            None => self.refuse(&format!(
                "the disk of the audit log has not answered for {} s: confirm it again once it does",
                RECORD.as_secs()
            )),
        }
    }

    /// Keeps the previous map if the control refuses its replacement. Returns `false` if there is no previous map.
    fn go_back(&mut self, why: &str) -> bool {
        let Some(checked) = self.before.take() else {
            return false;
        };
        // It was in use, so it is within the limits.
        if self.sender.replace(checked.map.clone()).is_err() {
            return false;
        }
        self.tell(format!("another map is not sent: {why}"));
        self.record("another map was refused by the control");
        self.checked = checked;
        true
    }

    /// Performs one exchange. Returns the wait until the next one.
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
            Ok(Step::NotScanned) => Ok(SOON),
            Ok(Step::Unreadable) => {
                self.tell("the report is torn, or of another machine".to_owned());
                Ok(SOON)
            }
            Err(SendError::Exchange(error)) => {
                self.tell(error.to_string());
                // Dropping the connection also discards responses in flight.
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

    /// Detects that the control has lost the map in use, also while a replacement is loaded.
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

    /// Whether to wait for another sender: an inactive sender loses the control after its timeout, an active one is
    /// left undisturbed.
    fn is_waited_for(&mut self, sequence: u16) -> bool {
        let now = self.clock.now();
        let other = (self.other).get_or_insert(Other {
            sequence,
            since: now,
        });
        other.sequence == sequence && now - other.since <= self.checked.patience()
    }

    /// Logs a warning if it differs from the last one.
    fn tell(&mut self, what: String) {
        if self.told != what {
            tracing::warn!("{}: {what}", self.checked.config.keys.url);
            self.told = what;
        }
    }

    /// Stops sending and waits until the control reports zero corrections.
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
            match words
                .report()
                .map(|words| self.sender.decode_report(&words))
            {
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

/// Whether the map that was in use is no longer, without having been replaced by the map being sent.
fn is_lost(was: Option<u16>, sent: u16, is: Option<u16>) -> bool {
    was.is_some() && is != was && is != Some(sent)
}

/// Prints a line to standard output; a closed pipe is not an error.
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
