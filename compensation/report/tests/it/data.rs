use volcomp_report::{
    BandSource, CheckOf, Drawn, Edition, Figures, Identified, Parameter, Report, State, Stated,
    Verdict, WarningKind, checks, tolerances, volume,
};
use volcomp_vocabulary::AxisName;

use crate::{Shop, machine};

/// Report of a machine file with these additional lines.
fn stated(more: &str) -> Report {
    Report::of_machine("machine.toml", &machine(more), &Stated::default())
}

#[test]
fn runs_stand_where_their_curve_is() {
    let shop = Shop::new();
    let report = shop.report();
    let names: Vec<&str> = report.curves.iter().map(|curve| curve.error.as_str()).collect();
    assert_eq!(names, ["EBX", "EXX", "EYX"]);
    for curve in &report.curves {
        let [line] = &curve.lines[..] else { panic!("one line") };
        assert_eq!(line.runs.len(), 10, "{}", curve.error);
        // The mean of the runs equals the fitted mean reading.
        for (direction, means) in line.means.iter().enumerate() {
            let runs = line.runs.iter().filter(|run| run.direction as usize == direction);
            let runs: Vec<_> = runs.collect();
            for (place, (at, mean)) in means.iter().enumerate() {
                let sum: f64 = runs.iter().map(|run| run.points[place].1).sum();
                assert_eq!(runs[0].points[place].0, *at);
                assert!((sum / runs.len() as f64 - mean).abs() < 1e-9);
            }
        }
        for branch in &curve.branches {
            let fit = branch.fit.as_ref().expect("fitted");
            assert_eq!(fit.readings, branch.residuals.len());
            let squares: f64 = branch.residuals.iter().map(|(_, r)| r * r).sum();
            let rms = (squares / fit.readings as f64).sqrt();
            assert!(
                (rms - fit.residual.rms).abs() < 1e-6,
                "{}: {rms} {:?}",
                curve.error,
                fit.residual
            );
            let band = branch.band.as_ref().expect("five runs");
            assert_eq!(band.source, BandSource::Runs);
        }
    }
}

/// Linear interpolation at a position between ascending positions.
fn drawn_at(x: &[f64], y: &[f64], at: f64) -> f64 {
    let next = x.partition_point(|place| *place < at).clamp(1, x.len() - 1);
    let share = (at - x[next - 1]) / (x[next] - x[next - 1]);
    y[next - 1] + share * (y[next] - y[next - 1])
}

/// The plotted band equals that of the fit within 2.1 %, at the targets and between them.
#[test]
fn the_band_is_that_of_the_fit() {
    let shop = Shop::new();
    // Waves that targets every 50 mm miss: the band is much wider between the targets.
    shop.write("exx.csv", &crate::csv(17, 50.0, 5, |x, _| 0.02 * x + 3.0 * (x / 21.0).sin()));
    let (file, calibration) = shop.calibrated();
    let report = Report::of_calibration("c.toml", &file, &calibration, &Stated::default());
    let branches = report.curves.iter().flat_map(|curve| &curve.branches);
    for (fitted, branch) in calibration.curves.iter().zip(branches) {
        let found = fitted.band().expect("five runs");
        let band = branch.band.as_ref().expect("a band");
        assert!(band.x.len() <= found.at.len());
        let mut widest = [0.0_f64; 2];
        for (place, (&at, half)) in found.at.iter().zip(&found.half_width).enumerate() {
            let (low, high) = (drawn_at(&band.x, &band.low, at), drawn_at(&band.x, &band.high, at));
            let drawn = 0.5 * (high - low);
            assert!((drawn - half).abs() <= 0.021 * half, "{at}: {drawn} {half}");
            let kind = usize::from(place % 8 != 0);
            widest[kind] = widest[kind].max(drawn);
        }
        if fitted.error.to_string() == "EXX" {
            assert!(widest[1] > 5.0 * widest[0], "{widest:?}");
        }
    }
}

#[test]
fn one_run_has_a_band_of_its_residuals() {
    let shop = Shop::new();
    shop.write("exx.csv", &crate::csv(17, 50.0, 1, |x, _| 0.02 * x));
    let report = shop.report();
    let mut curves = report.curves.iter();
    let curve = curves.find(|curve| curve.error == "EXX").expect("EXX");
    let band = curve.branches[0].band.as_ref().expect("a band");
    assert_eq!(band.source, BandSource::Residuals);
    let page = volcomp_report::html(&report);
    assert!(page.contains("With one run its residuals are drawn again"));
}

/// The verdict is undecided if the distance from the limit is below U: the laser scale of 0.5 µm/m (k = 1) over 0.8 m gives U = 0.8 µm.
#[test]
fn a_figure_near_its_limit_is_undecided() {
    let shop = Shop::new();
    let stated = "[uncertainty]\nlaser_um_per_m = 0.5\n";
    let text = shop.read("calibration.toml");
    shop.write(
        "calibration.toml",
        &text.replacen("[[measurement]]", &format!("{stated}[[measurement]]"), 1),
    );
    let report = shop.report();
    let test = &report.positioning[0];
    let e = test.figure("E").expect("E");
    assert!((test.uncertainty("E").expect("stated") - 0.8).abs() < 1e-9);
    assert_eq!(test.uncertainty("B"), None);
    for (limit, outcome) in [
        (e + 0.9, Verdict::Pass),
        (e + 0.7, Verdict::Undecided),
        (e - 0.7, Verdict::Undecided),
        (e - 0.9, Verdict::Fail),
    ] {
        let limits = tolerances(&format!("E={limit}")).expect("one");
        let found = checks(&report, &limits);
        assert_eq!(found[0].outcome, outcome, "{limit}");
    }
    let limits = tolerances(&format!("E={}", e + 0.7)).expect("one");
    let report = Report { checks: checks(&report, &limits), ..report };
    let page = volcomp_report::html(&report);
    assert!(page.contains("undecided") && page.contains("Not every stated tolerance is decided"));
}

/// The reference angle of 2 µrad (k = 1) gives U = 4 µrad for the squareness. Two mean readings of 0.3 µm give U = 2 √2
/// · 0.3 µm for a straightness, and two of 0.5 µrad give U = 2 √2 · 0.5 µrad for a tilt. For positioning the scale of
/// 0.5 µm/m is added in quadrature.
#[test]
fn squareness_and_error_motions_are_judged_with_their_uncertainty() {
    let shop = Shop::new();
    let text = shop.read("calibration.toml");
    let judged = |uncertainty: &str| {
        shop.write(
            "calibration.toml",
            &text.replacen("[[measurement]]", &format!("{uncertainty}[[measurement]]"), 1),
        );
        let limits = tolerances("EC0Y=15,EYX=100,EBX=100,EXX=100,V=20").expect("five");
        let mut report = shop.report();
        report.checks = checks(&report, &limits);
        report
    };
    let report = judged(
        "[uncertainty]\nlaser_um_per_m = 0.5\nsquare_urad = 2.0\nreading_um = 0.3\nreading_urad = 0.5\n",
    );
    let of = |symbol: &str| {
        let mut all = report.checks.iter();
        all.find(|check| check.symbol == symbol).expect("a check")
    };
    let u = |symbol: &str| of(symbol).uncertainty.expect(symbol);
    assert_eq!(u("EC0Y"), 4.0);
    // 12 + 4 exceeds the limit of 15, 12 does not.
    assert_eq!(of("EC0Y").outcome, Verdict::Undecided);
    assert!((u("EYX") - 0.848_528).abs() < 1e-6, "{}", u("EYX"));
    assert!((u("EBX") - core::f64::consts::SQRT_2).abs() < 1e-6, "{}", u("EBX"));
    // 0.02 µm/mm over 800 mm plus a wave: the extremes are at or near the ends.
    let (least, most) = (
        (0.848_528_f64.powi(2) + 0.7_f64.powi(2)).sqrt(),
        (0.848_528_f64.powi(2) + 0.8_f64.powi(2)).sqrt(),
    );
    assert!((least..most + 1e-6).contains(&u("EXX")), "{}", u("EXX"));
    // Without Monte Carlo samples V has no uncertainty; a missing value needs none.
    assert_eq!(of("V").uncertainty, None);

    let report = judged("");
    let page = volcomp_report::html(&report);
    assert!(report.checks.iter().all(|check| check.uncertainty.is_none()));
    assert_eq!(page.matches("no uncertainty given").count(), 4);
}

/// A squareness from lines is judged with the scatter of their slopes, without any stated contribution; a line of one run is named.
#[test]
fn a_squareness_from_lines_is_judged_with_their_slopes() {
    let shop = Shop::new();
    shop.write("exy.csv", &crate::csv(13, 50.0, 1, |y, _| 0.004 * y));
    let text = shop.read("calibration.toml");
    shop.write(
        "calibration.toml",
        &text.replace(
            "[[squareness]]\nerror = \"EC0Y\"\nvalue_urad = 12.0\n",
            "[[measurement]]\nerror = \"EXY\"\nfile = \"exy.csv\"\n[[squareness]]\nerror = \"EC0Y\"\nreference_angle_urad = 0.0\n",
        ),
    );
    let report = shop.report();
    let found = checks(&report, &tolerances("EC0Y=15").expect("one"));
    let u = found[0].uncertainty.expect("of the slopes");
    let known = shop.calibrated().1.square_uncertainties;
    assert!((u - 2.0 * known[&"EC0Y".parse().expect("a name")].0).abs() < 1e-12);
    assert!((0.1..5.0).contains(&u), "{u}");
    let mut warnings = report.warnings.iter();
    assert!(warnings.any(|of| of.text.contains("exy.csv: one run; U of the squareness")));
    // Five of the 21 errors have a value: EXX, EYX, EBX, EXY and the squareness of X and Y.
    assert_eq!(report.count_as_0, 16);
    assert_eq!(
        report.all_met(),
        "all stated tolerances are met; 16 errors were not measured and count as 0"
    );
}

/// The symbols are those of the edition; VDI/DGQ 3441 is included, and its tolerances are checked.
#[test]
fn editions_and_vdi_stand_in_the_report() {
    let shop = Shop::new();
    let (file, calibration) = shop.calibrated();
    let page = |edition| {
        let stated = Stated { edition, ..Stated::default() };
        let mut report = Report::of_calibration("c.toml", &file, &calibration, &stated);
        report.checks = checks(&report, &tolerances("P=100,Ps_max=0.001").expect("two"));
        volcomp_report::html(&report)
    };
    let [old, new] = [Edition::Iso1997, Edition::Iso2014].map(page);
    assert!(old.contains("ISO 230-2:1997") && old.contains("B reversal value"));
    assert!(new.contains("ISO 230-2:2014") && new.contains("B reversal error"));
    assert!(
        new.contains("P positional uncertainty")
            && new.contains("Not all stated tolerances are met")
    );
}

/// Waves that the curve does not follow leave the error undecided, so V does not pass.
#[test]
fn a_figure_that_the_curve_does_not_bear_out_does_not_pass() {
    let shop = Shop::new();
    shop.write("exx.csv", &crate::csv(17, 50.0, 5, |x, _| 20.0 * (x / 40.0).sin()));
    let text = shop.read("calibration.toml");
    let parabola = "file = \"exx.csv\"\ncurve = { poly = { order = 2 } }\n";
    shop.write("calibration.toml", &text.replace("file = \"exx.csv\"\n", parabola));
    let (_, calibration) = shop.calibrated();
    let mut report = shop.report();
    assert_eq!(report.undecided, ["EXX"]);
    let machine = &calibration.machine;
    let none = |_: &volcomp_kinematics::State| [0.0; 6];
    let fields = [field(machine, &none)];
    let of_curves = || {
        let found = volcomp_model::volumetric(&fields).expect("a valid machine");
        (State::Found, &fields[..], found)
    };
    report.volume = volume([machine; 2], &[], of_curves(), None).expect("three axes");
    let limits = tolerances("V=1000,EXX=60").expect("two");
    let found = checks(&report, &limits);
    assert_eq!((found[0].outcome, &found[0].of), (Verdict::Undecided, &CheckOf::NotConfirmed));
    assert_eq!(found[1].outcome, Verdict::Pass);
    // The machine file keeps the error undecided until it is set again.
    let text_of_machine = machine.to_toml();
    let mut read = volcomp_model::Machine::parse(&text_of_machine, "m.toml").expect("valid");
    assert_eq!(read.to_toml(), text_of_machine);
    let mut report = Report::of_machine("m.toml", &read, &Stated::default());
    report.volume = volume([machine; 2], &[], of_curves(), None).expect("three axes");
    for check in checks(&report, &limits) {
        assert_eq!((check.outcome, &check.of), (Verdict::Undecided, &CheckOf::NotConfirmed));
    }
    assert!(report.warnings.iter().any(|of| of.text.contains("do not confirm EXX")));
    assert!(report.not_measured.iter().any(|of| of.contains("EZX")));
    let name = "EXX".parse().expect("a name");
    let curve = read.error(name).expect("stated").clone();
    read.set_error(name, curve).expect("valid");
    assert!(read.provenance().note().is_none());
    // Two contradictory lines of one run each.
    for (file, slope) in [("exx.csv", 0.02), ("second.csv", -0.02)] {
        shop.write(file, &crate::csv(17, 50.0, 1, |x, _| slope * x));
    }
    let second = "file = \"exx.csv\"\n[[measurement]]\nerror = \"EXX\"\nat = { Y = 500.0 }\nfile = \"second.csv\"\n";
    shop.write("calibration.toml", &text.replace("file = \"exx.csv\"\n", second));
    assert_eq!(shop.report().undecided, ["EXX"]);
    shop.write("calibration.toml", &text);
    shop.write("exx.csv", &crate::csv(1, 50.0, 5, |_, _| 20.0));
    let found = checks(&shop.report(), &limits);
    assert_eq!(found[1].outcome, Verdict::NotEvaluated, "{found:?}");
}

/// A file with a single run shows no scatter: verdicts whose uncertainty lacks it do not pass, until the calibration file states it.
#[test]
fn an_uncertainty_without_the_scatter_of_a_file_passes_nothing() {
    let shop = Shop::new();
    let text = shop.read("calibration.toml");
    let limits = tolerances("V=1000").expect("one");
    let found = |runs, stated: &str| {
        shop.write("exx.csv", &crate::csv(17, 50.0, runs, |x, _| 0.01 * x));
        shop.write("calibration.toml", &text.replacen("[[m", &format!("{stated}[[m"), 1));
        let (_, calibration) = shop.calibrated();
        let mut report = shop.report();
        let none = |_: &volcomp_kinematics::State| [0.0; 6];
        let fields = [field(&calibration.machine, &none)];
        let both = [&calibration.machine; 2];
        let of_curves = || {
            let found = volcomp_model::volumetric(&fields).expect("a valid machine");
            (State::Found, &fields[..], found)
        };
        report.volume = volume(both, &[], of_curves(), None).expect("three axes");
        assert_eq!(checks(&report, &limits)[0].outcome, Verdict::Pass, "by the figure alone");
        let judged = [0.1, 0.0].map(|um| {
            report.uncertainty.get_or_insert_default().drawn =
                Some(Drawn { trials: 100, seed: 1, rms_um: um, max_um: um, at: Vec::new() });
            let [check] = &checks(&report, &limits)[..] else { panic!("one check") };
            (check.outcome, check.of.clone())
        });
        // If no file has several runs, no Monte Carlo samples are drawn.
        assert_eq!(judged[0], judged[1]);
        judged[0].clone()
    };
    assert_eq!(found(1, ""), (Verdict::Undecided, CheckOf::ScatterUnknown));
    assert_eq!(found(5, "").0, Verdict::Pass);
    let stated = "[uncertainty]\nreading_um = 1.0\nreading_urad = 1.0\n";
    assert_eq!(found(1, stated).0, Verdict::Pass);
}

/// Only the uncertainty of a machine found from readings can be evaluated by --trials, and only once.
#[test]
fn a_figure_without_uncertainty_states_the_reason() {
    let limits = tolerances("V=1000,EYX=1000").expect("two");
    let shop = Shop::new();
    let none = |_: &volcomp_kinematics::State| [0.0; 6];
    let drawn = Drawn { trials: 100, seed: 1, rms_um: 0.0, max_um: 0.0, at: Vec::new() };
    let reasons = |mut report: Report, is_corrected, drawn| {
        let (_, calibration) = shop.calibrated();
        let machine = &calibration.machine;
        let fields = [field(machine, &none)];
        let of = |state| (state, &fields[..], error_of(machine, &none));
        report.volume = if is_corrected {
            volume([machine; 2], &[], of(State::Truth), Some(of(State::TruthCorrected)))
        } else {
            volume([machine; 2], &[], of(State::Found), None)
        }
        .expect("three axes");
        report.uncertainty.get_or_insert_default().drawn = drawn;
        let found = checks(&report, &limits);
        found.into_iter().map(|check| check.to_string()).collect::<Vec<_>>()
    };
    let missing = "(uncertainty not evaluated: --trials)";
    let zero = "(no uncertainty given)";
    let corrected = "(the uncertainty of what a correction leaves is not evaluated)";
    for (report, is_corrected, drawn, reason) in [
        (shop.report(), false, None, missing),
        (shop.report(), false, Some(drawn.clone()), zero),
        (shop.report(), true, None, corrected),
        (shop.report(), true, Some(drawn), corrected),
        (stated("[errors]\nEXX = { poly = [0.0, 0.02] }\n"), false, None, zero),
    ] {
        let [of_volume, of_straightness] = &reasons(report, is_corrected, drawn)[..] else {
            panic!("two checks")
        };
        assert!(of_volume.ends_with(reason), "{of_volume}, expected {reason}");
        assert!(!of_straightness.contains("--trials"), "{of_straightness}");
    }
}

/// An error whose value requires another unknown to be zero is undetermined unless that unknown is known to be zero.
#[test]
fn an_unknown_that_holds_if_another_is_zero_is_open_where_that_is() {
    let parameter = |name: &str, uncertainty, given_zero: &[&str]| Parameter {
        name: name.to_owned(),
        value: 0.0,
        uncertainty,
        unit: "µrad".to_owned(),
        given_zero: given_zero.iter().map(|zero| (*zero).to_owned()).collect(),
    };
    let left = Figures { rms_um: 0.0, max_um: 0.0, rows: 9 };
    let found = Identified {
        parameters: vec![
            parameter("EA0Z", Some(0.3), &["EAZ legendre 1"]),
            parameter("EB0Z", Some(0.3), &["EBZ constant"]),
            parameter("EAZ legendre 1", None, &[]),
            parameter("EBZ constant", None, &[]),
            parameter("t.csv:frame.x", None, &[]),
        ],
        rank: 2,
        of: 3,
        score: 1.0,
        excess: 1.0,
        residual: left,
        left_out: None,
        judged: None,
        null_space: Vec::new(),
        redundant: vec!["EBZ constant".to_owned()],
        next: None,
    };
    let open: Vec<&str> = found.left_open().collect();
    assert_eq!(open, ["EAZ legendre 1"]);
    let open = ["EA0Z", "EAZ", "EB0Z", "EBZ"].map(|error| found.leaves_open(error));
    assert_eq!(open, [true, true, false, false]);
    // The residual is twice the stated uncertainty, so U is twice as large.
    let mut report = Shop::new().report();
    let known = parameter("EC0Y", Some(0.5), &[]);
    report.identified = Some(Identified { parameters: vec![known], excess: 2.0, ..found });
    let check = checks(&report, &tolerances("EC0Y=20").expect("one"));
    assert_eq!(check[0].uncertainty, Some(2.0));
    report.without_scatter.push("one.csv".to_owned());
    let check = checks(&report, &tolerances("EC0Y=10").expect("one"));
    let open = (Verdict::Undecided, &CheckOf::ScatterUnknown);
    assert_eq!((check[0].outcome, &check[0].of), open);
}

/// A squareness is checked on the axis to which it is assigned, with its own uncertainty, and with readings in one direction only.
#[test]
fn what_a_squareness_is_judged_by() {
    let shop = Shop::new();
    let text = shop.read("calibration.toml");
    let judged = |text: &str| {
        shop.write("calibration.toml", text);
        let report = shop.report();
        let found = checks(&report, &tolerances("EC0Y=13").expect("one"));
        (found[0].clone(), report)
    };
    let (on_y, report) = judged(&text);
    assert_eq!((on_y.value, on_y.uncertainty), (Some(12.0), None));
    assert!(!report.not_measured.iter().any(|of| of.contains("one direction")));
    let (on_x, _) = judged(&format!("reference_axes = [\"Y\", \"Z\"]\n{text}"));
    assert_eq!(on_x.value, Some(12.0));
    let (square, _) = text.split_once("[[squareness]]").expect("the last table");
    let stated = "[[location]]\nerror = \"EC0Y\"\nvalue_urad = 12\nuncertainty_urad = 5\n";
    let (own, _) = judged(&format!("{square}{stated}"));
    assert_eq!((own.uncertainty, own.outcome), (Some(10.0), Verdict::Undecided));
    let exx = shop.read("exx.csv");
    let forward = exx.lines().filter(|line| !line.contains(",-,"));
    shop.write("exx.csv", &(forward.collect::<Vec<_>>().join("\n") + "\n"));
    let told = |of: &String| of.ends_with("is not known: EXX");
    let (_, report) = judged(&text);
    assert!(report.not_measured.iter().any(told));
    // The machine file records that one direction of EXX is unknown, so the report of the machine file lists it too.
    let (_, calibration) = shop.calibrated();
    let written = calibration.machine.to_toml();
    let machine = volcomp_model::Machine::parse(&written, "machine.toml").expect("written");
    let report = Report::of_machine("machine.toml", &machine, &Stated::default());
    assert!(report.not_measured.iter().any(told));
}

/// An angle in `[assembly]` is part of the squareness, so the location error alone is not evaluated.
#[test]
fn no_location_is_judged_beside_assembly_errors() {
    let report = stated("[assembly]\nY = [0, 0, 0, 0, 0, 50]\n[errors]\nEXX = 3.0\n");
    let found = checks(&report, &tolerances("EC0Y=1").expect("one"));
    assert_eq!((found[0].value, found[0].outcome), (None, Verdict::NotEvaluated));
    let told = |of: &volcomp_report::Warning| of.text.contains("[assembly] states errors of Y");
    assert!(report.warnings.iter().any(told), "{:?}", report.warnings);
}

/// The range of an error that depends on a second axis is taken over both axes.
#[test]
fn the_range_of_a_stated_error_is_over_all_that_it_depends_on() {
    let grid = |axes: &str, values: &str| {
        format!(
            "{{ grid = {{ axes = [{axes}], nodes = [[0, 600], [-500, 0]], values = {values} }} }}"
        )
    };
    let of_the_end = "[[60, 0], [60, 0]]";
    let forward = grid("\"Y\", \"Z\"", "[[0, 0], [0, 0]]");
    let backward = grid("\"X\", \"Z\"", of_the_end);
    for (error, curve, range) in [
        ("EZY", grid("\"Y\", \"Z\"", "[[0, 0], [60, 0]]"), 60.0),
        // A grid need not depend on its own axis, and each direction may have its own grid.
        ("EZX", grid("\"Y\", \"Z\"", of_the_end), 60.0),
        ("EZY", format!("{{ forward = {forward}, backward = {backward} }}"), 60.0),
        // Peaks between the points of a plot: a wave, and a narrow peak.
        ("EXX", "{ fourier = [0, 0, 10], period = 5.0 }".to_owned(), 20.0),
        (
            "EXX",
            "{ table = [[0, 0], [502, 0], [502.083, 100], [503, 0], [600, 0]] }".to_owned(),
            100.0,
        ),
    ] {
        let report = stated(&format!("[errors]\n{error} = {curve}\n"));
        let tolerances = tolerances(&format!("{error}=10")).expect("one");
        let found = &checks(&report, &tolerances)[0];
        let value = found.value.expect("evaluated");
        assert!((value - range).abs() < 0.01, "{curve}: {value}");
        assert_eq!(found.outcome, Verdict::Fail, "{curve}");
    }
}

/// The uncertainty is that of the longest tool, whose tip the rotations of a Monte Carlo sample move most.
#[test]
fn the_uncertainty_counts_the_longest_tool() {
    let machine = |tools: &str, slope: f64| {
        machine(&format!("{tools}[errors]\nEAX = {{ poly = [{slope:?}] }}\n"))
    };
    let drawn_with = |tools: &str| {
        let tolerance = volcomp_model::Tolerance::from_nm(1.0);
        let drawn = [-5.0, 5.0].map(|urad| machine(tools, urad).compile(tolerance).expect("small"));
        let ensemble = volcomp_calibrate::Ensemble::new(drawn.to_vec()).expect("two");
        let found = volcomp_report::uncertainty(&machine(tools, 0.0), &ensemble, (2, 1));
        found.expect("evaluated").expect("three axes").max_um
    };
    let long = drawn_with("[tool]\ngauge = [0, 0, 0]\nlength = 1000\n");
    let both = drawn_with("[tool]\ngauge = [0, 0, 0]\nlength = 50\n[tools.LONG]\nlength = 1000\n");
    assert!((long - both).abs() < 1e-3 && both > 1.0, "{long} {both}");
}

#[test]
fn figures_stand_against_tolerances() {
    use Verdict::{Fail, NotEvaluated, Pass};
    let shop = Shop::new();
    let mut report = shop.report();
    let limits = tolerances("A=100,B=1,R=0.001,EC0Y=12.5,EYX=1,V=20,EZZ=3").expect("seven");
    report.checks = checks(&report, &limits);
    let outcomes: Vec<_> =
        report.checks.iter().map(|check| (check.symbol.as_str(), check.outcome)).collect();
    assert_eq!(
        outcomes,
        [
            ("A", Pass),
            ("B", Fail),
            ("R", Fail),
            ("EC0Y", Pass),
            ("EYX", Fail),
            ("V", NotEvaluated),
            ("EZZ", NotEvaluated)
        ]
    );
    let CheckOf::Test { error, file } = &report.checks[0].of else {
        panic!("a test: {:?}", report.checks[0])
    };
    assert!(error == "EXX" && file.ends_with("exx.csv"), "{error} {file}");
    assert_eq!(report.checks[0].of.to_string(), format!("EXX, {file}"));
    assert_eq!(report.checks[5].of, CheckOf::Symbol);
}

#[test]
fn warnings_name_what_lacks_the_gravest_first() {
    let shop = Shop::new();
    shop.write("exx.csv", "target,run,direction,deviation\n0,1,+,0\n200,1,+,1\n400,1,+,2\n");
    let report = shop.report();
    let kinds: Vec<WarningKind> = report.warnings.iter().map(|warning| warning.kind).collect();
    assert!(kinds.is_sorted(), "{kinds:?}");
    let few: Vec<&str> = report
        .warnings
        .iter()
        .filter(|w| w.kind == WarningKind::Few)
        .map(|w| w.text.as_str())
        .collect();
    let [few] = few[..] else { panic!("{few:?}") };
    assert!(
        few.contains("3 targets over 400 mm: ISO 230-2:2014 asks for 5 at least")
            && few.contains("1 run in a direction")
            && few.contains("only one direction was run"),
        "{few}"
    );
    assert!(kinds.contains(&WarningKind::NotMeasured) && kinds.contains(&WarningKind::Temperature));
    let mut texts: Vec<&str> = report.warnings.iter().map(|w| w.text.as_str()).collect();
    texts.sort_unstable();
    let all = texts.len();
    texts.dedup();
    assert_eq!(texts.len(), all, "the same sentence twice");
}

#[test]
fn an_outlier_is_named_with_its_file_run_and_target() {
    let shop = Shop::new();
    let good = crate::csv(17, 50.0, 5, |x, _| 0.02 * x);
    // One reading is 3 µm too large; the line starts with target, run and direction.
    let spoilt =
        good.lines().map(|line| if line.starts_with("400,3,+,") { "400,3,+,11.0" } else { line });
    shop.write("exx.csv", &spoilt.collect::<Vec<_>>().join("\n"));
    let report = shop.report();
    let outlier =
        report.warnings.iter().find(|w| w.kind == WarningKind::Outlier).expect("an outlier");
    assert!(
        outlier.text.contains("exx.csv: ") && outlier.text.contains("target 400 in forward run 3"),
        "{}",
        outlier.text
    );
}

pub(crate) fn field<'a>(
    machine: &'a volcomp_model::Machine,
    errors: &'a dyn Fn(&volcomp_kinematics::State) -> [f64; 6],
) -> volcomp_model::ErrorField<'a> {
    volcomp_model::ErrorField { tool: "", machine, curves: vec![machine], errors }
}

pub(crate) fn error_of(
    machine: &volcomp_model::Machine,
    errors: &dyn Fn(&volcomp_kinematics::State) -> [f64; 6],
) -> volcomp_model::VolumetricError {
    volcomp_model::volumetric(&[field(machine, errors)]).expect("a valid machine")
}

/// An error of x/1000 mm along X has its maximum of 0.8 mm at 800 mm, and 0.4 mm after alignment.
#[test]
fn the_working_space_has_the_sizes_of_its_errors() {
    let shop = Shop::new();
    let (_, calibration) = shop.calibrated();
    let machine = &calibration.machine;
    let errors = |pose: &volcomp_kinematics::State| {
        [
            1e-3 * pose.q[machine.index_of(volcomp_vocabulary::AxisName::X).expect("X")],
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
        ]
    };
    let half = |pose: &volcomp_kinematics::State| errors(pose).map(|x| 0.5 * x);
    let found = volume(
        [machine; 2],
        &[],
        (State::Truth, &[field(machine, &errors)], error_of(machine, &errors)),
        Some((State::TruthCorrected, &[field(machine, &half)], error_of(machine, &half))),
    )
    .expect("no other axes")
    .expect("three axes");
    let size = found.before.found;
    assert!((size.max_um - 800.0).abs() < 1e-9);
    // A translation is no error of form: 400 µm remain at both ends, apart from rotations by the finite number of poses.
    assert!((size.form_max_um - 400.0).abs() < 1.0, "{size:?}");
    assert_eq!(size.at[0].0, AxisName::X);
    assert!([0.0, 800.0].contains(&size.at[0].1));
    // RMS of an error that grows linearly over the travel: its maximum / √3.
    assert!((size.rms_um / (800.0 / 3.0_f64.sqrt()) - 1.0).abs() < 1e-3, "{size:?}");
    assert!((found.after.expect("after").found.max_um - 400.0).abs() < 1e-9);
    assert_eq!(found.slices.len(), 3);
    assert!((found.slices[0].before_um[24] - 400.0).abs() < 1.0, "the last node of the first row");
    assert_eq!(found.vectors.len(), 11 * 11 * 11);
}

#[test]
fn a_machine_file_has_curves_without_readings_and_says_so() {
    let report = stated("[errors]\nEXX = { poly = [0.0, 0.02] }\nEA0Z = 5.0\n");
    assert!(report.curves[0].lines.is_empty() && report.curves[0].branches[0].fit.is_none());
    assert_eq!(report.squareness[0].angle_urad, 5.0);
    assert!(!report.squareness[0].measured);
    let told: Vec<&str> = report.warnings.iter().map(|of| of.text.as_str()).collect();
    assert_eq!(told[0], "not measured, taken as 0: EYX EZX EAX EBX ECX");
    assert!(told[3].starts_with("EC0Y was not measured and is taken as 0"), "{told:?}");
    let report = stated("");
    let warning = &report.warnings[0].text;
    assert!(warning.starts_with("no error of this machine is known"), "{warning}");
}

#[test]
fn the_data_is_the_same_after_json() {
    let report = Shop::new().report();
    let text = serde_json::to_string(&report).expect("JSON");
    let again: Report = serde_json::from_str(&text).expect("a report");
    assert_eq!(again.curves.len(), report.curves.len());
    assert_eq!(serde_json::to_string(&again).expect("JSON"), text);
}

/// On a machine with rotary axes the map applies to one position of the rotary axes, which the page states.
#[test]
fn axes_that_stand_still_are_named() {
    let path = volcomp_test_support::root().join("examples/five-axis.toml");
    let machine = volcomp_model::Machine::read(&path).expect("a machine");
    let mut report = Report::of_machine("five-axis.toml", &machine, &Stated::default());
    let nothing = |_: &volcomp_kinematics::State| [0.0; 6];
    let others = [(AxisName::C, 90.0)];
    report.volume = volume(
        [&machine; 2],
        &others,
        (State::Found, &[field(&machine, &nothing)], error_of(&machine, &nothing)),
        None,
    )
    .expect("three axes");
    let map = report.volume.as_ref().expect("a map");
    let planes: Vec<String> =
        (map.slices.iter()).map(|slice| format!("{}{}", slice.across, slice.up)).collect();
    assert_eq!(planes, ["XY", "XZ", "YZ", "CB"]);
    assert_eq!(map.slices[3].before_um.len(), 625);
    assert_eq!(map.standing, [(AxisName::C, 90.0), (AxisName::B, 0.0)]);
    let page = volcomp_report::html(&report);
    assert!(
        page.contains(
            "Axes that do not move in the pictures over X, Y and Z: C 90.000°, B 0.000°."
        )
    );
}
