//! A bridge in this process: the reference barrier behind a UDP port.

use std::{
    net::{SocketAddr, UdpSocket},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use volcomp_guard::{
    barrier::{Barrier, REPORT_WORDS, Settings},
    protocol::{Counts, Layout},
};
use volcomp_linuxcnc::{
    AxisState, COMMAND_BYTES, Command, Content, Flags, Key, LinuxCncConfig, STATE_BYTES, State,
};
use volcomp_port::Words;
use volcomp_vocabulary::{AxisName, PerChannel};

pub(crate) const MACHINE: u16 = 7;
pub(crate) const KEY: Key = Key::new(*b"klmnopqrstuvwxyz");
pub(crate) const KEY_TEXT: &str = "6b6c6d6e6f707172737475767778797a\n";
pub(crate) const AXES: [AxisName; 2] = [AxisName::X, AxisName::C];

pub(crate) fn settings() -> Settings {
    Settings {
        axes: Layout::of(AXES).unwrap(),
        machine: MACHINE,
        limit: PerChannel::leading([20_000, 20_000]),
        rate: PerChannel::leading([100, 100]),
        step_scans: 1,
        hold_scans: 100,
        time_out_scans: 300,
    }
}

/// Faults of the simulated bridge, and the contents of its states apart from the report.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Behaviour {
    pub(crate) machine: u16,
    pub(crate) run: u32,
    pub(crate) flags: u16,
    pub(crate) at: [f64; 2],
    pub(crate) silent: bool,
    /// The control's planner does not move.
    pub(crate) stuck: bool,
}

pub(crate) struct Bridge {
    pub(crate) address: SocketAddr,
    pub(crate) behaviour: Arc<Mutex<Behaviour>>,
    pub(crate) barrier: Arc<Mutex<Barrier>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

pub(crate) fn state(behaviour: &Behaviour, sequence: u32, time: Duration, report: Words) -> State {
    let axis = |index: usize| AxisState {
        name: AXES[index],
        step: 1,
        position: behaviour.at[index],
        velocity: 0.0,
        // The applied correction in the report.
        offset: (report.as_slice().get(8 + 3 * index))
            .filter(|_| !behaviour.stuck)
            .map_or(0, |word| word.cast_signed().into()),
    };
    let axes = [axis(0), axis(1)];
    let mut state = State::of(&axes).unwrap();
    state.machine = behaviour.machine;
    (state.run, state.sequence) = (behaviour.run, sequence);
    state.flags = Flags(behaviour.flags);
    (state.time, state.scan) = (time, Duration::from_millis(1));
    state.report = report;
    state
}

impl Bridge {
    pub(crate) fn start() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let millisecond = Duration::from_millis(1);
        socket.set_read_timeout(Some(millisecond)).unwrap();
        let address = socket.local_addr().unwrap();
        let behaviour = Arc::new(Mutex::new(Behaviour {
            machine: MACHINE,
            run: 1,
            flags: Flags::ENABLED | Flags::HOMED,
            at: [100.0, 90.0],
            silent: false,
            stuck: false,
        }));
        let barrier = Barrier::start(settings(), 0, 0, &Counts::default()).unwrap();
        let barrier = Arc::new(Mutex::new(barrier));
        let stop = Arc::new(AtomicBool::new(false));
        let shared = (Arc::clone(&behaviour), Arc::clone(&barrier), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            let (behaviour, barrier, stop) = shared;
            let (mut peer, mut sequence) = (None, 0_u32);
            let start = Instant::now();
            let mut bytes = [0; COMMAND_BYTES];
            while !stop.load(Ordering::Relaxed) {
                let mut frame = None;
                if let Ok((length, from)) = socket.recv_from(&mut bytes)
                    && let Ok(command) = Command::decode(&bytes[..length], &KEY)
                {
                    // States are sent to every client; frames for another machine are ignored.
                    match command.content {
                        Content::Listen => peer = Some(from),
                        Content::Frame(words) if command.machine == MACHINE => {
                            (peer, frame) = (Some(from), Some(words));
                        }
                        Content::Frame(_) => {}
                    }
                }
                let mailbox = frame.as_ref().map(Words::as_slice);
                let report = {
                    let mut barrier = barrier.lock().unwrap();
                    barrier.scan(mailbox.as_slice(), false)
                };
                let mut words = [0; REPORT_WORDS];
                let length = report.encode(&mut words);
                let behaviour = *behaviour.lock().unwrap();
                sequence += 1;
                let report = Words::new(&words[..length]).unwrap();
                let state = state(&behaviour, sequence, start.elapsed(), report);
                let mut out = [0; STATE_BYTES];
                let length = state.encode(&KEY, &mut out);
                if let Some(peer) = peer.filter(|_| !behaviour.silent) {
                    let _ = socket.send_to(&out[..length], peer);
                }
            }
        });
        Self { address, behaviour, barrier, stop, thread: Some(thread) }
    }

    pub(crate) fn config(&self) -> LinuxCncConfig {
        LinuxCncConfig {
            host: self.address.ip().to_string(),
            port: self.address.port(),
            key: KEY,
            remote: false,
            channel: "linuxcnc".to_owned(),
            machine: MACHINE,
            axes: AXES.to_vec(),
            reads: Vec::new(),
            step_linear: LinuxCncConfig::STEP_LINEAR,
            step_rotary: LinuxCncConfig::step_rotary(),
        }
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
