//! The controller of a correction in real time: two exchanges a cycle.

use std::time::{Duration, Instant};

use volcomp_port::{
    Axis, Backoff, Controller, ControllerState, Description, DeviceError, Fault, Heartbeat,
    Snapshot, Supply,
};

use volcomp_vocabulary::{AxisKind, AxisName, Displacement, PerChannel};

use crate::{
    client::{Client, PmcArea, PositionKind, Width, function, slot, status},
    frame::{Block, Broken, Command, Request, Target},
    session::Session,
};

/// A place in the memory of the PMC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PmcAddress {
    /// Its area.
    pub area: PmcArea,
    /// Its byte.
    pub at: u16,
}

/// Where the machine zero point shift of each axis is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// The number of the control's first axis; the others follow.
    pub first: PmcAddress,
    /// Bytes of each number.
    pub width: Width,
    /// What one count moves a linear axis, mm.
    pub count_mm: f64,
    /// What one count moves a rotary axis, rad.
    pub count_rad: f64,
}

impl Shift {
    /// What one count moves an axis of this kind.
    pub fn count(&self, kind: AxisKind) -> Displacement {
        let mm_or_rad = match kind {
            AxisKind::Linear => self.count_mm,
            AxisKind::Rotary => self.count_rad,
        };
        Displacement::new(kind, mm_or_rad)
    }
}

/// How a control is used.
#[derive(Clone, Debug, PartialEq)]
pub struct FocasConfig {
    /// Name or address.
    pub host: String,
    /// Port, 8193 as delivered.
    pub port: u16,
    /// Path of the control, from 1.
    pub path: u16,
    /// Name of the channel by which corrections get in.
    pub channel: String,
    /// The axes to correct, in channel order.
    pub axes: Vec<AxisName>,
    /// Where corrections are written.
    pub shift: Shift,
    /// A byte that every correction moves on, for the ladder to watch; `None`: nobody watches.
    pub heartbeat: Option<PmcAddress>,
    /// A byte that is written last in every correction and counts up: where a ladder copies the shifts on, it
    /// does so when this byte has changed, and so takes all axes together.
    pub sequence: Option<PmcAddress>,
    /// Which positions are read.
    pub positions: PositionKind,
    /// Whether they contain the shift.
    pub includes_correction: bool,
    /// A byte whose bits say which axes are referenced, the control's first axis lowest; `None`: they are
    /// taken to be.
    pub referenced: Option<PmcAddress>,
    /// Control and PMC are asked in frames of their own, where a control refuses the mix.
    pub split: bool,
    /// PMC memory is asked point by point, where a control serves one at a time.
    pub one_point: bool,
    /// For connecting.
    pub at_most: Duration,
    /// Between tries to connect.
    pub backoff: Backoff,
}

impl FocasConfig {
    /// Linear axes with their shift in words of 1 µm from R100 on, a heartbeat at R120, referenced axes in F120.
    ///
    /// The addresses are examples; that a shift from R memory is enabled (parameters 1203#0 and 1280) and
    /// that F120 tells the referenced axes is not proven: read the control's manual.
    pub fn new(host: impl Into<String>, axes: &[AxisName]) -> Self {
        let address = |area, at| PmcAddress { area, at };
        Self {
            host: host.into(),
            port: 8193,
            path: 1,
            channel: "emzps".to_owned(),
            axes: axes.to_vec(),
            shift: Shift {
                first: address(PmcArea::R, 100),
                width: Width::Word,
                count_mm: 0.001,
                count_rad: 1e-3_f64.to_radians(),
            },
            heartbeat: Some(address(PmcArea::R, 120)),
            sequence: None,
            positions: PositionKind::Machine,
            includes_correction: false,
            referenced: Some(address(PmcArea::F, 120)),
            split: false,
            one_point: false,
            at_most: Duration::from_secs(2),
            backoff: Backoff::default(),
        }
    }

    fn device(&self) -> String {
        format!("focas://{}:{}", self.host, self.port)
    }

    fn description(&self) -> Description {
        let axis = |&name: &AxisName| Axis {
            name,
            includes_correction: self.includes_correction,
            resolution: self.shift.count(name.kind()),
        };
        Description {
            device: self.device(),
            channel: self.channel.clone(),
            axes: self.axes.iter().map(axis).collect(),
            heartbeat: match self.heartbeat {
                Some(_) => Heartbeat::Watched,
                None => Heartbeat::Unwatched,
            },
            sees_other_gateways: self.heartbeat.is_some(),
            shortest_cycle: Duration::from_millis(1),
        }
    }
}

/// A control that is corrected. The connection is made, and made again, on a thread of its own.
pub struct FocasController {
    description: Description,
    supply: Supply<Link>,
}

impl FocasController {
    /// Begins to connect.
    ///
    /// # Errors
    /// A configuration that makes no sense.
    pub fn new(config: FocasConfig) -> Result<Self, DeviceError> {
        let device = config.device();
        let (description, backoff) = (config.description(), config.backoff);
        if let Err(unfit) = description.check() {
            let remedy = "correct the axes, or what one count moves them";
            return Err(DeviceError::new(&*device, unfit.to_string(), remedy));
        }
        let supply = Supply::new(&device, backoff, move || Link::open(&config))?;
        Ok(Self {
            description,
            supply,
        })
    }

    /// Waits for the first connection.
    ///
    /// # Errors
    /// Why there is none.
    pub fn wait(&mut self, at_most: Duration) -> Result<(), DeviceError> {
        self.supply.wait(at_most).map(|_| ())
    }

    /// How often a connection was made.
    pub fn connections(&self) -> u64 {
        self.supply.opened()
    }

    /// Why there is no connection. Takes a lock: not for a cycle.
    pub fn last_error(&self) -> Option<DeviceError> {
        self.supply.last_error()
    }

    fn call<T>(&mut self, call: impl FnOnce(&mut Link) -> Result<T, Fault>) -> Result<T, Fault> {
        let link = self.supply.current()?;
        let result = call(link);
        if link.session.is_dead() || matches!(result, Err(Fault::Protocol(_))) {
            self.supply.lose();
        }
        result
    }
}

impl Controller for FocasController {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        self.call(|link| link.read(deadline))
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        self.call(|link| link.apply(corrections, deadline))
    }
}

/// An open session with the requests of a cycle.
struct Link {
    session: Session,
    axes: Vec<LinkAxis>,
    width: Width,
    reads: Vec<(Request, Vec<Read>)>,
    write: Request,
    heartbeat: Option<(usize, u8)>,
    /// Which command of the write, and the last number.
    sequence: Option<(usize, u8)>,
    /// The heartbeat that is in the control: what was written or, before that, read.
    known_heartbeat: Option<u8>,
}

/// Where an axis stands on the control.
struct LinkAxis {
    /// Its slot among the control's axes.
    slot: usize,
    rotary: bool,
    count: f64,
    /// Which command of the write, and which byte of its data.
    written_at: (usize, usize),
}

/// What a command of a read is for.
#[derive(Clone, Copy)]
enum Read {
    Status,
    Positions,
    /// Shifts of the axes from so many on.
    Shifts(usize, usize),
    Heartbeat,
    Referenced,
}

impl Link {
    fn open(config: &FocasConfig) -> Result<Self, DeviceError> {
        let device = config.device();
        let failed = |what: String, remedy: &str| DeviceError::new(&*device, what, remedy);
        let asked = |fault: Fault| failed(fault.to_string(), "check the options of the control");
        let mut client = Client::open(&config.host, config.port, config.at_most)?;
        let names = client.axis_names().map_err(asked)?;
        let mut axes = Vec::new();
        for name in &config.axes {
            let slot = names
                .iter()
                .position(|found| *found == name.letter())
                .ok_or_else(|| {
                    let found: String = names.iter().collect();
                    let what = format!("the control has no axis {name}, found {found}");
                    failed(what, "correct the axes of the configuration")
                })?;
            axes.push(LinkAxis {
                slot,
                rotary: name.is_rotary(),
                count: config.shift.count(name.kind()).mm_or_rad(),
                written_at: (0, 0),
            });
        }
        let plan = Plan::new(config, &mut axes);
        let too_long = |e: Broken| failed(e.0.to_owned(), "correct fewer axes");
        Ok(Self {
            session: client.into_session(),
            axes,
            width: config.shift.width,
            reads: plan.reads(config).map_err(too_long)?,
            write: plan.write(config).map_err(too_long)?,
            heartbeat: config.heartbeat.map(|_| (plan.runs.len(), 0)),
            sequence: config
                .sequence
                .map(|_| (plan.runs.len() + usize::from(config.heartbeat.is_some()), 0)),
            known_heartbeat: None,
        })
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        let begun = Instant::now();
        let mut snapshot = Snapshot {
            positions: PerChannel::ZERO,
            taken: begun,
            uncertainty: Duration::ZERO,
            state: ControllerState {
                referenced: true,
                ..ControllerState::default()
            },
            applied: Some(PerChannel::ZERO),
        };
        let mut heartbeat = None;
        for (index, (request, reads)) in self.reads.iter().enumerate() {
            let blocks = self.session.exchange(request, deadline)?;
            for (block, read) in blocks.zip(reads) {
                let block = answered(block)?;
                let axes = &self.axes;
                match *read {
                    Read::Heartbeat => heartbeat = block.data.first().copied(),
                    Read::Shifts(from, count) => {
                        let applied = snapshot.applied.get_or_insert(PerChannel::ZERO);
                        read_shifts(block.data, self.width, axes, from..from + count, applied)?;
                    }
                    other => read_state(other, block.data, axes, &mut snapshot)?,
                }
            }
            if index == 0 {
                // Positions are in the first frame.
                let half = begun.elapsed() / 2;
                (snapshot.taken, snapshot.uncertainty) = (begun + half, half);
            }
        }
        self.check_heartbeat(heartbeat)?;
        Ok(snapshot)
    }

    /// Nobody else may move the heartbeat.
    fn check_heartbeat(&mut self, found: Option<u8>) -> Result<(), Fault> {
        let before = self.known_heartbeat;
        self.known_heartbeat = found.or(before);
        match (before, found) {
            (Some(before), Some(found)) if before != found => Err(Fault::OtherGateway),
            _ => Ok(()),
        }
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        for (axis, correction) in self.axes.iter().zip(corrections) {
            let (command, byte) = axis.written_at;
            let into = self.write.data_mut(command).get_mut(byte..);
            put(
                into.unwrap_or_default(),
                self.width,
                correction / axis.count,
            );
        }
        if let Some((command, beat)) = &mut self.heartbeat {
            *beat = self.known_heartbeat.unwrap_or(*beat).wrapping_add(1);
            if let Some(byte) = self.write.data_mut(*command).first_mut() {
                *byte = *beat;
            }
        }
        if let Some((command, number)) = &mut self.sequence {
            *number = number.wrapping_add(1);
            if let Some(byte) = self.write.data_mut(*command).first_mut() {
                *byte = *number;
            }
        }
        for block in self.session.exchange(&self.write, deadline)? {
            answered(block)?;
        }
        if let Some((_, beat)) = self.heartbeat {
            self.known_heartbeat = Some(beat);
        }
        Ok(())
    }
}

/// The command went well.
fn answered(block: Result<Block<'_>, Broken>) -> Result<Block<'_>, Fault> {
    let block = block?;
    if block.error == 0 {
        Ok(block)
    } else {
        Err(Fault::Refused {
            code: i32::from(block.error),
            what: "a command of the cycle",
        })
    }
}

fn read_state(
    read: Read,
    data: &[u8],
    axes: &[LinkAxis],
    snapshot: &mut Snapshot,
) -> Result<(), Broken> {
    match read {
        Read::Status => {
            let found = status(data)?;
            snapshot.state.alarm = found.alarm != 0;
            snapshot.state.emergency_stop = found.emergency != 0;
        }
        Read::Positions => {
            for (position, axis) in snapshot.positions.iter_mut().zip(axes) {
                let found = slot(data, axis.slot)?;
                *position = if axis.rotary {
                    found.to_radians()
                } else {
                    found
                };
            }
        }
        Read::Referenced => {
            let bits = *data.first().ok_or(Broken("no byte of referenced axes"))?;
            let referenced = |axis: &LinkAxis| axis.slot > 7 || bits >> axis.slot & 1 == 1;
            snapshot.state.referenced = axes.iter().all(referenced);
        }
        Read::Shifts(..) | Read::Heartbeat => {}
    }
    Ok(())
}

/// Shifts of the axes whose slots are `slots`, as their counts stand in `data`.
fn read_shifts(
    data: &[u8],
    width: Width,
    axes: &[LinkAxis],
    slots: std::ops::Range<usize>,
    applied: &mut PerChannel<f64>,
) -> Result<(), Broken> {
    let bytes = usize::from(width.bytes());
    for (applied, axis) in applied.iter_mut().zip(axes) {
        let Some(index) = axis
            .slot
            .checked_sub(slots.start)
            .filter(|_| slots.contains(&axis.slot))
        else {
            continue;
        };
        let count = data
            .get(index * bytes..)
            .and_then(|rest| count(rest, width));
        *applied = count.ok_or(Broken("fewer shifts than asked for"))? * axis.count;
    }
    Ok(())
}

fn count(bytes: &[u8], width: Width) -> Option<f64> {
    match width {
        Width::Byte => bytes.first().map(|b| f64::from(b.cast_signed())),
        Width::Word => bytes
            .first_chunk()
            .map(|b| f64::from(i16::from_be_bytes(*b))),
        Width::Long => bytes
            .first_chunk()
            .map(|b| f64::from(i32::from_be_bytes(*b))),
    }
}

/// The nearest count that the width can hold; NaN is none.
#[expect(clippy::cast_possible_truncation, reason = "a cast of f64 saturates")]
fn put(into: &mut [u8], width: Width, count: f64) {
    let count = count.round();
    let bytes = match width {
        Width::Byte => {
            let [byte] = (count as i8).to_be_bytes();
            [byte, 0, 0, 0]
        }
        Width::Word => {
            let [a, b] = (count as i16).to_be_bytes();
            [a, b, 0, 0]
        }
        Width::Long => (count as i32).to_be_bytes(),
    };
    let length = usize::from(width.bytes());
    if let Some(into) = into.get_mut(..length) {
        into.copy_from_slice(&bytes[..length]);
    }
}

/// The commands of a cycle.
struct Plan {
    /// Runs of neighbouring slots whose shifts are asked for together: first and count.
    runs: Vec<(usize, usize)>,
}

impl Plan {
    fn new(config: &FocasConfig, axes: &mut [LinkAxis]) -> Self {
        let mut slots: Vec<usize> = axes.iter().map(|axis| axis.slot).collect();
        slots.sort_unstable();
        let mut runs: Vec<(usize, usize)> = Vec::new();
        for slot in slots {
            match runs.last_mut() {
                Some((first, count)) if !config.one_point && *first + *count == slot => *count += 1,
                _ => runs.push((slot, 1)),
            }
        }
        let bytes = usize::from(config.shift.width.bytes());
        for axis in axes {
            let run = runs
                .iter()
                .position(|(first, count)| (*first..first + count).contains(&axis.slot));
            // Every slot is in a run.
            let run = run.unwrap_or(0);
            axis.written_at = (run, (axis.slot - runs[run].0) * bytes);
        }
        Self { runs }
    }

    /// The frames that are read: all in one, or the control's and the PMC's apart.
    fn reads(&self, config: &FocasConfig) -> Result<Vec<(Request, Vec<Read>)>, Broken> {
        let cnc = |function, args| Command {
            target: Target::Cnc,
            path: config.path,
            function,
            args,
            data: &[],
        };
        let mut first = vec![
            (
                cnc(function::POSITIONS, [config.positions.code(), -1, 0, 0, 0]),
                Read::Positions,
            ),
            (cnc(function::STATUS, [0; 5]), Read::Status),
        ];
        let mut second = Vec::new();
        for &(slot, count) in &self.runs {
            let args = shift_args(config, slot, count, 0);
            second.push((
                pmc(config, function::READ_PMC, args, &[]),
                Read::Shifts(slot, count),
            ));
        }
        for (address, read) in [
            (config.heartbeat, Read::Heartbeat),
            (config.referenced, Read::Referenced),
        ] {
            if let Some(address) = address {
                let args = byte_args(address, 0);
                second.push((pmc(config, function::READ_PMC, args, &[]), read));
            }
        }
        let frames = if config.split {
            vec![first, second]
        } else {
            first.append(&mut second);
            vec![first]
        };
        let frame = |commands: Vec<(Command<'_>, Read)>| {
            let (commands, reads): (Vec<_>, Vec<_>) = commands.into_iter().unzip();
            Ok((Request::new(&commands)?, reads))
        };
        frames.into_iter().map(frame).collect()
    }

    fn write(&self, config: &FocasConfig) -> Result<Request, Broken> {
        let room = [0_u8; 4 * 32];
        let mut commands = Vec::new();
        for &(slot, count) in &self.runs {
            let bytes = count * usize::from(config.shift.width.bytes());
            let data = room.get(..bytes).ok_or(Broken("more than 32 axes"))?;
            let args = shift_args(config, slot, count, bytes);
            commands.push(pmc(config, function::WRITE_PMC, args, data));
        }
        for address in [config.heartbeat, config.sequence].into_iter().flatten() {
            let args = byte_args(address, 1);
            commands.push(pmc(config, function::WRITE_PMC, args, &room[..1]));
        }
        Request::new(&commands)
    }
}

fn pmc<'a>(config: &FocasConfig, function: u16, args: [i32; 5], data: &'a [u8]) -> Command<'a> {
    Command {
        target: Target::Pmc,
        path: config.path,
        function,
        args,
        data,
    }
}

/// First and last byte, area, width, and the length of what is written.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "slots and their bytes are counted in tens"
)]
fn shift_args(config: &FocasConfig, slot: usize, count: usize, written: usize) -> [i32; 5] {
    let width = i32::from(config.shift.width.bytes());
    let first = i32::from(config.shift.first.at) + slot as i32 * width;
    let last = first + count as i32 * width - 1;
    [
        first,
        last,
        config.shift.first.area as i32,
        config.shift.width.code(),
        written as i32,
    ]
}

fn byte_args(address: PmcAddress, written: i32) -> [i32; 5] {
    let at = i32::from(address.at);
    [at, at, address.area as i32, Width::Byte.code(), written]
}
