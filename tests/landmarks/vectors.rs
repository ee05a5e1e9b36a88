//! The landmarks' filters against independently computed files: every field of every event to its tolerance.

use std::path::{Path, PathBuf};

use crate::golden;
use serde_json::{Value, json};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/landmarks")
}

fn file(name: &str) -> Value {
    golden::read(&folder().join(format!("{name}.json"))).unwrap()
}

fn is_ok(file: &Value) -> bool {
    golden::run_value(file, &folder()).unwrap().is_ok()
}

const PAPER: &str = "g1_paper24_imu_cam";
const CAMERA: &str = "g2_cam12_delay";
const PRIMITIVES: &str = "g3_primitives";
const DRONE: &str = "g4_dframe_ooo_gate";

#[test]
fn every_file_is_reproduced() {
    for (name, least) in [(PAPER, 8000), (CAMERA, 4000), (PRIMITIVES, 4000), (DRONE, 10_000)] {
        let outcome = golden::run_value(&file(name), &folder()).unwrap();
        println!("{name}: {outcome}");
        assert!(outcome.is_ok() && outcome.compared() > least, "{name}: {outcome}");
    }
}

/// Adds to a number of a file.
fn disturb(file: &mut Value, pointer: &str, by: f64) {
    let number = file.pointer_mut(pointer).unwrap_or_else(|| panic!("no {pointer}"));
    let value = number.as_f64().unwrap();
    *number = json!(value + by * value.abs().max(1.0));
}

#[test]
fn a_file_that_is_wrong_anywhere_is_found_out() {
    for (name, pointer) in [
        (PAPER, "/events/9/x/17"),
        (PAPER, "/events/25/P_ut/40"),
        (CAMERA, "/events/30/x/3"),
        (CAMERA, "/events/12/P_ut/77"),
        (PRIMITIVES, "/propagate/2/P_next_ut/5"),
        (PRIMITIVES, "/propagate/3/Phi/1/2"),
        (PRIMITIVES, "/update/4/I_u/1"),
        (PRIMITIVES, "/update/1/H/2/4"),
        (PRIMITIVES, "/update/1/W/2/4"),
        (PRIMITIVES, "/update/2/zeta/7"),
        (PRIMITIVES, "/update/5/x_plus/11"),
        (PRIMITIVES, "/update/5/P_plus_ut/0"),
        (PRIMITIVES, "/projSO3/5/R/0/0"),
        (DRONE, "/events/40/x/2"),
        (DRONE, "/events/98/Y_ut/30"),
        (DRONE, "/events/50/nis"),
        (DRONE, "/events/52/P_V/1"),
        (DRONE, "/events/52/R_V_B/1/1"),
    ] {
        let mut file = file(name);
        disturb(&mut file, pointer, 1e-8);
        assert!(!is_ok(&file), "{name} {pointer}");
        // A looser tolerance in the file lets it pass.
        file["tol"] = json!("1e-7");
        assert!(is_ok(&file), "{name} {pointer}");
    }
    let mut file = file(DRONE);
    let verdict = file.pointer_mut("/events/20/accepted").unwrap();
    *verdict = json!(!verdict.as_bool().unwrap());
    assert!(!is_ok(&file));
}

/// A parameter that is read but not used would let a file with another value pass.
#[test]
fn every_parameter_has_an_effect() {
    for (name, pointer) in [
        (PAPER, "/gamma"),
        (PAPER, "/lam"),
        (PAPER, "/landmarks_V/2/1"),
        (PAPER, "/CPB/0"),
        (PAPER, "/events/3/u_from_now/0"),
        (PAPER, "/events/3/p/1"),
        (PAPER, "/events/3/R_rowmajor/1/1"),
        (CAMERA, "/events/10/u_from_now/5"),
        (CAMERA, "/events/6/tau"),
        (CAMERA, "/events/6/y/0/1"),
        (CAMERA, "/x0/4"),
        (PRIMITIVES, "/propagate/1/h"),
        (PRIMITIVES, "/update/3/tau"),
        (PRIMITIVES, "/update/3/inputs_each_0p05s/5/2"),
        (DRONE, "/params/lam"),
        (DRONE, "/params/sb"),
        (DRONE, "/params/sg"),
        (DRONE, "/pos_s"),
        (DRONE, "/rot_s"),
        (DRONE, "/lever/1"),
        (DRONE, "/inputs_vw/30/4"),
    ] {
        let mut file = file(name);
        disturb(&mut file, pointer, 1e-4);
        assert!(!is_ok(&file), "{name} with another {pointer}");
    }
    // These act only where they are reached.
    for (name, value) in [("gate", 1e9), ("rmin", 4.0), ("rmax", 3.0)] {
        let mut file = file(DRONE);
        file["params"][name] = json!(value);
        assert!(!is_ok(&file), "{name}");
    }
    let mut shuffled = file(DRONE);
    shuffled["events"][30]["k_sample"] = json!(21);
    assert!(!is_ok(&shuffled));
}

#[test]
fn a_file_that_cannot_be_run_says_why() {
    for (name, pointer, value, word) in [
        (PAPER, "/g_diag", json!([1, 2]), "g_diag"),
        (PAPER, "/landmarks_V", json!([]), "landmarks"),
        (PAPER, "/x0", json!([1]), "no such filter"),
        (PAPER, "/gamma", json!(0), "no such filter"),
        (CAMERA, "/events/6/tau", json!(5.0), "TooOld"),
        (CAMERA, "/events/6/tau", json!(-5.0), "FromTheFuture"),
        (PRIMITIVES, "/projSO3/0/M", json!([[0, 0, 0], [0, 0, 0], [0, 0, 0]]), "rotation"),
        (DRONE, "/events/9/id", json!(77), "landmark"),
        (DRONE, "/events/9/k_sample", json!(90), "Future"),
    ] {
        let mut file = file(name);
        *file.pointer_mut(pointer).unwrap() = value;
        let why = golden::run_value(&file, &folder()).map(|o| o.to_string()).unwrap_err();
        assert!(why.contains(word), "{name} {pointer}: {why}");
    }
}
