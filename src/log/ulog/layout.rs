//! The formats that a ULog describes itself in: where a field of a message stands.

use std::collections::BTreeMap;

use super::super::row::{FieldSlot, Storage};

/// Formats, fields of one, and elements of one array beyond this are no log's, but an attempt to use up memory or time.
const MOST_FORMATS: usize = 4096;
const MOST_FIELDS: usize = 1024;
const LONGEST: usize = 65_535;
/// Formats within formats.
const MOST_DEPTH: usize = 8;

/// One field as it is declared.
#[derive(Clone, Debug)]
struct Declared {
    of: String,
    name: String,
    /// Elements, of an array; 1 of a single one.
    n: usize,
    is_array: bool,
}

/// All formats of a log by their name.
#[derive(Clone, Debug, Default)]
pub(super) struct Formats {
    formats: BTreeMap<String, Vec<Declared>>,
}

impl Formats {
    /// Takes the text of a format message: `name:type field;type[n] field;…`. Whether it is one.
    pub(super) fn declare(&mut self, text: &str) -> bool {
        let Some((name, fields)) = text.split_once(':') else { return false };
        let fields: Option<Vec<Declared>> =
            fields.split(';').filter(|f| !f.trim().is_empty()).map(declared).collect();
        match fields {
            Some(fields) if fields.len() <= MOST_FIELDS && self.formats.len() < MOST_FORMATS => {
                self.formats.insert(name.trim().to_owned(), fields);
                true
            }
            _ => false,
        }
    }

    /// Shortest and longest data of a format: what pads its end is not logged.
    pub(super) fn lengths(&self, name: &str) -> Option<(usize, usize)> {
        let fields = self.formats.get(name)?;
        let mut sizes = BTreeMap::new();
        let (mut at, mut shortest) = (0usize, 0);
        for field in fields {
            at = at.checked_add(self.size(field, &mut sizes, 0)?)?;
            if !field.name.starts_with("_padding") {
                shortest = at;
            }
        }
        (at <= LONGEST).then_some((shortest, at))
    }

    /// Where a field of a format stands: `name`, or `name[2]` of an array, or `name[2].field` of an array of another format.
    pub(super) fn slot(&self, format: &str, path: &str) -> Option<FieldSlot> {
        let (field, inner) = path.split_once('.').map_or((path, None), |(field, inner)| (field, Some(inner)));
        let (name, index) = match field.strip_suffix(']').and_then(|f| f.split_once('[')) {
            Some((name, index)) => (name, index.parse().ok()?),
            None => (field, 0),
        };
        let mut sizes = BTreeMap::new();
        let mut at = 0usize;
        for declared in self.formats.get(format)? {
            let size = self.size(declared, &mut sizes, 0)?;
            if declared.name == name {
                let is_in = index < declared.n && declared.is_array == field.ends_with(']');
                let element = is_in.then(|| at.checked_add(size / declared.n * index))??;
                return self.slot_within(&declared.of, inner, element);
            }
            at = at.checked_add(size)?;
        }
        None
    }

    /// The same of what begins at `at`: a number, or a field of another format.
    fn slot_within(&self, of: &str, inner: Option<&str>, at: usize) -> Option<FieldSlot> {
        match inner {
            None => Some(FieldSlot { at, storage: storage(of)?, factor: 1.0 }),
            Some(path) => {
                let slot = self.slot(of, path)?;
                Some(FieldSlot { at: at.checked_add(slot.at)?, ..slot })
            }
        }
    }

    /// Bytes of a field, with all its elements. Each format is measured once, and one that holds itself has no size.
    fn size<'a>(
        &'a self,
        field: &'a Declared,
        sizes: &mut BTreeMap<&'a str, Option<usize>>,
        depth: usize,
    ) -> Option<usize> {
        let one = match storage(&field.of) {
            Some(storage) => Some(storage.len()),
            None => match sizes.get(field.of.as_str()) {
                Some(size) => *size,
                None if depth >= MOST_DEPTH => None,
                None => {
                    sizes.insert(&field.of, None);
                    let mut sum = Some(0usize);
                    for inner in self.formats.get(&field.of)? {
                        sum = sum.zip(self.size(inner, sizes, depth + 1)).map(|(a, b)| a.saturating_add(b));
                    }
                    sizes.insert(&field.of, sum);
                    sum
                }
            },
        };
        one?.checked_mul(field.n).filter(|size| *size <= LONGEST)
    }
}

/// `type name` or `type[n] name`.
fn declared(text: &str) -> Option<Declared> {
    let (of, name) = text.trim().split_once(' ')?;
    let (of, n, is_array) = match of.strip_suffix(']') {
        Some(of) => {
            let (of, n) = of.split_once('[')?;
            (of, n.parse().ok().filter(|n| *n <= LONGEST)?, true)
        }
        None => (of, 1, false),
    };
    Some(Declared { of: of.to_owned(), name: name.trim().to_owned(), n, is_array })
}

/// How a type of ULog's own is stored; other types are formats.
fn storage(of: &str) -> Option<Storage> {
    Some(match of {
        "int8_t" => Storage::I8,
        "uint8_t" | "bool" | "char" => Storage::U8,
        "int16_t" => Storage::I16,
        "uint16_t" => Storage::U16,
        "int32_t" => Storage::I32,
        "uint32_t" => Storage::U32,
        "int64_t" => Storage::I64,
        "uint64_t" => Storage::U64,
        "float" => Storage::F32,
        "double" => Storage::F64,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn fields_stand_where_the_declaration_puts_them() {
        let mut formats = Formats::default();
        // A format may be used before it is declared.
        assert!(
            formats.declare(
                "outer:uint64_t timestamp;inner[2] pair;float[3] v;uint8_t flag;uint8_t[3] _padding0;"
            )
        );
        assert!(formats.declare("inner:uint16_t a;uint16_t b;"));
        assert_eq!(formats.lengths("outer"), Some((29, 32)));
        let at = |f: &str| formats.slot("outer", f).map(|s| (s.at, s.storage));
        assert_eq!(at("timestamp"), Some((0, Storage::U64)));
        assert_eq!(at("v[0]"), Some((16, Storage::F32)));
        assert_eq!(at("v[2]"), Some((24, Storage::F32)));
        assert_eq!(at("flag"), Some((28, Storage::U8)));
        assert_eq!(at("pair[1].b"), Some((14, Storage::U16)));
        assert_eq!((at("pair[2].b"), at("pair.b"), at("pair[0].c"), at("flag.b")), (None, None, None, None));
        assert_eq!(
            (at("v[3]"), at("v"), at("flag[0]"), at("pair"), at("gone")),
            (None, None, None, None, None)
        );
    }

    #[test]
    fn formats_that_hold_themselves_or_grow_without_end_have_no_size() {
        let mut formats = Formats::default();
        assert!(formats.declare("a:b x;") && formats.declare("b:a x;"));
        assert_eq!(formats.lengths("a"), None);
        assert!(formats.declare("c:uint8_t[65000] x;uint8_t[65000] y;"));
        assert_eq!(formats.lengths("c"), None);
        for i in 0..40 {
            let fields = format!("f{}[1000] x;", i + 1).repeat(100);
            assert!(formats.declare(&format!("f{i}:{fields}")));
        }
        assert_eq!(formats.lengths("f0"), None);
        assert!(!formats.declare("no colon"));
        assert!(!formats.declare("x:uint8_t"));
    }

    proptest! {
        #[test]
        fn any_text_is_declared_or_not(texts in proptest::collection::vec("[a-c]:([a-c]|float)(\\[[0-9]{1,6}\\])? [a-c](;.{0,20})?", 0..20)) {
            let mut formats = Formats::default();
            for text in &texts {
                let _ = formats.declare(text);
            }
            for name in ["a", "b", "c"] {
                if let Some((shortest, longest)) = formats.lengths(name) {
                    prop_assert!(shortest <= longest && longest <= LONGEST);
                }
                let _ = formats.slot(name, "a[3]");
                let _ = formats.slot(name, "a[3].b[2].c");
            }
        }
    }
}
