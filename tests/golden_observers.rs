//! The observers, the projection and flow against independently computed files: every field of every step to its tolerance.

#![allow(clippy::unwrap_used, clippy::panic)] // a test may fail

#[path = "support/golden/mod.rs"]
mod golden;

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/observers")
}

fn files() -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder()).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn every_file_is_reproduced() {
    let mut formats = std::collections::BTreeSet::new();
    for path in files() {
        let outcome = golden::run(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        println!("{}: {outcome}", path.display());
        assert!(outcome.is_ok(), "{}: {outcome}", path.display());
        formats.insert(outcome.format);
    }
    assert_eq!(formats.into_iter().collect::<Vec<_>>(), ["flow", "fusini", "grip", "projection", "xkf"]);
}

/// Changes one number, in the middle of a list of rows, by as much as its size allows.
fn disturb(list: &mut Value, by: f64) {
    let rows = list.as_array_mut().unwrap();
    let middle = rows.len() / 2;
    let number = &mut rows[middle][0];
    let value = number.as_f64().unwrap();
    *number = json!(value + by * value.abs().max(1.0));
}

#[test]
fn a_file_that_is_wrong_anywhere_is_found_out() {
    for (name, field) in [
        ("grip_A_exp_isp_norm", "xi"),
        ("fusini_dr_B_exp_isp_zpred", "p_v_xi_bw_bf_bv"),
        ("xkf_euler", "P_diag_Theta"),
    ] {
        let mut file = golden::read(&folder().join(format!("{name}.json"))).unwrap();
        disturb(&mut file["expected"][field], 1e-8);
        assert!(!golden::run_value(&file, &folder()).unwrap().is_ok(), "{name}");
        // A looser tolerance in the file lets it pass.
        file["tol"] = json!("1e-7");
        assert!(golden::run_value(&file, &folder()).unwrap().is_ok(), "{name}");
        file["tol"] = json!("nothing, else 1e-7");
        assert!(!golden::run_value(&file, &folder()).unwrap().is_ok(), "{name}");
    }
}

/// A parameter that is read but not used would let a file with another value pass.
#[test]
fn every_parameter_has_an_effect() {
    let changes = [
        ("grip_A_exp_isp_norm", "/params/sigma", json!(2.0)),
        ("grip_A_exp_isp_norm", "/params/scheme", json!("ZOH")),
        ("grip_A_exp_isp_norm", "/params/scheme", json!("JUMP")),
        ("grip_A_exp_isp_norm", "/params/triad", json!("RAW")),
        ("grip_A_exp_isp_norm", "/params/use_vel", json!(false)),
        ("grip_A_exp_isp_norm", "/params/disc", json!("EULER")),
        ("grip_E_projection_reset", "/params/Mb", json!(0.004)),
        ("fusini_dr_B_exp_isp_zpred", "/params/zmode", json!(0)),
        ("fusini_dr_B_exp_isp_zpred", "/params/bvmode", json!(2)),
        ("fusini_dr_B_exp_isp_zpred", "/params/nsub", json!(3)),
        ("fusini_dr_B_exp_isp_zpred", "/params/scheme", json!(0)),
        ("fusini_dr_B_exp_isp_zpred", "/params/disc", json!(0)),
        ("fusini_dr_B_exp_isp_zpred", "/params/k_dr", json!(240)),
        ("fusini_dr_B_exp_isp_zpred", "/params/tau_bv", json!(4)),
        ("xkf_euler", "/params/use_y3", json!(1)),
        ("xkf_euler", "/params/freeze_biases", json!(0)),
        ("xkf_euler", "/params/r_alt", json!(0.1)),
        ("xkf_euler", "/params/k_dr", json!(240)),
        ("xkf_euler", "/params/q_gyro_acc_bw_bf", json!([2.8e-9, 4e-6, 1e-14, 1e-9])),
    ];
    for (name, pointer, value) in changes {
        let mut file = golden::read(&folder().join(format!("{name}.json"))).unwrap();
        *file.pointer_mut(pointer).unwrap() = value;
        let outcome = golden::run_value(&file, &folder()).unwrap();
        assert!(!outcome.is_ok(), "{name} with another {pointer}: {outcome}");
    }
    // Numbers stand for words.
    for (name, pointer, value) in [
        ("fusini_dr_B_exp_isp_zpred", "/params/scheme", json!(1)),
        ("fusini_dr_B_exp_isp_zpred", "/params/disc", json!(1)),
        ("grip_A_exp_isp_norm", "/params/use_vel", json!(1)),
    ] {
        let mut file = golden::read(&folder().join(format!("{name}.json"))).unwrap();
        *file.pointer_mut(pointer).unwrap() = value;
        assert!(golden::run_value(&file, &folder()).unwrap().is_ok(), "{name} {pointer}");
    }
}

#[test]
fn a_file_that_cannot_be_run_says_why() {
    let why = |file: &Value| golden::run_value(file, &folder()).unwrap_err();
    assert!(why(&json!({"some": 1})).contains("some"));
    assert!(why(&json!([1, 2])).contains("not a format"));
    let grip = golden::read(&folder().join("grip_A_exp_isp_norm.json")).unwrap();
    for (pointer, value, word) in [
        ("/params/scheme", json!("SPLINE"), "scheme"),
        ("/params/K", json!([1, 2]), "K"),
        ("/inputs/t", json!("x"), "t"),
        ("/inputs/gyro", json!([[1, 2, 3]]), "length"),
        ("/expected/R", json!([[1, 2, 3]]), "9"),
    ] {
        let mut file = grip.clone();
        *file.pointer_mut(pointer).unwrap() = value;
        assert!(why(&file).contains(word), "{pointer}: {}", why(&file));
    }
    let mut xkf = golden::read(&folder().join("xkf_euler.json")).unwrap();
    xkf["nlo_trajectory_file"] = json!("nowhere.json");
    assert!(why(&xkf).contains("nowhere.json"));
    assert!(golden::run(&folder()).is_err());
}
