//! A machine of a fleet with a real `nats-server` and a simulated control. Manifests are accepted or rejected, and no
//! axis steps.

use base64::{Engine, engine::general_purpose::STANDARD};
use volcomp_vocabulary::PerChannel;

use crate::{
    fleet_bench::{Centre, compensating, corrects_y, machine_with, wait},
    manual::{Served, no_step, says},
};

/// The centre forbids correcting while an older version is being activated. Correcting stays forbidden, whenever the
/// order arrives.
#[test]
fn an_order_to_disable_outlives_the_activation_of_an_older_version() {
    let Some(centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let program = compensating(&config);
    let mut version = 0;
    for delay_ms in [0_u8, 2, 5, 10, 20, 50, 100] {
        let model = machine_with(22.0 + f64::from(delay_ms % 3));
        version += 1;
        centre.roll_out(version, &model);
        std::thread::sleep(std::time::Duration::from_millis(delay_ms.into()));
        version += 1;
        let mut forbids = centre.manifest(version, &model);
        forbids.enable = false;
        centre.send(&forbids, &model);
        centre.acknowledged(version, "activated");
        let state = program.state();
        let shown = format!("after {delay_ms} ms: {state}");
        assert!(says(&state, "disabled by the centre"), "{shown}");
        assert_eq!(state["armed"], false, "{shown}");
        version += 1;
        centre.roll_out(version, &model);
        centre.acknowledged(version, "activated");
        wait(&program, "it corrects again", |state| state["state"] == "compensating");
    }
}

/// A small change ramps in, and a large one waits for its confirmation. No axis moves faster than the slew. After a restart without the
/// centre the accepted manifest is still active.
#[test]
fn a_roll_out_is_confirmed_ramped_in_and_outlives_the_centre() {
    let Some(mut centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let program = compensating(&config);
    corrects_y(&program, -20.0);
    centre.roll_out(1, &machine_with(25.0));
    centre.acknowledged(1, "activated");
    corrects_y(&program, -25.0);
    assert_eq!(program.state()["fleet"]["version"], 1);
    // A model with 75 µm more, which is not confirmed.
    let large = machine_with(100.0);
    centre.roll_out(2, &large);
    let asked = centre.acknowledged(2, "needs-confirmation");
    assert_eq!(asked["worst_um"], "75.0");
    corrects_y(&program, -25.0);
    let state = program.state();
    assert_eq!(state["fleet"]["version"], 1);
    assert_eq!(state["fleet"]["accepted"], 2);
    let mut confirmed = centre.manifest(3, &large);
    confirmed.confirm = asked["hash"].as_str().map(str::to_owned);
    centre.send(&confirmed, &large);
    centre.acknowledged(3, "activated");
    corrects_y(&program, -100.0);
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    let key = STANDARD.encode(centre.key.verifying_key().to_bytes());
    let who = format!("\"who\":\"centre {}\",\"what\":\"reload\"", &key[..8]);
    assert_eq!(audit.matches(&who).count(), 2, "{who} in {audit}");
    // The centre has ended for good. The machine needs neither the centre nor the configured machine file.
    centre.stop();
    let rig = program.stop();
    std::fs::remove_file(dir.path().join("machine.toml")).expect("there");
    let program = Served::again(rig, &config);
    corrects_y(&program, -100.0);
    let fleet = program.state()["fleet"].clone();
    assert_eq!(fleet["connected"], false, "{fleet}");
    assert_eq!(fleet["version"], 3, "{fleet}");
    no_step(&program.stop());
}

/// An order of the centre to disable ramps the correction out. The machine cannot be armed, even after a restart, until
/// the centre enables it.
#[test]
fn what_the_centre_disables_stays_disarmed_until_it_enables() {
    let Some(centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let model = machine_with(25.0);
    let program = compensating(&config);
    let mut manifest = centre.manifest(1, &model);
    manifest.enable = false;
    centre.send(&manifest, &model);
    let state = program.wait_for("disarmed");
    assert!(says(&state, "disabled by the centre"), "{state}");
    centre.acknowledged(1, "activated");
    let refused = program.arm();
    assert_eq!(refused.status, 409, "{}", refused.body);
    assert!(says(&refused.json(), "disabled by the centre"));
    assert_eq!(program.state()["state"], "disarmed");
    let program = program.killed_and_started(&config);
    program.watch();
    let state = wait(&program, "it says so after the restart", |state| {
        says(state, "disabled by the centre") && state["error_um"].is_array()
    });
    assert_eq!(state["state"], "disarmed");
    assert_eq!(program.gateway().shifts(), PerChannel::ZERO);
    centre.roll_out(2, &model);
    // Auto-arm resumes, because only the order prevented arming.
    program.wait_for("compensating");
    corrects_y(&program, -25.0);
    assert_eq!(program.state()["fleet"]["enabled"], true);
}

/// A value that is not signed for this machine, is older, or is damaged changes nothing. The gateway reports the
/// reason.
#[test]
fn rogue_values_change_nothing() {
    let Some(centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let program = compensating(&config);
    let first = centre.roll_out(5, &machine_with(22.0));
    centre.acknowledged(5, "activated");
    centre.roll_out(6, &machine_with(25.0));
    centre.acknowledged(6, "activated");
    corrects_y(&program, -25.0);
    let refused = |version: u64, words: &str| {
        let why = centre.refused(version, words);
        assert!(why.len() < 400, "{why}");
        // The outcome shown is that of the accepted manifest, which could not be activated.
        let fleet = program.state()["fleet"].clone();
        let shown =
            [&fleet["refused"], &fleet["outcome"]].map(|text| text.as_str().unwrap_or_default());
        assert!(shown.iter().any(|text| text.contains(words)), "{fleet}");
    };
    // A replay of an old manifest with a trusted signature.
    centre.put(&first);
    refused(5, "its version is 5, and 6 has been accepted before");
    let model = machine_with(28.0);
    let another = volcomp_fleet::SigningKey::from_bytes(&[8; 32]);
    let stranger = volcomp_fleet::Desired::sign(&centre.manifest(7, &model), &model, &another);
    centre.put(&stranger.expect("plain").bytes().expect("plain"));
    refused(7, "untrusted key");
    let mut serial = centre.manifest(8, &model);
    serial.serial = "4712".to_owned();
    centre.send(&serial, &model);
    refused(8, "the serial number \"4712\"");
    let mut axes = centre.manifest(9, &model);
    axes.axes.swap(0, 1);
    centre.send(&axes, &model);
    refused(9, "meant for the axes");
    let manifest = centre.manifest(10, &model);
    let mut tampered =
        volcomp_fleet::Desired::sign(&manifest, &model, &centre.key).expect("plain data");
    tampered.model = Some(machine_with(29.0));
    centre.put(&tampered.bytes().expect("plain data"));
    refused(10, "does not match the checksum");
    // Garbage, of the maximum size that the server accepts.
    centre.put(b"\xff\x00 no JSON");
    refused(0, "the document of the manifest");
    let huge = format!("{{\"{}\": 1}}", "x".repeat(3_900_000));
    centre.put(huge.as_bytes());
    refused(0, "unknown field");
    // The object store holds other content than the manifest names.
    let large = format!("{model}#{}\n", "-".repeat(volcomp_fleet::INLINE_LIMIT));
    let manifest = centre.manifest(11, &large);
    centre.store(&manifest.model.sha256, &large.replace("28.0", "88.0"));
    centre.send(&manifest, &large);
    refused(11, "its checksum differs");
    // An invalid machine file with a valid signature.
    let no_machine = "structure = \"w X' b Y Z t\"\n[axes.X]\n";
    centre.roll_out(12, no_machine);
    refused(12, "travel");
    let state = program.state();
    assert_eq!(state["state"], "compensating");
    assert_eq!(state["correction_um"]["Y"], -25.0);
    assert_eq!(state["fleet"]["version"], 6);
    // A valid manifest is accepted, even with its model in the object store.
    let manifest = centre.manifest(13, &large);
    centre.store(&manifest.model.sha256, &large);
    centre.send(&manifest, &large);
    centre.acknowledged(13, "activated");
    corrects_y(&program, -28.0);
}

/// The gateway is killed between acceptance and activation. After its restart it activates the manifest once. The same
/// manifest again changes nothing.
#[test]
fn a_restart_between_acceptance_and_activation_continues() {
    let Some(mut centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let model = machine_with(25.0);
    let large = format!("{model}#{}\n", "-".repeat(volcomp_fleet::INLINE_LIMIT));
    let manifest = centre.manifest(1, &large);
    let program = compensating(&config);
    // The server does not have the machine file yet: the manifest is accepted, and its activation waits.
    centre.send(&manifest, &large);
    wait(&program, "it is accepted", |state| {
        state["fleet"]["accepted"] == 1 && state["fleet"]["trouble"].is_string()
    });
    assert_eq!(program.state()["correction_um"]["Y"], -20.0);
    let rig = program.killed();
    centre.store(&manifest.model.sha256, &large);
    let program = Served::again(rig, &config);
    centre.acknowledged(1, "activated");
    corrects_y(&program, -25.0);
    // The server is killed and restarted. The same value again changes nothing.
    let ramps = || {
        let audit = program.gateway().audit();
        audit.matches("\"state\":\"arming\"").count()
    };
    let before = ramps();
    centre.stop();
    wait(&program, "it notices", |state| state["fleet"]["connected"] == false);
    centre.restart();
    wait(&program, "it is back", |state| state["fleet"]["connected"] == true);
    centre.send(&manifest, &large);
    centre.roll_out(2, &machine_with(26.0));
    centre.acknowledged(2, "activated");
    corrects_y(&program, -26.0);
    assert_eq!(ramps(), before + 1, "one ramp for one change");
}
