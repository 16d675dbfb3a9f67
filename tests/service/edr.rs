//! The weather service as an existing weather client uses it: from the landing page by links alone, CoverageJSON read strictly and held against
//! samples, and refusals by name.

mod common;

use std::collections::BTreeMap;

use common::{Answer, Server, empty_server};
use serde_json::{Value, json};
use welkin_proto::Scene;
use welkin_server::limits::Limits;

/// A server whose world w1 stands still: 350 m above the sea, 16 x 8 cells of 200 m, 16 levels of 150 m.
async fn server(limits: Limits) -> Server {
    let server = empty_server(limits).await;
    let mut scene = common::scene();
    scene["domain"]["surface_altitude_m"] = json!(350.0);
    scene["domain"]["cells"] = json!([16, 8, 16]);
    let scene: Scene = serde_json::from_value(scene).unwrap();
    server.state.create_world(scene).await.unwrap();
    server
}

async fn pause(server: &Server) {
    server
        .post("/v1/worlds/w1/commands", &json!({ "command": "pause" }))
        .await;
    while server.get("/v1/worlds/w1").await.json()["numbers"]["paused"] != true {
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
}

/// A coverage, read strictly (OGC 21-069r2): whatever must be there is, arrays are as long as their shapes say.
struct Coverage {
    kind: String,
    axes: BTreeMap<String, Vec<Value>>,
    ranges: BTreeMap<String, (Vec<usize>, Vec<Option<f64>>)>,
}

fn read(answer: &Answer) -> Coverage {
    assert_eq!(answer.status, 200, "{}", answer.json());
    assert_eq!(answer.header("content-type"), Some("application/vnd.cov+json"));
    let document = answer.json();
    assert_eq!(document["type"], "Coverage");
    let domain = &document["domain"];
    assert_eq!(domain["type"], "Domain");
    let kind = domain["domainType"].as_str().unwrap().to_owned();
    let axes: BTreeMap<String, Vec<Value>> = domain["axes"]
        .as_object()
        .unwrap()
        .iter()
        .map(|(name, axis)| (name.clone(), axis["values"].as_array().unwrap().clone()))
        .collect();
    let names: Vec<&str> = axes.keys().map(String::as_str).collect();
    let single = |name: &str| axes[name].len() == 1;
    match kind.as_str() {
        "Point" => assert!(names == ["t", "x", "y", "z"] && names.iter().all(|n| single(n))),
        "PointSeries" => assert!(names == ["t", "x", "y", "z"] && single("x") && single("y") && single("z")),
        "VerticalProfile" => assert!(names == ["t", "x", "y", "z"] && single("x") && single("y") && single("t")),
        "Grid" => assert!(names == ["t", "x", "y", "z"]),
        "MultiPoint" => assert!(names == ["composite", "t"] && single("t")),
        "Trajectory" => assert_eq!(names, ["composite"]),
        other => panic!("domain type {other}"),
    }
    for (name, values) in &axes {
        match name.as_str() {
            "composite" => {
                let axis = &domain["axes"]["composite"];
                assert_eq!(axis["dataType"], "tuple");
                let width = axis["coordinates"].as_array().unwrap().len();
                assert!(values.iter().all(|v| v.as_array().unwrap().len() == width));
            }
            "t" => {
                let times: Vec<f64> = values
                    .iter()
                    .map(|t| welkin_proto::time::parse_utc(t.as_str().unwrap()).unwrap())
                    .collect();
                assert!(times.windows(2).all(|w| w[0] < w[1]));
            }
            _ => {
                let numbers: Vec<f64> = values.iter().map(|v| v.as_f64().unwrap()).collect();
                assert!(numbers.windows(2).all(|w| w[0] < w[1]), "{name} rises: {numbers:?}");
            }
        }
    }
    let systems: BTreeMap<String, &str> = domain["referencing"]
        .as_array()
        .unwrap()
        .iter()
        .flat_map(|r| {
            let system = r["system"]["type"].as_str().unwrap();
            let of = r["coordinates"].as_array().unwrap().iter();
            of.map(move |c| (c.as_str().unwrap().to_owned(), system))
        })
        .collect();
    let wanted = [
        ("t", "TemporalRS"),
        ("x", "GeographicCRS"),
        ("y", "GeographicCRS"),
        ("z", "VerticalCRS"),
    ];
    assert_eq!(systems, wanted.map(|(c, s)| (c.to_owned(), s)).into());
    let ranges: BTreeMap<String, (Vec<usize>, Vec<Option<f64>>)> = document["ranges"]
        .as_object()
        .unwrap()
        .iter()
        .map(|(name, range)| {
            assert_eq!(
                (&range["type"], &range["dataType"]),
                (&json!("NdArray"), &json!("float"))
            );
            let shape: Vec<usize> = serde_json::from_value(range["shape"].clone()).unwrap();
            let along: Vec<String> = serde_json::from_value(range["axisNames"].clone()).unwrap();
            assert_eq!(shape, along.iter().map(|a| axes[a].len()).collect::<Vec<_>>(), "{name}");
            let values: Vec<Option<f64>> = serde_json::from_value(range["values"].clone()).unwrap();
            assert_eq!(values.len(), shape.iter().product::<usize>(), "{name}");
            let about = &document["parameters"][name];
            assert_eq!(about["type"], "Parameter");
            assert!(about["observedProperty"]["label"]["en"].is_string() && about["unit"]["label"]["en"].is_string());
            let symbol = &about["unit"]["symbol"];
            assert!(
                symbol.is_string()
                    || symbol["type"] == "http://www.opengis.net/def/uom/UCUM/" && symbol["value"].is_string()
            );
            (name.clone(), (shape, values))
        })
        .collect();
    assert_eq!(document["parameters"].as_object().unwrap().len(), ranges.len());
    Coverage { kind, axes, ranges }
}

impl Coverage {
    fn numbers(&self, axis: &str) -> Vec<f64> {
        self.axes[axis].iter().map(|v| v.as_f64().unwrap()).collect()
    }
}

/// What samples say of places (longitude, latitude, altitude).
async fn samples(server: &Server, places: &[[f64; 3]], channels: &[&str]) -> Value {
    let turned: Vec<[f64; 3]> = places.iter().map(|p| [p[1], p[0], p[2]]).collect();
    let answer = server
        .post(
            "/v1/worlds/w1/sample",
            &json!({ "positions_lat_lon_alt": turned, "channels": channels }),
        )
        .await;
    assert_eq!(answer.status, 200, "{}", answer.json());
    answer.json()["values"].clone()
}

/// Holds a coverage's values against samples at the same places.
async fn agrees(server: &Server, coverage: &Coverage, places: &[[f64; 3]]) {
    let names: Vec<&str> = coverage.ranges.keys().map(String::as_str).collect();
    let there = samples(server, places, &names).await;
    for (name, (_, values)) in &coverage.ranges {
        assert_eq!(values.len(), places.len());
        for (i, value) in values.iter().enumerate() {
            let wanted = there[name][i].as_f64().unwrap();
            // Places went through degrees and back, some 1e-8 m; a channel changes by less than its size over a cell.
            let scale = if name == "wind_from_deg" { 360.0 } else { wanted.abs() };
            assert!(
                (value.unwrap() - wanted).abs() <= 2e-5 * scale + 1e-9,
                "{name} at {:?}: {value:?} {wanted}",
                places[i]
            );
        }
    }
}

fn link<'a>(document: &'a Value, rel: &str, kind: &str) -> &'a str {
    let links = document["links"].as_array().unwrap();
    let found = links
        .iter()
        .find(|l| l["rel"] == rel && l["type"].as_str().unwrap().starts_with(kind));
    found.unwrap_or_else(|| panic!("no {rel} in {document}"))["href"]
        .as_str()
        .unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_finds_its_way_by_links_alone() {
    let server = server(Limits::default()).await;
    pause(&server).await;
    // A browser gets the page, a program the landing page.
    let page = server
        .request("GET", "/", "Accept: text/html,application/json;q=0.5\r\n", b"")
        .await;
    assert!(page.header("content-type").unwrap().starts_with("text/html"));
    let landing = server
        .request("GET", "/", "Accept: application/json\r\n", b"")
        .await
        .json();
    assert_eq!(landing, server.get("/?f=json").await.json());
    let path = |href: &str| {
        let base = format!("http://{}", server.address);
        href.strip_prefix(&base)
            .unwrap_or_else(|| panic!("{href} does not begin with {base}"))
            .to_owned()
    };
    let openapi = server
        .get(&path(link(
            &landing,
            "service-desc",
            "application/vnd.oai.openapi+json",
        )))
        .await
        .json();
    assert_eq!(openapi["openapi"], "3.1.0");
    for route in [
        "",
        "/{id}",
        "/{id}/position",
        "/{id}/area",
        "/{id}/cube",
        "/{id}/trajectory",
    ] {
        assert!(
            openapi["paths"][format!("/collections{route}")]["get"].is_object(),
            "{route}"
        );
    }
    let conformance = server
        .get(&path(link(&landing, "conformance", "application/json")))
        .await
        .json();
    let classes = conformance["conformsTo"].as_array().unwrap();
    assert!(classes.contains(&json!("http://www.opengis.net/spec/ogcapi-edr-1/1.1/conf/core")));
    let collections = server
        .get(&path(link(&landing, "data", "application/json")))
        .await
        .json();
    assert_eq!(collections["collections"].as_array().unwrap().len(), 1);
    let collection = &collections["collections"][0];
    assert_eq!(
        *collection,
        server
            .get(&path(link(collection, "self", "application/json")))
            .await
            .json()
    );

    // From its extent and its parameters alone: the column in the middle of the box.
    let bbox: Vec<f64> = serde_json::from_value(collection["extent"]["spatial"]["bbox"][0].clone()).unwrap();
    let middle = [0.5 * (bbox[0] + bbox[2]), 0.5 * (bbox[1] + bbox[3])];
    assert!(
        (middle[0] - 10.0).abs() < 1e-9 && (middle[1] - 45.0).abs() < 1e-9,
        "{bbox:?}"
    );
    assert_eq!(collection["extent"]["vertical"]["interval"], json!([["350", "2750"]]));
    let levels: Vec<f64> = serde_json::from_value::<Vec<String>>(collection["extent"]["vertical"]["values"].clone())
        .unwrap()
        .iter()
        .map(|z| z.parse().unwrap())
        .collect();
    let now = collection["extent"]["temporal"]["interval"][0][1].as_str().unwrap();
    let position = path(collection["data_queries"]["position"]["link"]["href"].as_str().unwrap());
    let query = format!(
        "{position}?coords=POINT({}%20{})&datetime={now}&f=CoverageJSON&crs=CRS84",
        middle[0], middle[1]
    );
    let profile = read(&server.get(&query).await);
    assert_eq!(profile.kind, "VerticalProfile");
    assert_eq!(profile.numbers("z"), levels);
    assert_eq!(profile.axes["t"], [json!(now)]);
    let mut offered: Vec<&String> = collection["parameter_names"].as_object().unwrap().keys().collect();
    offered.sort();
    assert_eq!(profile.ranges.keys().collect::<Vec<_>>(), offered);
    assert_eq!(
        collection["parameter_names"]["temperature_k"]["unit"]["symbol"]["value"],
        "K"
    );
    let places: Vec<[f64; 3]> = levels.iter().map(|&z| [middle[0], middle[1], z]).collect();
    agrees(&server, &profile, &places).await;
}

const TWO: &str = "parameter-name=temperature_k,wind_z_m_s";

#[tokio::test(flavor = "multi_thread")]
async fn every_query_answers_with_what_samples_say() {
    let server = server(Limits::default()).await;
    let base = "/collections/w1";
    // Some moments first, so that there is a past.
    server
        .get(&format!("{base}/position?coords=POINT(10%2045)&z=1000"))
        .await;
    tokio::time::sleep(std::time::Duration::from_millis(600)).await;
    pause(&server).await;

    let point = read(
        &server
            .get(&format!("{base}/position?coords=POINT(10%2045)&z=1000&{TWO}"))
            .await,
    );
    assert_eq!(point.kind, "Point");
    agrees(&server, &point, &[[10.0, 45.0, 1000.0]]).await;
    let same = read(
        &server
            .get(&format!("{base}/position?coords=POINT%20Z(10%2045%201000)&{TWO}"))
            .await,
    );
    assert_eq!(same.ranges, point.ranges);

    // A series: as many times as are kept, each what a sample of that second says.
    let series = read(
        &server
            .get(&format!(
                "{base}/position?coords=POINT(10%2045)&z=1000&datetime=../..&{TWO}"
            ))
            .await,
    );
    assert_eq!(series.kind, "PointSeries");
    let start = welkin_proto::time::parse_utc("2026-06-21T11:00:00Z").unwrap();
    assert!(series.axes["t"].len() >= 3, "{:?}", series.axes["t"]);
    for (i, time) in series.axes["t"].iter().enumerate() {
        let second = welkin_proto::time::parse_utc(time.as_str().unwrap()).unwrap() - start;
        let sample = server
            .get(&format!(
                "/v1/worlds/w1/sample?lat=45&lon=10&alt=1000&simulated_s={second}"
            ))
            .await
            .json();
        let wanted = sample["values"]["wind_z_m_s"].as_f64().unwrap();
        assert!(
            (series.ranges["wind_z_m_s"].1[i].unwrap() - wanted).abs() < 1e-6,
            "{time}"
        );
    }
    // Between two of them, linear in time.
    let half = server
        .get(&format!(
            "{base}/position?coords=POINT(10%2045)&z=1000&datetime={}&{TWO}",
            {
                let text = series.axes["t"][0].as_str().unwrap();
                text.replace('Z', ".500Z")
            }
        ))
        .await;
    let half = read(&half).ranges["wind_z_m_s"].1[0].unwrap();
    let w = &series.ranges["wind_z_m_s"].1;
    assert!((half - 0.5 * (w[0].unwrap() + w[1].unwrap())).abs() < 1e-6);

    // A cube: the grid's own cells, in the order of the axes.
    let cube = read(
        &server
            .get(&format!("{base}/cube?bbox=9.99,44.995,10.01,46&z=500/900&{TWO}"))
            .await,
    );
    assert_eq!(cube.kind, "Grid");
    let [x, y, z] = ["x", "y", "z"].map(|a| cube.numbers(a));
    assert!(
        (3..16).contains(&x.len()) && y.len() > 4 && z == [575.0, 725.0, 875.0],
        "{x:?} {y:?} {z:?}"
    );
    assert!(x[0] >= 9.99 && x[x.len() - 1] <= 10.01 && y[0] >= 44.995);
    let mut places = Vec::new();
    for &z in &z {
        for &y in &y {
            places.extend(x.iter().map(|&x| [x, y, z]));
        }
    }
    agrees(&server, &cube, &places).await;
    // The whole world asked for is the whole box; heights within the bounding box are the same as in z.
    let all = read(
        &server
            .get(&format!("{base}/cube?bbox=-180,-90,180,90&z=875&{TWO}"))
            .await,
    );
    assert_eq!(
        (all.axes["x"].len(), all.axes["y"].len(), all.axes["z"].len()),
        (16, 8, 1)
    );
    let six = read(
        &server
            .get(&format!("{base}/cube?bbox=9.99,44.995,500,10.01,46,900&{TWO}"))
            .await,
    );
    assert_eq!(six.ranges, cube.ranges);
    let times = read(
        &server
            .get(&format!(
                "{base}/cube?bbox=9.998,44.998,10.002,45.002&z=875&datetime=../..&{TWO}"
            ))
            .await,
    );
    assert_eq!(times.axes["t"], series.axes["t"]);

    // An area: a triangle with a hole; outside of it null, inside as the cube has it.
    let triangle = "POLYGON((9.98%2044.99,10.02%2044.99,10.02%2045.01,9.98%2044.99),(10.01%2044.995,10.012%2044.995,10.012%2044.999,10.01%2044.995))";
    let area = read(&server.get(&format!("{base}/area?coords={triangle}&z=875&{TWO}")).await);
    let [x, y] = ["x", "y"].map(|a| area.numbers(a));
    let (mut within, mut without) = (Vec::new(), 0);
    let values = &area.ranges["temperature_k"].1;
    for (j, &lat) in y.iter().enumerate() {
        for (i, &lon) in x.iter().enumerate() {
            // Under the line from corner to corner; the hole lies under its own.
            let inside = |west: f64, south: f64, rise: f64, east: f64| {
                lon > west && lon < east && lat > south && lat < south + rise * (lon - west)
            };
            let wanted = inside(9.98, 44.99, 0.5, 10.02) && !inside(10.01, 44.995, 2.0, 10.012);
            let value = values[j * x.len() + i];
            assert_eq!(value.is_some(), wanted, "{lon} {lat}");
            match value {
                Some(value) => within.push((value, [lon, lat, 875.0])),
                None => without += 1,
            }
        }
    }
    assert!(within.len() > 20 && without > 20, "{} {without}", within.len());
    let places: Vec<[f64; 3]> = within.iter().map(|(_, p)| *p).collect();
    let there = samples(&server, &places, &["temperature_k"]).await;
    for (i, (value, place)) in within.iter().enumerate() {
        assert!(
            (value - there["temperature_k"][i].as_f64().unwrap()).abs() < 1e-3,
            "{place:?}"
        );
    }

    // Several places, and paths with height and time.
    let several = read(
        &server
            .get(&format!(
                "{base}/position?coords=MULTIPOINT((10%2045),(10.005%2045.002))&z=800&{TWO}"
            ))
            .await,
    );
    assert_eq!(several.kind, "MultiPoint");
    agrees(&server, &several, &[[10.0, 45.0, 800.0], [10.005, 45.002, 800.0]]).await;
    let path = read(
        &server
            .get(&format!(
                "{base}/trajectory?coords=LINESTRING%20Z(9.99%2045%20700,10.01%2045.004%201100)&{TWO}"
            ))
            .await,
    );
    assert_eq!(path.kind, "Trajectory");
    let tuples: Vec<(String, f64, f64, f64)> = path.axes["composite"]
        .iter()
        .map(|t| serde_json::from_value(t.clone()).unwrap())
        .collect();
    assert!(tuples.len() >= 8, "a place every cell: {tuples:?}");
    assert!((tuples[0].1 - 9.99).abs() < 1e-9 && (tuples.last().unwrap().3 - 1100.0).abs() < 1e-6);
    let places: Vec<[f64; 3]> = tuples.iter().map(|t| [t.1, t.2, t.3]).collect();
    agrees(&server, &path, &places).await;
    let times: Vec<f64> = series.axes["t"]
        .iter()
        .map(|t| welkin_proto::time::parse_utc(t.as_str().unwrap()).unwrap())
        .collect();
    let (from, to) = (times[0], times[times.len() - 1]);
    let flight = read(
        &server
            .get(&format!(
                "{base}/trajectory?coords=LINESTRING%20ZM(9.999%2045%20700%20{from},10.001%2045%20700%20{to})&{TWO}"
            ))
            .await,
    );
    let first = flight.axes["composite"][0][0].as_str().unwrap();
    assert_eq!(first, series.axes["t"][0].as_str().unwrap());
    assert_eq!(
        flight.axes["composite"].last().unwrap()[0],
        *series.axes["t"].last().unwrap()
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_queries_are_refused_by_name() {
    let limits = Limits {
        edr_values_max: 20_000,
        sample_points_max: 50,
        ..Limits::default()
    };
    let server = server(limits).await;
    let long = vec!["10%2045"; 51].join(",");
    let ring = "((9.99%2044.99,10.01%2044.99,10.01%2045.01,9.99%2044.99))";
    for (query, status, code, pointer) in [
        ("position".to_owned(), 400, "bad_coords", "/coords"),
        ("position?coords=POINT(10%2045".to_owned(), 400, "bad_coords", "/coords"),
        ("position?coords=POINT(10)".to_owned(), 400, "bad_coords", "/coords"),
        (
            "position?coords=POINT(NaN%2045)".to_owned(),
            400,
            "bad_coords",
            "/coords",
        ),
        (
            "position?coords=POINT(inf%2045)".to_owned(),
            400,
            "bad_coords",
            "/coords",
        ),
        (format!("position?coords=POLYGON{ring}"), 400, "bad_coords", "/coords"),
        (
            "position?coords=POINT(139.7%2035.6)".to_owned(),
            400,
            "outside_domain",
            "/coords",
        ),
        (
            "position?coords=POINT(10.5%2045)".to_owned(),
            400,
            "outside_domain",
            "/coords",
        ),
        (
            "position?coords=POINT(10%20145)".to_owned(),
            400,
            "out_of_range",
            "/coords",
        ),
        (
            "position?coords=POINT(10%2045)&z=349".to_owned(),
            400,
            "outside_domain",
            "/z",
        ),
        (
            "position?coords=POINT(10%2045)&z=3000/4000".to_owned(),
            400,
            "outside_domain",
            "/z",
        ),
        (
            "position?coords=POINT(10%2045)&z=high".to_owned(),
            400,
            "bad_parameter",
            "/z",
        ),
        (
            "position?coords=POINT%20Z(10%2045%20900)&z=900".to_owned(),
            400,
            "bad_parameter",
            "/z",
        ),
        (
            "position?coords=MULTIPOINT(10%2045)".to_owned(),
            400,
            "bad_parameter",
            "/z",
        ),
        (
            format!("position?coords=MULTIPOINT({long})&z=900"),
            413,
            "too_many_points",
            "/coords",
        ),
        (
            "position?coords=POINT(10%2045)&datetime=yesterday".to_owned(),
            400,
            "bad_parameter",
            "/datetime",
        ),
        (
            "position?coords=POINT(10%2045)&datetime=2020-01-01T00:00:00Z".to_owned(),
            410,
            "too_old",
            "/datetime",
        ),
        (
            "position?coords=POINT(10%2045)&datetime=2030-01-01T00:00:00Z".to_owned(),
            404,
            "not_yet",
            "/datetime",
        ),
        (
            "position?coords=POINT(10%2045)&datetime=../2020-01-01T00:00:00Z".to_owned(),
            410,
            "too_old",
            "/datetime",
        ),
        (
            "position?coords=POINT(10%2045)&datetime=2030-01-01T00:00:00Z/..".to_owned(),
            404,
            "not_yet",
            "/datetime",
        ),
        (
            "position?coords=MULTIPOINT(10%2045)&z=900&datetime=../..".to_owned(),
            400,
            "bad_parameter",
            "/datetime",
        ),
        (
            "position?coords=POINT(10%2045)&parameter-name=sunshine".to_owned(),
            400,
            "unknown_channel",
            "/parameter-name",
        ),
        (
            "position?coords=POINT(10%2045)&parameter-name=rain_rate_mm_h".to_owned(),
            400,
            "channel_unavailable",
            "/parameter-name",
        ),
        (
            "position?coords=POINT(10%2045)&parameter-name=eddy_dissipation_rate_m23_s".to_owned(),
            400,
            "channel_unavailable",
            "/parameter-name",
        ),
        (
            "position?coords=POINT(10%2045)&crs=EPSG:3857".to_owned(),
            400,
            "unsupported_crs",
            "/crs",
        ),
        (
            "position?coords=POINT(10%2045)&f=GRIB".to_owned(),
            400,
            "unsupported_format",
            "/f",
        ),
        (
            "position?coords=POINT(10%2045)&bbox=1,2,3,4".to_owned(),
            400,
            "unknown_parameter",
            "/bbox",
        ),
        ("cube".to_owned(), 400, "bad_parameter", "/bbox"),
        ("cube?bbox=1,2,3".to_owned(), 400, "bad_parameter", "/bbox"),
        ("cube?bbox=10,44,9,46".to_owned(), 400, "bad_parameter", "/bbox"),
        ("cube?bbox=NaN,44,10,46".to_owned(), 400, "bad_parameter", "/bbox"),
        ("cube?bbox=20,44,21,46".to_owned(), 400, "outside_domain", "/bbox"),
        (
            "cube?bbox=-180,-90,180,90&z=R0/1/1".to_owned(),
            400,
            "bad_parameter",
            "/z",
        ),
        ("area?coords=POINT(10%2045)".to_owned(), 400, "bad_coords", "/coords"),
        (
            "area?coords=POLYGON((0%200,1%200,1%201,0%200))".to_owned(),
            400,
            "outside_domain",
            "/coords",
        ),
        (
            "trajectory?coords=LINESTRING(10%2045,10.001%2045)".to_owned(),
            400,
            "bad_parameter",
            "/z",
        ),
        (
            "trajectory?coords=LINESTRING(10%2045)&z=900".to_owned(),
            400,
            "bad_coords",
            "/coords",
        ),
        (
            "trajectory?coords=LINESTRING(10%2045,11%2045)&z=900".to_owned(),
            400,
            "outside_domain",
            "/coords",
        ),
        (
            "trajectory?coords=LINESTRING%20M(10%2045%201,10.001%2045%202)&z=900".to_owned(),
            410,
            "too_old",
            "/coords",
        ),
        (
            "trajectory?coords=LINESTRING%20M(10%2045%201,10.001%2045%202)&z=900&datetime=2026-06-21T11:00:00Z"
                .to_owned(),
            400,
            "bad_parameter",
            "/datetime",
        ),
    ] {
        println!("{query}");
        let answer = server.get(&format!("/collections/w1/{query}")).await;
        answer.assert_refused(status, code, Some(pointer));
    }
    // 16 x 8 x 16 cells of a dozen parameters are more than 20,000 values; a few of them are not.
    server
        .get("/collections/w1/cube?bbox=-180,-90,180,90")
        .await
        .assert_refused(413, "too_large", None);
    let few = server
        .get("/collections/w1/cube?bbox=-180,-90,180,90&parameter-name=temperature_k")
        .await;
    assert_eq!(read(&few).ranges["temperature_k"].1.len(), 16 * 8 * 16);
    server
        .get("/collections/w9")
        .await
        .assert_refused(404, "unknown_world", None);
    server
        .get("/collections/w9/position?coords=POINT(10%2045)")
        .await
        .assert_refused(404, "unknown_world", None);
}
