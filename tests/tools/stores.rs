//! Logs from object stores, against a server on loopback.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread;

use crate::command::{COPTER, Ran, bytes_of, holdover_with, records};

/// What the server has, and what it was asked.
#[derive(Default)]
struct Kept {
    /// By path from `/`.
    objects: BTreeMap<String, Vec<u8>>,
    /// Method, path with what follows it, and who asked.
    asked: Vec<(String, String, String)>,
    /// Answers that break off in the middle.
    cuts: usize,
}

/// A server of HTTP that also lists as S3 does. Its thread ends with the test.
struct Server {
    port: u16,
    kept: Arc<Mutex<Kept>>,
}

impl Server {
    fn with(objects: &[(&str, &[u8])]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let objects = objects.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect();
        let kept = Arc::new(Mutex::new(Kept { objects, ..Kept::default() }));
        let server = Self { port, kept: kept.clone() };
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let kept = kept.clone();
                thread::spawn(move || answer(&stream, &kept));
            }
        });
        server
    }

    fn asked(&self) -> Vec<(String, String, String)> {
        self.kept.lock().unwrap().asked.clone()
    }
}

/// One request a connection; what cannot be read is not answered.
fn answer(stream: &TcpStream, kept: &Mutex<Kept>) -> Option<()> {
    let mut lines = BufReader::new(stream).lines();
    let first = lines.next()?.ok()?;
    let mut words = first.split(' ');
    let (method, target) = (words.next()?.to_owned(), words.next()?.to_owned());
    let mut headers = BTreeMap::new();
    for line in lines.map_while(Result::ok).take_while(|l| !l.is_empty()) {
        if let Some((name, value)) = line.split_once(':') {
            headers.insert(name.to_ascii_lowercase(), value.trim().to_owned());
        }
    }
    let mut kept = kept.lock().ok()?;
    let who = headers.get("authorization").cloned().unwrap_or_default();
    kept.asked.push((method.clone(), target.clone(), who));
    let (path, query) = target.split_once('?').unwrap_or((&target, ""));
    if query.contains("list-type=2") {
        let bucket = path.trim_matches('/');
        let prefix = query.split('&').find_map(|p| p.strip_prefix("prefix=")).unwrap_or_default();
        return send(
            stream,
            "200 OK",
            "",
            listing(&kept, bucket, &prefix.replace("%2F", "/")).as_bytes(),
            false,
        );
    }
    if path.starts_with("/secret/") {
        return send(stream, "403 Forbidden", "", b"", false);
    }
    let Some(bytes) = kept.objects.get(path).cloned() else {
        return send(stream, "404 Not Found", "", b"", false);
    };
    let tag = format!("ETag: \"{}-{}\"\r\n", bytes.len(), bytes.iter().map(|b| u64::from(*b)).sum::<u64>());
    let tag = format!("{tag}Last-Modified: Fri, 01 May 2026 10:00:00 GMT\r\n");
    if method == "HEAD" {
        let length =
            format!("HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: {}\r\n{tag}\r\n", bytes.len());
        let mut to = stream;
        return to.write_all(length.as_bytes()).ok();
    }
    let cut = kept.cuts > 0;
    kept.cuts = kept.cuts.saturating_sub(1);
    drop(kept);
    let from =
        headers.get("range").and_then(|r| r.strip_prefix("bytes=")?.split('-').next()?.parse::<usize>().ok());
    match from {
        Some(from) => {
            let range = format!("Content-Range: bytes {from}-{}/{}\r\n{tag}", bytes.len() - 1, bytes.len());
            send(stream, "206 Partial Content", &range, bytes.get(from..)?, cut)
        }
        None => send(stream, "200 OK", &tag, &bytes, cut),
    }
}

fn send(mut to: &TcpStream, status: &str, headers: &str, body: &[u8], cut: bool) -> Option<()> {
    let head =
        format!("HTTP/1.1 {status}\r\nConnection: close\r\nContent-Length: {}\r\n{headers}\r\n", body.len());
    to.write_all(head.as_bytes()).ok()?;
    to.write_all(&body[..if cut { body.len() / 2 } else { body.len() }]).ok()
}

fn listing(kept: &Kept, bucket: &str, prefix: &str) -> String {
    let below = format!("/{bucket}/");
    let entries: String = kept
        .objects
        .iter()
        .filter_map(|(path, bytes)| Some((path.strip_prefix(&below)?, bytes.len())))
        .filter(|(key, _)| key.starts_with(prefix))
        .map(|(key, size)| {
            format!(
                "<Contents><Key>{key}</Key><LastModified>2026-05-01T10:00:00.000Z</LastModified><ETag>&quot;{size}&quot;</ETag><Size>{size}</Size></Contents>"
            )
        })
        .collect();
    format!(
        "<?xml version=\"1.0\"?><ListBucketResult><Name>{bucket}</Name><IsTruncated>false</IsTruncated>{entries}</ListBucketResult>"
    )
}

fn evaluate(server: &Server, more: &[&str]) -> Ran {
    let endpoint = format!("http://127.0.0.1:{}", server.port);
    let variables = [
        ("AWS_ENDPOINT_URL", endpoint.as_str()),
        ("AWS_ALLOW_HTTP", "true"),
        ("AWS_ACCESS_KEY_ID", "FLEETKEY"),
        ("AWS_SECRET_ACCESS_KEY", "not told"),
        ("AWS_REGION", "eu-north-1"),
    ];
    let question = ["evaluate", "--lengths", "15", "--starts", "1", "--estimator", "shipped"];
    holdover_with(&[&question[..], more].concat(), &variables)
}

fn flight() -> Vec<u8> {
    bytes_of(&records(COPTER, 0.0, 110.0))
}

#[test]
fn a_log_from_a_server_is_the_same_as_from_a_file() {
    let flight = flight();
    let server = Server::with(&[("/may/a.tlog", &flight)]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tlog");
    fs::write(&path, &flight).unwrap();
    let local = evaluate(&server, &[path.to_str().unwrap()]);
    assert!(server.asked().is_empty());
    // The first answer breaks off: it is gone on with from there.
    server.kept.lock().unwrap().cuts = 1;
    let far = evaluate(&server, &[&format!("http://127.0.0.1:{}/may/a.tlog?id=7", server.port)]);
    assert_eq!((far.code, &far.out), (Some(0), &local.out), "{far:?}");
    assert!(server.asked().iter().all(|(_, target, _)| target == "/may/a.tlog?id=7"));
}

#[test]
fn a_bucket_is_listed_worked_on_and_gone_on_with() {
    let flight = flight();
    let server = Server::with(&[
        ("/fleet/may/a.tlog", &flight),
        ("/fleet/may/b.tlog", &[0x55; 5000]),
        ("/fleet/may/notes.txt", b"no log"),
        ("/fleet/june/c.tlog", &flight),
    ]);
    let out = tempfile::tempdir().unwrap();
    let results = out.path().to_str().unwrap();
    let shard = |more: &[&str]| {
        evaluate(&server, &[&["s3://fleet/may/", "--recursive", "--out", results, "--json"], more].concat())
            .json()
    };
    let told = shard(&[]);
    assert_eq!((&told["logs"], &told["done_now"], &told["without_rows"]), (&2.into(), &2.into(), &1.into()));
    let asked = server.asked();
    assert!(
        asked.iter().all(|(_, _, who)| who.contains("FLEETKEY") && !who.contains("not told")),
        "{asked:?}"
    );
    let gets =
        |asked: &[(String, String, String)]| asked.iter().filter(|(_, t, _)| t.ends_with(".tlog")).count();
    assert_eq!(gets(&asked), 2);
    assert_eq!(shard(&[])["done_before"], 2);
    assert_eq!(gets(&server.asked()), 2);
    let whole = evaluate(&server, &["--merge", results]);
    assert!(whole.code == Some(0) && whole.err.contains("s3://fleet/may/b.tlog: no log"), "{whole:?}");
    // An object that has changed is done again.
    server.kept.lock().unwrap().objects.insert("/fleet/may/b.tlog".into(), flight);
    assert_eq!(shard(&[])["done_now"], 1);
}

#[test]
fn what_cannot_be_had_is_told_with_its_address_and_code() {
    let server = Server::with(&[("/fleet/may/notes.txt", b"no log")]);
    let host = format!("http://127.0.0.1:{}", server.port);
    evaluate(&server, &[&format!("{host}/none.tlog")]).fails(3, &["none.tlog", "no such object"]);
    evaluate(&server, &[&format!("{host}/secret/a.tlog?X-Sig=abc")])
        .fails(3, &["secret/a.tlog", "credentials", "***"]);
    evaluate(&server, &["s3://fleet/may/"]).fails(3, &["s3://fleet/may/", "no log is listed"]);
    evaluate(&server, &["s3://"]).fails(3, &["s3://"]);
    evaluate(&server, &[&format!("{host}/empty/")]).fails(3, &["/empty/"]);
}

#[test]
fn a_log_that_could_not_be_had_is_tried_again() {
    let server = Server::with(&[]);
    let out = tempfile::tempdir().unwrap();
    let address = format!("http://127.0.0.1:{}/a.tlog", server.port);
    let shard = || evaluate(&server, &[&address, "--out", out.path().to_str().unwrap(), "--json"]).json();
    assert_eq!(shard()["without_rows"], 1);
    server.kept.lock().unwrap().objects.insert("/a.tlog".into(), flight());
    let told = shard();
    assert_eq!((&told["done_now"], &told["without_rows"]), (&1.into(), &0.into()));
}
