use std::{collections::BTreeMap, path::PathBuf};

use volcomp_model::document::{Document, InputError, Section};

use crate::{
    control::{CONTROLS, Control, DecimalPoints},
    coordinates::{Axes, axis_of},
    modal::{CentrePoint, Modal, SYSTEMS, name_of_offset},
};

/// The part of the set-up that a program relies on but does not contain. Lengths are in mm, angles in deg; missing values are zero.
#[derive(Clone, Debug, PartialEq)]
pub struct SetUp {
    pub(crate) modal: Modal,
    stated: [bool; SYSTEMS],
    pub(crate) tools: BTreeMap<u32, Axes>,
    pub(crate) states_homes: [Axes<bool>; 2],
    start: Option<(Axes, Axes<bool>)>,
    pub(crate) folders: Vec<PathBuf>,
    control: Option<Control>,
    /// True if the file states the direction in which rotary words of RS-274 turn a rollover axis.
    pub(crate) states_rotary_words: bool,
    /// True if X60 means 60 least increments, false if 60 mm, inches or degrees; `None` if the file does not state it.
    without_point: Option<bool>,
}

impl Default for SetUp {
    fn default() -> Self {
        Self {
            modal: Modal::default(),
            stated: [false; SYSTEMS],
            tools: BTreeMap::new(),
            states_homes: [[false; 9]; 2],
            start: None,
            folders: Vec::new(),
            control: None,
            states_rotary_words: false,
            without_point: None,
        }
    }
}

impl SetUp {
    /// Reads a set-up file; `file` is its name in messages.
    ///
    /// # Errors
    /// Unknown keys and invalid values, with file, line and key.
    pub fn parse(text: &str, file: &str) -> Result<Self, InputError> {
        Document::new(file, text).decode(|root| {
            root.allow(&[
                "control",
                "without_point",
                "rotary_words",
                "units",
                "tool_centre_point",
                "work_offset",
                "tool",
                "home",
                "start",
            ])?;
            let mut setup = Self::default();
            if let Some(control) = root.get("control") {
                setup.control = Some(control.one_of(&CONTROLS)?);
            }
            if let Some(without_point) = root.get("without_point") {
                if let Some(control) = (setup.control).filter(|of| !of.is_fanuc_like()) {
                    return Err(without_point.error(format!(
                        "found it with control = \"{}\", for which a number without a decimal point is always in the unit of the program: expected with fanuc, haas or mazak, or without control",
                        control.name()
                    )));
                }
                setup.without_point =
                    Some(without_point.one_of(&[("unit", false), ("increment", true)])?);
            }
            if let Some(words) = root.get("rotary_words") {
                setup.modal.shorter = words.one_of(&[("linear", false), ("shorter", true)])?;
                setup.states_rotary_words = true;
            }
            if let Some(units) = root.get("units") {
                setup.modal.unit_mm = units.one_of(&[("mm", 1.0), ("inch", 25.4)])?;
            }
            if let Some(on) = root.get("tool_centre_point")
                && on.truth()?
            {
                setup.modal.centre_point = CentrePoint::Switched;
            }
            if let Some(offsets) = root.section("work_offset")? {
                let names: Vec<String> = (0..SYSTEMS).map(name_of_offset).collect();
                let allowed: Vec<&str> = names.iter().map(String::as_str).collect();
                // List only names of this dialect: suggesting G560 for G60 would not help.
                for (key, _) in offsets.values() {
                    if !allowed.contains(&key) {
                        return Err(offsets.error(format!(
                            "there is no work offset {key}; expected G54 to G59 or G59.1 to G59.3 or, by their numbers, P1 to P300 (SINUMERIK: G500, G54 to G57, G505 to G599; HEIDENHAIN: G54, P1 to P300)"
                        )));
                    }
                }
                for (place, name) in names.iter().enumerate() {
                    let Some(offset) = offsets.section(name)? else {
                        continue;
                    };
                    let (at, _) = axes_of(&offset, &["rotation_deg"])?;
                    setup.modal.offsets[place].offset = at;
                    setup.stated[place] = true;
                    if let Some(angle) = offset.get("rotation_deg") {
                        setup.modal.offsets[place].rotation_deg = angle.number()?;
                    }
                }
            }
            if setup.control.is_some_and(Control::is_printer) {
                // Printers have no work offset, or it is zero.
                setup.stated[0] = true;
            }
            if let Some(tools) = root.section("tool")? {
                for (name, _) in tools.values() {
                    let Some(tool) = tools.section(name)? else {
                        continue;
                    };
                    let number: u32 = name.parse().map_err(|_| {
                        tool.error("expected the number of a tool, such as [tool.1]")
                    })?;
                    setup.tools.insert(number, axes_of(&tool, &[])?.0);
                }
            }
            if let Some(homes) = root.section("home")? {
                homes.allow(&["G28", "G30"])?;
                for (place, name) in ["G28", "G30"].into_iter().enumerate() {
                    if let Some(home) = homes.section(name)? {
                        (setup.modal.homes[place], setup.states_homes[place]) = axes_of(&home, &[])?;
                    }
                }
            }
            if let Some(start) = root.section("start")? {
                setup.start = Some(axes_of(&start, &[])?);
            }
            Ok(setup)
        })
    }

    /// Sets the folders, in search order, for subroutines that the program calls but does not contain: o&lt;name&gt; in `name.ngc`, the
    /// program of `M98 P1000` in files such as `O1000` or `1000.nc`.
    #[must_use]
    pub fn with_subroutines(mut self, folders: Vec<PathBuf>) -> Self {
        self.folders = folders;
        self
    }

    /// Control that runs the program, if stated.
    #[must_use]
    pub fn control(&self) -> Option<Control> {
        self.control
    }

    pub(crate) fn points(&self) -> DecimalPoints {
        let by_control = self.control.is_some_and(Control::is_fanuc_like);
        DecimalPoints {
            means_increments: self.without_point.unwrap_or(by_control),
            may_mix: self.without_point.is_some(),
            last_in_increments: None,
        }
    }

    pub(crate) fn offset(&self, system: usize) -> Option<Axes> {
        let is_stated = *self.stated.get(system)?;
        is_stated.then(|| self.modal.offsets[system].offset)
    }

    pub(crate) fn with_offsets_moved(&self, by: &[[f64; 3]]) -> Self {
        let mut moved = self.clone();
        for (offset, by) in moved.modal.offsets.iter_mut().zip(by) {
            for (offset, by) in offset.offset.iter_mut().zip(by) {
                *offset += by;
            }
        }
        moved
    }

    /// Start position of the axes, and for each whether it is known.
    pub(crate) fn start(&self) -> (Axes, Axes<bool>) {
        self.start.unwrap_or_default()
    }
}

/// Coordinates by axis letter, and which of them were given.
fn axes_of(section: &Section<'_>, others: &[&str]) -> Result<(Axes, Axes<bool>), InputError> {
    let mut known: Vec<&str> = vec!["X", "Y", "Z", "A", "B", "C", "U", "V", "W"];
    known.extend(others);
    section.allow(&known)?;
    let (mut at, mut given) = ([0.0; 9], [false; 9]);
    let values = section.values();
    for (key, value) in values {
        let axis = match key.as_bytes() {
            [letter] => axis_of(*letter),
            _ => None,
        };
        if let Some(axis) = axis {
            at[axis] = value.number()?;
            given[axis] = true;
        }
    }
    Ok((at, given))
}
