//! Reads and generates TLS certificates.

use std::{
    fs::OpenOptions,
    io::Write,
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

/// Reason why TLS cannot be set up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TlsError {
    /// A certificate or key is invalid, or the two do not match.
    #[error("{}: {source}", file.display())]
    Certificate {
        /// File with the rejected certificate or key.
        file: PathBuf,
        source: CertificateError,
    },
    /// A key cannot be read, or other users can read it.
    #[error(transparent)]
    Key(#[from] PrivateError),
    /// No certificate can be generated for the names.
    #[error("{names}: {source}")]
    Names {
        /// The requested host names and addresses, for the message.
        names: String,
        source: rcgen::Error,
    },
    /// A file exists already; existing files are never overwritten.
    #[error("{}: exists and is not replaced; name another folder, or move it away first", file.display())]
    There {
        /// Full path: the requested folder with `certificate.pem` or `key.pem`.
        file: PathBuf,
    },
    /// A file or folder cannot be written.
    #[error("{}: {source}", file.display())]
    Write {
        /// The file or folder that cannot be written.
        file: PathBuf,
        source: std::io::Error,
    },
}

/// Reason why a certificate or key is rejected.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CertificateError {
    /// The file cannot be read or is not PEM of the expected kind.
    #[error(transparent)]
    Pem(#[from] tokio_rustls::rustls::pki_types::pem::Error),
    /// TLS rejects the certificate or the key.
    #[error(transparent)]
    Tls(#[from] tokio_rustls::rustls::Error),
}

/// Acceptor that wraps a TCP connection in TLS.
pub type Tls = TlsAcceptor;

/// Reads a certificate and its key from PEM files. Only the owner of the key file may have access to it.
///
/// # Errors
/// A file cannot be read, TLS rejects the certificate or the key, the two do not match, or other users can read the
/// key.
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
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(certificates, private))
        .map_err(|e| wrong(certificate, e.into()))?;
    Ok(Tls::from(Arc::new(config)))
}

/// Generates a self-signed certificate for these host names or addresses, and its key, and writes both into the folder
/// `dir`. Returns the paths of `certificate.pem` and `key.pem`; the key has mode 0600 on Unix.
///
/// # Errors
/// A name is invalid, the folder cannot be written, or one of the files exists already.
pub fn make(dir: &Path, names: &[String]) -> Result<[PathBuf; 2], TlsError> {
    let pair = rcgen::generate_simple_self_signed(names.to_vec())
        .map_err(|source| TlsError::Names { names: names.join(", "), source })?;
    let [certificate, key] = ["certificate.pem", "key.pem"].map(|name| dir.join(name));
    let write = |path: &Path, mode: u32, text: &str| {
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
        // Windows has no file modes; the access list of the folder applies.
        #[cfg(not(unix))]
        let _ = mode;
        let file = options.open(path);
        file.and_then(|mut file| file.write_all(text.as_bytes())).map_err(failed(path))
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
