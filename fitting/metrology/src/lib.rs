#![doc = include_str!("../README.md")]

mod abbe;
mod channel_log;
mod checks;
pub mod circular;
mod csv_file;
mod error;
pub mod form;
mod iso230_6;
mod laser_report;
mod mapped_table;
mod measurement;
mod positioning;
mod read;
mod renishaw;
mod runs;
mod straightness;
mod text;
mod tolerance;
mod unit;

pub use abbe::{
    CarriedSide, ParallelLine, Rides, SeparatedAngles, Travel, abbe_um, lever_mm,
    separate_parallel_lines,
};
pub use channel_log::{Channel, ChannelLog, Channels, parse_camonitor, readings_at_dwells};
pub use checks::{
    KnownReadings, LARGEST_PLAUSIBLE, MATERIAL_WITHIN_K, OutlierHint, REFERENCE_DEGC,
    SMALLEST_PLAUSIBLE, anomalies, axis_named, environment_notes, implausible_size,
    material_compensation, outlier_hints,
};
pub use csv_file::{parse_csv, write_csv};
pub use error::{Finding, MetrologyError};
pub use iso230_6::{
    DIAGONAL_NAMES, Diagonal, Iso230Part6, MeasuredDiagonal, SquarenessHint, evaluate_diagonals,
};
pub use laser_report::{parse_keysight_report, parse_pos, write_keysight_report, write_pos};
pub use mapped_table::{ColumnName, Columns, Mapping, parse_table_with};
pub use measurement::{
    Environment, FileFormat, Measurement, Metadata, MotionKind, Quantity, Reading, StartEnd,
    error_in_title, errors_named, not_positioning,
};
pub use positioning::{
    Approach, Contribution, Edition, Iso230Part2, PositioningUncertainty, RequiredTest, TargetRow,
    UncertaintyInputs, Vdi3441, Vdi3441Target, asme_b5_54, axis_kind, evaluate,
    positioning_uncertainty, required_test, shortfalls, vdi_3441,
};
pub use read::{Content, READ_EXTENSIONS, read_content, read_file, read_file_with};
pub use renishaw::{Capture, RenishawKind, parse_ren, parse_renishaw, parse_rtx, write_renishaw};
pub use runs::{AtTargets, IncompleteRuns, RunAlignment, RunScatter};
pub use straightness::{
    ReferenceKind, ReferenceLine, SlopeUncertainty, SquarenessInputs, SquarenessUncertainty,
    Straightness, StraightnessAbout, TiltReading, angular_method_um, opening, slope_gain,
    slope_gain_of_tilts, squareness, squareness_of_lengths, squareness_parts,
    squareness_uncertainty, straightness_of, straightness_of_profile, tilt_sign,
};
pub use tolerance::{
    Decision, JudgedQuantity, StandardQuantity, Tolerance, Verdict, decide, judged,
    parse_tolerances, parse_tolerances_of,
};
pub use unit::{DeviationUnit, ReadingUnit, TargetUnit};
pub use volcomp_vocabulary::Direction;
