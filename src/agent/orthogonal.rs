//! Orthogonal initial weights.

use std::f64::consts::SQRT_2;

use crate::agent::layers::{self, Layer};
use crate::agent::memory::{self, OutOfMemory};
use crate::agent::weights::{Tensor, Weights};
use crate::kernel::math;
use crate::rng::{Purpose, Stream};

/// Number of partial sums of a scalar product, so that additions do not wait for each other.
const SUMS: usize = 8;

/// The gain of a layer's weights, by the name of the layer. Logits near 0 make all actions about
/// equally likely.
fn gain(name: &str) -> f64 {
    match name {
        "logits" => 0.01,
        "value" | "advantage" | "gru_input" | "gru_hidden" => 1.0,
        _ => SQRT_2,
    }
}

/// The initial weights of layers, drawn from the seed's own stream. Matrices are orthogonal, with
/// gain sqrt(2) for hidden layers, 1 for a GRU, 0.01 for logits and 1 for values and advantages.
/// Biases are 0.
///
/// **Source**: Huang et al., "The 37 implementation details of proximal policy optimization", 2022,
/// details 2 of PPO and 2 of its LSTM.
///
/// **Errors**: there is not enough memory for `copies` copies of the network's weights.
pub(super) fn initial(layers: &[Layer], copies: usize, seed: u64) -> Result<Weights, OutOfMemory> {
    memory::require(copies * size_of::<f32>() * layers::numbers(layers), "the network")?;
    let mut stream = Stream::new(seed, Purpose::InitialWeights);
    let mut weights = Weights::default();
    for layer in layers {
        insert(layer, gain(&layer.name), &mut stream, &mut weights)?;
    }
    Ok(weights)
}

fn insert(
    layer: &Layer,
    gain: f64,
    stream: &mut Stream,
    weights: &mut Weights,
) -> Result<(), OutOfMemory> {
    let shape = [layer.inputs, layer.outputs];
    let values = matrix(shape, gain, stream)?;
    weights.tensors.insert(layer.weight(), Tensor { shape: shape.to_vec(), values });
    let bias = Tensor { shape: vec![layer.outputs], values: vec![0.0; layer.outputs] };
    weights.tensors.insert(layer.bias(), bias);
    Ok(())
}

/// A random matrix in row-major order. The vectors along its shorter side are orthogonal and have
/// length `gain`; the matrix is uniformly distributed among such matrices.
///
/// Standard normal vectors are orthogonalised by the modified Gram-Schmidt process, which is a QR
/// decomposition with a positive diagonal.
///
/// **Source**: Saxe, McClelland and Ganguli, "Exact solutions to the nonlinear dynamics of learning
/// in deep linear neural networks", 2014; Mezzadri, "How to generate random matrices from the
/// classical compact groups", 2007 (the positive diagonal).
///
/// **Errors**: there is not enough memory.
pub(super) fn matrix(
    [rows, columns]: [usize; 2],
    gain: f64,
    stream: &mut Stream,
) -> Result<Vec<f32>, OutOfMemory> {
    let (vectors, length) = (rows.min(columns), rows.max(columns));
    let mut drawn: Vec<f64> = Vec::new();
    memory::reserve_exact(&mut drawn, vectors * length, "the network")?;
    drawn.extend((0..vectors * length).map(|_| normal(stream)));
    for vector in 0..vectors {
        let (before, rest) = drawn.split_at_mut(vector * length);
        let own = &mut rest[..length];
        for other in before.chunks_exact(length) {
            let along = scalar_product(own, other);
            own.iter_mut().zip(other).for_each(|(own, other)| *own -= along * other);
        }
        let norm = scalar_product(own, own).sqrt();
        own.iter_mut().for_each(|own| *own /= norm);
    }
    let at = |row: usize, column: usize| {
        let index = if rows <= columns { row * length + column } else { column * length + row };
        (gain * drawn[index]) as f32
    };
    let entries = (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
    Ok(entries.map(|(row, column)| at(row, column)).collect())
}

fn scalar_product(left: &[f64], right: &[f64]) -> f64 {
    let mut sums = [0.0; SUMS];
    for (left, right) in left.chunks(SUMS).zip(right.chunks(SUMS)) {
        sums.iter_mut().zip(left.iter().zip(right)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    sums.iter().sum()
}

/// A standard normal deviate.
///
/// **Source**: Box and Muller, "A note on the generation of random normal deviates", 1958.
fn normal(stream: &mut Stream) -> f64 {
    // In (0, 1], where the logarithm is finite.
    let radius = 1.0 - stream.unit();
    math::root(-2.0 * math::ln(radius)) * math::cos_turns(stream.unit())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::Ppo;
    use crate::agent::Shape;

    fn stream() -> Stream {
        Stream::new(3, Purpose::InitialWeights)
    }

    #[test]
    fn the_shorter_side_is_orthogonal_with_the_gain_as_length() {
        for (shape, gain) in [([3, 64], 1.5), ([64, 64], 1.0), ([64, 4], 0.01), ([1, 5], 2.0)] {
            let [rows, columns] = shape;
            let values = matrix(shape, gain, &mut stream()).unwrap();
            let vector = |i: usize| -> Vec<f64> {
                let at = |k: usize| if rows <= columns { i * columns + k } else { k * columns + i };
                (0..rows.max(columns)).map(|k| f64::from(values[at(k)])).collect()
            };
            for i in 0..rows.min(columns) {
                for j in 0..=i {
                    let product = scalar_product(&vector(i), &vector(j)) / (gain * gain);
                    let expected = if i == j { 1.0 } else { 0.0 };
                    assert!((product - expected).abs() < 1e-6, "{shape:?} {i} {j}: {product}");
                }
            }
        }
    }

    #[test]
    fn orthogonal_matrices_are_uniformly_distributed() {
        // The entries of a uniform orthogonal matrix have mean 0 and variance 1/n. The angle of the
        // first column in the plane is uniform, so each quadrant has probability 1/4.
        let mut stream = stream();
        let mut quadrants = [0; 4];
        for _ in 0..4000 {
            let values = matrix([2, 2], 1.0, &mut stream).unwrap();
            let quadrant = usize::from(values[0] > 0.0) + 2 * usize::from(values[2] > 0.0);
            quadrants[quadrant] += 1;
        }
        // 1000 expected, standard deviation 27.
        assert!(quadrants.iter().all(|count: &i32| (count - 1000).abs() < 110), "{quadrants:?}");
    }

    #[test]
    fn normal_numbers_have_their_moments() {
        let mut stream = stream();
        let drawn: Vec<f64> = (0..100_000).map(|_| normal(&mut stream)).collect();
        let moment = |power| drawn.iter().map(|x: &f64| x.powi(power)).sum::<f64>() / 1e5;
        // Standard deviations of the means: 0.0032, 0.0045, 0.031.
        assert!(moment(1).abs() < 0.013, "{}", moment(1));
        assert!((moment(2) - 1.0).abs() < 0.018, "{}", moment(2));
        assert!((moment(4) - 3.0).abs() < 0.13, "{}", moment(4));
    }

    #[test]
    fn layers_have_their_gains_and_no_bias() {
        let layers = layers::ppo(
            &Ppo { layers: vec![8, 6], ..Ppo::default() },
            Shape { inputs: 3, actions: 4 },
        );
        let weights = initial(&layers, 1, 5).unwrap();
        let lengths = [
            ("policy_trunk.0", 3.0 * 2.0),
            ("policy_trunk.1", 6.0 * 2.0),
            ("logits", 4.0 * 1e-4),
            ("value_trunk.0", 3.0 * 2.0),
            ("value_trunk.1", 6.0 * 2.0),
            ("value", 1.0),
        ];
        assert_eq!(weights.tensors.len(), 2 * lengths.len());
        for (name, expected) in lengths {
            let values = &weights.tensors[&format!("{name}.weight")].values;
            let squares: f64 = values.iter().map(|v| f64::from(*v).powi(2)).sum();
            assert!((squares / expected - 1.0).abs() < 1e-6, "{name}: {squares}");
            assert!(weights.tensors[&format!("{name}.bias")].values.iter().all(|b| *b == 0.0));
        }
        assert_eq!(initial(&layers, 1, 5).unwrap(), weights);
        assert_ne!(initial(&layers, 1, 6).unwrap(), weights);
    }
}
