//! The OpenAPI document against the routes that are served and the types that travel.

mod common;

use common::{empty_server, server};
use serde_json::Value;
use welkin_server::http::routes;
use welkin_server::limits::Limits;

#[tokio::test]
async fn document_lists_every_route_and_every_listed_route_is_served() {
    let server = server(Limits::default()).await;
    let document = server.get("/v1/openapi.json").await.json();
    assert_eq!(document["openapi"], "3.1.0");
    let paths = document["paths"].as_object().unwrap();
    let mut listed: Vec<(String, String)> = Vec::new();
    for (path, operations) in paths {
        listed.extend(
            operations
                .as_object()
                .unwrap()
                .keys()
                .map(|method| (path.clone(), method.clone())),
        );
    }
    let mut table: Vec<(String, String)> = routes()
        .iter()
        .map(|r| (r.path.to_owned(), r.method.to_owned()))
        .collect();
    listed.sort();
    table.sort();
    assert_eq!(listed, table);
    for path in [
        "/",
        "/healthz",
        "/v1/scenes",
        "/v1/worlds",
        "/v1/worlds/{id}",
        "/v1/worlds/{id}/plan",
        "/v1/worlds/{id}/frame",
        "/v1/worlds/{id}/frame.mjpeg",
        "/v1/worlds/{id}/scenery",
        "/v1/shaders/view.json",
        "/v1/worlds/{id}/commands",
        "/v1/worlds/{id}/stream",
        "/v1/render",
        "/v1/schema/scene",
        "/v1/openapi.json",
    ] {
        assert!(paths.contains_key(path), "{path}");
    }
    for (path, method) in listed {
        let concrete = path.replace("{id}", "no-such").replace("{name}", "no-such");
        let answer = server.request(&method.to_uppercase(), &concrete, "", b"").await;
        let code = serde_json::from_slice::<Value>(&answer.body)
            .ok()
            .and_then(|b| b["code"].as_str().map(str::to_owned));
        assert_ne!(answer.status, 405, "{method} {path}");
        // A 404 may only say that the thing is not there, never that the route is not.
        assert!(answer.status != 404 || path.contains('{'), "{method} {path}");
        // Whatever is answered is written down, apart from a missing Content-Type on an empty body.
        let responses = &document["paths"][&path][&method]["responses"];
        assert!(
            responses[answer.status.to_string()].is_object(),
            "{method} {path} answers {} {code:?}: {responses}",
            answer.status
        );
    }
}

#[tokio::test]
async fn every_reference_in_the_document_leads_somewhere_and_ids_are_unique() {
    let server = empty_server(Limits::default()).await;
    let document = server.get("/v1/openapi.json").await.json();
    let mut references = Vec::new();
    collect(&document, &mut references);
    assert!(references.len() > 20, "{references:?}");
    for reference in references {
        let pointer = reference
            .strip_prefix('#')
            .unwrap_or_else(|| panic!("{reference} leads out of the document"));
        assert!(document.pointer(pointer).is_some(), "{reference} leads nowhere");
    }
    for name in [
        "Scene",
        "Numbers",
        "ApiError",
        "ClientMessage",
        "ServerMessage",
        "VolumeClientMessage",
        "VolumeServerMessage",
        "PlanReport",
        "Command",
    ] {
        assert!(document["components"]["schemas"][name].is_object(), "{name}");
    }
    let mut ids: Vec<&str> = Vec::new();
    for operations in document["paths"].as_object().unwrap().values() {
        ids.extend(
            operations
                .as_object()
                .unwrap()
                .values()
                .map(|o| o["operationId"].as_str().unwrap()),
        );
    }
    let all = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), all);
}

fn collect(value: &Value, references: &mut Vec<String>) {
    match value {
        Value::Object(fields) => {
            if let Some(Value::String(reference)) = fields.get("$ref") {
                references.push(reference.clone());
            }
            fields.values().for_each(|v| collect(v, references));
        }
        Value::Array(items) => items.iter().for_each(|v| collect(v, references)),
        _ => {}
    }
}
