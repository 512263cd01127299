//! The audit log: what changed state, who asked for it, each record chained to the one before by its hash.
//!
//! A line is `CHECKSUM JSON`: the checksum is SHA-256 over the checksum of the line before, a line feed, and
//! the JSON. A record is on disk when [`AuditLog::append`] returns.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Write},
    path::{Path, PathBuf},
};

use sha2::{Digest, Sha256};
use time::OffsetDateTime;
use volcomp_runtime::monotonic;

pub mod clerk;
pub(crate) mod slots;

use crate::documents::{Broken, Details, Record};

/// A file that is larger is closed, and the next one begun, bytes.
const MAX_BYTES: u64 = 4 << 20;
/// How many files are kept besides the current one.
const KEPT: usize = 8;
const CURRENT: &str = "audit.log";

/// The file in the folder of the log that is written now.
pub fn log_file(dir: &Path) -> PathBuf {
    dir.join(CURRENT)
}

/// The files of the log that are there, from the oldest to the one that is written now.
pub fn log_files(dir: &Path) -> Vec<PathBuf> {
    let old = (1..=KEPT).rev().map(|n| dir.join(format!("audit.{n}.log")));
    let all = old.chain([log_file(dir)]);
    all.filter(|path| path.is_file()).collect()
}

/// The state of the log when it was opened.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// Whole records in the current file.
    pub records: u64,
    /// Bytes of a torn tail that were cut.
    pub cut_bytes: u64,
    /// A log that did not belong together, put aside.
    pub broken: Option<Broken>,
}

/// A record that has no place in the chain yet, with the time at which it was made.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    who: String,
    what: String,
    details: Details,
    monotonic_s: f64,
    time: String,
}

impl Entry {
    /// A record of what happens now.
    pub fn new(who: impl Into<String>, what: impl Into<String>, details: Details) -> Self {
        Self {
            who: who.into(),
            what: what.into(),
            details,
            monotonic_s: monotonic().as_secs_f64(),
            time: utc_now(),
        }
    }
}

/// How a file of the log is brought onto the disk.
type Sync = Box<dyn FnMut(&File) -> io::Result<()> + Send>;

/// The log, open for appending.
pub struct AuditLog {
    dir: PathBuf,
    file: File,
    sync: Sync,
    bytes: u64,
    last_checksum: String,
    sequence: u64,
    boot_id: String,
    max_bytes: u64,
}

impl AuditLog {
    /// The file of what outlives a restart, beside the log.
    pub(crate) fn standing_file(&self) -> PathBuf {
        standing_file(&self.dir)
    }

    /// Opens the log in a folder, which is made where it is missing. A torn tail is cut; a file whose chain is
    /// broken is put aside and a new one begun.
    ///
    /// # Errors
    /// A folder or file that cannot be written.
    pub fn open(dir: &Path) -> io::Result<(Self, Found)> {
        fs::create_dir_all(dir)?;
        let path = log_file(dir);
        let mut file = OpenOptions::new()
            .read(true)
            .append(true)
            .create(true)
            .open(&path)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)?;
        let scanned = verify(&bytes);
        let mut found = Found {
            records: scanned.records,
            ..Found::default()
        };
        let whole = scanned.end as u64;
        if let Some(line) = scanned.broken {
            let aside = (1..1000)
                .map(|n| dir.join(format!("audit.broken-{n}.log")))
                .find(|aside| !aside.exists())
                .unwrap_or_else(|| dir.join("audit.broken.log"));
            fs::rename(&path, &aside)?;
            file = OpenOptions::new().append(true).create(true).open(&path)?;
            let aside = aside.display().to_string();
            found.broken = Some(Broken { line, aside });
        } else if whole < bytes.len() as u64 {
            file.set_len(whole)?;
            file.sync_all()?;
            found.cut_bytes = bytes.len() as u64 - whole;
        }
        sync_folder(dir)?;
        let is_broken = found.broken.is_some();
        Ok((
            Self {
                dir: dir.to_owned(),
                sync: Box::new(File::sync_data),
                bytes: if is_broken { 0 } else { whole },
                file,
                last_checksum: if is_broken {
                    String::new()
                } else {
                    scanned.last_checksum
                },
                sequence: if is_broken { 0 } else { scanned.sequence },
                boot_id: boot_id(),
                max_bytes: MAX_BYTES,
            },
            found,
        ))
    }

    /// Begins the next file at another size.
    #[must_use]
    pub fn rotating_at(mut self, bytes: u64) -> Self {
        self.max_bytes = bytes;
        self
    }

    /// Brings the file onto the disk in another way, such as a test's disk that hangs.
    #[must_use]
    pub fn synced_by(mut self, sync: impl FnMut(&File) -> io::Result<()> + Send + 'static) -> Self {
        self.sync = Box::new(sync);
        self
    }

    /// Appends a record of now; it is on disk afterwards.
    ///
    /// # Errors
    /// A disk that is full or gone: nothing of the record is left then.
    pub fn append(&mut self, who: &str, what: &str, details: Details) -> io::Result<()> {
        self.write(&Entry::new(who, what, details), 0)
    }

    /// Appends a record before which `lost` others could not be written; it is on disk afterwards.
    ///
    /// # Errors
    /// A disk that is full or gone: nothing of the record is left then.
    pub fn write(&mut self, entry: &Entry, lost: u64) -> io::Result<()> {
        if self.bytes > self.max_bytes {
            self.rotate()?;
        }
        let sequence = self.sequence + 1;
        let record = serde_json::to_string(&Record {
            seq: sequence,
            boot: self.boot_id.clone(),
            monotonic_s: entry.monotonic_s,
            time: entry.time.clone(),
            who: entry.who.clone(),
            what: entry.what.clone(),
            details: entry.details.clone(),
            lost,
            previous: self.last_checksum.clone(),
        })?;
        let checksum = checksum(&self.last_checksum, &record);
        let line = format!("{checksum} {record}\n");
        let written = self
            .file
            .write_all(line.as_bytes())
            .and_then(|()| (self.sync)(&self.file));
        if let Err(e) = written {
            // Half a record would be a torn tail: cut at once where that is possible.
            let _ = self.file.set_len(self.bytes);
            return Err(e);
        }
        self.bytes += line.len() as u64;
        (self.sequence, self.last_checksum) = (sequence, checksum);
        Ok(())
    }

    /// The current file becomes the first old one; the chain goes on in the next.
    fn rotate(&mut self) -> io::Result<()> {
        let old = |n: usize| self.dir.join(format!("audit.{n}.log"));
        for n in (1..KEPT).rev() {
            if old(n).exists() {
                fs::rename(old(n), old(n + 1))?;
            }
        }
        fs::rename(self.dir.join(CURRENT), old(1))?;
        self.file = OpenOptions::new()
            .append(true)
            .create(true)
            .open(self.dir.join(CURRENT))?;
        self.bytes = 0;
        sync_folder(&self.dir)
    }
}

/// The file of what outlives a restart, in a folder of the log.
pub(crate) fn standing_file(dir: &Path) -> PathBuf {
    dir.join("standing.slots")
}

/// Writes a small file whole or not at all, on disk.
///
/// # Errors
/// A disk that is full or gone.
pub fn replace_file(path: &Path, text: &str) -> io::Result<()> {
    let temporary = path.with_extension("new");
    let placed = File::create(&temporary).and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&temporary, path)
    });
    if placed.is_err() {
        // What is left of it would take the last room of a full disk.
        let _ = fs::remove_file(&temporary);
    }
    placed?;
    path.parent().map_or(Ok(()), sync_folder)
}

fn sync_folder(dir: &Path) -> io::Result<()> {
    File::open(dir)?.sync_all()
}

/// The result of verifying a file of the log.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verified {
    /// Whole records that belong to the chain.
    pub records: u64,
    /// How many bytes they take.
    pub end: usize,
    /// The first line that is whole and yet not of the chain.
    pub broken: Option<u64>,
    last_checksum: String,
    sequence: u64,
}

/// Goes through a file. The chain begins with what the first record says of the one before.
pub fn verify(bytes: &[u8]) -> Verified {
    let mut scanned = Verified::default();
    let mut previous: Option<String> = None;
    let mut rest = bytes;
    while let Some(length) = rest.iter().position(|byte| *byte == b'\n') {
        let (line, after) = rest.split_at(length + 1);
        let is_last = after.is_empty();
        let record = std::str::from_utf8(&line[..length])
            .ok()
            .and_then(|line| verified(line, previous.as_deref()));
        let Some((checksum, sequence)) = record else {
            // A last line may be torn in the middle of a block; before the last it was changed.
            scanned.broken = (!is_last).then_some(scanned.records + 1);
            return scanned;
        };
        scanned.records += 1;
        scanned.end += length + 1;
        (scanned.last_checksum, scanned.sequence) = (checksum.clone(), sequence);
        previous = Some(checksum);
        rest = after;
    }
    scanned
}

/// Checksum and sequence number of a line that belongs to the chain.
fn verified(line: &str, previous: Option<&str>) -> Option<(String, u64)> {
    let (found, record) = line.split_once(' ')?;
    let link: Link = serde_json::from_str(record).ok()?;
    let stated = link.previous;
    let follows = previous.is_none_or(|previous| previous == stated);
    (follows && checksum(&stated, record) == found).then(|| (found.to_owned(), link.seq))
}

/// The part of a record that makes the chain: records of other versions may hold other details.
#[derive(serde::Deserialize)]
struct Link {
    #[serde(default)]
    seq: u64,
    previous: String,
}

fn checksum(previous: &str, record: &str) -> String {
    let digest = Sha256::new()
        .chain_update(previous)
        .chain_update("\n")
        .chain_update(record)
        .finalize();
    crate::hex(&digest)
}

/// Which boot of the machine this is.
pub fn boot_id() -> String {
    let id = fs::read_to_string("/proc/sys/kernel/random/boot_id");
    id.unwrap_or_default().trim().to_owned()
}

/// Now, as ISO 8601 in UTC with milliseconds.
pub fn utc_now() -> String {
    utc(std::time::SystemTime::now())
}

/// A time as ISO 8601 in UTC with milliseconds; before 1970 the beginning of 1970.
pub fn utc(time: std::time::SystemTime) -> String {
    let since = time
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap_or_default();
    let seconds = i64::try_from(since.as_secs()).unwrap_or_default();
    // No clock shows a year beyond 9999.
    let at = OffsetDateTime::from_unix_timestamp(seconds).unwrap_or(OffsetDateTime::UNIX_EPOCH);
    format!(
        "{:04}-{:02}-{:02}T{:02}:{:02}:{:02}.{:03}Z",
        at.year(),
        u8::from(at.month()),
        at.day(),
        at.hour(),
        at.minute(),
        at.second(),
        since.subsec_millis()
    )
}
