#![doc = include_str!("../README.md")]

mod abbe;
mod api_pos;
mod asme_b5_54;
mod camonitor;
mod checks;
pub mod circular;
mod csv_file;
mod csv_head;
mod decimal_comma;
mod dwell;
mod edition;
mod encoding;
mod error;
mod error_motion;
mod file_format;
pub mod form;
mod incomplete_runs;
mod iso230_2;
mod iso230_6;
mod keysight;
mod mapped_table;
mod mapping;
mod measurement;
mod number;
mod passes;
mod positioning_uncertainty;
mod read;
mod reference_line;
mod renishaw;
mod runs;
mod slope_uncertainty;
mod squareness;
mod straightness;
mod test_plan;
mod text_report;
mod three_lines;
mod tolerance;
mod travel;
mod unit;
mod vdi_3441;
mod wide_table;

pub use abbe::{CarriedSide, Rides, Travel, abbe_um, lever_mm};
pub use api_pos::{parse_pos, write_pos};
pub use asme_b5_54::asme_b5_54;
pub use camonitor::{Channel, ChannelLog, parse_camonitor};
pub use checks::{
    KnownReadings, LARGEST_PLAUSIBLE, MATERIAL_WITHIN_K, OutlierHint, REFERENCE_DEGC,
    SMALLEST_PLAUSIBLE, anomalies, axis_named, environment_notes, implausible_size,
    material_compensation, outlier_hints,
};
pub use csv_file::{parse_csv, write_csv};
pub use dwell::{Channels, readings_at_dwells};
pub use edition::Edition;
pub use error::{Finding, MetrologyError};
pub use error_motion::{MotionKind, error_in_title, errors_named, not_positioning};
pub use file_format::{FileFormat, Quantity};
pub use incomplete_runs::{AtTargets, IncompleteRuns};
pub use iso230_2::{Approach, Iso230Part2, TargetRow, evaluate};
pub use iso230_6::{
    DIAGONAL_NAMES, Diagonal, Iso230Part6, MeasuredDiagonal, SquarenessHint, evaluate_diagonals,
};
pub use keysight::{parse_keysight_report, write_keysight_report};
pub use mapped_table::parse_table_with;
pub use mapping::{ColumnName, Columns, Mapping};
pub use measurement::{Environment, Measurement, Metadata, Reading, StartEnd};
pub use passes::RunAlignment;
pub use positioning_uncertainty::{
    Contribution, PositioningUncertainty, UncertaintyInputs, positioning_uncertainty,
};
pub use read::{Content, READ_EXTENSIONS, read_content, read_file, read_file_with};
pub use reference_line::{ReferenceKind, ReferenceLine};
pub use renishaw::{Capture, RenishawKind, parse_ren, parse_renishaw, parse_rtx, write_renishaw};
pub use runs::RunScatter;
pub use slope_uncertainty::{SlopeUncertainty, slope_gain, slope_gain_of_tilts};
pub use squareness::{
    SquarenessInputs, SquarenessUncertainty, opening, squareness, squareness_of_lengths,
    squareness_parts, squareness_uncertainty,
};
pub use straightness::{
    Straightness, StraightnessAbout, TiltReading, angular_method_um, straightness_of,
    straightness_of_profile, tilt_sign,
};
pub use test_plan::{RequiredTest, axis_kind, required_test, shortfalls};
pub use three_lines::{ParallelLine, SeparatedAngles, separate_parallel_lines};
pub use tolerance::{
    Decision, JudgedQuantity, StandardQuantity, Tolerance, Verdict, decide, judged,
    parse_tolerances, parse_tolerances_of,
};
pub use unit::{DeviationUnit, ReadingUnit, TargetUnit};
pub use vdi_3441::{Vdi3441, Vdi3441Target, vdi_3441};
pub use volcomp_vocabulary::Direction;
