//! An edge node of Sparkplug B: the gateway tells a broker what changes, and the broker tells others when the gateway is gone.

use std::time::SystemTime;

use super::{quantities::Shape, runtime};
use crate::{config::SparkplugConfig, error::GatewayError, published::Published};

mod credentials;
pub mod node;
mod payload;
mod session;

pub use credentials::Credentials;
use node::{Names, Node};

/// A node that connects once there is something to tell.
pub(super) struct Prepared {
    config: SparkplugConfig,
    credentials: Credentials,
}

impl Prepared {
    pub(super) fn new(config: &SparkplugConfig) -> Result<Self, GatewayError> {
        Ok(Self {
            credentials: Credentials::read(config)?,
            config: config.clone(),
        })
    }

    pub(super) fn run(
        self,
        shape: &Shape,
        published: Published,
    ) -> Result<runtime::Serving, GatewayError> {
        let names = Names {
            group: self.config.group.clone(),
            node: self.config.node.clone(),
            device: self.config.device_or(&shape.machine),
        };
        // Another number than that of the life before a restart, which the broker may still have to tell the end of.
        let first = payload::millis(SystemTime::now()) / 1000 % 256;
        let first = u8::try_from(first).unwrap_or_default();
        let node = Node::new(names, shape, self.config.deadbands, first);
        let session = session::run(self.config, self.credentials, node, published);
        runtime::start("volcomp-mqtt", session)
    }
}
