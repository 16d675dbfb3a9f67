//! A route: what serves it and what the OpenAPI document says of it, in one value.

use axum::handler::Handler;
use axum::routing::{self, MethodRouter};
use schemars::{JsonSchema, Schema, SchemaGenerator};

use super::state::AppState;

/// Makes the schema of one type, with its parts among the generator's definitions.
pub type SchemaOf = fn(&mut SchemaGenerator) -> Schema;

/// The schema of `T`.
pub fn schema_of<T: JsonSchema>(generator: &mut SchemaGenerator) -> Schema {
    generator.subschema_for::<T>()
}

/// Where a parameter stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// In the path, `{name}`.
    Path,
    /// After the `?`.
    Query,
    /// Among the request's headers.
    Header,
}

/// A parameter of a route.
#[derive(Clone, Debug)]
pub struct Parameter {
    /// Where it stands.
    pub place: Place,
    /// Its name.
    pub name: &'static str,
    /// What it means, with unit and default.
    pub description: &'static str,
    /// Its type.
    pub schema: SchemaOf,
}

/// A successful answer.
#[derive(Clone, Debug)]
pub struct Answer {
    /// HTTP status.
    pub status: u16,
    /// What it means.
    pub description: &'static str,
    /// Media type and, for JSON, the schema; empty where there is no body.
    pub content: Vec<(&'static str, Option<SchemaOf>)>,
}

/// See the module.
pub struct Route {
    /// Lower-case HTTP method.
    pub method: &'static str,
    /// Path, with `{name}` for parameters.
    pub path: &'static str,
    /// One line.
    pub summary: &'static str,
    /// Its parameters.
    pub parameters: Vec<Parameter>,
    /// The schema of its JSON request body.
    pub request: Option<SchemaOf>,
    /// What its request body of plain bytes holds.
    pub octets: Option<&'static str>,
    /// Its successful answers.
    pub answers: Vec<Answer>,
    /// Codes of the errors that it can answer with.
    pub errors: Vec<&'static str>,
    /// What serves it.
    pub handler: MethodRouter<AppState>,
}

impl Route {
    fn new(method: &'static str, path: &'static str, summary: &'static str, handler: MethodRouter<AppState>) -> Self {
        let (parameters, answers, errors) = (Vec::new(), Vec::new(), Vec::new());
        Self {
            method,
            path,
            summary,
            parameters,
            request: None,
            octets: None,
            answers,
            errors,
            handler,
        }
    }

    /// A route that reads.
    pub fn get<H, T>(path: &'static str, summary: &'static str, handler: H) -> Self
    where
        H: Handler<T, AppState>,
        T: 'static,
    {
        Self::new("get", path, summary, routing::get(handler))
    }

    /// A route that makes or tells something.
    pub fn post<H, T>(path: &'static str, summary: &'static str, handler: H) -> Self
    where
        H: Handler<T, AppState>,
        T: 'static,
    {
        Self::new("post", path, summary, routing::post(handler))
    }

    /// A route that takes something away.
    pub fn delete<H, T>(path: &'static str, summary: &'static str, handler: H) -> Self
    where
        H: Handler<T, AppState>,
        T: 'static,
    {
        Self::new("delete", path, summary, routing::delete(handler))
    }

    /// With a parameter of type `T`.
    pub fn parameter<T: JsonSchema>(mut self, place: Place, name: &'static str, description: &'static str) -> Self {
        self.parameters.push(Parameter {
            place,
            name,
            description,
            schema: schema_of::<T>,
        });
        self
    }

    /// With the `{id}` of a world, and the error where there is none.
    pub fn of_world(self) -> Self {
        self.parameter::<String>(Place::Path, "id", "A world's id, as `GET /v1/worlds` lists it.")
            .error("unknown_world")
    }

    /// With a JSON request body of type `T`, and the errors that reading it can give.
    pub fn body<T: JsonSchema>(mut self) -> Self {
        self.request = Some(schema_of::<T>);
        self.errors
            .extend(["bad_json", "bad_body", "body_too_large", "unsupported_media_type"]);
        self
    }

    /// With a request body of plain bytes, and the errors that reading it can give.
    pub fn octets(mut self, what: &'static str) -> Self {
        self.octets = Some(what);
        self.errors.extend(["body_too_large", "unsupported_media_type"]);
        self
    }

    /// With a JSON answer of type `T`.
    pub fn json<T: JsonSchema>(self, status: u16, description: &'static str) -> Self {
        self.answer(status, description, &["application/json"], Some(schema_of::<T>))
    }

    /// With an answer that is no JSON of ours, or none at all.
    pub fn bytes(self, status: u16, description: &'static str, media_types: &[&'static str]) -> Self {
        self.answer(status, description, media_types, None)
    }

    fn answer(
        mut self,
        status: u16,
        description: &'static str,
        media_types: &[&'static str],
        schema: Option<SchemaOf>,
    ) -> Self {
        let content = media_types.iter().map(|m| (*m, schema)).collect();
        self.answers.push(Answer {
            status,
            description,
            content,
        });
        self
    }

    /// With an error code that it can answer with.
    pub fn error(mut self, code: &'static str) -> Self {
        self.errors.push(code);
        self
    }
}
