//! The canonical form of keyed values: one text per content, even if keys are added later.

use serde_json::{Map, Value as Json};

use super::declare::{Key, json_object};
use super::value::Value;

/// Why an object is not the canonical form of some keys.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CanonicalError {
    /// A key without a value of earlier jobs is missing.
    #[error("key `{0}` is missing")]
    Missing(String),
    /// The table does not have this key.
    #[error("key `{0}` is unknown")]
    Unknown(String),
    /// The value of a key has another type.
    #[error("key `{0}` has a value of another type")]
    WrongType(String),
    /// A key is written although it has the value that the canonical form omits.
    #[error("key `{0}` has the value that is omitted in canonical form")]
    Redundant(String),
}

/// The object of [`json_object`] without keys that have the value of earlier jobs. Its text is canonical:
/// names in alphabetical order, numbers in the shortest form that parses to the same number.
///
/// **Shapes**: one value for each key, in their order.
pub fn canonical_object(keys: &[Key], values: &[Value]) -> Map<String, Json> {
    let mut object = json_object(keys, values);
    for (key, value) in keys.iter().zip(values) {
        if key.before().as_ref() == Some(value) {
            object.remove(key.name);
        }
    }
    object
}

/// The value of each key in an object that [`canonical_object`] wrote, possibly before some of the keys
/// were added.
///
/// **Errors**: the object is not a canonical form of these keys.
pub fn read_object(keys: &[Key], object: &Map<String, Json>) -> Result<Vec<Value>, CanonicalError> {
    if let Some(name) = object.keys().find(|name| keys.iter().all(|key| key.name != **name)) {
        return Err(CanonicalError::Unknown(name.clone()));
    }
    let value = |key: &Key| {
        let name = || key.name.to_owned();
        let before = key.before();
        let Some(json) = object.get(key.name) else {
            return before.ok_or_else(|| CanonicalError::Missing(name()));
        };
        let value = key.kind.value(json).ok_or_else(|| CanonicalError::WrongType(name()))?;
        if before.as_ref() == Some(&value) {
            return Err(CanonicalError::Redundant(name()));
        }
        Ok(value)
    };
    keys.iter().map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::key::{Keyed, Kind};

    crate::keys! {
        /// A simulation as it was when its first jobs were stored.
        struct Early {
            /// decay
            decay: f64 = 0.5, in Kind::PROBABILITY;
            /// widths
            widths: Vec<u32> = vec![8], in Kind::Widths { most: 2, max: 9 };
        }
    }

    crate::keys! {
        /// The same simulation with two more keys; the default of `noise` differs from the value of earlier jobs.
        struct Later {
            /// noise
            noise: f64 = 0.2, before 0.0, in Kind::PROBABILITY;
            /// decay
            decay: f64 = 0.5, in Kind::PROBABILITY;
            /// widths
            widths: Vec<u32> = vec![8], in Kind::Widths { most: 2, max: 9 };
            /// whether it wraps around
            wraps: bool = false, before false;
        }
    }

    fn text<T: Keyed>(keyed: &T) -> String {
        Json::Object(canonical_object(T::KEYS, &keyed.to_values())).to_string()
    }

    fn read<T: Keyed>(text: &str) -> Result<T, CanonicalError> {
        let json: Json = serde_json::from_str(text).unwrap();
        let values = read_object(T::KEYS, json.as_object().unwrap())?;
        Ok(T::from_values(&values).unwrap())
    }

    #[test]
    fn a_key_that_is_added_changes_no_form_at_the_value_of_earlier_jobs() {
        let early = Early { decay: 0.25, widths: vec![3, 4] };
        let later = Later { noise: 0.0, decay: 0.25, widths: vec![3, 4], wraps: false };
        assert_eq!(text(&early), r#"{"decay":0.25,"widths":[3,4]}"#);
        assert_eq!(text(&later), text(&early));
        assert_eq!(read::<Later>(&text(&early)), Ok(later.clone()));
        let other = Later { noise: 0.2, ..later };
        assert_eq!(text(&other), r#"{"decay":0.25,"noise":0.2,"widths":[3,4]}"#);
        assert_eq!(read::<Later>(&text(&other)), Ok(other));
    }

    #[test]
    fn one_content_has_one_spelling() {
        for (spelling, error) in [
            (
                r#"{"decay":0.25,"noise":0.0,"widths":[3]}"#,
                CanonicalError::Redundant("noise".into()),
            ),
            (
                r#"{"decay":0.25,"widths":[3],"wraps":false}"#,
                CanonicalError::Redundant("wraps".into()),
            ),
            (r#"{"widths":[3]}"#, CanonicalError::Missing("decay".into())),
            (r#"{"decay":0.25,"drift":1,"widths":[3]}"#, CanonicalError::Unknown("drift".into())),
            (r#"{"decay":true,"widths":[3]}"#, CanonicalError::WrongType("decay".into())),
        ] {
            assert_eq!(read::<Later>(spelling), Err(error), "{spelling}");
        }
    }

    #[test]
    fn defaults_and_values_of_earlier_jobs_are_two_things() {
        let [noise, decay, _, wraps] = Later::KEYS else { panic!("four keys") };
        assert_eq!(
            (noise.default(), noise.before()),
            (Some(Value::Real(0.2)), Some(Value::Real(0.0)))
        );
        assert_eq!((decay.default(), decay.before()), (Some(Value::Real(0.5)), None));
        assert_eq!((wraps.kind, wraps.doc()), (Kind::Flag, "whether it wraps around"));
    }
}
