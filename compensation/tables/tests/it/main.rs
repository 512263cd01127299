//! Maps compared with closed forms and SciPy; the control's side with its Structured Text, and on a wire that loses, tears, delays and
//! reorders.

mod axis_table;
mod bounds;
mod machines;
mod sender;
mod text;
mod wire;
mod words;
mod world;
