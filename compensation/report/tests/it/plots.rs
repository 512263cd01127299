//! Plots of arbitrary numbers.

use proptest::prelude::*;
use volcomp_report::plot::{
    Arrow, Band, Bars, Bracket, HeatMap, Look, Mark, Panel, PathPlot, PathPoint, PolarPlot, Quiver,
    Series, SquareSketch, XyPlot, bars, heat_map, path_plot, picture, polar, quiver, square_sketch,
    thinned, ticks, xy,
};

fn any() -> impl Strategy<Value = f64> {
    prop_oneof![
        -1e3..1e3_f64,
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY),
        Just(0.0),
        Just(1e300),
        Just(-1e300),
        Just(1e-300),
    ]
}

fn sound(svg: &str) {
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    assert!(svg.starts_with("<svg") && svg.ends_with("</svg>"));
    assert!(!svg.contains("<b>"), "{svg}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_number_breaks_a_plot(points in prop::collection::vec((any(), any()), 0..40), ends in [any(), any()]) {
        let (x, y): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
        sound(&xy(&XyPlot {
            words: "<b>".to_owned(), x_label: "<b>".to_owned(), y_label: "<b>".to_owned(),
            x_named: ends[0] > 0.0,
            x_range: Some(ends),
            y_range: None,
            width: ends[1], height: 200.0,
            series: vec![Series { name: "<b>".to_owned(), points: points.clone(), look: Look::Forward, mark: Mark::Up, line: true }],
            bands: vec![Band { x: x.clone(), low: y.clone(), high: y.clone(), look: Look::Backward }],
            brackets: vec![Bracket { label: "<b>".to_owned(), span: ends, at: None }, Bracket { label: "R".to_owned(), span: ends, at: Some(ends[0]) }],
            legend: vec![(Look::Forward, Mark::Cross, "<b>".to_owned())], band_label: "<b>".to_owned(),
        }));
        sound(&heat_map(&HeatMap {
            words: "<b>".to_owned(), title: "<b>".to_owned(), x_label: "<b>".to_owned(), y_label: String::new(),
            x: x.clone(), y: y.iter().take(3).copied().collect(), values: x.clone(), most: ends[0], unit: "<b>".to_owned(),
            arrows: points.iter().map(|(a, b)| ([*a; 2], [*b; 2])).collect(), arrow_scale: ends[1],
        }));
        sound(&quiver(&Quiver {
            words: "<b>".to_owned(), travels_mm: [ends; 3],
            arrows: points.iter().map(|(a, b)| Arrow { at_mm: [*a; 3], error_um: [*b; 3], after: *a > 0.0 }).collect(),
            scale_word: "<b>".to_owned(),
        }));
        sound(&polar(&PolarPlot {
            words: "<b>".to_owned(), axes: ["<b>".to_owned(), "Y".to_owned()], unit: "<b>".to_owned(),
            series: vec![("<b>".to_owned(), Look::Backward, points.clone())],
        }));
        sound(&bars(&Bars {
            words: "<b>".to_owned(), label: "<b>".to_owned(), legend: ["<b>".to_owned(), "max".to_owned()],
            rows: points.iter().map(|(a, b)| ("<b>".to_owned(), *a, *b)).collect(),
        }));
        let path: Vec<PathPoint> = points.iter().map(|(a, b)| PathPoint { at_mm: [*a, *b], deviation_um: [*b, *a], size_um: *a, begins: *b > 0.0 }).collect();
        sound(&path_plot(&PathPlot {
            words: "<b>".to_owned(), labels: ["<b>".to_owned(), "Y".to_owned()], range_mm: [ends; 2], width: ends[0], magnification: ends[1],
            most_um: ends[0], worst: path.first().map(|point| (*point, "<b>".to_owned())), points: path,
        }));
        sound(&square_sketch(&SquareSketch {
            words: "<b>".to_owned(), first: "<b>".to_owned(), second: "Y".to_owned(), angle_urad: ends[0], exaggeration: ends[1], label: "<b>".to_owned(),
        }));
    }

    #[test]
    fn thinning_keeps_the_ends_and_the_extremes(mut x in prop::collection::vec(-1e3..1e3_f64, 1..3000), most in 8..400_usize) {
        x.sort_by(f64::total_cmp);
        let points: Vec<(f64, f64)> = x.iter().map(|x| (*x, (x * 7.3).sin() * x)).collect();
        let kept = thinned(&points, most);
        prop_assert!(kept.len() <= most.max(8) + 4);
        let extreme = |of: &[(f64, f64)]| of.iter().map(|p| p.1).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), y| (l.min(y), h.max(y)));
        prop_assert_eq!(extreme(&kept), extreme(&points));
        prop_assert_eq!((kept[0].0, kept[kept.len() - 1].0), (x[0], x[x.len() - 1]));
    }

    #[test]
    fn ticks_are_within_and_not_too_many(low in any(), high in any(), count in 0..12_usize) {
        let (values, decimals) = ticks([low, high], count);
        prop_assert!(values.len() <= 4 * count + 1 && decimals <= 9);
        prop_assert!(values.iter().all(|v| v.is_finite()));
    }
}

#[test]
fn a_picture_is_one_document() {
    let plot = |points: &[(f64, f64)], span: [f64; 2]| XyPlot {
        words: "a plot".to_owned(),
        x_label: "target, mm".to_owned(),
        x_named: true,
        y_label: "deviation, µm".to_owned(),
        x_range: None,
        y_range: Some([-1.0, 3.0]),
        width: 340.0,
        height: 120.0,
        series: vec![Series {
            name: "mean".to_owned(),
            points: points.to_vec(),
            look: Look::Forward,
            mark: Mark::Up,
            line: true,
        }],
        bands: Vec::new(),
        brackets: vec![Bracket { label: "E 2.0".to_owned(), span, at: None }],
        legend: vec![(Look::Forward, Mark::Up, "mean".to_owned())],
        band_label: String::new(),
    };
    let panel = |heading: &str, plot: XyPlot| Panel { heading: heading.to_owned(), svg: xy(&plot) };
    let row = vec![
        panel("first", plot(&[(0.0, 0.0), (100.0, 2.0)], [0.0, 2.0])),
        panel("second", plot(&[(0.0, 1.0), (100.0, -1.0)], [-1.0, 1.0])),
    ];
    let svg = picture("Two < three", &["a & b.csv".to_owned()], &[row]);
    insta::assert_snapshot!(svg);
}
