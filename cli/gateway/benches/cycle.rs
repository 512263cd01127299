//! A full cycle on the simulated machine: reads, temperatures, model, guard and writes. The same cycle without errors
//! to correct measures the cost of the simulation alone.

use std::{hint::black_box, time::Duration};

use criterion::{Criterion, criterion_group, criterion_main};
use volcomp_gateway::simulate::{self, Simulation};
use volcomp_guard::Request;
use volcomp_port::{Clock, Controller, Thermometer};
use volcomp_runtime::{ControlPath, Cycle, CycleInput, Model, PathPlan, PathSettings, Sensors};
use volcomp_vocabulary::PerChannel;

const PERIOD: Duration = Duration::from_millis(1);

fn cycles(criterion: &mut Criterion) {
    let clock = Clock::manual();
    let guard = simulate::guard();
    let simulation = Simulation::new(clock.clone()).expect("built in");
    let model = Model::new(&simulation.model, guard.fading).expect("built in");
    let settings = PathSettings { proves: false, watch: Duration::ZERO, ..PathSettings::default() };
    let described = simulation.controller.description().clone();
    let plan = PathPlan::new(described, &model, &guard, &settings, PERIOD).expect("built in");
    let path = ControlPath::new(Box::new(simulation.controller), &plan).expect("built in");
    let sensors = Sensors::new(vec![Box::new(simulation.thermometer)], guard.temperatures);
    let mut cycle = Cycle::new(Box::new(model), vec![path], guard.hand_back, sensors, PERIOD)
        .expect("one path")
        .with_start(clock.start());
    let mut asked = CycleInput { request: Some(Request::Arm), ..CycleInput::default() };
    criterion.bench_function("whole cycle, simulated machine", |bencher| {
        bencher.iter(|| {
            clock.advance(PERIOD);
            cycle.run(clock.now(), &asked, &mut || Duration::ZERO);
            asked.request = None;
            black_box(cycle.report().correction)
        });
    });
    let clock = Clock::manual();
    let Simulation { mut controller, mut thermometer, .. } =
        Simulation::new(clock.clone()).expect("built in");
    criterion.bench_function("the simulation alone", |bencher| {
        bencher.iter(|| {
            clock.advance(PERIOD);
            let read = controller.read(clock.now()).map(|snapshot| snapshot.positions);
            let written = controller.apply(&PerChannel::from_fn(|_| 0.001), clock.now());
            black_box((read, written, thermometer.latest().len()))
        });
    });
}

criterion_group!(benches, cycles);
criterion_main!(benches);
