//! Hears the values of the machine's key and judges them: by their signature, their addressee and their version, by no clock.
//! What forbids correcting is ordered here, before anything is written or fetched.

use std::{sync::Arc, time::Duration};

use sha2::{Digest, Sha256};
use tokio::sync::mpsc;
use volcomp_fleet::{Accepted, Desired, MachineLink, MachineSender, Manifest, NotAccepted, Trust};
use volcomp_runtime::DisarmSwitch;
use volcomp_vocabulary::AxisName;

use super::{
    Shared,
    act::Actor,
    store::{Held, Kept},
};
use crate::request::{Ask, Asked, Asks, CentreAsk};

/// So many values that change nothing wait to be answered; further ones are not answered.
const OTHERS: usize = 4;
/// The pause after a value that changes nothing, so that a flood of them costs little.
const PAUSE: Duration = Duration::from_millis(100);

/// A value that was judged.
pub(super) enum Heard {
    /// A new manifest.
    New(Box<Judged>),
    /// The manifest that was accepted last, again.
    Again(Box<Judged>),
    /// One that is not accepted.
    Refused {
        /// The version that it has, as far as that can be read.
        version: u64,
        /// The checksum of the value.
        value_sha256: String,
        /// Who signed it, for the audit log.
        who: String,
        /// Why, in words.
        why: String,
    },
}

/// A manifest that a trusted key has signed for this machine.
#[derive(Clone)]
pub(super) struct Judged {
    pub(super) held: Held,
    /// Its machine file, where it came with it; it fits the checksum.
    pub(super) model: Option<String>,
    pub(super) value_sha256: String,
}

/// The side that hears.
pub(super) struct Hearer {
    trust: Trust,
    newest: Option<Held>,
    asks: Asks,
    switch: DisarmSwitch,
    shared: Arc<Shared>,
}

/// Who sent what no trusted key has signed.
const UNKNOWN: &str = "unknown";
/// The longest reason that is told, characters: some say what they found, which may be anything.
const LONGEST: usize = 300;

/// Who asks, in the audit log: the centre, by the beginning of its key.
pub(super) fn who(key: &str) -> String {
    format!("centre {}", key.get(..8).unwrap_or(UNKNOWN))
}

/// Who signed what is not accepted, as far as that is known.
fn signer(error: &NotAccepted, key: &str) -> String {
    match error {
        NotAccepted::Document(_) | NotAccepted::Signature | NotAccepted::Key { .. } => {
            UNKNOWN.to_owned()
        }
        _ => who(key),
    }
}

fn shortened(error: &NotAccepted) -> String {
    let text = error.to_string();
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

impl Hearer {
    pub(super) fn new(
        trust: Trust,
        axes: Vec<AxisName>,
        kept: &Kept,
        asks: Asks,
        switch: DisarmSwitch,
        shared: Arc<Shared>,
    ) -> Self {
        Self {
            trust: Trust {
                axes,
                highest: kept.standing.highest,
                ..trust
            },
            newest: kept.newest.clone(),
            asks,
            switch,
            shared,
        }
    }

    /// What a value is.
    fn judge(&mut self, value: &[u8]) -> Heard {
        let value_sha256 = crate::hex(&Sha256::digest(value));
        let parsed = Desired::parse(value);
        let mut desired = match parsed {
            Ok(desired) => desired,
            Err(e) => {
                return Heard::Refused {
                    version: 0,
                    value_sha256,
                    who: UNKNOWN.to_owned(),
                    why: shortened(&NotAccepted::Document(e)),
                };
            }
        };
        match self.trust.accept(&desired) {
            Ok(Accepted { manifest, model }) => {
                desired.model = None;
                self.trust.highest = manifest.version;
                let held = Held { desired, manifest };
                self.newest = Some(held.clone());
                Heard::New(Box::new(Judged {
                    held,
                    model,
                    value_sha256,
                }))
            }
            Err(error) => {
                let manifest = serde_json::from_str::<Manifest>(&desired.manifest).ok();
                let is_newest = matches!(&error, NotAccepted::Version { found, highest } if found == highest)
                    && (self.newest.as_ref())
                        .is_none_or(|newest| newest.desired.manifest == desired.manifest);
                let version = manifest.as_ref().map_or(0, |manifest| manifest.version);
                match manifest {
                    // Its signature has been judged before its version.
                    Some(manifest) if is_newest => {
                        let model = (desired.model.take())
                            .filter(|text| manifest.model.is(text.as_bytes()));
                        let held = Held { desired, manifest };
                        Heard::Again(Box::new(Judged {
                            held,
                            model,
                            value_sha256,
                        }))
                    }
                    _ => Heard::Refused {
                        version,
                        value_sha256,
                        who: signer(&error, &desired.key),
                        why: shortened(&error),
                    },
                }
            }
        }
    }

    /// Has the correction ramped out and arming forbidden, before anything else is done by a manifest.
    async fn disable(&self, judged: &Judged) {
        // Noted first: the actor, which may be putting an older version in force, runs on this thread, too, and asks for
        // nothing any more that would lift it.
        self.shared.forbid(judged.held.manifest.version);
        let key = &judged.held.desired.key;
        let ask = || Ask::Centre(CentreAsk::Disable);
        let mut asked = Asked::new(ask(), who(key), None, &self.switch);
        while let Err(error) = self.asks.try_send(asked) {
            match error {
                std::sync::mpsc::TrySendError::Full(back) => asked = back,
                std::sync::mpsc::TrySendError::Disconnected(_) => return,
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }
}

/// Hears values for ever. The actor works beside it, so that nothing it waits for keeps the next value from being heard.
pub(super) async fn hear(mut link: MachineLink, mut hearer: Hearer, actor: Actor) {
    let sender: MachineSender = link.sender();
    // What is accepted is signed by a trusted key, each with a higher version: these are few, and none is left out.
    let (accept, accepted) = mpsc::unbounded_channel();
    let (tell, others) = mpsc::channel(OTHERS);
    let hearing = async {
        loop {
            let value = link.next_desired().await;
            match hearer.judge(&value) {
                Heard::New(judged) => {
                    if !judged.held.manifest.enable {
                        hearer.disable(&judged).await;
                    }
                    if accept.send(judged).is_err() {
                        return;
                    }
                }
                other => {
                    // Where too many wait it is not answered.
                    let _ = tell.try_send(other);
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
    };
    tokio::select! {
        () = hearing => {}
        () = actor.run(sender, accepted, others) => {}
    }
}
