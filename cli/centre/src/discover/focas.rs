//! A FANUC control: its type, its software and its axis letters.

use std::{net::SocketAddr, time::Duration};

use volcomp_focas::{Client, FocasError};

use super::{Device, Kind, clean};

/// Queries the control on a blocking thread; each request has the timeout `at_most`.
pub(super) async fn probe(at: SocketAddr, at_most: Duration) -> Device {
    let asked = tokio::task::spawn_blocking(move || questions(at, at_most)).await;
    match asked {
        Ok(Ok(device)) => device,
        Ok(Err(error)) => Device::other(at, Kind::Focas, error.to_string()),
        Err(_) => Device::other(at, Kind::Focas, "the question failed"),
    }
}

fn questions(at: SocketAddr, at_most: Duration) -> Result<Device, FocasError> {
    let mut client = Client::open(&at.ip().to_string(), at.port(), at_most)?;
    let mut device = Device::at(at, Kind::Focas);
    let info = client.system_info()?;
    device.control = clean(&format!(
        "FANUC {} {} series {} {}",
        info.cnc_type, info.machine_type, info.series, info.version
    ));
    // A control that reports its type but not its axes is still a control.
    match client.axis_names() {
        Ok(mut names) => {
            // Use as many names as the path reports axes: some controls return unused slots with arbitrary letters
            // after them.
            if let Ok(count) = info.axes.trim().parse::<usize>()
                && count > 0
            {
                names.truncate(count);
            }
            names.truncate(32);
            device.axes = names;
        }
        Err(error) => device.note = clean(&error.to_string()),
    }
    Ok(device)
}
