//! What answers a connection, whatever carries it: bounded in size and time.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};

use super::board::{Board, RequestCounts};
use super::feed::FeedItem;
use super::routes::{Streams, router};

/// A request has to have come in this time, and its answer to have gone in that; a stream lasts longer, and its viewer comes again.
const REQUEST: Duration = Duration::from_secs(5);
const ANSWER: Duration = Duration::from_secs(15);
const STREAM: Duration = Duration::from_secs(3600);
/// A request's head, bytes (the least that hyper can do with), and its lines.
const LONGEST_HEAD: usize = 8192;
const MOST_HEADERS: usize = 40;

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct StatusFront {
    board: Arc<Board>,
    router: Router,
}

impl StatusFront {
    /// Of which nothing is known yet, for whoever asks for an address, localhost or one of these names.
    pub fn new(names: Arc<[String]>) -> Self {
        let board = Arc::new(Board::new());
        Self { router: router(Arc::clone(&board), names), board }
    }

    /// Takes what the navigation tells.
    pub fn take(&self, told: FeedItem) {
        self.board.take(told);
    }

    /// Answers one connection, and counts one that could not be answered; whether it could.
    pub async fn answer<S: AsyncRead + AsyncWrite + Unpin>(&self, stream: S) -> bool {
        let answered = self.converse(stream).await;
        if !answered {
            self.dropped();
        }
        answered
    }

    /// Counts a connection that there is no place for.
    pub(super) fn dropped(&self) {
        RequestCounts::note(&self.board.requests.dropped);
    }

    async fn converse<S: AsyncRead + AsyncWrite + Unpin>(&self, stream: S) -> bool {
        let streams = Streams::default();
        let service = TowerToHyperService::new(self.router.clone().layer(Extension(Arc::clone(&streams))));
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(REQUEST)
            .max_buf_size(LONGEST_HEAD)
            .max_headers(MOST_HEADERS)
            .keep_alive(false)
            .serve_connection(TokioIo::new(stream), service);
        tokio::pin!(connection);
        if let Ok(ended) = tokio::time::timeout(ANSWER, &mut connection).await {
            return ended.is_ok();
        }
        streams.load(Ordering::Relaxed)
            && tokio::time::timeout(STREAM, connection).await.is_ok_and(|ended| ended.is_ok())
    }
}
