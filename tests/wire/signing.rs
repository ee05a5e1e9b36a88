//! Signed links, with pymavlink's signing at the other end: what the real daemon believes, sends, and refuses to hear twice.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use crate::live::flight::{Flight, Heard};
use crate::live::process::Holdover;
use crate::live::pymavlink;
use holdover::wire::companion_clock::CompanionClock;
use holdover::wire::counters::Cause;
use holdover::wire::frame::{ComponentId, Frame, Scan, SystemId, scan};
use holdover::wire::frame_bytes::FrameBytes;
use holdover::wire::session::Address;
use holdover::wire::session::heartbeat::{SystemStatus, heartbeat};
use holdover::wire::session::outgoing::FrameWriter;
use holdover::wire::signing::{SigningGate, SigningKey, SigningSettings, SigningStamp};
use mavlink::dialects::ardupilotmega::MavMessage;
use tokio::net::UdpSocket;
use tokio::time::sleep;

const COPTER: &str = "ardupilot-copter-gps-loss";
const KEY: [u8; 32] = *b"\x01\x02\x03\x04\x05\x06\x07\x08 not a secret: of a tes\xff";
const OTHER_KEY: [u8; 32] = [0x77; 32];
const SPEED: f64 = 15.0;

fn hex(key: &[u8]) -> String {
    key.iter().map(|b| format!("{b:02x}")).collect()
}

fn now_us() -> i64 {
    CompanionClock::new().unix_us()
}

fn stamp_now() -> String {
    SigningStamp::of_unix_us(now_us()).0.to_string()
}

fn gate() -> SigningGate {
    SigningGate::new(Some(SigningKey::new(KEY)), &SigningSettings::default())
}

fn each(bytes: &[u8], mut take: impl FnMut(&Frame<'_>)) {
    let mut rest = bytes;
    while let Scan::Frame(frame) | Scan::Unknown(frame) = scan(rest, true) {
        take(&frame);
        rest = &rest[frame.len()..];
    }
    assert!(rest.is_empty(), "{} bytes are no frame", rest.len());
}

fn beats(n: u32) -> Vec<u8> {
    let mut writer = FrameWriter::new(Address { system: SystemId(1), component: ComponentId::AUTOPILOT });
    (0..n).flat_map(|i| writer.write(&heartbeat(SystemStatus::Active, i)).unwrap().to_vec()).collect()
}

#[test]
fn pymavlink_believes_what_is_signed_here_and_the_other_way_round() {
    let mut sent = Vec::new();
    let ours = gate();
    each(&beats(300), |frame| {
        let bytes = FrameBytes::new(frame.bytes()).unwrap();
        sent.extend_from_slice(&ours.sign(bytes, 1, now_us()).unwrap());
    });
    let check = |key: &[u8], bytes: &[u8]| {
        let told = pymavlink::sign(&["check", &hex(key), &stamp_now()], bytes);
        String::from_utf8(told).unwrap().trim().to_owned()
    };
    assert_eq!(check(&KEY, &sent), "300 0");
    assert!(check(&OTHER_KEY, &sent).starts_with("0 "));

    let theirs = pymavlink::sign(&["sign", &hex(&KEY), "9", &stamp_now()], &beats(300));
    let forged = pymavlink::sign(&["sign", &hex(&OTHER_KEY), "9", &stamp_now()], &beats(300));
    let gate = gate();
    let admitted = |bytes: &[u8]| {
        let mut verdicts = Vec::new();
        each(bytes, |frame| verdicts.push(gate.admit(frame, false, now_us())));
        assert!(verdicts.windows(2).all(|v| v[0] == v[1]), "{verdicts:?}");
        verdicts[0]
    };
    assert_eq!(admitted(&theirs), Ok(()));
    assert_eq!(admitted(&theirs), Err(Cause::Replayed));
    assert_eq!(admitted(&forged), Err(Cause::BadSignature));
}

/// An autopilot's socket that keeps what it sent, and what it hears.
struct Autopilot {
    socket: Arc<UdpSocket>,
    heard: Heard,
}

impl Autopilot {
    async fn new() -> Self {
        let socket = Arc::new(UdpSocket::bind("127.0.0.1:0").await.unwrap());
        let heard = Heard::on(&socket);
        Self { socket, heard }
    }

    /// Plays a flight, each frame signed as it leaves if there is a gate; what was sent.
    async fn play(
        &self,
        to: SocketAddr,
        flight: &Flight,
        until_s: f64,
        gate: Option<&SigningGate>,
    ) -> Vec<u8> {
        let mut sent = Vec::new();
        let signed = |bytes: &[u8]| {
            let mut out = Vec::new();
            each(bytes, |frame| {
                let bytes = FrameBytes::new(frame.bytes()).unwrap();
                match gate {
                    // MAVLink 1 cannot be signed: it stays at home.
                    Some(gate) => out.extend(gate.sign(bytes, 0, now_us()).iter().flat_map(|b| b.to_vec())),
                    None => out.extend_from_slice(&bytes),
                }
            });
            out
        };
        let introduce = async |beat: &[u8]| {
            let bytes = signed(beat);
            self.socket.send_to(&bytes, to).await.unwrap();
            sent.extend(bytes);
        };
        flight.introduce(introduce).await;
        let send = async |burst: &[u8]| {
            let bytes = signed(burst);
            drop(self.socket.send_to(&bytes, to).await);
            sent.extend(bytes);
        };
        flight.play(0.0, until_s, SPEED, send).await;
        sent
    }
}

/// A key file of mode 0600.
fn key_file(folder: &Path) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let path = folder.join("signing.key");
    std::fs::write(&path, KEY).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    path
}

fn start(folder: &Path, more: &[&str]) -> Holdover {
    let key = format!("signing.key_file={}", key_file(folder).display());
    let state = format!("state.dir={}", folder.display());
    let arguments = ["--endpoint", "udpin:127.0.0.1:0", "--set", &key, "--set", &state];
    Holdover::run(&[&arguments, more].concat())
}

#[tokio::test]
async fn a_signed_flight_is_flown_answered_signed_and_never_heard_twice() {
    let folder = tempfile::tempdir().unwrap();
    let flight = Flight::load(COPTER, 30.0);
    let mut holdover = start(folder.path(), &["--set", "outbound.publish=always"]);
    let autopilot = Autopilot::new().await;
    let sent = autopilot.play(holdover.address(), &flight, 30.0, Some(&gate())).await;
    holdover.wait_for("following", 1);
    autopilot.heard.until("a heartbeat", |h| !h.messages().is_empty()).await;
    assert_eq!(holdover.told("frames refused"), 0, "{}", holdover.log());
    assert!(!holdover.log().contains(&hex(&KEY)[..16]));
    // One that is killed forgets as little as one that ends.
    holdover.kill();
    let heard = autopilot.heard.bytes();
    let told = pymavlink::sign(&["check", &hex(&KEY), "0"], &heard);
    let mut frames = 0;
    autopilot.heard.each(|frame| {
        frames += 1;
        assert!(frame.is_signed());
    });
    assert!(frames > 3);
    assert_eq!(String::from_utf8(told).unwrap().trim(), format!("{frames} 0"));

    for kill in [false, true] {
        let mut again = start(folder.path(), &[]);
        let to = again.address();
        for datagram in datagrams(&sent) {
            autopilot.socket.send_to(&datagram, to).await.unwrap();
        }
        again.wait_for("replayed", 1);
        sleep(Duration::from_millis(200)).await;
        assert_eq!(again.told("following"), 0, "{}", again.log());
        if kill { again.kill() } else { again.stop() }
    }
    // What is new of the same stream is heard all the same.
    let mut again = start(folder.path(), &[]);
    sleep(Duration::from_millis(1500)).await;
    autopilot.play(again.address(), &flight, 5.0, Some(&gate())).await;
    again.wait_for("following", 1);
    again.stop();
    assert!(again.log().contains("verified"), "{}", again.log());
}

/// Whole frames, up to 1400 bytes a datagram.
fn datagrams(bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut out: Vec<Vec<u8>> = vec![Vec::new()];
    each(bytes, |frame| {
        if out.last().unwrap().len() + frame.len() > 1400 {
            out.push(Vec::new());
        }
        out.last_mut().unwrap().extend_from_slice(frame.bytes());
    });
    // A hundred are as good as all.
    out.truncate(100);
    out
}

#[tokio::test]
async fn what_is_unsigned_or_of_another_key_is_neither_believed_nor_answered() {
    let folder = tempfile::tempdir().unwrap();
    let flight = Flight::load(COPTER, 6.0);
    let other = SigningGate::new(Some(SigningKey::new(OTHER_KEY)), &SigningSettings::default());
    for (gate, reason) in [(None, "unsigned"), (Some(&other), "bad signature")] {
        let mut holdover = start(folder.path(), &[]);
        let autopilot = Autopilot::new().await;
        autopilot.play(holdover.address(), &flight, 6.0, gate).await;
        holdover.wait_for(reason, 1);
        holdover.stop();
        assert_eq!(holdover.told("following"), 0, "{}", holdover.log());
        assert_eq!(autopilot.heard.bytes(), Vec::<u8>::new());
        let end = holdover.wait_for("in the end", 1);
        assert!(end.contains(reason), "{end}");
    }
    // It does not take the link from a vehicle that signs, either.
    let mut holdover = start(folder.path(), &[]);
    let (stranger, autopilot) = (Autopilot::new().await, Autopilot::new().await);
    stranger.play(holdover.address(), &flight, 2.0, None).await;
    autopilot.play(holdover.address(), &flight, 3.0, Some(&self::gate())).await;
    holdover.wait_for("following", 1);
    holdover.stop();
    assert_eq!(stranger.heard.bytes(), Vec::<u8>::new());
}

#[tokio::test]
async fn without_a_key_a_signed_flight_is_flown_and_told() {
    let flight = Flight::load(COPTER, 6.0);
    let mut holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0"]);
    let autopilot = Autopilot::new().await;
    autopilot.play(holdover.address(), &flight, 6.0, Some(&gate())).await;
    holdover.wait_for("following", 1);
    holdover.wait_for("signing.key_file is not set", 1);
    holdover.stop();
    assert!(holdover.wait_for("in the end", 1).contains("not verified"));
}

#[test]
fn a_key_that_others_can_read_is_not_used() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = key_file(folder.path());
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
    let key = format!("signing.key_file={}", path.display());
    let mut holdover = Holdover::run(&["--endpoint", "udpin:127.0.0.1:0", "--set", &key]);
    assert_eq!(holdover.exit(Duration::from_secs(10)).code(), Some(2), "{}", holdover.log());
    assert!(holdover.wait_for("chmod 600", 1).contains("0644"));
}

/// `holdover` with these arguments and this on standard input: exit code, standard output, standard error.
fn holdover(arguments: &[&str], input: &[u8]) -> (i32, String, String) {
    use std::io::Write;
    let mut child = Command::new(env!("CARGO_BIN_EXE_holdover"))
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // One that does not read its input has ended before.
    let _ = child.stdin.take().unwrap().write_all(input);
    let output = child.wait_with_output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
}

#[test]
fn keys_are_made_imported_told_apart_and_not_overwritten() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (new, hexed, phrase) = (at("new"), at("hexed"), at("phrase"));
    assert_eq!(holdover(&["key", "new", &new], b"").0, 0);
    assert_eq!(std::fs::metadata(&new).unwrap().permissions().mode() & 0o777, 0o600);
    let before = std::fs::read(&new).unwrap();
    let (code, _, told) = holdover(&["key", "new", &new], b"");
    assert!(code == 2 && told.contains("--force") && told.contains(&new), "{told}");
    assert_eq!(std::fs::read(&new).unwrap(), before);

    let digest = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert!(holdover(&["key", "import", &hexed], format!("{digest}\n").as_bytes()).1.contains("hexadecimal"));
    let (code, told, warned) = holdover(&["key", "import", &phrase], b"abc\r\n");
    assert!(code == 0 && told.contains("passphrase") && warned.contains("guessed"), "{told} {warned}");
    let id = |file: &str| holdover(&["key", "show-id", file], b"").1;
    assert_eq!(id(&hexed), id(&phrase));
    assert_ne!(id(&hexed), id(&new));
    assert!(!id(&hexed).contains(&digest[..8]));
    assert_eq!(std::fs::read_to_string(&phrase).unwrap().trim(), digest);
    for wrong in [&b""[..], b"\n", b"a\nb\n", &[0xff; 40], &[b'x'; 5000]] {
        let (code, _, told) = holdover(&["key", "import", &at("none")], wrong);
        assert!(code == 2 && told.contains("standard input"), "{told}");
    }
}

/// An autopilot that takes the key from the link, and signs from then on.
#[tokio::test]
async fn a_key_is_handed_over_by_command_only_and_proved() {
    let folder = tempfile::tempdir().unwrap();
    let key = key_file(folder.path());
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("udpout:{}", socket.local_addr().unwrap());
    let flight = Flight::load(COPTER, 3.0);
    let command = tokio::task::spawn_blocking(move || {
        holdover(&["key", "setup", "--link", &endpoint, "--key", key.to_str().unwrap()], b"")
    });
    let mut taken = None;
    let mut buffer = vec![0; 2000];
    while !command.is_finished() {
        let Ok(Ok((n, peer))) =
            tokio::time::timeout(Duration::from_millis(100), socket.recv_from(&mut buffer)).await
        else {
            continue;
        };
        let Scan::Frame(frame) = scan(&buffer[..n], true) else { panic!("no frame") };
        if let Ok(MavMessage::SETUP_SIGNING(setup)) = frame.parse() {
            assert_eq!((setup.target_system, setup.target_component), (1, 1));
            taken =
                Some(SigningGate::new(Some(SigningKey::new(setup.secret_key)), &SigningSettings::default()));
        }
        let mut answer = flight.heartbeat().to_vec();
        if let Some(gate) = &taken {
            let bytes = FrameBytes::new(&answer).unwrap();
            answer = gate.sign(bytes, 0, now_us()).unwrap().to_vec();
        }
        socket.send_to(&answer, peer).await.unwrap();
    }
    let (code, told, warned) = command.await.unwrap();
    assert_eq!(code, 0, "{told} {warned}");
    assert!(told.contains("system 1 signs with key") && warned.contains("in clear"), "{told} {warned}");
    assert_eq!(taken.unwrap().key().unwrap().id(), SigningKey::new(KEY).id());
}
