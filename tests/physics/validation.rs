//! The published cases in their short form: what is claimed of them in `tests/validation` must stay true.

use welkin_server::validate::{CASES, Context, Report};

fn quick(name: &str) -> Report {
    let case = CASES.iter().find(|c| c.name == name).expect("a case");
    let context = Context {
        quick: true,
        machine: None::<usize>.into(),
        progress: &|_, _, _| true,
    };
    let report = case.run(&context).expect("it runs");
    for plot in &report.findings.plots {
        let picture = image::load_from_memory(&plot.png).expect("a PNG").to_rgb8();
        let colours: std::collections::HashSet<_> = picture.pixels().collect();
        assert!(colours.len() > 20, "{} is all but blank", plot.name);
    }
    for figure in &report.findings.figures {
        println!(
            "{}: {} {} (published {:?})",
            figure.what, figure.ours, figure.unit, figure.published
        );
    }
    report
}

fn missed(report: &Report) -> Vec<&str> {
    report.missed().map(|figure| figure.what.as_str()).collect()
}

#[test]
fn bubbles_meet_their_aims() {
    for name in ["dry-bubble", "moist-bubble"] {
        let report = quick(name);
        assert!(missed(&report).is_empty(), "{name}: {:?}", missed(&report));
        assert!(report.findings.figures.iter().filter(|f| f.met.is_some()).count() >= 3);
    }
}

#[test]
fn the_density_current_meets_its_aims_but_for_what_is_anelastic() {
    let report = quick("density-current");
    assert!(missed(&report).is_empty(), "{:?}", missed(&report));
    let of = |what: &str| {
        let figure = report.findings.figures.iter().find(|f| f.what == what);
        figure.unwrap_or_else(|| panic!("no {what}")).ours
    };
    // It converges to 15.16 km, 2.4 % short of the published compressible solution; at the full lengths a compressible flow of ours comes to 15.42 km at
    // 100 m and says whose the difference is.
    let front = of("front, 100 m");
    assert!((15_100.0..15_220.0).contains(&front), "{front} m");
    let compressible = of("front, compressible, 400 m");
    assert!((15_200.0..15_350.0).contains(&compressible), "{compressible} m");
}

#[test]
fn the_tunnels_cloud_goes_with_the_mean_wind_of_its_water() {
    let report = quick("wind-tunnel");
    assert!(missed(&report).is_empty(), "{:?}", missed(&report));
    let way = report
        .findings
        .figures
        .iter()
        .find(|f| f.what.starts_with("way of the cloud"));
    // Air of 2 m/s and more for two minutes.
    assert!(way.is_some_and(|f| f.ours > 200.0), "nothing drifts: {way:?}");
}

/// Every row within three of the tracer's own standard errors (with these fixed random numbers).
#[test]
fn the_path_tracer_meets_discrete_ordinates() {
    let report = quick("slab");
    assert_eq!(report.findings.figures.len(), 20);
    assert!(missed(&report).is_empty(), "{:?}", missed(&report));
}

#[test]
fn a_case_can_be_interrupted() {
    let context = Context {
        quick: true,
        machine: None::<usize>.into(),
        progress: &|_, done, _| done < 100.0,
    };
    let error = CASES[0].run(&context).expect_err("it was told to end");
    assert_eq!(error.to_string(), "interrupted");
}
