//! Which keys a configuration states.

use std::collections::BTreeSet;

use volcomp_document::Section;

/// The full keys that a configuration states, those inside arrays of tables with their index: `controller.0.url`.
pub(super) fn stated_keys(root: &Section<'_>) -> BTreeSet<String> {
    let mut keys = BTreeSet::new();
    collect(root, "", &mut keys);
    keys
}

fn collect(section: &Section<'_>, above: &str, keys: &mut BTreeSet<String>) {
    for (name, value) in section.values() {
        let key = format!("{above}{name}");
        if let Ok(inner) = value.section() {
            collect(&inner, &format!("{key}."), keys);
        } else if let Ok(items) = value.items() {
            for (index, item) in items.iter().enumerate() {
                if let Ok(inner) = item.section() {
                    collect(&inner, &format!("{key}.{index}."), keys);
                }
            }
        }
        keys.insert(key);
    }
}
