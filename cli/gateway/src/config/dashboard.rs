//! The tables `[dashboard]` and `[realtime]`.

use std::path::Path;
use volcomp_document::{InputError, Section};
use volcomp_runtime::Realtime;

use super::DashboardConfig;

pub(super) fn dashboard(
    section: &Section<'_>,
    folder: &Path,
) -> Result<DashboardConfig, InputError> {
    section.allow(&[
        "listen",
        "token_file",
        "tls_certificate",
        "tls_key",
        "hosts",
    ])?;
    let path =
        |key: &str| section.optional(key, |value| Ok::<_, InputError>(folder.join(value.text()?)));
    let listen = match section.get("listen") {
        None => DashboardConfig::default().listen,
        Some(value) => {
            let text = value.text()?;
            text.parse().map_err(|_| {
                value.error(format!(
                    "found `{text}`, expected an address and port such as 127.0.0.1:8080"
                ))
            })?
        }
    };
    let tls = match (path("tls_certificate")?, path("tls_key")?) {
        (Some(certificate), Some(key)) => Some((certificate, key)),
        (None, None) => None,
        _ => {
            return Err(
                section.error("found one of tls_certificate and tls_key, expected both or neither")
            );
        }
    };
    let hosts = section
        .get("hosts")
        .map(|value| value.texts())
        .transpose()?
        .unwrap_or_default();
    Ok(DashboardConfig {
        listen,
        token_file: path("token_file")?,
        tls,
        hosts: hosts.into_iter().map(str::to_owned).collect(),
    })
}

pub(super) fn realtime(section: &Section<'_>) -> Result<Realtime, InputError> {
    section.allow(&["priority", "cpu", "reference"])?;
    Ok(Realtime {
        priority: section.whole_or("priority", 0..=99, 60)?,
        cpu: section.optional("cpu", |value| value.count(1023))?,
        reference: section.truth_or("reference", false)?,
    })
}
