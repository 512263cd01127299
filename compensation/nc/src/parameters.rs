//! Program parameters, numbered and named, with local ones for each subroutine. Values that only exist at the machine, such as a probed
//! position, are unknown.

use std::collections::HashMap;

/// A number; `None` if it is only known at the machine.
pub(crate) type Value = Option<f64>;

/// Number of local numbered parameters (1 to 30).
const LOCAL: u32 = 30;

pub(crate) const MOST: u32 = 100_000;

/// Parameters that the control sets at run time: probed positions and input states.
const AT_MACHINE: [std::ops::RangeInclusive<u32>; 3] = [3000..=3999, 5061..=5070, 5399..=5399];

/// Return value of a subroutine, and whether it returned one.
pub(crate) const RETURNED: &str = "_value";

pub(crate) const HAS_RETURNED: &str = "_value_returned";

#[derive(Clone, Debug, Default)]
struct Values {
    numbered: HashMap<u32, Value>,
    named: HashMap<String, Value>,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Parameters {
    /// Global parameters: numbered from 31 on, and names with a leading underscore.
    shared: Values,
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
        if local { self.subs.last().unwrap_or(&self.main) } else { &self.shared }
    }

    fn values_mut(&mut self, local: bool) -> &mut Values {
        if local { self.subs.last_mut().unwrap_or(&mut self.main) } else { &mut self.shared }
    }

    /// Value of a numbered parameter. A local parameter that the program has not set is 0. Any other parameter that the
    /// program has not set is unknown, because the control keeps its value from program to program.
    pub(crate) fn numbered(&self, number: u32) -> Value {
        if let Some(value) = self.set_number(number) {
            return value;
        }
        if AT_MACHINE.iter().any(|range| range.contains(&number)) {
            return None;
        }
        Self::is_local(number).then_some(0.0)
    }

    /// Value of a numbered parameter, if the program has set it.
    pub(crate) fn set_number(&self, number: u32) -> Option<Value> {
        let values = self.values(Self::is_local(number));
        values.numbered.get(&number).copied()
    }

    pub(crate) fn set_numbered(&mut self, number: u32, value: Value) {
        let values = self.values_mut(Self::is_local(number));
        values.numbered.insert(number, value);
    }

    /// Value of a named parameter; `None` if it was never set.
    pub(crate) fn named(&self, name: &str) -> Option<Value> {
        let values = self.values(Self::is_local_name(name));
        values.named.get(name).copied()
    }

    pub(crate) fn set_named(&mut self, name: &str, value: Value) {
        let values = self.values_mut(Self::is_local_name(name));
        values.named.insert(name.to_owned(), value);
    }

    /// Enters a subroutine with these arguments; its other local parameters are 0.
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
