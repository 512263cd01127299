//! Which keys a configuration states, and where.

use std::collections::BTreeMap;

use volcomp_document::{InputError, Section};

/// The full keys that a configuration states, those inside arrays of tables with their index: `controller.0.url`. Two are equal
/// when they have the same keys: where these stand is no part of what a configuration says.
#[derive(Clone, Debug, Default)]
pub struct StatedKeys(BTreeMap<String, InputError>);

impl PartialEq for StatedKeys {
    fn eq(&self, other: &Self) -> bool {
        self.0.keys().eq(other.0.keys())
    }
}

impl StatedKeys {
    pub(super) fn of(root: &Section<'_>) -> Self {
        let mut keys = Self::default();
        keys.collect(root, "");
        keys
    }

    /// Whether a key is stated.
    pub fn contains(&self, key: &str) -> bool {
        self.0.contains_key(key)
    }

    /// The place of a key that is stated, as an error there without a message.
    pub fn place(&self, key: &str) -> Option<&InputError> {
        self.0.get(key)
    }

    fn collect(&mut self, section: &Section<'_>, above: &str) {
        for (name, value) in section.values() {
            let key = format!("{above}{name}");
            if let Ok(inner) = value.section() {
                self.collect(&inner, &format!("{key}."));
            } else if let Ok(items) = value.items() {
                for (index, item) in items.iter().enumerate() {
                    if let Ok(inner) = item.section() {
                        self.collect(&inner, &format!("{key}.{index}."));
                    }
                }
            }
            self.0.insert(key, value.error(""));
        }
    }
}
