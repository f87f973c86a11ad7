//! Weights as plain numbers, with conversion to and from safetensors files.

use std::collections::BTreeMap;
use std::collections::HashMap;

use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use crate::agent::network::NoEngine;

/// A named array of weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor<Number = f32> {
    /// Lengths of the axes: \[inputs, outputs\] of a weight matrix, \[outputs\] of a bias.
    pub shape: Vec<usize>,
    /// Values, row by row.
    pub values: Vec<Number>,
}

/// The weights of a network by name (`trunk.0.weight`), with additional numbers that a policy needs
/// (`epsilon`).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Weights {
    /// Arrays by name.
    pub tensors: BTreeMap<String, Tensor>,
    /// Arrays in double precision; their names differ from those in `tensors`.
    pub doubles: BTreeMap<String, Tensor<f64>>,
    /// Numbers by name.
    pub numbers: BTreeMap<String, f64>,
}

/// Why weights cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The bytes are not a safetensors file.
    #[error("read weights: {0}")]
    Format(#[from] safetensors::SafeTensorError),
    /// An array is missing, or its shape or type is different.
    #[error("the weights lack an array `{name}` of shape {shape:?} and the right type")]
    Missing {
        /// The name of the array.
        name: String,
        /// The shape that the network needs.
        shape: Vec<usize>,
    },
    /// A number is missing.
    #[error("the weights lack the number `{0}`")]
    MissingNumber(String),
    /// The weights are not a posterior of a regression.
    #[error("the precision of a regression is not positive definite")]
    NotPositiveDefinite,
    /// The agent is a rule or has no network for another reason.
    #[error("the agent has no network")]
    NoNetwork,
    /// The program was built without the engine of the network.
    #[error(transparent)]
    NoEngine(#[from] NoEngine),
    /// The agent is a user's program.
    #[error("the policy of an outside program is not stored")]
    Outside,
}

impl Weights {
    /// The array with this name and shape.
    ///
    /// **Errors**: there is no such array.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<&Tensor, WeightsError> {
        self.tensors
            .get(name)
            .filter(|tensor| tensor.shape == shape)
            .ok_or_else(|| WeightsError::Missing { name: name.to_owned(), shape: shape.to_vec() })
    }

    /// The array with this name and shape in double precision.
    ///
    /// **Errors**: there is no such array.
    pub fn double(&self, name: &str, shape: &[usize]) -> Result<&Tensor<f64>, WeightsError> {
        self.doubles
            .get(name)
            .filter(|tensor| tensor.shape == shape)
            .ok_or_else(|| WeightsError::Missing { name: name.to_owned(), shape: shape.to_vec() })
    }

    /// The number with this name.
    ///
    /// **Errors**: there is no such number.
    pub fn number(&self, name: &str) -> Result<f64, WeightsError> {
        let number = self.numbers.get(name).copied();
        number.ok_or_else(|| WeightsError::MissingNumber(name.to_owned()))
    }

    /// Whether every weight is finite.
    pub fn are_finite(&self) -> bool {
        self.tensors.values().all(|tensor| tensor.values.iter().all(|v| v.is_finite()))
            && self.doubles.values().all(|tensor| tensor.values.iter().all(|v| v.is_finite()))
    }

    /// The weights as a safetensors file, with numbers in its metadata. Equal weights give equal
    /// bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let singles = self.tensors.iter().map(|(name, tensor)| {
            let bytes: Vec<u8> = tensor.values.iter().flat_map(|v| v.to_le_bytes()).collect();
            (name, Dtype::F32, &tensor.shape, bytes)
        });
        let doubles = self.doubles.iter().map(|(name, tensor)| {
            let bytes: Vec<u8> = tensor.values.iter().flat_map(|v| v.to_le_bytes()).collect();
            (name, Dtype::F64, &tensor.shape, bytes)
        });
        let arrays: Vec<_> = singles.chain(doubles).collect();
        let views = arrays.iter().map(|(name, dtype, shape, bytes)| {
            let view = TensorView::new(*dtype, (*shape).clone(), bytes)
                .expect("the bytes were made from the values, and the shape is theirs");
            (name.as_str(), view)
        });
        // A single entry, because the order of several entries in a hash map would vary.
        let numbers = serde_json::to_string(&self.numbers).expect("a map of finite numbers");
        let metadata = HashMap::from([("numbers".to_owned(), numbers)]);
        safetensors::serialize(views, Some(metadata)).expect("names are distinct")
    }

    /// The weights that [`Weights::to_bytes`] wrote.
    ///
    /// **Errors**: the bytes are not a safetensors file, or hold types other than f32 and f64.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WeightsError> {
        let file = SafeTensors::deserialize(bytes)?;
        let mut weights = Weights::default();
        for (name, view) in file.tensors() {
            let shape = view.shape().to_vec();
            let data = view.data();
            match view.dtype() {
                Dtype::F32 => {
                    let values =
                        data.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
                    weights.tensors.insert(name, Tensor { shape, values });
                }
                Dtype::F64 => {
                    let values =
                        data.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
                    weights.doubles.insert(name, Tensor { shape, values });
                }
                _ => return Err(WeightsError::Missing { name, shape }),
            }
        }
        let (_, header) = SafeTensors::read_metadata(bytes)?;
        if let Some(numbers) = header.metadata().as_ref().and_then(|m| m.get("numbers")) {
            weights.numbers = serde_json::from_str(numbers)
                .map_err(|_| WeightsError::MissingNumber("numbers".to_owned()))?;
        }
        Ok(weights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weights() -> Weights {
        let tensor = |shape: &[usize], values: &[f32]| Tensor {
            shape: shape.to_vec(),
            values: values.to_vec(),
        };
        Weights {
            tensors: BTreeMap::from([
                ("b".to_owned(), tensor(&[2, 1], &[1.5, f32::MIN_POSITIVE])),
                ("a".to_owned(), tensor(&[3], &[-0.0, 0.1, 3e38])),
            ]),
            doubles: BTreeMap::from([(
                "c".to_owned(),
                Tensor { shape: vec![2], values: vec![0.1, f64::MIN_POSITIVE] },
            )]),
            numbers: BTreeMap::from([("epsilon".to_owned(), 0.01), ("other".to_owned(), 1.0)]),
        }
    }

    #[test]
    fn weights_read_back_bit_by_bit_and_write_the_same_bytes() {
        let bytes = weights().to_bytes();
        let read = Weights::from_bytes(&bytes).unwrap();
        assert_eq!(read, weights());
        assert_eq!(read.tensors["a"].values[0].to_bits(), (-0.0f32).to_bits());
        assert_eq!(read.to_bytes(), bytes);
    }

    #[test]
    fn damaged_weights_are_an_error() {
        let bytes = weights().to_bytes();
        assert!(Weights::from_bytes(&bytes[..bytes.len() / 2]).is_err());
        assert!(Weights::from_bytes(b"").is_err());
        assert!(weights().tensor("a", &[4]).is_err());
        assert!(weights().number("absent").is_err());
    }
}
