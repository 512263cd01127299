//! Texts and documents from files of the disk.

use std::{fs, io, path::Path};

use crate::toml_file::Document;

/// A file that cannot be read as text.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The system does not hand the file out: it is missing, a folder, or not readable for this user.
    #[error("{file}: cannot be read: {source}")]
    System {
        /// Name of the file.
        file: String,
        /// The answer of the system.
        source: io::Error,
    },
    /// The file holds bytes that are no UTF-8.
    #[error("{file}: byte {offset} is not UTF-8, expected a text file in UTF-8")]
    Encoding {
        /// Name of the file.
        file: String,
        /// Place of the first byte that is not UTF-8, from 0.
        offset: usize,
    },
}

impl Document {
    /// Reads a file. Its name in messages is its path as given.
    ///
    /// # Errors
    /// [`ReadError`]: the file cannot be read, or is not UTF-8.
    pub fn read(path: &Path) -> Result<Self, ReadError> {
        Ok(Self::new(&path.display().to_string(), &read_text(path)?))
    }
}

/// Reads a file as text.
///
/// # Errors
/// [`ReadError`]: the file cannot be read, or is not UTF-8.
pub fn read_text(path: &Path) -> Result<String, ReadError> {
    let file = path.display().to_string();
    let bytes = fs::read(path).map_err(|source| ReadError::System {
        file: file.clone(),
        source,
    })?;
    String::from_utf8(bytes).map_err(|error| ReadError::Encoding {
        file,
        offset: error.utf8_error().valid_up_to(),
    })
}
