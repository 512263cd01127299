//! `volcomp fit-thermal`: temperatures and displacements over time to drift terms of the machine file.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use volcomp_fit::{
    ThermalFit, ThermalOptions, ThermalRecord, ThermalSegment, fit_thermal, refit_thermal,
};

use super::{Answer, table, table_text};
use crate::failure::Failure;

/// Finds thermal drift terms from temperatures and displacements over time
///
/// The file has a column time_s, temperatures that end in _degc and displacements that end in _um
/// or _urad; other columns are left out. Lags, penalty and sensors are chosen on the first part of the time,
/// each stretch predicted from what was before it; the rest judges them. What is printed is fitted again on all of it.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Time, temperatures and displacements: .csv
    data: PathBuf,
    /// The displacement to fit; default: all
    #[arg(long)]
    displacement: Vec<String>,
    /// The error that the displacement is, for the terms of the machine file
    #[arg(long, default_value = "EZZ")]
    error: String,
    /// Share of the time that fits; the rest judges
    #[arg(long, default_value_t = 0.7)]
    train: f64,
    /// Temperature from which the terms count, degC
    #[arg(long, default_value_t = 20.0, allow_hyphen_values = true)]
    reference: f64,
    /// Time constants to choose from, s: 0,300,900
    #[arg(long, value_delimiter = ',')]
    lags: Vec<f64>,
    /// Leave out sensors that are not missed
    #[arg(long)]
    select: bool,
}

/// A displacement, fitted plainly and with lags.
struct Channel {
    name: String,
    plain: Judged,
    lagged: Judged,
    /// The same choice fitted on all rows.
    terms: ThermalFit,
}

struct Judged {
    fit: ThermalFit,
    rms: f64,
    worst: Option<ThermalSegment>,
}

/// The columns of a file.
struct Columns {
    time_s: Vec<f64>,
    sensors: Vec<String>,
    degc: Vec<Vec<f64>>,
    displacements: Vec<(String, Vec<f64>)>,
    notes: Vec<String>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    if !(0.05..=0.95).contains(&arguments.train) {
        let message = format!("--train: found {}, expected 0.05 to 0.95", arguments.train);
        return Err(Failure::Input(message));
    }
    if !arguments.reference.is_finite() {
        return Err(Failure::Input(format!(
            "--reference: found {}, expected a temperature",
            arguments.reference
        )));
    }
    let error = arguments
        .error
        .parse::<volcomp_model::ErrorName>()
        .map_err(|e| Failure::Input(format!("--error: {e}")))?;
    let mut options = ThermalOptions {
        select_sensors: arguments.select,
        ..ThermalOptions::default()
    };
    if !arguments.lags.is_empty() {
        options.lags_s.clone_from(&arguments.lags);
    }
    let columns = read(&arguments.data)?;
    let wanted = |name: &str| {
        arguments.displacement.is_empty() || arguments.displacement.iter().any(|d| d == name)
    };
    if let Some(missing) = arguments
        .displacement
        .iter()
        .find(|d| columns.displacements.iter().all(|(name, _)| name != *d))
    {
        let known: Vec<&str> = columns
            .displacements
            .iter()
            .map(|(name, _)| name.as_str())
            .collect();
        return Err(Failure::Input(format!(
            "--displacement: found {missing}, expected one of {}",
            known.join(", ")
        )));
    }
    let chosen = columns
        .displacements
        .iter()
        .filter(|(name, _)| wanted(name));
    let channels = chosen
        .map(|(name, displacement)| channel(name, displacement, &columns, arguments, &options))
        .collect::<Result<Vec<_>, _>>()?;
    let toml =
        |channel: &Channel| terms_toml(channel, &columns.sensors, error, arguments.reference);
    let documents: Vec<Value> = channels
        .iter()
        .map(|c| json(c, &columns.sensors, arguments.reference, &toml(c)))
        .collect();
    let terms: Vec<String> = channels
        .iter()
        .map(|c| format!("\n# {}\n{}", c.name, toml(c)))
        .collect();
    Ok(Answer {
        json: json!({ "displacements": documents, "train": arguments.train, "sensors": columns.sensors }),
        text: comparison(&channels) + &terms.concat(),
        notes: columns.notes,
    })
}

fn channel(
    name: &str,
    displacement: &[f64],
    columns: &Columns,
    arguments: &Arguments,
    options: &ThermalOptions,
) -> Result<Channel, Failure> {
    let record = ThermalRecord {
        time_s: columns.time_s.clone(),
        degc: columns.degc.clone(),
        displacement: displacement.to_vec(),
    };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a share of a count"
    )]
    let train = (record.len() as f64 * arguments.train) as usize;
    let failed = |e| Failure::Input(format!("{}: {name}: {e}", arguments.data.display()));
    let judged = |options: &ThermalOptions| -> Result<Judged, Failure> {
        let fit = fit_thermal(&record, 0..train, options).map_err(failed)?;
        let (rms, worst) = fit.residual(&record, train..record.len());
        Ok(Judged { fit, rms, worst })
    };
    let lagged = judged(options)?;
    Ok(Channel {
        name: name.to_owned(),
        plain: judged(&ThermalOptions::plain())?,
        terms: refit_thermal(&record, 0..record.len(), options, &lagged.fit.choices)
            .map_err(failed)?,
        lagged,
    })
}

fn read(path: &Path) -> Result<Columns, Failure> {
    let wrong = |what: String| Failure::Input(format!("{}: {what}", path.display()));
    let mut reader = csv::Reader::from_path(path).map_err(|e| wrong(e.to_string()))?;
    let header = reader.headers().map_err(|e| wrong(e.to_string()))?.clone();
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); header.len()];
    let is_used = |name: &str| {
        name == "time_s"
            || ["_degc", "_um", "_urad"]
                .iter()
                .any(|end| name.ends_with(end))
    };
    for record in reader.records() {
        let record = record.map_err(|e| wrong(e.to_string()))?;
        let line = record.position().map_or(0, csv::Position::line);
        for ((column, field), name) in columns.iter_mut().zip(&record).zip(&header) {
            if is_used(name) {
                let number = field.trim().parse::<f64>().ok().filter(|x| x.is_finite());
                let number = number.ok_or_else(|| {
                    wrong(format!(
                        "line {line}, {name}: found `{field}`, expected a finite number"
                    ))
                })?;
                column.push(number);
            }
        }
    }
    let mut found = Columns {
        time_s: Vec::new(),
        sensors: Vec::new(),
        degc: Vec::new(),
        displacements: Vec::new(),
        notes: Vec::new(),
    };
    for (name, column) in header.iter().zip(columns) {
        if name == "time_s" {
            found.time_s = column;
        } else if let Some(sensor) = name.strip_suffix("_degc") {
            found.sensors.push(sensor.to_owned());
            found.degc.push(column);
        } else if is_used(name) {
            found.displacements.push((name.to_owned(), column));
        }
    }
    let missing = if found.time_s.is_empty() {
        "column time_s with a time in each row"
    } else if found.sensors.is_empty() {
        "temperature: a column that ends in _degc"
    } else if found.displacements.is_empty() {
        "displacement: a column that ends in _um or _urad"
    } else {
        let repeated = spread_repeated(&mut found.time_s)
            .map_err(|row| wrong(format!("line {}: the time goes back", row + 2)))?;
        if repeated > 0 {
            found.notes.push(format!(
                "{repeated} rows repeat the time of the row before (too few digits): spread evenly"
            ));
        }
        return Ok(found);
    };
    Err(wrong(format!(
        "found no {missing}; the columns are {}",
        header.iter().collect::<Vec<_>>().join(", ")
    )))
}

/// Rows with one time are spread evenly up to the next: some loggers write too few digits. How many there were;
/// or the row at which time goes back.
fn spread_repeated(time_s: &mut [f64]) -> Result<usize, usize> {
    if let Some(row) = (1..time_s.len()).find(|&row| time_s[row] < time_s[row - 1]) {
        return Err(row);
    }
    let (mut from, mut repeated, mut spacing_s) = (0, 0, 1.0);
    while from < time_s.len() {
        let same = time_s[from..]
            .iter()
            .take_while(|t| **t == time_s[from])
            .count();
        if let Some(next) = time_s.get(from + same) {
            spacing_s = (next - time_s[from]) / same as f64;
        }
        for (place, time) in time_s[from..from + same].iter_mut().enumerate() {
            *time += spacing_s * place as f64;
        }
        repeated += same - 1;
        from += same;
    }
    Ok(repeated)
}

/// The terms as `[[thermal.drift]]`, and the constant that belongs to them.
fn terms_toml(
    channel: &Channel,
    sensors: &[String],
    error: volcomp_model::ErrorName,
    reference_degc: f64,
) -> String {
    use std::fmt::Write;
    let unit = if channel.name.ends_with("_urad") {
        "urad"
    } else {
        "um"
    };
    let mut text = format!(
        "# with {reference_degc} degC as [thermal] reference; the constant {:.3} {unit} belongs to the curve of {error}\n",
        channel.terms.constant_at(reference_degc)
    );
    for term in &channel.terms.terms {
        let weighted = sensors
            .iter()
            .zip(&term.per_k)
            .filter(|(_, per_k)| **per_k != 0.0);
        let weights: Vec<String> = weighted
            .map(|(name, per_k)| format!("{name} = {per_k:.6}"))
            .collect();
        // Writing to a string never fails.
        let _ = write!(
            text,
            "[[thermal.drift]]\nerror = \"{error}\"\nsensors = {{ {} }}\n{unit}_per_k = 1.0\nlag_s = {:.1}\n",
            weights.join(", "),
            term.lag_s
        );
    }
    text
}

fn json(channel: &Channel, sensors: &[String], reference_degc: f64, toml: &str) -> Value {
    let segment = |worst: &Option<ThermalSegment>| {
        worst.map(|w| json!({ "from_s": w.from_s, "to_s": w.to_s, "rms_um": w.rms }))
    };
    let judged = |judged: &Judged| {
        json!({
            "rms_um": judged.rms,
            "worst_segment": segment(&judged.worst),
            "forward_rms_um": judged.fit.forward_rms,
            "penalties": judged.fit.choices.iter().map(|choice| choice.penalty).collect::<Vec<_>>(),
            "lags_s": judged.fit.terms.iter().map(|term| term.lag_s).collect::<Vec<_>>(),
            "sensors": judged.fit.sensors().iter().map(|&s| &sensors[s]).collect::<Vec<_>>(),
        })
    };
    let drift = channel.terms.terms.iter().map(|term| {
        let weights: serde_json::Map<String, Value> = sensors
            .iter()
            .cloned()
            .zip(term.per_k.iter().map(|k| json!(k)))
            .collect();
        json!({ "lag_s": term.lag_s, "sensors": weights })
    });
    json!({
        "name": channel.name,
        "baseline": judged(&channel.plain),
        "fit": judged(&channel.lagged),
        "drift": drift.collect::<Vec<_>>(),
        "constant_um": channel.terms.constant_at(reference_degc),
        "toml": toml,
    })
}

fn comparison(channels: &[Channel]) -> String {
    let mut lines = table(&[
        "rms on the last part",
        "plain ridge",
        "with lags",
        "",
        "worst",
        "from, h",
        "lags, s",
        "sensors",
    ]);
    for Channel {
        name,
        plain,
        lagged,
        ..
    } in channels
    {
        let lags = lagged.fit.terms.iter().map(|term| term.lag_s);
        let [shortest, longest] = [
            lags.clone().fold(f64::INFINITY, f64::min),
            lags.fold(0.0, f64::max),
        ];
        lines.add_row([
            name.clone(),
            format!("{:.2}", plain.rms),
            format!("{:.2}", lagged.rms),
            format!("{:.0} %", 100.0 * (lagged.rms / plain.rms - 1.0)),
            lagged
                .worst
                .map_or(String::new(), |w| format!("{:.2}", w.rms)),
            lagged
                .worst
                .map_or(String::new(), |w| format!("{:.1}", w.from_s / 3600.0)),
            format!("{shortest} to {longest}"),
            format!("{}", lagged.fit.sensors().len()),
        ]);
    }
    table_text(&lines)
}
