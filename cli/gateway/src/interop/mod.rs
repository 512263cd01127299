//! Other systems that read the gateway, each over its own way and on a thread of its own. Nothing that comes over these ways
//! commands anything.
#![cfg_attr(
    not(any(feature = "shdr", feature = "opc-ua-server")),
    allow(unused_variables, reason = "without any way there is nothing to do")
)]

use crate::{config::Config, error::GatewayError, published::Published};

pub mod alarms;
#[cfg(feature = "opc-ua-server")]
mod opc_ua;
pub mod quantities;
#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
mod runtime;
#[cfg(feature = "shdr")]
pub mod shdr;

use quantities::Shape;

/// The ways that are configured, with their sockets and files; nobody is served yet.
pub struct Interop {
    #[cfg(feature = "shdr")]
    shdr: Option<shdr::Bound>,
    #[cfg(feature = "opc-ua-server")]
    opc_ua: Option<opc_ua::Bound>,
}

impl Interop {
    /// Opens sockets and reads files.
    ///
    /// # Errors
    /// An address at which this computer does not let it listen, or a file that cannot be used.
    pub fn open(config: &Config) -> Result<Self, GatewayError> {
        Ok(Self {
            #[cfg(feature = "shdr")]
            shdr: config.shdr.as_ref().map(shdr::Bound::new).transpose()?,
            #[cfg(feature = "opc-ua-server")]
            opc_ua: (config.opc_ua.as_ref())
                .map(opc_ua::Bound::new)
                .transpose()?,
        })
    }

    /// Serves until what is returned is dropped.
    ///
    /// # Errors
    /// A thread that cannot be started.
    pub fn serve(self, shape: &Shape, published: &Published) -> Result<Served, GatewayError> {
        Ok(Served {
            #[cfg(feature = "shdr")]
            _shdr: (self.shdr)
                .map(|shdr| shdr.serve(shape, published.clone()))
                .transpose()?,
            #[cfg(feature = "opc-ua-server")]
            _opc_ua: (self.opc_ua)
                .map(|opc_ua| opc_ua.serve(shape, published))
                .transpose()?,
        })
    }
}

/// The threads of the ways. They end, and their sockets close, when this is dropped.
pub struct Served {
    #[cfg(feature = "shdr")]
    _shdr: Option<runtime::Serving>,
    #[cfg(feature = "opc-ua-server")]
    _opc_ua: Option<runtime::Serving>,
}
