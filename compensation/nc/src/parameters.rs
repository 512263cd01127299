//! Parameters of a program: numbered and named ones. A value that only the machine knows, such as a probed position, is not known
//! here.

use std::collections::HashMap;

/// A number, or one that only the machine knows.
pub(crate) type Value = Option<f64>;

/// So many numbered parameters there are.
pub(crate) const MOST: u32 = 100_000;
/// Parameters that the control sets from what only it knows: probed positions, and what an input was.
const AT_MACHINE: [std::ops::RangeInclusive<u32>; 3] = [3000..=3999, 5061..=5070, 5399..=5399];

/// State: what the program has set so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Parameters {
    numbered: HashMap<u32, Value>,
    named: HashMap<String, Value>,
}

impl Parameters {
    /// The value of a numbered parameter: 0 where it was never set.
    pub(crate) fn numbered(&self, number: u32) -> Value {
        if AT_MACHINE.iter().any(|range| range.contains(&number)) {
            return None;
        }
        self.numbered.get(&number).copied().unwrap_or(Some(0.0))
    }

    pub(crate) fn set_numbered(&mut self, number: u32, value: Value) {
        self.numbered.insert(number, value);
    }

    /// The value of a named parameter; `None`: it was never set.
    pub(crate) fn named(&self, name: &str) -> Option<Value> {
        self.named.get(name).copied()
    }

    pub(crate) fn set_named(&mut self, name: &str, value: Value) {
        self.named.insert(name.to_owned(), value);
    }
}
