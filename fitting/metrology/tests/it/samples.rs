//! Small measurements and files written by hand.

use volcomp_metrology::{
    Direction::{self, Negative, Positive},
    Measurement, Reading,
};

/// A file with three targets, one of them negative, and two bidirectional runs; reverse passes are in the order of
/// travel.
pub(crate) const BIDIRECTIONAL_RTL: &str = "HEADER::\r
File type  : rtl\r
Owner      : Example\r
Version no : 1.0\r
TARGET DATA::\r
Filetype  : ISO\r
Target-count: 3\r
Targets :\r
-100.000000  0.000000  250.500000\r
Flags: 0 0 2 0\r
USER-TEXT::\r
Machine:Gantry 8000\r
Serial No:17\r
Date:2026-03-14\r
By:\r
Axis:X\r
Location:Hall: 2\r
TITLE:X at Y = 0\r
RUNS::\r
Run-count: 4\r
DEVIATIONS::\r
Run Target Data:\r
   1     1   1.000000\r
   1     2   2.500000\r
   1     3  -3.000000\r
   2     3  -2.000000\r
   2     2   3.500000\r
   2     1   4.000000\r
   3     1   1.200000\r
   3     2   2.700000\r
   3     3  -2.800000\r
   4     3  -1.800000\r
   4     2   3.700000\r
   4     1   4.200000\r
EQUIPMENT::\r
Laser: 123456\r
ENVIRONMENT::\r
Air temp   : 20.337280 20.384956 0\r
Air Press  : 99.039005 99.049346 1\r
Air humid  : 46.954897 46.893887\r
Mat temp 1 : 20.203292 20.321342 0\r
Mat temp 2 : -10.000000 -10.000000 0\r
Mat temp 3 : -10.000000 -10.000000 0\r
Env factor : 0.31641096 0.31641067\r
Exp coeff  : 8.000000 8.000000 0\r
Date Time  : \"10:46 Dec 12 2016\" \"11:01 Dec 12 2016\"\r
Final Data : 1 0\r
EOF::\r
";

/// The sample file with one text replaced. Panics if the text does not occur.
pub(crate) fn rtl_with(from: &str, to: &str) -> String {
    assert!(BIDIRECTIONAL_RTL.contains(from), "no {from:?} in the sample");
    BIDIRECTIONAL_RTL.replacen(from, to, 1)
}

#[track_caller]
pub(crate) fn near(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} against {expected} within {tolerance}");
}

pub(crate) fn measurement(readings: &[(f64, u32, Direction, f64)]) -> Measurement {
    let reading =
        |&(target, run, direction, deviation): &_| Reading { target, run, direction, deviation };
    Measurement {
        name: "m".into(),
        readings: readings.iter().map(reading).collect(),
        ..Measurement::default()
    }
}

/// A measurement with two targets and two runs in each direction.
pub(crate) fn small() -> Measurement {
    measurement(&[
        (0.0, 1, Positive, 1.0),
        (0.0, 2, Positive, 3.0),
        (0.0, 1, Negative, -2.0),
        (0.0, 2, Negative, -2.0),
        (10.0, 1, Positive, 5.0),
        (10.0, 2, Positive, 5.0),
        (10.0, 1, Negative, 4.0),
        (10.0, 2, Negative, 8.0),
    ])
}
