//! Applies the manifests of the centre.
//!
//! A value of the machine's key is judged by its signature, addressee and version, never by time. Manifests are
//! activated one at a time, in four steps: store the manifest, store the machine file, request the activation from the
//! service, store the activation.
//!
//! A manifest that forbids correcting takes effect before anything is written or fetched. Failures of the disk, the
//! server or the cycle are retried; refusals are final.
//!
//! [`Store`] is the folder of accepted manifests: the newest one, the active one, and their machine files. Its file
//! `standing.json` records the versions of the newest and the active manifest, and is replaced atomically. Manifests
//! are stored as signed, so that only content signed by a trusted key is used; a machine file is identified by its
//! checksum. A manifest is on disk before its version counts, and the version is on disk before it has any effect.

use std::{
    collections::BTreeSet,
    fs, io,
    os::unix::fs::DirBuilderExt,
    path::{Path, PathBuf},
    sync::{Arc, mpsc::TrySendError},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use tokio::{
    sync::{
        mpsc::{self, Receiver, UnboundedReceiver, UnboundedSender},
        oneshot,
    },
    time::Instant,
};
use volcomp_fleet::{
    Accepted, Acknowledgement, Desired, LinkError, MachineId, MachineLink, MachineSender, Manifest,
    ManifestRejection, Outcome, Trust, largest_moves,
};
use volcomp_runtime::DisarmSwitch;
use volcomp_vocabulary::AxisName;

use crate::{
    audit::replace_file,
    config::FleetConfig,
    documents::{Answer, Question},
    fleet::shared::Shared,
    request::{CentreOperation, Operation, Reply, RequestSender, ServiceRequest},
};

const RETRY_INTERVAL: Duration = Duration::from_secs(2);
/// Maximum number of queued values that change nothing; further values are not answered.
const MAX_OTHER_VALUES: usize = 4;
/// Pause after a value that changes nothing. It limits the load if many values arrive.
const PAUSE: Duration = Duration::from_millis(100);

#[derive(Clone)]
pub(super) struct Service {
    pub(super) requests: RequestSender,
    pub(super) switch: DisarmSwitch,
}

impl Service {
    fn request(
        &self,
        operation: CentreOperation,
        who: String,
        answer: Option<oneshot::Sender<Reply>>,
    ) -> Result<(), TrySendError<ServiceRequest>> {
        let request = ServiceRequest::new(Operation::Centre(operation), who, answer, &self.switch);
        self.requests.try_send(request)
    }
}

enum JudgedValue {
    New(Box<AcceptedManifest>),
    /// A manifest identical to the last accepted one.
    Again(Box<AcceptedManifest>),
    Refused {
        /// Version of the manifest; 0 if it cannot be parsed.
        version: u64,
        value_sha256: String,
        /// Signer, as recorded in the audit log.
        who: String,
        why: String,
    },
}

#[derive(Clone)]
struct AcceptedManifest {
    held: StoredManifest,
    /// The machine file, if the manifest included it; its checksum matches.
    model: Option<String>,
    value_sha256: String,
}

pub(super) struct ManifestReceiver {
    trust: Trust,
    newest: Option<StoredManifest>,
    service: Service,
    shared: Arc<Shared>,
}

/// Signer of a value that no trusted key has signed.
const UNKNOWN: &str = "unknown";
/// Maximum length of a reported reason, characters: some reasons quote received text of any length.
const MAX_REASON_CHARS: usize = 300;

fn who(key: &str) -> String {
    format!("centre {}", key.get(..8).unwrap_or(UNKNOWN))
}

/// The signer of a rejected value; [`UNKNOWN`] if no trusted key signed it.
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
    match text.char_indices().nth(MAX_REASON_CHARS) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

impl ManifestReceiver {
    pub(super) fn new(
        trust: Trust,
        axes: Vec<AxisName>,
        kept: &StoredFleet,
        service: Service,
        shared: Arc<Shared>,
    ) -> Self {
        Self {
            trust: Trust { axes, highest: kept.standing.highest, ..trust },
            newest: kept.newest.clone(),
            service,
            shared,
        }
    }

    fn judge(&mut self, value: &[u8]) -> JudgedValue {
        let value_sha256 = volcomp_model::hexadecimal(&Sha256::digest(value));
        let parsed = Desired::parse(value);
        let mut desired = match parsed {
            Ok(desired) => desired,
            Err(e) => {
                return JudgedValue::Refused {
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
                let held = StoredManifest { desired, manifest };
                self.newest = Some(held.clone());
                JudgedValue::New(Box::new(AcceptedManifest { held, model, value_sha256 }))
            }
            Err(error) => {
                let manifest = serde_json::from_str::<Manifest>(&desired.manifest).ok();
                let is_newest = matches!(&error, ManifestRejection::Version { found, highest } if found == highest)
                    && (self.newest.as_ref())
                        .is_none_or(|newest| newest.desired.manifest == desired.manifest);
                let version = manifest.as_ref().map_or(0, |manifest| manifest.version);
                match manifest {
                    // Checking the version requires a valid signature, so the signature is valid here.
                    Some(manifest) if is_newest => {
                        let model = (desired.model.take())
                            .filter(|text| manifest.model.is(text.as_bytes()));
                        let held = StoredManifest { desired, manifest };
                        JudgedValue::Again(Box::new(AcceptedManifest { held, model, value_sha256 }))
                    }
                    _ => JudgedValue::Refused {
                        version,
                        value_sha256,
                        who: signer(&error, &desired.key),
                        why: shortened(&error),
                    },
                }
            }
        }
    }

    /// Ramps the correction to zero and forbids arming, before the manifest has any other effect.
    async fn disable(&self, judged: &AcceptedManifest) {
        // Register the order first: the activator runs on the same thread and may be activating an older version, which
        // must not lift this order.
        self.shared.forbid(judged.held.manifest.version);
        let key = &judged.held.desired.key;
        let mut sent = self.service.request(CentreOperation::Disable, who(key), None);
        while let Err(error) = sent {
            let TrySendError::Full(request) = error else {
                return;
            };
            tokio::time::sleep(Duration::from_millis(5)).await;
            sent = self.service.requests.try_send(request);
        }
    }
}

pub(super) fn in_words(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Activated => "active".to_owned(),
        Outcome::NeedsConfirmation { hash, worst_um, worst_urad, differences } => format!(
            "a person must confirm it with {hash}: it moves the axes by up to {}",
            largest_moves(worst_um, worst_urad, differences)
        ),
        Outcome::Refused { why } => format!("refused: {why}"),
    }
}

struct RetryReason(String);

/// Activates manifests, one at a time. `standing` and `active` are also stored in the folder.
pub(super) struct ManifestActivator {
    store: Store,
    service: Service,
    shared: Arc<Shared>,
    acknowledge: UnboundedSender<Acknowledgement>,
    standing: Standing,
    active: Option<StoredManifest>,
    /// The manifest whose outcome is not known or not on disk yet.
    current: Option<AcceptedManifest>,
    /// Set if `current` is on disk.
    is_kept: bool,
    again: Instant,
    /// Damage found at start-up, until it is reported.
    damage: Option<String>,
    /// The last refusal recorded in the audit log. A flood of equal refusals is thus recorded once.
    refusal: String,
}

impl ManifestActivator {
    pub(super) fn new(
        store: Store,
        kept: StoredFleet,
        service: Service,
        shared: Arc<Shared>,
        acknowledge: UnboundedSender<Acknowledgement>,
    ) -> Self {
        if let Some(newest) = &kept.newest {
            let manifest = &newest.manifest;
            shared.set_pace(manifest.condition_s, manifest.telemetry_s);
        }
        // A manifest that was accepted but not activated before a stop continues here.
        let is_open = kept.standing.outcome.is_none();
        let current = kept.newest.filter(|_| is_open).map(|held| AcceptedManifest {
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
            current,
            is_kept: true,
            again: Instant::now(),
            damage: kept.damage,
            refusal: String::new(),
        }
    }

    async fn run(
        mut self,
        sender: MachineSender,
        mut accepted: UnboundedReceiver<Box<AcceptedManifest>>,
        mut others: Receiver<JudgedValue>,
    ) {
        if let Some(what) = self.damage.take() {
            self.tell(CentreOperation::Damaged(what), "gateway".to_owned());
        }
        loop {
            tokio::select! {
                biased;
                new = accepted.recv() => match new {
                    Some(new) => self.begin(*new),
                    None => return,
                },
                Some(other) = others.recv() => self.answer(other),
                () = tokio::time::sleep_until(self.again), if self.current.is_some() => {
                    self.advance(&sender).await;
                }
            }
        }
    }

    fn begin(&mut self, new: AcceptedManifest) {
        let manifest = &new.held.manifest;
        tracing::info!(version = manifest.version, "fleet: manifest accepted");
        self.shared.set_pace(manifest.condition_s, manifest.telemetry_s);
        self.standing.highest = manifest.version;
        self.standing.disabled |= !manifest.enable;
        self.standing.outcome = None;
        self.current = Some(new);
        self.is_kept = false;
        self.again = Instant::now();
        self.show(None);
    }

    /// Answers a value that changes nothing: a repeated or a refused manifest.
    fn answer(&mut self, other: JudgedValue) {
        match other {
            JudgedValue::New(new) => self.begin(*new),
            JudgedValue::Again(again) => match (&self.standing.outcome, &mut self.current) {
                (Some(outcome), _) => {
                    let outcome = outcome.clone();
                    self.acknowledge(self.standing.highest, again.value_sha256, outcome);
                }
                // The manifest was accepted before a restart, or its machine file was missing; this value may contain
                // the file.
                (None, Some(current)) => {
                    current.value_sha256 = again.value_sha256;
                    current.model = again.model.or(current.model.take());
                }
                (None, None) => {
                    self.current = Some(*again);
                    self.is_kept = false;
                    self.again = Instant::now();
                }
            },
            JudgedValue::Refused { version, value_sha256, who, why } => {
                if self.refusal != why {
                    self.refusal.clone_from(&why);
                    self.tell(CentreOperation::Refused(why.clone()), who);
                }
                let shown = why.clone();
                (self.shared.published).update_fleet(|state| state.refused = Some(shown));
                self.acknowledge(version, value_sha256, Outcome::Refused { why });
            }
        }
    }

    async fn advance(&mut self, sender: &MachineSender) {
        let Some(current) = self.current.clone() else {
            return;
        };
        match self.activate(current, sender).await {
            Ok((value_sha256, outcome)) => {
                tracing::info!(version = self.standing.highest, "fleet: {}", in_words(&outcome));
                self.current = None;
                self.refusal.clear();
                self.acknowledge(self.standing.highest, value_sha256, outcome);
                self.show(None);
            }
            Err(RetryReason(why)) => {
                tracing::warn!("fleet: {why}: tried again");
                self.again = Instant::now() + RETRY_INTERVAL;
                self.show(Some(why));
            }
        }
    }

    async fn activate(
        &mut self,
        current: AcceptedManifest,
        sender: &MachineSender,
    ) -> Result<(String, Outcome), RetryReason> {
        let held = current.held;
        if !self.is_kept {
            let standing = self.standing.clone();
            self.on_disk(&held, move |store, held| store.keep(held, &standing)).await?;
            self.is_kept = true;
        }
        let outcome = match self.store_machine(&held, current.model, sender).await? {
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
            self.shared.version.store(held.manifest.version, std::sync::atomic::Ordering::Relaxed);
            if self.enables(&held) {
                self.request(CentreOperation::Enable, &held).await?;
            }
            self.active = Some(held);
        }
        Ok((current.value_sha256, outcome))
    }

    /// Whether activating this manifest permits correction; false if a newer queued manifest forbids it.
    fn enables(&self, held: &StoredManifest) -> bool {
        held.manifest.enable && !self.shared.is_forbidden_after(held.manifest.version)
    }

    /// Ensures that the machine file is complete on disk. Returns the reason if the file is unobtainable.
    async fn store_machine(
        &self,
        held: &StoredManifest,
        model: Option<String>,
        sender: &MachineSender,
    ) -> Result<Option<String>, RetryReason> {
        let manifest = held.manifest.clone();
        let store = self.store.clone();
        let there = {
            let _waits = self.shared.activating.wait();
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
                Err(error) => return Err(RetryReason(error.to_string())),
            },
        };
        self.on_disk(held, move |store, held| store.keep_machine(&held.manifest, &text)).await?;
        Ok(None)
    }

    /// Requests that the service activates the machine file and permits correction.
    async fn take(&self, held: &StoredManifest) -> Result<Outcome, RetryReason> {
        let operation = CentreOperation::Take {
            machine: self.store.machine(&held.manifest),
            confirm: held.manifest.confirm.clone(),
        };
        let reply = self.request(operation, held).await?;
        match (reply.status, reply.answer) {
            (200, _) => Ok(Outcome::Activated),
            (_, Answer::Question(question)) => Ok(needs_confirmation(&question)),
            (422, Answer::Refusal(refusal)) => Ok(Outcome::Refused { why: refusal.error }),
            (_, Answer::Refusal(refusal)) => Err(RetryReason(refusal.error)),
            (status, Answer::Settled(settled)) => {
                let why = settled.error.unwrap_or_else(|| settled.reasons.join(", "));
                Err(RetryReason(format!("{status}: {why}")))
            }
            (status, Answer::Reloaded(_)) => Err(RetryReason(format!("answer {status}"))),
        }
    }

    async fn request(
        &self,
        operation: CentreOperation,
        held: &StoredManifest,
    ) -> Result<Reply, RetryReason> {
        let (answer, answered) = oneshot::channel();
        let who = who(&held.desired.key);
        if self.service.request(operation, who, Some(answer)).is_err() {
            return Err(RetryReason("too many requests wait".to_owned()));
        }
        answered.await.map_err(|_| RetryReason("the gateway is stopping".to_owned()))
    }

    /// Requests that the service records an event in the audit log, without waiting for the response.
    fn tell(&self, operation: CentreOperation, who: String) {
        if self.service.request(operation, who, None).is_err() {
            tracing::warn!("fleet: too many requests wait");
        }
    }

    async fn on_disk(
        &self,
        held: &StoredManifest,
        work: impl FnOnce(&Store, &StoredManifest) -> std::io::Result<()> + Send + 'static,
    ) -> Result<(), RetryReason> {
        let (store, held) = (self.store.clone(), held.clone());
        let done = {
            let _waits = self.shared.activating.wait();
            tokio::task::spawn_blocking(move || work(&store, &held)).await
        };
        let later = |why: String| {
            RetryReason(format!("the accepted manifest cannot be kept on disk: {why}"))
        };
        match done {
            Ok(done) => done.map_err(|e| later(e.to_string())),
            Err(e) => Err(later(e.to_string())),
        }
    }

    fn acknowledge(&self, version: u64, value_sha256: String, outcome: Outcome) {
        // A manifest read from disk after a restart is acknowledged when its value is received again.
        if value_sha256.is_empty() {
            return;
        }
        let acknowledgement = Acknowledgement { version, value_sha256, outcome };
        // The receiver of acknowledgements ends only with the gateway.
        let _ = self.acknowledge.send(acknowledgement);
    }

    fn show(&self, trouble: Option<String>) {
        let standing = &self.standing;
        self.shared.published.update_fleet(|state| {
            state.version = standing.active.unwrap_or(0);
            state.accepted = standing.highest;
            state.enabled = !standing.disabled;
            state.outcome = standing.outcome.as_ref().map(in_words);
            state.trouble = trouble;
            // A new manifest was accepted or activated, so an earlier refusal is obsolete.
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
        differences: question.differences.clone(),
    }
}

/// Receives values forever. The activator runs concurrently, so that its waits do not delay the next value.
pub(super) async fn receive(
    mut link: MachineLink,
    mut receiver: ManifestReceiver,
    activator: ManifestActivator,
) {
    let sender: MachineSender = link.sender();
    // The channel is unbounded, because no accepted manifest may be lost. They are few: a trusted key has signed each,
    // with increasing versions.
    let (accept, accepted) = mpsc::unbounded_channel();
    let (tell, others) = mpsc::channel(MAX_OTHER_VALUES);
    let receiving = async {
        loop {
            let value = link.next_desired().await;
            match receiver.judge(&value) {
                JudgedValue::New(judged) => {
                    if !judged.held.manifest.enable {
                        receiver.disable(&judged).await;
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
        () = receiving => {}
        () = activator.run(sender, accepted, others) => {}
    }
}

const STANDING: &str = "standing.json";

/// State that survives a restart, beyond the manifests.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Standing {
    /// Highest accepted version of a manifest; 0: none.
    pub(crate) highest: u64,
    /// Version of the active manifest; `None`: the configured machine file is active.
    pub(crate) active: Option<u64>,
    pub(crate) disabled: bool,
    /// Outcome of the manifest with the version `highest`; `None`: not known yet.
    pub(crate) outcome: Option<Outcome>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct StoredManifest {
    pub(crate) desired: Desired,
    pub(crate) manifest: Manifest,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct StoredFleet {
    pub(crate) standing: Standing,
    pub(crate) newest: Option<StoredManifest>,
    pub(crate) active: Option<StoredManifest>,
    pub(crate) damage: Option<String>,
}

#[derive(Clone, Debug)]
pub(crate) struct Store {
    dir: PathBuf,
    /// Site and name of the machine.
    identity: String,
}

impl Store {
    pub(crate) fn new(config: &FleetConfig) -> Self {
        let identity = format!("{}.{}", config.site, config.machine);
        Self { dir: config.dir.clone(), identity }
    }

    /// The folder of messages that wait for the server. Each identity has its own folder: the messages do not name
    /// their machine, and the computer may later serve another machine.
    pub(crate) fn spool(&self) -> PathBuf {
        self.dir.join("waiting").join(&self.identity)
    }

    pub(crate) fn audit_cursor(&self) -> PathBuf {
        self.dir.join("audit-sent.json")
    }

    pub(crate) fn machine(&self, manifest: &Manifest) -> PathBuf {
        self.dir.join(format!("machine-{}.toml", manifest.model.sha256))
    }

    fn manifest(&self, version: u64) -> PathBuf {
        self.dir.join(format!("manifest-{version}.json"))
    }

    pub(crate) fn make(&self) -> io::Result<()> {
        let mut builder = fs::DirBuilder::new();
        builder.recursive(true).mode(0o700).create(&self.dir)
    }

    /// Reads the folder. Only content signed by a trusted key for this machine is used. A missing folder is treated as
    /// empty.
    pub(crate) fn read(&self, config: &FleetConfig) -> StoredFleet {
        let mut kept = StoredFleet::default();
        let mut damage = Vec::new();
        match read_standing(&self.dir.join(STANDING)) {
            Ok(standing) => kept.standing = standing.unwrap_or_default(),
            Err(error) => {
                damage.push(error);
                // It is unknown whether the centre permits correcting, so correcting is forbidden.
                kept.standing.disabled = true;
            }
        }
        let manifests = self.manifests(config);
        let newest = manifests.iter().max_by_key(|held| held.manifest.version);
        if let Some(newest) = newest
            && (newest.manifest.version > kept.standing.highest || !damage.is_empty())
        {
            // The gateway stopped before it saved the version, or `standing.json` is damaged. An earlier order to
            // disable lasts until this manifest is active.
            kept.standing.highest = newest.manifest.version;
            kept.standing.disabled |= !newest.manifest.enable;
            kept.standing.outcome = None;
        }
        let with = |version: u64| {
            let mut all = manifests.iter();
            all.find(|held| held.manifest.version == version).cloned()
        };
        kept.newest = with(kept.standing.highest);
        if let Some(version) = kept.standing.active {
            match with(version) {
                None => damage.push(format!(
                    "{}: the active manifest is missing, or no trusted key has signed it for this machine",
                    self.manifest(version).display()
                )),
                Some(held) if !self.has_machine(&held.manifest) => damage.push(format!(
                    "{}: it does not fit the checksum of its manifest",
                    self.machine(&held.manifest).display()
                )),
                Some(held) => kept.active = Some(held),
            }
            if kept.active.is_none() {
                kept.standing.active = None;
                // The newest manifest is received again, so its outcome is open.
                if version == kept.standing.highest {
                    kept.standing.outcome = None;
                }
            }
        }
        kept.damage = (!damage.is_empty()).then(|| damage.join("; "));
        kept
    }

    fn manifests(&self, config: &FleetConfig) -> Vec<StoredManifest> {
        let Ok(entries) = fs::read_dir(&self.dir) else {
            return Vec::new();
        };
        let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
        let named = paths.filter(|path| {
            let name = path.file_name().and_then(|name| name.to_str());
            name.is_some_and(|name| name.starts_with("manifest-"))
                && path.extension().is_some_and(|ending| ending == "json")
        });
        named.filter_map(|path| verified(&path, config)).collect()
    }

    fn has_machine(&self, manifest: &Manifest) -> bool {
        fs::read(self.machine(manifest)).is_ok_and(|text| manifest.model.is(&text))
    }

    /// Saves an accepted manifest, then the new standing; the order matters.
    pub(crate) fn keep(&self, held: &StoredManifest, standing: &Standing) -> io::Result<()> {
        self.make()?;
        let text = serde_json::to_string(&held.desired)?;
        replace_file(&self.manifest(held.manifest.version), &text)?;
        self.keep_standing(standing)
    }

    fn keep_machine(&self, manifest: &Manifest, text: &str) -> io::Result<()> {
        replace_file(&self.machine(manifest), text)
    }

    pub(crate) fn keep_standing(&self, standing: &Standing) -> io::Result<()> {
        replace_file(&self.dir.join(STANDING), &serde_json::to_string(standing)?)
    }

    pub(crate) fn tidy(&self, held: &[&StoredManifest]) {
        let needed: BTreeSet<PathBuf> = held
            .iter()
            .flat_map(|held| [self.manifest(held.manifest.version), self.machine(&held.manifest)])
            .collect();
        let Ok(entries) = fs::read_dir(&self.dir) else {
            return;
        };
        for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
            let name = path.file_name().and_then(|name| name.to_str());
            let is_ours = name
                .is_some_and(|name| name.starts_with("manifest-") || name.starts_with("machine-"));
            if is_ours && !needed.contains(&path) {
                // A file that cannot be removed only uses space.
                let _ = fs::remove_file(path);
            }
        }
    }
}

fn read_standing(path: &Path) -> Result<Option<Standing>, String> {
    match fs::read_to_string(path) {
        Ok(text) => {
            serde_json::from_str(&text).map(Some).map_err(|e| format!("{}: {e}", path.display()))
        }
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(format!("{}: {e}", path.display())),
    }
}

/// Reads a manifest that a trusted key signed for this machine. Its axes are compared with the machine at activation,
/// and its machine file with the checksum.
fn verified(path: &Path, config: &FleetConfig) -> Option<StoredManifest> {
    let desired = Desired::parse(&fs::read(path).ok()?).ok()?;
    let manifest: Manifest = serde_json::from_str(&desired.manifest).ok()?;
    let trust = Trust { axes: manifest.axes, ..trust(config, config.identity().ok()?.machine) };
    let accepted = trust.accept(&desired).ok()?;
    Some(StoredManifest { desired, manifest: accepted.manifest })
}

/// Keys and identity that the machine trusts, without its axes.
pub(crate) fn trust(config: &FleetConfig, machine: MachineId) -> Trust {
    Trust {
        keys: config.trusted(),
        machine,
        serial: config.serial.clone(),
        axes: Vec::new(),
        highest: 0,
    }
}

#[cfg(test)]
mod tests {
    use volcomp_fleet::{ModelRef, SigningKey};

    use super::*;

    #[test]
    fn what_waits_is_not_sent_as_another_machines() {
        let spool = |machine: &str| {
            let config = FleetConfig { machine: machine.to_owned(), ..FleetConfig::default() };
            Store::new(&config).spool()
        };
        assert_ne!(spool("mill-1"), spool("mill-2"));
    }

    /// The centre disabled the machine. The newest manifest permits correcting, but is not active, for example because
    /// its model waits for a confirmation.
    #[test]
    fn a_damaged_standing_state_does_not_lift_an_order_to_disable() {
        let dir = tempfile::tempdir().expect("writable");
        let key = SigningKey::from_bytes(&[7; 32]);
        let mut config = FleetConfig {
            site: "berlin".to_owned(),
            machine: "mill-1".to_owned(),
            serial: "4711".to_owned(),
            dir: dir.path().to_owned(),
            ..FleetConfig::default()
        };
        let manifest = Manifest {
            machine: config.identity().expect("names").machine,
            serial: config.serial.clone(),
            version: 3,
            axes: vec![AxisName::X],
            model: ModelRef::of(b"machine"),
            enable: true,
            confirm: None,
            condition_s: None,
            telemetry_s: None,
            issued: String::new(),
        };
        let desired = Desired::sign(&manifest, "machine", &key).expect("JSON");
        config.trusted_keys = vec![desired.key.clone()];
        let standing = Standing { highest: 3, disabled: true, ..Standing::default() };
        let store = Store::new(&config);
        store.keep(&StoredManifest { desired, manifest }, &standing).expect("writable");
        assert!(store.read(&config).standing.disabled);
        fs::write(dir.path().join(STANDING), "garbage").expect("writable");
        let kept = store.read(&config);
        assert!(kept.damage.is_some());
        assert_eq!(kept.standing.highest, 3, "the manifest is still trusted");
        assert!(kept.standing.disabled);
    }
}
