//! Observers, projection, flow and altimeters against independently computed files: every field of every step to its tolerance.

use std::path::{Path, PathBuf};

use crate::golden;
use serde_json::{Value, json};

fn golden_folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

fn folder() -> PathBuf {
    golden_folder("observers")
}

fn altimeter(name: &str) -> Value {
    golden::read(&golden_folder("altimeter").join(format!("{name}.json"))).unwrap()
}

fn files() -> Vec<PathBuf> {
    let of = |name| std::fs::read_dir(golden_folder(name)).unwrap().map(|e| e.unwrap().path());
    let mut files: Vec<PathBuf> = of("observers").chain(of("altimeter")).collect();
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
    let all = ["altimeter", "altimeter parameters", "flow", "fusini", "grip", "projection", "xkf"];
    assert_eq!(formats.into_iter().collect::<Vec<_>>(), all);
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

#[test]
fn an_altimeter_file_that_is_wrong_anywhere_is_found_out() {
    let broken = |name: &str, pointer: &str, by: f64| {
        let mut file = altimeter(name);
        let number = file.pointer_mut(pointer).unwrap();
        let value = number.as_f64().unwrap();
        *number = json!(value + by * value.abs().max(1.0));
        !golden::run_value(&file, &folder()).unwrap().is_ok()
    };
    for pointer in [
        "/ibi/x/399/4",
        "/ibi/P_diag/10/1",
        "/ibi/P_full/199/2/0",
        "/ibi/prob/250",
        "/ibi/nu/401",
        "/ibi/S/3",
        "/iig/x/0/0",
        "/iig/P_diag/599/3",
        "/iig/P_full/0/3/3",
        "/iig/prob/599",
        "/iig/nu/0",
        "/iig/S/599",
        "/ibig/x/300",
        "/ibig/var/300",
    ] {
        assert!(broken("s3_rkf", pointer, 1e-8), "{pointer}");
        assert!(!broken("s3_rkf", pointer, 1e-10), "{pointer}");
    }
    for pointer in [
        "/p0/3",
        "/ibi/F/1/0",
        "/ibi/GQG/4/4",
        "/ibi/P0/0/0",
        "/ibi/R",
        "/iig/F/3/3",
        "/iig/R",
        "/ibi_ub_literal/GQG/4/4",
        "/prob_table/20/prob",
        "/fuse/1/x",
        "/fuse/2/v",
    ] {
        assert!(broken("params", pointer, 1e-8), "{pointer}");
    }
    // What goes in: a measurement, a parameter, the filter.
    assert!(broken("s0_okf", "/z_ibi/300", 1e-7) && broken("s0_okf", "/z_iig/300", 1e-7));
    for key in ["Td", "R0", "H", "g", "beta", "beta_g", "alpha", "s_B", "s_INS", "s_GPS", "p0_h", "p0_w"] {
        // Their sum divides 2 g Td, which is 10⁻⁶ after that.
        let by = if matches!(key, "R0" | "H") { 100.0 } else { 1e-3 };
        assert!(broken("params", &format!("/params/{key}"), by), "{key}");
    }
    // The driving noise is seen in what it leads to: its square is below any tolerance.
    assert!(broken("params", "/params/s_az", 1e-5) && broken("params", "/params/s_g", 1e-5));
    let changed = |name: &str, key: &str, value: Value| {
        let mut file = altimeter(name);
        file[key] = value;
        !golden::run_value(&file, &folder()).unwrap().is_ok()
    };
    assert!(changed("s3_rkf", "mode", json!("okf")));
    assert!(changed("s3_rkf", "variant", json!("joseph")));
    assert!(changed("variant_joseph_s3", "tol", json!(1e-16)));
}

/// A parameter that is read but not used would let a file with another value pass.
#[test]
fn every_parameter_has_an_effect() {
    let changes = [
        ("grip_A_exp_isp_norm", "/params/sigma", json!(2.0)),
        ("grip_A_exp_isp_norm", "/params/scheme", json!("ZOH")),
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
        ("xkf_euler_y3", "/params/use_y3", json!(0)),
        ("xkf_euler_y3", "/params/use_y3", json!(2)),
        ("xkf_euler_y3", "/params/use_y3", json!(3)),
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
        ("/params/triad", json!("RAW"), "triad"),
        ("/params/K", json!([1, 2]), "K"),
        ("/inputs/t", json!("x"), "t"),
        ("/inputs/gyro", json!([[1, 2, 3]]), "length"),
        ("/expected/R", json!([[1, 2, 3]]), "9"),
    ] {
        let mut file = grip.clone();
        *file.pointer_mut(pointer).unwrap() = value;
        assert!(why(&file).contains(word), "{pointer}: {}", why(&file));
    }
    let rkf = altimeter("s3_rkf");
    for (pointer, value, word) in [
        ("/mode", json!("ukf"), "mode"),
        ("/N", json!(599), "length"),
        ("/ibi/x", json!([[1, 2, 3, 4]]), "5"),
        ("/iig/prob", json!([1]), "iig"),
        ("/z_ibi/4", json!(1e300), "step 4"),
        ("/ibi/P_full", json!(1), "P_full"),
    ] {
        let mut file = rkf.clone();
        *file.pointer_mut(pointer).unwrap() = value;
        assert!(why(&file).contains(word), "{pointer}: {}", why(&file));
    }
    let mut xkf = golden::read(&folder().join("xkf_euler.json")).unwrap();
    xkf["nlo_trajectory_file"] = json!("nowhere.json");
    assert!(why(&xkf).contains("nowhere.json"));
    assert!(golden::run(&folder()).is_err());
}
