//! Compares the duration of a cycle with the simulator on loopback to the duration of two exchanges of the same sizes
//! with an echo server. Both alternate in one run. Reports medians and 99th percentiles.

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    time::{Duration, Instant},
};

use volcomp_focas::{
    FocasConfig, FocasController,
    simulator::{Options, Simulator, World},
};
use volcomp_port::Controller;
use volcomp_vocabulary::{AxisName, PerChannel};

const CYCLES: usize = 20_000;
/// Number of measured cycles in a run without `cargo bench`, which only checks that the benchmark works.
const CYCLES_OF_A_TEST: usize = 200;
const WARM_UP: usize = 1000;
/// Bytes sent and received in each exchange of a cycle. The first reads positions, status, shifts, heartbeat and
/// referenced axes; the second writes shifts and heartbeat.
const EXCHANGES: [(usize, usize); 2] = [(152, 370), (75, 44)];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let is_measured = std::env::args().any(|argument| argument == "--bench");
    let count = if is_measured { CYCLES } else { CYCLES_OF_A_TEST };
    println!("us                    focas     echo    ratio   goal");
    for (cores, servers_on) in [("one core", 0), ("two cores", 1)] {
        // The threads are pinned, because a scheduler that moves the servers between cores would determine the ratio.
        pin_to(servers_on)?;
        let [cycles, bare] = measure(servers_on, count)?;
        for (what, place, goal) in [("median", count / 2, 1.5), ("p99", count / 100 * 99, 2.0)] {
            let [ours, theirs] = [&cycles, &bare].map(|all| all[place].as_secs_f64() * 1e6);
            let ratio = ours / theirs;
            println!("{cores:10} {what:6} {ours:8.1} {theirs:8.1} {ratio:8.2} <= {goal}");
        }
    }
    Ok(())
}

fn pin_to(core: usize) -> Result<(), rustix::io::Errno> {
    let mut set = rustix::thread::CpuSet::new();
    set.set(core);
    rustix::thread::sched_setaffinity(None, &set)
}

/// Measures `count` cycles and `count` exchanges with the echo; returns both lists of durations, sorted.
fn measure(
    servers_on: usize,
    count: usize,
) -> Result<[Vec<Duration>; 2], Box<dyn std::error::Error>> {
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = std::sync::Arc::new(|_| vec![1.0, 2.0, 3.0]);
    let simulator = Simulator::start("127.0.0.1:0", Options::default(), world)?;
    let mut echo = echo()?;
    let mut controller = FocasController::new(FocasConfig {
        port: simulator.address().port(),
        ..FocasConfig::new("127.0.0.1", &[AxisName::X, AxisName::Y, AxisName::Z])
    })?;
    controller.wait(Duration::from_secs(5))?;
    pin_to(0)?;
    let (mut cycles, mut bare) = (Vec::new(), Vec::new());
    let mut corrections = PerChannel::ZERO;
    for cycle in 0..WARM_UP + count {
        let begun = Instant::now();
        let deadline = begun + Duration::from_millis(100);
        controller.read(deadline)?;
        corrections[0] = f64::from(u8::try_from(cycle % 100)?) * 1e-3;
        controller.apply(&corrections, deadline)?;
        let took = begun.elapsed();
        let begun = Instant::now();
        exchange_twice(&mut echo)?;
        if cycle >= WARM_UP {
            cycles.push(took);
            bare.push(begun.elapsed());
        }
    }
    cycles.sort_unstable();
    bare.sort_unstable();
    pin_to(servers_on)?;
    Ok([cycles, bare])
}

/// Starts a thread that answers requests of the sizes in `EXCHANGES` with as many bytes as a control.
fn echo() -> std::io::Result<TcpStream> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let stream = TcpStream::connect(listener.local_addr()?)?;
    stream.set_nodelay(true)?;
    std::thread::spawn(move || -> std::io::Result<()> {
        let (mut stream, _) = listener.accept()?;
        stream.set_nodelay(true)?;
        let mut buffer = [0; 1024];
        loop {
            for (out, back) in EXCHANGES {
                stream.read_exact(&mut buffer[..out])?;
                stream.write_all(&buffer[..back])?;
            }
        }
    });
    Ok(stream)
}

fn exchange_twice(stream: &mut TcpStream) -> std::io::Result<()> {
    let mut buffer = [0; 1024];
    for (out, back) in EXCHANGES {
        stream.write_all(&buffer[..out])?;
        stream.read_exact(&mut buffer[..back])?;
    }
    Ok(())
}
