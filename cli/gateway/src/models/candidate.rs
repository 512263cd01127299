//! The candidate: the uploaded machine file that may become the next model.
//!
//! The file is received in memory, then parsed and compared with the active model on a low-priority thread. Only one
//! candidate exists at a time. Requests refer to it by its id, so that an engineer does not activate another engineer's
//! file unseen.
//!
//! Invariant: the candidate is written to disk only when it is activated. A candidate does not survive a restart.

use std::{
    io,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, atomic::Ordering},
    thread,
};

use rustix::{
    process::setpriority_process,
    thread::{CpuSet, sched_getaffinity, sched_setaffinity},
};
use volcomp_model::{Fading, Machine, ModelError};
use volcomp_runtime::Model;
use volcomp_vocabulary::{AxisName, PerAxis};
use volcomp_web::file_name;

use crate::{
    audit::utc_now,
    documents::{
        Candidate, CandidateBrief, CandidateResult, CandidateStep, ModelDiagonal, UploadedFile,
    },
    identity::{ACTIVE, Differences, differences},
    locked,
    models::worker::{Activate, BUILT_IN, HeldCandidate, Shared, candidate_gone},
    request::{Reply, refused},
};

/// Maximum size of a machine file, bytes. Parsing needs about fifty times this memory, in the process that corrects the
/// machine.
pub(crate) const MAX_FILE_BYTES: usize = 4 * 1024 * 1024;
const MAX_UPLOADS: usize = 4;

pub(crate) struct UploadSlot(Arc<Shared>);

impl Drop for UploadSlot {
    fn drop(&mut self) {
        self.0.uploading.fetch_sub(1, Ordering::AcqRel);
    }
}

pub(super) fn place(shared: &Arc<Shared>) -> Result<UploadSlot, Reply> {
    if shared.is_built_in {
        return Err(refused(422, BUILT_IN));
    }
    if let Some(held) = &*locked(&shared.candidate) {
        return Err(held.occupied());
    }
    let more = |open| (open < MAX_UPLOADS).then_some(open + 1);
    let uploading = &shared.uploading;
    match uploading.fetch_update(Ordering::AcqRel, Ordering::Acquire, more) {
        Ok(_) => Ok(UploadSlot(Arc::clone(shared))),
        Err(_) => Err(refused(503, "other files are being received: try again")),
    }
}

pub(super) fn take(
    shared: &Arc<Shared>,
    who: &str,
    name: &str,
    bytes: Vec<u8>,
) -> Result<Candidate, Reply> {
    let Some(name) = file_name::sanitised(name) else {
        let why = "the name has no letter or digit, expected a file name";
        return Err(refused(400, why));
    };
    let id = volcomp_model::hexadecimal(&rand::random::<u64>().to_be_bytes());
    let document = Candidate {
        brief: CandidateBrief {
            id: id.clone(),
            who: who.to_owned(),
            since: utc_now(),
            step: CandidateStep::Working,
        },
        file: UploadedFile { name: name.clone(), bytes: bytes.len() as u64 },
        error: None,
        result: None,
    };
    {
        let mut candidate = locked(&shared.candidate);
        if let Some(held) = &*candidate {
            return Err(held.occupied());
        }
        // A comparison cannot be stopped. Without this check, comparisons of discarded candidates would run
        // concurrently with the next one.
        if shared.is_comparing.swap(true, Ordering::AcqRel) {
            let why = "the machine file that was discarded is still being compared: try again";
            return Err(refused(503, why));
        }
        let document = document.clone();
        *candidate = Some(HeldCandidate { document, text: None });
    }
    let running = shared.published.model();
    let (of, begun) = (id.clone(), Arc::clone(shared));
    let spawned = spawn("volcomp-models", shared.cycle_cpu, move || {
        // A panic in a comparison must not leave a candidate that can never be discarded.
        let work = || compared(bytes, &name, &running.text);
        let done = catch_unwind(AssertUnwindSafe(work));
        let fault = "a fault of the program, written on standard error";
        begun.is_comparing.store(false, Ordering::Release);
        begun.done(&of, done.unwrap_or_else(|_| Err(fault.to_owned())));
    });
    if let Err(e) = spawned {
        shared.is_comparing.store(false, Ordering::Release);
        // No other request has seen this candidate, or it is already discarded.
        let _ = shared.discard(&id);
        return Err(refused(503, format!("no thread for it: {e}")));
    }
    Ok(document)
}

impl Shared {
    fn done(&self, id: &str, done: Result<(String, CandidateResult), String>) {
        let mut candidate = locked(&self.candidate);
        let Some(held) = candidate.as_mut().filter(|held| held.is(id)) else {
            return;
        };
        match done {
            Ok((text, result)) => {
                held.text = Some(text);
                held.document.result = Some(result);
                held.document.brief.step = CandidateStep::Ready;
            }
            Err(error) => {
                held.document.error = Some(error);
                held.document.brief.step = CandidateStep::Refused;
            }
        }
    }

    pub(crate) fn discard(&self, id: &str) -> Result<(), Reply> {
        let taken = locked(&self.candidate).take_if(|held| held.is(id));
        taken.map(drop).ok_or_else(candidate_gone)
    }

    /// The candidate, ready for activation. `seen` is the hash of the result that the engineer saw.
    pub(crate) fn ready(&self, id: &str, seen: &str) -> Result<Activate, Reply> {
        let candidate = locked(&self.candidate);
        let held = candidate.as_ref().filter(|held| held.is(id));
        held.ok_or_else(candidate_gone)?.ready(seen)
    }
}

impl HeldCandidate {
    fn is(&self, id: &str) -> bool {
        self.document.brief.id == id
    }

    fn occupied(&self) -> Reply {
        let CandidateBrief { who, since, .. } = &self.document.brief;
        refused(
            409,
            format!("{who} has sent a machine file at {since}: activate or discard it first"),
        )
    }

    fn ready(&self, seen: &str) -> Result<Activate, Reply> {
        let (Some(text), Some(result)) = (&self.text, &self.document.result) else {
            return Err(refused(409, "there is no model yet that can be activated"));
        };
        if result.hash != seen {
            let hash = &result.hash;
            return Err(refused(
                409,
                format!("this is another model, {hash}: check that one first"),
            ));
        }
        Ok(Activate::Candidate {
            id: self.document.brief.id.clone(),
            hash: result.hash.clone(),
            text: text.clone(),
            file: self.document.file.name.clone(),
        })
    }
}

/// Parses a machine file and compares it with the active model. Returns the text to store and the result for the web
/// interface.
fn compared(
    bytes: Vec<u8>,
    name: &str,
    running: &str,
) -> Result<(String, CandidateResult), String> {
    let text = String::from_utf8(bytes).map_err(|e| {
        let place = e.utf8_error().valid_up_to();
        format!(
            "{name}: found an invalid byte at position {place}, expected a machine file in UTF-8"
        )
    })?;
    let named = |e: ModelError| match e {
        ModelError::Input(_) => e.to_string(),
        other => format!("{name}: {other}"),
    };
    let machine = Machine::parse(&text, name).map_err(named)?;
    let running = Machine::parse(running, "the active model").map_err(|e| e.to_string())?;
    let Differences { refusal, to_confirm } = differences(&machine, &running, ACTIVE);
    let mut warnings = to_confirm;
    if machine.checksum() == running.checksum() {
        warnings.push("this is the active model: nothing would change".to_owned());
    }
    warnings.extend(machine.notes());
    let result = CandidateResult {
        refusal,
        hash: machine.checksum(),
        name: machine.name.clone(),
        structure: machine.chain().structure().to_string(),
        warnings,
        diagonals: diagonals(&running, &machine).map_err(named)?,
    };
    Ok((machine.to_toml(), result))
}

const STEPS: usize = 40;

/// The errors along the diagonals of the linear axes: four body diagonals of three axes, or two face diagonals of two
/// axes. Rotary axes are at zero or at the end of travel nearest to it. The error is that of the displacement from the
/// start of the diagonal (ISO 230-6), without correction and at the reference temperature.
fn diagonals(before: &Machine, after: &Machine) -> Result<Vec<ModelDiagonal>, ModelError> {
    let same = |a: &Machine| -> Vec<AxisName> { a.axes().iter().map(|axis| axis.name).collect() };
    if same(before) != same(after) {
        return Ok(Vec::new());
    }
    let models = [Model::new(before, Fading::default())?, Model::new(after, Fading::default())?];
    let mut linear: Vec<AxisName> = same(after);
    linear.retain(|axis| !axis.is_rotary());
    linear.sort_unstable();
    linear.truncate(3);
    if linear.len() < 2 {
        return Ok(Vec::new());
    }
    // As in ISO 230-6, at most one axis moves backward. Of two axes only the first one may.
    let backward = (0..linear.len()).take(if linear.len() == 2 { 1 } else { 3 });
    core::iter::once(None)
        .chain(backward.map(Some))
        .map(|backward| diagonal(after, &models, &linear, backward))
        .collect()
}

/// The name of a diagonal: `NPP` for X backward, Y and Z forward. `0` is a missing axis, as in `NP0`. Axes other than
/// X, Y and Z give signs, such as `−U +V`.
fn name(linear: &[AxisName], backward: Option<usize>) -> String {
    let of_cube = [AxisName::X, AxisName::Y, AxisName::Z];
    let goes_back = |place: usize| backward == Some(place);
    if linear.iter().all(|axis| of_cube.contains(axis)) {
        let sign = |axis: &AxisName| match linear.iter().position(|name| name == axis) {
            None => '0',
            Some(place) if goes_back(place) => 'N',
            Some(_) => 'P',
        };
        return of_cube.iter().map(sign).collect();
    }
    let signs = linear.iter().enumerate().map(|(place, name)| {
        let sign = if goes_back(place) { '−' } else { '+' };
        format!("{sign}{name}")
    });
    signs.collect::<Vec<_>>().join(" ")
}

fn diagonal(
    machine: &Machine,
    models: &[Model; 2],
    linear: &[AxisName],
    backward: Option<usize>,
) -> Result<ModelDiagonal, ModelError> {
    let state_at = |share: f64| {
        let coordinates: Vec<(AxisName, f64)> = (machine.axes().iter())
            .map(|axis| {
                let Some(place) = linear.iter().position(|name| *name == axis.name) else {
                    return (axis.name, axis.nearest_zero());
                };
                let [low, high] = axis.travel;
                let share = if backward == Some(place) { 1.0 - share } else { share };
                (axis.name, low + share * (high - low))
            })
            .collect();
        machine.state(&coordinates)
    };
    let chain = machine.chain();
    let way = chain.ideal_tip_mm(&state_at(1.0)?) - chain.ideal_tip_mm(&state_at(0.0)?);
    let length = way.norm();
    let direction = way / length.max(f64::MIN_POSITIVE);
    let error_um = |model: &Model, share: f64| -> Result<f64, ModelError> {
        let [error, _] = model.errors(&state_at(share)?, &PerAxis::ZERO);
        let [x, y, z] = error.position_mm;
        Ok(1e3 * (x * direction.x + y * direction.y + z * direction.z))
    };
    let first = [error_um(&models[0], 0.0)?, error_um(&models[1], 0.0)?];
    let points = (0..=STEPS).map(|step| {
        let share = step as f64 / STEPS as f64;
        let [before, after] = [error_um(&models[0], share)?, error_um(&models[1], share)?];
        Ok([share * length, before - first[0], after - first[1]])
    });
    Ok(ModelDiagonal {
        name: name(linear, backward),
        points: points.collect::<Result<_, ModelError>>()?,
    })
}

const NICE: i32 = 15;

/// Spawns a low-priority thread. `cycle_cpu` is the processor reserved for the cycle, if any.
pub(super) fn spawn(
    name: &str,
    cycle_cpu: Option<usize>,
    work: impl FnOnce() + Send + 'static,
) -> io::Result<()> {
    // The thread logs under the span of the machine that starts it.
    let span = tracing::Span::current();
    thread::Builder::new().name(name.to_owned()).spawn(move || {
        span.in_scope(|| {
            step_back(cycle_cpu);
            work();
        });
    })?;
    Ok(())
}

/// Moves this thread off the processor of the cycle and lowers its priority. Failures are ignored, because the cycle
/// also has real-time priority.
fn step_back(cycle_cpu: Option<usize>) {
    if let (Some(cpu), Ok(set)) = (cycle_cpu, sched_getaffinity(None))
        && let Some(others) = without(set, cpu)
        && let Err(e) = sched_setaffinity(None, &others)
    {
        tracing::debug!("cannot leave processor {cpu}: {e}");
    }
    // On Linux this affects the calling thread only.
    if let Err(e) = setpriority_process(None, NICE) {
        tracing::debug!("no lower priority: {e}");
    }
}

/// Removes a processor from a set; `None` if no other processor remains.
fn without(mut set: CpuSet, cpu: usize) -> Option<CpuSet> {
    if cpu < CpuSet::MAX_CPU {
        set.unset(cpu);
    }
    (set.count() > 0).then_some(set)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use rustix::process::getpriority_process;

    use super::*;

    #[test]
    fn names_are_those_of_the_standard() {
        use AxisName::{U, V, X, Y, Z};
        let all = [None, Some(0), Some(1), Some(2)].map(|backward| name(&[X, Y, Z], backward));
        assert_eq!(all, volcomp_model::BODY_DIAGONALS);
        assert_eq!(name(&[X, Z], Some(0)), "N0P");
        assert_eq!(name(&[U, V], Some(0)), "−U +V");
    }

    /// X of a machine of 300 × 400 mm has a scale error of 50 µm/m. Along the diagonal of 500 mm the displacement error
    /// at the end is 50e-6 · 300 · 300/500 mm = 9 µm.
    #[test]
    fn the_end_of_a_diagonal_errs_as_by_hand() {
        let text = |scale: f64| {
            format!(
                "structure = \"w b X Y t\"\naxes.X.travel = [0.0, 300.0]\naxes.Y.travel = [0.0, 400.0]\n[errors]\nEXX = {{ poly = [7.0, {scale}] }}\n"
            )
        };
        let machine = |scale| Machine::parse(&text(scale), "m").expect("right");
        let found = diagonals(&machine(0.0), &machine(0.05)).expect("it compiles");
        let names: Vec<&str> = found.iter().map(|diagonal| diagonal.name.as_str()).collect();
        assert_eq!(names, ["PP0", "NP0"]);
        for diagonal in found {
            let [length, before, after] = diagonal.points[STEPS];
            assert!((length - 500.0).abs() < 1e-9 && before.abs() < 1e-9, "{before}");
            assert!((after - 9.0).abs() < 1e-6, "{after}");
        }
    }

    /// The background thread has a lower priority; the priority of the calling thread is unchanged.
    #[test]
    fn only_the_background_thread_has_low_priority() {
        let before = getpriority_process(None).expect("shown");
        let (tell, shown) = channel();
        spawn("quiet", None, move || {
            let _ = tell.send(getpriority_process(None).expect("shown"));
        })
        .expect("a thread");
        assert_eq!(shown.recv().expect("it ran"), NICE.max(before));
        assert_eq!(getpriority_process(None).expect("shown"), before);
    }

    #[test]
    fn the_last_processor_is_not_taken_away() {
        let mut set = CpuSet::new();
        set.set(1);
        set.set(2);
        let others = without(set, 1).expect("one is left");
        assert!(!others.is_set(1) && others.is_set(2));
        assert!(without(others, 2).is_none());
    }
}
