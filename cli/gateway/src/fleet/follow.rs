//! Applies the manifests of the centre. A value of the machine's key is judged by signature, addressee and version,
//! never by time. Manifests are activated one at a time: manifest to disk, machine file to disk, request to the
//! service, then the activation to disk.
//!
//! An order that forbids correcting takes effect before anything is written or fetched. Failures of the disk, the
//! server or the cycle are retried; refusals are not.

use std::{
    sync::{Arc, mpsc::TrySendError},
    time::Duration,
};

use sha2::{Digest, Sha256};
use tokio::{
    sync::{
        mpsc::{self, Receiver, UnboundedReceiver, UnboundedSender},
        oneshot,
    },
    time::Instant,
};
use volcomp_fleet::{
    Accepted, Acknowledgement, Desired, LinkError, MachineLink, MachineSender, Manifest,
    ManifestRejection, Outcome, Trust, largest_moves,
};
use volcomp_runtime::DisarmSwitch;
use volcomp_vocabulary::AxisName;

use super::{
    shared::Shared,
    store::{Held, Kept, Standing, Store},
};
use crate::{
    documents::{Answer, Question},
    request::{Ask, Asked, Asks, CentreAsk, Reply},
};

/// Retry interval after a failure.
const AGAIN: Duration = Duration::from_secs(2);
/// Maximum number of queued values that change nothing; further ones are not answered.
const OTHERS: usize = 4;
/// Pause after a value that changes nothing, to limit the load of a flood of them.
const PAUSE: Duration = Duration::from_millis(100);

/// Access to the service.
#[derive(Clone)]
pub(super) struct Service {
    pub(super) asks: Asks,
    pub(super) switch: DisarmSwitch,
}

impl Service {
    fn ask(
        &self,
        ask: CentreAsk,
        who: String,
        answer: Option<oneshot::Sender<Reply>>,
    ) -> Result<(), TrySendError<Asked>> {
        let asked = Asked::new(Ask::Centre(ask), who, answer, &self.switch);
        self.asks.try_send(asked)
    }
}

/// A received value, judged.
enum Heard {
    New(Box<Judged>),
    /// The last accepted manifest, received again.
    Again(Box<Judged>),
    /// A value that is not accepted.
    Refused {
        /// Its version, as far as it can be read.
        version: u64,
        value_sha256: String,
        /// The signer, for the audit log.
        who: String,
        why: String,
    },
}

/// A manifest that a trusted key has signed for this machine.
#[derive(Clone)]
struct Judged {
    held: Held,
    /// Its machine file, if it was included; the checksum matches.
    model: Option<String>,
    value_sha256: String,
}

/// Receives and judges values.
pub(super) struct Hearer {
    trust: Trust,
    newest: Option<Held>,
    service: Service,
    shared: Arc<Shared>,
}

/// Signer of a value that no trusted key has signed.
const UNKNOWN: &str = "unknown";
/// Maximum length of a reported reason, characters: some reasons quote received text of any length.
const LONGEST: usize = 300;

/// Requester for the audit log: the centre, with the first digits of its key.
fn who(key: &str) -> String {
    format!("centre {}", key.get(..8).unwrap_or(UNKNOWN))
}

/// The signer of a rejected value, as far as it is known.
fn signer(error: &ManifestRejection, key: &str) -> String {
    match error {
        ManifestRejection::Document(_)
        | ManifestRejection::Signature
        | ManifestRejection::Key { .. } => UNKNOWN.to_owned(),
        _ => who(key),
    }
}

fn shortened(error: &ManifestRejection) -> String {
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
        service: Service,
        shared: Arc<Shared>,
    ) -> Self {
        Self {
            trust: Trust {
                axes,
                highest: kept.standing.highest,
                ..trust
            },
            newest: kept.newest.clone(),
            service,
            shared,
        }
    }

    /// Classifies a value.
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
                    why: shortened(&ManifestRejection::Document(e)),
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
                let is_newest = matches!(&error, ManifestRejection::Version { found, highest } if found == highest)
                    && (self.newest.as_ref())
                        .is_none_or(|newest| newest.desired.manifest == desired.manifest);
                let version = manifest.as_ref().map_or(0, |manifest| manifest.version);
                match manifest {
                    // The signature was checked before the version.
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

    /// Ramps the correction out and forbids arming before the manifest has any other effect.
    async fn disable(&self, judged: &Judged) {
        // Note it first: the actor runs on the same thread and may be activating an older version, which must not lift
        // this order.
        self.shared.forbid(judged.held.manifest.version);
        let key = &judged.held.desired.key;
        let mut sent = self.service.ask(CentreAsk::Disable, who(key), None);
        while let Err(error) = sent {
            let TrySendError::Full(asked) = error else {
                return;
            };
            tokio::time::sleep(Duration::from_millis(5)).await;
            sent = self.service.asks.try_send(asked);
        }
    }
}

/// Describes the outcome of a manifest.
pub(super) fn in_words(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Activated => "in force".to_owned(),
        Outcome::NeedsConfirmation {
            hash,
            worst_um,
            worst_urad,
        } => format!(
            "a person must confirm it with {hash}: it moves the axes by up to {}",
            largest_moves(worst_um, worst_urad)
        ),
        Outcome::Refused { why } => format!("refused: {why}"),
    }
}

/// A failure that is retried, with its reason.
struct Later(String);

/// Activates manifests. State: the content of the folder, and the current manifest.
pub(super) struct Actor {
    store: Store,
    service: Service,
    shared: Arc<Shared>,
    acknowledge: UnboundedSender<Acknowledgement>,
    standing: Standing,
    active: Option<Held>,
    /// The current manifest, until its outcome is known and on disk.
    at_hand: Option<Judged>,
    /// Whether the current manifest is on disk.
    is_kept: bool,
    /// Time of the next attempt.
    again: Instant,
    /// Damage found at start-up, until it is reported.
    damage: Option<String>,
    /// The last refusal recorded in the audit log, so that a flood of equal refusals is recorded once.
    refusal: String,
}

impl Actor {
    pub(super) fn new(
        store: Store,
        kept: Kept,
        service: Service,
        shared: Arc<Shared>,
        acknowledge: UnboundedSender<Acknowledgement>,
    ) -> Self {
        if let Some(newest) = &kept.newest {
            let manifest = &newest.manifest;
            shared.set_pace(manifest.condition_s, manifest.telemetry_s);
        }
        // A gateway that stopped between acceptance and activation continues here.
        let is_open = kept.standing.outcome.is_none();
        let at_hand = kept.newest.filter(|_| is_open).map(|held| Judged {
            held,
            model: None,
            value_sha256: String::new(),
        });
        Self {
            store,
            service,
            shared,
            acknowledge,
            standing: kept.standing,
            active: kept.active,
            at_hand,
            is_kept: true,
            again: Instant::now(),
            damage: kept.damage,
            refusal: String::new(),
        }
    }

    /// Runs until it is dropped.
    async fn run(
        mut self,
        sender: MachineSender,
        mut accepted: UnboundedReceiver<Box<Judged>>,
        mut others: Receiver<Heard>,
    ) {
        if let Some(what) = self.damage.take() {
            self.tell(CentreAsk::Damaged(what), "gateway".to_owned());
        }
        loop {
            tokio::select! {
                biased;
                new = accepted.recv() => match new {
                    Some(new) => self.begin(*new),
                    None => return,
                },
                Some(other) = others.recv() => self.answer(other),
                () = tokio::time::sleep_until(self.again), if self.at_hand.is_some() => {
                    self.go_on(&sender).await;
                }
            }
        }
    }

    /// Replaces the current manifest with a new one.
    fn begin(&mut self, new: Judged) {
        let manifest = &new.held.manifest;
        tracing::info!(version = manifest.version, "fleet: manifest accepted");
        self.shared
            .set_pace(manifest.condition_s, manifest.telemetry_s);
        self.standing.highest = manifest.version;
        self.standing.disabled |= !manifest.enable;
        self.standing.outcome = None;
        self.at_hand = Some(new);
        self.is_kept = false;
        self.again = Instant::now();
        self.show(None);
    }

    /// Answers a value that changes nothing.
    fn answer(&mut self, other: Heard) {
        match other {
            Heard::New(new) => self.begin(*new),
            Heard::Again(again) => match (&self.standing.outcome, &mut self.at_hand) {
                (Some(outcome), _) => {
                    let outcome = outcome.clone();
                    self.acknowledge(self.standing.highest, again.value_sha256, outcome);
                }
                // The manifest dates from before the start, or its machine file was missing; this value may contain it.
                (None, Some(at_hand)) => {
                    at_hand.value_sha256 = again.value_sha256;
                    at_hand.model = again.model.or(at_hand.model.take());
                }
                (None, None) => {
                    self.at_hand = Some(*again);
                    self.is_kept = false;
                    self.again = Instant::now();
                }
            },
            Heard::Refused {
                version,
                value_sha256,
                who,
                why,
            } => {
                if self.refusal != why {
                    self.refusal.clone_from(&why);
                    self.tell(CentreAsk::Refused(why.clone()), who);
                }
                let shown = why.clone();
                (self.shared.published).tell_fleet(|state| state.refused = Some(shown));
                self.acknowledge(version, value_sha256, Outcome::Refused { why });
            }
        }
    }

    /// Tries once to activate the current manifest.
    async fn go_on(&mut self, sender: &MachineSender) {
        let Some(at_hand) = self.at_hand.clone() else {
            return;
        };
        match self.put_in_force(at_hand, sender).await {
            Ok((value_sha256, outcome)) => {
                tracing::info!(
                    version = self.standing.highest,
                    "fleet: {}",
                    in_words(&outcome)
                );
                self.at_hand = None;
                self.refusal.clear();
                self.acknowledge(self.standing.highest, value_sha256, outcome);
                self.show(None);
            }
            Err(Later(why)) => {
                tracing::warn!("fleet: {why}: tried again");
                self.again = Instant::now() + AGAIN;
                self.show(Some(why));
            }
        }
    }

    async fn put_in_force(
        &mut self,
        at_hand: Judged,
        sender: &MachineSender,
    ) -> Result<(String, Outcome), Later> {
        let held = at_hand.held;
        if !self.is_kept {
            let standing = self.standing.clone();
            self.on_disk(&held, move |store, held| store.keep(held, &standing))
                .await?;
            self.is_kept = true;
        }
        let outcome = match self.bring_machine(&held, at_hand.model, sender).await? {
            Some(why) => Outcome::Refused { why },
            None => self.take(&held).await?,
        };
        let mut standing = self.standing.clone();
        standing.outcome = Some(outcome.clone());
        let is_active = outcome == Outcome::Activated;
        if is_active {
            standing.active = Some(held.manifest.version);
            standing.disabled = !self.enables(&held);
        }
        let mut kept = vec![held.clone()];
        kept.extend(self.active.clone().filter(|_| !is_active));
        let next = standing.clone();
        self.on_disk(&held, move |store, _| {
            store.keep_standing(&next)?;
            store.tidy(&kept.iter().collect::<Vec<_>>());
            Ok(())
        })
        .await?;
        self.standing = standing;
        if is_active {
            self.shared
                .version
                .store(held.manifest.version, std::sync::atomic::Ordering::Relaxed);
            if self.enables(&held) {
                self.ask(CentreAsk::Enable, &held).await?;
            }
            self.active = Some(held);
        }
        Ok((at_hand.value_sha256, outcome))
    }

    /// Whether activating this manifest permits correcting: not if a newer queued manifest forbids it.
    fn enables(&self, held: &Held) -> bool {
        held.manifest.enable && !self.shared.is_forbidden_after(held.manifest.version)
    }

    /// Ensures that the machine file is complete on disk. `Some`: the reason why it is unobtainable.
    async fn bring_machine(
        &self,
        held: &Held,
        model: Option<String>,
        sender: &MachineSender,
    ) -> Result<Option<String>, Later> {
        let manifest = held.manifest.clone();
        let store = self.store.clone();
        let there = {
            let _waits = self.shared.acting.wait();
            tokio::task::spawn_blocking(move || store.has_machine(&manifest)).await
        };
        if there.unwrap_or(false) {
            return Ok(None);
        }
        let text = match model {
            Some(text) => text,
            None => match sender.fetch_model(&held.manifest.model).await {
                Ok(text) => text,
                Err(error @ LinkError::Model { .. }) => return Ok(Some(error.to_string())),
                Err(error) => return Err(Later(error.to_string())),
            },
        };
        self.on_disk(held, move |store, held| {
            store.keep_machine(&held.manifest, &text)
        })
        .await?;
        Ok(None)
    }

    /// Requests the service to correct with the machine file.
    async fn take(&self, held: &Held) -> Result<Outcome, Later> {
        let ask = CentreAsk::Take {
            machine: self.store.machine(&held.manifest),
            confirm: held.manifest.confirm.clone(),
        };
        let reply = self.ask(ask, held).await?;
        match (reply.status, reply.answer) {
            (200, _) => Ok(Outcome::Activated),
            (_, Answer::Question(question)) => Ok(needs_confirmation(&question)),
            (422, Answer::Refusal(refusal)) => Ok(Outcome::Refused { why: refusal.error }),
            (_, Answer::Refusal(refusal)) => Err(Later(refusal.error)),
            (status, Answer::Settled(settled)) => {
                let why = settled.error.unwrap_or_else(|| settled.reasons.join(", "));
                Err(Later(format!("{status}: {why}")))
            }
            (status, Answer::Reloaded(_)) => Err(Later(format!("answer {status}"))),
        }
    }

    async fn ask(&self, ask: CentreAsk, held: &Held) -> Result<Reply, Later> {
        let (answer, answered) = oneshot::channel();
        let who = who(&held.desired.key);
        if self.service.ask(ask, who, Some(answer)).is_err() {
            return Err(Later("too many requests wait".to_owned()));
        }
        answered
            .await
            .map_err(|_| Later("the gateway is stopping".to_owned()))
    }

    /// Sends a request for the audit log without waiting for the response.
    fn tell(&self, ask: CentreAsk, who: String) {
        if self.service.ask(ask, who, None).is_err() {
            tracing::warn!("fleet: too many requests wait");
        }
    }

    /// Runs disk work on a blocking thread.
    async fn on_disk(
        &self,
        held: &Held,
        work: impl FnOnce(&Store, &Held) -> std::io::Result<()> + Send + 'static,
    ) -> Result<(), Later> {
        let (store, held) = (self.store.clone(), held.clone());
        let done = {
            let _waits = self.shared.acting.wait();
            tokio::task::spawn_blocking(move || work(&store, &held)).await
        };
        let later = |why: String| Later(format!("what was accepted cannot be kept on disk: {why}"));
        match done {
            Ok(done) => done.map_err(|e| later(e.to_string())),
            Err(e) => Err(later(e.to_string())),
        }
    }

    fn acknowledge(&self, version: u64, value_sha256: String, outcome: Outcome) {
        // After a restart the acknowledgement is sent when the value is received again.
        if value_sha256.is_empty() {
            return;
        }
        let acknowledgement = Acknowledgement {
            version,
            value_sha256,
            outcome,
        };
        // The receiver ends only when the gateway ends.
        let _ = self.acknowledge.send(acknowledgement);
    }

    /// Publishes the current state.
    fn show(&self, trouble: Option<String>) {
        let standing = &self.standing;
        self.shared.published.tell_fleet(|state| {
            state.version = standing.active.unwrap_or(0);
            state.accepted = standing.highest;
            state.enabled = !standing.disabled;
            state.outcome = standing.outcome.as_ref().map(in_words);
            state.trouble = trouble;
            // A new manifest was accepted or activated: an earlier refusal is obsolete.
            state.refused = None;
        });
    }
}

fn needs_confirmation(question: &Question) -> Outcome {
    let text = |size: Option<f64>| size.map_or_else(String::new, |size| format!("{size:.1}"));
    Outcome::NeedsConfirmation {
        hash: question.model.clone(),
        worst_um: text(question.worst_corner_um),
        worst_urad: text(question.worst_corner_urad),
    }
}

/// Receives values forever. The actor runs concurrently, so that its waits do not delay the next value.
pub(super) async fn follow(mut link: MachineLink, mut hearer: Hearer, actor: Actor) {
    let sender: MachineSender = link.sender();
    // Unbounded: accepted manifests are signed by a trusted key with increasing versions, so they are few, and none may
    // be lost.
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
                    // If the queue is full, the value is not answered.
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
