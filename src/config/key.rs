//! What is known of a key: type, range, choices, unit, default, doc, and the names that it had. A [`section!`] declares all of it and the
//! serde struct at once, so a key is spelled in one place.

/// What type a key has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Type {
    /// true or false.
    Flag,
    /// A whole number.
    Whole,
    /// A number.
    Number,
    /// Text in quotes.
    Text,
    /// A list of texts in quotes.
    Texts,
    /// A list of tables, each with these keys.
    Tables(&'static [Key]),
}

/// What holds where a key is not given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// This, as TOML.
    Toml(&'static str),
    /// Nothing: the key has to be given.
    Required,
    /// Nothing: the key may be absent.
    Absent,
}

/// A key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key {
    /// Its name, as its field has it; see [`Key::name`].
    pub(super) field: &'static str,
    /// Its type.
    pub kind: Type,
    /// Least and greatest value, both included.
    pub range: Option<(f64, f64)>,
    /// The words that it may be.
    pub choices: &'static [&'static str],
    /// The unit where the name does not say it; see [`Key::unit`].
    pub(super) own_unit: Option<&'static str>,
    /// The default.
    pub preset: Preset,
    /// One line of doc, without the unit.
    pub(super) text: &'static str,
    /// Paths that it had before, which are refused.
    pub was: &'static [&'static str],
}

/// A section: the keys of one table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// Its path, as in `tuning.gnss`; empty for what stands outside all sections.
    pub path: &'static str,
    /// What it is about.
    pub(super) text: &'static str,
    /// Its keys.
    pub keys: &'static [Key],
}

/// The last part of a key's name, and the unit that it stands for; longer parts first.
const UNITS: [(&str, &str); 11] = [
    ("_per_s", "1/s"),
    ("_radps", "rad/s"),
    ("_mps2", "m/s²"),
    ("_mps", "m/s"),
    ("_dpm", "degrees a minute"),
    ("_deg", "degrees"),
    ("_hz", "Hz"),
    ("_ut", "µT"),
    ("_ms", "ms"),
    ("_s", "s"),
    ("_m", "m"),
];

impl Key {
    /// Its name within its section.
    pub fn name(&self) -> &'static str {
        self.field.strip_prefix("r#").unwrap_or(self.field)
    }

    /// Its path in a section.
    pub fn path(&self, section: &str) -> String {
        if section.is_empty() { self.name().to_owned() } else { format!("{section}.{}", self.name()) }
    }

    /// One line of doc, without the unit.
    pub fn doc(&self) -> &'static str {
        self.text.trim()
    }

    /// The unit; empty where there is none.
    pub fn unit(&self) -> &'static str {
        let by_name = || UNITS.iter().find(|(end, _)| self.name().ends_with(end)).map(|(_, unit)| *unit);
        match self.kind {
            Type::Whole | Type::Number => self.own_unit.or_else(by_name).unwrap_or_default(),
            _ => "",
        }
    }

    /// The default as TOML; `None` where there is none.
    pub fn default_toml(&self) -> Option<&'static str> {
        match self.preset {
            Preset::Toml(text) => Some(text),
            Preset::Required | Preset::Absent => None,
        }
    }

    /// What it may hold, in words.
    pub fn allowed(&self) -> String {
        let range = self.range.map(|(low, high)| format!(" from {low} to {high}")).unwrap_or_default();
        match self.kind {
            Type::Flag => "true or false".to_owned(),
            Type::Whole => format!("a whole number{range}"),
            Type::Number => format!("a number{range}"),
            Type::Text if self.choices.is_empty() => "text in quotes".to_owned(),
            Type::Text => format!("one of {}", self.choices.join(", ")),
            Type::Texts => "a list of texts in quotes".to_owned(),
            Type::Tables(rows) => {
                let names: Vec<_> = rows.iter().map(Key::name).collect();
                format!("a list of tables with {}", names.join(", "))
            }
        }
    }
}

impl Section {
    /// What it is about.
    pub fn doc(&self) -> &'static str {
        self.text.trim()
    }

    /// Whether these are keys that a user meets; the others are for who tunes.
    pub fn for_users(&self) -> bool {
        !self.path.starts_with("tuning.")
    }
}

/// A type that a key may have.
pub(super) trait Typed {
    /// Which.
    const TYPE: Type;
}

/// A table of a list.
pub(super) trait TableRow {
    /// Its keys.
    const KEYS: &'static [Key];
}

macro_rules! typed {
    ($($type:ty: $kind:ident),+ $(,)?) => { $(impl Typed for $type { const TYPE: Type = Type::$kind; })+ };
}

typed! {
    bool: Flag, u8: Whole, u32: Whole, u64: Whole, usize: Whole, f64: Number, String: Text, Vec<String>: Texts,
    super::LogTo: Text,
    crate::navigator::settings::Estimator: Text,
    crate::navigator::settings::FlowBiasSource: Text,
    crate::outbound::Carriage: Text,
    crate::outbound::Coasting: Text,
    crate::outbound::Covariance: Text,
    crate::outbound::Publish: Text,
    crate::wire::session::source_switch::SwitchedBy: Text,
    crate::wire::signing::AcceptUnsigned: Text,
}

impl<T: Typed> Typed for Option<T> {
    const TYPE: Type = T::TYPE;
}

impl<T: TableRow> Typed for Vec<T> {
    const TYPE: Type = Type::Tables(T::KEYS);
}

/// The default of a key: TOML, or one of two words.
macro_rules! preset {
    (required) => {
        $crate::config::key::Preset::Required
    };
    (absent) => {
        $crate::config::key::Preset::Absent
    };
    ($toml:tt) => {
        $crate::config::key::Preset::Toml(stringify!($toml))
    };
}

/// A section: the struct that serde reads, and `SECTION`, which says what its keys may hold. A key is
///
/// ```text
/// /// One line of doc, without the unit.
/// name: Type = default in low ..= high of "choice" | "choice" unit "unit" was "old.path", "older.path";
/// ```
///
/// where everything after the default is left out unless it is needed. The default is TOML, or `required`, or `absent`.
macro_rules! section {
    ($(#[doc = $about:literal])+ $path:literal struct $name:ident { $(
        $(#[doc = $doc:literal])+
        $field:ident: $type:ty = $default:tt
            $(in $low:literal ..= $high:literal)? $(of $($word:literal)|+)? $(unit $unit:literal)? $(was $($old:literal),+)?;
    )+ }) => {
        $(#[doc = $about])+
        #[derive(Debug, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(in crate::config) struct $name { $($(#[doc = $doc])+ pub(in crate::config) $field: $type,)+ }

        impl $name {
            pub(in crate::config) const SECTION: $crate::config::key::Section = $crate::config::key::Section {
                path: $path,
                text: concat!($($about),+),
                keys: &[$($crate::config::key::Key {
                    field: stringify!($field),
                    kind: <$type as $crate::config::key::Typed>::TYPE,
                    range: $crate::config::key::section!(@maybe $(($low, $high))?),
                    choices: &[$($($word),+)?],
                    own_unit: $crate::config::key::section!(@maybe $($unit)?),
                    preset: $crate::config::key::preset!($default),
                    text: concat!($($doc),+),
                    was: &[$($($old),+)?],
                }),+],
            };
        }
    };
    (@maybe) => { None };
    (@maybe $some:expr) => { Some($some) };
}

pub(super) use {preset, section};
