//! Tables whose keys are declared once: their types, defaults and documentation.
//!
//! In: a struct whose fields are the keys, declared with [`fields!`]. Out: reading with every fault, the JSON Schema, and
//! the keys as a manifest writes them. The module knows no particular table.

use std::borrow::Cow;
use std::collections::HashSet;

use serde_json::{Map, Value as Json, json};
use toml::de::DeTable;

use crate::job::Condition;
use crate::key::{KeyType, Kind, Parameter};
use crate::manifest::value::respelt::respelt;
use crate::manifest::value::schema;
use crate::manifest::value::sweep::{Node, Reader};
use crate::text::{Fault, Located, Span};

/// A key of a table.
#[derive(Clone, Copy, Debug)]
pub(in crate::manifest) struct TableKey {
    /// Its name in the manifest.
    pub name: &'static str,
    /// One line for editors.
    pub doc: &'static str,
    /// The JSON Schema of its values.
    pub schema: fn() -> Json,
    /// Whether every table has the key.
    pub is_required: bool,
}

/// How a field is read and written: one key, or several that belong together. Most types of fields describe
/// themselves.
pub(in crate::manifest) trait Field {
    /// The type of the field.
    type Value;

    /// The keys of a field that has others than the key of its name.
    const KEYS: Option<&'static [TableKey]> = None;

    /// The JSON Schema of its values.
    fn schema(kind: Option<Kind>) -> Json;

    /// Reads the field; `None` if it is faulty, which is reported.
    fn read(table: &mut TableReader<'_, '_>, key: &str, kind: Option<Kind>) -> Option<Self::Value>;

    /// Its keys with their values, as a manifest writes them.
    fn written(value: &Self::Value, key: &'static str) -> Vec<(&'static str, String)>;
}

/// A value of a declared kind.
impl<T: KeyType> Field for T {
    type Value = T;

    fn schema(kind: Option<Kind>) -> Json {
        schema::value(kind.expect("a field of a plain type has a kind"))
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, kind: Option<Kind>) -> Option<T> {
        let kind = kind?;
        let Some(node) = table.node(key) else {
            table.missing(key, &format!("it is {}", kind.expectation()));
            return None;
        };
        T::from_value(&table.reader.value(key, kind, node)?)
    }

    fn written(value: &T, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, value.to_value().to_string())]
    }
}

/// A field that a table may leave out.
impl<F: Field> Field for Option<F> {
    type Value = Option<F::Value>;

    const KEYS: Option<&'static [TableKey]> = F::KEYS;

    fn schema(kind: Option<Kind>) -> Json {
        F::schema(kind)
    }

    fn read(
        table: &mut TableReader<'_, '_>,
        key: &str,
        kind: Option<Kind>,
    ) -> Option<Option<F::Value>> {
        let has = |key: &str| table.node(key).is_some();
        let is_given =
            F::KEYS.map_or_else(|| has(key), |keys| keys.iter().any(|key| has(key.name)));
        if is_given { F::read(table, key, kind).map(Some) } else { Some(None) }
    }

    fn written(value: &Option<F::Value>, key: &'static str) -> Vec<(&'static str, String)> {
        value.as_ref().map_or_else(Vec::new, |value| F::written(value, key))
    }
}

/// A struct whose fields are keys of a table; [`fields!`] implements it.
pub(in crate::manifest) trait Fields: Sized {
    /// All keys.
    fn keys() -> Vec<TableKey>;

    /// Reads all fields; `None` if one is faulty, which is reported.
    fn read(table: &mut TableReader<'_, '_>) -> Option<Self>;

    /// The keys with their values, as a manifest writes them.
    fn written(&self) -> Vec<(&'static str, String)>;
}

/// Declares a struct whose fields are keys of a table.
///
/// The documentation comment of a field is the description of its key. A type behind `as` reads and writes the
/// field in place of the field's own type. A field with a default may be left out; `missing` says what to write
/// where a required key is missing. A field of a plain type has a [`Kind`], which gives its range.
///
/// `fields! { impl Name { … } with |table| { … } }` declares fields of a struct of another module as keys, and sets
/// the others.
macro_rules! fields {
    (
        $(#[$attribute:meta])*
        pub struct $Name:ident {
            $(
                $(#[doc = $doc:literal])+
                $field:ident: $Type:ty $(as $Form:ty)? $(= $default:expr)? $(, in $kind:expr)?
                    $(, missing $help:expr)?;
            )*
        }
    ) => {
        $(#[$attribute])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $Name {
            $($(#[doc = $doc])+ pub $field: $Type,)*
        }

        fields! {
            impl $Name {
                $(
                    $(#[doc = $doc])+
                    $field: $Type $(as $Form)? $(= $default)? $(, in $kind)? $(, missing $help)?;
                )*
            } with |table| {}
        }
    };
    (
        impl $Name:ident {
            $(
                $(#[doc = $doc:literal])+
                $field:ident: $Type:ty $(as $Form:ty)? $(= $default:expr)? $(, in $kind:expr)?
                    $(, missing $help:expr)?;
            )*
        } with |$table:ident| { $($other:ident: $value:expr),* }
    ) => {
        #[allow(unused_imports, unused_variables, reason = "a struct may have no key of its own")]
        impl crate::manifest::table::Fields for $Name {
            fn keys() -> Vec<crate::manifest::table::TableKey> {
                use crate::manifest::table::{Field, TableKey, schema_of};
                let own: Vec<&'static [TableKey]> = vec![$(
                    <fields!(@form $Type $(, $Form)?) as Field>::KEYS.unwrap_or(&[TableKey {
                        name: stringify!($field),
                        doc: concat!($($doc),+),
                        schema: || schema_of::<fields!(@form $Type $(, $Form)?)>(
                            fields!(@option $($kind)?),
                            fields!(@option $($default)?),
                        ),
                        is_required: fields!(@is_given $($help)?),
                    }]),
                )*];
                own.concat()
            }

            fn read($table: &mut crate::manifest::table::TableReader<'_, '_>) -> Option<Self> {
                $(
                    let $field = $table.field::<fields!(@form $Type $(, $Form)?)>(
                        stringify!($field),
                        fields!(@option $($kind)?),
                        fields!(@option $($default)?),
                        fields!(@option $($help)?),
                    );
                )*
                Some($Name { $($field: $field?,)* $($other: $value,)* })
            }

            fn written(&self) -> Vec<(&'static str, String)> {
                use crate::manifest::table::Field;
                let own: Vec<Vec<(&'static str, String)>> = vec![$(
                    <fields!(@form $Type $(, $Form)?) as Field>::written(&self.$field, stringify!($field)),
                )*];
                own.concat()
            }
        }
    };
    (@option) => { None };
    (@option $value:expr) => { Some($value) };
    (@is_given) => { false };
    (@is_given $value:expr) => { true };
    (@form $Type:ty) => { $Type };
    (@form $Type:ty, $Form:ty) => { $Form };
}
pub(in crate::manifest) use fields;

/// The schema of a field with its default.
pub(in crate::manifest) fn schema_of<F: Field>(
    kind: Option<Kind>,
    default: Option<F::Value>,
) -> Json {
    let mut schema = F::schema(kind);
    let written = default.and_then(|default| F::written(&default, "").pop());
    // Defaults are numbers, words and lists, which JSON and TOML write alike.
    if let Some(default) = written.and_then(|(_, text)| serde_json::from_str::<Json>(&text).ok()) {
        schema["default"] = default;
    }
    schema
}

/// The JSON Schema of a table with these keys.
pub(in crate::manifest) fn table_schema(keys: &[TableKey]) -> Json {
    let property = |key: &TableKey| {
        let mut schema = (key.schema)();
        schema["description"] = key.doc.trim().into();
        (key.name.to_owned(), schema)
    };
    let required = keys.iter().filter(|key| key.is_required).map(|key| key.name);
    json!({
        "type": "object",
        "additionalProperties": false,
        "required": required.collect::<Vec<_>>(),
        "properties": keys.iter().map(property).collect::<Map<_, _>>(),
    })
}

/// The key `name` of a table.
pub(in crate::manifest) const fn name_key(doc: &'static str) -> TableKey {
    TableKey { name: "name", doc, schema: || json!({ "$ref": "#/$defs/name" }), is_required: true }
}

/// The names of keys.
pub(in crate::manifest) fn names(keys: &[TableKey]) -> Vec<&'static str> {
    keys.iter().map(|key| key.name).collect()
}

/// A table that is being read.
pub(in crate::manifest) struct TableReader<'a, 'r> {
    pub reader: &'a mut Reader<'r>,
    /// The table in messages: `an [[estimate]]`.
    pub title: &'a str,
    /// The name that its key `name` gives it; empty without one.
    pub name: &'a str,
    /// Where the table begins.
    pub span: Span,
    pub table: &'a DeTable<'a>,
    /// What the table needs of the rest of the manifest.
    pub needs: Vec<Located<Need>>,
}

/// Something that a table names and that the rest of the manifest must have.
#[derive(Clone, Debug)]
pub(in crate::manifest) enum Need {
    /// Jobs that meet a condition.
    Jobs(Condition),
    /// Several values of a parameter.
    Values(Parameter),
    /// Several values of a parameter, all of them numbers.
    Numbers(Parameter),
}

impl<'a> TableReader<'a, '_> {
    /// The value of a key, if the table has it.
    pub fn node(&self, key: &str) -> Option<&'a Node<'a>> {
        self.table.get(key)
    }

    /// The position of the value of a key; of the table if it lacks the key.
    pub fn span_of(&self, key: &str) -> Span {
        self.node(key).map_or(self.span, |node| node.span().into())
    }

    /// The keys of these names that the table has, with the positions of their values.
    pub fn spans(&self, keys: &[&'static str]) -> Vec<(&'static str, Span)> {
        let given = keys.iter().filter(|key| self.node(key).is_some());
        given.map(|key| (*key, self.span_of(key))).collect()
    }

    /// Notes what the table needs of the rest of the manifest.
    pub fn need(&mut self, span: Span, value: Need) {
        self.needs.push(Located { value, span });
    }

    /// Notes that the table needs jobs that meet these conditions.
    pub fn need_jobs<'c>(
        &mut self,
        span: Span,
        conditions: impl IntoIterator<Item = &'c Condition>,
    ) {
        for condition in conditions {
            self.need(span, Need::Jobs(condition.clone()));
        }
    }

    /// Reports that a key is missing.
    pub fn missing(&mut self, key: &str, help: &str) {
        let fault = Fault::at(self.span, format!("missing key `{key}` in {}", self.title));
        self.reader.faults.add(fault.help(help));
    }

    /// Reads a field, which has its default or is reported as missing if the table lacks its key; `None` if it is
    /// faulty.
    pub fn field<F: Field>(
        &mut self,
        key: &str,
        kind: Option<Kind>,
        default: Option<F::Value>,
        missing: Option<&str>,
    ) -> Option<F::Value> {
        let is_given = F::KEYS.is_some() || self.node(key).is_some();
        match (default, missing) {
            (Some(default), _) if !is_given => Some(default),
            (None, Some(help)) if !is_given => {
                self.missing(key, help);
                None
            }
            _ => F::read(self, key, kind),
        }
    }
}

impl Reader<'_> {
    /// The table with each misspelt key under the name that was probably meant. Reports keys other than `known`.
    pub fn known_keys<'w, 't>(
        &mut self,
        title: &str,
        known: &[&str],
        written: &'w DeTable<'t>,
    ) -> Cow<'w, DeTable<'t>> {
        self.only_keys(title, known, written);
        respelt(written, known)
    }

    /// The name of one of the tables opened by `header`, which is added to `names`; empty if it is faulty. `missing` is
    /// the help for a table without a name, `twice` the help, if any, for a name that another table has.
    pub fn name_among(
        &mut self,
        (header, missing, twice): (&str, &str, Option<&str>),
        span: Span,
        table: &DeTable,
        names: &mut HashSet<String>,
    ) -> Located<String> {
        let Some(node) = table.get("name") else {
            let fault = Fault::at(span, format!("missing key `name` in an {header}"));
            self.faults.add(fault.help(missing));
            return Located { value: String::new(), span };
        };
        let name = self.name("name", node);
        if !name.value.is_empty() && !names.insert(name.value.clone()) {
            let message = format!("another {header} is called `{}`", name.value);
            let fault = Fault::at(name.span, message);
            self.faults.add(match twice {
                Some(help) => fault.help(help),
                None => fault,
            });
        }
        name
    }
}
