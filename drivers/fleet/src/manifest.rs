//! What a machine shall run: the manifest, its signature, and the document in which both travel.
//!
//! The manifest is signed as the bytes that travel, so that no two programs can disagree about how it is written. A machine
//! accepts one that a trusted key signed, for this machine, with a version above every one before. No clock decides: a machine
//! whose clock is wrong accepts the same manifests as every other.

use base64::{Engine, engine::general_purpose::STANDARD as BASE64};
use ed25519_dalek::Signer;
pub use ed25519_dalek::{SigningKey, VerifyingKey};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use volcomp_vocabulary::AxisName;

use crate::MachineId;

/// The largest model that travels inside of its manifest's document, bytes; a larger one is taken from the object store.
pub const INLINE_LIMIT: usize = 1024 * 1024;

/// What stands before the manifest in the bytes that are signed, so that a signature for another purpose fits nowhere.
const PURPOSE: &[u8] = b"volcomp desired 1\0";

/// The text of a machine file, by its checksum.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelRef {
    /// SHA-256 of the bytes of the machine file, 64 hexadecimal digits in lower case.
    pub sha256: String,
    pub bytes: u64,
}

impl ModelRef {
    /// The reference to a machine file.
    pub fn of(text: &[u8]) -> Self {
        Self {
            sha256: hex(&Sha256::digest(text)),
            bytes: text.len() as u64,
        }
    }

    /// Whether these bytes are the machine file that is meant.
    pub fn is(&self, text: &[u8]) -> bool {
        *self == Self::of(text)
    }
}

/// What a machine shall run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    pub machine: MachineId,
    /// The serial number of the machine tool, so that a computer which was moved to another machine refuses it.
    pub serial: String,
    /// The version, larger than that of every manifest before.
    pub version: u64,
    pub axes: Vec<AxisName>,
    pub model: ModelRef,
    /// Whether the machine may be corrected; `false` ramps the correction out and forbids arming.
    pub enable: bool,
    /// The hash by which a person has confirmed a change that moves the axes far (rule 13 of the guard).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confirm: Option<String>,
    /// The seconds between two conditions; `None`: 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub condition_s: Option<u32>,
    /// The seconds between two whole states; `None`: 10.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub telemetry_s: Option<u32>,
    /// When it was issued and by whom, for people; nothing is decided by it.
    #[serde(default)]
    pub issued: String,
}

/// A signed manifest with the model that belongs to it: the value of the key of a machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Desired {
    /// The manifest as JSON: exactly the bytes that were signed.
    pub manifest: String,
    /// The public key that verifies the signature, base64.
    pub key: String,
    pub signature: String,
    /// The machine file where it is not larger than [`INLINE_LIMIT`]; `None`: it is in the object store of the machine under
    /// its checksum.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
}

/// A value of a key that is none of ours.
#[derive(Debug, thiserror::Error)]
pub enum NotADesired {
    /// No JSON, or other keys.
    #[error("the document of the manifest: {0}")]
    Json(#[from] serde_json::Error),
    /// The key or the signature is no base64 of the right length.
    #[error("{what}: expected base64 of {bytes} bytes")]
    Base64 { what: &'static str, bytes: usize },
    /// A public key that is no point of the curve, or one for which everybody can sign.
    #[error("key: expected a public key of Ed25519 that only its owner can sign for")]
    WeakKey,
}

impl Desired {
    /// Signs a manifest, with its machine file inside where that is small enough.
    ///
    /// # Errors
    /// None in practice: the manifest is plain data that JSON can hold.
    pub fn sign(manifest: &Manifest, model: &str, key: &SigningKey) -> Result<Self, NotADesired> {
        let manifest = serde_json::to_string(manifest)?;
        let signature = key.sign(&signed_bytes(&manifest));
        Ok(Self {
            key: BASE64.encode(key.verifying_key().to_bytes()),
            signature: BASE64.encode(signature.to_bytes()),
            model: (model.len() <= INLINE_LIMIT).then(|| model.to_owned()),
            manifest,
        })
    }

    /// Takes the bytes of a value. Nothing of it is trusted yet: see [`Trust::accept`](crate::Trust::accept).
    ///
    /// # Errors
    /// They are no such document.
    pub fn parse(bytes: &[u8]) -> Result<Self, NotADesired> {
        Ok(serde_json::from_slice(bytes)?)
    }

    /// The bytes of the value.
    ///
    /// # Errors
    /// None in practice: it is plain data that JSON can hold.
    pub fn bytes(&self) -> Result<Vec<u8>, NotADesired> {
        Ok(serde_json::to_vec(self)?)
    }

    /// The key that has signed the manifest; `None`: the signature does not fit. Whether the key is trusted is another
    /// question.
    ///
    /// # Errors
    /// The key or the signature is no base64 of its length.
    pub fn signer(&self) -> Result<Option<VerifyingKey>, NotADesired> {
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

/// A public key whose signatures are to be trusted, as `trusted_keys` of a machine and [`Desired::key`] have it.
///
/// # Errors
/// No base64 of 32 bytes, or no key that only its owner can sign for.
pub fn trusted_key(text: &str) -> Result<VerifyingKey, NotADesired> {
    let bytes: [u8; 32] = decode(text, "key", 32)?;
    let key = VerifyingKey::from_bytes(&bytes).ok();
    key.filter(|key| !key.is_weak()).ok_or(NotADesired::WeakKey)
}

/// What a machine trusts and is.
#[derive(Clone, Debug)]
pub struct Trust {
    /// The keys whose signatures count.
    pub keys: Vec<VerifyingKey>,
    pub machine: MachineId,
    pub serial: String,
    pub axes: Vec<AxisName>,
    /// The version of the highest manifest that was ever accepted, from disk; 0 where there was none.
    pub highest: u64,
}

/// A manifest that was accepted, with what is left to be fetched.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Accepted {
    pub manifest: Manifest,
    /// The machine file, checked against its checksum; `None`: it is in the object store.
    pub model: Option<String>,
}

/// Why a manifest is not accepted. Nothing has been changed by it.
#[derive(Debug, thiserror::Error)]
pub enum NotAccepted {
    /// It is no such document.
    #[error(transparent)]
    Document(#[from] NotADesired),
    #[error("the signature does not fit the manifest")]
    Signature,
    /// The key that signed it is none of the trusted ones.
    #[error("it was signed by a key that is not trusted here: {key}")]
    Key { key: String },
    #[error("it is meant for the machine {found}, this is {expected}")]
    Machine {
        found: MachineId,
        expected: MachineId,
    },
    #[error("it is meant for the serial number {found:?}, this machine has {expected:?}")]
    Serial { found: String, expected: String },
    #[error("it is meant for the axes {found:?}, this machine has {expected:?}")]
    Axes {
        found: Vec<AxisName>,
        expected: Vec<AxisName>,
    },
    /// A manifest of this version or a higher one has been accepted before.
    #[error("its version is {found}, and {highest} has been accepted before")]
    Version { found: u64, highest: u64 },
    /// The machine file is not the one that the manifest names.
    #[error("the machine file does not fit the checksum in the manifest")]
    Model,
}

impl Trust {
    /// Takes a manifest, or says why not. The signature is judged first: what nobody trusted has signed tells nothing.
    ///
    /// # Errors
    /// Why it is not accepted.
    pub fn accept(&self, desired: &Desired) -> Result<Accepted, NotAccepted> {
        let signer = desired.signer()?.ok_or(NotAccepted::Signature)?;
        if !self.keys.contains(&signer) {
            return Err(NotAccepted::Key {
                key: desired.key.clone(),
            });
        }
        let manifest: Manifest =
            serde_json::from_str(&desired.manifest).map_err(NotADesired::from)?;
        if manifest.machine != self.machine {
            return Err(NotAccepted::Machine {
                found: manifest.machine,
                expected: self.machine.clone(),
            });
        }
        if manifest.serial != self.serial {
            return Err(NotAccepted::Serial {
                found: manifest.serial,
                expected: self.serial.clone(),
            });
        }
        if manifest.axes != self.axes {
            return Err(NotAccepted::Axes {
                found: manifest.axes,
                expected: self.axes.clone(),
            });
        }
        if manifest.version <= self.highest {
            return Err(NotAccepted::Version {
                found: manifest.version,
                highest: self.highest,
            });
        }
        let model = desired.model.clone();
        if model
            .as_ref()
            .is_some_and(|text| !manifest.model.is(text.as_bytes()))
        {
            return Err(NotAccepted::Model);
        }
        Ok(Accepted { manifest, model })
    }
}

fn decode<const N: usize>(
    text: &str,
    what: &'static str,
    bytes: usize,
) -> Result<[u8; N], NotADesired> {
    let found = BASE64.decode(text).ok();
    found
        .and_then(|found| found.try_into().ok())
        .ok_or(NotADesired::Base64 { what, bytes })
}

fn signed_bytes(manifest: &str) -> Vec<u8> {
    [PURPOSE, manifest.as_bytes()].concat()
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write;
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string never fails.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
