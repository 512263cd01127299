use std::fmt;

/// Return code of the control: 0 for success, otherwise the reason for the rejection. Names and numbers are those of
/// the manufacturer's library.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReturnCode(pub i16);

/// Each number with its name and meaning. The meanings are from public descriptions of the library.
const CODES: [(i16, &str); 31] = [
    (-17, "EW_PROTOCOL, the request is not what the protocol allows here"),
    (-16, "EW_SOCKET, the connection of the control fails"),
    (-15, "EW_NODLL, the control has no such library"),
    (-11, "EW_BUS, a bus inside the control fails"),
    (-9, "EW_HSSB, the serial bus to the control fails"),
    (-8, "EW_HANDLE, unknown session"),
    (-7, "EW_VERSION, the versions of the two sides do not fit together"),
    (-6, "EW_UNEXP, something unexpected failed"),
    (-5, "EW_SYSTEM, the system of the control fails"),
    (-4, "EW_PARITY, a parity error in the memory of the control"),
    (-3, "EW_MMCSYS, the user interface of the control fails"),
    (-2, "EW_RESET, the control was reset meanwhile"),
    (-1, "EW_BUSY, the control is busy"),
    (0, "EW_OK, done"),
    (1, "EW_FUNC, the control does not know this function or has no PMC"),
    (2, "EW_LENGTH, the length of the data is wrong"),
    (3, "EW_NUMBER, the number, address or range does not exist"),
    (4, "EW_ATTRIB, the attribute or type is wrong"),
    (5, "EW_DATA, the data are wrong"),
    (6, "EW_NOOPT, the control lacks the option for it"),
    (7, "EW_PROT, writing is protected"),
    (8, "EW_OVRFLOW, the memory of the control is full"),
    (9, "EW_PARAM, a parameter of the control forbids it"),
    (10, "EW_BUFFER, a buffer of the control is full or empty"),
    (11, "EW_PATH, the control has no such path"),
    (12, "EW_MODE, the mode of the control forbids it"),
    (13, "EW_REJECT, the control rejects it in its state"),
    (14, "EW_DTSRVR, the data server fails"),
    (15, "EW_ALARM, an alarm of the control forbids it"),
    (16, "EW_STOP, the control is stopped"),
    (17, "EW_PASSWD, a password protects it"),
];

impl ReturnCode {
    /// The control is busy. The same request may succeed later.
    pub const BUSY: Self = Self(-1);

    /// Name and meaning, such as `EW_NOOPT, the control lacks the option for it`.
    pub fn words(self) -> &'static str {
        CODES
            .iter()
            .find(|(number, _)| *number == self.0)
            .map_or("unknown code", |(_, words)| words)
    }

    /// Name in the manufacturer's library, such as `EW_NOOPT`; `None` for an unknown code.
    pub fn name(self) -> Option<&'static str> {
        let name = self.words().split(',').next()?;
        name.starts_with("EW_").then_some(name)
    }
}

impl From<ReturnCode> for volcomp_port::Fault {
    /// Converts the code to a fault of a real-time cycle. The fault contains name and meaning.
    fn from(code: ReturnCode) -> Self {
        Self::Refused { code: i32::from(code.0), what: code.words() }
    }
}

impl fmt::Display for ReturnCode {
    /// Formats number, name and meaning: `code 6: EW_NOOPT, the control lacks the option for it`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "code {}: {}", self.0, self.words())
    }
}
