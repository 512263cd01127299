//! Time from a received state to the answering frame, compared with an echo server for datagrams of the same size. Both
//! alternate over thousands of datagrams in one process: `cargo bench -p volcomp-linuxcnc --bench reply -- 20000`.

use std::{
    net::UdpSocket,
    time::{Duration, Instant},
};

use volcomp_guard::{
    barrier::{Barrier, FRAME_WORDS, REPORT_WORDS, Report, Settings},
    protocol::{Counts, Layout, Session},
};
use volcomp_linuxcnc::{
    AxisState, Flags, Key, LinuxCncConfig, LinuxCncController, STATE_BYTES, State,
};
use volcomp_port::{Controller, Words};
use volcomp_vocabulary::{AxisName, PerChannel};

const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];
const KEY: Key = Key::new([1; 16]);
const EVERY: Duration = Duration::from_millis(1);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let wanted = std::env::args().find_map(|text| text.parse().ok());
    // Without `cargo bench` the program only checks that the benchmark works.
    let is_measured = std::env::args().any(|argument| argument == "--bench");
    let rounds: usize = wanted.unwrap_or(if is_measured { 5000 } else { 50 });
    let settings = Settings {
        axes: Layout::of(AXES)?,
        machine: 1,
        limit: PerChannel::leading([30_000; 3]),
        rate: PerChannel::leading([2000; 3]),
        step_scans: 1,
        hold_scans: 100,
        time_out_scans: 300,
    };
    let mut barrier = Barrier::start(settings, 0, 0, &Counts::default())?;
    let bridge = UdpSocket::bind("127.0.0.1:0")?;
    let config = LinuxCncConfig {
        host: "127.0.0.1".to_owned(),
        port: bridge.local_addr()?.port(),
        key: KEY,
        remote: false,
        channel: "linuxcnc".to_owned(),
        machine: 1,
        axes: AXES.to_vec(),
        reads: Vec::new(),
        step_linear: LinuxCncConfig::STEP_LINEAR,
        step_rotary: LinuxCncConfig::step_rotary(),
    };
    let mut controller = LinuxCncController::new(&config)?;
    let _ = controller.read(Instant::now());
    let mut room = [0; 600];
    let (_, gateway) = bridge.recv_from(&mut room)?;
    let (near, far) = (UdpSocket::bind("127.0.0.1:0")?, UdpSocket::bind("127.0.0.1:0")?);
    near.connect(far.local_addr()?)?;
    far.connect(near.local_addr()?)?;
    let mut session = Session::new(5);
    let start = Instant::now();
    let [mut replies, mut echoes] = [const { Vec::new() }; 2];
    let mut next = Instant::now();
    for round in 0..rounds {
        next += EVERY;
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
        let mut words = [0; REPORT_WORDS];
        let length = barrier.scan(&[], false).encode(&mut words);
        let axis = |name| AxisState {
            name,
            step: 1,
            position: round as f64 * 0.01,
            velocity: 10.0,
            offset: 0,
        };
        let mut state = State::of(&AXES.map(axis)).ok_or("three axes")?;
        (state.machine, state.run) = (1, 9);
        state.sequence = u32::try_from(round)? + 1;
        (state.time, state.scan) = (start.elapsed(), EVERY);
        state.flags = Flags(Flags::ENABLED | Flags::HOMED);
        state.report = Words::new(&words[..length]).ok_or("few words")?;
        let mut bytes = [0; STATE_BYTES];
        let length = state.encode(&KEY, &mut bytes);

        bridge.send_to(&bytes[..length], gateway)?;
        let begun = Instant::now();
        let read = controller.read(begun + Duration::from_secs(1))?;
        let report = read.report.ok_or("a report")?;
        let report = Report::decode(1, settings.axes, report.as_slice()).ok_or("a report")?;
        session.read(report.head());
        let mut frame = [0; FRAME_WORDS];
        let values = PerChannel::leading([i16::try_from(round % 30_000)?; 3]);
        let frame_length = session.frame(&values).map(|made| made.encode(&settings, &mut frame));
        if let Some(frame) = frame_length.and_then(|length| Words::new(&frame[..length])) {
            controller.post(&frame, begun + Duration::from_secs(1))?;
        }
        replies.push(begun.elapsed());
        bridge.recv_from(&mut room)?;

        // Wait, so that the caches are as cold as for the echo.
        next += EVERY;
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
        near.send(&bytes[..length])?;
        let begun = Instant::now();
        let length = far.recv(&mut room)?;
        far.send(&room[..length])?;
        echoes.push(begun.elapsed());
        near.recv(&mut room)?;
    }
    for (name, mut times) in [("reply", replies), ("echo", echoes)] {
        times.sort_unstable();
        let at = |per_mille: usize| {
            times[(times.len() * per_mille / 1000).min(times.len() - 1)].as_nanos()
        };
        println!(
            "{name:6} {} datagrams, us: p50 {:.1}  p90 {:.1}  p99 {:.1}  p99.9 {:.1}",
            times.len(),
            at(500) as f64 / 1e3,
            at(900) as f64 / 1e3,
            at(990) as f64 / 1e3,
            at(999) as f64 / 1e3
        );
    }
    Ok(())
}
