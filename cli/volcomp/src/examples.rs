//! The examples at the end of each command's help. The files they name are those of the repository's `examples/`
//! and of `volcomp demo -o FOLDER`; a test runs every line.

pub(crate) const CHECK: &str = "\
Examples:
  volcomp check gantry.toml
  volcomp check mill.toml --tool T5";

pub(crate) const ERROR: &str = "\
Examples:
  volcomp error -m gantry.toml --at X=1000,Y=500,Z=-50
  volcomp error -m gantry.toml --points points.csv --temperature scale_x=22.5";

pub(crate) const CORRECT: &str = "\
Examples:
  volcomp correct -m five-axis.toml --at X=100,Y=50,B=30,C=45
  volcomp correct -m gantry.toml --points points.csv -o corrected.csv";

pub(crate) const DIAGONALS: &str = "\
Examples:
  volcomp diagonals -m gantry.toml
  volcomp diagonals -m calibrated.toml --truth truth.toml --resolution 1";

pub(crate) const MAP: &str = "\
Examples:
  volcomp map -m gantry.toml --grid 21x21x21 -o map.vti
  volcomp map -m calibrated.toml --grid 5x5x5 --truth truth.toml";

pub(crate) const AXES: &str = "\
Examples:
  volcomp axes -m trunnion.toml --tip 0,0,-50 --tool-axis 0,0.5,0.866
  volcomp --json axes -m five-axis.toml --tip 400,300,-300";

pub(crate) const NC: &str = "\
Examples:
  volcomp nc part.ngc -o part-compensated.ngc -m mill.toml
  volcomp nc part.ngc -o out.ngc -m mill.toml --setup setup.toml --tolerance 0.5";

pub(crate) const AGE: &str = "\
Examples:
  volcomp age -m mill.toml --months 36 -o worn.toml
  volcomp --json age -m trunnion.toml --months 12 --load 2 --seed 7 -o worn.toml";

pub(crate) const DH: &str = "\
Examples:
  volcomp dh -m trunnion.toml
  volcomp dh -m five-axis.toml --convention proximal";

pub(crate) const SENSITIVITY: &str = "\
Examples:
  volcomp sensitivity -m blade-mill.toml --assembly
  volcomp --json sensitivity -m gantry.toml --points points.csv";

pub(crate) const EXPRESSION: &str = "\
Examples:
  volcomp expression -m mill.toml
  volcomp expression -m first.toml --assembly --latex";

pub(crate) const FIT: &str = "\
Examples:
  volcomp fit exx.rtl --method mls --auto --residual 1 --scan
  volcomp fit exx.rtl --method chebyshev --order 5 --at 0,4000";

pub(crate) const FIT_THERMAL: &str = "\
Examples:
  volcomp fit-thermal spindle.csv --displacement ch1_um --error EZZ
  volcomp fit-thermal spindle.csv --lags 0,300,1800 --most-sensors 4";

pub(crate) const ISO230: &str = "\
Examples:
  volcomp iso230 exx.rtl --standard all --tolerance A=90,B=5
  volcomp --json iso230 circle.csv --part 4 --radius-mm 150";

pub(crate) const STRAIGHTNESS: &str = "\
Examples:
  volcomp straightness straight-exy.csv --reference end-points
  volcomp --json straightness tilts.csv --bridge-mm 250";

pub(crate) const SQUARENESS: &str = "\
Examples:
  volcomp squareness straight-exy.csv straight-eyx.csv --error EC0Y
  volcomp --json squareness straight-exy.csv straight-eyx.csv --error EC0Y";

pub(crate) const FORM: &str = "\
Examples:
  volcomp form ring.csv --feature circle --plane xy
  volcomp --json form bore.csv --feature cylinder --datum 0,0,0,0,0,1";

pub(crate) const CALIBRATE: &str = "\
Examples:
  volcomp calibrate calibration.toml -o machine-new.toml
  volcomp --json calibrate calibration.toml -o machine-new.toml";

pub(crate) const REPORT: &str = "\
Examples:
  volcomp report calibration.toml -o report.html --tolerance A=10,V=40
  volcomp report calibration.toml -o report.html --truth truth.toml";

pub(crate) const IDENTIFY: &str = "\
Examples:
  volcomp identify identification/observations.toml -o found.toml
  volcomp --json identify identification/observations.toml -o found.toml";

pub(crate) const SIMULATE: &str = "\
Examples:
  volcomp simulate shop.toml -o lasers
  volcomp --json simulate shop.toml -o lasers";

pub(crate) const DEMO: &str = "\
Examples:
  volcomp demo
  volcomp demo -o demo --seed 7 --curve mls";

pub(crate) const STUDIO: &str = "\
Examples:
  volcomp studio lasers
  volcomp studio lasers --listen 127.0.0.1:8100 --no-browser";

pub(crate) const INSPECT: &str = "\
Examples:
  volcomp inspect exx.rtl
  volcomp --json inspect exx.rtl eay.rta";

pub(crate) const PROBE: &str = "\
Examples:
  volcomp probe --list
  volcomp --json probe focas://127.0.0.1:8193 --within 1";

pub(crate) const MAP_TABLE: &str = "\
Examples:
  volcomp map-table -m gantry.toml --words 5000 -o gantry.map
  volcomp map-table -m mill.toml --tool T5 --within 2 --words 8000 -o mill.map";

pub(crate) const EXPORT: &str = "\
Examples:
  volcomp export -m gantry.toml --format csv --step 200 -o gantry-tables.csv
  volcomp export -m mill.toml --format siemens-840d --at Z=-200 -o mill-840d";

pub(crate) const IMPORT: &str = "\
Examples:
  volcomp import gantry-tables.csv -o curves.toml
  volcomp --json import mill-840d";

pub(crate) const COMPILE: &str = "\
Examples:
  volcomp compile gantry.toml -o gantry.blob
  volcomp compile mill.toml --tool T5 --tolerance-nm 10 -o mill.blob";

pub(crate) const COMPLETIONS: &str = "\
Examples:
  volcomp completions bash > volcomp.bash
  volcomp completions zsh > _volcomp";
