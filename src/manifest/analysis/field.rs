//! The declaration of an analysis's keys: a struct whose fields are keys, with reading, writing and JSON Schema.

use crate::job::Condition;
use serde_json::Value as Json;
use toml::de::DeTable;

use crate::key::{KeyType, Kind, Parameter};
use crate::manifest::text::fault::Fault;
use crate::manifest::text::source::{Located, Span};
use crate::manifest::value::schema;
use crate::manifest::value::sweep::{Node, Reader};

/// A key of `[[analysis]]`.
#[derive(Clone, Copy, Debug)]
pub(in crate::manifest) struct AnalysisKey {
    /// Its name in the manifest.
    pub name: &'static str,
    /// One line for editors.
    pub doc: &'static str,
    /// The JSON Schema of its values.
    pub schema: fn() -> Json,
}

/// A table of `[[analysis]]` that is being read, with the parts that are checked against the rest of the
/// manifest.
pub(in crate::manifest) struct AnalysisTable<'a, 'r> {
    pub reader: &'a mut Reader<'r>,
    /// The name of the analysis.
    pub name: &'a str,
    /// Where the table begins.
    pub span: Span,
    pub table: &'a DeTable<'a>,
    /// The conditions on its jobs and sides.
    pub conditions: Vec<Located<Condition>>,
    /// The key that distinguishes its panels; at most one.
    pub panels: Vec<Located<Parameter>>,
    /// The parameters along its axes.
    pub axes: Vec<Located<Parameter>>,
}

impl<'a> AnalysisTable<'a, '_> {
    /// The value of a key, if the table has it.
    pub fn node(&self, key: &str) -> Option<&'a Node<'a>> {
        self.table.get(key)
    }

    /// Notes where conditions stand.
    pub fn locate<'c>(&mut self, span: Span, conditions: impl IntoIterator<Item = &'c Condition>) {
        let conditions = conditions.into_iter().cloned();
        self.conditions.extend(conditions.map(|value| Located { value, span }));
    }

    /// Reports that a key is missing.
    pub fn missing(&mut self, key: &str, help: &str) {
        let fault = Fault::at(self.span, format!("missing key `{key}` in an [[analysis]]"));
        self.reader.faults.add(fault.help(help));
    }
}

/// The type of a field: one key, or several that belong together.
pub(in crate::manifest) trait Field: Sized {
    /// The keys of a field that has others than the key of its name.
    const KEYS: Option<&'static [AnalysisKey]> = None;

    /// The JSON Schema of its values.
    fn schema(kind: Option<Kind>) -> Json;

    /// Reads the field; `None` if it is faulty, which is reported.
    fn read(table: &mut AnalysisTable<'_, '_>, key: &str, kind: Option<Kind>) -> Option<Self>;

    /// Its keys with their values, as a manifest writes them.
    fn written(&self, key: &'static str) -> Vec<(&'static str, String)>;
}

/// A value of a declared kind.
impl<T: KeyType> Field for T {
    fn schema(kind: Option<Kind>) -> Json {
        schema::value(kind.expect("a field of a plain type has a kind"))
    }

    fn read(table: &mut AnalysisTable<'_, '_>, key: &str, kind: Option<Kind>) -> Option<T> {
        let kind = kind?;
        let Some(node) = table.node(key) else {
            table.missing(key, &format!("it is {}", kind.expectation()));
            return None;
        };
        T::from_value(&table.reader.value(key, kind, node)?)
    }

    fn written(&self, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, self.to_value().to_string())]
    }
}

/// A field that a table may leave out.
impl<T: Field> Field for Option<T> {
    const KEYS: Option<&'static [AnalysisKey]> = T::KEYS;

    fn schema(kind: Option<Kind>) -> Json {
        T::schema(kind)
    }

    fn read(table: &mut AnalysisTable<'_, '_>, key: &str, kind: Option<Kind>) -> Option<Option<T>> {
        let has = |key: &str| table.table.contains_key(key);
        let is_given =
            T::KEYS.map_or_else(|| has(key), |keys| keys.iter().any(|key| has(key.name)));
        if is_given { T::read(table, key, kind).map(Some) } else { Some(None) }
    }

    fn written(&self, key: &'static str) -> Vec<(&'static str, String)> {
        self.as_ref().map_or_else(Vec::new, |value| value.written(key))
    }
}

/// A struct whose fields are keys of an analysis; [`fields!`] implements it.
pub(in crate::manifest) trait Fields: Sized {
    /// All keys.
    fn keys() -> Vec<AnalysisKey>;

    /// Reads all fields; `None` if one is faulty, which is reported.
    fn read(table: &mut AnalysisTable<'_, '_>) -> Option<Self>;

    /// The keys with their values, as a manifest writes them.
    fn written(&self) -> Vec<(&'static str, String)>;
}

/// Declares a struct whose fields are keys of an analysis.
///
/// The documentation comment of a field is the description of its key. A field with a default may be left out.
/// A field of a plain type has a [`Kind`], which gives its range.
macro_rules! fields {
    (
        $(#[$attribute:meta])*
        pub struct $Name:ident {
            $(
                $(#[doc = $doc:literal])+
                $field:ident: $Type:ty $(= $default:expr)? $(, in $kind:expr)?;
            )*
        }
    ) => {
        $(#[$attribute])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $Name {
            $($(#[doc = $doc])+ pub $field: $Type,)*
        }

        impl crate::manifest::analysis::field::Fields for $Name {
            fn keys() -> Vec<crate::manifest::analysis::field::AnalysisKey> {
                #[allow(unused_imports, reason = "a kind may have no key of its own")]
                use crate::manifest::analysis::field::{AnalysisKey, Field, with_default};
                let own: Vec<&'static [AnalysisKey]> = vec![$(
                    <$Type as Field>::KEYS.unwrap_or(&[AnalysisKey {
                        name: stringify!($field),
                        doc: concat!($($doc),+),
                        schema: || {
                            let schema = <$Type as Field>::schema(fields!(@option $($kind)?));
                            with_default::<$Type>(schema, fields!(@option $($default)?))
                        },
                    }]),
                )*];
                own.concat()
            }

            fn read(table: &mut crate::manifest::analysis::field::AnalysisTable<'_, '_>) -> Option<Self> {
                $(
                    let $field = fields!(@read table, $field: $Type, [$($default)?], [$($kind)?]);
                )*
                let _ = table;
                Some($Name { $($field: $field?,)* })
            }

            fn written(&self) -> Vec<(&'static str, String)> {
                #[allow(unused_imports, reason = "a kind may have no key of its own")]
                use crate::manifest::analysis::field::Field;
                let own: Vec<Vec<(&'static str, String)>> =
                    vec![$(Field::written(&self.$field, stringify!($field)),)*];
                own.concat()
            }
        }
    };
    (@option) => { None };
    (@option $value:expr) => { Some($value) };
    (@read $table:ident, $field:ident: $Type:ty, [], [$($kind:expr)?]) => {
        <$Type as crate::manifest::analysis::field::Field>::read(
            $table, stringify!($field), fields!(@option $($kind)?),
        )
    };
    (@read $table:ident, $field:ident: $Type:ty, [$default:expr], [$($kind:expr)?]) => {
        match $table.table.contains_key(stringify!($field)) {
            true => fields!(@read $table, $field: $Type, [], [$($kind)?]),
            false => Some($default),
        }
    };
}
pub(in crate::manifest) use fields;

/// The schema with the default of its key.
pub(in crate::manifest) fn with_default<T: Field>(mut schema: Json, default: Option<T>) -> Json {
    let written = default.and_then(|default| default.written("").pop());
    // Defaults are numbers and words, which JSON and TOML write alike.
    if let Some(default) = written.and_then(|(_, text)| serde_json::from_str::<Json>(&text).ok()) {
        schema["default"] = default;
    }
    schema
}
