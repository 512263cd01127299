//! One open session: a request out, its answer in, before a deadline.

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
    error::FocasError,
    frame::{Blocks, HEAD, Head, Kind, Request, close_frame, open_frame},
    return_code::ReturnCode,
};

/// The length of the longest answer that there can be, bytes.
const LONGEST: usize = 65_536;

/// An open session. After a fault other than a refusal it is dead: what is still on its way would be taken
/// for the next answer.
///
/// A dead session is aborted at once, in the cycle: the connection is reset, and what the kernel has not delivered yet is
/// thrown away. Otherwise a request that was written before a cable was pulled would reach the control when the cable is
/// back, and shift an axis by a correction that is long out of date. The same happens when the process ends in any way
/// before it has closed the session itself.
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
    /// No such host, no answer within `at_most`, a refused session.
    pub fn open(host: &str, port: u16, at_most: Duration) -> Result<Self, FocasError> {
        let deadline = Instant::now() + at_most;
        let addresses = (host, port)
            .to_socket_addrs()
            .map_err(|source| FocasError::Resolve {
                host: host.to_owned(),
                source,
            })?;
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

    /// Opens a session on a connection.
    fn on(stream: TcpStream, deadline: Instant) -> Result<Self, FocasError> {
        let lost = |_| FocasError::NoSession(Fault::Disconnected);
        stream.set_nodelay(true).map_err(lost)?;
        stream.set_nonblocking(true).map_err(lost)?;
        // However the socket is closed, even by the end of the process: nothing is delivered afterwards.
        let set = set_socket_linger(&stream, Some(Duration::ZERO));
        set.map_err(|e| lost(e.into()))?;
        let mut session = Self {
            stream,
            answer: vec![0; LONGEST].into_boxed_slice(),
            dead: true,
            version: 0,
        };
        session.bound_unacknowledged(deadline.saturating_duration_since(Instant::now()));
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

    /// Lets the kernel give the connection up when something that was sent stays unacknowledged for this time, whether
    /// this program runs or is stopped. Where the kernel cannot do it, the deadlines remain.
    pub(crate) fn bound_unacknowledged(&self, time: Duration) {
        #[cfg(target_os = "linux")]
        {
            let ms = u32::try_from(time.as_millis()).unwrap_or(u32::MAX).max(1);
            let _ = rustix::net::sockopt::set_tcp_user_timeout(&self.stream, ms);
        }
        #[cfg(not(target_os = "linux"))]
        let _ = time;
    }

    /// Ends the session without a word: the connection is reset, and nothing that was not delivered will be. No
    /// allocation and no wait.
    pub(crate) fn abort(&mut self) {
        self.dead = true;
        // Where this fails the connection is gone already, or is reset when the socket is closed.
        let _ = connect_unspec(&self.stream);
    }

    /// The version that the control answers with: 2, 3 or 4 by its generation.
    pub fn version(&self) -> u16 {
        self.version
    }

    /// Whether the session must be opened anew.
    pub fn is_dead(&self) -> bool {
        self.dead
    }

    /// Sends a request and waits for its answers. No allocation. A request whose deadline has passed is not sent.
    ///
    /// # Errors
    /// [`Fault::TimedOut`] before anything was sent, and [`Fault::Refused`] when the controller refuses the request as
    /// a whole: the session lives on. After every other fault it is dead; an answer that came after the deadline is
    /// such a fault, too.
    pub fn exchange(&mut self, request: &Request, deadline: Instant) -> Result<Blocks<'_>, Fault> {
        if self.dead {
            return Err(Fault::NotConnected);
        }
        if Instant::now() >= deadline {
            // Nothing is on its way yet.
            return Err(Fault::TimedOut);
        }
        // Dead unless everything goes well.
        self.dead = true;
        let received = self
            .send(request.bytes(), deadline)
            .and_then(|()| self.receive(deadline));
        let in_time = received.and_then(|head| {
            let is_late = Instant::now() >= deadline;
            if is_late {
                Err(Fault::TimedOut)
            } else {
                Ok(head)
            }
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
                let code = payload
                    .get(2..4)
                    .map_or(0, |c| i16::from_be_bytes([c[0], c[1]]));
                Err(ReturnCode(code).into())
            }
            _ => Err(Fault::Protocol("an answer of another kind")),
        }
    }

    fn send(&mut self, mut bytes: &[u8], deadline: Instant) -> Result<(), Fault> {
        while !bytes.is_empty() {
            // Right before the bytes go out: this thread may have stood since the caller looked.
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

    /// Waits where the socket is not ready, to the microsecond: time-outs of a socket are as coarse as the
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

    /// Reads one frame whole into `answer`.
    fn receive(&mut self, deadline: Instant) -> Result<Head, Fault> {
        let mut have = 0;
        let mut head: Option<Head> = None;
        loop {
            let wanted = HEAD + head.map_or(0, |head| head.length);
            if have >= wanted {
                match head {
                    None => {
                        // `have` says that they are there.
                        let bytes = self.answer.first_chunk().unwrap_or(&[0; HEAD]);
                        head = Some(Head::parse(bytes)?);
                        continue;
                    }
                    Some(_) if have > wanted => {
                        return Err(Fault::Protocol("more than one answer"));
                    }
                    Some(head) => {
                        self.answer.copy_within(HEAD..wanted, 0);
                        return Ok(head);
                    }
                }
            }
            // One read for the whole answer where it comes in one piece.
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
        // Everything that was sent has been answered, so only the closing frame can still be delivered. The other side
        // may be gone; there is nothing to be done about it.
        let _ = set_socket_linger(&self.stream, None);
        let _ = self.stream.write(&close_frame());
    }
}
