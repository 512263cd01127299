//! Single questions and orders, for set-up and tools; a cycle uses [`FocasController`](crate::FocasController).

use std::time::{Duration, Instant};

use volcomp_port::{DeviceError, Fault};

use crate::{
    frame::{Command, Request, Target, number, number_bytes},
    session::Session,
};

/// An area of the PMC's memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum PmcArea {
    /// Signals to the control.
    G = 0,
    /// Signals from the control.
    F = 1,
    /// Outputs to the machine.
    Y = 2,
    /// Inputs from the machine.
    X = 3,
    /// Messages.
    A = 4,
    /// Internal relays.
    R = 5,
    /// Timers.
    T = 6,
    /// Keep relays.
    K = 7,
    /// Counters.
    C = 8,
    /// Data tables.
    D = 9,
}

impl PmcArea {
    /// All areas.
    pub const ALL: [Self; 10] = [
        Self::G,
        Self::F,
        Self::Y,
        Self::X,
        Self::A,
        Self::R,
        Self::T,
        Self::K,
        Self::C,
        Self::D,
    ];

    /// The area of a letter.
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|area| format!("{area:?}").starts_with(letter.to_ascii_uppercase()))
    }
}

/// Bytes of one point of PMC memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Width {
    /// One byte.
    Byte,
    /// Two bytes, signed.
    #[default]
    Word,
    /// Four bytes, signed.
    Long,
}

impl Width {
    /// How many.
    pub fn bytes(self) -> u16 {
        match self {
            Self::Byte => 1,
            Self::Word => 2,
            Self::Long => 4,
        }
    }

    pub(crate) fn code(self) -> i32 {
        match self {
            Self::Byte => 0,
            Self::Word => 1,
            Self::Long => 2,
        }
    }
}

/// Which positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PositionKind {
    /// Machine coordinates.
    #[default]
    Machine,
    /// Absolute coordinates, in the workpiece's system.
    Absolute,
}

impl PositionKind {
    pub(crate) fn code(self) -> i32 {
        match self {
            Self::Machine => 1,
            Self::Absolute => 4,
        }
    }
}

/// What the control says about itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SystemInfo {
    /// Slots in answers about all axes.
    pub max_axes: u16,
    /// Type of control, such as ` 0` or `31`.
    pub cnc_type: String,
    /// ` M` for milling, ` T` for turning.
    pub machine_type: String,
    /// Series.
    pub series: String,
    /// Version.
    pub version: String,
    /// Axes of the path.
    pub axes: String,
}

/// The state of the control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StatusInfo {
    /// Mode: 0 MDI, 1 memory, 3 edit, 4 handle, 5 jog, 9 reference, 10 remote.
    pub mode: u16,
    /// 0 reset, 1 stop, 2 hold, 3 running.
    pub run: u16,
    /// Axes move.
    pub motion: u16,
    /// 1: emergency stop.
    pub emergency: u16,
    /// Not 0: an alarm.
    pub alarm: u16,
}

/// One alarm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Alarm {
    /// Its number.
    pub number: i32,
    /// Its type.
    pub kind: i32,
    /// Axis it belongs to, 0 for none.
    pub axis: i32,
    /// Its text.
    pub text: String,
}

/// A control that is asked one thing at a time.
#[derive(Debug)]
pub struct Client {
    session: Session,
    path: u16,
    at_most: Duration,
}

/// The functions of the control.
pub(crate) mod function {
    pub(crate) const SYSTEM: u16 = 0x18;
    pub(crate) const STATUS: u16 = 0x19;
    pub(crate) const ALARMS: u16 = 0x23;
    pub(crate) const POSITIONS: u16 = 0x26;
    pub(crate) const AXIS_NAMES: u16 = 0x89;
    pub(crate) const READ_PARAMETER: u16 = 0x8d;
    pub(crate) const READ_MACRO: u16 = 0xa7;
    pub(crate) const WRITE_MACRO: u16 = 0xa8;
    pub(crate) const READ_OFFSET: u16 = 0x0b;
    pub(crate) const WRITE_OFFSET: u16 = 0x0c;
    pub(crate) const READ_PMC: u16 = 0x8001;
    pub(crate) const WRITE_PMC: u16 = 0x8002;
}

impl Client {
    /// Opens a session; every later call takes `at_most` too.
    ///
    /// # Errors
    /// See [`Session::open`].
    pub fn open(host: &str, port: u16, at_most: Duration) -> Result<Self, DeviceError> {
        Ok(Self {
            session: Session::open(host, port, at_most)?,
            path: 1,
            at_most,
        })
    }

    /// The session itself.
    pub fn into_session(self) -> Session {
        self.session
    }

    /// Version that the controller answers with.
    pub fn version(&self) -> u16 {
        self.session.version()
    }

    /// One command and its data.
    fn ask(
        &mut self,
        target: Target,
        function: u16,
        args: [i32; 5],
        data: &[u8],
        what: &'static str,
    ) -> Result<Vec<u8>, Fault> {
        let command = Command {
            target,
            path: self.path,
            function,
            args,
            data,
        };
        let request = Request::new(&[command])?;
        let deadline = Instant::now() + self.at_most;
        let mut blocks = self.session.exchange(&request, deadline)?;
        // `answers` has seen as many blocks as commands.
        let block = blocks
            .next()
            .unwrap_or(Err(crate::frame::Broken("no answer")))?;
        if block.error != 0 {
            return Err(Fault::Refused {
                code: i32::from(block.error),
                what,
            });
        }
        Ok(block.data.to_vec())
    }

    /// What the control is.
    ///
    /// # Errors
    /// See [`Fault`].
    pub fn system_info(&mut self) -> Result<SystemInfo, Fault> {
        let data = self.ask(
            Target::Cnc,
            function::SYSTEM,
            [0; 5],
            &[],
            "system information",
        )?;
        let data = data
            .first_chunk::<18>()
            .ok_or(Fault::Protocol("system information that is cut off"))?;
        let text = |from: usize, to: usize| String::from_utf8_lossy(&data[from..to]).into_owned();
        Ok(SystemInfo {
            max_axes: u16::from_be_bytes([data[2], data[3]]),
            cnc_type: text(4, 6),
            machine_type: text(6, 8),
            series: text(8, 12),
            version: text(12, 16),
            axes: text(16, 18),
        })
    }

    /// The state of the control.
    ///
    /// # Errors
    /// See [`Fault`].
    pub fn status(&mut self) -> Result<StatusInfo, Fault> {
        let data = self.ask(Target::Cnc, function::STATUS, [0; 5], &[], "status")?;
        Ok(status(&data)?)
    }

    /// The letters of the axes, as far as they have one.
    ///
    /// # Errors
    /// See [`Fault`].
    pub fn axis_names(&mut self) -> Result<Vec<char>, Fault> {
        let data = self.ask(Target::Cnc, function::AXIS_NAMES, [0; 5], &[], "axis names")?;
        let names = data.chunks_exact(4).map(|name| char::from(name[0]));
        Ok(names.take_while(char::is_ascii_alphabetic).collect())
    }

    /// Positions of the first `axes` axes, mm or deg.
    ///
    /// # Errors
    /// See [`Fault`]; a slot that holds no number.
    pub fn positions(&mut self, kind: PositionKind, axes: usize) -> Result<Vec<f64>, Fault> {
        let args = [kind.code(), -1, 0, 0, 0];
        let data = self.ask(Target::Cnc, function::POSITIONS, args, &[], "positions")?;
        (0..axes).map(|axis| Ok(slot(&data, axis)?)).collect()
    }

    /// Memory of the PMC, as many bytes as asked for.
    ///
    /// # Errors
    /// See [`Fault`].
    pub fn read_pmc(&mut self, area: PmcArea, first: u16, bytes: u16) -> Result<Vec<u8>, Fault> {
        let last = i32::from(first) + i32::from(bytes.max(1)) - 1;
        let args = [i32::from(first), last, area as i32, Width::Byte.code(), 0];
        let data = self.ask(Target::Pmc, function::READ_PMC, args, &[], "PMC memory")?;
        if data.len() != usize::from(bytes.max(1)) {
            return Err(Fault::Protocol(
                "another length of PMC memory than asked for",
            ));
        }
        Ok(data)
    }

    /// Writes bytes into the memory of the PMC.
    ///
    /// # Errors
    /// See [`Fault`].
    pub fn write_pmc(&mut self, area: PmcArea, first: u16, bytes: &[u8]) -> Result<(), Fault> {
        let length = i32::try_from(bytes.len()).unwrap_or(i32::MAX);
        let last = i32::from(first) + length.max(1) - 1;
        let args = [
            i32::from(first),
            last,
            area as i32,
            Width::Byte.code(),
            length,
        ];
        self.ask(
            Target::Pmc,
            function::WRITE_PMC,
            args,
            bytes,
            "writing PMC memory",
        )?;
        Ok(())
    }

    /// A custom macro variable; `None` where it is vacant.
    ///
    /// # Errors
    /// See [`Fault`].
    pub fn read_macro(&mut self, number: i32) -> Result<Option<f64>, Fault> {
        let args = [number, 1, 0, 0, 0];
        let data = self.ask(
            Target::Cnc,
            function::READ_MACRO,
            args,
            &[],
            "a macro variable",
        )?;
        let value = data.first_chunk().map(|bytes| f64::from_be_bytes(*bytes));
        let value = value.ok_or(Fault::Protocol("a macro variable that is cut off"))?;
        Ok(Some(value).filter(|value| !value.is_nan()))
    }

    /// Sets a custom macro variable.
    ///
    /// # Errors
    /// See [`Fault`].
    pub fn write_macro(&mut self, number: i32, value: f64) -> Result<(), Fault> {
        let args = [number, 0, 0, 0, 8];
        let data = value.to_be_bytes();
        self.ask(
            Target::Cnc,
            function::WRITE_MACRO,
            args,
            &data,
            "writing a macro variable",
        )?;
        Ok(())
    }

    /// A work offset of an axis (`number` 0: external, 1 to 6: G54 to G59), mm or deg.
    ///
    /// # Errors
    /// See [`Fault`].
    pub fn read_work_offset(&mut self, number: i32, axis: usize) -> Result<f64, Fault> {
        let args = [number, number, -1, 0, 0];
        let data = self.ask(
            Target::Cnc,
            function::READ_OFFSET,
            args,
            &[],
            "a work offset",
        )?;
        Ok(slot(&data, axis)?)
    }

    /// Sets a work offset of an axis, counted from 0, with three decimals. It takes effect at block
    /// look-ahead: no substitute for a zero point shift. Seen on a real control for G54 only.
    ///
    /// # Errors
    /// See [`Fault`].
    pub fn write_work_offset(&mut self, number: i32, axis: usize, value: f64) -> Result<(), Fault> {
        let axis = i32::try_from(axis + 1).unwrap_or(i32::MAX);
        let args = [number, number, axis, 0, 8];
        let [a, b, c, d, ..] = number_bytes(value, 3);
        // As captured: the mantissa alone, exponent ffff.
        let data = [a, b, c, d, 0, 0, 0xff, 0xff];
        self.ask(
            Target::Cnc,
            function::WRITE_OFFSET,
            args,
            &data,
            "writing a work offset",
        )?;
        Ok(())
    }

    /// A parameter of the control that holds whole numbers, by axis from 0 or as it is.
    ///
    /// # Errors
    /// See [`Fault`]; a number that does not exist refuses the request.
    pub fn read_parameter(&mut self, number_of: i32, axis: Option<usize>) -> Result<f64, Fault> {
        let wanted = axis.map_or(0, |axis| i32::try_from(axis + 1).unwrap_or(i32::MAX));
        let args = [number_of, number_of, wanted, 0, 0];
        let data = self.ask(
            Target::Cnc,
            function::READ_PARAMETER,
            args,
            &[],
            "a parameter",
        )?;
        let values = data.get(8..).unwrap_or_default();
        Ok(slot(values, axis.unwrap_or(0))?)
    }

    /// The alarms that are on, ten at the most.
    ///
    /// # Errors
    /// See [`Fault`].
    pub fn alarms(&mut self) -> Result<Vec<Alarm>, Fault> {
        let args = [-1, 10, 2, 64, 0];
        let data = self.ask(Target::Cnc, function::ALARMS, args, &[], "alarms")?;
        let alarm = |record: &[u8]| {
            let word = |k: usize| {
                let [a, b, c, d] = [record[k], record[k + 1], record[k + 2], record[k + 3]];
                i32::from_be_bytes([a, b, c, d])
            };
            let length = usize::try_from(word(12)).unwrap_or(0).min(64);
            let text = String::from_utf8_lossy(&record[16..16 + length]);
            Alarm {
                number: word(0),
                kind: word(4),
                axis: word(8),
                text: text.trim_end_matches(['\0', ' ']).to_owned(),
            }
        };
        Ok(data.chunks_exact(80).map(alarm).collect())
    }
}

/// The number in a slot of eight bytes.
pub(crate) fn slot(data: &[u8], index: usize) -> Result<f64, crate::frame::Broken> {
    let bytes = data
        .get(8 * index..)
        .and_then(|rest| rest.first_chunk::<8>());
    let bytes = bytes.ok_or(crate::frame::Broken("fewer axes than asked for"))?;
    number(*bytes).ok_or(crate::frame::Broken("a position that is no number"))
}

pub(crate) fn status(data: &[u8]) -> Result<StatusInfo, crate::frame::Broken> {
    let data = data
        .first_chunk::<14>()
        .ok_or(crate::frame::Broken("a status that is cut off"))?;
    let word = |k: usize| u16::from_be_bytes([data[2 * k], data[2 * k + 1]]);
    Ok(StatusInfo {
        mode: word(0),
        run: word(1),
        motion: word(2),
        emergency: word(4),
        alarm: word(5),
    })
}
