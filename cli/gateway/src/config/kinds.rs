//! Which keys of `[[controller]]` each kind of controller can use: one table. A key that has no effect is refused,
//! since whoever wrote it relies on it.

use volcomp_devices::{Address, Scheme};
use volcomp_document::{InputError, Section};

/// The kind of a controller, by the scheme of its URL.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControllerKind {
    /// A FANUC control, `focas://`.
    Focas,
    /// A bridge on CAN, `can://`: its DBC file says which signals and steps there are.
    Can,
    /// Words on digital lines, `gpio://`, `modbus://` or `modbus-rtu://`.
    Lines,
    /// A SINUMERIK control over OPC UA, `opc.tcp://`.
    Sinumerik,
    /// A LinuxCNC control by its bridge, `linuxcnc://`: it has a barrier, and tells the states of the control.
    LinuxCnc,
}

use ControllerKind::{Can, Focas, Lines, LinuxCnc, Sinumerik};

/// The keys of `[[controller]]`, and the kinds of controllers that use each of them.
pub const CONTROLLER_KEYS: [(&str, &[ControllerKind]); 21] = [
    ("url", &ControllerKind::ALL),
    ("channel", &ControllerKind::ALL),
    ("axes", &ControllerKind::ALL),
    ("reads", &ControllerKind::ALL),
    ("fixed", &ControllerKind::ALL),
    ("not_driven", &ControllerKind::ALL),
    ("includes_correction", &[Focas, Can, Lines, Sinumerik]),
    ("terms", &ControllerKind::ALL),
    ("hold_ms", &ControllerKind::ALL),
    ("test_shift", &ControllerKind::ALL),
    ("unwatched", &[Focas, Can, Lines, Sinumerik]),
    ("unseen", &ControllerKind::ALL),
    ("resolution_um", &[Focas, Lines, Sinumerik, LinuxCnc]),
    ("resolution_urad", &[Focas, Lines, Sinumerik, LinuxCnc]),
    ("area", &[Focas]),
    ("heartbeat", &[Focas]),
    ("referenced", &[Focas]),
    ("barrier", &[Focas, Can, LinuxCnc]),
    ("digital", &[Lines]),
    ("sinumerik", &[Sinumerik]),
    ("linuxcnc", &[LinuxCnc]),
];

/// The keys that a controller which is only read can use.
const KEYS_OF_A_READER: [&str; 8] = [
    "url",
    "axes",
    "reads",
    "referenced",
    "unseen",
    "digital",
    "sinumerik",
    "linuxcnc",
];

/// Refuses keys about corrections at a controller that writes none.
pub(super) fn check_reader(section: &Section<'_>) -> Result<(), InputError> {
    for (key, _) in CONTROLLER_KEYS {
        if let Some(value) = section
            .get(key)
            .filter(|_| !KEYS_OF_A_READER.contains(&key))
        {
            return Err(value.error(
                "found this key for a controller that is only read (axes = []), expected it only where axes are written",
            ));
        }
    }
    Ok(())
}

impl ControllerKind {
    /// Every kind of controller that a configuration can name.
    pub const ALL: [Self; 5] = [Focas, Can, Lines, Sinumerik, LinuxCnc];

    /// The kind of the controllers of this scheme.
    pub fn of(scheme: Scheme) -> Self {
        match scheme {
            Scheme::Focas => Focas,
            Scheme::Can => Can,
            Scheme::OpcUa => Sinumerik,
            Scheme::LinuxCnc => LinuxCnc,
            Scheme::Gpio | Scheme::Modbus | Scheme::ModbusRtu => Lines,
        }
    }

    /// The kind in words.
    pub fn name(self) -> &'static str {
        match self {
            Focas => "a FANUC control (focas://)",
            Can => "a bridge on CAN (can://)",
            Sinumerik => "a SINUMERIK control (opc.tcp://)",
            LinuxCnc => "a LinuxCNC control (linuxcnc://)",
            Lines => "digital lines (gpio://, modbus://, modbus-rtu://)",
        }
    }
}

/// The URL of a device; an error names the key and its line.
pub(super) fn address(section: &Section<'_>) -> Result<Address, InputError> {
    let url = section.require("url")?;
    Address::parse(url.text()?).map_err(|error| url.error(error.to_string()))
}

/// Refuses keys that are not known, a URL that is none, and keys that a controller of this kind cannot use.
pub(super) fn check(section: &Section<'_>) -> Result<(), InputError> {
    section.allow(&CONTROLLER_KEYS.map(|(key, _)| key))?;
    let kind = ControllerKind::of(address(section)?.scheme);
    for (key, kinds) in CONTROLLER_KEYS {
        if let Some(value) = section.get(key).filter(|_| !kinds.contains(&kind)) {
            let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
            return Err(value.error(format!(
                "found this key for {}, expected it only for {}",
                kind.name(),
                names.join(" or ")
            )));
        }
    }
    Ok(())
}
