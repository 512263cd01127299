//! An independent client (pyfocas) against the simulator.

use std::process::Command;

use volcomp_focas::simulator::Options;

use crate::simulator;

#[test]
fn pyfocas_understands_the_simulator() {
    let Some(python) = volcomp_test_support::peers::python() else {
        return;
    };
    for version in [2, 3, 4] {
        let simulator = simulator(Options {
            version,
            ..Options::default()
        });
        simulator.world().macros.insert(100, -12.5);
        let program = "import sys\n\
            from pyfocas.protocol.protocol import FOCAS\n\
            f = FOCAS('127.0.0.1', int(sys.argv[1]))\n\
            assert f.connect()\n\
            info = f.get_sys_info()\n\
            assert (info.series, info.version, info.axes) == ('D4G3', '28.0', '04'), info\n\
            status = f.get_status_info()\n\
            assert (status.run, status.emergency, status.alarm) == (3, 0, 0), status\n\
            f.write_macro_double(500, 1.5)\n\
            assert f.read_macro(500) == {500: 1.5}\n\
            assert f.read_macro(100) == {100: -12.5}\n";
        let output = Command::new(&python)
            .args(["-c", program, &simulator.address().port().to_string()])
            .output()
            .unwrap();
        assert!(output.status.success(), "{output:?}");
        assert_eq!(simulator.world().macros[&500], 1.5);
    }
}
