//! Certificates of a secure connection: the client's own certificate, and the server's certificate, which must be
//! trusted. Errors are reported before a session is opened, with the file and the remedy.

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::SystemTime,
};

use opcua::{
    crypto::{CertificateStore, KeySize as _, SecurityPolicy, X509},
    types::{EndpointDescription, MessageSecurityMode},
};

use volcomp_document::{PrivateError, private};

use crate::error::SinumerikError;

pub(super) const APPLICATION_URI: &str = "urn:volcomp";
/// Path of the client's certificate, relative to the folder of certificates.
pub(super) const OWN_CERTIFICATE: &str = "own/cert.der";
/// Path of the client's private key, relative to the folder of certificates.
pub(super) const OWN_KEY: &str = "private/private.pem";

fn wrong(file: &Path, found: impl Into<String>, expected: impl Into<String>) -> SinumerikError {
    SinumerikError::Certificate {
        file: file.to_owned(),
        found: found.into(),
        expected: expected.into(),
    }
}

fn unreadable(file: &Path, error: &io::Error, expected: &str) -> SinumerikError {
    let found = match error.kind() {
        io::ErrorKind::NotFound => "no such file".to_owned(),
        _ => error.to_string(),
    };
    wrong(file, found, expected)
}

/// Checks the client's own certificate and key. Errors: one of the two is missing, invalid, expired, or readable by
/// others.
pub(super) fn check_own(folder: &Path) -> Result<(), SinumerikError> {
    let key = folder.join(OWN_KEY);
    let expected = "the client's private key, PEM, mode 600";
    private::open(&key).map_err(|error| match error {
        PrivateError::Mode { mode, .. } => wrong(
            &key,
            format!("mode {mode:03o}"),
            "600: with the key another program can impersonate the client",
        ),
        PrivateError::Read { source, .. } => unreadable(&key, &source, expected),
        other => wrong(&key, other.to_string(), expected),
    })?;
    let read = CertificateStore::read_pkey(&key);
    let read = read.map_err(|_| wrong(&key, "no private key in PEM", expected))?;
    let file = folder.join(OWN_CERTIFICATE);
    let expected = format!("the client's certificate, DER, with the URI {APPLICATION_URI}");
    let bytes = fs::read(&file).map_err(|e| unreadable(&file, &e, &expected))?;
    let none = || wrong(&file, "no certificate in DER", expected.as_str());
    let certificate = X509::from_der(&bytes).map_err(|_| none())?;
    if certificate.is_application_uri_valid(APPLICATION_URI).is_err() {
        return Err(wrong(&file, "a certificate without this URI", expected));
    }
    let public = certificate.public_key().map_err(|_| none())?;
    // The key belongs to the certificate if the certificate verifies a signature by the key.
    let mut signature = vec![0; read.size()];
    let signed = read.sign_sha256(APPLICATION_URI.as_bytes(), &mut signature);
    let belongs = signed.is_ok()
        && public.verify_sha256(APPLICATION_URI.as_bytes(), &signature).unwrap_or(false);
    if !belongs {
        return Err(wrong(
            &file,
            "the certificate of another key",
            format!("the certificate of {}", key.display()),
        ));
    }
    check_validity(&file, &certificate, "a new one of the client")
}

/// Selects the endpoint with this message security. Errors: the server does not offer it.
pub(super) fn endpoint(
    endpoints: &[EndpointDescription],
    policy: SecurityPolicy,
    mode: MessageSecurityMode,
) -> Result<&EndpointDescription, SinumerikError> {
    let is_it = |one: &&EndpointDescription| {
        one.security_policy_uri.as_ref() == policy.to_uri() && one.security_mode == mode
    };
    endpoints.iter().find(is_it).ok_or_else(|| SinumerikError::Protection {
        offered: endpoints.iter().map(endpoint_security).collect(),
        expected: words(policy, mode),
    })
}

fn endpoint_security(endpoint: &EndpointDescription) -> String {
    let uri: &str = endpoint.security_policy_uri.as_ref();
    let policy = uri.rsplit('#').next().unwrap_or(uri);
    match endpoint.security_mode {
        MessageSecurityMode::None => "none".to_owned(),
        MessageSecurityMode::Sign => format!("{policy} sign"),
        MessageSecurityMode::SignAndEncrypt => format!("{policy} sign-and-encrypt"),
        MessageSecurityMode::Invalid => format!("{policy} invalid"),
    }
}

fn words(policy: SecurityPolicy, mode: MessageSecurityMode) -> String {
    let mode = match mode {
        MessageSecurityMode::Sign => "sign",
        MessageSecurityMode::SignAndEncrypt => "sign-and-encrypt",
        _ => return "none".to_owned(),
    };
    format!("{} {mode}", policy.to_str())
}

/// Checks that a server's certificate is in the folder of trusted certificates, under any file name, and valid today.
/// Saves an untrusted certificate in the folder of rejected certificates, where the operator can compare it. Errors:
/// the certificate is not trusted or has expired, or a folder cannot be used.
pub(super) fn admit(folder: &Path, endpoint: &EndpointDescription) -> Result<(), SinumerikError> {
    let certificate = &X509::from_byte_string(&endpoint.server_certificate).map_err(|_| {
        wrong(folder, "a server without a readable certificate", "one with an X.509 certificate")
    })?;
    let (trusted, rejected) = (folder.join("trusted"), folder.join("rejected"));
    let name = CertificateStore::cert_file_name(certificate);
    let (file, kept) = (trusted.join(&name), rejected.join(&name));
    let failed = |file: &Path, e: &io::Error| unreadable(file, e, "a writable folder");
    for folder in [&trusted, &rejected] {
        fs::create_dir_all(folder).map_err(|e| failed(folder, &e))?;
    }
    let der = certificate
        .to_der()
        .map_err(|_| wrong(&file, "an invalid certificate", "an X.509 certificate"))?;
    if !file.exists() {
        let Some(found) = same(&trusted, &der) else {
            fs::write(&kept, &der).map_err(|e| failed(&kept, &e))?;
            return Err(SinumerikError::Untrusted {
                fingerprint: fingerprint_pairs(&certificate.thumbprint().as_hex_string()),
                file: kept,
                trusted,
            });
        };
        // The library finds a certificate only by this file name. The file is moved instead of copied, so that removing
        // the file revokes the trust.
        fs::write(&file, &der).map_err(|e| failed(&file, &e))?;
        fs::remove_file(&found).map_err(|e| failed(&found, &e))?;
    }
    // A certificate that the operator copied to the trusted folder is still in the rejected folder.
    if kept.exists() {
        fs::remove_file(&kept).map_err(|e| failed(&kept, &e))?;
    }
    check_validity(&file, certificate, "a new one of the server, or a correct clock")
}

fn same(folder: &Path, der: &[u8]) -> Option<PathBuf> {
    let files = fs::read_dir(folder).ok()?;
    let files = files.filter_map(|file| Some(file.ok()?.path()));
    files.into_iter().find(|file| {
        let Ok(bytes) = fs::read(file) else {
            return false;
        };
        let pem = || X509::from_pem(&bytes).ok()?.to_der().ok();
        bytes == der || pem().is_some_and(|pem| pem == der)
    })
}

fn check_validity(file: &Path, certificate: &X509, expected: &str) -> Result<(), SinumerikError> {
    let (Ok(from), Ok(to)) = (certificate.not_before(), certificate.not_after()) else {
        return Err(wrong(
            file,
            "a certificate without a validity period",
            "one with a validity period",
        ));
    };
    let now: SystemTime = SystemTime::now();
    if SystemTime::from(from) <= now && now <= SystemTime::from(to) {
        return Ok(());
    }
    let day = |time: &dyn std::fmt::Display| time.to_string().chars().take(10).collect::<String>();
    Err(wrong(
        file,
        format!("a certificate from {} to {}", day(&from), day(&to)),
        format!("one that is valid today: {expected}"),
    ))
}

/// Formats a fingerprint in pairs of digits, like the display of a control.
fn fingerprint_pairs(hex: &str) -> String {
    let pairs: Vec<String> =
        hex.as_bytes().chunks(2).map(|pair| String::from_utf8_lossy(pair).to_uppercase()).collect();
    pairs.join(":")
}
