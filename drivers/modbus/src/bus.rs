//! The line to the modules: serial or TCP, one question at a time, drained after one that was not answered.

use std::{
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
use tokio_serial::{SerialPortBuilderExt, SerialStream};
use volcomp_port::{DeviceError, Fault};

/// How long a module may take for an answer where nothing else is asked for. This judges no age: a module that is slower does
/// not answer.
pub const ANSWER_WITHIN: Duration = Duration::from_millis(300);

/// Parity of a serial line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Parity {
    /// There is no parity bit.
    #[default]
    None,
    /// The parity bit makes the number of ones even.
    Even,
    /// The parity bit makes the number of ones odd.
    Odd,
}

/// How modules are reached.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Bus {
    /// The modules answer on Modbus TCP.
    Tcp {
        /// The host name or IP address of the module or its gateway.
        host: String,
        /// Port, 502 by convention.
        port: u16,
    },
    /// The modules answer on Modbus RTU, on a serial line.
    Rtu {
        /// The serial device, such as `/dev/ttyUSB0`.
        path: String,
        /// The speed of the line in baud.
        baud: u32,
        /// The parity of the line.
        parity: Parity,
        /// The number of stop bits, 1 or 2.
        stop_bits: u8,
    },
}

impl Bus {
    /// The device as messages name it.
    pub fn device(&self) -> String {
        match self {
            Self::Tcp { host, port } => format!("modbus://{host}:{port}"),
            Self::Rtu { path, .. } => format!("modbus-rtu://{path}"),
        }
    }

    /// Silence that ends a frame: 3.5 characters of 11 bits, at least 1.75 ms.
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
                        // When it is given up it is reset, not closed: what the kernel still holds of a request must
                        // not reach the module when the cable is in again.
                        stream.set_zero_linger()?;
                        Ok(stream)
                    })
                    .map_err(|e| {
                        let remedy = "check the address, the cable and the module's supply";
                        failed(format!("no connection: {e}"), remedy).caused_by(e)
                    })?;
                let context = tcp::attach_slave(stream, Slave(0));
                Ok(Line {
                    context,
                    serial: None,
                    gap: Duration::ZERO,
                })
            }
            Self::Rtu {
                path,
                baud,
                parity,
                stop_bits,
            } => {
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
                let shared = Shared(Arc::new(Mutex::new(stream)));
                let context = rtu::attach_slave(shared.clone(), Slave(0));
                Ok(Line {
                    context,
                    serial: Some(shared),
                    gap: self.frame_gap(),
                })
            }
        }
    }
}

/// The error of a driver whose own thread cannot be started.
pub(crate) fn no_thread(device: &str, error: io::Error) -> DeviceError {
    let found = format!("no thread for its exchanges: {error}");
    let remedy = "check the limits on threads and memory of this process";
    DeviceError::open(device, found, remedy).caused_by(error)
}

/// Why a question was not answered with data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unanswered {
    /// No answer in time. The line was drained: a late answer is gone.
    Silent,
    /// The module refused the request with an exception of this code; 0: it answered another request.
    Refused(u8),
    /// The line is broken.
    Broken,
}

impl Unanswered {
    /// The fault of a write that was answered so.
    pub(crate) fn fault(self) -> Fault {
        match self {
            Self::Silent => Fault::TimedOut,
            Self::Refused(code) => Fault::Refused {
                code: code.into(),
                what: "outputs of a module",
            },
            Self::Broken => Fault::Disconnected,
        }
    }
}

/// An open line to the modules, by TCP or serial.
pub(crate) struct Line {
    context: Context,
    serial: Option<Shared>,
    gap: Duration,
}

impl Line {
    /// How long to wait for the answer to a write. Over TCP no longer than until its deadline: then the connection is reset, so
    /// that nothing of the write is left in a queue of the kernel. What was given to a serial line is on the wire, and cannot
    /// be called back.
    pub(crate) fn patience(&self, at_most: Duration, deadline: Instant) -> Duration {
        if self.serial.is_some() {
            return at_most;
        }
        at_most.min(deadline.saturating_duration_since(Instant::now()))
    }

    /// Sends a request to the module with this address and waits `at_most` for its answer.
    pub(crate) async fn ask(
        &mut self,
        unit: u8,
        request: Request<'_>,
        at_most: Duration,
    ) -> Result<Response, Unanswered> {
        if self.serial.is_some() {
            // The line must have been silent before a new frame.
            tokio::time::sleep(self.gap).await;
        }
        self.context.set_slave(Slave(unit));
        match timeout(at_most, self.context.call(request)).await {
            Ok(Ok(Ok(response))) => Ok(response),
            Ok(Ok(Err(exception))) => Err(Unanswered::Refused(exception.into())),
            Ok(Err(_)) => {
                // On a serial line a disturbed frame; on TCP a connection that is gone.
                self.drain(at_most).await?;
                Err(Unanswered::Silent)
            }
            Err(_) => {
                self.drain(at_most).await?;
                Err(Unanswered::Silent)
            }
        }
    }

    /// Waits until the line has been silent for the time an answer may take, and forgets what came.
    async fn drain(&mut self, at_most: Duration) -> Result<(), Unanswered> {
        let Some(serial) = &mut self.serial else {
            // TCP numbers its answers, but a connection that does not answer is made anew.
            return Err(Unanswered::Broken);
        };
        let silence = at_most.max(self.gap);
        let mut rest = [0; 256];
        loop {
            match timeout(silence, serial.read(&mut rest)).await {
                Err(_) => break,
                Ok(Ok(0) | Err(_)) => return Err(Unanswered::Broken),
                Ok(Ok(_)) => {}
            }
        }
        // Half a frame may stand in the old one's buffer.
        self.context = rtu::attach_slave(serial.clone(), Slave(0));
        Ok(())
    }
}

/// A serial port that is used by a context and drained beside it.
#[derive(Clone)]
struct Shared(Arc<Mutex<SerialStream>>);

impl Shared {
    fn port(&self) -> MutexGuard<'_, SerialStream> {
        // One thread drives the line, so nobody waits here.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("serial port")
    }
}

impl AsyncRead for Shared {
    fn poll_read(
        self: Pin<&mut Self>,
        task: &mut Task<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut *self.port()).poll_read(task, buffer)
    }
}

impl AsyncWrite for Shared {
    fn poll_write(
        self: Pin<&mut Self>,
        task: &mut Task<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut *self.port()).poll_write(task, bytes)
    }

    fn poll_flush(self: Pin<&mut Self>, task: &mut Task<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut *self.port()).poll_flush(task)
    }

    fn poll_shutdown(self: Pin<&mut Self>, task: &mut Task<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut *self.port()).poll_shutdown(task)
    }
}
