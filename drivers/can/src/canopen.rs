//! A small CANopen consumer: starts nodes, watches their heartbeat, reads and writes single objects, and takes
//! temperatures (CiA 404) and digital lines (CiA 401) from their process data. Default identifiers (CiA 301).

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use volcomp_port::{DeviceError, DigitalIo, Fault, Reason, Temperature, Thermometer};

use crate::frame::{CanPort, Frame, Received};

/// What a node says of itself in its heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodeState {
    /// It has just started.
    BootUp,
    /// It was stopped.
    Stopped,
    /// It sends process data.
    Operational,
    /// It waits to be started.
    PreOperational,
    /// Something else.
    Other(u8),
}

impl NodeState {
    fn from_code(code: u8) -> Self {
        match code & 0x7f {
            0 => Self::BootUp,
            4 => Self::Stopped,
            5 => Self::Operational,
            0x7f => Self::PreOperational,
            other => Self::Other(other),
        }
    }
}

/// A frame as CANopen means it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Telegram {
    /// Heartbeat of a node.
    Heartbeat {
        /// The node.
        node: u8,
        /// Its state.
        state: NodeState,
    },
    /// An emergency of a node: its error code, 0 when all errors are gone.
    Emergency {
        /// The node.
        node: u8,
        /// CiA error code.
        code: u16,
    },
    /// Process data that a node sends: number 1 to 4.
    Pdo {
        /// The node.
        node: u8,
        /// Which.
        number: u8,
    },
    /// The answer to reading or writing an object.
    Sdo {
        /// The node.
        node: u8,
        /// What it says.
        answer: SdoAnswer,
    },
}

/// The answer to an expedited transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SdoAnswer {
    /// An object was read: up to four bytes, little-endian.
    Read {
        /// Index and subindex.
        object: (u16, u8),
        /// Its value.
        value: u32,
        /// How many bytes of it count.
        bytes: u8,
    },
    /// An object was written.
    Written {
        /// Index and subindex.
        object: (u16, u8),
    },
    /// Refused, with the code of CiA 301.
    Aborted {
        /// Index and subindex.
        object: (u16, u8),
        /// Why.
        code: u32,
    },
    /// A transfer in segments, which this consumer does not do.
    Segmented {
        /// Index and subindex.
        object: (u16, u8),
    },
}

/// What a frame means; `None` where it is none of these or broken.
pub fn telegram(frame: &Frame) -> Option<Telegram> {
    if frame.extended || frame.fd {
        return None;
    }
    let node = u8::try_from(frame.id & 0x7f)
        .ok()
        .filter(|node| *node > 0)?;
    let data = frame.data();
    let number = |function: u32| u8::try_from((function - 0x180) / 0x100 + 1).ok();
    match frame.id & 0x780 {
        0x700 => Some(Telegram::Heartbeat {
            node,
            state: NodeState::from_code(*data.first()?),
        }),
        0x080 => Some(Telegram::Emergency {
            node,
            code: u16::from_le_bytes(*data.first_chunk()?),
        }),
        function @ (0x180 | 0x280 | 0x380 | 0x480) => Some(Telegram::Pdo {
            node,
            number: number(function)?,
        }),
        0x580 => Some(Telegram::Sdo {
            node,
            answer: sdo_answer(*data.first_chunk()?)?,
        }),
        _ => None,
    }
}

fn sdo_answer(data: [u8; 8]) -> Option<SdoAnswer> {
    let [command, low, high, sub, a, b, c, d] = data;
    let object = (u16::from_le_bytes([low, high]), sub);
    let value = u32::from_le_bytes([a, b, c, d]);
    Some(match command >> 5 {
        2 if command & 0b10 != 0 => {
            // Without a stated size all four bytes count.
            let unused = if command & 1 == 1 {
                command >> 2 & 3
            } else {
                0
            };
            let bytes = 4 - unused;
            SdoAnswer::Read {
                object,
                value: value & (u32::MAX >> (8 * unused)),
                bytes,
            }
        }
        2 => SdoAnswer::Segmented { object },
        3 => SdoAnswer::Written { object },
        4 => SdoAnswer::Aborted {
            object,
            code: value,
        },
        _ => return None,
    })
}

/// Network management: what a node is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum NmtCommand {
    /// Send process data.
    Start = 1,
    /// Stop.
    Stop = 2,
    /// Wait.
    PreOperational = 128,
    /// Start anew.
    Reset = 129,
}

/// The frame that tells a node (0: all of them).
pub fn nmt(command: NmtCommand, node: u8) -> Option<Frame> {
    Frame::new(0, false, false, &[command as u8, node])
}

/// The frame that asks for an object.
pub fn sdo_read(node: u8, (index, sub): (u16, u8)) -> Option<Frame> {
    let [low, high] = index.to_le_bytes();
    let data = [0x40, low, high, sub, 0, 0, 0, 0];
    Frame::new(0x600 + u32::from(node), false, false, &data)
}

/// The frame that writes an object of 1 to 4 bytes.
pub fn sdo_write(node: u8, (index, sub): (u16, u8), value: &[u8]) -> Option<Frame> {
    let unused = 4_usize
        .checked_sub(value.len())
        .filter(|unused| *unused < 4)?;
    let [low, high] = index.to_le_bytes();
    let mut data = [
        0x23 | u8::try_from(unused << 2).ok()?,
        low,
        high,
        sub,
        0,
        0,
        0,
        0,
    ];
    data[4..4 + value.len()].copy_from_slice(value);
    Frame::new(0x600 + u32::from(node), false, false, &data)
}

/// The frame with a node's output lines: process data that it receives, number 1.
fn outputs_frame(node: u8, levels: u64, lines: u32) -> Option<Frame> {
    let bytes = levels.to_le_bytes();
    let count = usize::try_from(lines.div_ceil(8)).ok()?;
    Frame::new(0x200 + u32::from(node), false, false, bytes.get(..count)?)
}

/// Asks nodes for single objects, one at a time. For set-up: it waits.
#[derive(Debug)]
pub struct SdoClient<P> {
    port: P,
}

impl<P: CanPort> SdoClient<P> {
    /// On a bus.
    pub fn new(port: P) -> Self {
        Self { port }
    }

    /// The bus.
    pub fn into_port(self) -> P {
        self.port
    }

    /// Reads an object of up to four bytes, little-endian.
    ///
    /// # Errors
    /// [`Fault::TimedOut`]; [`Fault::Refused`] with the node's abort code; [`Fault::Unsupported`] for objects
    /// that need more than one frame.
    pub fn read(&mut self, node: u8, object: (u16, u8), deadline: Instant) -> Result<u32, Fault> {
        let question = sdo_read(node, object).ok_or(Fault::Unsupported("a node number"))?;
        self.port.send(&question, deadline)?;
        match self.answer(node, object, deadline)? {
            SdoAnswer::Read { value, .. } => Ok(value),
            _ => Err(Fault::Protocol("an object that was not read")),
        }
    }

    /// Writes an object of 1 to 4 bytes.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn write(
        &mut self,
        node: u8,
        object: (u16, u8),
        value: &[u8],
        deadline: Instant,
    ) -> Result<(), Fault> {
        let question = sdo_write(node, object, value).ok_or(Fault::Unsupported("1 to 4 bytes"))?;
        self.port.send(&question, deadline)?;
        match self.answer(node, object, deadline)? {
            SdoAnswer::Written { .. } => Ok(()),
            _ => Err(Fault::Protocol("an object that was not written")),
        }
    }

    fn answer(
        &mut self,
        node: u8,
        wanted: (u16, u8),
        deadline: Instant,
    ) -> Result<SdoAnswer, Fault> {
        while let Some(received) = self.port.receive(deadline)? {
            let Received::Frame(frame, _) = received else {
                continue;
            };
            let Some(Telegram::Sdo { node: from, answer }) = telegram(&frame) else {
                continue;
            };
            let (SdoAnswer::Read { object, .. }
            | SdoAnswer::Written { object }
            | SdoAnswer::Aborted { object, .. }
            | SdoAnswer::Segmented { object }) = answer;
            // A late answer to another question.
            if from != node || object != wanted {
                continue;
            }
            return match answer {
                SdoAnswer::Aborted { code, .. } => Err(Fault::Refused {
                    code: code.cast_signed(),
                    what: "an object of the node",
                }),
                SdoAnswer::Segmented { .. } => Err(Fault::Unsupported("a transfer in segments")),
                other => Ok(other),
            };
        }
        Err(Fault::TimedOut)
    }
}

/// How a CiA 404 node's process data hold a temperature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// Two bytes, times 10^−decimals °C (object 7130h).
    I16 {
        /// Decimals of the node (object 6132h).
        decimals: u8,
    },
    /// Four bytes of a floating number, °C (object 6130h).
    F32,
}

impl Number {
    fn bytes(self) -> usize {
        match self {
            Self::I16 { .. } => 2,
            Self::F32 => 4,
        }
    }

    fn value(self, data: &[u8]) -> Option<f64> {
        match self {
            Self::I16 { decimals } => {
                let raw = f64::from(i16::from_le_bytes(*data.first_chunk()?));
                Some(raw / 10_f64.powi(i32::from(decimals)))
            }
            Self::F32 => Some(f64::from(f32::from_le_bytes(*data.first_chunk()?))),
        }
    }
}

/// One temperature of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// The sensor's name.
    pub name: String,
    /// The node.
    pub node: u8,
    /// Process data 1 to 4.
    pub pdo: u8,
    /// First byte in them.
    pub at: usize,
    /// How the number stands there.
    pub number: Number,
    /// The byte with the channel's status (object 6150h), 0 when good, in the same process data.
    pub status_at: Option<usize>,
}

/// A node that is watched.
#[derive(Clone, Copy, Debug)]
struct Watched {
    state: Option<NodeState>,
    heard: Instant,
    emergency: u16,
    started: Option<Instant>,
}

/// The nodes of a consumer: started when they wait, silent when their heartbeat is.
#[derive(Debug)]
struct Nodes {
    watched: BTreeMap<u8, Watched>,
    silent_after: Duration,
}

impl Nodes {
    fn new(nodes: impl Iterator<Item = u8>, silent_after: Duration) -> Self {
        let watched = Watched {
            state: None,
            heard: Instant::now(),
            emergency: 0,
            started: None,
        };
        Self {
            watched: nodes.map(|node| (node, watched)).collect(),
            silent_after,
        }
    }

    /// Takes what concerns the nodes.
    fn hear(&mut self, telegram: Telegram, taken: Instant) {
        let (Telegram::Heartbeat { node, .. }
        | Telegram::Emergency { node, .. }
        | Telegram::Pdo { node, .. }
        | Telegram::Sdo { node, .. }) = telegram;
        let Some(watched) = self.watched.get_mut(&node) else {
            return;
        };
        match telegram {
            Telegram::Heartbeat { state, .. } => {
                watched.state = Some(state);
                watched.heard = taken;
            }
            Telegram::Emergency { code, .. } => watched.emergency = code,
            _ => {}
        }
    }

    /// What starts a node that waits for it, once in a while.
    fn start(&mut self, now: Instant) -> Option<Frame> {
        let waits = |watched: &Watched| {
            let due = watched
                .started
                .is_none_or(|then| now.saturating_duration_since(then) > Duration::from_secs(1));
            due && watched.state != Some(NodeState::Operational)
        };
        let (node, watched) = self
            .watched
            .iter_mut()
            .find(|(_, watched)| waits(watched))?;
        watched.started = Some(now);
        nmt(NmtCommand::Start, *node)
    }

    /// Why a node's data must not be used; `None` when they may.
    fn trouble(&self, node: u8) -> Option<Reason> {
        let watched = self.watched.get(&node)?;
        if watched.heard.elapsed() > self.silent_after || watched.state.is_none() {
            return Some(Reason::NoAnswer);
        }
        match watched.state {
            Some(NodeState::Operational) if watched.emergency == 0 => None,
            Some(NodeState::Operational) => Some(Reason::Reported),
            _ => Some(Reason::NotRead),
        }
    }
}

/// Temperatures of CiA 404 nodes. The consumer starts the nodes and supervises their heartbeat; reading takes
/// what has come and does not wait.
pub struct CanopenThermometer<P> {
    port: P,
    nodes: Nodes,
    channels: Vec<Channel>,
    names: Vec<String>,
    latest: Vec<Temperature>,
    stale_after: Duration,
}

impl<P: CanPort> CanopenThermometer<P> {
    /// These channels on a bus. `silent_after`: of heartbeats; `stale_after`: of process data.
    ///
    /// # Errors
    /// Channels that make no sense.
    pub fn new(
        port: P,
        channels: Vec<Channel>,
        silent_after: Duration,
        stale_after: Duration,
    ) -> Result<Self, DeviceError> {
        let refused =
            |what: String| DeviceError::option(port.device(), what, "correct the channels");
        if channels.is_empty() {
            return Err(refused("no channel is named".to_owned()));
        }
        for (index, channel) in channels.iter().enumerate() {
            let Channel {
                name,
                node,
                pdo,
                at,
                number,
                status_at,
            } = channel;
            let fits = at + number.bytes() <= 8 && status_at.is_none_or(|at| at < 8);
            if !fits || !(1..=127).contains(node) || !(1..=4).contains(pdo) {
                return Err(refused(format!(
                    "{name}: node {node}, process data {pdo}, byte {at}, expected nodes 1 to 127, process data 1 to 4 of 8 bytes"
                )));
            }
            if channels[..index].iter().any(|other| other.name == *name) {
                return Err(refused(format!("the sensor {name} stands twice")));
            }
        }
        Ok(Self {
            nodes: Nodes::new(channels.iter().map(|c| c.node), silent_after),
            names: channels.iter().map(|c| c.name.clone()).collect(),
            latest: vec![Temperature::NOT_READ; channels.len()],
            channels,
            port,
            stale_after,
        })
    }

    fn hear(&mut self, frame: &Frame, taken: Instant) {
        let Some(telegram) = telegram(frame) else {
            return;
        };
        self.nodes.hear(telegram, taken);
        let Telegram::Pdo { node, number } = telegram else {
            return;
        };
        for (channel, latest) in self.channels.iter().zip(&mut self.latest) {
            if (channel.node, channel.pdo) != (node, number) {
                continue;
            }
            let data = frame.data();
            let status = channel.status_at.map(|at| data.get(at).copied());
            let value = data
                .get(channel.at..)
                .and_then(|data| channel.number.value(data));
            *latest = match (value, status) {
                (Some(degc), None | Some(Some(0))) => Temperature::good(degc, taken),
                (_, Some(Some(_))) => Temperature::bad(Reason::Reported, taken),
                _ => Temperature::bad(Reason::NotANumber, taken),
            };
        }
    }
}

impl<P: CanPort> Thermometer for CanopenThermometer<P> {
    fn device(&self) -> &str {
        self.port.device()
    }

    fn names(&self) -> &[String] {
        &self.names
    }

    fn latest(&mut self) -> &[Temperature] {
        let now = Instant::now();
        // A flooded bus must not hold the caller up.
        for _ in 0..256 {
            match self.port.receive(now) {
                Ok(Some(Received::Frame(frame, taken))) => self.hear(&frame, taken),
                Ok(Some(_)) => {}
                Ok(None) | Err(_) => break,
            }
        }
        if let Some(frame) = self.nodes.start(now) {
            // A bus that takes nothing shows in the heartbeats.
            let _ = self.port.send(&frame, now);
        }
        for (channel, latest) in self.channels.iter().zip(&mut self.latest) {
            let stale = latest
                .taken
                .is_some_and(|taken| taken.elapsed() > self.stale_after);
            let trouble = self.nodes.trouble(channel.node);
            let trouble = trouble.or(stale.then_some(Reason::NoAnswer));
            if let (Some(reason), Some(taken)) = (trouble, latest.taken) {
                *latest = Temperature::bad(reason, taken);
            }
        }
        &self.latest
    }
}

/// A CiA 401 node as a digital port: its inputs from process data 1 that it sends, its outputs in process data
/// 1 that it receives.
pub struct CanopenDigital<P> {
    port: P,
    node: u8,
    nodes: Nodes,
    inputs: u32,
    outputs: u32,
    levels: Option<(u64, Instant)>,
    stale_after: Duration,
}

impl<P: CanPort> CanopenDigital<P> {
    /// A node with so many lines.
    ///
    /// # Errors
    /// Numbers that there are not.
    pub fn new(
        port: P,
        node: u8,
        inputs: u32,
        outputs: u32,
        silent_after: Duration,
        stale_after: Duration,
    ) -> Result<Self, DeviceError> {
        if !(1..=127).contains(&node) || inputs > 64 || outputs > 64 {
            let what = format!("found node {node}, {inputs} inputs, {outputs} outputs");
            let remedy = "expected nodes 1 to 127 and at most 64 lines each way";
            return Err(DeviceError::option(port.device(), what, remedy));
        }
        Ok(Self {
            nodes: Nodes::new([node].into_iter(), silent_after),
            port,
            node,
            inputs,
            outputs,
            levels: None,
            stale_after,
        })
    }

    fn listen(&mut self, deadline: Instant) -> Result<(), Fault> {
        for _ in 0..256 {
            let Some(received) = self.port.receive(deadline)? else {
                break;
            };
            match received {
                Received::BusOff => return Err(Fault::Disconnected),
                Received::Error => {}
                Received::Frame(frame, taken) => {
                    let Some(telegram) = telegram(&frame) else {
                        continue;
                    };
                    self.nodes.hear(telegram, taken);
                    if telegram
                        == (Telegram::Pdo {
                            node: self.node,
                            number: 1,
                        })
                    {
                        let mut bytes = [0; 8];
                        bytes[..frame.data().len()].copy_from_slice(frame.data());
                        let lines = u64::MAX.checked_shr(64 - self.inputs).unwrap_or(0);
                        self.levels = Some((u64::from_le_bytes(bytes) & lines, taken));
                    }
                }
            }
        }
        let now = Instant::now();
        if let Some(frame) = self.nodes.start(now) {
            self.port.send(&frame, now + Duration::from_millis(1))?;
        }
        Ok(())
    }
}

impl<P: CanPort> DigitalIo for CanopenDigital<P> {
    fn device(&self) -> &str {
        self.port.device()
    }

    fn inputs(&self) -> u32 {
        self.inputs
    }

    fn outputs(&self) -> u32 {
        self.outputs
    }

    /// Four frames at 125 kBd.
    fn shortest_cycle(&self) -> Duration {
        Duration::from_millis(4)
    }

    /// The inputs that the node sent last.
    fn read(&mut self, _deadline: Instant) -> Result<u64, Fault> {
        self.listen(Instant::now())?;
        match (self.levels, self.nodes.trouble(self.node)) {
            (Some((levels, taken)), None) if taken.elapsed() <= self.stale_after => Ok(levels),
            (_, Some(Reason::NoAnswer)) | (None, _) => Err(Fault::NotConnected),
            (_, Some(_)) => Err(Fault::Protocol("the node reports an error or does not run")),
            (Some(_), None) => Err(Fault::TimedOut),
        }
    }

    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault> {
        let frame = outputs_frame(self.node, levels, self.outputs);
        let frame = frame.ok_or(Fault::Unsupported("so many lines"))?;
        self.port.send(&frame, deadline)
    }
}
