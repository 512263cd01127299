//! Reads texts and documents from disk.

use std::{
    fs::File,
    io::{self, Read},
    path::Path,
};

use crate::toml_file::{Document, MOST_BYTES};

/// Reason why a file cannot be read as text.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The operating system cannot read the file, because it is missing, is a folder, or is not readable for this user.
    #[error("{file}: cannot be read: {source}")]
    System {
        /// Path as given by the caller.
        file: String,
        source: io::Error,
    },
    /// The file contains bytes that are not UTF-8.
    #[error("{file}: byte {offset} is not UTF-8, expected a text file in UTF-8")]
    Encoding {
        /// Path as given by the caller.
        file: String,
        /// Offset of the first byte that is not UTF-8, counted from 0.
        offset: usize,
    },
    /// The file is longer than [`MAX_TEXT_BYTES`], or it is a device without an end, such as `/dev/zero`.
    #[error("{file}: found more than {} MiB, expected a text file of at most that size", MAX_TEXT_BYTES >> 20)]
    TooLarge {
        /// Path as given by the caller.
        file: String,
    },
}

/// Maximum size of a text file that is not a document, bytes.
pub const MAX_TEXT_BYTES: u64 = 256 << 20;

impl Document {
    /// Reads a file. Messages name the file by `path`.
    ///
    /// # Errors
    /// [`ReadError`]: the file cannot be read, or is not UTF-8.
    pub fn read(path: &Path) -> Result<Self, ReadError> {
        // One byte more than the limit suffices for `decode` to reject the file.
        let text = text_of(path, MOST_BYTES as u64 + 1)?;
        Ok(Self::new(&path.display().to_string(), &text))
    }
}

/// Reads a file or an unnamed pipe as text.
///
/// # Errors
/// [`ReadError`]: the file cannot be read, is a named pipe, is not UTF-8, or is longer than [`MAX_TEXT_BYTES`].
pub fn read_text(path: &Path) -> Result<String, ReadError> {
    let text = text_of(path, MAX_TEXT_BYTES + 1)?;
    if text.len() as u64 > MAX_TEXT_BYTES {
        return Err(ReadError::TooLarge { file: path.display().to_string() });
    }
    Ok(text)
}

/// Reads a file or an unnamed pipe.
///
/// # Errors
/// It cannot be read, is a named pipe, or is longer than [`MAX_TEXT_BYTES`].
pub fn read_bytes(path: &Path) -> io::Result<Vec<u8>> {
    bytes_of(open(path)?)
}

/// Opens a file or an unnamed pipe.
pub(crate) fn open(path: &Path) -> io::Result<File> {
    refuse_named_pipe(path)?;
    File::open(path)
}

/// Refuses a named pipe: opening one without a writer would never return.
///
/// # Errors
/// The path is a named pipe, or does not exist.
pub fn refuse_named_pipe(path: &Path) -> io::Result<()> {
    #[cfg(not(unix))]
    let _ = path;
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        // `/dev/stdin` and a process substitution of the shell are links, whose pipes are open already.
        if path.symlink_metadata()?.file_type().is_fifo() {
            let found = "found a named pipe, expected a file";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, found));
        }
    }
    Ok(())
}

pub(crate) fn bytes_of(file: File) -> io::Result<Vec<u8>> {
    let bytes = up_to(file, MAX_TEXT_BYTES + 1)?;
    if bytes.len() as u64 > MAX_TEXT_BYTES {
        let found = format!("found more than {} MiB, expected at most that", MAX_TEXT_BYTES >> 20);
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, found));
    }
    Ok(bytes)
}

/// The first `most` bytes of a file or a pipe.
fn up_to(file: File, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(most).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn text_of(path: &Path, most: u64) -> Result<String, ReadError> {
    let file = path.display().to_string();
    let bytes = open(path)
        .and_then(|file| up_to(file, most))
        .map_err(|source| ReadError::System { file: file.clone(), source })?;
    let is_cut = bytes.len() as u64 == most;
    String::from_utf8(bytes).or_else(|error| match error.utf8_error() {
        // The limit has cut a character in two.
        end if is_cut && end.error_len().is_none() => {
            Ok(String::from_utf8_lossy(error.as_bytes()).into_owned())
        }
        wrong => Err(ReadError::Encoding { file, offset: wrong.valid_up_to() }),
    })
}
