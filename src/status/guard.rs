//! Whose requests are answered.
//!
//! A page of the network may have a browser ask here in its name: by another origin, or by a name of its own that is made to lead here (DNS rebinding).
//! So the host that is asked for has to be an address, which no name can be turned into, or a name that is ours; and an origin, where one is told, has
//! to be that host.

use std::net::{Ipv4Addr, Ipv6Addr};
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{HOST, HeaderMap, ORIGIN};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::board::{Board, RequestCounts};

/// Names that lead here.
#[derive(Clone, Debug)]
pub(super) struct Guard {
    pub(super) names: Arc<[String]>,
    pub(super) board: Arc<Board>,
}

impl Guard {
    /// Whether the host is an address or one of our names, whatever the port.
    fn knows(&self, authority: &str) -> bool {
        if let Some(inner) = authority.strip_prefix('[') {
            return inner.split_once(']').is_some_and(|(ip, _)| ip.parse::<Ipv6Addr>().is_ok());
        }
        let host = authority.rsplit_once(':').map_or(authority, |(host, _)| host);
        host.parse::<Ipv4Addr>().is_ok()
            || host.eq_ignore_ascii_case("localhost")
            || self.names.iter().any(|name| name.eq_ignore_ascii_case(host))
    }

    fn admits(&self, headers: &HeaderMap) -> bool {
        let mut hosts = headers.get_all(HOST).iter();
        let (Some(host), None) = (hosts.next().and_then(|h| h.to_str().ok()), hosts.next()) else {
            return false;
        };
        let same =
            |origin: &HeaderValue| origin.to_str().ok().and_then(|o| o.strip_prefix("http://")) == Some(host);
        self.knows(host) && headers.get_all(ORIGIN).iter().all(same)
    }
}

/// What browsers are told of every answer: it is shown by nobody else, runs nothing of anybody else, and is not kept.
const MANNERS: [(HeaderName, &str); 5] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
];

/// Answers whom it should.
pub(super) async fn guard(State(guard): State<Guard>, request: Request, next: Next) -> Response {
    let counts = &guard.board.requests;
    let mut response = if guard.admits(request.headers()) {
        next.run(request).await
    } else {
        RequestCounts::note(&counts.foreign);
        (StatusCode::MISDIRECTED_REQUEST, "this host is not served: see status.hosts\n").into_response()
    };
    match response.status() {
        StatusCode::NOT_FOUND | StatusCode::METHOD_NOT_ALLOWED => RequestCounts::note(&counts.unknown),
        status if status.is_success() => RequestCounts::note(&counts.served),
        _ => {}
    }
    for (name, value) in MANNERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn admits(headers: &[(HeaderName, &str)]) -> bool {
        let names: Arc<[String]> = Arc::from(["drone.local".to_owned()]);
        let guard = Guard { names, board: Arc::new(Board::new()) };
        let pairs = headers.iter().map(|(n, v)| (n.clone(), HeaderValue::from_str(v).unwrap()));
        let mut map = HeaderMap::new();
        pairs.for_each(|(name, value)| _ = map.append(name, value));
        guard.admits(&map)
    }

    #[test]
    fn addresses_and_our_names_are_served_and_other_names_are_not() {
        for host in
            ["127.0.0.1:8750", "192.168.4.1", "[::1]:8750", "localhost", "LOCALHOST:1", "Drone.local:80"]
        {
            assert!(admits(&[(HOST, host)]), "{host}");
        }
        for host in [
            "evil.example:8750",
            "127.0.0.1.evil.example",
            "",
            "localhost.evil.example:8750",
            "[::1",
            "[evil.example]",
            "1.2.3.4@evil.example",
            "drone.local.evil.example",
            "2130706433",
        ] {
            assert!(!admits(&[(HOST, host)]), "{host}");
        }
        assert!(!admits(&[]), "no host");
        assert!(!admits(&[(HOST, "localhost"), (HOST, "evil.example")]), "two hosts");
    }

    #[test]
    fn a_foreign_origin_is_refused() {
        let host = (HOST, "127.0.0.1:8750");
        assert!(admits(&[host.clone(), (ORIGIN, "http://127.0.0.1:8750")]));
        for origin in ["null", "http://evil.example", "https://127.0.0.1:8750", "http://127.0.0.1:8751"] {
            assert!(!admits(&[host.clone(), (ORIGIN, origin)]), "{origin}");
        }
    }
}
