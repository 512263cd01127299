//! Desired state of a machine: the manifest, its signature, and the document that contains both.
//!
//! The signature covers the transmitted bytes, so the serialization is unambiguous. A machine accepts a manifest if it
//! is signed by a trusted key, addressed to this machine, and has a higher version than every manifest accepted before.
//! Clocks have no effect on the result.

use base64::{Engine, engine::general_purpose::STANDARD as BASE64};
use ed25519_dalek::Signer;
pub use ed25519_dalek::{SigningKey, VerifyingKey};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use volcomp_vocabulary::AxisName;

use crate::MachineId;

/// Maximum size of a model that is embedded in the document, bytes. Larger models are stored in the object store.
pub const INLINE_LIMIT: usize = 1024 * 1024;

/// Prefix of the signed bytes. It makes signatures for other purposes invalid here.
const PURPOSE: &[u8] = b"volcomp desired 1\0";

/// Reference to a machine file by checksum and size.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelRef {
    /// SHA-256 of the machine file, 64 lower-case hexadecimal digits.
    pub sha256: String,
    pub bytes: u64,
}

impl ModelRef {
    /// Creates the reference to a machine file.
    pub fn of(text: &[u8]) -> Self {
        Self { sha256: hex(&Sha256::digest(text)), bytes: text.len() as u64 }
    }

    /// Whether `text` is the referenced machine file.
    pub fn is(&self, text: &[u8]) -> bool {
        *self == Self::of(text)
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    pub machine: MachineId,
    /// Serial number of the machine tool. A gateway computer that was moved to another machine rejects the manifest by
    /// this number.
    pub serial: String,
    /// Version, higher than that of every earlier manifest.
    pub version: u64,
    pub axes: Vec<AxisName>,
    pub model: ModelRef,
    /// Permission to correct. `false` ramps the correction out and prevents arming.
    pub enable: bool,
    /// Hash by which the operator confirms a change that moves the axes far (rule 13 of the guard).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confirm: Option<String>,
    /// Interval of conditions, s; `None`: 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub condition_s: Option<u32>,
    /// Interval of full telemetry, s; `None`: 10.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub telemetry_s: Option<u32>,
    /// Time and author of the manifest. They are only displayed.
    #[serde(default)]
    pub issued: String,
}

/// Value stored under the key of a machine: a signed manifest, with its model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Desired {
    /// The manifest as JSON text, exactly as signed.
    pub manifest: String,
    /// Public key that verifies the signature, base64.
    pub key: String,
    pub signature: String,
    /// The machine file, if it is not larger than [`INLINE_LIMIT`]. `None`: the machine file is in the machine's object
    /// store under its checksum.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
}

#[derive(Debug, thiserror::Error)]
pub enum DesiredError {
    /// Invalid JSON, or unexpected keys.
    #[error("the document of the manifest: {0}")]
    Json(#[from] serde_json::Error),
    /// The key or the signature is not base64, or has a wrong length.
    #[error("{what}: expected base64 of {bytes} bytes")]
    Base64 { what: &'static str, bytes: usize },
    /// The public key is not a point of the curve, or is weak: anyone can forge its signatures.
    #[error("key: expected an Ed25519 public key of large order")]
    WeakKey,
}

impl Desired {
    /// Signs a manifest, and embeds its machine file if that file is not larger than [`INLINE_LIMIT`].
    ///
    /// # Errors
    /// None in practice, since JSON can represent every manifest.
    pub fn sign(manifest: &Manifest, model: &str, key: &SigningKey) -> Result<Self, DesiredError> {
        let manifest = serde_json::to_string(manifest)?;
        let signature = key.sign(&signed_bytes(&manifest));
        Ok(Self {
            key: BASE64.encode(key.verifying_key().to_bytes()),
            signature: BASE64.encode(signature.to_bytes()),
            model: (model.len() <= INLINE_LIMIT).then(|| model.to_owned()),
            manifest,
        })
    }

    /// Parses the bytes of a value. The result is untrusted until [`Trust::accept`](crate::Trust::accept) has verified
    /// it.
    ///
    /// # Errors
    /// The bytes are not a JSON document with a manifest.
    pub fn parse(bytes: &[u8]) -> Result<Self, DesiredError> {
        Ok(serde_json::from_slice(bytes)?)
    }

    /// Serializes the value.
    ///
    /// # Errors
    /// None in practice, since JSON can represent every value.
    pub fn bytes(&self) -> Result<Vec<u8>, DesiredError> {
        Ok(serde_json::to_vec(self)?)
    }

    /// Key that signed the manifest; `None` if the signature is invalid. Does not check whether the key is trusted.
    ///
    /// # Errors
    /// The key or the signature is not base64, or has a wrong length.
    pub fn signer(&self) -> Result<Option<VerifyingKey>, DesiredError> {
        let key: [u8; 32] = decode(&self.key, "key", 32)?;
        let signature: [u8; 64] = decode(&self.signature, "signature", 64)?;
        let signature = ed25519_dalek::Signature::from_bytes(&signature);
        let Ok(key) = VerifyingKey::from_bytes(&key) else {
            return Ok(None);
        };
        let holds = key.verify_strict(&signed_bytes(&self.manifest), &signature);
        Ok(holds.is_ok().then_some(key))
    }
}

/// Parses the public key of a trusted signer, in the format of a machine's `trusted_keys` and of [`Desired::key`].
///
/// # Errors
/// Not base64 of 32 bytes, or a weak key whose signatures can be forged.
pub fn trusted_key(text: &str) -> Result<VerifyingKey, DesiredError> {
    let bytes: [u8; 32] = decode(text, "key", 32)?;
    let key = VerifyingKey::from_bytes(&bytes).ok();
    key.filter(|key| !key.is_weak()).ok_or(DesiredError::WeakKey)
}

/// Data by which a machine verifies a manifest: the identity of the machine, and the keys that it trusts.
#[derive(Clone, Debug)]
pub struct Trust {
    pub keys: Vec<VerifyingKey>,
    pub machine: MachineId,
    pub serial: String,
    pub axes: Vec<AxisName>,
    /// Highest version that was ever accepted, as stored on disk; 0 if no manifest was accepted.
    pub highest: u64,
}

/// An accepted manifest and, if it was embedded, its model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Accepted {
    pub manifest: Manifest,
    /// Machine file, verified against its checksum. `None`: it must be fetched from the object store.
    pub model: Option<String>,
}

/// Reasons why a manifest is rejected. A rejected manifest has no effect.
#[derive(Debug, thiserror::Error)]
pub enum ManifestRejection {
    #[error(transparent)]
    Document(#[from] DesiredError),
    #[error("the signature does not match the manifest")]
    Signature,
    #[error("signed by an untrusted key: {key}")]
    Key { key: String },
    #[error("it is meant for the machine {found}, this is {expected}")]
    Machine { found: MachineId, expected: MachineId },
    #[error("it is meant for the serial number {found:?}, this machine has {expected:?}")]
    Serial { found: String, expected: String },
    #[error("it is meant for the axes {found:?}, this machine has {expected:?}")]
    Axes { found: Vec<AxisName>, expected: Vec<AxisName> },
    /// A manifest with this version or a higher one was accepted before.
    #[error("its version is {found}, and {highest} has been accepted before")]
    Version { found: u64, highest: u64 },
    /// The checksum of the machine file differs from that in the manifest.
    #[error("the machine file does not match the checksum in the manifest")]
    Model,
}

impl Trust {
    /// Verifies a manifest. The signature is checked first, so that no other error depends on unsigned data.
    ///
    /// # Errors
    /// The reason why the manifest is rejected.
    pub fn accept(&self, desired: &Desired) -> Result<Accepted, ManifestRejection> {
        let signer = desired.signer()?.ok_or(ManifestRejection::Signature)?;
        if !self.keys.contains(&signer) {
            return Err(ManifestRejection::Key { key: desired.key.clone() });
        }
        let manifest: Manifest =
            serde_json::from_str(&desired.manifest).map_err(DesiredError::from)?;
        if manifest.machine != self.machine {
            return Err(ManifestRejection::Machine {
                found: manifest.machine,
                expected: self.machine.clone(),
            });
        }
        if manifest.serial != self.serial {
            return Err(ManifestRejection::Serial {
                found: manifest.serial,
                expected: self.serial.clone(),
            });
        }
        if manifest.axes != self.axes {
            return Err(ManifestRejection::Axes {
                found: manifest.axes,
                expected: self.axes.clone(),
            });
        }
        if manifest.version <= self.highest {
            return Err(ManifestRejection::Version {
                found: manifest.version,
                highest: self.highest,
            });
        }
        let model = desired.model.clone();
        if model.as_ref().is_some_and(|text| !manifest.model.is(text.as_bytes())) {
            return Err(ManifestRejection::Model);
        }
        Ok(Accepted { manifest, model })
    }
}

fn decode<const N: usize>(
    text: &str,
    what: &'static str,
    bytes: usize,
) -> Result<[u8; N], DesiredError> {
    let found = BASE64.decode(text).ok();
    found.and_then(|found| found.try_into().ok()).ok_or(DesiredError::Base64 { what, bytes })
}

fn signed_bytes(manifest: &str) -> Vec<u8> {
    [PURPOSE, manifest.as_bytes()].concat()
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write;
    bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}
