//! The bytes of a file of messages that wait: records with lengths and a checksum, so that a torn end is seen.

use sha2::{Digest, Sha256};

/// Lengths of the kind, of the id and of the bytes, then eight bytes of the checksum.
const HEADER: usize = 1 + 2 + 4 + 8;

/// One message in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Record<'a> {
    pub(crate) kind: &'a str,
    pub(crate) id: &'a str,
    pub(crate) bytes: &'a [u8],
}

/// Adds a record. One whose kind, id or bytes are longer than their length can say is left out.
pub(crate) fn append(file: &mut Vec<u8>, record: Record<'_>) {
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

/// The records of a file up to the first that is torn or damaged.
pub(crate) fn records(mut file: &[u8]) -> impl Iterator<Item = Record<'_>> {
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
        /// Cut at any byte, or with any byte changed: what comes out is what went in, up to there.
        #[test]
        fn a_torn_or_damaged_file_gives_its_whole_records(
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
