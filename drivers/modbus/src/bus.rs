//! The serial or TCP line to the modules. It carries one request at a time, and is drained after a timeout.

use std::{
    collections::VecDeque,
    io,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context as Task, Poll},
    time::{Duration, Instant},
};

use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, ReadBuf},
    net::TcpStream,
    time::timeout,
};
use tokio_modbus::{
    client::{Context, rtu, tcp},
    prelude::{Client, Request, Response, Slave, SlaveContext},
};
use tokio_serial::{ClearBuffer, SerialPort as _, SerialPortBuilderExt, SerialStream};
use volcomp_port::{DeviceError, Fault, Reason, exception_name};

/// Default response timeout of a module. A slower module counts as not answering. This timeout does not limit the age
/// of data.
pub const ANSWER_WITHIN: Duration = Duration::from_millis(300);

/// Parity of a serial line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Parity {
    #[default]
    None,
    Even,
    Odd,
}

#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Bus {
    Tcp {
        /// Host name or IP address of the module, or of a gateway to its line.
        host: String,
        /// TCP port, 502 by convention.
        port: u16,
    },
    /// Modbus RTU on a serial line.
    Rtu {
        /// Serial device, such as `/dev/ttyUSB0`.
        path: String,
        /// Speed of the line, baud.
        baud: u32,
        parity: Parity,
        /// Number of stop bits, 1 or 2.
        stop_bits: u8,
    },
}

impl Bus {
    /// Name of the device in messages.
    pub fn device(&self) -> String {
        match self {
            Self::Tcp { host, port } => format!("modbus://{host}:{port}"),
            Self::Rtu { path, .. } => format!("modbus-rtu://{path}"),
        }
    }

    /// Silence that ends a frame: the time of 3.5 characters of 11 bits, but at least 1.75 ms. Zero on TCP.
    pub(crate) fn frame_gap(&self) -> Duration {
        match self {
            Self::Tcp { .. } => Duration::ZERO,
            Self::Rtu { baud, .. } => {
                let seconds = 3.5 * 11.0 / f64::from((*baud).max(1));
                Duration::from_secs_f64(seconds).max(Duration::from_micros(1750))
            }
        }
    }

    pub(crate) async fn connect(&self, at_most: Duration) -> Result<Line, DeviceError> {
        let failed = |what: String, remedy: &str| DeviceError::open(self.device(), what, remedy);
        match self {
            Self::Tcp { host, port } => {
                let connecting = TcpStream::connect((host.as_str(), *port));
                let stream = timeout(at_most, connecting)
                    .await
                    .unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
                    .and_then(|stream| {
                        stream.set_nodelay(true)?;
                        // Closing resets the socket, so that a request that is still in the kernel cannot reach the
                        // module when the cable is plugged in again.
                        stream.set_zero_linger()?;
                        Ok(stream)
                    })
                    .map_err(|e| {
                        let remedy = "check the address, the cable and the module's supply";
                        failed(format!("no connection: {e}"), remedy).caused_by(e)
                    })?;
                let context = tcp::attach_slave(stream, Slave(0));
                Ok(Line { context, serial: None, gap: Duration::ZERO })
            }
            Self::Rtu { path, baud, parity, stop_bits } => {
                let mut builder = tokio_serial::new(path, *baud).parity(match parity {
                    Parity::None => tokio_serial::Parity::None,
                    Parity::Even => tokio_serial::Parity::Even,
                    Parity::Odd => tokio_serial::Parity::Odd,
                });
                if *stop_bits == 2 {
                    builder = builder.stop_bits(tokio_serial::StopBits::Two);
                }
                let stream = builder.open_native_async().map_err(|e| {
                    let remedy = "check its name (volcomp probe lists the ports) and that this user is in the group dialout";
                    failed(format!("the port cannot be opened: {e}"), remedy).caused_by(e)
                })?;
                let shared = SharedPort(Arc::new(Mutex::new(Port::new(stream))));
                let context = rtu::attach_slave(shared.clone(), Slave(0));
                Ok(Line { context, serial: Some(shared), gap: self.frame_gap() })
            }
        }
    }
}

pub(crate) fn thread_error(device: &str, error: io::Error) -> DeviceError {
    let found = format!("no thread for its exchanges: {error}");
    let remedy = "check the limits on threads and memory of this process";
    DeviceError::open(device, found, remedy).caused_by(error)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RequestError {
    /// No answer in time. The line was drained, so that a late answer is discarded.
    NoAnswer,
    /// The request was echoed, but no answer arrived in time: the module behind an adapter with local echo does not
    /// answer.
    EchoOnly,
    /// The module rejected the request with this exception code. 0 means that the answer was to another request.
    Refused(u8),
    Disconnected,
}

impl RequestError {
    pub(crate) fn reason(self) -> Reason {
        match self {
            Self::NoAnswer | Self::Disconnected | Self::Refused(0) => Reason::NoAnswer,
            Self::EchoOnly => Reason::Echo,
            Self::Refused(code) => Reason::Refused { code },
        }
    }

    pub(crate) fn fault(self) -> Fault {
        match self {
            Self::NoAnswer | Self::EchoOnly => Fault::TimedOut,
            Self::Refused(0) => Fault::Protocol("an answer to another request"),
            Self::Refused(code) => Fault::Refused { code: code.into(), what: exception_name(code) },
            Self::Disconnected => Fault::Disconnected,
        }
    }
}

/// Maximum duration of draining a serial line that is never silent, as a multiple of the response timeout.
const MAX_DRAINS: u32 = 10;

/// Required content of the response to a request. The decoder of the protocol does not check it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Expected {
    /// This number of coils or inputs, in whole bytes.
    Bits(u16),
    Registers(u16),
    /// The address and number of the written coils.
    Written(u16, usize),
    Anything,
}

impl Expected {
    fn of(request: &Request<'_>) -> Self {
        match request {
            Request::ReadCoils(_, count) | Request::ReadDiscreteInputs(_, count) => {
                Self::Bits(*count)
            }
            Request::ReadHoldingRegisters(_, count) | Request::ReadInputRegisters(_, count) => {
                Self::Registers(*count)
            }
            Request::WriteMultipleCoils(address, coils) => Self::Written(*address, coils.len()),
            _ => Self::Anything,
        }
    }

    fn is_met_by(self, response: &Response) -> bool {
        match (self, response) {
            (
                Self::Bits(count),
                Response::ReadCoils(found) | Response::ReadDiscreteInputs(found),
            ) => found.len() == usize::from(count).next_multiple_of(8),
            (
                Self::Registers(count),
                Response::ReadHoldingRegisters(found) | Response::ReadInputRegisters(found),
            ) => found.len() == usize::from(count),
            (Self::Written(address, count), Response::WriteMultipleCoils(at, found)) => {
                (*at, usize::from(*found)) == (address, count)
            }
            (Self::Anything, _) => true,
            _ => false,
        }
    }
}

pub(crate) struct Line {
    context: Context,
    serial: Option<SharedPort>,
    gap: Duration,
}

impl Line {
    /// Timeout for the response to a write. Over TCP the deadline limits the timeout: at the deadline the connection is
    /// reset, so that no part of the write stays in a kernel queue. A serial line transmits a request at once, so its
    /// writes cannot be cancelled.
    pub(crate) fn write_timeout(&self, at_most: Duration, deadline: Instant) -> Duration {
        if self.serial.is_some() {
            return at_most;
        }
        at_most.min(deadline.saturating_duration_since(Instant::now()))
    }

    /// Sends a request to the module with the address `unit`, and waits up to `at_most` for its answer. After a timeout
    /// the line is drained.
    pub(crate) async fn request(
        &mut self,
        unit: u8,
        request: Request<'_>,
        at_most: Duration,
    ) -> Result<Response, RequestError> {
        if self.serial.is_some() {
            // The line must be silent before a new frame.
            tokio::time::sleep(self.gap).await;
        }
        if let Some(serial) = &self.serial {
            serial.port().begin_request();
        }
        self.context.set_slave(Slave(unit));
        let expected = Expected::of(&request);
        match timeout(at_most, self.context.call(request)).await {
            Ok(Ok(Ok(response))) if expected.is_met_by(&response) => Ok(response),
            Ok(Ok(Err(exception))) => Err(RequestError::Refused(exception.into())),
            // The expected answer may still arrive after a timeout or an answer to another request, and after a
            // corrupted frame on a serial line. A lost TCP connection also ends here.
            Ok(Ok(Ok(_)) | Err(_)) | Err(_) => {
                let echoed = (self.serial.as_ref()).is_some_and(|serial| serial.port().echoed);
                self.drain(at_most).await?;
                Err(if echoed { RequestError::EchoOnly } else { RequestError::NoAnswer })
            }
        }
    }

    /// Waits until a serial line has been silent for the response timeout, at most [`MAX_DRAINS`] times as long, and
    /// discards the received bytes. A TCP connection is not drained but reported as disconnected.
    async fn drain(&mut self, at_most: Duration) -> Result<(), RequestError> {
        let Some(serial) = &mut self.serial else {
            // TCP answers carry transaction numbers, so draining is unnecessary. The connection is reopened.
            return Err(RequestError::Disconnected);
        };
        let silence = at_most.max(self.gap);
        let end = Instant::now() + silence * MAX_DRAINS;
        let mut rest = [0; 256];
        while Instant::now() < end {
            match timeout(silence, serial.read(&mut rest)).await {
                Err(_) => break,
                Ok(Ok(0) | Err(_)) => return Err(RequestError::Disconnected),
                Ok(Ok(_)) => {}
            }
        }
        // The buffer of the old context may contain half a frame.
        self.context = rtu::attach_slave(serial.clone(), Slave(0));
        Ok(())
    }
}

/// A serial port that removes echoes from the received data. Adapters with local echo return every request before the
/// response. No answer to a request of this crate begins with the whole request.
///
/// Invariant: `sent` is the part of the request that may still be echoed, and `matched` is the number of its bytes that
/// have come back. The first byte that differs proves that there is no echo. Then the matched bytes are moved to
/// `received`, which is read first.
struct Port {
    stream: SerialStream,
    sent: Vec<u8>,
    matched: usize,
    /// Whether the whole request has been echoed.
    echoed: bool,
    received: VecDeque<u8>,
}

impl Port {
    fn new(stream: SerialStream) -> Self {
        Self { stream, sent: Vec::new(), matched: 0, echoed: false, received: VecDeque::new() }
    }

    /// Discards received data, also in the kernel, because they belong to an earlier request.
    fn begin_request(&mut self) {
        // A port that is gone fails at the request itself.
        let _ = self.stream.clear(ClearBuffer::Input);
        self.sent.clear();
        self.received.clear();
        self.matched = 0;
        self.echoed = false;
    }

    fn take(&mut self, bytes: &[u8]) {
        for byte in bytes {
            if self.matched < self.sent.len() {
                if *byte == self.sent[self.matched] {
                    self.matched += 1;
                    self.echoed = self.matched == self.sent.len();
                    continue;
                }
                self.received.extend(&self.sent[..self.matched]);
                self.sent.clear();
                self.matched = 0;
            }
            self.received.push_back(*byte);
        }
    }
}

#[derive(Clone)]
struct SharedPort(Arc<Mutex<Port>>);

impl SharedPort {
    fn port(&self) -> MutexGuard<'_, Port> {
        // Only one thread uses the line, so the lock is never contended.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl std::fmt::Debug for SharedPort {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("serial port")
    }
}

impl AsyncRead for SharedPort {
    fn poll_read(
        self: Pin<&mut Self>,
        task: &mut Task<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let mut port = self.port();
        while port.received.is_empty() {
            let mut bytes = [0; 256];
            let mut into = ReadBuf::new(&mut bytes);
            match Pin::new(&mut port.stream).poll_read(task, &mut into) {
                Poll::Ready(Ok(())) if !into.filled().is_empty() => port.take(into.filled()),
                other => return other,
            }
        }
        let count = buffer.remaining().min(port.received.len());
        for byte in port.received.drain(..count) {
            buffer.put_slice(&[byte]);
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for SharedPort {
    fn poll_write(
        self: Pin<&mut Self>,
        task: &mut Task<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let mut port = self.port();
        let written = Pin::new(&mut port.stream).poll_write(task, bytes);
        if let Poll::Ready(Ok(count)) = written {
            port.sent.extend_from_slice(&bytes[..count]);
        }
        written
    }

    fn poll_flush(self: Pin<&mut Self>, task: &mut Task<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port().stream).poll_flush(task)
    }

    fn poll_shutdown(self: Pin<&mut Self>, task: &mut Task<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.port().stream).poll_shutdown(task)
    }
}
