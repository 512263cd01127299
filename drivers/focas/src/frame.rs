//! Builds and parses frames of the protocol in both directions. Numbers are big-endian. The format is from public
//! captures and descriptions. Only functions that build requests and responses allocate.

/// Length of a frame's header, bytes.
pub const HEAD: usize = 10;
const SYNC: [u8; 4] = [0xa0; 4];
const REQUEST_VERSION: u16 = 1;
/// Length of a command without its data, bytes.
const COMMAND: usize = 0x1c;
/// Length of a response block without its data, bytes.
const BLOCK: usize = 16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Open,
    Opened,
    /// Response that rejects a session because there are too many sessions.
    Refused,
    Close,
    Closed,
    Command,
    Answer,
    /// Response that rejects the whole request.
    Negative,
}

impl Kind {
    const CODES: [(Self, [u8; 2]); 8] = [
        (Self::Open, [0x01, 0x01]),
        (Self::Opened, [0x01, 0x02]),
        (Self::Refused, [0x01, 0x03]),
        (Self::Close, [0x02, 0x01]),
        (Self::Closed, [0x02, 0x02]),
        (Self::Command, [0x21, 0x01]),
        (Self::Answer, [0x21, 0x02]),
        (Self::Negative, [0x21, 0x03]),
    ];

    fn code(self) -> [u8; 2] {
        let known = Self::CODES.iter().find(|(kind, _)| *kind == self);
        known.map_or([0; 2], |(_, code)| *code)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct FrameError(pub &'static str);

impl From<FrameError> for volcomp_port::Fault {
    fn from(broken: FrameError) -> Self {
        Self::Protocol(broken.0)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Protocol version: 1 in requests; 2, 3 or 4 in responses, depending on the generation of the control.
    pub version: u16,
    pub kind: Kind,
    /// Length of the payload, bytes.
    pub length: usize,
}

impl Head {
    /// # Errors
    /// Wrong start bytes, or an unknown kind.
    pub fn parse(bytes: &[u8; HEAD]) -> Result<Self, FrameError> {
        let [a, b, c, d, v, w, func, dir, l, m] = *bytes;
        if [a, b, c, d] != SYNC {
            return Err(FrameError("a frame does not begin with a0 a0 a0 a0"));
        }
        let kind = Kind::CODES.iter().find(|(_, code)| *code == [func, dir]);
        Ok(Self {
            version: u16::from_be_bytes([v, w]),
            kind: kind.ok_or(FrameError("an unknown kind of frame"))?.0,
            length: usize::from(u16::from_be_bytes([l, m])),
        })
    }
}

/// # Errors
/// The payload exceeds the maximum length of a frame.
pub fn frame(version: u16, kind: Kind, payload: &[u8]) -> Result<Vec<u8>, FrameError> {
    let length = u16::try_from(payload.len()).map_err(|_| FrameError("frame too long"))?;
    let mut bytes = Vec::with_capacity(HEAD + payload.len());
    bytes.extend(SYNC);
    bytes.extend(version.to_be_bytes());
    bytes.extend(kind.code());
    bytes.extend(length.to_be_bytes());
    bytes.extend(payload);
    Ok(bytes)
}

/// Frame that opens a session for commands (role 2; role 1 transfers programs).
pub fn open_frame() -> [u8; HEAD + 2] {
    [0xa0, 0xa0, 0xa0, 0xa0, 0, 1, 1, 1, 0, 2, 0, 2]
}

pub fn close_frame() -> [u8; HEAD] {
    [0xa0, 0xa0, 0xa0, 0xa0, 0, 1, 2, 1, 0, 0]
}

/// Part of the control to which a command is addressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Target {
    /// The numerical control itself.
    Cnc = 1,
    /// The programmable machine controller (PMC), which runs the ladder.
    Pmc = 2,
}

/// One command of a request. For a write, the fifth number of `args` is the length of `data`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command<'a> {
    pub target: Target,
    /// Path of the control, counted from 1.
    pub path: u16,
    pub function: u16,
    pub args: [i32; 5],
    /// Data to write; empty for a read.
    pub data: &'a [u8],
}

/// A request of one or more commands. It is built once and sent repeatedly.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    bytes: Vec<u8>,
    commands: Vec<Sent>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Sent {
    target: u16,
    path: u16,
    function: u16,
    /// Offset of the command's data from the start of the frame.
    data: usize,
}

impl Request {
    /// # Errors
    /// The commands exceed the maximum length of a frame.
    pub fn new(commands: &[Command<'_>]) -> Result<Self, FrameError> {
        let too_long = |_| FrameError("request too long");
        let count = u16::try_from(commands.len()).map_err(too_long)?;
        let mut payload = Vec::from(count.to_be_bytes());
        let mut sent = Vec::new();
        for command in commands {
            let size = u16::try_from(COMMAND + command.data.len()).map_err(too_long)?;
            let target = command.target as u16;
            for number in [size, target, command.path, command.function] {
                payload.extend(number.to_be_bytes());
            }
            for argument in command.args {
                payload.extend(argument.to_be_bytes());
            }
            sent.push(Sent {
                target,
                path: command.path,
                function: command.function,
                data: HEAD + payload.len(),
            });
            payload.extend(command.data);
        }
        Ok(Self { bytes: frame(REQUEST_VERSION, Kind::Command, &payload)?, commands: sent })
    }

    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Data of the command with this index. They may be changed in place before the request is sent again.
    pub fn data_mut(&mut self, command: usize) -> &mut [u8] {
        let Some(sent) = self.commands.get(command) else {
            return &mut [];
        };
        let next = self.commands.get(command + 1);
        let end = next.map_or(self.bytes.len(), |next| next.data - COMMAND);
        self.bytes.get_mut(sent.data..end).unwrap_or_default()
    }

    /// Parses the payload of a response to this request and checks that its blocks match the commands.
    ///
    /// # Errors
    /// A malformed response, or a response to a different request.
    pub fn answers<'a>(&self, payload: &'a [u8]) -> Result<Blocks<'a>, FrameError> {
        let blocks = Blocks::parse(payload)?;
        let mut count = 0;
        for (block, sent) in blocks.clone().zip(&self.commands) {
            let block = block?;
            if (block.target, block.path, block.function) != (sent.target, sent.path, sent.function)
            {
                return Err(FrameError("an answer to another command"));
            }
            count += 1;
        }
        if count != self.commands.len() || blocks.count != self.commands.len() {
            return Err(FrameError("another number of answers than of commands"));
        }
        Ok(blocks)
    }
}

/// Response to one command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block<'a> {
    pub target: u16,
    pub path: u16,
    pub function: u16,
    /// Return code with which the control rejected the command; 0 if it accepted the command.
    pub error: i16,
    pub data: &'a [u8],
}

/// Iterator over the blocks of a response. There is one block for each command, in the same order.
#[derive(Clone, Debug)]
pub struct Blocks<'a> {
    rest: &'a [u8],
    left: usize,
    count: usize,
}

impl<'a> Blocks<'a> {
    /// # Errors
    /// The payload is too short for the number of blocks.
    pub fn parse(payload: &'a [u8]) -> Result<Self, FrameError> {
        let (count, rest) =
            payload.split_first_chunk::<2>().ok_or(FrameError("an answer without a count"))?;
        let count = usize::from(u16::from_be_bytes(*count));
        Ok(Self { rest, left: count, count })
    }

    fn block(&mut self) -> Result<Block<'a>, FrameError> {
        const CUT: FrameError = FrameError("a truncated answer");
        let head = self.rest.first_chunk::<BLOCK>().ok_or(CUT)?;
        let number = |at: usize| u16::from_be_bytes([head[at], head[at + 1]]);
        let size = usize::from(number(0));
        let block = self.rest.get(..size).ok_or(CUT)?;
        self.rest = &self.rest[size..];
        let error = i16::from_be_bytes([head[8], head[9]]);
        let length = usize::from(number(14));
        let data = block.get(BLOCK..).ok_or(CUT)?;
        // The block of a rejected command may state a length without having the data.
        let data = match data.get(..length) {
            Some(data) => data,
            None if error != 0 => &[],
            None => return Err(CUT),
        };
        Ok(Block { target: number(2), path: number(4), function: number(6), error, data })
    }
}

impl<'a> Iterator for Blocks<'a> {
    type Item = Result<Block<'a>, FrameError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.left = self.left.checked_sub(1)?;
        let block = self.block();
        if block.is_err() {
            self.left = 0;
        }
        Some(block)
    }
}

/// Parses the commands of a request's payload, for the simulator.
///
/// # Errors
/// A malformed request.
pub fn parse_commands(payload: &[u8]) -> Result<Vec<Command<'_>>, FrameError> {
    const CUT: FrameError = FrameError("a truncated request");
    let (count, mut rest) = payload.split_first_chunk::<2>().ok_or(CUT)?;
    let mut commands = Vec::new();
    for _ in 0..u16::from_be_bytes(*count) {
        let head = rest.first_chunk::<COMMAND>().ok_or(CUT)?;
        let number = |at: usize| u16::from_be_bytes([head[at], head[at + 1]]);
        let size = usize::from(number(0));
        let data = rest.get(COMMAND..size).ok_or(CUT)?;
        let argument = |k: usize| {
            let at = 8 + 4 * k;
            i32::from_be_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]])
        };
        commands.push(Command {
            target: match number(2) {
                1 => Target::Cnc,
                2 => Target::Pmc,
                _ => return Err(FrameError("a command for an unknown target")),
            },
            path: number(4),
            function: number(6),
            args: std::array::from_fn(argument),
            data,
        });
        rest = &rest[size..];
    }
    Ok(commands)
}

/// Appends the response to one command to the payload of a response frame.
///
/// # Errors
/// The data exceed the maximum length of a block.
pub fn push_block(
    payload: &mut Vec<u8>,
    command: &Command<'_>,
    error: i16,
    data: &[u8],
) -> Result<(), FrameError> {
    let too_long = |_| FrameError("answer too long");
    let size = u16::try_from(BLOCK + data.len()).map_err(too_long)?;
    let length = u16::try_from(data.len()).map_err(too_long)?;
    for number in [size, command.target as u16, command.path, command.function] {
        payload.extend(number.to_be_bytes());
    }
    payload.extend(error.to_be_bytes());
    payload.extend([0; 4]);
    payload.extend(length.to_be_bytes());
    payload.extend(data);
    Ok(())
}

/// Decodes a number of eight bytes as mantissa, base and exponent; `None` if the number is vacant or invalid.
pub fn number(bytes: [u8; 8]) -> Option<f64> {
    let [a, b, c, d, e, f, g, h] = bytes;
    let mantissa = f64::from(i32::from_be_bytes([a, b, c, d]));
    let base = match u16::from_be_bytes([e, f]) {
        10 => 10.0_f64,
        2 => 2.0,
        _ => return None,
    };
    let exponent = i16::from_be_bytes([g, h]);
    // The exponent ffff marks a vacant number.
    (0..=30).contains(&exponent).then(|| mantissa / base.powi(i32::from(exponent)))
}

/// Encodes a number with `decimals` decimals in eight bytes. A number beyond the range of the mantissa saturates.
#[expect(clippy::cast_possible_truncation, reason = "a cast of f64 saturates")]
pub fn number_bytes(value: f64, decimals: i16) -> [u8; 8] {
    let mantissa = (value * 10_f64.powi(i32::from(decimals))).round() as i32;
    let [a, b, c, d] = mantissa.to_be_bytes();
    let [g, h] = decimals.to_be_bytes();
    [a, b, c, d, 0, 10, g, h]
}
