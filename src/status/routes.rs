//! What can be asked for.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::extract::{Extension, Query, State};
use axum::http::{StatusCode, header};
use axum::middleware::from_fn_with_state;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Router, response::Html};
use futures_util::stream::{self, Stream};
use serde::Deserialize;
use tokio::sync::OwnedSemaphorePermit;
use utoipa::{IntoParams, OpenApi};

use super::board::{Board, Shown, TrackPoint};
use super::guard::{Guard, guard};
use super::metrics;
use super::view::{EventView, StatusView};

/// A sign of life where nothing else is to be told.
const KEEP_ALIVE: Duration = Duration::from_secs(5);

const PAGE: &str = include_str!("page/index.html");
const SCRIPT: &str = include_str!("page/page.js");
const STYLE: &str = include_str!("page/page.css");

#[derive(OpenApi)]
#[openapi(
    paths(status, events, track),
    info(
        title = "Holdover",
        description = "How a running daemon fares, to be read only.",
        license(name = "MIT OR Apache-2.0")
    )
)]
struct Api;

/// Whether the connection streams, and may last.
pub(super) type Streams = Arc<AtomicBool>;

/// Everything that is served.
pub(super) fn router(board: Arc<Board>, names: Arc<[String]>) -> Router {
    let text = |kind: &'static str, body: &'static str| {
        get(move || async move { ([(header::CONTENT_TYPE, kind)], body) })
    };
    Router::new()
        .route("/", get(|| async { Html(PAGE) }))
        .route("/page.js", text("text/javascript; charset=utf-8", SCRIPT))
        .route("/page.css", text("text/css; charset=utf-8", STYLE))
        .route("/api/v1/status", get(status))
        .route("/api/v1/events", get(events))
        .route("/api/v1/track", get(track))
        .route("/api/v1/stream", get(follow))
        .route("/api/v1/openapi.json", get(openapi))
        .route("/metrics", get(scrape))
        .with_state(Arc::clone(&board))
        .layer(from_fn_with_state(Guard { names, board }, guard))
}

fn json(body: String) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], body).into_response()
}

fn told<T: serde::Serialize>(value: &T) -> Response {
    match serde_json::to_string(value) {
        Ok(body) => json(body),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

async fn openapi() -> Response {
    told(&Api::openapi())
}

/// How everything fares, some 200 ms ago at most.
#[utoipa::path(get, path = "/api/v1/status", responses((status = 200, body = StatusView), (status = 503, description = "nothing is known yet")))]
async fn status(State(board): State<Arc<Board>>) -> Response {
    let shown = Arc::clone(&board.newest.borrow());
    if shown.json.is_empty() {
        StatusCode::SERVICE_UNAVAILABLE.into_response()
    } else {
        json(shown.json.clone())
    }
}

/// Which events.
#[derive(Deserialize, IntoParams)]
struct EventsQuery {
    /// Only those with a greater number.
    #[serde(default)]
    after: u64,
}

/// What happened of late, the oldest first.
#[utoipa::path(get, path = "/api/v1/events", params(EventsQuery), responses((status = 200, body = Vec<EventView>)))]
async fn events(State(board): State<Arc<Board>>, Query(query): Query<EventsQuery>) -> Response {
    told(&board.events(query.after))
}

/// The track of the last half hour, a point a second: s since the daemon began, north and east, m.
#[utoipa::path(get, path = "/api/v1/track", responses((status = 200, body = Vec<[f64; 3]>)))]
async fn track(State(board): State<Arc<Board>>) -> Response {
    let track: Vec<TrackPoint> = board.track();
    told(&track)
}

async fn scrape(State(board): State<Arc<Board>>) -> Response {
    ([(header::CONTENT_TYPE, metrics::CONTENT_TYPE)], metrics::text(&board)).into_response()
}

/// A viewer of the stream. What is not taken in time is not kept for him: he gets the newest.
struct Viewer {
    board: Arc<Board>,
    newest: tokio::sync::watch::Receiver<Arc<Shown>>,
    event: u64,
    waiting: Vec<EventView>,
    _place: OwnedSemaphorePermit,
}

impl Viewer {
    async fn next(mut self) -> Option<(Result<Event, Infallible>, Self)> {
        if self.waiting.is_empty() {
            self.waiting = self.board.events(self.event);
            self.waiting.reverse();
        }
        if let Some(event) = self.waiting.pop() {
            self.event = event.number;
            let data = serde_json::to_string(&event).unwrap_or_default();
            return Some((Ok(Event::default().event("event").data(data)), self));
        }
        self.newest.changed().await.ok()?;
        let shown = Arc::clone(&self.newest.borrow_and_update());
        Some((Ok(Event::default().event("status").data(&shown.json)), self))
    }
}

fn watch(viewer: Viewer) -> impl Stream<Item = Result<Event, Infallible>> {
    stream::unfold(viewer, Viewer::next)
}

/// Views and events as they come, as server-sent events.
async fn follow(State(board): State<Arc<Board>>, Extension(streams): Extension<Streams>) -> Response {
    let Ok(place) = Arc::clone(&board.viewers).try_acquire_owned() else {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many viewers\n").into_response();
    };
    streams.store(true, Ordering::Relaxed);
    let mut newest = board.newest.subscribe();
    newest.mark_changed();
    let viewer = Viewer { board, newest, event: 0, waiting: Vec::new(), _place: place };
    Sse::new(watch(viewer)).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response()
}
