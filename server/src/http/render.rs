//! `POST /v1/render`: a picture of a scene of its own, from its start to the second that was asked for.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use axum::extract::State;
use axum::http::header;
use axum::response::Response;
use welkin_proto::wire::RenderRequest;
use welkin_proto::{ApiError, Scene, validate};

use super::checks;
use super::error::{Refusal, internal};
use super::extract::{JsonText, parse_json, read, take_scene};
use super::route::Route;
use super::state::AppState;
use super::viewing::still_fits;
use super::world_frame::{MEDIA_TYPES, image_response};
use crate::host::renderer::{Frame, FrameRequest};
use crate::machine::Machine;
use crate::picture::{self, Renderer};
use crate::world::World;

/// The route.
pub fn route() -> Route {
    Route::post("/v1/render", "Run a scene of its own and take a picture", render)
        .body::<RenderRequest>()
        .bytes(
            200,
            "The picture, with `X-Welkin-Tick`, `Server-Timing` and `X-Welkin-Simulate-Ms`.",
            &MEDIA_TYPES,
        )
        .error("out_of_range")
        .error("unknown_preset")
        .error("busy")
        .error("render_too_long")
        .error("unstable")
        .error("internal")
}

/// Set when the request's future is dropped, so that nobody simulates for a client who has left.
struct Abandon(Arc<AtomicBool>);

impl Drop for Abandon {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

async fn render(State(state): State<AppState>, JsonText(text): JsonText) -> Result<Response, Refusal> {
    let limits = state.limits();
    let mut document = parse_json(&text)?;
    let scene = take_scene(&mut document, limits)?;
    let wish: RenderRequest = read::<RenderRequest>(document)?;
    checks::size(wish.width, wish.height, limits)?;
    if wish.still {
        still_fits(wish.width, wish.height, limits).map_err(|error| error.at("/still"))?;
    }
    checks::in_range(wish.simulated_s, 0.0, limits.render_simulated_max_s, "/simulated_s")?;
    if let Some(camera) = &wish.camera {
        validate::camera(camera, "/camera")?;
    }
    let permit = state.renders().clone().try_acquire_owned().map_err(|_| {
        ApiError::new(
            "busy",
            format!(
                "{} renders run already, which is the limit; try again",
                limits.renders_max
            ),
        )
    })?;
    let abandoned = Arc::new(AtomicBool::new(false));
    let _guard = Abandon(abandoned.clone());
    let deadline = Duration::try_from_secs_f64(limits.render_time_max_s).unwrap_or(Duration::MAX);
    let machine = state.machine().clone();
    let work = tokio::task::spawn_blocking(move || {
        let _permit = permit; // held until the work is over, even if the client leaves
        run(scene, &wish, machine, deadline, &abandoned)
    });
    let (frame, simulate_ms) = work.await.map_err(internal)??;
    let more = [
        (header::CACHE_CONTROL, "no-store".to_owned()),
        (
            header::HeaderName::from_static("x-welkin-simulate-ms"),
            format!("{simulate_ms:.0}"),
        ),
    ];
    Ok(image_response(&frame, more))
}

/// Simulates and takes the picture; returns it with the wall milliseconds that the simulation took.
fn run(
    scene: Scene,
    wish: &RenderRequest,
    machine: Machine,
    deadline: Duration,
    abandoned: &AtomicBool,
) -> Result<(Frame, f64), ApiError> {
    let began = Instant::now();
    let request = FrameRequest {
        width: wish.width,
        height: wish.height,
        format: wish.format,
        camera: wish.camera.clone().unwrap_or_else(|| scene.camera.clone()),
        still: wish.still,
        whole: true,
        past: None,
        layers: None,
    };
    let mut renderer = Renderer::new(&machine.compute);
    let mut world = World::new(scene, machine)?;
    world.advance_to(wish.simulated_s, |_| {
        began.elapsed() < deadline && !abandoned.load(Ordering::Relaxed)
    });
    if let Some(error) = world.halted_error() {
        return Err(error);
    }
    let snapshot = world.snapshot();
    let reached_s = snapshot.numbers.simulated_s;
    if reached_s < wish.simulated_s - 1e-6 {
        let limit_s = deadline.as_secs_f64();
        let message = format!(
            "{limit_s} s of wall time, which is the limit, were over at simulated second {reached_s:.0} of {:.0}",
            wish.simulated_s
        );
        return Err(ApiError::new("render_too_long", message));
    }
    let simulate_ms = began.elapsed().as_secs_f64() * 1e3;
    let size = [request.width, request.height];
    let picture = renderer.render(&snapshot, world.scene(), &request.camera, size, request.still)?;
    let encoding = Instant::now();
    let bytes = picture::encode(&picture, request.format, request.still)?;
    let frame = Frame {
        request,
        revision: 0,
        published_at: encoding,
        tick: snapshot.numbers.tick,
        simulated_s: reached_s,
        render_ms: picture.render_ms,
        encode_ms: encoding.elapsed().as_secs_f64() * 1e3,
        bytes,
    };
    Ok((frame, simulate_ms))
}
