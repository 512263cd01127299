//! Which manifest a machine accepts: one that a trusted key signed, for this machine, with a version above every one before.
//!
//! No clock is asked: a machine whose clock is wrong accepts the same manifests as every other.

use volcomp_vocabulary::AxisName;

use crate::{Desired, MachineId, Manifest, NotADesired, VerifyingKey};

/// What a machine trusts and is.
#[derive(Clone, Debug)]
pub struct Trust {
    /// The keys whose signatures count.
    pub keys: Vec<VerifyingKey>,
    /// The name of the machine.
    pub machine: MachineId,
    /// The serial number of the machine tool.
    pub serial: String,
    /// The axes of the machine in machine order.
    pub axes: Vec<AxisName>,
    /// The version of the highest manifest that was ever accepted, from disk; 0 where there was none.
    pub highest: u64,
}

/// A manifest that was accepted, with what is left to be fetched.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Accepted {
    /// The manifest.
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
    /// The signature does not fit the manifest.
    #[error("the signature does not fit the manifest")]
    Signature,
    /// The key that signed it is none of the trusted ones.
    #[error("it was signed by a key that is not trusted here: {key}")]
    Key {
        /// The key, base64.
        key: String,
    },
    /// It is meant for another machine.
    #[error("it is meant for the machine {found}, this is {expected}")]
    Machine {
        /// The machine that it names.
        found: MachineId,
        /// This machine.
        expected: MachineId,
    },
    /// It is meant for a machine tool with another serial number.
    #[error("it is meant for the serial number {found:?}, this machine has {expected:?}")]
    Serial {
        /// The serial number that it names.
        found: String,
        /// The serial number of this machine.
        expected: String,
    },
    /// It is meant for a machine with other axes.
    #[error("it is meant for the axes {found:?}, this machine has {expected:?}")]
    Axes {
        /// The axes that it names.
        found: Vec<AxisName>,
        /// The axes of this machine.
        expected: Vec<AxisName>,
    },
    /// A manifest of this version or a higher one has been accepted before.
    #[error("its version is {found}, and {highest} has been accepted before")]
    Version {
        /// The version that it has.
        found: u64,
        /// The highest version that was accepted.
        highest: u64,
    },
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
