//! Measurements computed from a truth machine's kinematics come back as its volumetric error.

mod gantry;
mod instrument;
mod located;
mod messages;
mod turning;
mod uncertainty;
