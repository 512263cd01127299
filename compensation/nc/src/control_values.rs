//! Parameters that the control provides: where the axes are, which offsets hold, what is switched on.

use crate::{
    coordinates::{Axes, axis_of, is_rotary},
    interpret::Interpreter,
    modal::WORK_OFFSETS,
    parameters::Value,
};

/// The axis whose place the named parameter is: `_x`.
pub(crate) fn axis_of_name(name: &str) -> Option<usize> {
    match name.as_bytes() {
        [b'_', letter] => axis_of(letter.to_ascii_uppercase()),
        _ => None,
    }
}

/// The axis whose place the numbered parameter is.
pub(crate) fn axis_of_place(number: u32) -> Option<usize> {
    let axis = number.checked_sub(5420)? as usize;
    (axis < 9).then_some(axis)
}

impl Interpreter {
    /// A named parameter that the control provides.
    pub(crate) fn provided(&self, name: &str) -> Option<Value> {
        let truth = |truth: bool| Some(Some(f64::from(u8::from(truth))));
        let modal = &self.modal;
        if let Some(axis) = axis_of_name(name) {
            let at = self.program_position()[axis] / modal.scale(axis);
            return Some(self.says_place(axis).then_some(at));
        }
        match name {
            "_metric" => truth(modal.unit_mm == 1.0),
            "_imperial" => truth(modal.unit_mm != 1.0),
            "_absolute" => truth(modal.absolute),
            "_incremental" => truth(!modal.absolute),
            "_feed" => Some(modal.feed),
            "_coord_system" => WORK_OFFSETS
                .get(modal.system)
                .map(|code| Some(f64::from(*code))),
            "_current_tool" => Some(self.tool_in_spindle().map(f64::from)),
            "_selected_tool" => Some(modal.tool.map(f64::from)),
            "_motion_mode" => Some(modal.motion.map(f64::from)),
            // Of the machine, and set by it.
            _ if name.starts_with("_ini[")
                || name.starts_with("_hal[")
                || matches!(
                    name,
                    "_vmajor"
                        | "_vminor"
                        | "_line"
                        | "_rpm"
                        | "_task"
                        | "_value"
                        | "_value_returned"
                        | "_remote_call"
                ) =>
            {
                Some(None)
            }
            _ => None,
        }
    }

    /// A numbered parameter that the control provides.
    pub(crate) fn numbered(&self, number: u32) -> Option<Value> {
        let place = |first: u32| Some((number - first) as usize);
        let (list, axis): (&Axes, _) = match number {
            5161..=5169 => (&self.modal.homes[0], place(5161)?),
            5181..=5189 => (&self.modal.homes[1], place(5181)?),
            5211..=5219 => (&self.modal.shift, place(5211)?),
            5220 => return Some(Some(self.modal.system as f64 + 1.0)),
            5221..=5390 => {
                let (system, axis) = (place(5221)? / 20, place(5221)? % 20);
                let offset = self.modal.offsets.get(system)?;
                if axis == 9 {
                    return Some(Some(offset.rotation_deg));
                }
                let at = *offset.offset.get(axis)?;
                return Some(Some(at / self.length_unit(axis)));
            }
            5400 => return Some(self.tool_in_spindle().map(f64::from)),
            5401..=5409 => (&self.modal.tool_offset, place(5401)?),
            5420..=5428 => {
                let axis = axis_of_place(number)?;
                let at = self.program_position()[axis] / self.modal.scale(axis);
                return Some(self.says_place(axis).then_some(at));
            }
            _ => return None,
        };
        let at = *list.get(axis)?;
        Some(Some(at / self.length_unit(axis)))
    }

    fn length_unit(&self, axis: usize) -> f64 {
        if is_rotary(axis) {
            1.0
        } else {
            self.modal.unit_mm
        }
    }
}
