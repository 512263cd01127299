//! The audit log: every change of state with the client that requested it, as a hash chain of records.
//!
//! A line is `CHECKSUM JSON`. The checksum is SHA-256 over the checksum of the previous line, a line feed, and the
//! JSON. A record is on disk when [`AuditLog::append`] returns.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Seek, SeekFrom, Write},
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
};

use sha2::{Digest, Sha256};
use time::OffsetDateTime;
use volcomp_document::refuse_named_pipe;
use volcomp_runtime::monotonic;

pub mod writer;

use crate::documents::{Broken, Details, Record};

/// Size above which the current file is closed and the next one started, bytes.
const MAX_BYTES: u64 = 4 << 20;
/// Number of closed files that are kept in addition to the current one.
const KEPT: usize = 8;
const CURRENT: &str = "audit.log";
/// File created by a rotation, until it is renamed to the current file.
const NEXT: &str = "audit.log.new";

/// Path of the current file in the log folder.
pub fn log_file(dir: &Path) -> PathBuf {
    dir.join(CURRENT)
}

/// The existing files of the log, oldest first, the current file last.
pub fn log_files(dir: &Path) -> Vec<PathBuf> {
    let old = (1..=KEPT).rev().map(|n| dir.join(format!("audit.{n}.log")));
    let all = old.chain([log_file(dir)]);
    all.filter(|path| path.is_file()).collect()
}

/// Rejects a folder with a named pipe: reading or writing it could wait without end.
fn refuse_pipes(dir: &Path) -> io::Result<()> {
    for entry in fs::read_dir(dir)? {
        let path = entry?.path();
        refuse_named_pipe(&path).map_err(|error| {
            io::Error::new(error.kind(), format!("{}: {error}", path.display()))
        })?;
    }
    Ok(())
}

/// Maximum number of records that [`last_records`] returns.
pub const MAX_LAST: usize = 500;
const MAX_LAST_BYTES: u64 = 1 << 20;

/// The last records of the log, newest first: at most `count` and at most [`MAX_LAST`]. Invalid lines are skipped; the
/// hash chain is not verified.
///
/// # Errors
/// A file cannot be read.
pub fn last_records(dir: &Path, count: usize) -> io::Result<Vec<Record>> {
    let count = count.min(MAX_LAST);
    let mut records = Vec::new();
    let mut left = MAX_LAST_BYTES;
    for path in log_files(dir).into_iter().rev() {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        let skipped = length.saturating_sub(left);
        file.seek(SeekFrom::Start(skipped))?;
        let mut bytes = Vec::new();
        file.take(left).read_to_end(&mut bytes)?;
        let lines = bytes.split(|byte| *byte == b'\n').rev();
        let parsed = lines.filter_map(|line| {
            let (_, record) = std::str::from_utf8(line).ok()?.split_once(' ')?;
            serde_json::from_str(record).ok()
        });
        records.extend(parsed.take(count - records.len()));
        left = left.saturating_sub(length);
        if records.len() == count || left == 0 {
            break;
        }
    }
    Ok(records)
}

/// The state of the log when it was opened.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogState {
    /// Number of complete records in the current file.
    pub records: u64,
    /// Length of an incomplete last record that was cut off, bytes.
    pub cut_bytes: u64,
    /// Damaged file that was moved aside because its hash chain was broken.
    pub broken: Option<Broken>,
}

/// A record that is not yet in the chain, with the time of its creation.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    who: String,
    what: String,
    details: Details,
    monotonic_s: f64,
    time: String,
}

impl Entry {
    /// Creates a record with the current time.
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
    pub(crate) fn standing_file(&self) -> PathBuf {
        standing_file(&self.dir)
    }

    /// Opens the log in a folder, which is created if it is missing. An incomplete last record is
    /// cut off; a file with a broken chain is moved aside and a new one started.
    ///
    /// # Errors
    ///
    /// The folder or file cannot be written, or the folder contains a named pipe.
    pub fn open(dir: &Path) -> io::Result<(Self, LogState)> {
        fs::create_dir_all(dir)?;
        refuse_pipes(dir)?;
        let path = log_file(dir);
        let mut file = OpenOptions::new().read(true).append(true).create(true).open(&path)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)?;
        let mut scanned = verify(&bytes);
        if bytes.is_empty() {
            // A rotation was interrupted before the first record: the chain continues from the previous file.
            let before = verify(&fs::read(dir.join("audit.1.log")).unwrap_or_default());
            (scanned.last_checksum, scanned.sequence) = (before.last_checksum, before.sequence);
        }
        let mut found = LogState { records: scanned.records, ..LogState::default() };
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
                last_checksum: if is_broken { String::new() } else { scanned.last_checksum },
                sequence: if is_broken { 0 } else { scanned.sequence },
                boot_id: boot_id(),
                max_bytes: MAX_BYTES,
            },
            found,
        ))
    }

    /// Sets the size at which the next file is started, bytes.
    #[must_use]
    pub fn rotating_at(mut self, bytes: u64) -> Self {
        self.max_bytes = bytes;
        self
    }

    /// Replaces the function that syncs the file; tests use it to simulate a disk that hangs.
    #[must_use]
    pub fn synced_by(mut self, sync: impl FnMut(&File) -> io::Result<()> + Send + 'static) -> Self {
        self.sync = Box::new(sync);
        self
    }

    /// Appends a record with the current time and syncs it to disk.
    ///
    /// # Errors
    /// The disk is full or does not respond; no part of the record remains in the file.
    pub fn append(&mut self, who: &str, what: &str, details: Details) -> io::Result<()> {
        self.write(&Entry::new(who, what, details), 0)
    }

    /// Appends a record that states the number `lost` of earlier records that could not be written, and syncs it to
    /// disk.
    ///
    /// # Errors
    /// The disk is full or does not respond; no part of the record remains in the file.
    pub fn write(&mut self, entry: &Entry, lost: u64) -> io::Result<()> {
        let in_place = is_at(&self.file, &log_file(&self.dir));
        if !in_place {
            tracing::error!("the audit log was moved or removed: a new file continues its chain");
        }
        if !in_place || self.bytes > self.max_bytes {
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
        let written = self.file.write_all(line.as_bytes()).and_then(|()| (self.sync)(&self.file));
        if let Err(e) = written {
            // Cut off a partial record now if possible, because it would remain as a torn tail.
            let _ = self.file.set_len(self.bytes);
            return Err(e);
        }
        self.bytes += line.len() as u64;
        (self.sequence, self.last_checksum) = (sequence, checksum);
        Ok(())
    }

    /// Renames the current file to `audit.1.log` and older files accordingly; the chain continues in a new file. The
    /// new file is created first, so that nothing is renamed on a full disk. A repetition after a failure overwrites no
    /// file but the oldest.
    fn rotate(&mut self) -> io::Result<()> {
        restore_folder(&self.dir, &self.file)?;
        let next = self.dir.join(NEXT);
        let file = OpenOptions::new().append(true).create(true).open(&next)?;
        let current = log_file(&self.dir);
        if current.exists() {
            let old = |n: usize| self.dir.join(format!("audit.{n}.log"));
            let free = (1..KEPT).find(|n| !old(*n).exists()).unwrap_or(KEPT);
            for n in (1..free).rev() {
                fs::rename(old(n), old(n + 1))?;
            }
            fs::rename(&current, old(1))?;
        }
        fs::rename(&next, &current)?;
        self.file = file;
        self.bytes = 0;
        sync_folder(&self.dir)
    }
}

/// True if an open file is still the file at this path.
fn is_at(file: &File, path: &Path) -> bool {
    let [Ok(ours), Ok(there)] = [file.metadata(), fs::metadata(path)] else {
        return false;
    };
    (ours.dev(), ours.ino()) == (there.dev(), there.ino())
}

pub(crate) fn standing_file(dir: &Path) -> PathBuf {
    dir.join("standing.slots")
}

pub(crate) fn output_file(dir: &Path) -> PathBuf {
    dir.join("output.json")
}

/// Creates a folder again that was removed while a file in it was open. If the folder above is on another file system
/// than that file, its disk is missing, and what is written would be gone when the disk is back: nothing is created.
fn restore_folder(dir: &Path, file: &File) -> io::Result<()> {
    if dir.exists() {
        return Ok(());
    }
    let above = dir.parent().filter(|above| !above.as_os_str().is_empty());
    if fs::metadata(above.unwrap_or(Path::new(".")))?.dev() != file.metadata()?.dev() {
        return Err(io::ErrorKind::NotFound.into());
    }
    fs::create_dir(dir)
}

/// Replaces a small file atomically and syncs it to disk.
///
/// # Errors
/// The disk is full or does not respond.
pub fn replace_file(path: &Path, text: &str) -> io::Result<()> {
    let temporary = path.with_extension("new");
    let placed = File::create(&temporary).and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&temporary, path)
    });
    if placed.is_err() {
        // A partial temporary file would use the last space of a full disk.
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
    /// Number of complete records in the chain.
    pub records: u64,
    /// Length of the complete records, bytes.
    pub end: usize,
    /// Number, from 1, of the first complete line that is not part of the chain.
    pub broken: Option<u64>,
    last_checksum: String,
    sequence: u64,
}

/// Verifies a file. The chain starts with the previous checksum named in the first record.
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
            // Only an invalid last line can be an interrupted write; an earlier invalid line was modified.
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

/// Checksum and sequence number of a line; `None` if the line does not continue the hash chain.
fn verified(line: &str, previous: Option<&str>) -> Option<(String, u64)> {
    let (found, record) = line.split_once(' ')?;
    let link: Link = serde_json::from_str(record).ok()?;
    let stated = link.previous;
    let follows = previous.is_none_or(|previous| previous == stated);
    (follows && checksum(&stated, record) == found).then(|| (found.to_owned(), link.seq))
}

/// The fields of a record that form the hash chain. `details` is not parsed, because it differs between versions.
#[derive(serde::Deserialize)]
struct Link {
    #[serde(default)]
    seq: u64,
    previous: String,
}

fn checksum(previous: &str, record: &str) -> String {
    let digest =
        Sha256::new().chain_update(previous).chain_update("\n").chain_update(record).finalize();
    volcomp_model::hexadecimal(&digest)
}

/// The kernel's boot ID; empty if it cannot be read.
pub fn boot_id() -> String {
    let id = fs::read_to_string("/proc/sys/kernel/random/boot_id");
    id.unwrap_or_default().trim().to_owned()
}

/// The current time in ISO 8601, UTC, with milliseconds.
pub fn utc_now() -> String {
    utc(std::time::SystemTime::now())
}

/// A time in ISO 8601, UTC, with milliseconds; times before 1970 become the start of 1970.
pub fn utc(time: std::time::SystemTime) -> String {
    let since = time.duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    let seconds = i64::try_from(since.as_secs()).unwrap_or_default();
    // `time` supports years up to 9999.
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
