//! What the broker and the gateway know of one another: the user with its password, and the authority of the broker's
//! certificate.

use std::sync::Arc;

use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, RootCertStore,
        crypto::ring,
        pki_types::{
            CertificateDer, ServerName,
            pem::{self, PemObject},
        },
    },
};

use volcomp_web::{CertificateError, TlsError};

use crate::{config::SparkplugConfig, error::GatewayError};

/// What a connection needs besides its address.
pub struct Credentials {
    /// User and password.
    pub(super) login: Option<(String, String)>,
    /// TLS, where it is asked for, and the name that the broker's certificate must have.
    pub(super) tls: Option<(TlsConnector, ServerName<'static>)>,
}

impl Credentials {
    /// Reads the files that a configuration names.
    ///
    /// # Errors
    /// A file that cannot be read, a password that others may read, a certificate that is none.
    pub fn read(config: &SparkplugConfig) -> Result<Self, GatewayError> {
        let login = match (&config.user, &config.password_file) {
            (Some(user), Some(file)) => {
                let password = volcomp_document::private::read(file)?;
                let password = password.lines().next().unwrap_or_default();
                Some((user.clone(), password.to_owned()))
            }
            _ => None,
        };
        let tls = config.ca.as_ref().map(|file| {
            let wrong = |source: CertificateError| {
                GatewayError::from(TlsError::Certificate {
                    file: file.clone(),
                    source,
                })
            };
            let mut roots = RootCertStore::empty();
            let certificates = CertificateDer::pem_file_iter(file).map_err(|e| wrong(e.into()))?;
            for certificate in certificates {
                let certificate = certificate.map_err(|e| wrong(e.into()))?;
                roots.add(certificate).map_err(|e| wrong(e.into()))?;
            }
            if roots.is_empty() {
                return Err(wrong(pem::Error::NoItemsFound.into()));
            }
            let tls = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
                .with_safe_default_protocol_versions()
                .map_err(|e| wrong(e.into()))?
                .with_root_certificates(roots)
                .with_no_client_auth();
            let name = ServerName::try_from(config.host.clone()).map_err(|_| {
                let text = format!(
                    "sparkplug: the host {} has no name that a certificate can have",
                    config.host
                );
                GatewayError::system(text, std::io::ErrorKind::InvalidInput.into())
            })?;
            Ok::<_, GatewayError>((TlsConnector::from(Arc::new(tls)), name))
        });
        Ok(Self {
            login,
            tls: tls.transpose()?,
        })
    }
}
