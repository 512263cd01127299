//! How one line is measured: which error, where everything stands, in which sign.

use volcomp_kinematics::Side;
use volcomp_metrology::{Rides, TiltReading};
use volcomp_vocabulary::ErrorName;

/// How one error is measured along one line.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// The error that is measured.
    pub error: ErrorName,
    /// Where every axis stands, mm or deg, by its place in the chain; the measured one at 0. An axis without a value
    /// stands at 0.
    pub at: Vec<f64>,
    /// The measured point m, mm in MCS with the measured axis at 0; `None`: the point at which the
    /// axis's errors are stated.
    pub point_mcs: Option<[f64; 3]>,
    /// Which side of the joint the point is on.
    pub rides: Rides,
    /// How the readings become the error.
    pub method: Method,
    /// −1 when the instrument gives the motion of the workpiece-side component, else 1.
    pub sign: f64,
}

/// How readings become the error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// The readings are the error itself.
    Direct,
    /// Tilts of a bridge, to be summed up to a straightness.
    Angular {
        /// Foot spacing of the bridge, mm.
        bridge_mm: f64,
        /// How the sign of a tilt is meant.
        reading: TiltReading,
    },
}

impl Setup {
    /// Whether the measured point belongs to the tool side of the machine, for an axis that carries
    /// `side`.
    pub fn point_is_on_tool_side(&self, side: Side) -> bool {
        (side == Side::Tool) == (self.rides == Rides::Carriage)
    }

    /// Whether the readings are angles: of an angular error, or of a bridge.
    pub fn reads_angles(&self) -> bool {
        self.error.component.is_angular() || self.method != Method::Direct
    }
}
