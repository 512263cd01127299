//! Sends a map and keeps it valid until a signal ends it.

use std::{
    collections::BTreeMap,
    io::Write as _,
    sync::mpsc::Receiver,
    time::{Duration, Instant},
};

use volcomp_tables::{Exchange, SendError, Sender, Step};

use super::{
    Checked,
    replace::{Another, fits, watch},
    words::{Place, Words},
};
use crate::{
    audit::AuditLog,
    documents::{Details, Event},
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

/// What is known of another sender.
struct Other {
    sequence: u16,
    since: Instant,
}

struct Sending {
    checked: Checked,
    place: Place,
    sender: Sender,
    owner: u16,
    /// Maps that were confirmed while it runs.
    others: Receiver<Another>,
    /// The map in use while another one is brought in its place.
    before: Option<(Checked, Sender)>,
    words: Option<Words>,
    audit: AuditLog,
    in_use: bool,
    other: Option<Other>,
    /// What went wrong last, which is told once.
    told: String,
}

/// Sends the map and keeps it valid until a signal ends it. After that the control goes to zero by itself, and it is
/// waited for that; a second signal ends it at once.
///
/// # Errors
/// Another gateway or sender has the control, the control allows more than the sender or refuses the map, the audit log
/// cannot be written, or nobody knows whether the corrections came to zero.
pub fn run(checked: &Checked) -> Result<(), GatewayError> {
    let config = &checked.config;
    let place = Place::of(config)?;
    let _locks = lock::lock_sender(&config.url, &config.audit_dir)?;
    let shown = config.audit_dir.display().to_string();
    let (audit, _) =
        AuditLog::open(&config.audit_dir).map_err(|e| GatewayError::system(shown, e))?;
    let mut number = [0; 2];
    rustix::rand::getrandom(&mut number, rustix::rand::GetRandomFlags::empty())
        .map_err(|e| GatewayError::system("random numbers", e.into()))?;
    let owner = u16::from_le_bytes(number).max(1);
    let map = checked.map.clone();
    let sender = Sender::new(map, config.number, owner, config.allowed);
    let others = watch(checked).map_err(|e| GatewayError::system("thread of files", e))?;
    let mut sending = Sending {
        checked: checked.clone(),
        place,
        sender: sender.map_err(|e| ended(checked, e.to_string()))?,
        owner,
        others,
        before: None,
        words: None,
        audit,
        in_use: false,
        other: None,
        told: String::new(),
    };
    let heard = Heard::new(|| ())?;
    // Nothing is sent before it is on record.
    sending.record("a map is going to be sent", Event::Nothing)?;
    let outcome = sending.keep(&heard);
    let silent = sending.fall_silent(&heard);
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

fn ended(checked: &Checked, what: String) -> GatewayError {
    GatewayError::MapEnded {
        url: checked.config.url.clone(),
        what,
    }
}

impl Sending {
    fn record(&mut self, what: &str, event: Event) -> Result<(), GatewayError> {
        let details = Details {
            model: format!("map {}", self.checked.hash),
            output_um: BTreeMap::new(),
            output_urad: BTreeMap::new(),
            what: event,
        };
        let written = self.audit.append("send-map", what, details);
        written.map_err(|e| {
            GatewayError::system(self.checked.config.audit_dir.display().to_string(), e)
        })
    }

    /// Until a signal comes, or something is wrong that does not pass.
    fn keep(&mut self, heard: &Heard) -> Result<(), GatewayError> {
        loop {
            if let Ok(another) = self.others.try_recv() {
                self.take(another)?;
            }
            let wait = self.step()?;
            if heard.next(wait) == Some(Signal::Stop) {
                return Ok(());
            }
        }
    }

    /// Begins with a map that was confirmed meanwhile. The one in use stays so until the control has all of the other; then the
    /// control goes from value to value at its rate.
    fn take(&mut self, another: Another) -> Result<(), GatewayError> {
        let made = another.and_then(|another| {
            if !self.in_use {
                return Err("the map before is not in use yet".to_owned());
            }
            fits(&self.checked, &another)?;
            let (map, config) = (another.map.clone(), &another.config);
            let sender = Sender::new(map, config.number, self.owner, config.allowed);
            Ok((*another, sender.map_err(|e| e.to_string())?))
        });
        match made {
            Ok((checked, sender)) => {
                let checked = std::mem::replace(&mut self.checked, checked);
                let sender = std::mem::replace(&mut self.sender, sender);
                self.before = Some((checked, sender));
                self.in_use = false;
                self.record("another map is going to be sent", Event::Nothing)
            }
            Err(why) => {
                self.tell(format!("another map is not sent: {why}"));
                self.record("another map was refused", Event::Nothing)
            }
        }
    }

    /// The map before stays where the control does not take the other: whether there was one.
    fn go_back(&mut self, why: &str) -> Result<bool, GatewayError> {
        let Some((checked, sender)) = self.before.take() else {
            return Ok(false);
        };
        self.tell(format!("another map is not sent: {why}"));
        self.record("another map was refused by the control", Event::Nothing)?;
        (self.checked, self.sender) = (checked, sender);
        Ok(true)
    }

    /// One exchange; how long to wait until the next.
    fn step(&mut self) -> Result<Duration, GatewayError> {
        let Some(words) = &mut self.words else {
            return Ok(self.connect());
        };
        match self.sender.step(words) {
            Ok(Step::Kept) => {
                self.other = None;
                self.before = None;
                if !self.in_use {
                    self.in_use = true;
                    self.told.clear();
                    self.record("the map is in use", Event::Nothing)?;
                    say(&format!(
                        "map {} is in use",
                        self.checked.map.header().counter
                    ))?;
                }
                Ok(self.place.period())
            }
            Ok(Step::Loading) => {
                self.other = None;
                if std::mem::take(&mut self.in_use) {
                    self.tell("the control has lost the map, and is sent it again".to_owned());
                    self.record("the control has lost the map", Event::Nothing)?;
                }
                Ok(Duration::ZERO)
            }
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
                Ok(self.place.period())
            }
            Err(error) => {
                let why = error.to_string();
                if self.go_back(&why)? {
                    return Ok(SOON);
                }
                Err(ended(&self.checked, why))
            }
        }
    }

    fn connect(&mut self) -> Duration {
        match self.place.open() {
            Ok(words) => {
                self.words = Some(words);
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
        let other = self.other.get_or_insert_with(|| Other {
            sequence,
            since: Instant::now(),
        });
        other.sequence == sequence && other.since.elapsed() <= self.checked.patience()
    }

    /// Warns of what is new.
    fn tell(&mut self, what: String) {
        if self.told != what {
            tracing::warn!("{}: {what}", self.checked.config.url);
            self.told = what;
        }
    }

    /// Sends nothing any more, and waits until the control says that its corrections are zero.
    fn fall_silent(&mut self, heard: &Heard) -> Result<(), GatewayError> {
        let still = self.checked.patience();
        let (mut last, mut since) = (None, Instant::now());
        let mut is_zero = false;
        while !is_zero && since.elapsed() < still {
            let Some(words) = &mut self.words else {
                let wait = self.connect();
                if heard.next(wait) == Some(Signal::Stop) {
                    break;
                }
                continue;
            };
            match words.report().map(|words| self.sender.seen(&words)) {
                Ok(Some(seen)) => {
                    if last.replace(seen.applied) != Some(seen.applied) {
                        since = Instant::now();
                    }
                    is_zero = !seen.valid && seen.applied.iter().all(|steps| *steps == 0);
                }
                Ok(None) => {}
                Err(_) => self.words = None,
            }
            if heard.next(self.place.period()) == Some(Signal::Stop) {
                break;
            }
        }
        if let Some(words) = self.words.take() {
            words.close();
        }
        if !is_zero {
            let what =
                "nothing is sent any more, but it is not known that the corrections are zero";
            self.record(what, Event::Nothing)?;
            return Err(ended(&self.checked, what.to_owned()));
        }
        self.record("the corrections are zero", Event::Nothing)?;
        say("the corrections are zero")
    }
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
