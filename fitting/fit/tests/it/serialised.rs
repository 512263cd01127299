//! Tests of serialised fits.

use volcomp_fit::{
    AutoFit, Fit, FitOptions, ThermalOptions, ThermalRecord, fit_auto, fit_linear_table,
};

#[test]
fn a_fit_reads_back_the_same() {
    let x = [0.0, 100.0, 200.0, 300.0, 400.0];
    let u = [0.0, 1.0, 4.0, 9.0, 16.0];
    let options = FitOptions { required_residual: Some(1.0), ..FitOptions::default() };
    let chosen = fit_auto(&x, &u, &options).unwrap();
    let text = serde_json::to_string(&chosen).unwrap();
    let read: AutoFit = serde_json::from_str(&text).expect(&text);
    assert_eq!(read.choice.method, chosen.choice.method);
    assert_eq!(read.choice.scores.len(), chosen.choice.scores.len());
    // In a table of two targets, neither target can be predicted from the other: the leave-one-out error is infinite.
    let fits = [
        fit_auto(&x, &u, &options).unwrap().fit,
        fit_linear_table(&x, &u).unwrap(),
        fit_linear_table(&x[..2], &u[..2]).unwrap(),
    ];
    assert!(fits[2].leave_one_out_rms.is_infinite());
    for fit in fits {
        let text = serde_json::to_string(&fit).unwrap();
        let read: Fit = serde_json::from_str(&text).expect(&text);
        assert_eq!(read.curve.kind(), fit.curve.kind());
        for x in [-10.0, 150.0, 400.0] {
            assert!((read.curve.value(x) - fit.curve.value(x)).abs() < 1e-12);
        }
        assert_eq!(read.leave_one_out_rms.is_finite(), fit.leave_one_out_rms.is_finite());
        assert_eq!(read.meets_required, fit.meets_required);
    }
    // A deserialised curve passes the checks of its constructor.
    let broken = r#"{"curve":{"table":{"nodes":[[0.0,1.0]],"interpolation":"linear"}},"residuals":[],"leave_one_out_rms":null,"meets_required":null}"#;
    let error = serde_json::from_str::<Fit>(broken).expect_err("one node").to_string();
    assert!(error.contains("found 1 nodes"), "{error}");
}

#[test]
fn records_and_options_read_back_the_same() {
    let record = ThermalRecord {
        time_s: vec![0.0, 60.0],
        degc: vec![vec![20.0, 20.5]],
        displacement: vec![0.0, 1.0],
    };
    let text = serde_json::to_string(&record).unwrap();
    assert_eq!(serde_json::from_str::<ThermalRecord>(&text).unwrap(), record);
    let options = ThermalOptions::plain();
    let text = serde_json::to_string(&options).unwrap();
    assert_eq!(serde_json::from_str::<ThermalOptions>(&text).unwrap(), options);
}
