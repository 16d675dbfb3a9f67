//! HTTP and WebSocket. One file a route; [`routes`] is the table from which both the router and the OpenAPI document are
//! made, so that no path can be served and be missing in the document.

mod checks;
mod cors;
mod edr;
mod error;
mod extract;
mod healthz;
mod layers;
mod openapi;
mod page;
mod query;
mod render;
mod route;
mod sample_many;
mod sample_point;
mod sample_stream;
mod sampling;
mod scene;
mod scene_schema;
mod scenes;
mod socket;
mod stalling;
mod state;
mod view_shaders;
mod viewing;
mod world_commands;
mod world_create;
mod world_delete;
mod world_depth;
mod world_frame;
mod world_frame_before;
mod world_frame_mjpeg;
mod world_past;
mod world_past_bin;
mod world_plan;
mod world_scenery;
mod world_stars;
mod world_state;
mod world_stream;
mod world_volume;
mod world_volume_bin;
mod worlds;

use std::future::Future;
use std::time::Duration;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderValue, Method, Uri, header};
use axum::middleware::map_response;
use axum::response::Response;
use tokio::net::TcpListener;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{NotForContentType, Predicate, SizeAbove};
use tower_http::trace::TraceLayer;
use welkin_proto::ApiError;

pub use healthz::{Health, WorldHealth};
pub use openapi::document;
pub use route::Route;
pub use scenes::{SceneSummary, list as scene_list};
pub use state::AppState;
pub use world_state::WorldState;

use error::Refusal;
pub(crate) use error::internal;
use stalling::StallingListener;

/// How long a server that was told to stop waits for answers under way.
const SHUT_DOWN_WITHIN: Duration = Duration::from_secs(5);

/// Every route that is served.
pub fn routes() -> Vec<Route> {
    let mut routes = vec![
        page::route(),
        page::file_route(),
        healthz::route(),
        openapi::route(),
        scene_schema::route(),
        scenes::route(),
        scene::route(),
        worlds::route(),
        world_create::route(),
        world_state::route(),
        world_delete::route(),
        world_plan::route(),
        world_scenery::route(),
        world_stars::route(),
        view_shaders::route(),
        world_frame::route(),
        world_frame_before::route(),
        world_depth::route(),
        world_frame_mjpeg::route(),
        world_commands::route(),
        world_stream::route(),
        sample_point::route(),
        sample_many::route(),
        sample_stream::route(),
        world_volume::route(),
        world_volume_bin::route(),
        world_past::route(),
        world_past_bin::route(),
        render::route(),
    ];
    routes.extend(edr::routes());
    routes.sort_by_key(|r| (r.path, r.method));
    routes
}

/// The whole service.
pub fn router(state: AppState) -> Router {
    let body_bytes_max = state.limits().body_bytes_max;
    let compressed = SizeAbove::new(1024)
        .and(NotForContentType::IMAGES)
        .and(NotForContentType::new("multipart/x-mixed-replace"))
        .and(NotForContentType::new("application/octet-stream"));
    let origins = state.limits().cors_origins.clone();
    let router = routes()
        .into_iter()
        .fold(Router::new(), |router, route| router.route(route.path, route.handler))
        .fallback(not_found)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(DefaultBodyLimit::max(body_bytes_max))
        .layer(map_response(no_sniffing));
    let router = if origins.is_empty() {
        router
    } else {
        router.layer(cors::layer(&origins))
    };
    router
        .layer(CompressionLayer::new().compress_when(compressed))
        .layer(TraceLayer::new_for_http())
        .with_state(state)
}

/// Serves until `stop` resolves, then lets answers under way finish for a few seconds and stops the worlds.
///
/// Errors: those of the listener.
pub async fn serve_until(
    listener: TcpListener,
    state: AppState,
    stop: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    let stall = Duration::try_from_secs_f64(state.limits().stall_timeout_s).unwrap_or(Duration::MAX);
    let listener = StallingListener::new(listener, stall);
    let (stopping, stopped) = tokio::sync::oneshot::channel();
    let worlds = state.clone();
    let idle = state.clone();
    let served = axum::serve(listener, router(state)).with_graceful_shutdown(async move {
        stop.await;
        worlds.shut_down().await;
        let _ = stopping.send(()); // nobody listens where serving has failed already
    });
    let too_long = async move {
        // Where serving has failed the sender is dropped without a word, and the other branch below has the error.
        if stopped.await.is_err() {
            std::future::pending::<()>().await;
        }
        tokio::time::sleep(SHUT_DOWN_WITHIN).await;
    };
    let never_idle = async move {
        idle.stop_idle_worlds().await;
        std::future::pending::<()>().await
    };
    tokio::select! {
        result = served => result,
        () = too_long => Ok(()),
        () = never_idle => Ok(()),
    }
}

/// Serves for ever.
///
/// Errors: those of the listener.
pub async fn serve(listener: TcpListener, state: AppState) -> std::io::Result<()> {
    serve_until(listener, state, std::future::pending()).await
}

async fn not_found(uri: Uri) -> Refusal {
    ApiError::new(
        "not_found",
        format!("nothing is served at {}; see /v1/openapi.json", uri.path()),
    )
    .into()
}

async fn method_not_allowed(method: Method, uri: Uri) -> Refusal {
    ApiError::new(
        "method_not_allowed",
        format!("{method} is not served at {}; see /v1/openapi.json", uri.path()),
    )
    .into()
}

async fn no_sniffing(mut response: Response) -> Response {
    response
        .headers_mut()
        .insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}
