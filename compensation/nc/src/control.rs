//! Program languages, and controls: controls interpret the same words differently.

use std::path::Path;

use crate::{
    modal::{Code, MAX_NUMBERED_OFFSET},
    number::Decimals,
};

/// The language of a program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Dialect {
    /// RS-274 (G-code) as read by LinuxCNC and FANUC controls.
    #[default]
    Rs274,
    /// The language of SINUMERIK controls.
    Siemens,
    /// The conversational language of HEIDENHAIN controls.
    Heidenhain,
}

impl Dialect {
    /// The language in which files with this name are written: SINUMERIK for `.mpf` and `.spf`, HEIDENHAIN for `.h`,
    /// otherwise RS-274.
    #[must_use]
    pub fn of_file(path: &Path) -> Self {
        let extension = path.extension().and_then(|extension| extension.to_str());
        match extension.map(str::to_ascii_lowercase).as_deref() {
            Some("mpf" | "spf") => Self::Siemens,
            Some("h") => Self::Heidenhain,
            _ => Self::Rs274,
        }
    }

    /// Name in the `--dialect` option of `volcomp nc`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Rs274 => "rs274",
            Self::Siemens => "siemens",
            Self::Heidenhain => "heidenhain",
        }
    }
}

/// The control that runs a program: key `control` of the set-up file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Control {
    /// LinuxCNC: RS-274 with O-words.
    LinuxCnc,
    /// FANUC controls with G-code programs.
    Fanuc,
    /// Haas controls: like FANUC, with their own codes for work offsets.
    Haas,
    /// Mazak, in EIA/ISO programs.
    Mazak,
    /// SINUMERIK controls in their own language.
    Siemens,
    /// HEIDENHAIN, in conversational programs.
    Heidenhain,
    /// Printers with Marlin.
    Marlin,
    /// Printers with Klipper.
    Klipper,
    /// Grbl firmware on small mills and lasers.
    Grbl,
}

pub(crate) const CONTROLS: [(&str, Control); 9] = [
    ("linuxcnc", Control::LinuxCnc),
    ("fanuc", Control::Fanuc),
    ("haas", Control::Haas),
    ("mazak", Control::Mazak),
    ("siemens", Control::Siemens),
    ("heidenhain", Control::Heidenhain),
    ("marlin", Control::Marlin),
    ("klipper", Control::Klipper),
    ("grbl", Control::Grbl),
];

impl Control {
    /// The language that the control reads.
    #[must_use]
    pub fn dialect(self) -> Dialect {
        match self {
            Self::Siemens => Dialect::Siemens,
            Self::Heidenhain => Dialect::Heidenhain,
            _ => Dialect::Rs274,
        }
    }

    /// Name in the set-up file.
    #[must_use]
    pub fn name(self) -> &'static str {
        let found = CONTROLS.into_iter().find(|(_, control)| *control == self);
        found.map_or("", |(name, _)| name)
    }

    /// True for 3D printer firmware: one command per line, E is the filament.
    pub(crate) fn is_printer(self) -> bool {
        matches!(self, Self::Marlin | Self::Klipper)
    }

    /// True if a G code moves no axis and changes no coordinate on this control: look-ahead, smoothing, exact stop, or the cancel code of a
    /// mode that is rejected.
    pub(crate) fn has_harmless(self, code: Code) -> bool {
        let codes: &[Code] = match self {
            // Look-ahead, corners, tapping, stored stroke limits off, spindle speed monitoring, and the cancel codes of G41.1, G12.1, G51,
            // G51.1, G66.
            Self::Fanuc => &[80, 110, 131, 230, 250, 260, 401, 500, 501, 620, 630, 670, 1130],
            // Look-ahead, smoothness, and the cancel codes of G51 and G101.
            Self::Haas => &[500, 1000, 1030, 1870],
            Self::Mazak => &[80, 131, 230, 401, 500, 501, 620, 630, 670, 1130],
            _ => &[],
        };
        codes.contains(&code)
    }

    /// Reason to reject on this control a G code that others accept.
    pub(crate) fn refuses(self, code: Code) -> Option<&'static str> {
        match (self, code) {
            (Self::Fanuc | Self::Mazak, 70) => {
                Some("it makes an axis hypothetical on this control")
            }
            (Self::Klipper, 530) => Some(
                "Klipper ignores it and moves in the coordinates of the program: remove it, or program the position in these coordinates",
            ),
            (Self::Haas, 70 | 80) => Some("it is unknown for this control"),
            (Self::Fanuc | Self::Haas | Self::Mazak, 281 | 301) => {
                Some("it moves to a reference position that only the machine knows")
            }
            (Self::Fanuc | Self::Haas | Self::Mazak, 411 | 421) => {
                Some("it turns the tool along the path")
            }
            (Self::Fanuc | Self::Haas | Self::Mazak, 431) => {
                Some("it applies the tool length along the tilted tool")
            }
            (Self::Fanuc | Self::Haas | Self::Mazak, 591..=593) => {
                Some("it is unknown for this control")
            }
            _ => None,
        }
    }

    pub(crate) fn has_numbered_offset(self, code: Code) -> bool {
        match self {
            Self::Fanuc | Self::Mazak => code == 541,
            // G112 and G113 are polar interpolation on some Haas controls.
            Self::Haas => {
                let is_short = (1100..=1290).contains(&code) && code.is_multiple_of(10);
                code == 1540 || is_short && !matches!(code, 1120 | 1130)
            }
            _ => false,
        }
    }

    /// Largest number of a numbered work offset: FANUC offers at most G54.1 P1 to P300, Haas has G154 P1 to P99.
    pub(crate) fn last_numbered(self) -> u32 {
        match self {
            Self::Haas => 99,
            _ => MAX_NUMBERED_OFFSET,
        }
    }

    /// True if the control reads programs as FANUC does: builder-specific M codes, numbered work offsets by G10 L20, and coordinates
    /// without a decimal point as least increments (unless a control parameter differs).
    pub(crate) fn is_fanuc_like(self) -> bool {
        matches!(self, Self::Fanuc | Self::Haas | Self::Mazak)
    }
}

/// Usual least increments: 0.001 mm, 0.0001 inch, 0.001 deg.
pub(crate) const INCREMENTS: Decimals = Decimals { mm: 3, inch: 4, deg: 3 };

/// How the program writes coordinates, on a control where the decimal point is significant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DecimalPoints {
    /// Set if a coordinate without a decimal point counts least increments.
    pub(crate) means_increments: bool,
    /// Set if the set-up file states the meaning of coordinates without a decimal point, so that
    /// the program may mix them with coordinates that have one.
    pub(crate) may_mix: bool,
    /// Whether the last non-zero coordinate had no point.
    pub(crate) last_in_increments: Option<bool>,
}

pub(crate) fn why_refused(code: Code, control: Option<Control>) -> Option<String> {
    if let Some(why) = control.and_then(|control| control.refuses(code)) {
        return Some(why.to_owned());
    }
    let why = match code {
        70 | 71 | 1070 => "it makes an axis hypothetical, or wraps coordinates around a cylinder",
        120 | 130 | 1500 | 700 | 710 | 720 => "a cycle whose motions are not supported",
        121 | 1120 | 1130 => "polar interpolation",
        310 | 311..=313 | 370 | 360 | 350 | 1360 => {
            "it ends at a signal, which only the machine knows"
        }
        440 => {
            "it subtracts a length: state the length with the opposite sign in the set-up file and write G43"
        }
        510 | 511 | 501 | 500 | 1010 => "it scales or mirrors coordinates",
        542 | 2540 => "an offset that rotates with the table",
        600 => "it approaches its target from one side by a separate motion",
        650 | 660 | 661 => "it calls a macro, whose motions are not in the program",
        682..=684 | 531 | 2680 => "a tilted plane",
        435 => "tool directions are supported as angles of the rotary axes only",
        _ => "",
    };
    if !why.is_empty() {
        return Some(why.to_owned());
    }
    let known = |control: &Control| control.has_harmless(code) || control.has_numbered_offset(code);
    let names: Vec<&str> =
        (CONTROLS.iter()).filter(|(_, control)| known(control)).map(|(name, _)| *name).collect();
    (!names.is_empty()).then(|| {
        format!("it is supported with control = \"{}\" in the set-up file", names.join("\" or \""))
    })
}
