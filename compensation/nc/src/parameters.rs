//! Parameters of a program: numbered and named ones, with those of a subroutine for its own. A value that only the machine
//! knows, such as a probed position, is not known here.

use std::collections::HashMap;

/// A number, or one that only the machine knows.
pub(crate) type Value = Option<f64>;

/// The first numbered parameters are a subroutine's own.
const LOCAL: u32 = 30;

/// So many numbered parameters there are.
pub(crate) const MOST: u32 = 100_000;

/// Parameters that the control sets from what only it knows: probed positions, and what an input was.
const AT_MACHINE: [std::ops::RangeInclusive<u32>; 3] = [3000..=3999, 5061..=5070, 5399..=5399];

/// What a subroutine returned, and whether it did.
pub(crate) const RETURNED: &str = "_value";

pub(crate) const HAS_RETURNED: &str = "_value_returned";

#[derive(Clone, Debug, Default)]
struct Values {
    numbered: HashMap<u32, Value>,
    named: HashMap<String, Value>,
}

/// State: what the program has set so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Parameters {
    /// Numbered ones from 31 on, and named ones whose names begin with an underscore.
    shared: Values,
    /// The own ones of the main program, and of each subroutine that is being executed.
    main: Values,
    subs: Vec<Values>,
}

impl Parameters {
    pub(crate) fn in_sub(&self) -> bool {
        !self.subs.is_empty()
    }

    pub(crate) fn is_local(number: u32) -> bool {
        number <= LOCAL
    }

    pub(crate) fn is_local_name(name: &str) -> bool {
        !name.starts_with('_')
    }

    fn values(&self, local: bool) -> &Values {
        if local {
            self.subs.last().unwrap_or(&self.main)
        } else {
            &self.shared
        }
    }

    fn values_mut(&mut self, local: bool) -> &mut Values {
        if local {
            self.subs.last_mut().unwrap_or(&mut self.main)
        } else {
            &mut self.shared
        }
    }

    /// The value of a numbered parameter: where the program has never set it, 0 for the own ones of a subroutine, and of the others what the
    /// control keeps from program to program, which only the machine knows.
    pub(crate) fn numbered(&self, number: u32) -> Value {
        if let Some(value) = self.set_number(number) {
            return value;
        }
        if AT_MACHINE.iter().any(|range| range.contains(&number)) {
            return None;
        }
        Self::is_local(number).then_some(0.0)
    }

    /// The value of a numbered parameter, if the program has set it.
    pub(crate) fn set_number(&self, number: u32) -> Option<Value> {
        let values = self.values(Self::is_local(number));
        values.numbered.get(&number).copied()
    }

    pub(crate) fn set_numbered(&mut self, number: u32, value: Value) {
        let values = self.values_mut(Self::is_local(number));
        values.numbered.insert(number, value);
    }

    /// The value of a named parameter; `None`: it was never set.
    pub(crate) fn named(&self, name: &str) -> Option<Value> {
        let values = self.values(Self::is_local_name(name));
        values.named.get(name).copied()
    }

    pub(crate) fn set_named(&mut self, name: &str, value: Value) {
        let values = self.values_mut(Self::is_local_name(name));
        values.named.insert(name.to_owned(), value);
    }

    /// A subroutine begins with these arguments; parameters without one are 0 in it.
    pub(crate) fn enter(&mut self, arguments: &[Value]) {
        self.subs.push(Values {
            numbered: (1..=LOCAL).zip(arguments.iter().copied()).collect(),
            named: HashMap::new(),
        });
    }

    pub(crate) fn leave(&mut self) {
        self.subs.pop();
    }
}
