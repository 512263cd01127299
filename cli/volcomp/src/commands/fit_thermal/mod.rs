//! `volcomp fit-thermal`: temperatures and displacements over time to drift terms of the machine file.

mod columns;
mod text;

use std::path::PathBuf;

use volcomp_fit::{
    ThermalFit, ThermalOptions, ThermalRecord, ThermalSegment, fit_thermal, refit_thermal,
};

use volcomp_model::POSSIBLE_DEGC;

use self::{
    columns::Columns,
    text::{comparison, terms_toml},
};
use super::Answer;
use crate::{
    answers::fit_thermal::{Displacement, DriftTerm, FitThermal, Prediction, Segment},
    failure::Failure,
};

/// Finds thermal drift terms from temperatures and displacements over time
///
/// The file has a column time_s, temperatures in columns that end in _degc and displacements in columns that end in
/// _um or _urad; other columns are not read. Time constants, penalty and sensors are chosen on the first part of the
/// time, each stretch predicted from what came before it; the rest of the time shows how well the fit predicts. The
/// terms that are printed are fitted once more on the whole time.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Time, temperatures and displacements: .csv
    data: PathBuf,
    /// Column with the displacement to fit, more than once for several; without it all are fitted
    #[arg(long)]
    displacement: Vec<String>,
    /// The error that the displacement is, for the terms of the machine file
    #[arg(long, default_value = "EZZ")]
    error: String,
    /// Share of the time on which the terms are fitted, 0.05 to 0.95; the rest is predicted
    #[arg(long, default_value_t = 0.7)]
    train: f64,
    /// Temperature at which the terms are zero, °C
    #[arg(long, default_value_t = 20.0, allow_hyphen_values = true)]
    reference: f64,
    /// Time constants to choose from, s: 0,300,900
    #[arg(long, value_delimiter = ',')]
    lags: Vec<f64>,
    /// Drop sensors without which the prediction is no worse
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

/// A fit on the first part of the time, and how well it predicts the rest.
struct Judged {
    fit: ThermalFit,
    /// Root mean square error of the prediction, µm or µrad.
    rms: f64,
    worst: Option<ThermalSegment>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    if !(0.05..=0.95).contains(&arguments.train) {
        let message = format!("--train: found {}, expected 0.05 to 0.95", arguments.train);
        return Err(Failure::Input(message));
    }
    if !POSSIBLE_DEGC.contains(&arguments.reference) {
        return Err(Failure::Input(format!(
            "--reference: found {}, expected {} to {} °C",
            arguments.reference,
            POSSIBLE_DEGC.start(),
            POSSIBLE_DEGC.end()
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
    let columns = columns::read(&arguments.data)?;
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
    let documents = channels
        .iter()
        .map(|c| document(c, &columns.sensors, arguments.reference, toml(c)));
    let document = FitThermal {
        displacements: documents.collect(),
        train: arguments.train,
        sensors: columns.sensors.clone(),
    };
    let terms: Vec<String> = channels
        .iter()
        .map(|c| format!("\n# {}\n{}", c.name, toml(c)))
        .collect();
    Answer::new(
        &document,
        comparison(&channels) + &terms.concat(),
        columns.notes.clone(),
    )
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
    let failed = |e| Failure::in_file(&arguments.data, format_args!("{name}: {e}"));
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

fn document(
    channel: &Channel,
    sensors: &[String],
    reference_degc: f64,
    toml: String,
) -> Displacement {
    let angular = channel.is_angular();
    let in_um = |value: f64| (!angular).then_some(value);
    let in_urad = |value: f64| angular.then_some(value);
    let prediction = |judged: &Judged| Prediction {
        rms_um: in_um(judged.rms),
        rms_urad: in_urad(judged.rms),
        worst_segment: judged.worst.as_ref().map(|worst| Segment {
            from_s: worst.from_s,
            to_s: worst.to_s,
            rms_um: in_um(worst.rms),
            rms_urad: in_urad(worst.rms),
        }),
        forward_rms_um: in_um(judged.fit.forward_rms),
        forward_rms_urad: in_urad(judged.fit.forward_rms),
        penalties: judged.fit.choices.iter().map(|c| c.penalty).collect(),
        lags_s: judged.fit.terms.iter().map(|term| term.lag_s).collect(),
        sensors: judged
            .fit
            .sensors()
            .iter()
            .filter_map(|&sensor| sensors.get(sensor).cloned())
            .collect(),
    };
    let constant = channel.terms.constant_at(reference_degc);
    Displacement {
        name: channel.name.clone(),
        baseline: prediction(&channel.plain),
        fit: prediction(&channel.lagged),
        drift: channel
            .terms
            .terms
            .iter()
            .map(|term| DriftTerm {
                lag_s: term.lag_s,
                sensors: sensors
                    .iter()
                    .cloned()
                    .zip(term.per_k.iter().copied())
                    .collect(),
            })
            .collect(),
        constant_um: in_um(constant),
        constant_urad: in_urad(constant),
        toml,
    }
}
