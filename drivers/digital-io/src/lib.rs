#![doc = include_str!("../README.md")]

mod axis;
mod coherent;
mod controller;
#[cfg(feature = "gpio")]
mod gpio;
mod outputs;
mod panel;
mod wiring;
mod words;

pub use axis::{DigitalAxis, LowBits};
pub use coherent::{Coherence, read_coherent};
pub use controller::DigitalController;
#[cfg(feature = "gpio")]
pub use gpio::{GpioPort, LineSet};
pub use panel::{Panel, PanelWord};
pub use wiring::{Wiring, WiringError};
pub use words::{
    BeyondWord, Coded, Correction, CorrectionCode, CorrectionWord, PositionCode, PositionWord,
    Unwrapper,
};
