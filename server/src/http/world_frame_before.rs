//! `POST /v1/worlds/{id}/frame`: what of a picture lies before a client's objects, whose distances the body holds.

use std::sync::Arc;

use axum::body::{Body, to_bytes};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use welkin_proto::ApiError;

use super::error::Refusal;
use super::extract::{Pairs, WorldOf, of_media_type};
use super::layers::{Wish, parameters};
use super::route::Route;
use super::state::AppState;
use crate::host::renderer::LayersWish;

const MEDIA_TYPE: &str = "application/octet-stream";

/// The route.
pub fn route() -> Route {
    let summary = "The part of a picture that lies before a client's own objects";
    let body = "Distances of the objects along the pixels' rays in metres: a little-endian 32-bit float a pixel, rows from the top; infinite where there is none.";
    let answer = "PNG: 8-bit RGBA with premultiplied light; an object's pixel becomes light plus its own times one less alpha, both decoded from sRGB. Where \
                  there is no object alpha is 255 and the light is the picture's. f32: the same as four little-endian 32-bit floats a pixel, linear, exposed and \
                  before the tone map. With `X-Welkin-Size`, `X-Welkin-Tick`, `X-Welkin-Simulated-S`, `Server-Timing`.";
    parameters(Route::post("/v1/worlds/{id}/frame", summary, before).of_world(), answer)
        .octets(body)
        .error("bad_depth")
}

async fn before(
    State(state): State<AppState>,
    WorldOf(host): WorldOf,
    Pairs(pairs): Pairs,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Refusal> {
    let view = host.view().clone();
    drop(host); // the world may be stopped while the picture is drawn
    let mut wish = Wish::new(pairs, &view.scene.camera, state.limits())?;
    of_media_type(&headers, MEDIA_TYPE)?;
    let pixels = wish.request.width as usize * wish.request.height as usize;
    let most = state.limits().object_pixels_max;
    if pixels > most {
        let message = format!("{pixels} distances are more than {most}, the most that are taken");
        return Err(ApiError::new("body_too_large", message).into());
    }
    // One byte more than wanted is enough to see that there are too many.
    let bytes = to_bytes(body, pixels * 4 + 1)
        .await
        .map_err(|_| wrong_size(pixels, None))?;
    wish.request.layers = Some(LayersWish::Before {
        objects_m: distances(&bytes, pixels)?,
        raw: wish.raw,
    });
    wish.answer(view, &state).await
}

fn wrong_size(pixels: usize, found: Option<usize>) -> ApiError {
    let found = found.map_or("more".to_owned(), |bytes| bytes.to_string());
    let wanted = pixels * 4;
    let message = format!("the body has {found} bytes; a picture of {pixels} pixels takes {wanted}, four each");
    ApiError::new("bad_depth", message)
}

/// The distances in a body. Errors: `bad_depth` for a wrong number of them, for one that is no number and for one below 0.
fn distances(bytes: &[u8], pixels: usize) -> Result<Arc<[f32]>, ApiError> {
    if bytes.len() != pixels * 4 {
        return Err(wrong_size(pixels, (bytes.len() <= pixels * 4).then_some(bytes.len())));
    }
    let floats = bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let objects_m: Arc<[f32]> = floats.collect();
    match objects_m.iter().position(|m| m.is_nan() || *m < 0.0) {
        Some(n) => {
            let message = format!("the distance of pixel {n} is {}; it must be 0 m or more", objects_m[n]);
            Err(ApiError::new("bad_depth", message).at(format!("/{n}")))
        }
        None => Ok(objects_m),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_read_or_refused() {
        let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        assert_eq!(
            &distances(&bytes(&[0.0, 12.5, f32::INFINITY]), 3).unwrap()[..2],
            [0.0, 12.5]
        );
        for (values, pixels, pointer) in [
            (&[1.0, f32::NAN][..], 2, Some("/1")),
            (&[-1.0, 2.0], 2, Some("/0")),
            (&[1.0], 2, None),
            (&[1.0; 3], 2, None),
        ] {
            let error = distances(&bytes(values), pixels).unwrap_err();
            assert_eq!((error.code.as_ref(), error.pointer.as_deref()), ("bad_depth", pointer));
        }
    }
}
