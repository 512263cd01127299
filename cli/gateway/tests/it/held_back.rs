//! A wire between gateway and control that can keep what is on its way, and deliver it later, when the gateway has long
//! given that connection up.

use std::{
    io::{Read, Write},
    net::{Shutdown, SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::Duration,
};

/// A wire; new connections are refused when it is dropped.
pub(crate) struct Wire {
    pub(crate) address: SocketAddr,
    made: Arc<AtomicUsize>,
    /// The connections before this one are kept back.
    kept: Arc<AtomicUsize>,
    done: Arc<AtomicBool>,
}

impl Wire {
    /// A wire to a control.
    pub(crate) fn to(control: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
        let wire = Self {
            address: listener.local_addr().expect("bound"),
            made: Arc::default(),
            kept: Arc::default(),
            done: Arc::default(),
        };
        let (made, kept) = (Arc::clone(&wire.made), Arc::clone(&wire.kept));
        let done = Arc::clone(&wire.done);
        std::thread::spawn(move || {
            for near in listener.incoming() {
                if done.load(Ordering::Relaxed) {
                    return;
                }
                let (Ok(near), Ok(far)) = (near, TcpStream::connect(control)) else {
                    continue;
                };
                let number = made.fetch_add(1, Ordering::Relaxed);
                let ends = near.try_clone().and_then(|n| Ok((n, far.try_clone()?)));
                let Ok((near_back, far_back)) = ends else {
                    continue;
                };
                let kept = Arc::clone(&kept);
                std::thread::spawn(move || {
                    pass(near, far, || number < kept.load(Ordering::Relaxed));
                });
                std::thread::spawn(move || pass(far_back, near_back, || false));
            }
        });
        wire
    }

    /// What comes to the control on all connections that are open now is kept until [`deliver`](Self::deliver).
    pub(crate) fn keep(&self) {
        let made = self.made.load(Ordering::Relaxed);
        self.kept.store(made, Ordering::Relaxed);
    }

    /// What was kept goes on to the control.
    pub(crate) fn deliver(&self) {
        self.kept.store(0, Ordering::Relaxed);
    }

    /// How many connections were made.
    pub(crate) fn connections(&self) -> usize {
        self.made.load(Ordering::Relaxed)
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.done.store(true, Ordering::Relaxed);
        // Wakes who waits for a connection.
        let _ = TcpStream::connect(self.address);
    }
}

/// Passes bytes on until one end is gone; what was taken is delivered also when its sender is gone.
fn pass(mut from: TcpStream, mut to: TcpStream, waits: impl Fn() -> bool) {
    let _ = to.set_nodelay(true);
    let mut bytes = [0; 4096];
    while let Ok(count) = from.read(&mut bytes) {
        while waits() {
            std::thread::sleep(Duration::from_millis(1));
        }
        if count == 0 || to.write_all(&bytes[..count]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Write);
}
