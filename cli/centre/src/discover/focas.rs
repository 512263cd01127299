//! A FANUC control: its type, its software and the letters of its axes.

use std::{net::SocketAddr, time::Duration};

use volcomp_focas::{Client, FocasError};

use super::{Device, Kind, clean};

/// Asks on a thread that may wait; every question is answered within `at_most`.
pub(super) async fn ask(at: SocketAddr, at_most: Duration) -> Device {
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
    // A control that tells its type, but not its axes, is a control all the same.
    match client.axis_names() {
        Ok(mut names) => {
            // As many as the path says that it has: behind them some controls have slots with letters of nothing.
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
