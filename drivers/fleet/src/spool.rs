//! Queue of outgoing messages, bounded in memory and on disk. Messages are in memory while the server is reachable, and
//! on disk while it is not.
//!
//! Messages on disk survive the end of the program. A message is sent until the server acknowledges that it is stored.
//! After a crash some messages are sent again, and their ids identify duplicates.

use std::{
    collections::VecDeque,
    io,
    path::{Path, PathBuf},
};

use sha2::{Digest, Sha256};

use crate::Kind;

/// Maximum number of messages of a lane in memory. Beyond it all messages in memory are moved to disk. This does not
/// happen while the server is reachable.
const MAX_IN_MEMORY: usize = 64;
/// Maximum number of messages of a lane in memory while the disk rejects writes. Beyond it the oldest messages are
/// dropped.
const MAX_WITHOUT_DISK: usize = 1024;
/// Maximum size of a file on disk, bytes. A single larger message gets a larger file.
const FILE: usize = 256 * 1024;

/// Priority class of a message, by its [`Kind`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// Acknowledgements and audit records. They are sent first, and never dropped in favour of telemetry.
    Kept,
    /// Conditions and telemetry. They are sent last and dropped first.
    Passing,
}

impl Lane {
    pub fn of(kind: Kind) -> Self {
        match kind {
            Kind::Ack | Kind::Audit => Self::Kept,
            Kind::Condition | Kind::Telemetry => Self::Passing,
        }
    }
}

/// Maximum sizes of the two lanes of the queue on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpoolLimits {
    /// Maximum for acknowledgements and audit records, bytes.
    pub kept_bytes: u64,
    /// Maximum for conditions and telemetry, bytes.
    pub passing_bytes: u64,
}

impl Default for SpoolLimits {
    /// 16 MiB for acknowledgements and audit records, and 64 MiB for conditions and telemetry, which suffices for about
    /// a day.
    fn default() -> Self {
        Self { kept_bytes: 16 << 20, passing_bytes: 64 << 20 }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Waiting {
    pub kind: Kind,
    /// Identifier by which the server and the centre recognize duplicates.
    pub id: String,
    pub bytes: Vec<u8>,
}

/// Messages waiting for the server.
#[derive(Debug)]
pub struct Spool {
    kept: Queue,
    passing: Queue,
}

impl Spool {
    /// Opens the folder and lists its files. The complete messages of a file that a crash has torn are recovered.
    ///
    /// # Errors
    /// The folder cannot be created or read.
    pub fn open(folder: &Path, limits: SpoolLimits) -> io::Result<Self> {
        Ok(Self {
            kept: Queue::open(folder.join("kept"), limits.kept_bytes)?,
            passing: Queue::open(folder.join("passing"), limits.passing_bytes)?,
        })
    }

    /// Adds a message. If there is no room, drops the oldest message of its lane, which [`dropped`](Self::dropped)
    /// counts.
    pub fn push(&mut self, message: Waiting) {
        self.lane(Lane::of(message.kind)).push(message);
    }

    /// Next message of a lane to send. Returns the same message until [`done`](Self::done) is called.
    pub fn first(&mut self, lane: Lane) -> Option<&Waiting> {
        self.lane(lane).first()
    }

    /// Removes the message that [`first`](Self::first) returned, after the server has stored it.
    pub fn done(&mut self, lane: Lane) {
        self.lane(lane).done();
    }

    /// Number of messages since the start that were dropped for lack of room or lost with damaged files.
    pub fn dropped(&self) -> u64 {
        self.kept.dropped + self.passing.dropped
    }

    /// Current disk error; `None` if the last disk operation succeeded or no disk operation was needed.
    pub fn trouble(&self) -> Option<&str> {
        self.kept.trouble.as_deref().or(self.passing.trouble.as_deref())
    }

    /// Writes the messages in memory to disk. Call this before the program ends.
    pub fn flush(&mut self) {
        for queue in [&mut self.kept, &mut self.passing] {
            queue.take_back();
            queue.spill();
        }
    }

    fn lane(&mut self, lane: Lane) -> &mut Queue {
        match lane {
            Lane::Kept => &mut self.kept,
            Lane::Passing => &mut self.passing,
        }
    }
}

/// A file on disk. Its name contains a number, by which files are ordered, and the number of its messages. From the
/// latter, the messages lost with a damaged file are counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Stored {
    number: u64,
    messages: u64,
    bytes: u64,
}

impl Stored {
    /// Parses a file name; `None` if the file does not belong to this queue.
    fn named(name: &str, bytes: u64) -> Option<Self> {
        let (number, messages) = name.strip_suffix(".spool")?.split_once('-')?;
        Some(Self { number: number.parse().ok()?, messages: messages.parse().ok()?, bytes })
    }

    fn name(self) -> String {
        format!("{:012}-{}.spool", self.number, self.messages)
    }
}

/// Queue of one lane. The messages of the open file are sent first, then those of the other files, then those in
/// memory.
#[derive(Debug)]
struct Queue {
    folder: PathBuf,
    limit: u64,
    files: VecDeque<Stored>,
    /// File whose messages are currently being sent.
    open: Option<Stored>,
    /// Messages of the open file that are not sent yet.
    front: VecDeque<Waiting>,
    /// The message that was returned last, and whether it came from the open file. It is outside the queue, so that it
    /// is not dropped while it is being sent.
    given: Option<(Waiting, bool)>,
    /// The newest messages, which are in no file yet.
    memory: VecDeque<Waiting>,
    next_file: u64,
    dropped: u64,
    trouble: Option<String>,
}

impl Queue {
    fn open(folder: PathBuf, limit: u64) -> io::Result<Self> {
        std::fs::create_dir_all(&folder)?;
        let mut files: Vec<Stored> = Vec::new();
        for entry in std::fs::read_dir(&folder)? {
            let entry = entry?;
            let name = entry.file_name();
            let length = entry.metadata()?.len();
            files.extend(name.to_str().and_then(|name| Stored::named(name, length)));
        }
        files.sort_unstable();
        Ok(Self {
            next_file: files.last().map_or(0, |file| file.number.saturating_add(1)),
            files: files.into(),
            folder,
            limit,
            open: None,
            front: VecDeque::new(),
            given: None,
            memory: VecDeque::new(),
            dropped: 0,
            trouble: None,
        })
    }

    fn path(&self, file: Stored) -> PathBuf {
        self.folder.join(file.name())
    }

    fn push(&mut self, message: Waiting) {
        self.memory.push_back(message);
        // After a disk failure every further message causes another attempt to write.
        if self.memory.len() > MAX_IN_MEMORY {
            self.spill();
        }
        while self.memory.len() > MAX_WITHOUT_DISK {
            self.memory.pop_front();
            self.dropped += 1;
        }
    }

    /// Moves messages from memory to files, and removes the oldest files if there is no room.
    fn spill(&mut self) {
        while !self.memory.is_empty() {
            let mut bytes = Vec::new();
            let mut count = 0;
            for message in &self.memory {
                if count > 0 && bytes.len() + message.bytes.len() > FILE {
                    break;
                }
                append(
                    &mut bytes,
                    Record { kind: message.kind.name(), id: &message.id, bytes: &message.bytes },
                );
                count += 1;
            }
            let length = bytes.len() as u64;
            self.make_room(length);
            let file = Stored { number: self.next_file, messages: count as u64, bytes: length };
            let path = self.path(file);
            if let Err(e) = std::fs::write(&path, &bytes) {
                // A partial file may remain. Its messages are still in memory and would be sent twice.
                let _ = std::fs::remove_file(&path);
                self.trouble = Some(format!("{}: {e}", path.display()));
                return;
            }
            self.trouble = None;
            self.files.push_back(file);
            self.next_file = self.next_file.saturating_add(1);
            self.memory.drain(..count);
        }
    }

    fn make_room(&mut self, length: u64) {
        let held = |files: &VecDeque<Stored>| files.iter().map(|file| file.bytes).sum::<u64>();
        while held(&self.files) + length > self.limit {
            let Some(file) = self.files.pop_front() else {
                return;
            };
            self.dropped = self.dropped.saturating_add(file.messages);
            let _ = std::fs::remove_file(self.path(file));
        }
    }

    fn first(&mut self) -> Option<&Waiting> {
        if self.given.is_none() {
            self.given = self.next();
        }
        self.given.as_ref().map(|(message, _)| message)
    }

    fn next(&mut self) -> Option<(Waiting, bool)> {
        while self.front.is_empty() {
            self.close();
            let Some(file) = self.files.pop_front() else {
                return self.memory.pop_front().map(|message| (message, false));
            };
            let path = self.path(file);
            match std::fs::read(&path) {
                // The file may still exist, so it will be read again later. Meanwhile newer messages are sent.
                Err(e) if e.kind() != io::ErrorKind::NotFound || !self.folder.is_dir() => {
                    self.trouble = Some(format!("{}: {e}", path.display()));
                    self.files.push_front(file);
                    return self.memory.pop_front().map(|message| (message, false));
                }
                Err(_) => self.dropped = self.dropped.saturating_add(file.messages),
                Ok(bytes) => self.give_out(file, &bytes),
            }
        }
        self.front.pop_front().map(|message| (message, true))
    }

    /// Loads the messages of a file. Drops damaged messages, and messages of a kind that this version of the program
    /// does not support.
    fn give_out(&mut self, file: Stored, bytes: &[u8]) {
        self.open = Some(file);
        self.trouble = None;
        let waiting = records(bytes).filter_map(|record| {
            Some(Waiting {
                kind: Kind::with_name(record.kind)?,
                id: record.id.to_owned(),
                bytes: record.bytes.to_vec(),
            })
        });
        self.front.extend(waiting);
        let lost = file.messages.saturating_sub(self.front.len() as u64);
        self.dropped = self.dropped.saturating_add(lost);
    }

    fn done(&mut self) {
        self.given = None;
        if self.front.is_empty() {
            self.close();
        }
    }

    /// Puts the message that `first` handed out back into the queue. Messages of the open file are also on disk.
    fn take_back(&mut self) {
        match self.given.take() {
            Some((message, true)) => self.front.push_front(message),
            Some((message, false)) => self.memory.push_front(message),
            None => {}
        }
    }

    fn close(&mut self) {
        if let Some(file) = self.open.take() {
            let _ = std::fs::remove_file(self.path(file));
        }
    }
}

/// Size of the header of a record, bytes: 1 for the length of the kind, 2 for the length of the id, 4 for the length of
/// the content, and 8 for a checksum, which detects a torn end.
const HEADER: usize = 1 + 2 + 4 + 8;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Record<'a> {
    kind: &'a str,
    id: &'a str,
    bytes: &'a [u8],
}

/// Appends a record. Omits a record whose kind, id or content is too long for its length field.
fn append(file: &mut Vec<u8>, record: Record<'_>) {
    let lengths = (
        u8::try_from(record.kind.len()),
        u16::try_from(record.id.len()),
        u32::try_from(record.bytes.len()),
    );
    let (Ok(kind), Ok(id), Ok(bytes)) = lengths else {
        return;
    };
    file.push(kind);
    file.extend_from_slice(&id.to_le_bytes());
    file.extend_from_slice(&bytes.to_le_bytes());
    file.extend_from_slice(&checksum(record));
    file.extend_from_slice(record.kind.as_bytes());
    file.extend_from_slice(record.id.as_bytes());
    file.extend_from_slice(record.bytes);
}

/// Records of a file, up to the first torn or damaged record.
fn records(mut file: &[u8]) -> impl Iterator<Item = Record<'_>> {
    std::iter::from_fn(move || {
        let (header, rest) = file.split_at_checked(HEADER)?;
        let kind = usize::from(header[0]);
        let id = usize::from(u16::from_le_bytes([header[1], header[2]]));
        let bytes = u32::from_le_bytes([header[3], header[4], header[5], header[6]]);
        let (kind, rest) = rest.split_at_checked(kind)?;
        let (id, rest) = rest.split_at_checked(id)?;
        let (bytes, rest) = rest.split_at_checked(usize::try_from(bytes).ok()?)?;
        let record = Record {
            kind: std::str::from_utf8(kind).ok()?,
            id: std::str::from_utf8(id).ok()?,
            bytes,
        };
        if checksum(record) != header[7..] {
            return None;
        }
        file = rest;
        Some(record)
    })
}

fn checksum(record: Record<'_>) -> [u8; 8] {
    let digest = Sha256::new()
        .chain_update((record.kind.len() as u64).to_le_bytes())
        .chain_update((record.id.len() as u64).to_le_bytes())
        .chain_update(record.kind)
        .chain_update(record.id)
        .chain_update(record.bytes)
        .finalize();
    let mut short = [0; 8];
    short.copy_from_slice(&digest[..8]);
    short
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// A file that is cut at any byte, or has one changed byte, yields all records before that byte unchanged.
        #[test]
        fn a_damaged_file_yields_its_complete_records(
            messages in proptest::collection::vec(("[a-z]{0,9}", ".{0,20}", proptest::collection::vec(any::<u8>(), 0..40)), 0..8),
            at in any::<proptest::sample::Index>(),
            change in proptest::option::of(1_u8..),
        ) {
            let mut file = Vec::new();
            for (kind, id, bytes) in &messages {
                append(&mut file, Record { kind, id, bytes });
            }
            let whole: Vec<_> = records(&file).map(|r| (r.kind.to_owned(), r.id.to_owned(), r.bytes.to_vec())).collect();
            prop_assert_eq!(&whole, &messages);
            if !file.is_empty() {
                let at = at.index(file.len());
                match change {
                    Some(change) => file[at] ^= change,
                    None => file.truncate(at),
                }
                let found: Vec<_> = records(&file).map(|r| (r.kind.to_owned(), r.id.to_owned(), r.bytes.to_vec())).collect();
                prop_assert!(found.len() < messages.len());
                prop_assert_eq!(&found[..], &messages[..found.len()]);
            }
        }
    }
}
