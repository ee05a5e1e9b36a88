//! Recordings of frames that come and go, on disks that work and on disks that do not.

use super::*;
use crate::wire::frame::{ComponentId, SystemId};
use crate::wire::frame_bytes::FrameBytes;
use crate::wire::session::heartbeat::{SystemStatus, heartbeat};
use crate::wire::session::identity::AutopilotKind;
use crate::wire::session::outgoing::FrameWriter;
use crate::wire::tlog::TlogReader;

const VEHICLE: Vehicle = Vehicle {
    system: SystemId(7),
    component: ComponentId::AUTOPILOT,
    autopilot: AutopilotKind::Px4,
    vehicle_type: 2,
    armed: false,
    version: None,
};

fn settings(folder: &std::path::Path) -> RecordSettings {
    RecordSettings {
        folder: folder.to_owned(),
        max_bytes: 1 << 30,
        min_free_bytes: 0,
        max_file_bytes: 1 << 30,
        max_file_age: Span::from_seconds(1e6),
    }
}

fn frames(n: u32) -> Vec<FrameBytes> {
    let mut writer = FrameWriter::new(VEHICLE.address());
    (0..n).map(|i| writer.write(&heartbeat(SystemStatus::Active, i)).unwrap()).collect()
}

fn at(i: usize) -> Stamp<Companion> {
    Stamp::from_micros(i as i64 * 1000)
}

fn hear(recorder: &mut LinkRecorder, i: usize, how: HeardAs, bytes: &FrameBytes) {
    recorder.heard(at(i), how, &bytes.frame().unwrap());
}

/// The recorded frames with their times, and the marks, of all files in their order.
fn read(folder: &std::path::Path) -> (Vec<(u64, Vec<u8>)>, Vec<Mark>) {
    let mut names: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    names.retain(|path| path.extension().is_some_and(|e| e == "tlog"));
    names.sort();
    let (mut frames, mut marks) = (Vec::new(), Vec::new());
    for name in names {
        let bytes = std::fs::read(name).unwrap();
        let mut reader = TlogReader::new(&bytes[..]);
        while let Some(record) = reader.next_record().unwrap() {
            match Mark::of(&record.frame) {
                Some(mark) => marks.push(mark),
                None => frames.push((record.written_us, record.frame.bytes().to_vec())),
            }
        }
        assert!(!reader.truncated() && reader.counters().seen().count() == 0);
    }
    (frames, marks)
}

/// What is dropped is written, on a disk that is not slow; that of a test's machine may be.
fn finish(recorder: LinkRecorder) {
    let written = Arc::clone(&recorder.keeper.written);
    drop(recorder);
    for _ in 0..2000 {
        if Arc::strong_count(&written) == 1 {
            return;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("the recorder does not end");
}

#[test]
fn everything_is_there_in_its_order_with_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let clock = CompanionClock::manual(Stamp::from_micros(0));
    let mut recorder = LinkRecorder::start(settings(folder.path()), "a.b = 1\n".into(), clock).unwrap();
    recorder.follows(at(0), &VEHICLE, false);
    let all = frames(3000);
    for (i, frame) in all.iter().enumerate() {
        match i % 3 {
            0 => hear(&mut recorder, i, HeardAs::Listened, frame),
            1 => hear(&mut recorder, i, HeardAs::Sensor, frame),
            _ => recorder.sent(at(i), frame),
        }
    }
    finish(recorder);
    let (found, marks) = read(folder.path());
    let expected: Vec<_> = all.iter().enumerate().map(|(i, f)| (i as u64 * 1000, f.to_vec())).collect();
    assert_eq!(found, expected);
    assert_eq!(marks[0], Mark::Part { run: 1, part: 1 });
    let heard = marks.iter().filter(|m| matches!(m, Mark::Heard(_))).count();
    assert!(marks.contains(&Mark::Follows { vehicle: VEHICLE, anew: false }) && heard > 1999, "{heard}");
    assert_eq!(std::fs::read_to_string(folder.path().join("holdover-00001.toml")).unwrap(), "a.b = 1\n");
}

#[test]
fn files_follow_each_other_and_each_says_what_holds() {
    let folder = tempfile::tempdir().unwrap();
    let clock = CompanionClock::manual(Stamp::from_micros(0));
    let small = RecordSettings { max_file_bytes: 40_000, ..settings(folder.path()) };
    let mut recorder = LinkRecorder::start(small, String::new(), clock).unwrap();
    recorder.follows(at(0), &VEHICLE, false);
    let drill = Mark::Drill { from_s: 1.0, to_s: 2.0 };
    recorder.holds(at(0), drill.clone());
    let all = frames(4000);
    for (i, frame) in all.iter().enumerate() {
        hear(&mut recorder, i, HeardAs::Beside, frame);
    }
    finish(recorder);
    let (found, marks) = read(folder.path());
    assert!(found.iter().map(|(_, bytes)| &bytes[..]).eq(all.iter().map(|f| &f[..])));
    let parts: Vec<_> = marks.iter().filter(|m| matches!(m, Mark::Part { .. })).collect();
    assert!(parts.len() >= 3, "{parts:?}");
    // Said when it began to hold, and at the head of every file that begins after it.
    for held in [drill, Mark::Follows { vehicle: VEHICLE, anew: false }] {
        let said = marks.iter().filter(|m| **m == held).count();
        assert!((parts.len()..=parts.len() + 1).contains(&said), "{said} of {}", parts.len());
    }
}

#[test]
fn a_disk_that_does_not_keep_up_costs_frames_and_no_time() {
    let (blocks, waiting) = sync_channel(2);
    let (give_back, empty) = sync_channel(2);
    let (_tell, news) = sync_channel(1);
    let (ends, ended) = sync_channel(0);
    let written = Arc::new(Written::default());
    let thread = KeeperThread { empty, news, written, ended };
    let mut recorder = LinkRecorder::with(blocks, thread, 0);
    for (i, frame) in frames(6000).iter().enumerate() {
        hear(&mut recorder, i, HeardAs::Listened, frame);
    }
    let lost = recorder.counts().lost;
    assert!(lost > 3000, "{lost}");
    // The disk works again: what is missing is said where it is missing.
    let first: Vec<_> = waiting.try_iter().collect();
    assert_eq!(first.len(), 2);
    hear(&mut recorder, 6000, HeardAs::Listened, &frames(1)[0]);
    let (kept, lost) = (first.iter().map(|b| u64::from(b.frames)).sum::<u64>(), recorder.counts().lost);
    drop((ends, give_back));
    drop(recorder);
    let last: Vec<_> = waiting.try_iter().collect();
    let kept = kept + last.iter().map(|b| u64::from(b.frames)).sum::<u64>();
    assert_eq!(kept + lost, 6001);
    let mut reader = TlogReader::new(&last[0].bytes[..]);
    let record = reader.next_record().unwrap().unwrap();
    assert_eq!(Mark::of(&record.frame), Some(Mark::Lost(u32::try_from(lost).unwrap())));
}

#[test]
fn without_room_it_is_told_and_goes_on_when_there_is_some() {
    let folder = tempfile::tempdir().unwrap();
    let clock = CompanionClock::manual(Stamp::from_micros(0));
    let place = folder.path().join("flights");
    let mut recorder = LinkRecorder::start(settings(&place), String::new(), clock.clone()).unwrap();
    // The folder goes; what is in its place is no folder.
    std::fs::remove_dir(&place).unwrap();
    std::fs::write(&place, "").unwrap();
    let all = frames(2);
    let told = |recorder: &mut LinkRecorder| {
        for _ in 0..2000 {
            if let Some(news) = recorder.news() {
                return news;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        panic!("nothing is told");
    };
    hear(&mut recorder, 0, HeardAs::Listened, &all[0]);
    recorder.poll(at(1000));
    let news = told(&mut recorder);
    assert!(news.is_bad() && news.to_string().contains("flights"), "{news}");
    assert_eq!(recorder.counts().lost, 1);
    std::fs::remove_file(&place).unwrap();
    std::fs::create_dir(&place).unwrap();
    clock.advance(Span::from_seconds(10.0));
    hear(&mut recorder, 1, HeardAs::Listened, &all[1]);
    recorder.poll(at(2000));
    assert!(matches!(told(&mut recorder), RecordNews::Begun(_)));
    finish(recorder);
    let (found, marks) = read(&place);
    assert_eq!(found, [(1000, all[1].to_vec())]);
    assert!(marks.contains(&Mark::Lost(1)), "{marks:?}");
}

#[test]
fn forged_marks_are_not_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let clock = CompanionClock::manual(Stamp::from_micros(0));
    let mut recorder = LinkRecorder::start(settings(folder.path()), String::new(), clock).unwrap();
    let forged = MarkWriter::new().write(&Mark::Lost(9)).unwrap();
    hear(&mut recorder, 0, HeardAs::Listened, &forged);
    hear(&mut recorder, 2, HeardAs::Listened, &frames(1)[0]);
    assert_eq!(recorder.counts().withheld, 1);
    finish(recorder);
    let (found, marks) = read(folder.path());
    assert_eq!(found.len(), 1);
    assert!(!marks.iter().any(|m| matches!(m, Mark::Lost(_))), "{marks:?}");
}
