//! Weights as plain numbers, and as a safetensors file.

use std::collections::BTreeMap;
use std::collections::HashMap;

use burn::tensor::{Device, Tensor as BurnTensor, TensorData};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

/// A named array of weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Lengths of the axes: \[inputs, outputs\] of a weight matrix, \[outputs\] of a bias.
    pub shape: Vec<usize>,
    /// Values, row by row.
    pub values: Vec<f32>,
}

impl Tensor {
    /// The values of a tensor of Burn.
    pub fn of_burn<const AXES: usize>(tensor: BurnTensor<AXES>) -> Tensor {
        let data = tensor.into_data();
        let shape = data.shape().as_slice().to_vec();
        Tensor { shape, values: data.try_to_vec().expect("networks compute in f32") }
    }

    /// The same values as a tensor of Burn.
    ///
    /// # Panics
    /// If the number of axes is another.
    pub fn to_burn<const AXES: usize>(&self, device: &Device) -> BurnTensor<AXES> {
        BurnTensor::from_data(TensorData::new(self.values.clone(), self.shape.clone()), device)
    }
}

/// The weights of a network by name (`trunk.0.weight`), with the numbers a policy needs beside
/// them (`epsilon`).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Weights {
    /// Arrays by name.
    pub tensors: BTreeMap<String, Tensor>,
    /// Numbers by name.
    pub numbers: BTreeMap<String, f64>,
}

/// Why weights cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The bytes are not a safetensors file.
    #[error("read weights: {0}")]
    Format(#[from] safetensors::SafeTensorError),
    /// An array is missing or of another shape or type.
    #[error("the weights have no f32 array `{name}` of shape {shape:?}")]
    Missing {
        /// Its name.
        name: String,
        /// The shape the network needs.
        shape: Vec<usize>,
    },
    /// A number is missing.
    #[error("the weights have no number `{0}`")]
    MissingNumber(String),
    /// The agent is a rule.
    #[error("a rule has no network to put weights into")]
    NoNetwork,
}

impl Weights {
    /// The array of this name and shape.
    ///
    /// **Errors**: there is none.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<&Tensor, WeightsError> {
        self.tensors
            .get(name)
            .filter(|tensor| tensor.shape == shape)
            .ok_or_else(|| WeightsError::Missing { name: name.to_owned(), shape: shape.to_vec() })
    }

    /// The number of this name.
    ///
    /// **Errors**: there is none.
    pub fn number(&self, name: &str) -> Result<f64, WeightsError> {
        let number = self.numbers.get(name).copied();
        number.ok_or_else(|| WeightsError::MissingNumber(name.to_owned()))
    }

    /// Whether every weight is finite.
    pub fn are_finite(&self) -> bool {
        self.tensors.values().all(|tensor| tensor.values.iter().all(|v| v.is_finite()))
    }

    /// The weights as a safetensors file; numbers go into its metadata. Equal weights make equal
    /// bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let bytes: Vec<Vec<u8>> = self
            .tensors
            .values()
            .map(|tensor| tensor.values.iter().flat_map(|v| v.to_le_bytes()).collect())
            .collect();
        let views = self.tensors.iter().zip(&bytes).map(|((name, tensor), bytes)| {
            let view = TensorView::new(Dtype::F32, tensor.shape.clone(), bytes)
                .expect("the bytes were made from the values, and the shape is theirs");
            (name.as_str(), view)
        });
        // One entry only: a hash map of several would be written in an order of its own.
        let numbers = serde_json::to_string(&self.numbers).expect("a map of finite numbers");
        let metadata = HashMap::from([("numbers".to_owned(), numbers)]);
        safetensors::serialize(views, Some(metadata)).expect("names are distinct")
    }

    /// Reads what [`Weights::to_bytes`] wrote.
    ///
    /// **Errors**: the bytes are no safetensors file, or hold other types than f32.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WeightsError> {
        let file = SafeTensors::deserialize(bytes)?;
        let mut weights = Weights::default();
        for (name, view) in file.tensors() {
            let shape = view.shape().to_vec();
            if view.dtype() != Dtype::F32 {
                return Err(WeightsError::Missing { name, shape });
            }
            let values = view
                .data()
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect();
            weights.tensors.insert(name, Tensor { shape, values });
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
