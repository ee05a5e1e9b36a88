//! JSON whose numbers are read as they were written.
//!
//! What reads JSON here rounds the last digit of one number in some hundreds otherwise than it was, and a merge is to print what one run prints, to the byte. So a
//! number with a fraction is written as `{"f": "its shortest digits"}`, which the standard library reads exactly. What is no number is null, as in any JSON.

use serde::Serialize;
use serde::de::{DeserializeOwned, Error};
use serde_json::{Map, Value};

/// The one name in the object that stands for a number.
const NUMBER: &str = "f";

/// A value as JSON.
///
/// # Errors
/// As for any JSON.
pub(super) fn to_vec(value: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    serde_json::to_vec(&in_digits(serde_json::to_value(value)?))
}

/// The value of such JSON.
///
/// # Errors
/// It is none, or none of such a value.
pub(super) fn from_slice<T: DeserializeOwned>(bytes: &[u8]) -> serde_json::Result<T> {
    serde_json::from_value(in_numbers(serde_json::from_slice(bytes)?)?)
}

fn in_digits(value: Value) -> Value {
    match value {
        Value::Number(n) if n.is_f64() => {
            let digits = n.as_f64().map_or(Value::Null, |f| Value::String(f.to_string()));
            Value::Object(Map::from_iter([(NUMBER.to_owned(), digits)]))
        }
        Value::Array(all) => all.into_iter().map(in_digits).collect(),
        Value::Object(all) => all.into_iter().map(|(name, v)| (name, in_digits(v))).collect(),
        other => other,
    }
}

fn in_numbers(value: Value) -> serde_json::Result<Value> {
    match value {
        Value::Object(all) if all.len() == 1 && all.contains_key(NUMBER) => {
            let number = all[NUMBER].as_str().and_then(|digits| digits.parse::<f64>().ok());
            number.map(Value::from).ok_or_else(|| serde_json::Error::custom("digits that are no number"))
        }
        Value::Array(all) => all.into_iter().map(in_numbers).collect(),
        Value::Object(all) => all
            .into_iter()
            .map(|(name, v)| Ok((name, in_numbers(v)?)))
            .collect::<Result<_, _>>()
            .map(Value::Object),
        other => Ok(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, PartialEq, Serialize, serde::Deserialize)]
    struct Numbers {
        some: Vec<Option<f64>>,
        count: u64,
        word: String,
    }

    proptest! {
        #[test]
        fn numbers_are_what_they_were(
            some in proptest::collection::vec(proptest::option::of(proptest::num::f64::NORMAL | proptest::num::f64::ZERO), 0..20),
            count in any::<u64>(),
            word in ".*",
        ) {
            let numbers = Numbers { some, count, word };
            let again: Numbers = from_slice(&to_vec(&numbers).unwrap()).unwrap();
            prop_assert_eq!(again, numbers);
        }

        #[test]
        fn no_bytes_are_too_strange(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = from_slice::<Numbers>(&bytes);
        }
    }

    #[test]
    fn digits_that_are_no_number_are_refused() {
        assert!(from_slice::<Numbers>(br#"{"some":[{"f":"x"}],"count":1,"word":""}"#).is_err());
        assert!(from_slice::<Numbers>(br#"{"some":[{"f":1}],"count":1,"word":""}"#).is_err());
    }
}
