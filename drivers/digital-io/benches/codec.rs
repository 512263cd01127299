//! Time to decode a position and to encode a correction, as in every cycle.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use volcomp_digital_io::{DigitalAxis, PositionCode, Wiring};
use volcomp_vocabulary::AxisName;

fn codec(c: &mut Criterion) {
    let wiring = Wiring { inverted_inputs: 0b101, parity: Some(15), ..Wiring::published() };
    let mut axis = DigitalAxis::published(AxisName::X);
    axis.position.code = PositionCode::Gray;
    let levels = wiring.control_outputs(axis.position.encode(512.0).unwrap_or(0), 0, true);
    c.bench_function("decode and encode", |b| {
        b.iter(|| {
            let word = wiring.position_word(black_box(levels)).unwrap_or(0);
            let place = axis.position.decode(word).position;
            let correction = axis.correction.encode(black_box(-1e-4) * place);
            wiring.levels(correction.word, 0)
        });
    });
}

criterion_group!(benches, codec);
criterion_main!(benches);
