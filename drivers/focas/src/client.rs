//! Sends single read and write requests, for set-up and tools. For a real-time cycle use
//! [`FocasController`](crate::FocasController).

use std::time::{Duration, Instant};

use volcomp_port::Fault;

use crate::{
    answers::{Alarm, PositionKind, StatusInfo, SystemInfo, function, slot, status},
    error::{FocasError, ReturnCode},
    frame::{Command, FrameError, Request, Target, number_bytes},
    parameters::{SHIFT_FIRST, SHIFT_IN_USE, ShiftSource},
    pmc::{PmcArea, Width},
    session::Session,
};

#[derive(Debug)]
pub struct Client {
    session: Session,
    path: u16,
    at_most: Duration,
}

impl Client {
    /// Opens a session. `at_most` is the timeout of this call and of every later call.
    ///
    /// # Errors
    /// See [`Session::open`].
    pub fn open(host: &str, port: u16, at_most: Duration) -> Result<Self, FocasError> {
        Ok(Self { session: Session::open(host, port, at_most)?, path: 1, at_most })
    }

    /// Returns the session, for requests that this client lacks.
    pub fn into_session(self) -> Session {
        self.session
    }

    /// Selects a path of the control, counted from 1 [default: 1].
    #[must_use]
    pub fn with_path(self, path: u16) -> Self {
        Self { path, ..self }
    }

    /// Protocol version of the control's responses: 2, 3 or 4, depending on the generation of the control.
    pub fn version(&self) -> u16 {
        self.session.version()
    }

    fn request(
        &mut self,
        function: u16,
        args: [i32; 5],
        data: &[u8],
        what: &'static str,
    ) -> Result<Vec<u8>, FocasError> {
        let target = match function {
            function::READ_PMC | function::WRITE_PMC => Target::Pmc,
            _ => Target::Cnc,
        };
        let command = Command { target, path: self.path, function, args, data };
        let request = Request::new(&[command])?;
        let deadline = Instant::now() + self.at_most;
        let failed = |fault| FocasError::in_request(what, fault);
        let mut blocks = self.session.exchange(&request, deadline).map_err(failed)?;
        // The session has checked that the response has one block for each command.
        let block = blocks.next().unwrap_or(Err(FrameError("no answer")));
        let block = block.map_err(|e| failed(e.into()))?;
        if block.error != 0 {
            return Err(FocasError::Refused {
                request: what.to_owned(),
                code: ReturnCode(block.error),
            });
        }
        Ok(block.data.to_vec())
    }

    /// Reads type, software and number of axes of the control.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn system_info(&mut self) -> Result<SystemInfo, FocasError> {
        let data = self.request(function::SYSTEM, [0; 5], &[], "reading system information")?;
        let data = data
            .first_chunk::<18>()
            .ok_or_else(|| broken("reading system information", FrameError("it is truncated")))?;
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

    /// Reads the state of the control.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn status(&mut self) -> Result<StatusInfo, FocasError> {
        let data = self.request(function::STATUS, [0; 5], &[], "reading the status")?;
        status(&data).map_err(|e| broken("reading the status", e))
    }

    /// Reads the letters of the axes in the control's order, up to the first axis that has no letter.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn axis_names(&mut self) -> Result<Vec<char>, FocasError> {
        let data = self.request(function::AXIS_NAMES, [0; 5], &[], "reading axis names")?;
        let names = data.chunks_exact(4).map(|name| char::from(name[0]));
        Ok(names.take_while(char::is_ascii_alphabetic).collect())
    }

    /// Reads the positions of the first `axes` axes, mm or deg.
    ///
    /// # Errors
    /// See [`FocasError`]. A slot that contains no number is an error too.
    pub fn positions(&mut self, kind: PositionKind, axes: usize) -> Result<Vec<f64>, FocasError> {
        let args = [kind.code(), -1, 0, 0, 0];
        let data = self.request(function::POSITIONS, args, &[], "reading positions")?;
        let position = |axis| slot(&data, axis).map_err(|e| broken("reading positions", e));
        (0..axes).map(position).collect()
    }

    /// Reads `bytes` bytes of PMC memory from the address `first`.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn read_pmc(
        &mut self,
        area: PmcArea,
        first: u16,
        bytes: u16,
    ) -> Result<Vec<u8>, FocasError> {
        let last = i32::from(first) + i32::from(bytes.max(1)) - 1;
        let args = [i32::from(first), last, area as i32, Width::Byte.code(), 0];
        let data = self.request(function::READ_PMC, args, &[], "reading PMC memory")?;
        if data.len() != usize::from(bytes.max(1)) {
            let wrong = FrameError("another length than requested");
            return Err(broken("reading PMC memory", wrong));
        }
        Ok(data)
    }

    /// Writes bytes to PMC memory from the address `first`.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn write_pmc(&mut self, area: PmcArea, first: u16, bytes: &[u8]) -> Result<(), FocasError> {
        let length = i32::try_from(bytes.len()).unwrap_or(i32::MAX);
        let last = i32::from(first) + length.max(1) - 1;
        let args = [i32::from(first), last, area as i32, Width::Byte.code(), length];
        self.request(function::WRITE_PMC, args, bytes, "writing PMC memory")?;
        Ok(())
    }

    /// Reads the custom macro variable with this number; `None` if the variable is vacant.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn read_macro(&mut self, number: i32) -> Result<Option<f64>, FocasError> {
        let args = [number, 1, 0, 0, 0];
        let data = self.request(function::READ_MACRO, args, &[], "reading a macro variable")?;
        let value = data.first_chunk().map(|bytes| f64::from_be_bytes(*bytes));
        let value = value
            .ok_or_else(|| broken("reading a macro variable", FrameError("it is truncated")))?;
        Ok(Some(value).filter(|value| !value.is_nan()))
    }

    /// Sets the custom macro variable with this number.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn write_macro(&mut self, number: i32, value: f64) -> Result<(), FocasError> {
        let args = [number, 0, 0, 0, 8];
        let data = value.to_be_bytes();
        self.request(function::WRITE_MACRO, args, &data, "writing a macro variable")?;
        Ok(())
    }

    /// Reads a work offset of the axis with this index from 0, mm or deg. `number` 0 is the external offset, 1 to 6 are
    /// G54 to G59.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn read_work_offset(&mut self, number: i32, axis: usize) -> Result<f64, FocasError> {
        let args = [number, number, -1, 0, 0];
        let data = self.request(function::READ_OFFSET, args, &[], "reading a work offset")?;
        slot(&data, axis).map_err(|e| broken("reading a work offset", e))
    }

    /// Sets a work offset of the axis with this index from 0, mm or deg, rounded to three decimals. For `number` see
    /// [`Client::read_work_offset`].
    ///
    /// A work offset does not replace a zero point shift, because it reportedly takes effect only when blocks are read
    /// ahead. A public description of the protocol documents this request only for G54 of the X axis, with a delayed
    /// read-back. This client has been tested only against its own simulator.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn write_work_offset(
        &mut self,
        number: i32,
        axis: usize,
        value: f64,
    ) -> Result<(), FocasError> {
        let axis = i32::try_from(axis + 1).unwrap_or(i32::MAX);
        let args = [number, number, axis, 0, 8];
        let [a, b, c, d, ..] = number_bytes(value, 3);
        // The format of the public description: a mantissa of four bytes, two zero bytes, and the exponent ffff.
        let data = [a, b, c, d, 0, 0, 0xff, 0xff];
        self.request(function::WRITE_OFFSET, args, &data, "writing a work offset")?;
        Ok(())
    }

    /// Reads a parameter of the control. `axis` is the index of an axis from 0, or `None` for a parameter that belongs
    /// to no axis.
    ///
    /// # Errors
    /// See [`FocasError`]. The control rejects a request for an unknown number.
    pub fn read_parameter(
        &mut self,
        number_of: i32,
        axis: Option<usize>,
    ) -> Result<f64, FocasError> {
        let axis_number = axis.map_or(0, |axis| i32::try_from(axis + 1).unwrap_or(i32::MAX));
        let args = [number_of, number_of, axis_number, 0, 0];
        let data = self.request(function::READ_PARAMETER, args, &[], "reading a parameter")?;
        let values = data.get(8..).unwrap_or_default();
        slot(values, axis.unwrap_or(0)).map_err(|e| broken("reading a parameter", e))
    }

    /// Reads an integer parameter of the control. The inner error is the reason why the value is unknown: the control
    /// rejects the request, or the value is not a whole number. The outer error means that the session failed or the
    /// control is busy.
    pub(crate) fn integer_parameter(
        &mut self,
        number: i32,
    ) -> Result<Result<u32, String>, FocasError> {
        let value = match self.read_parameter(number, None) {
            Err(error) if self.session.is_dead() => return Err(error),
            Err(error @ FocasError::Refused { code: ReturnCode::BUSY, .. }) => return Err(error),
            Err(error) => Err(error.to_string()),
            Ok(value) => Ok(value),
        };
        Ok(value.and_then(|value| {
            whole(value)
                .ok_or_else(|| format!("parameter {number} holds {value}, expected a whole number"))
        }))
    }

    /// Determines the PMC words from which the control takes the machine zero point shift of its axes, from parameters
    /// 1203#0 and 1280. Their meaning is from memory of the manuals, and unverified. If the control rejects the request
    /// or a value is not a whole number, the result is [`ShiftSource::Unreported`].
    ///
    /// # Errors
    /// The session failed, or the control is busy: see [`FocasError`].
    pub fn shift_source(&mut self) -> Result<ShiftSource, FocasError> {
        let mut values = [0; 2];
        for (value, number) in values.iter_mut().zip([SHIFT_IN_USE, SHIFT_FIRST]) {
            let whole = self.integer_parameter(number)?;
            match whole {
                Ok(whole) => *value = whole,
                Err(why) => return Ok(ShiftSource::Unreported { why }),
            }
        }
        let [in_use, first] = values;
        Ok(ShiftSource::Reported { in_use: in_use & 1 == 1, first })
    }

    /// Reads the active alarms, at most ten.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn alarms(&mut self) -> Result<Vec<Alarm>, FocasError> {
        let args = [-1, 10, 2, 64, 0];
        let data = self.request(function::ALARMS, args, &[], "reading alarms")?;
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

/// Converts a whole number from 0 to 2³² − 1; `None` for other numbers.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "within the range, which is seen before"
)]
fn whole(value: f64) -> Option<u32> {
    let is_whole = (0.0..=f64::from(u32::MAX)).contains(&value) && value.fract() == 0.0;
    is_whole.then_some(value as u32)
}

fn broken(request: &str, broken: FrameError) -> FocasError {
    FocasError::in_request(request, Fault::from(broken))
}
