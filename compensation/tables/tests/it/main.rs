//! Tests of tables, and of maps in a control.
//!
//! Maps are compared with closed forms and SciPy. The program of the control is run with its Structured Text, and on a
//! wire that loses, tears, delays and reorders.

mod axis_table;
mod bounds;
mod machines;
mod sender;
mod text;
mod wire;
mod words;
mod world;
