//! The page in a real browser, through a loss of GNSS, its return, and a restart of the daemon. Debian's chromium, spoken to by its own protocol over a
//! pipe; where there is none the test says so and passes, but not in CI.

use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::page::{Flown, page};

/// The browser speaks on 3 and 4.
const WITH_PIPES: &str = r#"exec "$0" "$@" 3<&0 4>&1 </dev/null >/dev/null 2>&1"#;
const QUIET: [&str; 12] = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
];
/// For anything that the page or the browser has to do, on a machine that is busy.
const PATIENCE: Duration = Duration::from_secs(60);

struct Browser {
    process: Child,
    say: ChildStdin,
    heard: Receiver<Value>,
    number: u64,
    session: Option<String>,
    /// What the page has complained of.
    complaints: Vec<String>,
    _profile: TempDir,
}

impl Drop for Browser {
    fn drop(&mut self) {
        self.say(&json!({"id": 0, "method": "Browser.close"}));
        for _ in 0..100 {
            if self.process.try_wait().is_ok_and(|ended| ended.is_some()) {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Browser {
    /// `None` where there is no chromium, which CI has.
    fn start() -> Option<Self> {
        let there =
            |name: &&str| Command::new(*name).arg("--version").output().is_ok_and(|o| o.status.success());
        let Some(name) = ["chromium", "chromium-browser", "google-chrome"].into_iter().find(there) else {
            assert!(std::env::var_os("CI").is_none(), "no chromium: apt-get install chromium");
            eprintln!("skipped: there is no chromium");
            return None;
        };
        let profile = tempfile::tempdir().unwrap();
        let mut process = Command::new("bash")
            .args(["-c", WITH_PIPES, name])
            .args(QUIET)
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let (say, stdout) = (process.stdin.take().unwrap(), process.stdout.take().unwrap());
        let (send, heard) = channel();
        std::thread::spawn(move || {
            let messages = BufReader::new(stdout).split(0).map_while(Result::ok);
            for message in messages {
                let Ok(value) = serde_json::from_slice(&message) else { continue };
                if send.send(value).is_err() {
                    return;
                }
            }
        });
        let complaints = Vec::new();
        Some(Self { process, say, heard, number: 0, session: None, complaints, _profile: profile })
    }

    fn say(&mut self, message: &Value) {
        let _ = self.say.write_all(format!("{message}\0").as_bytes()).and_then(|()| self.say.flush());
    }

    fn call(&mut self, method: &str, params: Value) -> Value {
        self.number += 1;
        let mut message = json!({"id": self.number, "method": method, "params": params});
        if let Some(session) = &self.session {
            message["sessionId"] = session.as_str().into();
        }
        self.say(&message);
        loop {
            let heard = self.heard.recv_timeout(PATIENCE).unwrap_or_else(|e| panic!("{method}: {e}"));
            self.note(&heard);
            if heard["id"] == self.number {
                assert!(heard["error"].is_null(), "{method}: {heard}");
                return heard["result"].clone();
            }
        }
    }

    /// What the page throws, and what is refused by its policy; not that a connection failed.
    fn note(&mut self, heard: &Value) {
        let entry = &heard["params"]["entry"];
        let network = entry["source"] == "network";
        if heard["method"] == "Runtime.exceptionThrown" || (entry["level"] == "error" && !network) {
            self.complaints.push(heard.to_string());
        }
    }

    fn open(&mut self, at: SocketAddr, (width, height): (u32, u32)) {
        let target = self.call("Target.createTarget", json!({"url": "about:blank"}));
        let attached =
            self.call("Target.attachToTarget", json!({"targetId": target["targetId"], "flatten": true}));
        self.session = Some(attached["sessionId"].as_str().unwrap().to_owned());
        for domain in ["Page", "Runtime", "Log"] {
            self.call(&format!("{domain}.enable"), json!({}));
        }
        self.size(width, height);
        self.call("Page.navigate", json!({"url": format!("http://{at}/")}));
    }

    fn size(&mut self, width: u32, height: u32) {
        let metrics =
            json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600});
        self.call("Emulation.setDeviceMetricsOverride", metrics);
    }

    /// What an expression is in the page.
    fn value(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "returnByValue": true});
        let answer = self.call("Runtime.evaluate", params);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true; before the page is there it throws.
    fn until(&mut self, expression: &str) {
        let tries = PATIENCE.as_millis() / 50;
        let asked = format!("(() => {{ try {{ return {expression}; }} catch {{ return false; }} }})()");
        for _ in 0..tries {
            if self.value(&asked) == true {
                return;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        let shown = self.value("document.body.innerText");
        panic!("never: {expression}\n{shown}\n{:?}", self.complaints);
    }

    /// A picture of the whole window, where somebody has asked for pictures.
    fn picture(&mut self, name: &str) {
        let Some(folder) = std::env::var_os("HOLDOVER_TEST_PICTURES") else { return };
        let shot = self.call("Page.captureScreenshot", json!({"format": "png"}));
        let bytes = BASE64_STANDARD.decode(shot["data"].as_str().unwrap()).unwrap();
        std::fs::write(Path::new(&folder).join(name), bytes).unwrap();
    }
}

const MODE: &str = "document.getElementById('mode').textContent";

#[tokio::test]
async fn a_browser_follows_a_flight_through_a_loss_a_return_and_a_restart() {
    let Some(mut browser) = Browser::start() else { return };
    let mut flown = Flown::begin(140.0, &["--deny-gnss", "70..105"]).await;
    let at = page(&flown.holdover);
    flown.fly(0.0, 65.0).await;
    browser.open(at, (1280, 1000));
    browser.until(&format!("{MODE} === 'Aided'"));
    browser.until("document.querySelectorAll('#sources tr').length >= 5");
    browser.until("parseFloat(document.getElementById('sigma').textContent) > 0.1");
    // What was flown before the page was opened is there, too.
    browser.until("document.getElementById('track').getAttribute('points').split(' ').length >= 4");
    browser.until("document.querySelectorAll('#events li code').length >= 3");

    flown.fly(65.0, 100.0).await;
    browser.until(&format!("{MODE} === 'Holdover'"));
    browser.until("document.getElementById('top').dataset.mode === 'Holdover'");
    browser.until("!document.getElementById('carried').textContent.includes('GNSS')");
    // The source that is refused stands out, with its reason.
    browser.until("[...document.querySelectorAll('#sources tr:not(.healthy)')].some(r => /GNSS/.test(r.innerText) && r.querySelector('.why').textContent.length > 3)");
    browser.picture("page.png");
    browser.size(412, 1400);
    browser.until("document.documentElement.scrollWidth <= 412");
    browser.picture("page-phone.png");
    browser.size(1280, 1000);

    flown.fly(100.0, 140.0).await;
    browser.until(&format!("{MODE} === 'Aided'"));
    browser.until("[...document.querySelectorAll('#events li')].some(e => /Holdover -> /.test(e.innerText))");

    // Gone, and begun again at the same place.
    flown.holdover.stop();
    browser.until("document.getElementById('top').classList.contains('stale')");
    browser.until("document.getElementById('link').textContent.includes('NO WORD')");
    let listen = format!("status.listen={at}");
    let mut second =
        crate::live::process::Holdover::run(&["--endpoint", "udpin:127.0.0.1:0", "--set", &listen]);
    browser.until("!document.getElementById('top').classList.contains('stale')");
    browser.until(&format!("{MODE} === 'Aligning' && document.querySelectorAll('#events li').length === 0"));
    assert_eq!(browser.complaints, [] as [String; 0]);
    second.stop();
}
