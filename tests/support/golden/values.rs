//! Numbers out of a golden file, with errors that say which key is at fault.

use nalgebra::{Matrix3, Vector3};
use serde_json::Value;

/// What is wrong with a file.
pub type Result<T> = std::result::Result<T, String>;

/// The value of a key.
pub fn at<'a>(v: &'a Value, key: &str) -> Result<&'a Value> {
    v.get(key).ok_or_else(|| format!("no \"{key}\""))
}

/// The elements of a list.
pub fn list<'a>(v: &'a Value, key: &str) -> Result<&'a [Value]> {
    at(v, key)?.as_array().map(Vec::as_slice).ok_or_else(|| format!("\"{key}\" is no list"))
}

fn flatten(v: &Value, out: &mut Vec<f64>) -> Option<()> {
    match v {
        Value::Array(a) => a.iter().try_for_each(|v| flatten(v, out)),
        Value::Bool(b) => {
            out.push(f64::from(*b));
            Some(())
        }
        other => {
            out.push(other.as_f64()?);
            Some(())
        }
    }
}

/// All numbers under a key, row by row.
pub fn numbers(v: &Value, key: &str) -> Result<Vec<f64>> {
    let mut out = Vec::new();
    flatten(at(v, key)?, &mut out).ok_or_else(|| format!("\"{key}\" holds something that is no number"))?;
    Ok(out)
}

fn exactly<const N: usize>(v: &Value, key: &str) -> Result<[f64; N]> {
    numbers(v, key)?
        .try_into()
        .map_err(|got: Vec<f64>| format!("\"{key}\" has {} numbers, not {N}", got.len()))
}

/// One number; `true` is 1.
pub fn number(v: &Value, key: &str) -> Result<f64> {
    Ok(exactly::<1>(v, key)?[0])
}

/// Several numbers.
pub fn array<const N: usize>(v: &Value, key: &str) -> Result<[f64; N]> {
    exactly(v, key)
}

/// Three numbers.
pub fn vector(v: &Value, key: &str) -> Result<Vector3<f64>> {
    Ok(Vector3::from(exactly::<3>(v, key)?))
}

/// Three numbers, or zeros where the key is absent.
pub fn vector_or_zero(v: &Value, key: &str) -> Result<Vector3<f64>> {
    if v.get(key).is_some() { vector(v, key) } else { Ok(Vector3::zeros()) }
}

/// Nine numbers, row by row.
pub fn matrix(v: &Value, key: &str) -> Result<Matrix3<f64>> {
    Ok(Matrix3::from_row_slice(&exactly::<9>(v, key)?))
}

/// A list of as many numbers a row.
pub fn rows<const N: usize>(v: &Value, key: &str) -> Result<Vec<[f64; N]>> {
    let flat = numbers(v, key)?;
    if flat.len() != N * list(v, key)?.len() {
        return Err(format!("\"{key}\" has rows of other than {N} numbers"));
    }
    Ok(flat.chunks_exact(N).map(|c| std::array::from_fn(|i| c[i])).collect())
}

/// A list of three numbers each.
pub fn vectors(v: &Value, key: &str) -> Result<Vec<Vector3<f64>>> {
    Ok(rows::<3>(v, key)?.into_iter().map(Vector3::from).collect())
}

/// One of several words, or its number.
pub fn choice<T: Copy>(v: &Value, key: &str, choices: &[(&str, f64, T)]) -> Result<T> {
    let value = at(v, key)?;
    let found = choices.iter().find(|(word, code, _)| match value {
        Value::String(s) => s.eq_ignore_ascii_case(word),
        other => other.as_f64() == Some(*code) || other.as_bool().map(f64::from) == Some(*code),
    });
    found.map(|c| c.2).ok_or_else(|| format!("\"{key}\" is {value}, which is not known"))
}

/// A number of the parameters that may be absent.
pub fn number_or(v: &Value, key: &str, default: f64) -> Result<f64> {
    if v.get(key).is_some() { number(v, key) } else { Ok(default) }
}

/// A matrix row by row.
pub fn row_major(m: &Matrix3<f64>) -> [f64; 9] {
    std::array::from_fn(|i| m[(i / 3, i % 3)])
}
