//! Parameters of a program: numbered and named ones, with those of a subroutine for its own. A value that only the machine
//! knows, such as a probed position, is not known here.

use std::collections::HashMap;

/// A number, or one that only the machine knows.
pub type Value = Option<f64>;

/// The first numbered parameters are a subroutine's own.
const LOCAL: u32 = 30;
/// So many numbered parameters there are.
pub(crate) const MOST: u32 = 100_000;
/// Parameters that the control sets from what only it knows: probed positions, and what an input was.
const AT_MACHINE: [std::ops::RangeInclusive<u32>; 3] = [3000..=3999, 5061..=5070, 5399..=5399];

/// State: what the program has set so far.
#[derive(Clone, Debug)]
pub(crate) struct Parameters {
    numbered: HashMap<u32, Value>,
    /// Named ones whose names begin with an underscore.
    global: HashMap<String, Value>,
    /// The own parameters of each subroutine that is being executed, the main program first.
    frames: Vec<Frame>,
}

#[derive(Clone, Debug, Default)]
struct Frame {
    numbered: HashMap<u32, Value>,
    named: HashMap<String, Value>,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            numbered: HashMap::new(),
            global: HashMap::new(),
            frames: vec![Frame::default()],
        }
    }
}

impl Parameters {
    /// The value of a numbered parameter: 0 where it was never set.
    pub(crate) fn numbered(&self, number: u32) -> Value {
        if AT_MACHINE.iter().any(|range| range.contains(&number)) {
            return None;
        }
        let values = match self.frames.last() {
            Some(frame) if number <= LOCAL => &frame.numbered,
            _ => &self.numbered,
        };
        values.get(&number).copied().unwrap_or(Some(0.0))
    }

    pub(crate) fn set_numbered(&mut self, number: u32, value: Value) {
        let values = match self.frames.last_mut() {
            Some(frame) if number <= LOCAL => &mut frame.numbered,
            _ => &mut self.numbered,
        };
        values.insert(number, value);
    }

    /// The value of a named parameter; `None`: it was never set.
    pub(crate) fn named(&self, name: &str) -> Option<Value> {
        if name.starts_with('_') {
            return self.global.get(name).copied();
        }
        self.frames.last()?.named.get(name).copied()
    }

    pub(crate) fn set_named(&mut self, name: &str, value: Value) {
        if name.starts_with('_') {
            self.global.insert(name.to_owned(), value);
        } else if let Some(frame) = self.frames.last_mut() {
            frame.named.insert(name.to_owned(), value);
        }
    }

    /// A subroutine begins with these arguments; parameters without one are 0 in it.
    pub(crate) fn enter(&mut self, arguments: &[Value]) {
        let numbered = (1..=LOCAL).zip(arguments.iter().copied()).collect();
        self.frames.push(Frame {
            numbered,
            named: HashMap::new(),
        });
    }

    /// A subroutine ends.
    pub(crate) fn leave(&mut self) {
        if self.frames.len() > 1 {
            self.frames.pop();
        }
    }
}
