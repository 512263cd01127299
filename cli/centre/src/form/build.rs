//! From a form to a model.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use serde::Serialize;
use toml::{Table, Value};
use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_document::InputError;
use volcomp_model::{Machine, ModelError};
use volcomp_sensitivity::{Expression, terms};

use super::{CurveForm, Form, FormError, StructureForm, Upload};
use crate::map::{ErrorMap, error_map};

/// The largest number of axes, errors, files and nodes that a form takes.
const MOST_ERRORS: usize = 200;
const MOST_NODES: usize = 10_000;
/// The largest measurement file, bytes.
const LARGEST_FILE: usize = 1024 * 1024;

/// What a machine file says, for people.
#[derive(Clone, Debug, Serialize)]
pub struct Described {
    /// The machine file.
    pub text: String,
    /// The structure code.
    pub structure: String,
    /// The type numbers, linear and rotary; `None`: none of the sixteen types.
    pub type_numbers: Option<[u8; 2]>,
    /// The first-order volumetric error as a formula: displacement along X, Y, Z, rotation about them (mm, rad).
    pub formula: Vec<String>,
    /// The coordinates of the tool tip in the formula, mm.
    pub tool_mm: [f64; 3],
}

/// A model that a form has made.
#[derive(Clone, Debug, Serialize)]
pub struct Built {
    /// The machine file and its formula.
    #[serde(flatten)]
    pub described: Described,
    /// The map before and after the correction.
    pub map: ErrorMap,
    /// What a person should read.
    pub notes: Vec<String>,
    /// The model has an error that no machine should have: a person must say that the numbers are right.
    pub warning: Option<String>,
}

/// Makes the model of a form.
///
/// # Errors
/// What is wrong with the form, with the key of the machine file or the line of a measurement file.
pub fn build(form: &Form) -> Result<Built, FormError> {
    check(form)?;
    let typed = Machine::parse(&toml::to_string(&table(form))?, "the form").map_err(field)?;
    let mut notes = typed.notes();
    let machine = if form.uploads.is_empty() {
        typed
    } else {
        let (machine, warnings) = calibrated(&typed, &form.uploads)?;
        notes.extend(warnings);
        machine
    };
    let text = machine.to_toml();
    let map = error_map(&machine)?;
    Ok(Built {
        described: described(&machine, &text),
        warning: warning(&map),
        map,
        notes,
    })
}

/// A machine of which a guard would refuse the correction is a machine whose numbers were not meant.
fn warning(map: &ErrorMap) -> Option<String> {
    let largest_mm = map.largest_um[0] / 1000.0;
    let volcomp_vocabulary::Mm(most_mm) = volcomp_guard::ceiling::LIMIT;
    (largest_mm > most_mm).then(|| {
        format!(
            "The error is up to {largest_mm:.1} mm in the work space. No guard corrects an axis by more than {most_mm} mm, and machines have some hundredths: look whether the numbers and their units are as they were meant."
        )
    })
}

/// The formula of a machine, whose file has this text.
pub fn described(machine: &Machine, text: &str) -> Described {
    let stated: Vec<_> = machine.locations().keys().copied().collect();
    let expression = Expression::of(machine.chain(), &terms(machine.chain(), false, &stated));
    let structure = machine.chain().structure();
    Described {
        text: text.to_owned(),
        structure: structure.to_string(),
        type_numbers: structure
            .type_numbers()
            .map(|numbers| [numbers.translational, numbers.rotary]),
        formula: expression.text().to_vec(),
        tool_mm: expression.tool_tip_mm(),
    }
}

fn check(form: &Form) -> Result<(), FormError> {
    let most = |what, found: usize, most| {
        if found > most {
            Err(FormError::TooMany { what, found, most })
        } else {
            Ok(())
        }
    };
    most("axes", form.axes.len(), 9)?;
    most("errors", form.errors.len(), MOST_ERRORS)?;
    most("files", form.uploads.len(), MOST_ERRORS)?;
    let mut axes = BTreeSet::new();
    for axis in &form.axes {
        if !axes.insert(axis.axis) {
            return Err(FormError::AxisTwice { axis: axis.axis });
        }
    }
    let mut errors = BTreeSet::new();
    for error in &form.errors {
        if !errors.insert(error.error.to_string()) {
            return Err(FormError::ErrorTwice { error: error.error });
        }
        let nodes = match &error.value {
            CurveForm::Number(_) => 1,
            CurveForm::Poly(list) => list.len(),
            CurveForm::Table(list) | CurveForm::Cubic(list) => list.len(),
        };
        most("nodes of a curve", nodes, MOST_NODES)?;
    }
    for upload in &form.uploads {
        // Several files of one error are lines of it, but a typed one beside them would be lost.
        if errors.contains(&upload.error.to_string()) {
            return Err(FormError::ErrorTwice {
                error: upload.error,
            });
        }
        most("bytes of a file", upload.text.len(), LARGEST_FILE)?;
    }
    Ok(())
}

fn numbers(list: impl IntoIterator<Item = f64>) -> Value {
    Value::Array(list.into_iter().map(Value::Float).collect())
}

/// The form as a machine file. Texts stand in it as values, never as parts of its syntax.
fn table(form: &Form) -> Table {
    let mut file = Table::new();
    if !form.name.is_empty() {
        file.insert("name".to_owned(), form.name.clone().into());
    }
    if let Some(correct) = &form.correct {
        let letters: Vec<Value> = correct.iter().map(|axis| axis.to_string().into()).collect();
        file.insert("correct".to_owned(), letters.into());
    }
    match &form.structure {
        StructureForm::Code { code } => {
            file.insert("structure".to_owned(), code.clone().into());
        }
        StructureForm::Type {
            translational,
            rotary,
            rotary_axes,
        } => {
            let letters: Vec<Value> = (rotary_axes.iter())
                .map(|axis| axis.to_string().into())
                .collect();
            let mut numbers = Table::new();
            numbers.insert("translational".to_owned(), i64::from(*translational).into());
            numbers.insert("rotary".to_owned(), i64::from(*rotary).into());
            numbers.insert("rotary_axes".to_owned(), letters.into());
            file.insert("type".to_owned(), numbers.into());
        }
    }
    let mut axes = Table::new();
    for axis in &form.axes {
        let mut one = Table::new();
        one.insert("travel".to_owned(), numbers(axis.travel));
        if let Some(point) = axis.point_mm {
            one.insert("point".to_owned(), numbers(point));
        }
        if let Some(modulo) = axis.modulo {
            one.insert("modulo".to_owned(), modulo.into());
        }
        axes.insert(axis.axis.to_string(), one.into());
    }
    file.insert("axes".to_owned(), axes.into());
    if let Some(tip) = form.tip_mm {
        let tool = Table::from_iter([("tip".to_owned(), numbers(tip))]);
        file.insert("tool".to_owned(), tool.into());
    }
    let errors: Table = (form.errors.iter())
        .map(|error| (error.error.to_string(), curve(&error.value)))
        .collect();
    if !errors.is_empty() {
        file.insert("errors".to_owned(), errors.into());
    }
    file
}

fn curve(value: &CurveForm) -> Value {
    let nodes = |list: &[[f64; 2]]| Value::Array(list.iter().map(|node| numbers(*node)).collect());
    let mut table = Table::new();
    match value {
        CurveForm::Number(number) => return Value::Float(*number),
        CurveForm::Poly(list) => {
            table.insert("poly".to_owned(), numbers(list.iter().copied()));
        }
        CurveForm::Table(list) => {
            table.insert("table".to_owned(), nodes(list));
        }
        CurveForm::Cubic(list) => {
            table.insert("table".to_owned(), nodes(list));
            table.insert("interpolation".to_owned(), "cubic".into());
        }
    }
    table.into()
}

/// What is wrong in the machine file of a form is told with the field of the form: nobody has seen the file.
fn field(error: ModelError) -> FormError {
    let ModelError::Input(InputError { key, message, .. }) = error else {
        return error.into();
    };
    let parts: Vec<&str> = key.split('.').collect();
    let field = match parts.as_slice() {
        ["name"] => "Name of the model".to_owned(),
        ["structure", ..] => "Structure code".to_owned(),
        ["type", "translational"] => "Linear type number".to_owned(),
        ["type", "rotary"] => "Rotary type number".to_owned(),
        ["type", "rotary_axes", ..] => "Rotary axes".to_owned(),
        ["type", ..] => "Type numbers".to_owned(),
        ["axes", axis, "travel", ..] => format!("Travels, {axis}: from and to"),
        ["axes", axis, "point", ..] => format!("Travels, {axis}: a point on its centre line"),
        ["axes", axis, ..] => format!("Travels, {axis}"),
        ["axes"] => "Travels".to_owned(),
        ["tool", ..] => "Tool tip at machine zero".to_owned(),
        ["errors", error, ..] => format!("Component error {error}"),
        _ => key,
    };
    FormError::Field { field, message }
}

/// The machine with the errors of measurement files, and what is to be read about them.
fn calibrated(machine: &Machine, uploads: &[Upload]) -> Result<(Machine, Vec<String>), FormError> {
    let folder = tempfile::tempdir()?;
    let machine_file = "the-form.toml";
    std::fs::write(folder.path().join(machine_file), machine.to_toml())?;
    let mut measurements = Vec::new();
    let mut counts: BTreeMap<String, u32> = BTreeMap::new();
    // The names as the person has chosen the files, for messages.
    let mut chosen = vec![(folder.path().join(machine_file), "the form".to_owned())];
    for upload in uploads {
        let ending = Path::new(&upload.name)
            .extension()
            .and_then(|ending| ending.to_str())
            .map(str::to_ascii_lowercase);
        let Some(ending @ ("rtl" | "rta" | "csv")) = ending.as_deref() else {
            return Err(FormError::Ending {
                name: upload.name.chars().take(80).collect(),
            });
        };
        // Its own name stays outside: a name can be a path.
        let count = counts.entry(upload.error.to_string()).or_default();
        *count += 1;
        let name = format!("{}-{count}.{ending}", upload.error);
        let path = folder.path().join(&name);
        std::fs::write(&path, &upload.text)?;
        chosen.push((path, upload.name.chars().take(80).collect()));
        let mut one = Table::new();
        one.insert("error".to_owned(), upload.error.to_string().into());
        one.insert("file".to_owned(), name.into());
        if let Some(unit) = &upload.unit {
            one.insert("unit".to_owned(), unit.clone().into());
        }
        if upload.workpiece_side {
            one.insert("sign".to_owned(), Value::Integer(-1));
        }
        if !upload.at.is_empty() {
            let at: Table = (upload.at.iter())
                .map(|(axis, at)| (axis.to_string(), Value::Float(*at)))
                .collect();
            one.insert("at".to_owned(), at.into());
        }
        measurements.push(Value::Table(one));
    }
    let mut calibration = Table::new();
    calibration.insert("machine".to_owned(), machine_file.into());
    calibration.insert("measurement".to_owned(), measurements.into());
    let path = folder.path().join("the-form-calibration.toml");
    std::fs::write(&path, toml::to_string(&calibration)?)?;
    chosen.push((path.clone(), "the measurement files".to_owned()));
    let told = |mut text: String| {
        // One path is the beginning of no other: each ends with its ending.
        for (path, name) in &chosen {
            text = text.replace(&path.display().to_string(), name);
        }
        text
    };
    let file = CalibrationFile::read(&path);
    let done = file.and_then(|file| calibrate(&file, |_, _| {}));
    let done = done.map_err(|error| FormError::Calibrate {
        told: told(error.to_string()),
        source: Box::new(error),
    })?;
    Ok((done.machine, done.warnings.into_iter().map(told).collect()))
}
