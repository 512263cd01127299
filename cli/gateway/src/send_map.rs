//! `volcomp-gateway send-map`: brings a map of corrections into a control that looks up by itself, and keeps it valid.

use std::{fmt::Write as _, path::Path};

use sha2::{Digest, Sha256};
use volcomp_tables::{Map, Transfer, axes_of};

use crate::{config::MapSender, error::GatewayError};

/// A map that may be sent, and its hash.
#[derive(Clone, Debug)]
pub struct Checked {
    /// What the file of the sender says.
    pub config: MapSender,
    /// The map.
    pub map: Map,
    /// The first 16 digits of the SHA-256 of the map's file: by these it is confirmed.
    pub hash: String,
}

/// Reads the file of a sender and its map, and checks that the map is within the limits. No device is opened.
///
/// # Errors
/// A file that cannot be read or is wrong, a map that is damaged, of another machine, or beyond the limits.
pub fn check(path: &Path) -> Result<Checked, GatewayError> {
    let config = MapSender::read(path)?;
    let shown = config.map.display().to_string();
    let bytes = std::fs::read(&config.map).map_err(|source| GatewayError::Read {
        file: shown.clone(),
        source,
    })?;
    let wrong = |what: String| GatewayError::Map { file: shown, what };
    let map = Map::from_image(&bytes, config.number).map_err(|e| wrong(e.to_string()))?;
    let admitted = config.allowed.admits(&map);
    admitted.map_err(|e| GatewayError::Map {
        file: config.map.display().to_string(),
        what: e.to_string(),
    })?;
    let hash = crate::hex(&Sha256::digest(&bytes)[..8]);
    Ok(Checked { config, map, hash })
}

impl Checked {
    /// Refuses a map that nobody has confirmed.
    ///
    /// # Errors
    /// Another hash than the map's.
    pub fn confirmed(&self, hash: &str) -> Result<(), GatewayError> {
        if hash == self.hash {
            return Ok(());
        }
        Err(GatewayError::Map {
            file: self.config.map.display().to_string(),
            what: format!(
                "--confirm: found {hash:?}, expected {:?}: another map was confirmed",
                self.hash
            ),
        })
    }

    /// What would be sent, in some lines.
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
            (
                "control",
                format!("{}, machine {}", self.config.url, self.config.number),
            ),
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
            (
                "corrects",
                format!("{} over {}", names(header.outputs), names(header.grid)),
            ),
            (
                "within",
                format!(
                    "{:.1} µm, {:.1} µm/s; zero {:.0} ms after the last frame at the latest",
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

/// Sends the map and keeps it valid until a signal ends it.
///
/// # Errors
/// This build has no OPC UA.
#[cfg(not(feature = "sinumerik"))]
pub fn run(checked: &Checked) -> Result<(), GatewayError> {
    let address =
        volcomp_devices::Address::parse(&checked.config.url).map_err(GatewayError::Device)?;
    crate::sinumerik::server(&address, &checked.config.server)
        .map(drop)
        .map_err(GatewayError::Device)
}

#[cfg(feature = "sinumerik")]
pub use opened::run;

#[cfg(feature = "sinumerik")]
mod opened {
    use std::{
        collections::BTreeMap,
        io::Write as _,
        time::{Duration, Instant},
    };

    use volcomp_devices::Address;
    use volcomp_sinumerik::{MapWords, Server, SinumerikError};
    use volcomp_tables::{Exchange, SendError, Sender, Step, control::FRAME_WORDS};

    use super::Checked;
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

    struct Words(MapWords);

    impl Exchange for Words {
        type Error = SinumerikError;

        fn report(&mut self) -> Result<Vec<u16>, SinumerikError> {
            self.0.report()
        }

        fn write(&mut self, frame: &[u16; FRAME_WORDS]) -> Result<(), SinumerikError> {
            self.0.write(frame)
        }

        fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, SinumerikError> {
            self.0.buffer(buffer, count)
        }
    }

    /// What is known of another sender.
    struct Other {
        sequence: u16,
        since: Instant,
    }

    struct Sending<'a> {
        checked: &'a Checked,
        server: Server,
        sender: Sender,
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
        let address = Address::parse(&config.url).map_err(GatewayError::Device)?;
        let server =
            crate::sinumerik::server(&address, &config.server).map_err(GatewayError::Device)?;
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
        let mut sending = Sending {
            checked,
            server,
            sender: sender.map_err(|e| ended(checked, e.to_string()))?,
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
        sending.fall_silent(&heard)?;
        outcome
    }

    fn ended(checked: &Checked, what: String) -> GatewayError {
        GatewayError::MapEnded {
            url: checked.config.url.clone(),
            what,
        }
    }

    impl Sending<'_> {
        fn record(&mut self, what: &str, event: Event) -> Result<(), GatewayError> {
            let details = Details {
                model: format!("map {}", self.checked.hash),
                output_um: BTreeMap::new(),
                output_urad: BTreeMap::new(),
                what: event,
            };
            let shown = || self.checked.config.audit_dir.display().to_string();
            let written = self.audit.append("send-map", what, details);
            written.map_err(|e| GatewayError::system(shown(), e))
        }

        /// Until a signal comes, or something is wrong that does not pass.
        fn keep(&mut self, heard: &Heard) -> Result<(), GatewayError> {
            loop {
                let wait = self.step()?;
                if heard.next(wait) == Some(Signal::Stop) {
                    return Ok(());
                }
            }
        }

        /// One exchange; how long to wait until the next.
        fn step(&mut self) -> Result<Duration, GatewayError> {
            let Some(words) = &mut self.words else {
                return Ok(self.connect());
            };
            match self.sender.step(words) {
                Ok(Step::Kept) => {
                    self.other = None;
                    if !self.in_use {
                        self.in_use = true;
                        self.told.clear();
                        self.record("the map is in use", Event::Nothing)?;
                        say(&format!(
                            "map {} is in use",
                            self.checked.map.header().counter
                        ))?;
                    }
                    Ok(self.server.period)
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
                Err(SendError::Held { by, sequence }) => self.wait_for_other(by, sequence),
                Err(error) => Err(ended(self.checked, error.to_string())),
            }
        }

        fn connect(&mut self) -> Duration {
            let config = &self.checked.config;
            match MapWords::open(&self.server, config.nodes.clone(), config.allowed.capacity) {
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

        /// One that is gone has left the control when its time is out; one that sends is left alone.
        fn wait_for_other(&mut self, by: u16, sequence: u16) -> Result<Duration, GatewayError> {
            let other = self.other.get_or_insert_with(|| Other {
                sequence,
                since: Instant::now(),
            });
            let patience = Duration::from_secs_f64(2.0 + self.checked.config.allowed.zero_after_s);
            if other.sequence != sequence || other.since.elapsed() > patience {
                let what = format!("another sender, number {by}, holds the control");
                return Err(ended(self.checked, what));
            }
            Ok(self.server.period)
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
            let still = Duration::from_secs_f64(2.0 + self.checked.config.allowed.zero_after_s);
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
                if heard.next(self.server.period) == Some(Signal::Stop) {
                    break;
                }
            }
            if let Some(Words(words)) = self.words.take() {
                words.close();
            }
            if !is_zero {
                let what =
                    "nothing is sent any more, but it is not known that the corrections are zero";
                self.record(what, Event::Nothing)?;
                return Err(ended(self.checked, what.to_owned()));
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
}
