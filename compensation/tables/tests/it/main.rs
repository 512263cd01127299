//! Maps against closed forms and SciPy; the control's half against its Structured Text, and behind a wire that loses,
//! tears, delays and exchanges.

mod axis_table;
mod bounds;
mod machines;
mod peer;
mod sender;
mod text;
mod wire;
mod words;
mod world;
