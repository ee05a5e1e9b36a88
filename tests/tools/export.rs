//! What `export` writes, read back by the libraries of those who will.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::Field;
use serde_json::Value;
use tempfile::tempdir;

use crate::command::{PX4, bytes_of, holdover, records, sitl_log, write_log};

fn run(arguments: &[&str]) {
    let ran = holdover(arguments);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), ""), "{ran:?}");
}

/// Messages by topic: the schema's name, the time, s, and the value.
fn messages(path: &Path) -> BTreeMap<String, (String, Vec<(f64, Value)>)> {
    let bytes = fs::read(path).unwrap();
    let mut out: BTreeMap<String, (String, Vec<(f64, Value)>)> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!(
            (schema.encoding.as_str(), message.channel.message_encoding.as_str()),
            ("jsonschema", "json")
        );
        let description: Value = serde_json::from_slice(&schema.data).unwrap();
        let value: Value = serde_json::from_slice(&message.data).unwrap();
        for name in value.as_object().unwrap().keys() {
            assert!(description["properties"][name].is_object(), "{}: {name} is not described", schema.name);
        }
        let of =
            out.entry(message.channel.topic.clone()).or_insert_with(|| (schema.name.clone(), Vec::new()));
        of.1.push((message.log_time as f64 * 1e-9, value));
    }
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let counted: usize = out.values().map(|of| of.1.len()).sum();
    assert_eq!(summary.stats.unwrap().message_count, counted as u64);
    assert!(!summary.chunk_indexes.is_empty(), "it can be searched");
    out
}

#[test]
fn mcap_is_read_by_its_own_library_and_says_what_replay_says() {
    let folder = tempdir().unwrap();
    let file = folder.path().join("flight.mcap");
    let log = sitl_log(PX4);
    let log = log.to_str().unwrap();
    run(&["export", log, "--mcap", file.to_str().unwrap(), "--outage", "100..160"]);
    let replayed = holdover(&["replay", log, "--outage", "100..160", "--json"]).json();
    let all = messages(&file);
    let of = |topic: &str| &all.get(topic).unwrap_or_else(|| panic!("{topic} among {:?}", all.keys())).1;
    let schemas = [
        ("/solution/pose", "foxglove.PoseInFrame"),
        ("/solution/location", "foxglove.LocationFix"),
        ("/gnss/0/location", "foxglove.LocationFix"),
        ("/truth/location", "foxglove.LocationFix"),
        ("/events", "foxglove.Log"),
        ("/solution", "holdover.Solution"),
        ("/sources/GNSS_0", "holdover.Source"),
    ];
    for (topic, schema) in schemas {
        assert_eq!(all[topic].0, schema);
        assert!(of(topic).is_sorted_by(|a, b| a.0 <= b.0 + 1.0), "{topic}");
    }
    let events: Vec<&str> = of("/events").iter().map(|(_, v)| v["name"].as_str().unwrap()).collect();
    let told: Vec<&str> =
        replayed["events"].as_array().unwrap().iter().map(|e| e["code"].as_str().unwrap()).collect();
    assert_eq!(events, told);
    // A pose is east, north, up; the series north, east, down.
    let series: BTreeMap<u64, &Value> =
        of("/solution").iter().map(|(t, v)| ((t * 1e3).round() as u64, v)).collect();
    for (t, pose) in of("/solution/pose") {
        let row = series[&((t * 1e3).round() as u64)];
        let place = &pose["pose"]["position"];
        for (theirs, ours, sign) in [("x", "east_m", 1.0), ("y", "north_m", 1.0), ("z", "down_m", -1.0)] {
            let apart = place[theirs].as_f64().unwrap() - sign * row[ours].as_f64().unwrap();
            assert!(apart.abs() < 1e-9, "{place} {row}");
        }
        let q = &pose["pose"]["orientation"];
        let [x, y, z, w] = ["x", "y", "z", "w"].map(|c| q[c].as_f64().unwrap());
        // Where the nose points, from east towards north.
        let yaw_enu = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z)).to_degrees();
        let apart = (90.0 - yaw_enu - row["yaw_deg"].as_f64().unwrap()).rem_euclid(360.0);
        assert!(!(0.01..=359.99).contains(&apart), "{row} {yaw_enu}");
    }
    // With GNSS the estimate and the receiver are in one place.
    let (t, fix) = &of("/gnss/0/location")[300];
    let (_, at) = of("/solution/location").iter().find(|(s, _)| s >= t).unwrap();
    for key in ["latitude", "longitude"] {
        assert!((fix[key].as_f64().unwrap() - at[key].as_f64().unwrap()).abs() < 5e-5, "{fix} {at}");
    }
    let last = &of("/sources/GNSS_0").last().unwrap().1;
    let source = replayed["sources"].as_array().unwrap().iter().find(|s| s["kind"] == "gnss").unwrap();
    assert!(last["fused"].as_f64().unwrap() > 0.95 * source["fused"].as_f64().unwrap(), "{last} {source}");
}

/// The rows of a table in Parquet, as text like the CSV's.
fn parquet_rows(path: &Path) -> (Vec<String>, Vec<Vec<String>>) {
    let reader = SerializedFileReader::new(fs::File::open(path).unwrap()).unwrap();
    let names =
        reader.metadata().file_metadata().schema_descr().columns().iter().map(|c| c.name().to_owned());
    let names = names.collect();
    let rows = reader.get_row_iter(None).unwrap().map(|row| {
        let cells = row.unwrap().into_columns().into_iter().map(|(_, field)| match field {
            Field::Null => String::new(),
            Field::Double(v) => format!("{v:.6}"),
            Field::Long(v) => v.to_string(),
            Field::Str(v) => v,
            other => panic!("{other:?}"),
        });
        cells.collect()
    });
    (names, rows.collect())
}

#[test]
fn csv_and_parquet_hold_the_same_rows() {
    let folder = tempdir().unwrap();
    let log = write_log(folder.path(), "a.tlog", &bytes_of(&records(PX4, 0.0, 60.0)));
    let (log, out) = (log.to_str().unwrap(), folder.path().join("tables"));
    run(&["export", log, "--csv", out.to_str().unwrap()]);
    run(&["export", log, "--parquet", out.to_str().unwrap()]);
    for (table, most, column, value) in
        [("solution", 1300, "mode", "Aided"), ("sources", 700, "source", "GNSS")]
    {
        let mut csv = csv::Reader::from_path(out.join(table).with_extension("csv")).unwrap();
        let names: Vec<String> = csv.headers().unwrap().iter().map(str::to_owned).collect();
        let rows: Vec<Vec<String>> =
            csv.records().map(|r| r.unwrap().iter().map(str::to_owned).collect()).collect();
        assert!(rows.len() > 200 && rows.len() < most, "{table}: {}", rows.len());
        let at = names.iter().position(|n| n == column).unwrap();
        assert!(rows.iter().any(|r| r[at] == value), "{table}");
        assert_eq!((names, rows), parquet_rows(&out.join(table).with_extension("parquet")));
    }
}

#[test]
fn nothing_is_overwritten_and_nothing_is_half() {
    let folder = tempdir().unwrap();
    let log = write_log(folder.path(), "a.tlog", &bytes_of(&records(PX4, 0.0, 20.0)));
    let (log, file) = (log.to_str().unwrap(), folder.path().join("a.mcap"));
    let file = file.to_str().unwrap();
    holdover(&["export", log]).fails(2, &["--mcap", "--csv", "--parquet"]);
    fs::write(file, "mine").unwrap();
    holdover(&["export", log, "--mcap", file]).fails(2, &["a.mcap", "--force"]);
    assert_eq!(fs::read_to_string(file).unwrap(), "mine");
    run(&["export", log, "--mcap", file, "--force"]);
    assert!(fs::read(file).unwrap().starts_with(b"\x89MCAP0\r\n"));
    // Without an IMU there is no flight to write.
    let deaf: Vec<_> =
        records(PX4, 0.0, 20.0).into_iter().filter(|r| ![26, 27, 105, 116, 129].contains(&r.id())).collect();
    let deaf = write_log(folder.path(), "deaf.tlog", &bytes_of(&deaf));
    let other = folder.path().join("deaf.mcap");
    holdover(&["export", deaf.to_str().unwrap(), "--mcap", other.to_str().unwrap()]).fails(4, &["IMU"]);
    assert!(!other.exists());
}
