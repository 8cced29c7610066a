//! The JSON API and the web page (`docs/bench-api.md`).

use std::io;
use std::net::TcpListener;

use axum::Router;
use axum::body::Bytes;
use axum::extract::rejection::{BytesRejection, QueryRejection};
use axum::extract::{Path, Query, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Json, Response};
use axum::routing::{get, post};
use axum::serve::ListenerExt;
use serde_json::{Value, json};
use tokio::sync::oneshot;

use super::json::{Fields, required};
use super::server::Bench;
use super::{BenchError, Handle, frame, patch, view};
use crate::remark::remark;

/// Longest step: one hour.
const LONGEST_STEP_US: u64 = 3_600_000_000;
/// Frames in an answer of the trace when the request does not say.
const DEFAULT_LIMIT: u64 = 1000;
/// Most frames in an answer of the trace.
const LARGEST_LIMIT: u64 = 100_000;

const PAGE: &str = include_str!("../../web/index.html");
const STYLE: &str = include_str!("../../web/style.css");
const SCRIPT: &str = include_str!("../../web/bench.js");

/// A request that gets no result: status code and reason.
#[derive(Debug)]
pub(super) struct Refusal {
    status: StatusCode,
    message: String,
}

impl Refusal {
    fn new(status: StatusCode, message: impl Into<String>) -> Self {
        Self {
            status,
            message: message.into(),
        }
    }

    /// 400: the request itself is wrong; the message names the field.
    pub(super) fn bad_request(message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, message)
    }

    fn no_node(id: &str, nodes: usize) -> Self {
        let known = match nodes {
            0 => "this bench has none".to_owned(),
            1 => "this bench has only node 0".to_owned(),
            count => format!("this bench has nodes 0 to {}", count - 1),
        };
        Self::new(StatusCode::NOT_FOUND, format!("no node {id}; {known}"))
    }
}

impl From<BenchError> for Refusal {
    fn from(error: BenchError) -> Self {
        let status = match error {
            BenchError::NotPaused => StatusCode::CONFLICT,
            BenchError::Stopped => StatusCode::SERVICE_UNAVAILABLE,
            _ => StatusCode::INTERNAL_SERVER_ERROR,
        };
        Self::new(status, format!("{error}; {}", error.next_step()))
    }
}

impl From<QueryRejection> for Refusal {
    fn from(rejection: QueryRejection) -> Self {
        Self::new(rejection.status(), rejection.body_text())
    }
}

impl From<BytesRejection> for Refusal {
    fn from(rejection: BytesRejection) -> Self {
        Self::new(rejection.status(), rejection.body_text())
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        (self.status, Json(json!({ "error": self.message }))).into_response()
    }
}

type Answer = Result<Json<Value>, Refusal>;
type Body = Result<Bytes, BytesRejection>;

/// The HTTP side, ready to run on a thread of its own.
pub(super) struct Http {
    listener: TcpListener,
    runtime: tokio::runtime::Runtime,
    router: Router,
}

/// Prepares serving on `listener`, which must be non-blocking.
pub(super) fn prepare(listener: TcpListener, handle: Handle) -> io::Result<Http> {
    Ok(Http {
        listener,
        runtime: tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?,
        router: router(handle),
    })
}

impl Http {
    /// Serves until `stopped` resolves; connections that are open then are closed.
    pub(super) fn run(self, stopped: oneshot::Receiver<()>) {
        let Self {
            listener,
            runtime,
            router,
        } = self;
        let result: io::Result<()> = runtime.block_on(async move {
            let listener = tokio::net::TcpListener::from_std(listener)?.tap_io(|stream| {
                // Only a matter of latency.
                let _ = stream.set_nodelay(true);
            });
            tokio::select! {
                result = axum::serve(listener, router) => result,
                _ = stopped => Ok(()),
            }
        });
        if let Err(error) = result {
            remark(format_args!("bench: the HTTP server has ended: {error}"));
        }
    }
}

fn router(handle: Handle) -> Router {
    Router::new()
        .route("/", get(async || asset("text/html; charset=utf-8", PAGE)))
        .route("/style.css", get(async || asset("text/css", STYLE)))
        .route("/bench.js", get(async || asset("text/javascript", SCRIPT)))
        .route("/api/sim", get(show_bench))
        .route("/api/sim/nodes/{id}", get(show_node).patch(patch_node))
        .route("/api/sim/nodes/{id}/power-cycle", post(power_cycle))
        .route("/api/sim/step", post(step))
        .route("/api/sim/trace", get(show_trace))
        .route("/api/sim/frames", post(send_frame))
        .fallback(async || {
            Refusal::new(
                StatusCode::NOT_FOUND,
                "no such resource; docs/bench-api.md lists them",
            )
        })
        .method_not_allowed_fallback(async || {
            Refusal::new(
                StatusCode::METHOD_NOT_ALLOWED,
                "this resource has no such method; docs/bench-api.md lists them",
            )
        })
        .with_state(handle)
}

fn asset(kind: &'static str, content: &'static str) -> Response {
    let headers = [
        (header::CONTENT_TYPE, kind),
        // The page must always fit the bench that serves it.
        (header::CACHE_CONTROL, "no-cache"),
    ];
    (headers, content).into_response()
}

/// Runs `work` on the bench's thread and awaits its result.
async fn ask<T: Send + 'static>(
    handle: &Handle,
    work: impl FnOnce(&mut Bench) -> T + Send + 'static,
) -> Result<T, Refusal> {
    let (sender, receiver) = oneshot::channel();
    handle.submit(work, move |result| {
        // A browser that has gone needs no answer.
        let _ = sender.send(result);
    })?;
    receiver
        .await
        .map_err(|_| Refusal::from(BenchError::Stopped))
}

async fn show_bench(State(handle): State<Handle>) -> Answer {
    ask(&handle, |bench| Json(view::bench(bench))).await
}

/// The index of a node named in a path; the check that it exists is the bench's.
fn node_index(bench: &Bench, id: &str) -> Result<usize, Refusal> {
    let nodes = bench.world().nodes();
    id.parse()
        .ok()
        .filter(|index| *index < nodes)
        .ok_or_else(|| Refusal::no_node(id, nodes))
}

async fn show_node(State(handle): State<Handle>, Path(id): Path<String>) -> Answer {
    ask(&handle, move |bench| {
        let index = node_index(bench, &id)?;
        Ok(Json(view::node(bench, index)))
    })
    .await?
}

async fn patch_node(State(handle): State<Handle>, Path(id): Path<String>, body: Body) -> Answer {
    let body = body?;
    ask(&handle, move |bench| {
        let index = node_index(bench, &id)?;
        bench.apply(index, patch::parse(&body)?);
        Ok(Json(view::node(bench, index)))
    })
    .await?
}

async fn power_cycle(State(handle): State<Handle>, Path(id): Path<String>) -> Answer {
    ask(&handle, move |bench| {
        let index = node_index(bench, &id)?;
        bench.world_mut().power_cycle(index);
        Ok(Json(view::node(bench, index)))
    })
    .await?
}

async fn step(State(handle): State<Handle>, body: Body) -> Answer {
    let mut fields = Fields::parse(&body?)?;
    let us = fields.integer("us", 0..=LONGEST_STEP_US)?;
    fields.finish()?;
    let us = required("us", us)?;
    let now = ask(&handle, move |bench| bench.step(us)).await??;
    Ok(Json(json!({ "t_us": now.as_micros() })))
}

async fn show_trace(
    State(handle): State<Handle>,
    query: Result<Query<Vec<(String, String)>>, QueryRejection>,
) -> Answer {
    let Query(query) = query?;
    let (mut since, mut limit, mut decode) = (0, DEFAULT_LIMIT, false);
    for (name, value) in &query {
        match name.as_str() {
            "since" => since = query_integer(name, value, 0, u64::MAX)?,
            "limit" => limit = query_integer(name, value, 1, LARGEST_LIMIT)?,
            "decode" => decode = query_boolean(name, value)?,
            _ => {
                return Err(Refusal::bad_request(format!(
                    "unknown query parameter \"{name}\"; known: since, limit, decode"
                )));
            }
        }
    }
    let entries = ask(&handle, move |bench| {
        bench.world().trace_since(since, limit as usize)
    })
    .await?;
    let entries = entries.iter().map(|entry| view::trace_entry(entry, decode));
    Ok(Json(entries.collect()))
}

fn query_boolean(name: &str, value: &str) -> Result<bool, Refusal> {
    value.parse().map_err(|_| {
        Refusal::bad_request(format!(
            "query parameter \"{name}\" is \"{value}\", not true or false"
        ))
    })
}

fn query_integer(name: &str, value: &str, low: u64, high: u64) -> Result<u64, Refusal> {
    match value.parse() {
        Ok(number) if (low..=high).contains(&number) => Ok(number),
        _ => Err(Refusal::bad_request(format!(
            "query parameter \"{name}\" is \"{value}\", not a whole number from {low} to {high}"
        ))),
    }
}

async fn send_frame(State(handle): State<Handle>, body: Body) -> Answer {
    let frame = frame::parse(&body?)?;
    ask(&handle, move |bench| {
        bench.send_from_http(frame);
        Json(json!({ "t_us": bench.world().now().as_micros() }))
    })
    .await
}
