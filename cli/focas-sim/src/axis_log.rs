//! Log of the axis corrections, written by a separate thread, so that a scan never waits for a disk.

use std::{
    fs::File,
    io::{BufWriter, Write},
    path::Path,
    sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    thread::{self, JoinHandle},
    time::Duration,
};

use rustix::time::{ClockId, clock_gettime};
use volcomp_focas::simulator::{Scan, ScanLog};
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{error::SimError, quantities::count};

const FLUSH: Duration = Duration::from_millis(50);

/// One line of the log: monotonic time, ns; whether the control was power-cycled; the shift of each axis, counts.
struct Line {
    time_ns: i128,
    switched_on: bool,
    shifts: Vec<i64>,
}

pub(crate) struct AxisLog {
    writer: JoinHandle<std::io::Result<()>>,
    file: String,
}

impl AxisLog {
    /// Creates the file and the scan callback. Dropping the callback ends the log.
    pub(crate) fn create(path: &Path, axes: &[AxisName]) -> Result<(ScanLog, Self), SimError> {
        let file = path.display().to_string();
        let mut output = BufWriter::new(File::create(path).map_err(SimError::write(&file))?);
        let heads = axes.iter().map(|axis| match axis.kind() {
            AxisKind::Linear => format!(",{axis}_um"),
            AxisKind::Rotary => format!(",{axis}_urad"),
        });
        let heads: String = heads.collect();
        writeln!(output, "monotonic_s,switched_on{heads}").map_err(SimError::write(&file))?;
        let scales: Vec<f64> = (axes.iter()).map(|axis| count(axis.kind()).um_or_urad()).collect();
        let (line_sender, lines) = channel();
        let writer = thread::Builder::new()
            .name("focas-sim axes".to_owned())
            .spawn(move || write(output, &lines, &scales))
            .map_err(SimError::thread)?;
        Ok((scan_log(line_sender), Self { writer, file }))
    }

    pub(crate) fn end(self) -> Result<(), SimError> {
        // The panic of the thread has already printed its message.
        let written = self.writer.join().unwrap_or(Ok(()));
        written.map_err(SimError::write(&self.file))
    }
}

/// Forwards the first scan, scans in which an axis moved, and scans after a power cycle.
fn scan_log(line_sender: Sender<Line>) -> ScanLog {
    let mut last: Option<Vec<i64>> = None;
    Box::new(move |scan: Scan<'_>| {
        if !scan.switched_on && last.as_deref() == Some(scan.shifts) {
            return;
        }
        let now = clock_gettime(ClockId::Monotonic);
        // The writer drops the receiver only after a write error, which `end` returns.
        let _ = line_sender.send(Line {
            time_ns: i128::from(now.tv_sec) * 1_000_000_000 + i128::from(now.tv_nsec),
            switched_on: scan.switched_on,
            shifts: scan.shifts.to_vec(),
        });
        last = Some(scan.shifts.to_vec());
    })
}

fn write(
    mut output: BufWriter<File>,
    lines: &Receiver<Line>,
    scales: &[f64],
) -> std::io::Result<()> {
    loop {
        match lines.recv_timeout(FLUSH) {
            Ok(line) => {
                let seconds = line.time_ns as f64 * 1e-9;
                write!(output, "{seconds:.6},{}", u8::from(line.switched_on))?;
                for (shift, scale) in line.shifts.iter().zip(scales) {
                    write!(output, ",{:.3}", *shift as f64 * scale)?;
                }
                writeln!(output)?;
            }
            Err(RecvTimeoutError::Timeout) => output.flush()?,
            Err(RecvTimeoutError::Disconnected) => return output.flush(),
        }
    }
}
