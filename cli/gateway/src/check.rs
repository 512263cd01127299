//! What `check` prints: the plan of a configuration, or those of several machines and what they have in common.

use std::{fmt::Write, path::Path};

use crate::{
    config::{ConfigFile, Several},
    documents::{MachinesPlan, MemberPlan, OverviewPlan, PlanDocument},
    error::GatewayError,
    options::Options,
    plan::{self, Plan},
    run::{members, together},
};

/// Checks a configuration, or the file of several machines, of which `machine` chooses one. `online` asks the controls, too.
///
/// # Errors
/// The first thing that is wrong.
pub fn check(
    path: &Path,
    machine: Option<&str>,
    online: bool,
    json: bool,
) -> Result<String, GatewayError> {
    match (ConfigFile::read(path)?, machine) {
        (ConfigFile::Several(several), None) => check_several(&several, online, json),
        (file, machine) => {
            let plan = Plan::new(file.machine(machine)?)?;
            let found = document(&plan, online)?;
            if json {
                line(&found)
            } else {
                Ok(plan.text_of(&found))
            }
        }
    }
}

fn document(plan: &Plan, online: bool) -> Result<PlanDocument, GatewayError> {
    if online {
        plan.online()
    } else {
        Ok(plan.document())
    }
}

fn check_several(several: &Several, online: bool, json: bool) -> Result<String, GatewayError> {
    let members = members(several, &Options::default());
    let of = |name: &str, source| GatewayError::OfMachine {
        name: name.to_owned(),
        source: Box::new(source),
    };
    together(several, &members)?;
    let (tokens, tls) = plan::dashboard(&several.dashboard)?;
    let overview = OverviewPlan {
        listen: several.dashboard.listen.to_string(),
        tls: tls.is_some(),
        reading_needs_token: several.dashboard.reading_needs_token(),
        tokens: tokens.plan(),
    };
    let mut text = String::new();
    let mut machines = Vec::new();
    for (entry, member) in several.machines.iter().zip(members) {
        let plan = member.plan.map_err(|source| of(&entry.name, source))?;
        let found = document(&plan, online).map_err(|source| of(&entry.name, source))?;
        // Writing to a string never fails.
        let _ = writeln!(text, "{} ({})", entry.name, entry.config.display());
        let _ = writeln!(text, "{}", plan.text_of(&found));
        machines.push(MemberPlan {
            name: entry.name.clone(),
            config: entry.config.display().to_string(),
            plan: found,
        });
    }
    let yes_no = |yes: bool| if yes { "yes" } else { "no" };
    let reading = if overview.reading_needs_token {
        "needs a token"
    } else {
        "open to programs on this computer"
    };
    for (label, value) in [
        ("overview", overview.listen.as_str()),
        ("  TLS", yes_no(overview.tls)),
        ("  reading", reading),
    ] {
        let _ = writeln!(text, "{label:<22}{value}");
    }
    for token in &overview.tokens {
        let _ = writeln!(
            text,
            "{:<22}{}",
            format!("  token {}", token.name),
            token.role
        );
    }
    if json {
        line(&MachinesPlan { machines, overview })
    } else {
        Ok(text)
    }
}

/// A document as one line.
///
/// # Errors
/// None for a document of the gateway.
pub fn line(document: &impl serde::Serialize) -> Result<String, GatewayError> {
    let text = serde_json::to_string(document);
    let text = text.map_err(|e| GatewayError::system("JSON", e.into()))?;
    Ok(text + "\n")
}
