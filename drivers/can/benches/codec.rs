//! Time to decode a position frame and to encode a correction frame.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use volcomp_can::{SHIPPED_DBC, SignalTable};

fn codec(c: &mut Criterion) {
    let table = SignalTable::parse(SHIPPED_DBC).expect("the shipped file");
    let named = |name: &str| table.messages.iter().find(|m| m.name == name).expect("shipped");
    let (position, correction) = (named("POSITION_XY"), named("CORRECTION"));
    let mut data = [1, 2, 3, 4, 5, 6, 7, 8];
    position.seal(&mut data, 3);
    c.bench_function("decode a frame", |b| {
        b.iter(|| {
            let data = black_box(&data);
            let whole = position.is_whole(data);
            let [x, y] = [0, 1].map(|k| position.signals[k].value(data));
            (whole, position.counter(data), x, y)
        });
    });
    c.bench_function("encode a frame", |b| {
        let mut frame = correction.frame().expect("eight bytes");
        b.iter(|| {
            for signal in &correction.signals[..4] {
                signal.put(frame.data_mut(), black_box(12.3));
            }
            correction.seal(frame.data_mut(), black_box(5));
            frame
        });
    });
}

criterion_group!(benches, codec);
criterion_main!(benches);
