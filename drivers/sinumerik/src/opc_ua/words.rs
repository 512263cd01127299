//! Transfers the words of a map to the PLC, over a separate session.

use opcua::types::{DataValue, Variant};

use super::link::{Link, runtime};
use crate::{config::Server, error::SinumerikError, nodes::MapNodes};

const MAX_ARRAYS_PER_READ: usize = 16;

/// An open session that transfers a map to the PLC. Every exchange ends within the server's timeout. Drop the session
/// after a failed exchange, because its state is unknown.
pub struct MapWords {
    runtime: tokio::runtime::Runtime,
    link: Link,
    nodes: MapNodes,
    capacity: usize,
}

impl MapWords {
    /// Connects to a control whose buffers have `capacity` words each.
    ///
    /// # Errors
    /// The server cannot be reached, or rejects the connection.
    pub fn open(server: &Server, nodes: MapNodes, capacity: usize) -> Result<Self, SinumerikError> {
        let runtime = runtime()?;
        let link = runtime.block_on(Link::open(server))?;
        Ok(Self { runtime, link, nodes, capacity })
    }

    /// # Errors
    /// No response in time, or a response that is not an array of words.
    pub fn report(&self) -> Result<Vec<u16>, SinumerikError> {
        self.read(std::slice::from_ref(&self.nodes.report))
    }

    /// Writes the words of the mailbox as one array.
    ///
    /// # Errors
    /// No response in time, or a rejected write.
    pub fn write(&self, words: &[u16]) -> Result<(), SinumerikError> {
        let node = &self.nodes.mailbox;
        let value = Variant::from(words.to_vec());
        let write = self.link.write(std::iter::once((node, value)));
        match self.runtime.block_on(write)?.first() {
            Some(status) if status.is_good() => Ok(()),
            status => Err(SinumerikError::Node {
                node: node.clone(),
                found: status.map_or_else(|| "no status".to_owned(), ToString::to_string),
            }),
        }
    }

    /// Reads the first `count` words of buffer 0 or 1.
    ///
    /// # Errors
    /// Same as [`MapWords::report`].
    pub fn buffer(&self, buffer: u16, count: usize) -> Result<Vec<u16>, SinumerikError> {
        let mut words = Vec::new();
        let nodes = self.nodes.of_buffer(buffer, count, self.capacity);
        for some in nodes.chunks(MAX_ARRAYS_PER_READ) {
            words.extend(self.read(some)?);
        }
        words.truncate(count);
        Ok(words)
    }

    /// Closes the session properly, because a control admits only a few sessions.
    pub fn close(self) {
        self.runtime.block_on(self.link.close());
    }

    fn read(&self, nodes: &[String]) -> Result<Vec<u16>, SinumerikError> {
        let answer = self.runtime.block_on(self.link.read(nodes))?;
        let mut words = Vec::new();
        for (node, value) in nodes.iter().zip(&answer.values) {
            let found = words_of(value).ok_or_else(|| SinumerikError::Node {
                node: node.clone(),
                found: match value.status {
                    Some(status) if !status.is_good() => status.to_string(),
                    _ => "not an array of words".to_owned(),
                },
            })?;
            words.extend(found);
        }
        Ok(words)
    }
}

fn words_of(value: &DataValue) -> Option<Vec<u16>> {
    if value.status.is_some_and(|status| !status.is_good()) {
        return None;
    }
    let Some(Variant::Array(array)) = &value.value else {
        return None;
    };
    let word = |value: &Variant| match value {
        Variant::UInt16(word) => Some(*word),
        Variant::Int16(word) => Some(word.cast_unsigned()),
        _ => None,
    };
    array.values.iter().map(word).collect()
}
