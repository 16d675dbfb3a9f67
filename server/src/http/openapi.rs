//! `GET /v1/openapi.json`: the OpenAPI 3.1 document, made from the route table and the types.

use std::collections::BTreeMap;

use axum::Json;
use schemars::SchemaGenerator;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};
use welkin_proto::ApiError;
use welkin_proto::sample::{SampleClientMessage, SampleServerMessage};
use welkin_proto::volume::subscribe::{VolumeClientMessage, VolumeServerMessage};
use welkin_proto::wire::{ClientMessage, ServerMessage};

use super::error::status_of;
use super::route::{Answer, Place, Route, schema_of};

/// The route.
pub fn route() -> Route {
    Route::get("/v1/openapi.json", "This document", async || {
        Json(document(&super::routes()))
    })
    .bytes(
        200,
        "The OpenAPI 3.1 description of this service.",
        &["application/json"],
    )
}

/// The OpenAPI 3.1 document of a route table.
pub fn document(routes: &[Route]) -> Value {
    let settings = SchemaSettings::draft2020_12().with(|s| {
        s.definitions_path = "/components/schemas".into();
        s.meta_schema = None;
    });
    let mut generator = settings.into_generator();
    let mut paths: BTreeMap<&str, Map<String, Value>> = BTreeMap::new();
    for route in routes {
        let operation = operation(route, &mut generator);
        paths
            .entry(route.path)
            .or_default()
            .insert(route.method.to_owned(), operation);
    }
    // The stream's messages travel inside a WebSocket, which OpenAPI has no place for: they are among the schemas.
    generator.subschema_for::<ClientMessage>();
    generator.subschema_for::<ServerMessage>();
    generator.subschema_for::<SampleClientMessage>();
    generator.subschema_for::<SampleServerMessage>();
    generator.subschema_for::<VolumeClientMessage>();
    generator.subschema_for::<VolumeServerMessage>();
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "Welkin",
            "summary": "A shared, physically simulated sky as a service.",
            "version": env!("CARGO_PKG_VERSION"),
            "license": { "name": "MIT OR Apache-2.0" },
        },
        "jsonSchemaDialect": "https://json-schema.org/draft/2020-12/schema",
        "paths": paths,
        "components": { "schemas": generator.take_definitions(true) },
    })
}

fn operation(route: &Route, generator: &mut SchemaGenerator) -> Value {
    let mut operation = Map::new();
    operation.insert("operationId".into(), operation_id(route).into());
    operation.insert("summary".into(), route.summary.into());
    if !route.parameters.is_empty() {
        let parameters = route.parameters.iter().map(|p| {
            let place = match p.place {
                Place::Path => "path",
                Place::Query => "query",
                Place::Header => "header",
            };
            json!({
                "name": p.name,
                "in": place,
                "required": p.place == Place::Path,
                "description": p.description,
                "schema": (p.schema)(generator),
            })
        });
        operation.insert("parameters".into(), parameters.collect());
    }
    if let Some(schema) = route.request {
        let body = json!({ "required": true, "content": { "application/json": { "schema": schema(generator) } } });
        operation.insert("requestBody".into(), body);
    }
    if let Some(what) = route.octets {
        let body = json!({ "required": true, "description": what, "content": { "application/octet-stream": {} } });
        operation.insert("requestBody".into(), body);
    }
    let mut responses = Map::new();
    for answer in &route.answers {
        responses.insert(answer.status.to_string(), response(answer, generator));
    }
    for (status, codes) in errors_by_status(route) {
        let error = schema_of::<ApiError>(generator);
        let description = format!("Refused; `code` is one of: {}.", codes.join(", "));
        let body = json!({ "description": description, "content": { "application/json": { "schema": error } } });
        responses.insert(status.to_string(), body);
    }
    operation.insert("responses".into(), responses.into());
    operation.into()
}

fn response(answer: &Answer, generator: &mut SchemaGenerator) -> Value {
    let mut content = Map::new();
    for (media_type, schema) in &answer.content {
        let body = match schema {
            Some(schema) => json!({ "schema": schema(generator) }),
            None => json!({}),
        };
        content.insert((*media_type).to_owned(), body);
    }
    if content.is_empty() {
        return json!({ "description": answer.description });
    }
    json!({ "description": answer.description, "content": content })
}

fn errors_by_status(route: &Route) -> BTreeMap<u16, Vec<&'static str>> {
    let mut by_status: BTreeMap<u16, Vec<&'static str>> = BTreeMap::new();
    for code in &route.errors {
        by_status.entry(status_of(code).as_u16()).or_default().push(code);
    }
    by_status
}

/// `get_v1_worlds_id_plan` and the like: unique as method and path are.
fn operation_id(route: &Route) -> String {
    let path = route
        .path
        .split(|c: char| !c.is_ascii_alphanumeric())
        .filter(|part| !part.is_empty());
    std::iter::once(route.method).chain(path).collect::<Vec<_>>().join("_")
}
