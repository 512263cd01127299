//! A simulated control on the network, for tests and rehearsals. It responds as in public captures. [`Options`] select
//! deviating behaviour.

use std::{
    io::{Read, Write},
    net::{Shutdown, SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use crate::{
    answers::function,
    frame::{Command, HEAD, Head, Kind, Target, frame, number_bytes, parse_commands, push_block},
    parameters::{SHIFT_FIRST, SHIFT_IN_USE, UNIT_NUMBERS},
    pmc::PmcArea,
};

mod world;

pub use world::{BarrierLadder, Ladder, LadderProgram, Motion, Scan, ScanLog, ShiftArea, World};

#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[expect(clippy::struct_excessive_bools, reason = "independent properties of a control")]
pub struct Options {
    /// Protocol version of the control's responses: 2 (16i), 3 (0i), 4 (31i).
    pub version: u16,
    /// Number of slots in responses about all axes: 8 or 32.
    pub slots: usize,
    /// Whether the slots after the last axis contain garbage.
    pub garbage: bool,
    /// Whether a command may address only one point of PMC memory. Ranges are then rejected with EW_NUMBER.
    pub one_point: bool,
    /// Whether a command may read the position of only one axis. A command for all axes is then rejected with
    /// EW_NUMBER.
    pub one_axis: bool,
    /// Whether a request with commands for both the control and the PMC is rejected as a whole.
    pub refuses_mix: bool,
    /// Whether a request with more than one command is rejected as a whole.
    pub one_command: bool,
    pub write_protected: bool,
    pub sessions: usize,
    /// Size of the pieces in which responses are sent, bytes; 0 to send them whole.
    pub fragment: usize,
    pub latency: Duration,
}

impl Default for Options {
    /// A control with protocol version 3 and 32 slots. Unused slots contain garbage.
    fn default() -> Self {
        Self {
            version: 3,
            slots: 32,
            garbage: true,
            one_point: false,
            one_axis: false,
            refuses_mix: false,
            one_command: false,
            write_protected: false,
            sessions: 4,
            fragment: 0,
            latency: Duration::ZERO,
        }
    }
}

/// A simulated control on a TCP socket. Dropping it ends its threads and connections.
pub struct Simulator {
    address: SocketAddr,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

struct Shared {
    options: Options,
    world: Mutex<World>,
    sessions: Mutex<Vec<TcpStream>>,
    requests: AtomicU64,
    stop: AtomicBool,
}

impl Shared {
    fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn sessions(&self) -> MutexGuard<'_, Vec<TcpStream>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Simulator {
    /// Listens on an address such as `127.0.0.1:0`, and starts the scans of the control.
    ///
    /// # Errors
    /// The address cannot be bound.
    pub fn start(address: &str, options: Options, mut world: World) -> std::io::Result<Self> {
        // At the start, the control's program takes over the shifts from the axis words.
        world.reset();
        let listener = TcpListener::bind(address)?;
        let address = listener.local_addr()?;
        let shared = Arc::new(Shared {
            options,
            world: Mutex::new(world),
            sessions: Mutex::new(Vec::new()),
            requests: AtomicU64::new(0),
            stop: AtomicBool::new(false),
        });
        let mut simulator = Self { address, shared, threads: Vec::new() };
        let scanned = Arc::clone(&simulator.shared);
        simulator.run("focas-scan", move || scan(&scanned))?;
        let served = Arc::clone(&simulator.shared);
        simulator.run("focas-sim", move || listen(&listener, &served))?;
        Ok(simulator)
    }

    fn run(&mut self, name: &str, work: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
        let thread = thread::Builder::new().name(name.to_owned()).spawn(work)?;
        self.threads.push(thread);
        Ok(())
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Locks the machine and the memory of the control. No responses are sent while the lock is held.
    pub fn world(&self) -> MutexGuard<'_, World> {
        self.shared.world()
    }

    pub fn open_sessions(&self) -> usize {
        self.shared.sessions().len()
    }

    pub fn requests(&self) -> u64 {
        self.shared.requests.load(Ordering::Relaxed)
    }

    /// Power-cycles the control (see [`World::power_up`]) and ends its connections.
    pub fn power_up(&self) {
        self.world().power_up();
        self.disconnect_all();
    }

    /// Cuts all connections, like an unplugged cable.
    pub fn disconnect_all(&self) {
        for session in self.shared.sessions().iter() {
            // An error means that the session is already closed.
            let _ = session.shutdown(Shutdown::Both);
        }
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::SeqCst);
        self.disconnect_all();
        // The listening thread waits for a connection, so this connection lets it end.
        drop(TcpStream::connect(self.address));
        for thread in self.threads.drain(..) {
            // The panic message of the thread was already printed.
            let _ = thread.join();
        }
    }
}

/// Runs the scans of the control at its scan period. If the thread is late by up to five scans, it catches up;
/// otherwise the missed scans are skipped.
fn scan(shared: &Shared) {
    const MOST_BEHIND: u32 = 5;
    let mut due = Instant::now();
    while !shared.stop.load(Ordering::SeqCst) {
        let time = {
            let mut world = shared.world();
            world.run_scan();
            world.scan.max(Duration::from_micros(100))
        };
        let now = Instant::now();
        due += time;
        if due + time * MOST_BEHIND < now {
            due = now;
        }
        thread::sleep(due.saturating_duration_since(now));
    }
}

fn listen(listener: &TcpListener, shared: &Arc<Shared>) {
    for stream in listener.incoming() {
        if shared.stop.load(Ordering::SeqCst) {
            return;
        }
        let Ok(stream) = stream else { continue };
        let served = Arc::clone(shared);
        let started = thread::Builder::new().name("focas-session".to_owned()).spawn(move || {
            // A session ends with its connection, with or without an error.
            let _ = serve(stream, &served);
        });
        if started.is_err() {
            return;
        }
    }
}

fn serve(mut stream: TcpStream, shared: &Shared) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let local = stream.peer_addr()?;
    let (head, _) = receive(&mut stream)?;
    let version = shared.options.version;
    if head.kind != Kind::Open {
        return Ok(());
    }
    wait_out_silence(shared);
    {
        let mut sessions = shared.sessions();
        if sessions.len() >= shared.options.sessions {
            return send(&mut stream, shared, version, Kind::Refused, &[0, 0, 0, 4]);
        }
        sessions.push(stream.try_clone()?);
    }
    let served = answer_all(&mut stream, shared);
    let mut sessions = shared.sessions();
    sessions.retain(|other| other.peer_addr().is_ok_and(|address| address != local));
    served
}

fn answer_all(stream: &mut TcpStream, shared: &Shared) -> std::io::Result<()> {
    let options = &shared.options;
    let opened = opened(options);
    send(stream, shared, options.version, Kind::Opened, &opened)?;
    loop {
        let (head, payload) = receive(stream)?;
        match head.kind {
            Kind::Close => return send(stream, shared, options.version, Kind::Closed, &[]),
            Kind::Command => {
                shared.requests.fetch_add(1, Ordering::Relaxed);
                let latency = options.latency + shared.world().latency;
                thread::sleep(latency);
                wait_out_silence(shared);
                let (kind, answer) = {
                    let mut world = shared.world();
                    answer(&payload, options, &mut world)
                };
                send(stream, shared, options.version, kind, &answer)?;
            }
            // An unexpected frame ends the connection.
            _ => return Ok(()),
        }
    }
}

fn wait_out_silence(shared: &Shared) {
    while !shared.stop.load(Ordering::SeqCst) {
        let Some(left) = shared.world().silence() else {
            return;
        };
        thread::sleep(left.min(Duration::from_millis(10)));
    }
}

fn receive(stream: &mut TcpStream) -> std::io::Result<(Head, Vec<u8>)> {
    let mut head = [0; HEAD];
    stream.read_exact(&mut head)?;
    let head = Head::parse(&head).map_err(|e| std::io::Error::other(e.0))?;
    let mut payload = vec![0; head.length];
    stream.read_exact(&mut payload)?;
    Ok((head, payload))
}

fn send(
    stream: &mut TcpStream,
    shared: &Shared,
    version: u16,
    kind: Kind,
    payload: &[u8],
) -> std::io::Result<()> {
    let bytes = frame(version, kind, payload).map_err(|e| std::io::Error::other(e.0))?;
    match shared.options.fragment {
        0 => stream.write_all(&bytes),
        pieces => bytes.chunks(pieces).try_for_each(|piece| {
            stream.write_all(piece)?;
            // Without a pause the kernel would send the pieces together.
            thread::sleep(Duration::from_micros(200));
            Ok(())
        }),
    }
}

const LENGTH: i16 = 2;
const NUMBER: i16 = 3;
const PROTECTED: i16 = 7;
const NO_FUNCTION: i16 = 1;

/// Builds the payload of the response to a request to open a session.
fn opened(options: &Options) -> Vec<u8> {
    let (length, count_at) =
        if options.version < 3 { (16 + 8 * 10, 8) } else { (40 + 32 * 10, 10) };
    let mut payload = vec![0; length];
    payload[count_at + 1] = 10;
    payload
}

fn answer(payload: &[u8], options: &Options, world: &mut World) -> (Kind, Vec<u8>) {
    let negative =
        |code: i16| (Kind::Negative, [&[0; 2], &code.to_be_bytes()[..], &[0, 1, 0, 0]].concat());
    let Ok(commands) = parse_commands(payload) else {
        return negative(-17);
    };
    let mixed = commands.windows(2).any(|pair| pair[0].target != pair[1].target);
    let packed = commands.len() > 1;
    if (options.refuses_mix && mixed) || (options.one_command && packed) {
        return negative(-17);
    }
    let mut answer = Vec::new();
    answer.extend(u16::try_from(commands.len()).unwrap_or(0).to_be_bytes());
    for command in &commands {
        let (error, data) = match answer_one(command, options, world) {
            Ok(data) => (0, data),
            Err(Refusal::Command(error)) => (error, Vec::new()),
            Err(Refusal::Frame) => return negative(-17),
        };
        if push_block(&mut answer, command, error, &data).is_err() {
            return negative(-17);
        }
    }
    (Kind::Answer, answer)
}

enum Refusal {
    /// Rejects only the command, with this return code.
    Command(i16),
    /// Rejects the whole frame, as for a parameter number that does not exist.
    Frame,
}

type CommandResult = Result<Vec<u8>, Refusal>;

fn answer_one(command: &Command<'_>, options: &Options, world: &mut World) -> CommandResult {
    match (command.target, command.function) {
        (Target::Cnc, function::SYSTEM) => Ok(system(options, world)),
        (Target::Cnc, function::STATUS) => Ok(status(world)),
        (Target::Cnc, function::AXIS_NAMES) => Ok(axis_names(options, world)),
        (Target::Cnc, function::POSITIONS) => positions(command, options, world),
        (Target::Cnc, function::ALARMS) => Ok(alarms(world)),
        (Target::Cnc, function::READ_MACRO) => Ok(read_macro(command, world)),
        (Target::Cnc, READ_MACRO_NUMBERS) => read_macro_numbers(command, world),
        (Target::Cnc, function::WRITE_MACRO) => write_macro(command, world),
        (Target::Cnc, function::READ_OFFSET) => {
            let number = command.args[0];
            let of = |slot| world.offsets.get(&(number, slot)).copied().unwrap_or(0.0);
            Ok(slots((0..world.axes.len()).map(of), options))
        }
        (Target::Cnc, function::WRITE_OFFSET) => write_offset(command, world),
        (Target::Cnc, function::READ_PARAMETER) => parameter(command, options, world),
        (Target::Pmc, function::READ_PMC) => read_pmc(command, options, world),
        (Target::Pmc, function::WRITE_PMC) => write_pmc(command, options, world),
        _ => Err(Refusal::Command(NO_FUNCTION)),
    }
}

const READ_MACRO_NUMBERS: u16 = 0x15;

fn system(options: &Options, world: &World) -> Vec<u8> {
    let slots = u16::try_from(options.slots).unwrap_or(u16::MAX);
    let kind: &[u8; 4] = match options.version {
        2 => b"16 M",
        3 => b" 0 M",
        _ => b"31 M",
    };
    let mut data = vec![0x06, 0x62];
    data.extend(slots.to_be_bytes());
    data.extend(kind);
    data.extend(b"D4G328.0");
    data.extend(format!("{:02}", world.axes.len().min(99)).bytes());
    data
}

fn status(world: &World) -> Vec<u8> {
    let emergency = u16::from(world.emergency_stop());
    let alarm = u16::from(!world.alarms.is_empty());
    let words = [1, 3, 1, 0, emergency, alarm, 0];
    words.into_iter().flat_map(u16::to_be_bytes).collect()
}

fn axis_names(options: &Options, world: &World) -> Vec<u8> {
    let name = |letter: &char| [u8::try_from(*letter).unwrap_or(b'?'), 0, 0, 0];
    let mut data: Vec<u8> = world.axes.iter().flat_map(name).collect();
    data.resize(4 * options.slots.max(world.axes.len()), 0);
    data
}

/// Encodes numbers with three decimals in slots, and fills the unused slots with garbage or 0.
fn slots(values: impl Iterator<Item = f64>, options: &Options) -> Vec<u8> {
    let mut data: Vec<u8> = values.flat_map(|value| number_bytes(value, 3)).collect();
    let mut garbage = 0x5eed_u32;
    while data.len() < 8 * options.slots {
        garbage = garbage.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let [a, ..] = garbage.to_be_bytes();
        data.push(if options.garbage { a } else { 0 });
    }
    data
}

fn positions(command: &Command<'_>, options: &Options, world: &mut World) -> CommandResult {
    let positions = world.positions();
    match command.args {
        [1 | 4 | 0, -1, ..] if options.one_axis => Err(Refusal::Command(NUMBER)),
        [1 | 4 | 0, -1, ..] => Ok(slots(positions.into_iter(), options)),
        [1 | 4 | 0, axis, ..] => {
            let index = usize::try_from(axis - 1).map_err(|_| Refusal::Command(NUMBER))?;
            let position = positions.get(index).ok_or(Refusal::Command(NUMBER))?;
            Ok(number_bytes(*position, 3).to_vec())
        }
        _ => Err(Refusal::Command(NO_FUNCTION)),
    }
}

fn alarms(world: &World) -> Vec<u8> {
    let record = |(number, text): &(i32, String)| {
        let mut record = Vec::new();
        let length = i32::try_from(text.len().min(64)).unwrap_or(0);
        for word in [*number, 6, 0, length] {
            record.extend(word.to_be_bytes());
        }
        record.extend(text.bytes().take(64));
        record.resize(80, 0);
        record
    };
    world.alarms.iter().flat_map(record).collect()
}

fn read_macro(command: &Command<'_>, world: &World) -> Vec<u8> {
    let [first, count, ..] = command.args;
    let value = |number| world.macros.get(&number).copied().unwrap_or(f64::NAN);
    let numbers = first..first.saturating_add(count.clamp(0, 100));
    numbers.flat_map(|n| value(n).to_be_bytes()).collect()
}

fn read_macro_numbers(command: &Command<'_>, world: &World) -> CommandResult {
    let [first, last, ..] = command.args;
    let value = |number| match world.macros.get(&number) {
        Some(value) => number_bytes(*value, 6),
        None => [0, 0, 0, 0, 0, 10, 0xff, 0xff],
    };
    if !(first..first.saturating_add(100)).contains(&last) {
        return Err(Refusal::Command(NUMBER));
    }
    Ok((first..=last).flat_map(value).collect())
}

fn write_macro(command: &Command<'_>, world: &mut World) -> CommandResult {
    let bytes = command.data.first_chunk().ok_or(Refusal::Command(LENGTH))?;
    world.macros.insert(command.args[0], f64::from_be_bytes(*bytes));
    Ok(Vec::new())
}

fn write_offset(command: &Command<'_>, world: &mut World) -> CommandResult {
    let [number, _, axis, ..] = command.args;
    let slot = usize::try_from(axis - 1).map_err(|_| Refusal::Command(NUMBER))?;
    let mantissa = command.data.first_chunk().ok_or(Refusal::Command(LENGTH))?;
    if slot >= world.axes.len() {
        return Err(Refusal::Command(NUMBER));
    }
    let value = f64::from(i32::from_be_bytes(*mantissa)) / 1000.0;
    world.offsets.insert((number, slot), value);
    Ok(Vec::new())
}

fn parameter(command: &Command<'_>, options: &Options, world: &World) -> CommandResult {
    let number = command.args[0];
    let of = |slot| world.parameters.get(&(number, slot)).copied();
    let is_set = world.parameters.keys().any(|(known, _)| *known == number);
    let default = if is_set { Some(0.0) } else { known_parameter(number, world) };
    // In captures, an unknown number makes the control reject the whole frame.
    let default = default.ok_or(Refusal::Frame)?;
    let mut data = number.to_be_bytes().to_vec();
    data.extend([0, 0, 0, 2]);
    let values = (0..world.axes.len()).map(|slot| of(slot).unwrap_or(default));
    data.extend(slots(values, options));
    Ok(data)
}

/// Value of a parameter that determines the unit of positions or the source of the shifts; `None` for other parameters.
fn known_parameter(number: i32, world: &World) -> Option<f64> {
    if UNIT_NUMBERS.contains(&number) {
        // The control is metric and reports positions in mm.
        return Some(0.0);
    }
    if !world.reports_shift_source {
        return None;
    }
    let in_r = world.shift.area == PmcArea::R;
    match number {
        SHIFT_IN_USE => Some(if in_r { 1.0 } else { 0.0 }),
        SHIFT_FIRST => {
            let first = if in_r { world.shift.first } else { 0 };
            u32::try_from(first).ok().map(f64::from)
        }
        _ => None,
    }
}

/// Parses the arguments of a PMC command: area, first byte, bytes per point, total number of bytes.
fn pmc_range(
    command: &Command<'_>,
    options: &Options,
) -> Result<(PmcArea, usize, usize, usize), Refusal> {
    let [first, last, area, width, _] = command.args;
    let area = usize::try_from(area).ok().and_then(|area| PmcArea::ALL.get(area));
    let area = *area.ok_or(Refusal::Command(NUMBER))?;
    let width = match width {
        0 => 1,
        1 => 2,
        2 => 4,
        _ => return Err(Refusal::Command(NUMBER)),
    };
    let at = usize::try_from(first).map_err(|_| Refusal::Command(NUMBER))?;
    let bytes = usize::try_from(last - first + 1).map_err(|_| Refusal::Command(NUMBER))?;
    if bytes == 0 || bytes % width != 0 || bytes > 2048 {
        return Err(Refusal::Command(LENGTH));
    }
    if options.one_point && bytes > width {
        return Err(Refusal::Command(NUMBER));
    }
    Ok((area, at, width, bytes))
}

/// Swaps the byte order of each point, because memory is little-endian and the protocol is big-endian.
fn swap_points(bytes: &[u8], width: usize) -> Vec<u8> {
    let points = bytes.chunks(width);
    points.flat_map(|point| point.iter().rev().copied()).collect()
}

fn read_pmc(command: &Command<'_>, options: &Options, world: &mut World) -> CommandResult {
    let (area, at, width, bytes) = pmc_range(command, options)?;
    let memory = world.read(area, at, bytes);
    memory.map(|bytes| swap_points(&bytes, width)).ok_or(Refusal::Command(NUMBER))
}

fn write_pmc(command: &Command<'_>, options: &Options, world: &mut World) -> CommandResult {
    let (area, at, width, bytes) = pmc_range(command, options)?;
    if command.data.len() != bytes {
        return Err(Refusal::Command(LENGTH));
    }
    if options.write_protected {
        return Err(Refusal::Command(PROTECTED));
    }
    // The manufacturer's simulated control rejects writes to the machine's outputs.
    if area == PmcArea::Y || !world.write(area, at, &swap_points(command.data, width)) {
        return Err(Refusal::Command(NUMBER));
    }
    Ok(Vec::new())
}
