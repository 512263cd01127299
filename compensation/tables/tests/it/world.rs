use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use volcomp_tables::{
    GRID_AXES, GridAxis, HEADER_WORDS, Header, Layout, Lines, Map, OUTPUTS, Output, Request,
    barrier,
    control::Settings,
    protocol::Counts,
    vocabulary::AxisName::{self, X, Y, Z},
};

/// Request over this number of axes, 0 to 1000 mm or deg each, for the correction of this number of outputs.
pub(crate) fn request(axes: usize, outputs: usize, within_um: f64) -> Request {
    let names = [X, Y, Z, AxisName::A, AxisName::C];
    let axis = |name| GridAxis { name, travel: [0.0, 1000.0], step: 0.001 };
    let output = |name| Output { name, step_mm: 0.001, limit_mm: 2.0 };
    Request {
        axes: names[..axes].iter().copied().map(axis).collect(),
        outputs: names[..outputs].iter().copied().map(output).collect(),
        within_mm: within_um * 1e-3,
        words: 32767,
        counter: 1,
        model: 0x1234_5678,
    }
}

/// Random settings with small numbers of scans, and buffers for maps of 300 words.
pub(crate) fn settings(rng: &mut ChaCha8Rng) -> Settings {
    let (axes, outputs) = (rng.random_range(1..=GRID_AXES), rng.random_range(1..=OUTPUTS));
    let hold_scans = rng.random_range(1..20);
    let furthest = [40, 32767][rng.random_range(0..2)];
    let grid = [X, AxisName::C, Z, AxisName::W, Y];
    let corrected = [Z, X, AxisName::W];
    Settings {
        grid: Layout::of(grid[..axes].iter().copied()).expect("each once"),
        position_step_millionths: core::array::from_fn(|_| rng.random_range(1..2_000_000_000)),
        output_step_nm: core::array::from_fn(|_| rng.random_range(1..2_000_000_000)),
        capacity: 300,
        turned: core::array::from_fn(|_| rng.random_range(1..50)),
        outputs: barrier::Settings {
            axes: Layout::of(corrected[..outputs].iter().copied()).expect("each once"),
            machine: rng.random_range(0..=65534),
            limit: Counts::from_fn(|_| rng.random_range(1..furthest)),
            rate: Counts::from_fn(|_| rng.random_range(1..60)),
            step_scans: rng.random_range(1..4),
            hold_scans,
            time_out_scans: 2 * hold_scans + rng.random_range(0..40),
        },
    }
}

pub(crate) fn map(rng: &mut ChaCha8Rng, settings: &Settings, counter: u16) -> Map {
    let (axes, outputs) = (settings.grid.count(), settings.outputs.axes.count());
    // The map has at most 232 values.
    let most = [70_u16, 8, 4, 2, 2][axes - 1];
    let scale = [1, 3, 64][rng.random_range(0..3)];
    let far = rng.random_bool(0.1);
    let lines = core::array::from_fn(|axis| {
        if axis >= axes {
            return Lines::default();
        }
        let [part, parts] = if far {
            [rng.random_range(1..3000), rng.random_range(1..3000)]
        } else {
            [rng.random_range(1..40), rng.random_range(1..40)]
        };
        let origin = if far { 900_000_000 } else { 2000 };
        Lines {
            origin: rng.random_range(-origin..origin),
            part,
            parts,
            count: rng.random_range(2..=most),
            step_millionths: settings.position_step_millionths[axis],
        }
    });
    let most = |output: usize| {
        let most = i32::from(settings.outputs.limit[output]) * i32::from(scale);
        i16::try_from(most).unwrap_or(i16::MAX)
    };
    let mut reversal = [[0; OUTPUTS]; GRID_AXES];
    for row in reversal.iter_mut().take(axes) {
        for (output, value) in row.iter_mut().enumerate().take(outputs) {
            let most = most(output).min(100);
            *value = rng.random_range(-most..=most);
        }
    }
    let header = Header {
        counter,
        model: rng.random(),
        grid: settings.grid,
        outputs: settings.outputs.axes,
        scale,
        lines,
        reversal,
        output_step_nm: settings.output_step_nm,
    };
    let values: Vec<i16> = (0..header.values())
        .map(|at| {
            let most = most(at % outputs);
            rng.random_range(-most..=most)
        })
        .collect();
    let map = Map::new(header, &values).expect("within all ranges");
    assert!(map.words().len() <= 300, "{header:?}");
    assert_eq!(map.words().len(), HEADER_WORDS + values.len());
    map
}

/// A random position in or around the grid of a map.
pub(crate) fn somewhere(rng: &mut ChaCha8Rng, header: &Header) -> [i32; GRID_AXES] {
    core::array::from_fn(|axis| {
        if rng.random_bool(0.02) {
            return rng.random();
        }
        let lines = &header.lines[axis];
        let way = lines.pitch() * (i32::from(lines.count) - 1).max(0) + 40;
        lines.origin.saturating_add(rng.random_range(-40..way))
    })
}
