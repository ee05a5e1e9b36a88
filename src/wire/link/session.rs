//! What all streams of bytes have in common: one session from open to lost, and opening again.

use std::io;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt};
use tokio::time::timeout;

use super::arrival::StreamArrivals;
use super::bucket::Bucket;
use super::deframer::Deframer;
use super::event::LinkEventKind;
use super::shared::{Rejects, Shared};

/// Carries frames over `stream` until it breaks; returns why. With `silence`, a stream that is silent for longer is broken.
///
/// Reader and writer run in one task but wait for nothing of each other's.
pub(super) async fn serve<S>(stream: S, shared: &Shared, silence: Option<Duration>) -> String
where
    S: AsyncRead + AsyncWrite,
{
    let (mut reader, mut writer) = tokio::io::split(stream);
    tokio::select! {
        reason = read_all(&mut reader, shared, silence) => reason,
        reason = write_all(&mut writer, shared) => reason,
    }
}

async fn read_all<R: AsyncRead + Unpin>(
    reader: &mut R,
    shared: &Shared,
    silence: Option<Duration>,
) -> String {
    let mut deframer = Deframer::new();
    let per_s = shared.config.limits.search_bytes_per_s;
    let mut bytes = Bucket::new(per_s, per_s / 10.0);
    let mut arrivals = StreamArrivals::new(shared.attendance());
    loop {
        let reading = arrivals.read(reader, deframer.space());
        let result = match silence {
            None => reading.await,
            Some(limit) => match timeout(limit, reading).await {
                Ok(result) => result,
                Err(_elapsed) => return format!("silent for {limit:?}"),
            },
        };
        match result {
            Ok((0, _)) => return "the other end closed it".to_owned(),
            Ok((n, arrived)) => {
                shared.read(n);
                let mut rejects = Rejects::default();
                deframer.advance(n, |found| {
                    shared.found(&found, arrived, &mut rejects);
                });
                shared.rejected(&rejects);
                // A stream is read no faster than this: who writes more has to wait.
                let now = shared.now();
                if !bytes.take(n, now) {
                    tokio::time::sleep(bytes.wait(n)).await;
                }
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return format!("reading failed: {error}"),
        }
    }
}

async fn write_all<W: AsyncWrite + Unpin>(writer: &mut W, shared: &Shared) -> String {
    loop {
        let frame = shared.next_outbound().await;
        match timeout(shared.config.write_stall, writer.write_all(&frame)).await {
            Ok(Ok(())) => shared.written(frame.len()),
            Ok(Err(error)) => return format!("writing failed: {error}"),
            // Part of the frame may be out: only a new connection makes the stream whole again.
            Err(_elapsed) => return format!("took no bytes for {:?}", shared.config.write_stall),
        }
    }
}

/// Something that can be opened again and again.
pub(super) trait Connect {
    type Stream: AsyncRead + AsyncWrite + Send;

    /// Opens it; also returns the other end's name.
    fn connect(&self, shared: &Shared) -> impl Future<Output = io::Result<(Self::Stream, String)>> + Send;

    /// How long it may be silent.
    fn silence(&self, shared: &Shared) -> Option<Duration>;
}

/// Opens, serves, and opens again, for ever. `first` is what was opened at start-up.
pub(super) async fn keep_connected<C: Connect>(
    connector: &C,
    first: Option<(C::Stream, String)>,
    shared: &Shared,
) {
    let mut backoff = shared.backoff();
    let mut opened = first;
    loop {
        let attempt = match opened.take() {
            Some(opened) => Ok(opened),
            None => connector.connect(shared).await,
        };
        match attempt {
            Ok((stream, peer)) => {
                let heard_before = shared.frames_in();
                shared.up(peer, |peer| LinkEventKind::Up { peer });
                let reason = serve(stream, shared, connector.silence(shared)).await;
                shared.down(LinkEventKind::Down { reason });
                // Something that accepts and hangs up at once is no success.
                if shared.frames_in() > heard_before {
                    backoff.reset();
                }
                tokio::time::sleep(backoff.pause()).await;
            }
            Err(error) => shared.pause(&mut backoff, error.to_string()).await,
        }
    }
}
