//! Which keys of `[[controller]]` each kind of controller can use: one table. A key that has no effect is refused,
//! since whoever wrote it relies on it.

use volcomp_devices::Scheme;
use volcomp_document::Mistakes;

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

/// Whether a controller of this kind uses a key.
pub(super) fn uses(kind: ControllerKind, is_reader: bool, key: &str) -> bool {
    let mut keys = CONTROLLER_KEYS.iter();
    keys.any(|(known, kinds)| *known == key && kinds.contains(&kind))
        && (!is_reader || KEYS_OF_A_READER.contains(&key))
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

/// Refuses keys that a controller of this kind cannot use. `at` is its table.
pub(super) fn check(found: &mut Mistakes<'_>, at: &str, kind: ControllerKind, is_reader: bool) {
    for (key, kinds) in CONTROLLER_KEYS {
        let place = format!("{at}.{key}");
        if !found.states(&place) {
            continue;
        }
        if !kinds.contains(&kind) {
            let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
            let message = format!(
                "found this key for {}, expected it only for {}",
                kind.name(),
                names.join(" or ")
            );
            found.add(&place, message);
        } else if is_reader && !KEYS_OF_A_READER.contains(&key) {
            found.add(
                &place,
                "found this key for a controller that is only read (axes = []), expected it only where axes are written",
            );
        }
    }
}
