//! The words of a map in a control of either make.

use std::time::Duration;

use volcomp_devices::Address;
use volcomp_focas::FocasError;
use volcomp_tables::{
    Exchange,
    control::{FRAME_WORDS, REPORT_WORDS},
};

use crate::{
    config::{MapControl, MapSender},
    error::GatewayError,
};

/// Between two frames to a PMC: far within every time-out, and little beside the scans of its ladder.
const PMC_PERIOD: Duration = Duration::from_millis(50);

/// Where the words lie, and how they are reached.
pub(super) enum Place {
    /// In a SINUMERIK, over OPC UA.
    #[cfg(feature = "sinumerik")]
    Sinumerik {
        server: Box<volcomp_sinumerik::Server>,
        nodes: volcomp_sinumerik::MapNodes,
        capacity: usize,
    },
    /// In a FANUC control, over FOCAS.
    Fanuc {
        host: String,
        port: u16,
        at_most: Duration,
        places: volcomp_focas::MapPlaces,
    },
}

/// An open session to a control.
pub(super) enum Words {
    #[cfg(feature = "sinumerik")]
    Sinumerik(volcomp_sinumerik::MapWords),
    Fanuc(Box<volcomp_focas::MapWords>),
}

/// Why words do not get through.
#[derive(Debug, thiserror::Error)]
pub(super) enum WordsError {
    #[cfg(feature = "sinumerik")]
    #[error(transparent)]
    Sinumerik(#[from] volcomp_sinumerik::SinumerikError),
    #[error(transparent)]
    Fanuc(#[from] FocasError),
}

impl Place {
    /// Where the control of a sender is.
    ///
    /// # Errors
    /// A password file that cannot be read, a build without OPC UA.
    pub(super) fn of(config: &MapSender) -> Result<Self, GatewayError> {
        let address = Address::parse(&config.url).map_err(GatewayError::Device)?;
        match &config.control {
            #[cfg(feature = "sinumerik")]
            MapControl::Sinumerik { server, nodes } => Ok(Self::Sinumerik {
                server: Box::new(
                    crate::sinumerik::server(&address, server).map_err(GatewayError::Device)?,
                ),
                nodes: nodes.clone(),
                capacity: config.allowed.capacity,
            }),
            #[cfg(not(feature = "sinumerik"))]
            MapControl::Sinumerik { server, .. } => {
                let none = crate::sinumerik::server(&address, server);
                Err(
                    none.map_or_else(GatewayError::Device, |_| GatewayError::MapEnded {
                        url: config.url.clone(),
                        what: "this build of the gateway has no OPC UA".to_owned(),
                    }),
                )
            }
            MapControl::Fanuc { at_most, places } => Ok(Self::Fanuc {
                host: address.host.clone(),
                port: address.port.unwrap_or(volcomp_focas::PORT),
                at_most: *at_most,
                places: *places,
            }),
        }
    }

    /// How long to wait between two frames that keep a map.
    pub(super) fn period(&self) -> Duration {
        match self {
            #[cfg(feature = "sinumerik")]
            Self::Sinumerik { server, .. } => server.period,
            Self::Fanuc { .. } => PMC_PERIOD,
        }
    }

    /// Connects.
    ///
    /// # Errors
    /// The control does not answer, or refuses.
    pub(super) fn open(&self) -> Result<Words, WordsError> {
        Ok(match self {
            #[cfg(feature = "sinumerik")]
            Self::Sinumerik {
                server,
                nodes,
                capacity,
            } => Words::Sinumerik(volcomp_sinumerik::MapWords::open(
                server,
                nodes.clone(),
                *capacity,
            )?),
            Self::Fanuc {
                host,
                port,
                at_most,
                places,
            } => {
                let words = volcomp_focas::MapWords::open(host, *port, *at_most, *places)?;
                Words::Fanuc(Box::new(words))
            }
        })
    }
}

impl Words {
    /// Ends the session in good order.
    pub(super) fn close(self) {
        match self {
            #[cfg(feature = "sinumerik")]
            Self::Sinumerik(words) => words.close(),
            // It closes when it is dropped.
            Self::Fanuc(_) => {}
        }
    }
}

impl Exchange for Words {
    type Error = WordsError;

    fn report(&mut self) -> Result<Vec<u16>, WordsError> {
        Ok(match self {
            #[cfg(feature = "sinumerik")]
            Self::Sinumerik(words) => words.report()?,
            Self::Fanuc(words) => words.report(REPORT_WORDS)?,
        })
    }

    fn write(&mut self, frame: &[u16; FRAME_WORDS]) -> Result<(), WordsError> {
        match self {
            #[cfg(feature = "sinumerik")]
            Self::Sinumerik(words) => words.write(frame)?,
            Self::Fanuc(words) => words.write(frame)?,
        }
        Ok(())
    }

    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, WordsError> {
        Ok(match self {
            #[cfg(feature = "sinumerik")]
            Self::Sinumerik(words) => words.buffer(buffer, count)?,
            Self::Fanuc(words) => words.buffer(buffer, count)?,
        })
    }
}
