//! A simulated control on the network, for tests and rehearsals. It responds as in public captures. [`Options`] select
//! deviating behaviour.

mod answer;
mod world;

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

pub use world::{BarrierLadder, Ladder, LadderProgram, Motion, Scan, ScanLog, ShiftArea, World};

use crate::frame::{HEAD, Head, Kind, frame};

#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[expect(clippy::struct_excessive_bools, reason = "independent properties of a control")]
pub struct Options {
    /// Protocol version of the control's responses: 2 (16i), 3 (0i), 4 (31i).
    pub version: u16,
    /// Number of slots in responses about all axes: 8 or 32.
    pub slots: usize,
    /// Whether the slots behind the last axis contain garbage.
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

/// Runs the scans of the control at its scan period. Up to five delayed scans are made up for.
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
    let opened = answer::opened(options);
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
                    answer::answer(&payload, options, &mut world)
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
