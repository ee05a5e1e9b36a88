//! The real `holdover` process.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::Duration;

/// A running `holdover run`, killed when dropped.
pub struct Holdover {
    child: Child,
    log: Arc<Mutex<Vec<String>>>,
}

impl Holdover {
    /// Starts it with these arguments after `run`.
    pub fn run(args: &[&str]) -> Self {
        Self::start(args, Stdio::piped())
    }

    /// The same with a log that cannot be written: the disk is full.
    pub fn run_without_log(args: &[&str]) -> Self {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        Self::start(args, full.into())
    }

    /// The same with another place for its log.
    pub fn start(args: &[&str], stderr: Stdio) -> Self {
        // What one test's vehicle has left is nothing to another's.
        let keeps = args.iter().any(|a| a.starts_with("state.dir"));
        let forgetful = if keeps { &[][..] } else { &["--set", "state.dir=\"\""][..] };
        let mut child = Command::new(env!("CARGO_BIN_EXE_holdover"))
            .arg("run")
            // The flights are played many times as fast as they were flown, so queues and patience must be larger in proportion.
            .args(["--set", "tuning.link.queue_frames=16384", "--set", "tuning.link.stale_output_ms=3000"])
            .args(["--set", "tuning.link.peer_confirm_ms=50", "--set", "tuning.link.max_frames_hz=200000"])
            .args(args)
            .args(forgetful)
            .env_remove("HOLDOVER_LOG")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(stderr)
            .spawn()
            .unwrap();
        let log = Arc::new(Mutex::new(Vec::new()));
        if let Some(stderr) = child.stderr.take() {
            let lines = Arc::clone(&log);
            std::thread::spawn(move || {
                for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                    lines.lock().unwrap().push(line);
                }
            });
        }
        Self { child, log }
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Everything it logged so far.
    pub fn log(&self) -> String {
        self.log.lock().unwrap().join("\n")
    }

    /// How many lines of its log hold `text`.
    pub fn told(&self, text: &str) -> usize {
        self.log.lock().unwrap().iter().filter(|l| l.contains(text)).count()
    }

    /// Waits for the `n`-th line with `text`, 10 s at most.
    pub fn wait_for(&self, text: &str, n: usize) -> String {
        for _ in 0..1000 {
            let found = self.log.lock().unwrap().iter().filter(|l| l.contains(text)).nth(n - 1).cloned();
            if let Some(line) = found {
                return line;
            }
            sleep(Duration::from_millis(10));
        }
        panic!("\"{text}\" was not logged {n} times:\n{}", self.log());
    }

    /// The address that its first link listens at.
    pub fn address(&self) -> SocketAddr {
        let line = self.wait_for("listens at", 1);
        line.rsplit(' ').next().unwrap().parse().unwrap()
    }

    /// Asks it to end.
    pub fn terminate(&self) {
        let status = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status().unwrap();
        assert!(status.success());
    }

    /// Kills it, as an operating system does that has run out of memory.
    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Waits for its end, `limit` at most.
    pub fn exit(&mut self, limit: Duration) -> ExitStatus {
        for _ in 0..limit.as_millis() / 5 {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            sleep(Duration::from_millis(5));
        }
        panic!("it does not end within {limit:?}:\n{}", self.log());
    }

    /// Ends it and checks that it ends well.
    pub fn stop(&mut self) {
        self.terminate();
        let status = self.exit(Duration::from_secs(2));
        assert_eq!(status.code(), Some(0), "{}", self.log());
    }
}

impl Drop for Holdover {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
