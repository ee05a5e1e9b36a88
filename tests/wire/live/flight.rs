//! A recorded flight, and what came back while it was played.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use holdover::sample::Input;
use holdover::time::AutopilotTime;
use holdover::wire::frame::{Frame, Scan, scan};
use holdover::wire::tlog::TlogReader;
use mavlink::dialects::ardupilotmega::MavMessage;
use tokio::net::UdpSocket;
use tokio::time::{Instant, sleep, sleep_until};

/// Path of a recorded flight.
pub fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("sitl-logs").join(format!("{name}.tlog"))
}

/// The frames of a flight, with the seconds since the first at which each was recorded.
pub struct Flight {
    pub frames: Vec<(f64, Vec<u8>)>,
    heartbeat: Vec<u8>,
}

impl Flight {
    /// The part of a flight that was recorded within `to_s` seconds from its start.
    pub fn load(name: &str, to_s: f64) -> Self {
        let mut reader = TlogReader::new(File::open(path(name)).unwrap());
        let (mut first, mut frames, mut heartbeat) = (None, Vec::new(), None);
        while let Some(record) = reader.next_record().unwrap() {
            let t = record.written_us as f64 * 1e-6;
            let t = t - *first.get_or_insert(t);
            if t > to_s {
                break;
            }
            if record.frame.message_id() == 0 && record.frame.component().0 == 1 && heartbeat.is_none() {
                heartbeat = Some(record.frame.bytes().to_vec());
            }
            frames.push((t, record.frame.bytes().to_vec()));
        }
        Self { frames, heartbeat: heartbeat.unwrap() }
    }

    /// The autopilot's heartbeat: sent before anything else, so that nothing is lost before the vehicle is known.
    pub fn heartbeat(&self) -> &[u8] {
        &self.heartbeat
    }

    /// Says who is there, as an autopilot does before anything else: a second for the link, and one for the vehicle. Nothing is lost of what
    /// is played after that.
    pub async fn introduce<F: AsyncFnMut(&[u8])>(&self, mut send: F) {
        for _ in 0..5 {
            send(&self.heartbeat).await;
            sleep(Duration::from_millis(500)).await;
        }
        send(&self.heartbeat).await;
    }

    /// Plays the frames recorded in [from, to) s, `speed` times as fast. `send` gets a burst of a few frames at a time.
    pub async fn play<F: AsyncFnMut(&[u8])>(&self, from_s: f64, to_s: f64, speed: f64, mut send: F) {
        let begun = Instant::now();
        let mut burst = Vec::with_capacity(2000);
        for (t, frame) in self.frames.iter().filter(|(t, _)| (from_s..to_s).contains(t)) {
            let due = begun + Duration::from_secs_f64((t - from_s) / speed);
            if due > Instant::now() || burst.len() + frame.len() > 1400 {
                if !burst.is_empty() {
                    send(&burst).await;
                    burst.clear();
                }
                sleep_until(due).await;
            }
            burst.extend_from_slice(frame);
        }
        if !burst.is_empty() {
            send(&burst).await;
        }
    }

    /// Boot time of the first sample or reference, µs: what `replay` and `--deny-gnss` count from.
    pub fn start_us(name: &str) -> i64 {
        let log = holdover::log::Log::open(&path(name), None).unwrap();
        let mut start: Option<AutopilotTime> = None;
        log.play(
            |_, _| {},
            |_, item| {
                let time = match item {
                    Input::Sample(s) => s.time(),
                    Input::Reference(r) => r.time(),
                    _ => return,
                };
                start.get_or_insert(time);
            },
        )
        .unwrap();
        start.unwrap().micros()
    }
}

/// Bytes that the daemon sent.
#[derive(Clone, Default)]
pub struct Heard(Arc<Mutex<Vec<u8>>>);

impl Heard {
    /// What comes to a socket from now on.
    pub fn on(socket: &Arc<UdpSocket>) -> Self {
        let heard = Self::default();
        let (listener, ear) = (Arc::clone(socket), heard.clone());
        tokio::spawn(async move {
            let mut buffer = vec![0; 2000];
            loop {
                // Where nobody listens the system says so, and somebody may tomorrow.
                if let Ok(n) = listener.recv(&mut buffer).await {
                    ear.add(&buffer[..n]);
                }
            }
        });
        heard
    }

    pub fn add(&self, bytes: &[u8]) {
        self.0.lock().unwrap().extend_from_slice(bytes);
    }

    pub fn bytes(&self) -> Vec<u8> {
        self.0.lock().unwrap().clone()
    }

    /// Calls `take` with every frame so far.
    pub fn each(&self, mut take: impl FnMut(&Frame<'_>)) {
        let bytes = self.bytes();
        let mut rest = &bytes[..];
        loop {
            match scan(rest, true) {
                Scan::Frame(frame) | Scan::Unknown(frame) => {
                    take(&frame);
                    rest = &rest[frame.len()..];
                }
                Scan::Skip { skip, cause } => panic!("{skip} bytes sent that are no frame: {cause:?}"),
                Scan::Incomplete => return,
            }
        }
    }

    /// The messages so far.
    pub fn messages(&self) -> Vec<MavMessage> {
        let mut out = Vec::new();
        self.each(|frame| out.push(frame.parse().unwrap()));
        out
    }

    /// `time_usec` of every ODOMETRY so far.
    pub fn odometry(&self) -> Vec<u64> {
        let stamp = |m| match m {
            MavMessage::ODOMETRY(o) => Some(o.time_usec),
            _ => None,
        };
        self.messages().into_iter().filter_map(stamp).collect()
    }

    /// Waits until `wanted` says yes, 10 s at most.
    pub async fn until(&self, what: &str, wanted: impl Fn(&Self) -> bool) {
        for _ in 0..1000 {
            if wanted(self) {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        panic!("never came: {what}");
    }
}
