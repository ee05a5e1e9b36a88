//! What a browser, or somebody who is none, asks of the page: over a pipe in memory instead of a network.

use std::net::IpAddr;
use std::time::Duration;

use holdover::status::view::{EventView, StatusView};
use holdover::status::{FeedItem, StatusFront};
use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;

/// No answer is longer, bytes.
const LONGEST: usize = 1 << 18;
/// Every request has an end long before.
const PATIENCE: Duration = Duration::from_secs(60);
/// What fits into the pipe at a time.
const PIPE: usize = 4096;
/// Heads that no line behind them can make ours.
const FOREIGN: [&str; 2] = [
    "GET /api/v1/status HTTP/1.1\r\nHost: evil.example\r\n",
    "GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: http://evil.example\r\n",
];

struct HttpStage {
    runtime: Runtime,
    front: StatusFront,
}

thread_local! {
    static STAGE: HttpStage = HttpStage::new();
}

impl HttpStage {
    fn new() -> Self {
        let front = StatusFront::new(std::sync::Arc::from(["drone.local".to_owned()]));
        front.take(FeedItem::View(Box::<StatusView>::default()));
        front.take(FeedItem::Event(EventView {
            number: 1,
            text: "</script>\"\n".into(),
            ..EventView::default()
        }));
        Self { runtime: Builder::new_current_thread().enable_time().build().expect("a runtime"), front }
    }

    /// What is answered to bytes that come in pieces of this size, whereupon whoever asks says nothing more.
    fn answer(&self, bytes: &[u8], piece: usize) -> Vec<u8> {
        self.runtime.block_on(async {
            let (near, far) = duplex(PIPE);
            let (mut reading, mut writing) = tokio::io::split(near);
            let asking = async {
                for piece in bytes.chunks(piece) {
                    // Who has answered already hears nothing more.
                    if writing.write_all(piece).await.is_err() {
                        break;
                    }
                    tokio::task::yield_now().await;
                }
                let _ = writing.shutdown().await;
            };
            let hearing = async {
                let mut answer = Vec::new();
                // A stream of events goes on for ever: the first of them is enough.
                while answer.len() <= LONGEST && !answer.windows(7).any(|w| w == b"event: ") {
                    if reading.read_buf(&mut answer).await.is_ok_and(|n| n == 0) {
                        break;
                    }
                }
                answer
            };
            let serving = async {
                tokio::join!(self.front.answer(far), asking);
                std::future::pending().await
            };
            tokio::select! {
                answer = timeout(PATIENCE, hearing) => answer.expect("neither an answer nor an end"),
                never = serving => never,
            }
        })
    }
}

/// Whatever is asked is answered by what it deserves, or not at all: never by an error of the server, never at length, and never to a page of
/// somebody else's.
pub fn http(input: &[u8]) -> u64 {
    let Some((&size, bytes)) = input.split_first() else { return 1 };
    STAGE.with(|stage| {
        let answer = stage.answer(bytes, 1 + usize::from(size));
        if code_of(&answer).is_some_and(|code| code < 300) {
            assert!(is_ours(bytes), "a foreign request is answered");
        }
        for head in FOREIGN {
            let answer = stage.answer(&[head.as_bytes(), bytes].concat(), usize::MAX);
            assert!(code_of(&answer).is_none_or(|code| code >= 400), "a foreign request is answered");
        }
    });
    3
}

/// The code of an answer, which has the manners that every answer has to a request that could be read; `None` where there is none.
fn code_of(answer: &[u8]) -> Option<u16> {
    assert!(answer.len() <= LONGEST, "{} bytes", answer.len());
    if answer.is_empty() {
        return None;
    }
    let text = String::from_utf8_lossy(answer);
    let head = text.split("\r\n\r\n").next().unwrap_or_default();
    let line = head.lines().next().unwrap_or_default();
    let code = line.strip_prefix("HTTP/1.1 ").or_else(|| line.strip_prefix("HTTP/1.0 "));
    let code: u16 = code.and_then(|c| c.get(..3)?.parse().ok()).expect("an answer begins with a code");
    assert!((200..500).contains(&code), "{line}");
    if matches!(code, 200 | 404 | 405 | 421) {
        for manner in ["x-frame-options: DENY", "x-content-type-options: nosniff", "default-src 'none'"] {
            assert!(head.contains(manner), "no {manner}: {head}");
        }
    }
    assert!(!head.contains("access-control-allow-origin"), "{head}");
    Some(code)
}

/// Whether a request names one host, which is an address or one of our names, and no origin but that.
fn is_ours(request: &[u8]) -> bool {
    let text = String::from_utf8_lossy(request);
    let head = text.lines().skip_while(|l| l.is_empty()).take_while(|l| !l.is_empty());
    let (mut hosts, mut origins) = (Vec::new(), Vec::new());
    for line in head.skip(1) {
        let Some((name, value)) = line.split_once(':') else { continue };
        match name.to_ascii_lowercase().as_str() {
            "host" => hosts.push(value.trim().to_owned()),
            "origin" => origins.push(value.trim().to_owned()),
            _ => {}
        }
    }
    let [host] = hosts.as_slice() else { return false };
    let named = host.strip_prefix('[').and_then(|h| h.split(']').next());
    let named = named.or_else(|| host.split(':').next()).unwrap_or_default().to_ascii_lowercase();
    let known = named.parse::<IpAddr>().is_ok() || ["localhost", "drone.local"].contains(&named.as_str());
    known && origins.iter().all(|o| *o == format!("http://{host}"))
}
