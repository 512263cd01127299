//! Data for the records, in addition to the results of a rehearsal: time, place, configuration and limits.

use std::{env, fs, time::Duration};

use sha2::{Digest, Sha256};
use volcomp_guard::barrier::Settings;
use volcomp_runtime::PathPlan;
use volcomp_vocabulary::AxisKind;

use super::judge::in_shown_unit;
use crate::{
    audit::utc_now,
    documents::{AxisBounds, RehearsedBarrier, RehearsedLimits, round},
    error::GatewayError,
};

/// Time, place, user and configuration of a rehearsal.
pub(super) struct Head {
    pub(super) time: String,
    pub(super) user: String,
    pub(super) host: String,
    pub(super) config_hash: String,
}

impl Head {
    /// Collects the data of a rehearsal that starts now.
    ///
    /// # Errors
    /// The configuration cannot be read any more.
    pub(super) fn of(config: &str) -> Result<Self, GatewayError> {
        let text = fs::read(config).map_err(|source| GatewayError::Read {
            file: config.to_owned(),
            source,
        })?;
        let mut names = ["USER", "LOGNAME"].into_iter();
        let user = names.find_map(|name| env::var(name).ok());
        let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        Ok(Self {
            time: utc_now(),
            user: user.unwrap_or_else(|| format!("uid {}", rustix::process::getuid().as_raw())),
            host: host.trim().to_owned(),
            config_hash: format!("sha256:{}", crate::hex(&Sha256::digest(&text))),
        })
    }
}

pub(super) fn ms(time: Duration) -> f64 {
    round(time.as_secs_f64() * 1e3)
}

/// The barrier in the control, for the document.
pub(super) fn barrier(path: &PathPlan, settings: Option<&Settings>) -> Option<RehearsedBarrier> {
    let (settings, scan) = (settings?, path.barrier?.scan);
    Some(RehearsedBarrier {
        machine: settings.machine,
        scan_ms: ms(scan),
        hold_ms: ms(scan * u32::from(settings.hold_scans)),
        time_out_ms: ms(scan * u32::from(settings.time_out_scans)),
    })
}

/// The limits that apply, in display units.
pub(super) fn limits(path: &PathPlan, barrier: Option<&Settings>) -> Vec<RehearsedLimits> {
    let step_s = |settings: &Settings| {
        let scan = path.barrier.map(|barrier| barrier.scan);
        scan.unwrap_or_default().as_secs_f64() * f64::from(settings.step_scans)
    };
    let axes = path.description.axes.iter().zip(&path.limits.axes);
    let of_axis = |(place, (axis, limits)): (usize, (&volcomp_port::Axis, &_))| {
        let limits: &volcomp_guard::AxisLimits = limits;
        let shown = |value: f64| round(value * in_shown_unit(axis.kind()));
        let rate = barrier
            .map(|settings| f64::from(settings.rate[place]) * limits.resolution / step_s(settings));
        let bounds = AxisBounds {
            limit: shown(limits.reachable()),
            slew_per_s: shown(limits.slew_per_s),
            accel_per_s2: limits
                .accel_per_s2
                .is_finite()
                .then(|| shown(limits.accel_per_s2)),
            step: shown(limits.resolution),
            barrier_per_s: rate.map(shown),
        };
        let is_linear = axis.kind() == AxisKind::Linear;
        RehearsedLimits {
            axis: axis.name,
            um: is_linear.then_some(bounds),
            urad: (!is_linear).then_some(bounds),
        }
    };
    axes.enumerate().map(of_axis).collect()
}
