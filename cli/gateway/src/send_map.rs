//! `volcomp-gateway send-map`: loads a correction map into a control that interpolates it itself, and keeps the map
//! valid until a signal arrives.
//!
//! While a map is in use, no function here waits for a disk, because the validity of the map would expire. Records go
//! to the `Log`. A disk that does not respond only prevents the map from being replaced.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs, io,
    path::{Path, PathBuf},
    sync::mpsc::{Receiver, channel},
    thread,
    time::{Duration, Instant},
};

use sha2::{Digest, Sha256};
use volcomp_devices::{
    map::{MapDevice, MapError, MapWords},
    map_device,
};
use volcomp_port::Clock;
use volcomp_tables::{
    Exchange, Map, SendError, Sender, Step, Transfer, axes_of,
    control::{FRAME_WORDS, REPORT_WORDS},
};

use crate::{
    audit::{
        AuditLog, Entry, replace_file,
        writer::{AuditWriter, Receipt},
    },
    config::MapSender,
    documents::{Details, Event},
    error::GatewayError,
    lock,
    run::{Signal, SignalReceiver},
};

#[derive(Clone, Debug)]
pub struct Checked {
    /// Settings of the sender: the control, the limits, and the addresses in the control's memory.
    pub config: MapSender,
    /// The map, within the limits of `config`.
    pub map: Map,
    pub path: PathBuf,
    /// First 16 hexadecimal digits of the SHA-256 of the map file, which confirm the map.
    pub hash: String,
}

/// Reads a sender's configuration and its map, and checks the map against the limits. No device is opened.
///
/// # Errors
/// A file is unreadable or invalid, or the map is damaged, for another machine, or beyond the limits.
pub fn check(path: &Path) -> Result<Checked, GatewayError> {
    let config = MapSender::read(path)?;
    // Reject an unreadable password before anything else is prepared.
    map_device(&config.keys).map_err(GatewayError::Device)?;
    let shown = config.keys.map.display().to_string();
    let bytes = std::fs::read(&config.keys.map)
        .map_err(|source| GatewayError::Read { file: shown.clone(), source })?;
    let wrong = |what: String| GatewayError::invalid_in(&shown, what);
    let map = Map::from_image(&bytes, config.keys.number).map_err(|e| wrong(e.to_string()))?;
    let admitted = config.allowed.check_map(&map);
    admitted.map_err(|e| wrong(e.to_string()))?;
    let hash = volcomp_model::hexadecimal(&Sha256::digest(&bytes)[..8]);
    Ok(Checked { config, map, path: path.to_owned(), hash })
}

impl Checked {
    /// Checks that `hash`, which the user confirmed, is the hash of the map.
    ///
    /// # Errors
    /// `hash` is another hash.
    pub fn confirmed(&self, hash: &str) -> Result<(), GatewayError> {
        if hash == self.hash {
            return Ok(());
        }
        Err(GatewayError::invalid_in(
            self.config.keys.map.display(),
            format_args!(
                "--confirm: found {hash:?}, expected {:?}: another map was confirmed",
                self.hash
            ),
        ))
    }

    /// Formats a summary of the map and its destination.
    #[must_use]
    pub fn text(&self) -> String {
        let header = self.map.header();
        let names = |layout| {
            let names: Vec<String> = axes_of(layout).map(|axis| axis.to_string()).collect();
            names.join(" ")
        };
        let allowed = &self.config.allowed;
        let mut text = String::new();
        let lines = [
            ("control", format!("{}, machine {}", self.config.keys.url, self.config.keys.number)),
            (
                "map",
                format!(
                    "number {}, of the machine file {:08x}…, {} words of {}, {} frames",
                    header.counter,
                    header.model,
                    self.map.words().len(),
                    allowed.capacity,
                    Transfer::of(&self.map).frames
                ),
            ),
            ("corrects", format!("{} over {}", names(header.outputs), names(header.grid))),
            (
                "within",
                format!(
                    "{:.1} µm, {:.1} µm/s; goes to zero {:.0} ms after the last frame at the latest",
                    allowed.limit_mm * 1e3,
                    allowed.slew_mm_per_s * 1e3,
                    allowed.zero_after_s * 1e3
                ),
            ),
            ("send it with", format!("--confirm {}", self.hash)),
        ];
        for (name, value) in lines {
            // Writing to a string never fails.
            let _ = writeln!(text, "{name:13} {value}");
        }
        text
    }
}

/// Retry interval for an unreachable control.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);
/// Polling interval until the control has scanned.
const SCAN_POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Time added to the control's timeout when waiting for the effect of the timeout, s.
const PATIENCE_S: f64 = 2.0;

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

struct OtherSender {
    sequence: u16,
    since: Instant,
}

/// A replacement map whose audit record is being written. The map is sent only after the record is on disk.
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
    /// Number of this sender.
    owner: u16,
    sender: Sender,
    replacements: Receiver<NewMap>,
    recording: Option<Recording>,
    before: Option<Checked>,
    words: Option<Words>,
    log: Log,
    /// Number of the map in use. While a replacement is loaded, it is that of the previous map.
    in_use: Option<u16>,
    other: Option<OtherSender>,
    last_warning: String,
}

/// Sends the map and keeps it valid until a signal arrives. Then waits until the control, after its timeout, has ramped
/// to zero. A second signal ends the wait.
///
/// # Errors
/// Another gateway or sender uses the control, the control permits more than the sender or refuses the map, the first
/// record cannot be written, or the final corrections are not known to be zero.
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
    let replacements = watch(checked).map_err(|e| GatewayError::system("thread of files", e))?;
    let mut sending = Sending {
        clock,
        checked: checked.clone(),
        place,
        owner,
        sender: sender.map_err(|e| ended(checked, &e.to_string()))?,
        replacements,
        recording: None,
        before: None,
        words: None,
        log,
        in_use: None,
        other: None,
        last_warning: String::new(),
    };
    let signals = SignalReceiver::new(|| ())?;
    let begun = sending.log.wait_for_first(checked, &signals);
    if !begun.map_err(in_folder)? {
        return Ok(());
    }
    let outcome = sending.keep(&signals);
    let silent = sending.end_sending(&signals);
    sending.log.end();
    match (outcome, silent) {
        // Return the first error, which ended the program, and log the second.
        (Err(cause), Err(error)) => {
            tracing::error!("{error}");
            Err(cause)
        }
        (outcome, silent) => outcome.and(silent),
    }
}

impl Checked {
    fn patience(&self) -> Duration {
        Duration::from_secs_f64(PATIENCE_S + self.config.allowed.zero_after_s)
    }
}

fn ended(checked: &Checked, what: &str) -> GatewayError {
    GatewayError::failed(format!("{}: {what}", checked.config.keys.url))
}

impl Sending {
    fn record(&self, what: &str) {
        let _ = self.log.record(&self.checked, what);
    }

    fn keep(&mut self, signals: &SignalReceiver) -> Result<(), GatewayError> {
        loop {
            if let Ok(another) = self.replacements.try_recv() {
                self.begin_replacement(another);
            }
            self.switch_map();
            self.log.check_log(&self.checked);
            let wait = self.step()?;
            if signals.next(wait) == Some(Signal::Stop) {
                return Ok(());
            }
        }
    }

    fn begin_replacement(&mut self, another: NewMap) {
        let made = another.and_then(|another| {
            if self.in_use.is_none() || self.before.is_some() || self.recording.is_some() {
                return Err("the previous map is not in use yet".to_owned());
            }
            check_compatible(&self.checked, &another)?;
            let admitted = another.config.allowed.check_map(&another.map);
            admitted.map_err(|e| e.to_string())?;
            Ok(*another)
        });
        match made {
            Ok(checked) => {
                let receipt = self.log.record(&checked, "another map is going to be sent");
                self.recording =
                    Some(Recording { checked, receipt, until: self.clock.now() + RECORD_TIMEOUT });
            }
            Err(why) => self.refuse(&why),
        }
    }

    fn refuse(&mut self, why: &str) {
        self.warn_once(format!("another map is not sent: {why}"));
        self.record("another map was refused");
    }

    /// Starts loading the replacement map once its record is written. The map in use stays active until the control has
    /// the complete replacement. Then the control moves from the old to the new corrections at its rate.
    fn switch_map(&mut self) {
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
            // The record may still be written later. The refusal recorded after it states the outcome.
            None => self.refuse(&format!(
                "the disk of the audit log has not answered for {} s: confirm it again once it does",
                RECORD_TIMEOUT.as_secs()
            )),
        }
    }

    /// Returns to the previous map if the control refuses its replacement. Returns `false` if there is no previous map.
    fn revert_map(&mut self, why: &str) -> bool {
        let Some(checked) = self.before.take() else {
            return false;
        };
        // The previous map was in use, so it is within the limits.
        if self.sender.replace(checked.map.clone()).is_err() {
            return false;
        }
        self.warn_once(format!("another map is not sent: {why}"));
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
            self.check_use();
        }
        match step {
            Ok(Step::Kept) => {
                self.before = None;
                let number = self.checked.map.header().counter;
                if self.in_use != Some(number) {
                    self.in_use = Some(number);
                    self.record("the map is in use");
                    // A full disk behind standard output must not end the sending.
                    if let Err(error) = crate::print(&format!("map {number} is in use\n")) {
                        tracing::warn!("{error}");
                    }
                }
                self.last_warning.clear();
                Ok(self.place.period)
            }
            Ok(Step::Loading) => Ok(Duration::ZERO),
            Ok(Step::NotScanned) => Ok(SCAN_POLL_INTERVAL),
            Ok(Step::Unreadable) => {
                self.warn_once("the report is torn, or of another machine".to_owned());
                Ok(SCAN_POLL_INTERVAL)
            }
            Err(SendError::Exchange(error)) => {
                self.warn_once(error.to_string());
                // Dropping the connection also discards responses in flight.
                self.words = None;
                Ok(SCAN_POLL_INTERVAL)
            }
            Err(SendError::Held { by, sequence }) if self.is_awaited(sequence) => {
                self.warn_once(format!("waiting until sender {by} has released the control"));
                Ok(self.place.period)
            }
            Err(error) => {
                let why = error.to_string();
                if self.revert_map(&why) {
                    return Ok(SCAN_POLL_INTERVAL);
                }
                Err(ended(&self.checked, &why))
            }
        }
    }

    /// Detects that the control has lost the map in use, even while a replacement is loaded.
    fn check_use(&mut self) {
        if is_lost(self.in_use, self.checked.map.header().counter, self.sender.in_use()) {
            self.in_use = None;
            self.warn_once("the control has lost the map: sending it again".to_owned());
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
                self.warn_once(error.to_string());
                RETRY_INTERVAL
            }
        }
    }

    /// True while another sender must be waited for. An inactive sender loses the control after its timeout; the
    /// corrections of an active sender are not disturbed.
    fn is_awaited(&mut self, sequence: u16) -> bool {
        let now = self.clock.now();
        let other = (self.other).get_or_insert(OtherSender { sequence, since: now });
        other.sequence == sequence && now - other.since <= self.checked.patience()
    }

    fn warn_once(&mut self, what: String) {
        if self.last_warning != what {
            tracing::warn!("{}: {what}", self.checked.config.keys.url);
            self.last_warning = what;
        }
    }

    /// Stops sending and waits until the control reports zero corrections.
    fn end_sending(&mut self, signals: &SignalReceiver) -> Result<(), GatewayError> {
        let still = self.checked.patience();
        let (mut last, mut since) = (None, self.clock.now());
        let mut is_zero = false;
        while !is_zero && self.clock.now() - since < still {
            let Some(words) = &mut self.words else {
                let wait = self.connect();
                if signals.next(wait) == Some(Signal::Stop) {
                    break;
                }
                continue;
            };
            match words.report().map(|words| self.sender.decode_report(&words)) {
                Ok(Some(seen)) => {
                    let applied = seen.of.applied;
                    if last.replace(applied) != Some(applied) {
                        since = self.clock.now();
                    }
                    let is_other = ![0, self.owner].contains(&seen.of.owner);
                    // The corrections of another active sender need never stand still, nor become zero.
                    if is_other && !self.is_awaited(seen.of.sequence) {
                        break;
                    }
                    is_zero = !seen.valid && applied.iter().all(|steps| *steps == 0);
                }
                Ok(None) => {}
                Err(_) => self.words = None,
            }
            if signals.next(self.place.period) == Some(Signal::Stop) {
                break;
            }
        }
        if let Some(words) = self.words.take() {
            words.0.close();
        }
        if !is_zero {
            let what = "sending has stopped, but it is unknown whether the corrections are zero";
            self.record(what);
            return Err(ended(&self.checked, what));
        }
        self.record("the corrections are zero");
        crate::print("the corrections are zero\n")
    }
}

/// True if the control has lost the map that was in use: the control now uses neither that map nor the map being sent.
fn is_lost(was: Option<u16>, sent: u16, is: Option<u16>) -> bool {
    was.is_some() && is != was && is != Some(sent)
}

/// Timeout for the record of a new map. Without its record the map is not sent.
const RECORD_TIMEOUT: Duration = Duration::from_secs(5);
const POLL_INTERVAL: Duration = Duration::from_millis(10);
/// Timeout for the last records at shutdown. Records not written by then are lost.
const END_TIMEOUT: Duration = Duration::from_secs(1);

/// The audit log of the sender. Only calls before the first map is sent and after the last exchange wait for the disk.
struct Log {
    writer: AuditWriter,
    clock: Clock,
    /// The last logged reason why records may be missing.
    trouble: Option<&'static str>,
}

impl Log {
    /// Opens the log in a folder.
    ///
    /// # Errors
    /// The folder cannot be written, or the operating system cannot create a thread.
    fn begin(folder: &Path, clock: Clock) -> io::Result<Self> {
        let (audit, _) = AuditLog::open(folder)?;
        Ok(Self { writer: AuditWriter::start(audit, clock.clone())?, clock, trouble: None })
    }

    fn record(&self, checked: &Checked, what: &str) -> Receipt {
        self.writer.record(entry(checked, what))
    }

    /// Waits until the first record is written; until then nothing is sent. Returns `false` if a signal ends the wait.
    ///
    /// # Errors
    /// The record cannot be written, or the disk does not respond.
    fn wait_for_first(&self, checked: &Checked, signals: &SignalReceiver) -> io::Result<bool> {
        let receipt = self.record(checked, "a map is going to be sent");
        let until = self.clock.now() + RECORD_TIMEOUT;
        loop {
            match receipt.written() {
                Some(true) => return Ok(true),
                Some(false) => {
                    return Err(io::Error::other(
                        "the audit log cannot be written, and nothing was sent",
                    ));
                }
                None if self.clock.now() > until => {
                    return Err(io::Error::new(
                        io::ErrorKind::TimedOut,
                        format!(
                            "the disk of the audit log has not answered for {} s, and nothing was sent",
                            RECORD_TIMEOUT.as_secs()
                        ),
                    ));
                }
                None => {}
            }
            if signals.next(POLL_INTERVAL) == Some(Signal::Stop) {
                return Ok(false);
            }
        }
    }

    /// Logs changes of the log's health, and retries a failed log. `checked` is the map being sent.
    fn check_log(&mut self, checked: &Checked) {
        let trouble = self.writer.trouble();
        if trouble != self.trouble {
            if let Some(trouble) = trouble {
                tracing::error!(
                    "{trouble}: the map stays in use, and no other one is accepted until it is written again"
                );
            } else {
                tracing::info!("the audit log is written again");
            }
            self.trouble = trouble;
        }
        let again = || entry(checked, "audit log can be written again");
        self.writer.retry(again);
    }

    /// Waits at most [`END_TIMEOUT`] for the last records.
    fn end(&self) {
        if !self.writer.settle(END_TIMEOUT) {
            tracing::error!("the disk of the audit log does not answer: the last records are lost");
        }
    }
}

fn entry(checked: &Checked, what: &str) -> Entry {
    let details = Details {
        model: format!("map {}", checked.hash),
        output_um: BTreeMap::new(),
        output_urad: BTreeMap::new(),
        what: Event::Nothing,
    };
    Entry::new("send-map", what, details)
}

const CONFIRMATION_POLL_INTERVAL: Duration = Duration::from_secs(1);

fn confirmation(audit_dir: &Path) -> PathBuf {
    audit_dir.join("confirmed-map")
}

/// Requests the running sender to use this map.
///
/// # Errors
/// No sender is running with this configuration, or its folder cannot be written.
pub fn request_replacement(checked: &Checked) -> Result<(), GatewayError> {
    let config = &checked.config;
    // A running sender locks its folder. A gateway on the same control uses another folder.
    if !lock::is_folder_locked(&config.keys.audit.dir)? {
        return Err(GatewayError::failed(format!(
            "{}: --replace: found no sender that runs, expected one of {}",
            config.keys.url,
            checked.path.display()
        )));
    }
    let file = confirmation(&config.keys.audit.dir);
    replace_file(&file, &checked.hash)
        .map_err(|e| GatewayError::system(file.display().to_string(), e))
}

/// A replacement map, or the reason why it is refused.
type NewMap = Result<Box<Checked>, String>;

/// Polls for confirmations of a replacement map until the receiver is dropped. A confirmation is a file in the folder
/// of the audit log. This thread reads the files, because the map in use must be kept valid meanwhile. The replacement
/// is activated without ramping the corrections to zero.
///
/// # Errors
/// The operating system cannot create a thread.
fn watch(running: &Checked) -> std::io::Result<Receiver<NewMap>> {
    let (sender, receiver) = channel();
    let (path, config) = (running.path.clone(), running.config.clone());
    let file = confirmation(&config.keys.audit.dir);
    // A confirmation that an earlier sender left is invalid.
    let _ = fs::remove_file(&file);
    thread::Builder::new().name("volcomp-files".to_owned()).spawn(move || {
        let mut trouble = String::new();
        loop {
            thread::sleep(CONFIRMATION_POLL_INTERVAL);
            let another = match take_confirmation(&file) {
                Ok(None) => {
                    trouble.clear();
                    continue;
                }
                Ok(Some(hash)) => read_replacement(&path, &config, hash.trim()),
                Err(e) => {
                    let what = format!("{}: {e}", file.display());
                    // The error persists, so report it only once.
                    if what == trouble {
                        continue;
                    }
                    trouble.clone_from(&what);
                    Err(what)
                }
            };
            if sender.send(another).is_err() {
                return;
            }
        }
    })?;
    Ok(receiver)
}

/// Takes the pending confirmation; `None` without a file. The file is renamed before it is read, so that a confirmation
/// written meanwhile remains for the next poll.
fn take_confirmation(file: &Path) -> io::Result<Option<String>> {
    let mine = file.with_extension("taken");
    match fs::rename(file, &mine) {
        Ok(()) => fs::read_to_string(&mine).map(Some),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(e),
    }
}

/// Reads the confirmed map, and checks that no other key of the sender's configuration has changed.
fn read_replacement(path: &Path, running: &MapSender, hash: &str) -> NewMap {
    let checked = check(path).map_err(|e| e.to_string())?;
    checked.confirmed(hash).map_err(|e| e.to_string())?;
    let mut but_for_the_map = checked.config.clone();
    but_for_the_map.keys.map.clone_from(&running.keys.map);
    if but_for_the_map != *running {
        return Err(format!(
            "{}: found other keys than `map` changed, expected the sender to be started again for those",
            path.display()
        ));
    }
    Ok(Box::new(checked))
}

/// Rejects a map that cannot replace the map in use. The numbers must differ, because the control identifies maps by
/// number. The axes and steps must be the same.
fn check_compatible(running: &Checked, another: &Checked) -> Result<(), String> {
    let (is, was) = (another.map.header(), running.map.header());
    let file = another.config.keys.map.display();
    if is.counter == was.counter {
        return Err(format!(
            "{file}: found the number {} of the map in use, expected another one (volcomp map-table --counter)",
            is.counter
        ));
    }
    let steps = |header: &volcomp_tables::Header| header.lines.map(|lines| lines.step_millionths);
    if (is.grid, is.outputs, is.output_step_nm, steps(is))
        != (was.grid, was.outputs, was.output_step_nm, steps(was))
    {
        return Err(format!(
            "{file}: found other axes or other steps than those of the map in use, expected the same"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lost_map_is_detected_during_a_replacement() {
        // Map 7 is kept valid. Then map 8 is transferred and replaces it.
        assert!(!is_lost(None, 7, None));
        assert!(!is_lost(Some(7), 7, Some(7)));
        assert!(!is_lost(Some(7), 8, Some(7)));
        assert!(!is_lost(Some(7), 8, Some(8)));
        // The control uses no map, or the map of another sender.
        assert!(is_lost(Some(7), 7, None));
        assert!(is_lost(Some(7), 8, None));
        assert!(is_lost(Some(7), 7, Some(9)));
    }
}
