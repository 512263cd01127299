//! The audit-log records that have not been sent to the centre. They are read from the log files, so only records on
//! disk are sent, in log order.

use std::{
    collections::VecDeque,
    fs::{self, File},
    io::{Read, Seek, SeekFrom},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use volcomp_fleet::AuditLine;

use crate::audit::{log_files, replace_file};

/// Maximum size of one read, bytes.
const PIECE: u64 = 256 * 1024;

/// Checksum of the last record sent; empty if none was sent.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Cursor {
    checksum: String,
}

#[derive(Clone, Copy)]
struct LogPosition {
    inode: u64,
    offset: u64,
}

/// Follows the log while another thread writes it, and stores the position up to which it was sent.
pub(super) struct AuditTail {
    folder: PathBuf,
    cursor_file: PathBuf,
    sent: Cursor,
    written: Cursor,
    /// Next read position; `None` before the first read, which continues after the record of the cursor.
    place: Option<LogPosition>,
    lines: VecDeque<AuditLine>,
}

impl AuditTail {
    pub(super) fn new(folder: PathBuf, cursor_file: PathBuf) -> Self {
        let text = fs::read_to_string(&cursor_file).unwrap_or_default();
        let sent: Cursor = serde_json::from_str(&text).unwrap_or_default();
        Self {
            folder,
            cursor_file,
            written: sent.clone(),
            sent,
            place: None,
            lines: VecDeque::new(),
        }
    }

    /// The next record to send. It stays the same until [`done`](Self::done).
    pub(super) fn first(&mut self) -> Option<&AuditLine> {
        if self.lines.is_empty() {
            self.read();
        }
        self.lines.front()
    }

    /// Marks the record returned by [`first`](Self::first) as stored at the server, and removes it.
    pub(super) fn done(&mut self) {
        if let Some(line) = self.lines.pop_front() {
            self.sent.checksum = line.checksum;
        }
    }

    /// Saves the cursor. After a crash the last records may be sent again; their checksums identify them.
    pub(super) fn keep(&mut self) {
        if self.sent == self.written {
            return;
        }
        let text = serde_json::to_string(&self.sent).unwrap_or_default();
        // If this fails, some records are sent again after a restart.
        if replace_file(&self.cursor_file, &text).is_ok() {
            self.written = self.sent.clone();
        }
    }

    fn read(&mut self) {
        let files: Vec<(PathBuf, u64)> = log_files(&self.folder)
            .into_iter()
            .filter_map(|path| Some((path.clone(), fs::metadata(path).ok()?.ino())))
            .collect();
        let Some(mut place) = self.place.or_else(|| self.find_position(&files)) else {
            return;
        };
        // The file is no longer among the kept files, so its unread records are lost. The centre detects the gap by
        // their sequence numbers.
        let mut index =
            (files.iter()).position(|(_, inode)| *inode == place.inode).unwrap_or_else(|| {
                place.offset = 0;
                0
            });
        while self.lines.is_empty()
            && let Some((path, inode)) = files.get(index)
        {
            place.inode = *inode;
            let (lines, read) = lines_at(path, &mut place.offset);
            self.lines.extend(lines);
            place.offset += read;
            let is_last = index + 1 == files.len();
            if self.lines.is_empty() && read == 0 {
                if is_last {
                    break;
                }
                index += 1;
                place.offset = 0;
            }
        }
        self.place = Some(place);
    }

    /// The position after the last record sent. If that record is not found: the start of the oldest file. If no record
    /// was ever sent: the start of the current file.
    fn find_position(&self, files: &[(PathBuf, u64)]) -> Option<LogPosition> {
        let (_, current) = files.last()?;
        if self.sent.checksum.is_empty() {
            return Some(LogPosition { inode: *current, offset: 0 });
        }
        for (path, inode) in files.iter().rev() {
            let mut at = 0;
            loop {
                let (lines, read) = lines_at(path, &mut at);
                let mut end = at;
                for line in &lines {
                    // Length of a line: the checksum, a space, the record and a line feed.
                    end += (line.checksum.len() + line.record.len() + 2) as u64;
                    if line.checksum == self.sent.checksum {
                        return Some(LogPosition { inode: *inode, offset: end });
                    }
                }
                if read == 0 {
                    break;
                }
                at += read;
            }
        }
        let (_, oldest) = files.first()?;
        Some(LogPosition { inode: *oldest, offset: 0 })
    }
}

/// The complete lines of a file from an offset, up to [`PIECE`] bytes, and their length in bytes. An offset beyond the
/// end, which remains after a torn record was cut off, is set to the end.
fn lines_at(path: &Path, offset: &mut u64) -> (Vec<AuditLine>, u64) {
    let mut piece = || -> std::io::Result<Vec<u8>> {
        let mut file = File::open(path)?;
        *offset = file.metadata()?.len().min(*offset);
        file.seek(SeekFrom::Start(*offset))?;
        let mut bytes = Vec::new();
        file.take(PIECE).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    let bytes = piece().unwrap_or_default();
    let is_full = bytes.len() as u64 == PIECE;
    let end = match bytes.iter().rposition(|byte| *byte == b'\n') {
        Some(last) => last + 1,
        // No record is this long: skip these bytes.
        None if is_full => bytes.len(),
        None => 0,
    };
    let lines = String::from_utf8_lossy(&bytes[..end]);
    let lines = lines.lines().filter_map(|line| {
        let (checksum, record) = line.split_once(' ')?;
        Some(AuditLine { checksum: checksum.to_owned(), record: record.to_owned() })
    });
    (lines.collect(), end as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        audit::AuditLog,
        documents::{ByAxis, Details, Event},
    };

    fn details() -> Details {
        Details {
            model: String::new(),
            output_um: ByAxis::new(),
            output_urad: ByAxis::new(),
            what: Event::Nothing,
        }
    }

    fn sent(tail: &mut AuditTail) -> Vec<String> {
        let mut whats = Vec::new();
        while let Some(line) = tail.first() {
            let record: serde_json::Value = serde_json::from_str(&line.record).expect("JSON");
            whats.push(record["what"].as_str().expect("text").to_owned());
            tail.done();
        }
        tail.keep();
        whats
    }

    /// Across rotations and restarts each record is returned once and in order, so that the receiver can verify the
    /// hash chain.
    #[test]
    fn every_record_once_over_rotations_and_restarts() {
        let dir = tempfile::tempdir().expect("writable");
        let (log, _) = AuditLog::open(dir.path()).expect("writable");
        let mut log = log.rotating_at(2000);
        let cursor = dir.path().join("cursor.json");
        let open = || AuditTail::new(dir.path().to_owned(), cursor.clone());
        let mut tail = open();
        let mut expected = Vec::new();
        let mut found = Vec::new();
        for number in 0..60 {
            let what = format!("event {number}");
            log.append("test", &what, details()).expect("writable");
            expected.push(what);
            if number % 7 == 3 {
                found.extend(sent(&mut tail));
            }
            if number % 13 == 5 {
                tail = open();
            }
        }
        found.extend(sent(&mut tail));
        assert_eq!(found, expected);
        assert_eq!(sent(&mut open()), [""; 0], "nothing twice");
    }

    /// A partly written line is returned only when it is complete.
    #[test]
    fn a_torn_end_waits() {
        let dir = tempfile::tempdir().expect("writable");
        let mut tail = AuditTail::new(dir.path().to_owned(), dir.path().join("cursor.json"));
        let log = crate::audit::log_file(dir.path());
        fs::write(&log, "aa {\"what\":\"one\"}\nbb {\"wh").expect("writable");
        assert_eq!(sent(&mut tail), ["one"]);
        fs::write(&log, "aa {\"what\":\"one\"}\nbb {\"what\":\"two\"}\n").expect("writable");
        assert_eq!(sent(&mut tail), ["two"]);
    }
}
