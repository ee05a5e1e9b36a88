//! Logs in object stores (S3, Google's, Azure's) and on servers of HTTP. Credentials, regions and endpoints come from the variables that each
//! provider's own tools read.

use std::io::{self, ErrorKind, Read};
use std::path::Path;
use std::sync::Arc;

use futures_util::StreamExt;
use futures_util::stream::BoxStream;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
use object_store::http::HttpBuilder;
use object_store::path::Path as Location;
use object_store::{ClientConfigKey, Error, ObjectMeta, ObjectStore, ObjectStoreExt, RetryConfig};
use reqwest::Url;
use tokio::runtime::Runtime;

use crate::log::{LogFile, RemoteLog};

/// A server that is silent for longer is asked again.
const SILENCE: &str = "60 s";
/// A log may take this long: what is wanted of a server is that it goes on, not that it is fast.
const LONGEST: &str = "1 day";
/// How long a request is tried again, and how often.
const PATIENCE_S: u64 = 90;
const MOST_RETRIES: usize = 6;
/// Logs by their names, in a listing: to look into each would be to fetch it.
const ENDINGS: &[&str] = &[".ulg", ".bin", ".tlog", ".tlog.raw", ".log.bin"];
const PACKED: &[&str] = &["", ".gz", ".zst"];
/// Objects below an address that are looked at.
const MOST_OBJECTS: usize = 1_000_000;
/// Parameters of an address whose values are secrets: they are not shown.
const SECRET_WORDS: &[&str] = &["sig", "token", "key", "credential", "secret", "pass"];

/// Where objects are, and what waits for them. Its clones are used by many threads at once.
#[derive(Debug)]
struct StoreClient {
    store: Box<dyn ObjectStore>,
    runtime: Runtime,
}

/// A log in it.
#[derive(Debug)]
struct StoredLog {
    bucket: Arc<StoreClient>,
    location: Location,
    /// What the listing told of it.
    listed: Option<String>,
}

/// The logs at an address: the object itself, or, where it ends with `/`, those below it whose names end like a log's, in the order of their
/// names, with `recursive` in folders below as well. Nothing is fetched yet, but the listing.
///
/// # Errors
/// An address that cannot be understood, a listing that cannot be had, or has no log in it.
pub fn logs_at(address: &str, recursive: bool) -> io::Result<Vec<LogFile>> {
    let url = Url::parse(address).map_err(|e| io::Error::new(ErrorKind::InvalidInput, e.to_string()))?;
    let location = Location::from_url_path(url.path())
        .map_err(|e| io::Error::new(ErrorKind::InvalidInput, e.to_string()))?;
    let bucket = Arc::new(StoreClient { store: store(&url).map_err(|e| told(&e))?, runtime: runtime()? });
    if !url.path().ends_with('/') && !url.path().is_empty() {
        let log = StoredLog { bucket, location, listed: None };
        return Ok(vec![LogFile::remote(Path::new(&shown(&url)), Arc::new(log))]);
    }
    let mut found = bucket.listed(&location, recursive)?;
    found.retain(|meta| is_log(meta.location.as_ref()));
    if found.is_empty() {
        let more = if recursive { "" } else { " (--recursive looks into the folders below as well)" };
        return Err(io::Error::new(ErrorKind::NotFound, format!("no log is listed there{more}")));
    }
    found.sort_by(|a, b| a.location.cmp(&b.location));
    let mut place = url.clone();
    place.set_path("");
    place.set_query(None);
    let place = shown(&place);
    let place = place.trim_end_matches('/');
    let logs = found.into_iter().map(|meta| {
        let name = format!("{place}/{}", meta.location);
        let log =
            StoredLog { bucket: bucket.clone(), listed: Some(identity(&meta)), location: meta.location };
        LogFile::remote(Path::new(&name), Arc::new(log))
    });
    Ok(logs.collect())
}

fn is_log(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    PACKED.iter().any(|packed| {
        name.strip_suffix(packed).is_some_and(|name| ENDINGS.iter().any(|ending| name.ends_with(ending)))
    })
}

/// An address without what is secret in it.
fn shown(url: &Url) -> String {
    let mut shown = url.clone();
    // Neither can fail where there is a host.
    let _ = shown.set_password(None);
    let _ = shown.set_username("");
    let secret = |name: &str| SECRET_WORDS.iter().any(|word| name.to_ascii_lowercase().contains(word));
    let pairs: Vec<(String, String)> = url
        .query_pairs()
        .map(|(name, value)| (name.to_string(), if secret(&name) { "***".into() } else { value.to_string() }))
        .collect();
    if !pairs.is_empty() {
        shown.query_pairs_mut().clear().extend_pairs(pairs);
    }
    shown.to_string()
}

fn store(url: &Url) -> Result<Box<dyn ObjectStore>, Error> {
    // Whoever was first has chosen the same.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let retry = RetryConfig {
        max_retries: MOST_RETRIES,
        retry_timeout: std::time::Duration::from_secs(PATIENCE_S),
        ..RetryConfig::default()
    };
    let patience = [(ClientConfigKey::ReadTimeout, SILENCE), (ClientConfigKey::Timeout, LONGEST)];
    macro_rules! patient {
        ($builder:expr, $key:expr) => {{
            let builder = $builder.with_retry(retry);
            Box::new(patience.into_iter().fold(builder, |b, (k, v)| b.with_config($key(k), v)).build()?)
        }};
    }
    let text = url.as_str();
    Ok(match url.scheme() {
        "s3" | "s3a" => patient!(AmazonS3Builder::from_env().with_url(text), AmazonS3ConfigKey::Client),
        "gs" => patient!(GoogleCloudStorageBuilder::from_env().with_url(text), GoogleConfigKey::Client),
        "http" | "https" => {
            // What stands behind the path goes with every request.
            let mut base = url.clone();
            base.set_path("/");
            let builder = HttpBuilder::new().with_url(base).with_config(ClientConfigKey::AllowHttp, "true");
            patient!(builder, std::convert::identity)
        }
        _ => patient!(MicrosoftAzureBuilder::from_env().with_url(text), AzureConfigKey::Client),
    })
}

/// Everything that waits does so on the thread that wants it.
fn runtime() -> io::Result<Runtime> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()
}

/// What tells an object from another in its place.
fn identity(meta: &ObjectMeta) -> String {
    match meta.e_tag.as_ref().or(meta.version.as_ref()) {
        Some(tag) => format!("{} bytes, {tag}", meta.size),
        None => format!("{} bytes, {}", meta.size, meta.last_modified.to_rfc3339()),
    }
}

impl StoreClient {
    fn listed(&self, folder: &Location, recursive: bool) -> io::Result<Vec<ObjectMeta>> {
        let below = (!folder.as_ref().is_empty()).then_some(folder);
        if !recursive {
            let found = self.runtime.block_on(self.store.list_with_delimiter(below));
            return Ok(found.map_err(|e| told(&e))?.objects);
        }
        let mut listing = self.store.list(below);
        let mut found = Vec::new();
        while let Some(meta) = self.runtime.block_on(listing.next()) {
            found.push(meta.map_err(|e| told(&e))?);
            if found.len() > MOST_OBJECTS {
                return Err(io::Error::other(format!(
                    "more than {MOST_OBJECTS} objects: give a list (--list)"
                )));
            }
        }
        Ok(found)
    }
}

impl RemoteLog for StoredLog {
    fn identity(&self) -> io::Result<String> {
        if let Some(listed) = &self.listed {
            return Ok(listed.clone());
        }
        let head = self.bucket.runtime.block_on(self.bucket.store.head(&self.location));
        head.map(|meta| identity(&meta)).map_err(|e| told(&e))
    }

    fn open(&self) -> io::Result<Box<dyn Read>> {
        let got = self.bucket.runtime.block_on(self.bucket.store.get(&self.location));
        let chunks = got.map_err(|e| told(&e))?.into_stream();
        Ok(Box::new(Arriving { bucket: self.bucket.clone(), chunks, chunk: Default::default(), at: 0 }))
    }
}

/// An object while it comes.
struct Arriving {
    bucket: Arc<StoreClient>,
    chunks: BoxStream<'static, object_store::Result<bytes::Bytes>>,
    chunk: bytes::Bytes,
    at: usize,
}

impl Read for Arriving {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        while self.at == self.chunk.len() {
            match self.bucket.runtime.block_on(self.chunks.next()) {
                None => return Ok(0),
                Some(chunk) => (self.chunk, self.at) = (chunk.map_err(|e| told(&e))?, 0),
            }
        }
        let n = to.len().min(self.chunk.len() - self.at);
        to[..n].copy_from_slice(&self.chunk[self.at..self.at + n]);
        self.at += n;
        Ok(n)
    }
}

/// What a store says, for people: what it was and the innermost reason, without addresses that may hold secrets.
fn told(e: &Error) -> io::Error {
    match e {
        Error::NotFound { .. } => io::Error::new(ErrorKind::NotFound, "there is no such object"),
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => io::Error::new(
            ErrorKind::PermissionDenied,
            "access is refused: are the provider's variables with the credentials set, and right?",
        ),
        _ => {
            let mut inner: &dyn std::error::Error = e;
            while let Some(source) = inner.source() {
                inner = source;
            }
            io::Error::other(format!("the store cannot be read: {inner}"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_logs_and_what_is_not_shown() {
        for name in ["a/b.ulg", "B.BIN", "c.tlog.gz", "d.tlog.raw.zst", "e.Ulg.ZST"] {
            assert!(is_log(name), "{name}");
        }
        for name in ["a.txt", "ulg", "a.ulg.part", "b.parquet", ""] {
            assert!(!is_log(name), "{name}");
        }
        let url = Url::parse("https://me:secret@host/a.ulg?X-Amz-Signature=abc&id=3").unwrap();
        let text = shown(&url);
        assert!(text.contains("id=3") && !text.contains("secret") && !text.contains("abc"), "{text}");
    }
}
