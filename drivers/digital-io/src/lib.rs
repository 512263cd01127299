#![doc = include_str!("../README.md")]

mod controller;
#[cfg(feature = "gpio")]
mod gpio;
mod panel;
mod wiring;
mod words;

pub use controller::{Coherence, DigitalAxis, DigitalController, LowBits, read_coherent};
#[cfg(feature = "gpio")]
pub use gpio::{GpioPort, LineSet};
pub use panel::{Panel, PanelWord};
pub use wiring::{Wiring, WiringError};
pub use words::{
    BeyondWord, Coded, Correction, CorrectionCode, CorrectionWord, PositionCode, PositionWord,
    Unwrapper,
};
