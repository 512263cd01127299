//! The certificate of a page: read, and made.

use std::{
    fs::OpenOptions,
    io::Write,
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
    sync::Arc,
};

use tokio_rustls::{
    TlsAcceptor,
    rustls::{
        ServerConfig,
        crypto::ring,
        pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject},
    },
};

use volcomp_document::{PrivateError, private};

/// Why there is no TLS.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TlsError {
    /// A certificate or key that is none, or that do not belong together.
    #[error("{}: {source}", file.display())]
    Certificate {
        /// The path of the file.
        file: PathBuf,
        /// The reason why it is refused.
        source: CertificateError,
    },
    /// A key that cannot be read, or that others can read.
    #[error(transparent)]
    Key(#[from] PrivateError),
    /// Names for which no certificate can be made.
    #[error("{names}: {source}")]
    Names {
        /// The names, as they were given.
        names: String,
        /// The reason why no certificate is made.
        source: rcgen::Error,
    },
    /// A file that is there: it is never written over.
    #[error("{}: there already, kept; expected another folder, or that it is moved away first", file.display())]
    There {
        /// The path of the file.
        file: PathBuf,
    },
    /// A file or folder that cannot be written.
    #[error("{}: {source}", file.display())]
    Write {
        /// The path of the file or folder.
        file: PathBuf,
        /// Why the operating system refused it.
        source: std::io::Error,
    },
}

/// The reason why a certificate or key is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CertificateError {
    /// The file cannot be read or is no PEM of that kind.
    #[error(transparent)]
    Pem(#[from] tokio_rustls::rustls::pki_types::pem::Error),
    /// TLS does not take it.
    #[error(transparent)]
    Tls(#[from] tokio_rustls::rustls::Error),
}

/// The acceptor that turns a TCP connection into one with TLS.
pub type Tls = TlsAcceptor;

/// Reads a certificate and its key, PEM. Nobody but its owner may read the key.
///
/// # Errors
/// Files that cannot be read or do not belong together; a key that others may read.
pub fn acceptor(certificate: &Path, key: &Path) -> Result<Tls, TlsError> {
    let wrong = |path: &Path, source: CertificateError| TlsError::Certificate {
        file: path.to_owned(),
        source,
    };
    let certificates = CertificateDer::pem_file_iter(certificate)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|e| wrong(certificate, e.into()))?;
    let private = private::read(key)?;
    let private = PrivateKeyDer::from_pem_slice(private.as_bytes());
    let private = private.map_err(|e| wrong(key, e.into()))?;
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| {
            builder
                .with_no_client_auth()
                .with_single_cert(certificates, private)
        })
        .map_err(|e| wrong(certificate, e.into()))?;
    Ok(Tls::from(Arc::new(config)))
}

/// Makes a self-signed certificate for some names or addresses, with its key (mode 0600), in a folder. Files that are there stay.
///
/// # Errors
/// Names that are none, a folder that cannot be written, files that are there already.
pub fn make(dir: &Path, names: &[String]) -> Result<[PathBuf; 2], TlsError> {
    let pair =
        rcgen::generate_simple_self_signed(names.to_vec()).map_err(|source| TlsError::Names {
            names: names.join(", "),
            source,
        })?;
    let [certificate, key] = ["certificate.pem", "key.pem"].map(|name| dir.join(name));
    let write = |path: &Path, mode: u32, text: &str| {
        let mut options = OpenOptions::new();
        let file = options.write(true).create_new(true).mode(mode).open(path);
        file.and_then(|mut file| file.write_all(text.as_bytes()))
            .map_err(failed(path))
    };
    std::fs::create_dir_all(dir).map_err(failed(dir))?;
    write(&key, 0o600, &pair.signing_key.serialize_pem())?;
    write(&certificate, 0o644, &pair.cert.pem())?;
    Ok([certificate, key])
}

fn failed(file: &Path) -> impl FnOnce(std::io::Error) -> TlsError {
    let file = file.to_owned();
    move |source| match source.kind() {
        std::io::ErrorKind::AlreadyExists => TlsError::There { file },
        _ => TlsError::Write { file, source },
    }
}
