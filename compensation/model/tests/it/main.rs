//! The machine file, its errors and its evaluation, against closed forms.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod absurd;
mod correct;
mod evaluation;
mod fuzz_corpus;
mod messages;
mod round_trip;
#[cfg(feature = "serde")]
mod serialised;
mod thermal;

/// Ends the run on an allocation where one is forbidden.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// The example of the file format, every kind of curve in it.
pub const EXAMPLE: &str = r#"
name = "gantry-8000"
structure = "w C' X' b Y Z t"
[axes.X]
travel = [0.0, 8000.0]
[axes.Y]
travel = [0.0, 4000.0]
[axes.Z]
travel = [0.0, 2500.0]
[axes.C]
travel = [-360.0, 360.0]
point = [400.0, 300.0, -200.0]
[tool]
tip = [0.0, 0.0, -150.0]
axis = [0.0, 0.0, 1.0]
[tools.T5]
tip = [0.0, 0.0, -250.0]
[workpiece]
origin = [0.0, 0.0, 0.0]
[errors]
EXX = { poly = [0.0, 0.0073, -2.1e-7] }
EYX = { chebyshev = [0.4, -1.2, 3.0], domain = [0.0, 8000.0] }
EZX = { table = [[0.0, 0.0], [400.0, 1.5]], interpolation = "linear" }
EXY = { forward = { poly = [1.0] }, backward = { poly = [3.5] } }
EYY = { mls = { nodes = [[0.0, 0.0], [1000.0, 2.2], [2000.0, 1.0], [3000.0, -0.5], [4000.0, 0.3]], order = 2, support = 0.8, shape = 3.0 } }
EAC = { fourier = [0.5, 3.0, -1.2], period = 360.0 }
EC0Y = 12.0
EZY = { grid = { axes = ["Y", "Z"], nodes = [[0, 500], [0, 650, 1050]], values = [[0.0, 1.0, 2.0], [0.5, 1.5, 2.5]] } }
EXZ = { mean = { table = [[0.0, 0.0], [1000.0, 4.0], [2500.0, 1.0]], interpolation = "cubic" }, reversal = 3.5 }
EYZ = { bspline = { knots = [0.0, 0.0, 1250.0, 2500.0, 2500.0], coefficients = [1.0, 2.0, -1.0], degree = 1 } }
EAY = 4.0
[assembly]
X = [1, 2, 3, 4, 5, 6]
[thermal]
reference = 20.0
[[thermal.expansion]]
error = "EXX"
sensor = "scale_x"
um_per_m_k = 11.5
fixed_mm = 100.0
[[thermal.drift]]
error = "EZZ"
sensors = { spindle = 1.0, bed = -1.0 }
um_per_k = 3.2
lag_s = 600.0
"#;
