//! A simulated control that answers S7 and NCK requests, for tests: it shares the codec with the client, so that its
//! frames must be compared with published ones elsewhere.

use std::{
    collections::BTreeMap,
    io::{self, Read as _, Write as _},
    net::{SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use super::{
    codec::{Cotp, Message, confirm_frame, frame_length, frame_of, parse_frame},
    error::{ReturnCode, S7Error},
    item::Item,
};

/// What a simulated control holds, and what it does wrong.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    /// The bytes of data blocks by their numbers.
    pub blocks: BTreeMap<u16, Vec<u8>>,
    /// The bytes of a line of NCK variables, by area and unit (as on the wire), module, column and line.
    pub nck: BTreeMap<(u8, u8, u16, u16), Vec<u8>>,
    /// How long an answer waits.
    pub latency: Duration,
    /// Answers come in pieces of so many bytes; 0: whole.
    pub fragment: usize,
    /// Answers carry the number of another request.
    pub wrong_reference: bool,
    /// Every request is refused as a whole.
    pub refuses: bool,
}

/// A running simulated control; it ends when it is dropped.
pub struct Simulator {
    address: SocketAddr,
    memory: Arc<Mutex<Memory>>,
    ends: Arc<AtomicBool>,
}

impl Simulator {
    /// Listens on an address, port 0 for a free one.
    ///
    /// # Errors
    /// The address is taken or none.
    pub fn start(listen: &str, memory: Memory) -> io::Result<Self> {
        let listener = TcpListener::bind(listen)?;
        let address = listener.local_addr()?;
        let memory = Arc::new(Mutex::new(memory));
        let ends = Arc::new(AtomicBool::new(false));
        let (shared, ending) = (Arc::clone(&memory), Arc::clone(&ends));
        thread::Builder::new()
            .name("s7-sim".to_owned())
            .spawn(move || {
                for stream in listener.incoming() {
                    if ending.load(Ordering::Relaxed) {
                        return;
                    }
                    let (memory, ends) = (Arc::clone(&shared), Arc::clone(&ending));
                    if let Ok(stream) = stream {
                        // Without a thread this one is not served; whoever connected sees no answer.
                        let _ = thread::Builder::new().spawn(move || serve(stream, &memory, &ends));
                    }
                }
            })?;
        Ok(Self {
            address,
            memory,
            ends,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What it holds, to be looked at or changed.
    pub fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        // Wakes the thread that accepts.
        let _ = TcpStream::connect_timeout(&self.address, Duration::from_millis(100));
    }
}

/// Serves one connection until it ends, or says something wrong.
fn serve(mut stream: TcpStream, memory: &Mutex<Memory>, ends: &AtomicBool) {
    // A connection without a deadline would keep its thread for ever.
    if stream
        .set_read_timeout(Some(Duration::from_secs(30)))
        .is_err()
    {
        return;
    }
    while !ends.load(Ordering::Relaxed) {
        let Ok(answer) = next(&mut stream, memory) else {
            return;
        };
        let (latency, fragment) = {
            let memory = memory.lock().unwrap_or_else(PoisonError::into_inner);
            (memory.latency, memory.fragment)
        };
        thread::sleep(latency);
        let size = if fragment == 0 {
            answer.len()
        } else {
            fragment
        };
        for piece in answer.chunks(size.max(1)) {
            if stream
                .write_all(piece)
                .and_then(|()| stream.flush())
                .is_err()
            {
                return;
            }
        }
    }
}

fn next(stream: &mut TcpStream, memory: &Mutex<Memory>) -> Result<Vec<u8>, S7Error> {
    let io = |source| S7Error::Io {
        what: "receiving",
        source,
    };
    let mut frame = vec![0; 4];
    stream.read_exact(&mut frame).map_err(io)?;
    let head = frame.first_chunk().ok_or(S7Error::Short("a frame"))?;
    let length = frame_length(*head)?;
    frame.resize(length, 0);
    stream.read_exact(&mut frame[4..]).map_err(io)?;
    match parse_frame(&frame)? {
        Cotp::Connect { .. } => Ok(confirm_frame()),
        Cotp::Confirm => Err(S7Error::Frame("a confirmation from a client")),
        Cotp::Data(data) => {
            let message = Message::parse(data)?;
            let mut memory = memory.lock().unwrap_or_else(PoisonError::into_inner);
            Ok(frame_of(&answer(message, &mut memory)?))
        }
    }
}

fn answer(message: Message, memory: &mut Memory) -> Result<Message, S7Error> {
    let shift = u16::from(memory.wrong_reference);
    let reference = message.reference().wrapping_add(shift);
    if memory.refuses && !matches!(message, Message::Setup { .. }) {
        return Ok(Message::Refused {
            reference,
            class: 0x85,
            code: 0,
        });
    }
    match message {
        Message::Setup { longest, .. } => Ok(Message::Setup {
            reference,
            longest: longest.min(480),
            is_answer: true,
        }),
        Message::Read { items, .. } => Ok(Message::Values {
            reference,
            values: items.iter().map(|item| memory.read(*item)).collect(),
            of_nck: items
                .iter()
                .map(|item| matches!(item, Item::Nck(_)))
                .collect(),
        }),
        Message::Write { writes, .. } => Ok(Message::Written {
            reference,
            codes: writes
                .iter()
                .map(|write| memory.write(write.item, &write.bytes))
                .collect(),
        }),
        _ => Err(S7Error::Frame("an answer from a client")),
    }
}

impl Memory {
    /// The key of a line of an NCK variable.
    fn key(variable: super::item::NckVariable, line: u16) -> (u8, u8, u16, u16) {
        let mut bytes = Vec::new();
        Item::Nck(variable).put(&mut bytes);
        // Area and unit as they stand on the wire.
        (
            bytes.get(3).copied().unwrap_or(0),
            variable.module,
            variable.column,
            line,
        )
    }

    /// Puts an eight-byte number into an NCK variable.
    pub fn set_nck(&mut self, variable: &super::item::NckVariable, value: f64) {
        self.nck.insert(
            Self::key(*variable, variable.line),
            value.to_le_bytes().to_vec(),
        );
    }

    fn read(&self, item: Item) -> Result<Vec<u8>, ReturnCode> {
        match item {
            Item::Block {
                number,
                first,
                count,
            } => {
                let block = self.blocks.get(&number).ok_or(ReturnCode::NO_OBJECT)?;
                let first = usize::from(first);
                let bytes = block.get(first..first + usize::from(count));
                bytes.map(<[u8]>::to_vec).ok_or(ReturnCode::ADDRESS)
            }
            Item::Nck(variable) => {
                let mut bytes = Vec::new();
                for line in 0..u16::from(variable.lines) {
                    let key = Self::key(variable, variable.line.wrapping_add(line));
                    bytes.extend(self.nck.get(&key).ok_or(ReturnCode::NO_OBJECT)?);
                }
                Ok(bytes)
            }
        }
    }

    fn write(&mut self, item: Item, bytes: &[u8]) -> ReturnCode {
        let place = match item {
            Item::Block {
                number,
                first,
                count,
            } => {
                let Some(block) = self.blocks.get_mut(&number) else {
                    return ReturnCode::NO_OBJECT;
                };
                if usize::from(count) != bytes.len() {
                    return ReturnCode::TYPE;
                }
                let first = usize::from(first);
                block.get_mut(first..first + bytes.len())
            }
            Item::Nck(variable) => {
                let key = Self::key(variable, variable.line);
                match self.nck.get_mut(&key) {
                    None => return ReturnCode::NO_OBJECT,
                    Some(line) if line.len() != bytes.len() => return ReturnCode::TYPE,
                    Some(line) => Some(&mut line[..]),
                }
            }
        };
        match place {
            None => ReturnCode::ADDRESS,
            Some(place) => {
                place.copy_from_slice(bytes);
                ReturnCode::GOOD
            }
        }
    }
}
