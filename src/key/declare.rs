//! The declaration of keys: a struct and the table of its fields in one.

use serde_json::{Map, Value as Json};

use super::content::Content;
use super::distribution::Distribution;
use super::rows::Rows;
use super::value::{Kind, Value};

/// A key, which takes one value or a sweep.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Its name in the manifest, the store and the command line.
    pub name: &'static str,
    /// The type and range of its values.
    pub kind: Kind,
    /// One line for editors and the reference; see [`Key::doc`].
    pub written_doc: &'static str,
    /// The value if a manifest does not set the key; `None` if a manifest must set it.
    pub default: Option<fn() -> Value>,
    /// The value of all jobs from before the key was added; `None` for a key that every job has had.
    /// Canonical forms omit the key at this value.
    pub before: Option<fn() -> Value>,
    /// The default of earlier releases, if it was another. Canonical forms name the value, so jobs that were
    /// stored under it keep their keys.
    pub earlier: Option<fn() -> Value>,
}

impl Key {
    /// The meaning of the key, in one line.
    pub fn doc(&self) -> &'static str {
        self.written_doc.trim_start()
    }

    /// The value if a manifest does not set the key; `None` if a manifest must set it.
    pub fn default(&self) -> Option<Value> {
        self.default.map(|value| value())
    }

    /// The default of earlier releases, if it was another.
    pub fn earlier_default(&self) -> Option<Value> {
        self.earlier.map(|value| value())
    }

    /// The value of all jobs from before the key was added; `None` if every job has had the key.
    pub fn before(&self) -> Option<Value> {
        self.before.map(|value| value())
    }
}

/// Why a setting of a key is rejected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingError {
    /// There is no such key.
    #[error("unknown key `{0}`")]
    Unknown(String),
    /// The value is of another type or outside the range.
    #[error("`{name}`: expected {expected}, found {found}")]
    Value {
        /// The key.
        name: String,
        /// The expected values, in words.
        expected: String,
        /// The value that was given.
        found: String,
    },
}

/// A struct whose fields are keys; [`keys!`](crate::keys) implements it.
pub trait Keyed: Sized {
    /// The keys, in the order the documentation lists them.
    const KEYS: &'static [Key];

    /// The value of every field, in the order of [`Keyed::KEYS`].
    fn to_values(&self) -> Vec<Value>;

    /// The struct with one value for each key, in the order of the keys; `None` if a value has the wrong
    /// type, or if their number is wrong.
    fn from_values(values: &[Value]) -> Option<Self>;

    /// The fields as a JSON object with every key.
    fn to_json(&self) -> Map<String, Json> {
        json_object(Self::KEYS, &self.to_values())
    }

    /// A copy with new values, in JSON, for some keys.
    ///
    /// **Errors**: a key is unknown, or a value is outside the range of its key.
    fn with_settings(&self, settings: &Map<String, Json>) -> Result<Self, SettingError> {
        let mut values = self.to_values();
        for (name, json) in settings {
            let index = Self::KEYS.iter().position(|key| key.name == name);
            let index = index.ok_or_else(|| SettingError::Unknown(name.clone()))?;
            let kind = Self::KEYS[index].kind;
            let value = kind.value(json).filter(|value| kind.admits(value));
            values[index] = value.ok_or_else(|| SettingError::Value {
                name: name.clone(),
                expected: kind.expectation(),
                found: json.to_string(),
            })?;
        }
        Ok(Self::from_values(&values).expect("a value that a key admits fits its field"))
    }

    /// The defaults, and these values for the keys without a default, in the order of the keys.
    ///
    /// # Panics
    /// If the values do not match the keys without a default.
    fn with_required(required: &[Value]) -> Self {
        let mut required = required.iter().cloned();
        let values: Option<Vec<Value>> =
            Self::KEYS.iter().map(|key| key.default().or_else(|| required.next())).collect();
        let keyed = values.and_then(|values| Self::from_values(&values));
        assert!(required.next().is_none(), "no more values than keys without default");
        keyed.expect("a value for every key without default")
    }
}

/// The values as a JSON object with every key.
///
/// **Shapes**: one value for each key, in their order.
pub fn json_object(keys: &[Key], values: &[Value]) -> Map<String, Json> {
    let json = |value: &Value| serde_json::to_value(value).expect("values are finite");
    keys.iter().zip(values).map(|(key, value)| (key.name.to_owned(), json(value))).collect()
}

/// A Rust type that a key's values can have.
pub trait KeyType: Sized {
    /// The value in the form that keys store.
    ///
    /// # Panics
    /// If a number is infinite or NaN.
    fn to_value(&self) -> Value;

    /// The inverse of [`KeyType::to_value`]; `None` if the value is too large or has another type.
    fn from_value(value: &Value) -> Option<Self>;
}

/// A type whose keys need no declared range.
pub trait FixedKind: KeyType {
    /// The kind of every key of this type.
    const KIND: Kind;
}

/// The number, with -0 replaced by 0, so that equal values have one spelling.
///
/// # Panics
/// If the number is infinite or NaN, which no key accepts.
fn finite(number: f64) -> f64 {
    assert!(number.is_finite(), "the value of a key is a finite number, not {number}");
    number + 0.0
}

macro_rules! types {
    ($($Variant:ident $type:ty, $stored:expr;)+) => {$(
        impl KeyType for $type {
            fn to_value(&self) -> Value {
                let stored: fn(&Self) -> Self = $stored;
                Value::$Variant(stored(self))
            }

            fn from_value(value: &Value) -> Option<Self> {
                if let Value::$Variant(value) = value { Some(value.to_owned()) } else { None }
            }
        }
    )+};
}

types! {
    Real f64, |real| finite(*real);
    RealPair [f64; 2], |pair| pair.map(finite);
    Reals Vec<f64>, |reals| reals.iter().copied().map(finite).collect();
    Wholes Vec<u32>, Clone::clone;
    Text String, Clone::clone;
    Words Vec<String>, Clone::clone;
    Distribution Distribution, Clone::clone;
    Content Content, Clone::clone;
    Rows Rows, Clone::clone;
    Flag bool, Clone::clone;
}

impl FixedKind for bool {
    const KIND: Kind = Kind::Flag;
}

macro_rules! whole_numbers {
    ($($number:ty),*) => {$(
        impl KeyType for $number {
            fn to_value(&self) -> Value {
                Value::Integer(*self as u64)
            }

            fn from_value(value: &Value) -> Option<Self> {
                if let Value::Integer(whole) = value { (*whole).try_into().ok() } else { None }
            }
        }
    )*};
}

whole_numbers!(u8, u32, u64, usize);

/// Declares a struct whose fields are keys of a manifest.
///
/// Each field is a key. Its documentation comment is the description of the key in the reference.
/// After the type come the default, the value of all jobs from before the key was added, and the
/// range. A key that a manifest must set has no default. `bool` and [`choices!`](crate::choices)
/// need no range.
///
/// A key that is added to a struct with stored jobs must have `before`, which preserves their identity. A key
/// whose default changes names the former default as `earlier`, so that a plan can say why stored jobs are not
/// used.
///
/// ```
/// use jitai::key::Kind;
///
/// jitai::keys! {
///     /// Parameters of a bandit.
///     pub struct Bandit {
///         /// episodes of training
///         episodes: u32 = 1000, in Kind::EPISODES;
///         /// probability of a random action
///         epsilon: f64 = 0.1, before 0.0, in Kind::PROBABILITY;
///     }
/// }
/// ```
#[macro_export]
macro_rules! keys {
    (
        $(#[$attribute:meta])*
        $visibility:vis struct $Name:ident {
            $(
                $(#[doc = $doc:literal])+
                $field:ident: $Type:ty
                    $(= $default:expr)? $(, before $before:expr)? $(, earlier $earlier:expr)?
                    $(, in $kind:expr)?;
            )+
        }
    ) => {
        $(#[$attribute])*
        #[derive(Clone, Debug, PartialEq)]
        $visibility struct $Name {
            $($(#[doc = $doc])+ pub $field: $Type,)+
        }

        impl $crate::key::Keyed for $Name {
            const KEYS: &'static [$crate::key::Key] = &[$(
                $crate::key::Key {
                    name: stringify!($field),
                    kind: $crate::keys!(@kind $Type $(, $kind)?),
                    written_doc: concat!($($doc),+),
                    default: $crate::keys!(@value $Type $(, $default)?),
                    before: $crate::keys!(@value $Type $(, $before)?),
                    earlier: $crate::keys!(@value $Type $(, $earlier)?),
                },
            )+];

            fn to_values(&self) -> Vec<$crate::key::Value> {
                vec![$($crate::key::KeyType::to_value(&self.$field)),+]
            }

            fn from_values(values: &[$crate::key::Value]) -> Option<Self> {
                let [$($field),+] = values else { return None };
                Some($Name { $($field: $crate::key::KeyType::from_value($field)?),+ })
            }
        }
    };
    (@kind $Type:ty) => { <$Type as $crate::key::FixedKind>::KIND };
    (@kind $Type:ty, $kind:expr) => { $kind };
    (@value $Type:ty) => { None };
    (@value $Type:ty, $value:expr) => {
        Some(|| {
            let value: $Type = $value;
            $crate::key::KeyType::to_value(&value)
        })
    };
}

/// Declares an enum whose variants are the words that a key accepts.
#[macro_export]
macro_rules! choices {
    (
        $(#[$attribute:meta])*
        $visibility:vis enum $Name:ident {
            $($(#[$of_variant:meta])+ $Variant:ident = $word:literal,)+
        }
    ) => {
        $(#[$attribute])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        $visibility enum $Name {
            $($(#[$of_variant])+ $Variant,)+
        }

        impl $Name {
            /// The words in the order of the variants.
            pub const WORDS: &'static [&'static str] = &[$($word),+];

            /// The word in manifests and in the store.
            pub fn word(self) -> &'static str {
                match self {
                    $($Name::$Variant => $word,)+
                }
            }

            /// The variant for a word.
            pub fn named(word: &str) -> Option<Self> {
                match word {
                    $($word => Some($Name::$Variant),)+
                    _ => None,
                }
            }
        }

        impl $crate::key::KeyType for $Name {
            fn to_value(&self) -> $crate::key::Value {
                $crate::key::Value::Choice(self.word())
            }

            fn from_value(value: &$crate::key::Value) -> Option<Self> {
                match value {
                    $crate::key::Value::Choice(word) => $Name::named(word),
                    _ => None,
                }
            }
        }

        impl $crate::key::FixedKind for $Name {
            const KIND: $crate::key::Kind = $crate::key::Kind::Choice($Name::WORDS);
        }
    };
}

// Macros that other crates can call are at the root of the crate; within it they have a path.
pub(crate) use {choices, keys};
