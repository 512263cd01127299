//! An open session, which sends a request and receives its response before a deadline.

use std::{
    io::{Error, ErrorKind, Read, Write},
    net::{TcpStream, ToSocketAddrs},
    time::{Duration, Instant},
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
    net::{connect_unspec, sockopt::set_socket_linger},
};
use volcomp_port::Fault;

use crate::{
    error::{FocasError, ReturnCode},
    frame::{Blocks, HEAD, Head, Kind, Request, close_frame, open_frame},
};

const MAX_RESPONSE_BYTES: usize = 65_536;

/// An open session. A fault makes the session dead, because a delayed response could be taken for the next one.
/// Exceptions are a rejection, and a deadline that had expired before anything was sent.
///
/// A dead session is aborted at once, within the cycle: the connection is reset, and undelivered data in the kernel are
/// discarded. Otherwise a request written before a cable was unplugged would reach the control when the cable is
/// plugged in again, and would shift an axis by an outdated correction. The connection is also reset if the process
/// ends before it has closed the session.
#[derive(Debug)]
pub struct Session {
    stream: TcpStream,
    answer: Box<[u8]>,
    dead: bool,
    version: u16,
}

impl Session {
    /// Connects to `host`:`port` and opens a session.
    ///
    /// # Errors
    /// An unknown host, no session within `at_most`, a rejected session.
    pub fn open(host: &str, port: u16, at_most: Duration) -> Result<Self, FocasError> {
        let deadline = Instant::now() + at_most;
        let addresses = (host, port)
            .to_socket_addrs()
            .map_err(|source| FocasError::Resolve { host: host.to_owned(), source })?;
        let mut last = FocasError::NoAddress(host.to_owned());
        for address in addresses {
            let left = deadline.saturating_duration_since(Instant::now());
            match TcpStream::connect_timeout(&address, left.max(Duration::from_millis(1))) {
                Ok(stream) => return Self::on(stream, deadline),
                Err(source) => last = FocasError::Connect { address, source },
            }
        }
        Err(last)
    }

    fn on(stream: TcpStream, deadline: Instant) -> Result<Self, FocasError> {
        let lost = |_| FocasError::NoSession(Fault::Disconnected);
        stream.set_nodelay(true).map_err(lost)?;
        stream.set_nonblocking(true).map_err(lost)?;
        // The kernel discards undelivered data when the socket is closed, also when the process ends.
        let set = set_socket_linger(&stream, Some(Duration::ZERO));
        set.map_err(|e| lost(e.into()))?;
        let mut session = Self {
            stream,
            answer: vec![0; MAX_RESPONSE_BYTES].into_boxed_slice(),
            dead: true,
            version: 0,
        };
        session.limit_unacknowledged(deadline.saturating_duration_since(Instant::now()));
        let head = session
            .send(&open_frame(), deadline)
            .and_then(|()| session.receive(deadline))
            .map_err(FocasError::NoSession)?;
        session.version = head.version;
        match head.kind {
            Kind::Opened => {
                session.dead = false;
                Ok(session)
            }
            Kind::Refused => Err(FocasError::SessionRefused),
            _ => {
                let wrong = Fault::Protocol("another answer than to the opening of a session");
                Err(FocasError::NoSession(wrong))
            }
        }
    }

    /// Makes the kernel drop the connection if sent data stay unacknowledged for this time, even while this program is
    /// stopped. If the kernel does not support this, only the deadlines apply.
    pub(crate) fn limit_unacknowledged(&self, time: Duration) {
        #[cfg(target_os = "linux")]
        {
            let ms = u32::try_from(time.as_millis()).unwrap_or(u32::MAX).max(1);
            let _ = rustix::net::sockopt::set_tcp_user_timeout(&self.stream, ms);
        }
        #[cfg(not(target_os = "linux"))]
        let _ = time;
    }

    /// Ends the session without a closing frame. The connection is reset, and undelivered data are discarded. Does not
    /// allocate or block.
    pub(crate) fn abort(&mut self) {
        self.dead = true;
        // If the call fails, the connection is already closed, or will be reset when the socket is closed.
        let _ = connect_unspec(&self.stream);
    }

    /// Protocol version of the control's responses: 2, 3 or 4, depending on the generation of the control.
    pub fn version(&self) -> u16 {
        self.version
    }

    /// Whether the session has failed, so that another session must be opened.
    pub fn is_dead(&self) -> bool {
        self.dead
    }

    /// Sends a request and waits for its response, without allocating. If the deadline has passed, sends nothing.
    ///
    /// # Errors
    /// The session stays usable after [`Fault::TimedOut`] if nothing was sent, and after [`Fault::Refused`], by which
    /// the control rejects the whole request. After every other fault the session is dead, also after a response that
    /// arrives after the deadline.
    pub fn exchange(&mut self, request: &Request, deadline: Instant) -> Result<Blocks<'_>, Fault> {
        if self.dead {
            return Err(Fault::NotConnected);
        }
        if Instant::now() >= deadline {
            // Nothing was sent, so the session stays usable.
            return Err(Fault::TimedOut);
        }
        // The session is dead unless the whole exchange succeeds.
        self.dead = true;
        let received = self.send(request.bytes(), deadline).and_then(|()| self.receive(deadline));
        let in_time = received.and_then(|head| {
            let is_late = Instant::now() >= deadline;
            if is_late { Err(Fault::TimedOut) } else { Ok(head) }
        });
        let head = match in_time {
            Ok(head) => head,
            Err(fault) => {
                self.abort();
                return Err(fault);
            }
        };
        let payload = &self.answer[..head.length];
        match head.kind {
            Kind::Answer => {
                let blocks = request.answers(payload)?;
                self.dead = false;
                Ok(blocks)
            }
            Kind::Negative => {
                self.dead = false;
                let code = payload.get(2..4).map_or(0, |c| i16::from_be_bytes([c[0], c[1]]));
                Err(ReturnCode(code).into())
            }
            _ => Err(Fault::Protocol("an answer of another kind")),
        }
    }

    fn send(&mut self, mut bytes: &[u8], deadline: Instant) -> Result<(), Fault> {
        while !bytes.is_empty() {
            // Check again immediately before sending, because this thread may have been suspended since the caller's
            // check.
            if Instant::now() >= deadline {
                return Err(Fault::TimedOut);
            }
            match self.stream.write(bytes) {
                Ok(count) => bytes = bytes.get(count..).unwrap_or_default(),
                Err(e) => self.wait_for(&e, PollFlags::OUT, deadline)?,
            }
        }
        Ok(())
    }

    /// Waits until the socket is ready, with microsecond resolution. Socket timeouts would have the resolution of the
    /// kernel's ticks.
    fn wait_for(&self, error: &Error, what: PollFlags, deadline: Instant) -> Result<(), Fault> {
        match error.kind() {
            ErrorKind::Interrupted => return Ok(()),
            ErrorKind::WouldBlock => {}
            _ => return Err(Fault::Disconnected),
        }
        let left = deadline.saturating_duration_since(Instant::now());
        let left = Timespec::try_from(left).map_err(|_| Fault::TimedOut)?;
        match poll(&mut [PollFd::new(&self.stream, what)], Some(&left)) {
            Ok(0) => Err(Fault::TimedOut),
            Ok(_) | Err(Errno::INTR) => Ok(()),
            Err(_) => Err(Fault::Disconnected),
        }
    }

    fn receive(&mut self, deadline: Instant) -> Result<Head, Fault> {
        let mut have = 0;
        let mut head: Option<Head> = None;
        loop {
            let needed = HEAD + head.map_or(0, |head| head.length);
            if have >= needed {
                match head {
                    None => {
                        // The bytes are present, because `have` is at least `needed`.
                        let bytes = self.answer.first_chunk().unwrap_or(&[0; HEAD]);
                        head = Some(Head::parse(bytes)?);
                        continue;
                    }
                    Some(_) if have > needed => {
                        return Err(Fault::Protocol("more than one answer"));
                    }
                    Some(head) => {
                        self.answer.copy_within(HEAD..needed, 0);
                        return Ok(head);
                    }
                }
            }
            // A single read returns the whole response if it arrived in one piece.
            match self.stream.read(&mut self.answer[have..]) {
                Ok(0) => return Err(Fault::Disconnected),
                Ok(count) => have += count,
                Err(e) => self.wait_for(&e, PollFlags::IN, deadline)?,
            }
        }
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if self.dead {
            return self.abort();
        }
        // All requests have been answered, so only the closing frame can still be delivered. An error has no
        // consequence, because the peer may have closed the connection.
        let _ = set_socket_linger(&self.stream, None);
        let _ = self.stream.write(&close_frame());
    }
}
