//! Configuration of a control that is corrected through setting data 43900 (SD43900).

use std::{fmt, path::PathBuf, time::Duration};

use volcomp_port::{Axis, Backoff, Description, Heartbeat, ShownStates};
use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement, Mm, Rad, Um};

use crate::{error::SinumerikError, nodes::Nodes};

/// Name of the channel through which corrections reach the axes, which is SD43900.
pub const CHANNEL: &str = "temperature-compensation";
/// Assumed resolution of the reported positions, mm or deg.
const POSITION_STEP: f64 = 0.001;

/// Direction in which a positive value of SD43900 moves an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Sign {
    /// A positive value moves the axis in its positive direction.
    #[default]
    Adds,
    /// A positive value moves the axis in its negative direction.
    Subtracts,
}

impl Sign {
    /// Factor from a correction to the value of SD43900, 1 or −1.
    pub fn factor(self) -> f64 {
        match self {
            Self::Adds => 1.0,
            Self::Subtracts => -1.0,
        }
    }
}

/// A control that is corrected through SD43900 of each axis, the position-independent part K0 of its temperature
/// compensation. This is suitable only for corrections that change slowly.
#[derive(Clone, Debug, PartialEq)]
pub struct SinumerikConfig {
    pub server: Server,
    /// Corrected axes, in channel order.
    pub axes: Vec<AxisName>,
    pub reads: Vec<AxisName>,
    /// Numbers of the axes in the control, from 1: first those of `axes`, then those of `reads`. If empty, the axes are
    /// numbered 1, 2, 3, ….
    pub numbers: Vec<u16>,
    /// Patterns of the OPC UA nodes that are read and written.
    pub nodes: Nodes,
    /// Name of the channel through which corrections reach the axes. Controllers with the same channel are
    /// alternatives.
    pub channel: String,
    pub sign: Sign,
    pub step_linear: Mm,
    pub step_rotary: Rad,
    pub includes_correction: bool,
}

impl SinumerikConfig {
    /// Creates a configuration for these axes: corrections in steps of 0.1 µm and 0.0001 deg, axes numbered from 1,
    /// nodes of [`Nodes::default`].
    pub fn new(server: Server, axes: &[AxisName]) -> Self {
        Self {
            server,
            axes: axes.to_vec(),
            reads: Vec::new(),
            numbers: Vec::new(),
            nodes: Nodes::default(),
            channel: CHANNEL.to_owned(),
            sign: Sign::Adds,
            step_linear: Um(0.1).to_mm(),
            step_rotary: Deg(0.0001).to_rad(),
            includes_correction: false,
        }
    }

    pub fn device(&self) -> &str {
        &self.server.url
    }

    /// Resolution of the reported positions of an axis: 0.001 mm or 0.001 deg, or the step of its corrections if that
    /// is coarser.
    pub fn position_step(&self, name: AxisName) -> Displacement {
        let decimal = match name.kind() {
            AxisKind::Linear => POSITION_STEP,
            AxisKind::Rotary => Deg(POSITION_STEP).to_rad().0,
        };
        Displacement::new(name.kind(), decimal.max(self.step(name).mm_or_rad()))
    }

    /// Smallest step of the corrections of an axis.
    pub fn step(&self, name: AxisName) -> Displacement {
        match name.kind() {
            AxisKind::Linear => Displacement::Length(self.step_linear),
            AxisKind::Rotary => Displacement::Angle(self.step_rotary),
        }
    }

    /// The axes with their numbers in the control: corrected axes, then read-only axes.
    pub(crate) fn numbered(&self) -> impl Iterator<Item = (AxisName, u16)> {
        let names = self.axes.iter().chain(&self.reads).copied();
        let number = |place: usize| match self.numbers.get(place) {
            Some(number) => *number,
            // The conversion cannot fail, because there are at most nine axes.
            None => u16::try_from(place + 1).unwrap_or(u16::MAX),
        };
        names.enumerate().map(move |(place, name)| (name, number(place)))
    }

    /// Describes the controller without connecting.
    ///
    /// The setting data keep their values when the gateway stops writing, and the control does not detect this. Hence
    /// [`Heartbeat::Unwatched`]. Each cycle writes at most once, so the shortest cycle is the sampling period of the
    /// server.
    ///
    /// # Errors
    /// The first invalid setting.
    pub fn describe(&self) -> Result<Description, SinumerikError> {
        let axis = |&name: &AxisName| Axis {
            name,
            includes_correction: self.includes_correction,
            resolution: self.step(name),
            largest: None,
        };
        let description = Description {
            device: self.server.url.clone(),
            channel: self.channel.clone(),
            axes: self.axes.iter().map(axis).collect(),
            reads: self.reads.clone(),
            heartbeat: Heartbeat::Unwatched,
            barrier: false,
            tells_applied: !self.axes.is_empty(),
            shown: ShownStates {
                referenced: self.nodes.referenced.is_some(),
                alarm: self.nodes.alarm.is_some(),
                emergency_stop: self.nodes.emergency_stop.is_some(),
            },
            sees_other_gateways: false,
            shortest_cycle: SHORTEST_PERIOD,
        };
        description.check()?;
        self.server.check()?;
        let count = self.axes.len() + self.reads.len();
        self.nodes.check(count)?;
        let mut distinct = self.numbers.clone();
        distinct.sort_unstable();
        distinct.dedup();
        let fits = distinct.len() == count && self.numbers.len() == count && distinct[0] > 0;
        if !self.numbers.is_empty() && !fits {
            return Err(SinumerikError::Numbers { found: self.numbers.clone(), axes: count });
        }
        Ok(description)
    }
}

/// Distance that an axis travels at this speed during one `period`. A correction is read and written once per period.
///
/// A position-dependent correction is wrong by its change over this distance. A correction that depends only on
/// temperatures is not affected.
pub fn lag(speed_mm_per_s: f64, period: Duration) -> Mm {
    Mm(speed_mm_per_s * period.as_secs_f64())
}

/// Shortest sampling and publishing period of the OPC UA server of an 840D sl or 828D.
pub const SHORTEST_PERIOD: Duration = Duration::from_millis(100);
/// Default port of the control's OPC UA server.
pub const PORT: u16 = 4840;

/// The OPC UA server of a control, and the settings for polling it.
#[derive(Clone, Debug, PartialEq)]
pub struct Server {
    /// URL of the server: `opc.tcp://HOST:4840`.
    pub url: String,
    /// Namespace of the server's nodes. Its index is looked up in the server's NamespaceArray at every connection.
    pub namespace: String,
    /// User that logs in; `None` for an anonymous login.
    pub user: Option<User>,
    pub security: Security,
    /// Folder with certificates: `own/cert.der`, `private/private.pem`, and `trusted/` with the server's certificate.
    /// Required for message security.
    pub pki: Option<PathBuf>,
    pub period: Duration,
    /// Timeout of a request. When it expires, the session is closed.
    pub time_out: Duration,
    /// Whether the age of positions is taken from the server's source timestamps. Set this to `false` if the server
    /// updates a timestamp only when the value changes, because positions at standstill would then seem to be old.
    pub source_timestamps: bool,
    /// Delay between two connection attempts.
    pub backoff: Backoff,
}

#[derive(Clone, PartialEq, Eq)]
pub struct User {
    pub name: String,
    /// Password of the user. It never appears in messages or `Debug` output.
    pub password: String,
}

impl fmt::Debug for User {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("User").field("name", &self.name).finish_non_exhaustive()
    }
}

/// Message security. Signatures and encryption use the policy Basic256Sha256.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Security {
    /// Messages are neither signed nor encrypted, so passwords are sent in clear text.
    #[default]
    None,
    Sign,
    SignAndEncrypt,
}

impl Server {
    /// Creates the settings for a server: namespace `SinumerikVarProvider`, anonymous, no message security, a reading
    /// every 100 ms, a timeout of 500 ms.
    pub fn new(url: impl Into<String>) -> Self {
        Self {
            url: url.into(),
            namespace: "SinumerikVarProvider".to_owned(),
            user: None,
            security: Security::None,
            pki: None,
            period: SHORTEST_PERIOD,
            time_out: Duration::from_millis(500),
            source_timestamps: true,
            backoff: Backoff::default(),
        }
    }

    /// Checks period, timeout and certificates, without connecting.
    ///
    /// # Errors
    /// The first invalid setting.
    pub fn check(&self) -> Result<(), SinumerikError> {
        if self.period < SHORTEST_PERIOD {
            return Err(SinumerikError::Period { found: self.period, shortest: SHORTEST_PERIOD });
        }
        if !(Duration::from_millis(10)..=Duration::from_secs(60)).contains(&self.time_out) {
            return Err(SinumerikError::TimeOut(self.time_out));
        }
        if self.security != Security::None && self.pki.is_none() {
            return Err(SinumerikError::NoCertificates);
        }
        Ok(())
    }

    /// Maximum time until a sent correction appears in a reading, if every request is answered in time. The time
    /// consists of the write, a reading that has already begun, and the next reading.
    pub fn read_back(&self) -> Duration {
        self.time_out + 2 * self.period
    }
}
