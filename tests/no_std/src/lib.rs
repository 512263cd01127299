//! The error curves and the kinematics behind a C interface, without the standard library.
//!
//! Memory comes from a fixed arena and is never freed: curves are built once, at start.
#![no_std]
extern crate alloc;

use alloc::{boxed::Box, vec::Vec};
use core::alloc::{GlobalAlloc, Layout};
use core::cell::UnsafeCell;
use core::panic::PanicInfo;
use core::ptr::null_mut;
use core::slice;
use core::time::Duration;
use core::sync::atomic::{AtomicUsize, Ordering};

use volcomp_curve::{Curve, MovingLeastSquares, Polynomial, Table};
use volcomp_evaluator::CompiledMachine;
use volcomp_guard::{AxisLimits, Guard, Inputs, Limits, ReadBack, Reading, CorrectionReport, RequestedCorrection};
use volcomp_guard::vocabulary::{AxisKind, AxisName, MAX_AXES, PerAxis, PerChannel};
use volcomp_kinematics::{Chain, CorrectionOptions, ErrorMotion, Form, GivenErrors, State, correct, volumetric_error};

const ARENA_BYTES: usize = 1 << 20;

struct Arena {
    bytes: UnsafeCell<[u8; ARENA_BYTES]>,
    used: AtomicUsize,
}

// SAFETY: `used` hands every byte of `bytes` out at most once.
unsafe impl Sync for Arena {}

// SAFETY: blocks lie inside `bytes`, do not overlap, and start at a multiple of the alignment.
unsafe impl GlobalAlloc for Arena {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let base = self.bytes.get() as usize;
        let mut used = self.used.load(Ordering::Relaxed);
        loop {
            let Some(start) = (base + used).checked_next_multiple_of(layout.align()) else {
                return null_mut();
            };
            let offset = start - base;
            let Some(end) = offset
                .checked_add(layout.size())
                .filter(|&e| e <= ARENA_BYTES)
            else {
                return null_mut();
            };
            let taken =
                self.used
                    .compare_exchange_weak(used, end, Ordering::Relaxed, Ordering::Relaxed);
            match taken {
                // SAFETY: `offset` is inside `bytes`.
                Ok(_) => return unsafe { self.bytes.get().cast::<u8>().add(offset) },
                Err(now) => used = now,
            }
        }
    }

    unsafe fn dealloc(&self, _: *mut u8, _: Layout) {}
}

#[global_allocator]
static ARENA: Arena = Arena {
    bytes: UnsafeCell::new([0; ARENA_BYTES]),
    used: AtomicUsize::new(0),
};

#[panic_handler]
fn stop(_: &PanicInfo) -> ! {
    loop {
        core::hint::spin_loop();
    }
}

/// The precompiled `core` of hosted targets, which unwind, refers to this symbol; it is never called here.
#[unsafe(no_mangle)]
extern "C" fn rust_eh_personality() {}

fn boxed(curve: Option<Curve>) -> *mut Curve {
    curve.map_or(null_mut(), |curve| Box::into_raw(Box::new(curve)))
}

/// Builds a monotone cubic table from `count` pairs of argument and value. Returns null if the pairs are invalid.
///
/// # Safety
/// `pairs` points to `2 * count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn volcomp_curve_cubic(pairs: *const f64, count: usize) -> *mut Curve {
    // SAFETY: promised by the caller.
    let nodes = unsafe { nodes(pairs, count) };
    boxed(Table::cubic(nodes).ok().map(Curve::Table))
}

/// Builds a moving least-squares curve from `count` pairs of argument and value. Returns null if the pairs or
/// parameters are invalid.
///
/// # Safety
/// `pairs` points to `2 * count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn volcomp_curve_mls(
    pairs: *const f64,
    count: usize,
    order: usize,
    support: f64,
    shape: f64,
) -> *mut Curve {
    // SAFETY: promised by the caller.
    let nodes = unsafe { nodes(pairs, count) };
    let curve = MovingLeastSquares::new(nodes, order, support, shape);
    boxed(curve.ok().map(Curve::MovingLeastSquares))
}

/// Builds a polynomial from `count` coefficients, constant first. Returns null if the coefficients or the range from
/// `lower` to `upper` are invalid.
///
/// # Safety
/// `coefficients` points to `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn volcomp_curve_polynomial(
    coefficients: *const f64,
    count: usize,
    lower: f64,
    upper: f64,
) -> *mut Curve {
    // SAFETY: promised by the caller.
    let coefficients = unsafe { slice::from_raw_parts(coefficients, count) }.to_vec();
    boxed(
        Polynomial::new(coefficients, [lower, upper])
            .ok()
            .map(Curve::Polynomial),
    )
}

/// Value of a curve at `x`.
///
/// # Safety
/// `curve` was returned by a function `volcomp_curve_…` that builds a curve, and is not null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn volcomp_curve_value(curve: *const Curve, x: f64) -> f64 {
    // SAFETY: promised by the caller.
    unsafe { &*curve }.value(x)
}

/// Derivative of a curve at `x`.
///
/// # Safety
/// `curve` was returned by a function `volcomp_curve_…` that builds a curve, and is not null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn volcomp_curve_derivative(curve: *const Curve, x: f64) -> f64 {
    // SAFETY: promised by the caller.
    unsafe { &*curve }.derivative(x)
}

/// # Safety
/// `pairs` points to `2 * count` numbers.
unsafe fn nodes(pairs: *const f64, count: usize) -> Vec<[f64; 2]> {
    // SAFETY: promised by the caller; `[f64; 2]` is laid out as two `f64`.
    unsafe { slice::from_raw_parts(pairs.cast::<[f64; 2]>(), count) }.to_vec()
}

/// Error (mm) and correction (mm, rad) of a five-axis machine whose X axis has the six error motions `um_urad`, at the
/// coordinates `q` (mm, rad) of X, Y, Z, B and C; the correction is in the same order. Returns 0, or −1 if the
/// structure is refused.
///
/// # Safety
/// `q` points to 5 numbers, `um_urad` to 6, `error_mm` to 3 writable ones, `delta` to 5.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn volcomp_five_axis(
    q: *const f64,
    um_urad: *const f64,
    error_mm: *mut f64,
    delta: *mut f64,
) -> i32 {
    let Ok(structure) = "w C' X' b Y Z B t".parse() else {
        return -1;
    };
    // SAFETY: the caller keeps the lengths stated above.
    let (q, six) = unsafe { (slice::from_raw_parts(q, 5), slice::from_raw_parts(um_urad, 6)) };
    // SAFETY: as above, for writing.
    let (error_mm, delta) =
        unsafe { (slice::from_raw_parts_mut(error_mm, 3), slice::from_raw_parts_mut(delta, 5)) };
    let chain = Chain::new(structure);
    let mut errors = GivenErrors::default();
    if let Some(x) = chain.structure().index_of(AxisName::X) {
        errors.motion[x] = ErrorMotion::from_um_urad(core::array::from_fn(|i| six[i]));
    }
    let axes = [AxisName::X, AxisName::Y, AxisName::Z, AxisName::B, AxisName::C];
    let Ok(state) = State::new(&chain, axes.into_iter().zip(q.iter().copied())) else {
        return -1;
    };
    let error = volumetric_error(&chain, &errors, &state, Form::Exact);
    error_mm.copy_from_slice(error.position_mm.as_slice());
    let correction = correct(&chain, &errors, &state, &CorrectionOptions::default());
    for (delta, axis) in delta.iter_mut().zip(axes) {
        *delta = chain.of_axis(axis, &correction.delta).unwrap_or_default();
    }
    0
}

/// First-order correction (mm, rad) of a compiled machine from its bytes, at the coordinates `q` (mm, rad) of its axes,
/// both in the order of its chain. Returns the number of axes, or −1 if the bytes are refused.
///
/// # Safety
/// `blob` points to `length` bytes, `q` to 9 numbers, `delta` to 9 writable ones.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn volcomp_compiled_correction(
    blob: *const u8,
    length: usize,
    q: *const f64,
    delta: *mut f64,
) -> i32 {
    // SAFETY: the caller keeps the lengths stated above.
    let (blob, q) = unsafe { (slice::from_raw_parts(blob, length), slice::from_raw_parts(q, 9)) };
    // SAFETY: as above, for writing.
    let delta = unsafe { slice::from_raw_parts_mut(delta, 9) };
    let Ok(machine) = CompiledMachine::from_blob(blob) else {
        return -1;
    };
    let state = State {
        q: PerAxis::from_fn(|axis| q[axis]),
        ..State::default()
    };
    delta.copy_from_slice(&machine.first_order(&state).delta.0);
    machine.chain().joints().len() as i32
}

/// One cycle of a guard of three axes: the permitted part of the requested corrections (mm), given the applied ones.
/// The guard is rebuilt at each call, so this only tests that it links. Returns 1 if a correction must be written, 0 if
/// not, −1 if the limits are rejected.
///
/// # Safety
/// `wanted` and `applied` point to 9 numbers, `output` to 9 writable ones.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn volcomp_guard_cycle(
    limit_mm: f64,
    wanted: *const f64,
    applied: *const f64,
    output: *mut f64,
) -> i32 {
    // SAFETY: the caller keeps the lengths stated above.
    let (wanted, applied) = unsafe { (slice::from_raw_parts(wanted, 9), slice::from_raw_parts(applied, 9)) };
    // SAFETY: as above, for writing.
    let output = unsafe { slice::from_raw_parts_mut(output, 9) };
    let axis = AxisLimits {
        kind: AxisKind::Linear,
        limit: limit_mm,
        warn: limit_mm,
        slew_per_s: 0.5,
        accel_per_s2: f64::INFINITY,
        resolution: 0.001,
        includes_correction: false,
    };
    let limits = Limits {
        axes: [axis; MAX_AXES],
        count: 3,
        period: Duration::from_millis(4),
        hold: Duration::from_millis(50),
        zero_after: Duration::from_millis(500),
        ramp: Duration::from_millis(500),
        test_shift: PerChannel::ZERO,
        read_back_cycles: 2,
        only_thermal: false,
    };
    let Ok(mut guard) = Guard::new(limits) else { return -1 };
    let mut read_back = ReadBack::plain(Duration::ZERO);
    let told = CorrectionReport::Values(PerChannel::from_fn(|i| applied[i]));
    read_back.receive(Duration::ZERO, Duration::ZERO, &told, &limits);
    let reading = Reading {
        taken: Duration::ZERO,
        positions: PerChannel::ZERO,
    };
    let found = guard.cycle(&Inputs {
        reading: Some(reading),
        read_back: *read_back.status(),
        requested: Some(RequestedCorrection::linear(PerChannel::from_fn(|i| wanted[i]))),
        ..Inputs::default()
    });
    output.copy_from_slice(&found.correction[..]);
    i32::from(found.write)
}
