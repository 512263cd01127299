#![no_main]
//! NC programs: no panic on any text, and a machine without errors returns every accepted program unchanged.

use libfuzzer_sys::fuzz_target;
use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{Corrector, Dialect, Job, SetUp, compensate};

const TRAVELS: &str = "structure = \"w X' b Y Z t\"
axes.X.travel = [-500.0, 500.0]
axes.Y.travel = [-400.0, 400.0]
axes.Z.travel = [-400.0, 400.0]
";
const ERRORS: &str = "errors.EXX = { mean = { poly = [0.0, 0.05] }, reversal = 3.0 }
errors.EYX = { poly = [0.0, 0.0, 0.0001] }
errors.EC0Y = 40.0
";

thread_local! {
    static CORRECTORS: [Corrector; 2] = [TRAVELS.to_owned(), format!("{TRAVELS}{ERRORS}")].map(|text| {
        let machine = Machine::parse(&text, "machine.toml").expect("a good machine");
        Corrector::new(&machine, &Temperatures::new(), 0.001).expect("compiles")
    });
}

fuzz_target!(|program: &[u8]| {
    CORRECTORS.with(|[plain, worn]| {
        for dialect in [Dialect::Rs274, Dialect::Siemens, Dialect::Heidenhain] {
            let run = |corrector: &Corrector| {
                let mut out = Vec::new();
                let setup = SetUp::default();
                let job = Job { dialect, most_blocks: 20_000, ..Job::new(corrector, &setup) };
                compensate(&mut &program[..], &mut out, job, |_| Ok(())).map(|_| out)
            };
            if let Ok(same) = run(plain) {
                assert_eq!(same, program);
                let _ = run(worn);
            }
        }
    });
});
