//! Recorded flights of real vehicles. They are other projects' data and stand beside the project, not in it: `HOLDOVER_FLIGHT_LOGS` is
//! the folder that has them.

use std::path::PathBuf;

use crate::command::holdover;

fn flights() -> Vec<PathBuf> {
    let folder = std::env::var_os("HOLDOVER_FLIGHT_LOGS").expect("HOLDOVER_FLIGHT_LOGS is not set");
    let entries = std::fs::read_dir(folder).unwrap();
    let mut found: Vec<PathBuf> = entries
        .flatten()
        .map(|e| e.path())
        .filter(|p| p.extension().is_some_and(|e| e == "tlog" || e == "ulg"))
        .collect();
    found.sort();
    found
}

/// Flights that Holdover can do nothing with, and what it has to say of them.
const LACKING: [(&str, &str); 4] = [
    ("fw_px4_proto_flt09_noimu_530s", "no IMU"),
    // Indoors, without a fix.
    ("mc_px4_v6c_gpsnofix_93s", "no GNSS fix"),
    ("native_mc_corruptlink_2015_1377s", "too slow to integrate"),
    ("native_sub_nogps_v1v2_2024_246s", "too slow to integrate"),
];

#[test]
#[ignore = "needs HOLDOVER_FLIGHT_LOGS"]
fn real_flights_are_read_and_replayed() {
    let flights = flights();
    assert!(!flights.is_empty(), "no flight logs");
    for path in &flights {
        let name = path.file_stem().unwrap().to_str().unwrap();
        let log = path.to_str().unwrap();
        let inspected = holdover(&["inspect", log, "--json"]).json();
        let replayed = holdover(&["replay", log, "--outage", "40..50", "--json"]);
        match LACKING.iter().find(|(n, _)| *n == name) {
            Some((_, why)) => {
                replayed.fails(4, &[name, why]);
                assert!(inspected["lacks"].as_str().unwrap().contains(why));
            }
            None => {
                let report = replayed.json();
                assert_eq!(inspected["lacks"].as_str(), None, "{name}: {inspected}");
                assert_eq!(report["frames"], inspected["frames"], "{name}");
                assert_eq!(report["bad_crc"], 0, "{name}");
                let aided = &report["aided"]["position_rmse_m"];
                assert!(aided.is_null() || aided.as_f64().unwrap() < 100.0, "{name}: {aided}");
            }
        }
        if name.starts_with("rtk_phantom4") {
            // Neither magnetometer nor flow: motion has to show the heading, and a short straight flight does not.
            assert!(inspected["can"][0].as_str().unwrap().contains("needs motion"), "{inspected}");
            let report = holdover(&["replay", log, "--json"]).json();
            let turning = name.contains("path11");
            assert_eq!(report["modes"][0]["mode"] == "Aided", turning, "{}", report["modes"]);
        }
        if name == "native_mc_corruptlink_2015_1377s" {
            let bad = inspected["bad_crc"].as_u64().unwrap();
            assert!((1300..1500).contains(&bad), "{bad} bad checksums");
            assert!(inspected["skipped_bytes"].as_u64().unwrap() > 0);
        }
    }
}
