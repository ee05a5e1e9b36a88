//! One message of a log that describes its own layout: numbers looked up by the name of their field.

/// Numbers in an array of them, as DataFlash has them.
pub(super) const SHORTS: usize = 32;

/// How a number is stored, little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Storage {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Storage {
    /// Its length in bytes.
    pub(super) const fn len(self) -> usize {
        match self {
            Storage::I8 | Storage::U8 => 1,
            Storage::I16 | Storage::U16 => 2,
            Storage::I32 | Storage::U32 | Storage::F32 => 4,
            Storage::I64 | Storage::U64 | Storage::F64 => 8,
        }
    }
}

/// Where a number stands in a message, and what it is to be multiplied by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FieldSlot {
    pub(super) at: usize,
    pub(super) storage: Storage,
    pub(super) factor: f64,
}

impl FieldSlot {
    /// The number, if the message is long enough. What 64 bits hold beyond 2^53 (no stamp in microseconds does) is rounded.
    fn read(&self, data: &[u8]) -> Option<f64> {
        let bytes = data.get(self.at..)?.get(..self.storage.len())?;
        let raw = bytes.iter().rev().fold(0u64, |raw, &b| raw << 8 | u64::from(b));
        let value = match self.storage {
            Storage::I8 => f64::from(raw as i8),
            Storage::U8 => f64::from(raw as u8),
            Storage::I16 => f64::from(raw as i16),
            Storage::U16 => f64::from(raw as u16),
            Storage::I32 => f64::from(raw as i32),
            Storage::U32 => f64::from(raw as u32),
            Storage::I64 => raw as i64 as f64,
            Storage::U64 => raw as f64,
            Storage::F32 => f64::from(f32::from_bits(raw as u32)),
            Storage::F64 => f64::from_bits(raw),
        };
        Some(value * self.factor)
    }
}

/// Where the wanted fields of one kind of message stand; `None` for one that this log's version of it does not have.
#[derive(Clone, Debug)]
pub(super) struct Columns {
    names: &'static [&'static str],
    slots: Vec<Option<FieldSlot>>,
}

impl Columns {
    /// Looks all names up.
    pub(super) fn of(
        names: &'static [&'static str],
        find: impl FnMut(&'static str) -> Option<FieldSlot>,
    ) -> Self {
        Self { names, slots: names.iter().copied().map(find).collect() }
    }

    /// One message.
    pub(super) fn row<'a>(&'a self, data: &'a [u8]) -> LogRow<'a> {
        LogRow { columns: self, data }
    }
}

/// One message.
#[derive(Clone, Copy, Debug)]
pub(super) struct LogRow<'a> {
    columns: &'a Columns,
    data: &'a [u8],
}

impl LogRow<'_> {
    /// A number as it is, NaN included; `None` where there is no such field.
    pub(super) fn get(&self, name: &str) -> Option<f64> {
        let i = self.columns.names.iter().position(|n| *n == name)?;
        self.columns.slots[i]?.read(self.data)
    }

    /// The same of several.
    pub(super) fn all<const N: usize>(&self, names: [&str; N]) -> Option<[f64; N]> {
        let mut values = [0.0; N];
        for (value, name) in values.iter_mut().zip(names) {
            *value = self.get(name)?;
        }
        Some(values)
    }

    /// A number that is one, and not zero where that means that it is not known.
    pub(super) fn known(&self, name: &str) -> Option<f64> {
        self.get(name).filter(|v| v.is_finite() && *v != 0.0)
    }

    /// A whole number in the range of `u8`, as enumerations and counts are.
    pub(super) fn byte(&self, name: &str) -> Option<u8> {
        self.get(name).filter(|v| (0.0..=255.0).contains(v)).map(|v| v as u8)
    }

    /// An array of 16-bit numbers.
    pub(super) fn shorts(&self, name: &str) -> Option<[i16; SHORTS]> {
        let i = self.columns.names.iter().position(|n| *n == name)?;
        let slot = self.columns.slots[i].filter(|s| s.storage == Storage::I16)?;
        let (pairs, _) = self.data.get(slot.at..)?.get(..2 * SHORTS)?.as_chunks::<2>();
        let mut numbers = [0; SHORTS];
        numbers.iter_mut().zip(pairs).for_each(|(number, pair)| *number = i16::from_le_bytes(*pair));
        Some(numbers)
    }

    /// A stamp in microseconds.
    pub(super) fn micros(&self, name: &str) -> Option<u64> {
        self.get(name).filter(|v| (0.0..9e15).contains(v)).map(|v| v as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_found_by_name_and_short_messages_have_none() {
        let columns = Columns::of(&["x", "gone", "t"], |name| match name {
            "x" => Some(FieldSlot { at: 1, storage: Storage::I16, factor: 0.01 }),
            "t" => Some(FieldSlot { at: 3, storage: Storage::U64, factor: 1.0 }),
            _ => None,
        });
        let mut data = vec![9, 0x9C, 0xFF];
        data.extend_from_slice(&1_234_567u64.to_le_bytes());
        let row = columns.row(&data);
        assert_eq!((row.get("x"), row.get("gone"), row.micros("t")), (Some(-1.0), None, Some(1_234_567)));
        assert_eq!((row.byte("x"), row.shorts("x")), (None, None));
        assert_eq!(columns.row(&data[..9]).get("t"), None);
        assert_eq!(row.all(["x", "t"]), Some([-1.0, 1_234_567.0]));
    }
}
