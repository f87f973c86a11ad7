//! A module with its optimiser.

use std::io;
use std::mem;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Gradients, Tensor, TensorData};

use crate::agent::burn::numbers;
use crate::kernel::{Adam, Aligned, Isa, LANES, clip_norm};
use crate::state::{Resumable, StateError, StateReader, StateWriter, resumable};

/// A module, its parameters as one array, and Adam on that array.
///
/// Burn's own Adam takes a dozen operations for each tensor of parameters, however small.
#[derive(Clone, Debug)]
pub(super) struct Trainer<M> {
    module: M,
    /// The module without gradients; set by the first evaluation after a step.
    evaluated: Option<M>,
    parameters: Aligned,
    /// 0 between steps.
    gradient: Aligned,
    adam: Adam,
}

impl<M: Module> Trainer<M> {
    /// The trainer of a module on the training device.
    pub(super) fn new(module: M, learning_rate: f64) -> Self {
        Trainer::with_adam(module, |parameters| Adam::new(learning_rate, parameters))
    }

    /// The trainer with another epsilon of Adam.
    pub(super) fn with_epsilon(module: M, learning_rate: f64, epsilon: f64) -> Self {
        Trainer::with_adam(module, |parameters| {
            Adam::with_epsilon(learning_rate, epsilon, parameters)
        })
    }

    fn with_adam(module: M, adam: impl Fn(usize) -> Adam) -> Self {
        let parameters = parameters(&module);
        let (gradient, adam) = (Aligned::zeros(parameters.len()), adam(parameters.len()));
        Trainer { module, evaluated: None, parameters, gradient, adam }
    }

    /// The module that is trained.
    pub(super) fn module(&self) -> &M {
        &self.module
    }

    /// The module without gradients.
    pub(super) fn evaluated(&mut self) -> &mut M {
        self.evaluated.get_or_insert_with(|| self.module.valid())
    }

    /// Sets the step size of later steps.
    pub(super) fn set_learning_rate(&mut self, learning_rate: f64) {
        self.adam.set_learning_rate(learning_rate);
    }

    /// One step of Adam on a loss of [`Trainer::module`]. A gradient whose norm exceeds `most` is
    /// scaled down to it.
    pub(super) fn step(&mut self, loss: &Tensor<1>, most: Option<f32>) {
        let gradients = loss.backward();
        self.module.visit(&mut Differentiated { gradients, rest: &mut self.gradient });
        let isa = Isa::chosen();
        if let Some(most) = most {
            clip_norm(isa, &mut self.gradient, most);
        }
        self.adam.update(isa, &mut self.parameters, &mut self.gradient);
        self.renew();
    }

    /// Makes the module of the parameters.
    fn renew(&mut self) {
        self.evaluated = None;
        self.module = with_parameters(&self.module, &self.parameters);
    }
}

resumable!([M: Module] Trainer<M> { parts adam; fixed parameters; then renew });

/// A network that is trained, and its target network.
pub struct BurnDqn<N> {
    pub(super) network: Trainer<N>,
    pub(super) target: N,
}

impl<N: Module> BurnDqn<N> {
    /// Both networks from one module on the training device.
    pub(super) fn of(network: N, learning_rate: f64) -> Self {
        BurnDqn { target: network.valid(), network: Trainer::new(network, learning_rate) }
    }

    /// Copies the network into the target network.
    pub(super) fn copy_to_target(&mut self) {
        self.target = self.network.evaluated().clone();
    }

    /// One step of Adam on a loss of the network; returns the loss. Takes no step if it is not finite.
    pub(super) fn learn(&mut self, loss: &Tensor<1>) -> f32 {
        let value: f32 = loss.clone().into_scalar();
        if value.is_finite() {
            self.network.step(loss, None);
        }
        value
    }
}

impl<N: Module> Resumable for BurnDqn<N> {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        self.network.save(out)?;
        out.many(&parameters(&self.target))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.network.restore(from)?;
        let mut saved = parameters(&self.target);
        from.fill(&mut saved, "weights")?;
        self.target = with_parameters(&self.target, &saved);
        Ok(())
    }
}

/// The parameters of a module one after the other, in the order in which Burn visits them, followed
/// by zeros up to whole [`LANES`].
fn parameters(module: &impl Module) -> Aligned {
    let mut parameters = Aligned::zeros(module.num_params().next_multiple_of(LANES));
    module.visit(&mut Read(&mut parameters));
    parameters
}

/// The module with other parameters, in the order of [`parameters`].
fn with_parameters<M: Module>(module: &M, parameters: &[f32]) -> M {
    // Burn's mapping consumes a module and returns it.
    module.clone().map(&mut Replaced(parameters))
}

/// Reads parameters into the array.
struct Read<'a>(&'a mut [f32]);

impl ModuleVisitor for Read<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let values = numbers(param.val());
        next(&mut self.0, values.len()).copy_from_slice(&values);
    }
}

/// Reads the gradients of parameters into the array.
struct Differentiated<'a> {
    gradients: Gradients,
    rest: &'a mut [f32],
}

impl ModuleVisitor for Differentiated<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let parameter = param.val();
        let gradient = next(&mut self.rest, parameter.shape().num_elements());
        // The gradient of a parameter on which the loss does not depend stays 0.
        if let Some(found) = parameter.grad_remove(&mut self.gradients) {
            gradient.copy_from_slice(&numbers(found));
        }
    }
}

/// Replaces parameters by the values of the array.
struct Replaced<'a>(&'a [f32]);

impl ModuleMapper for Replaced<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (id, old, mapper) = param.consume();
        let (values, rest) = self.0.split_at(old.shape().num_elements());
        self.0 = rest;
        let new = Tensor::from_data(TensorData::new(values.to_vec(), old.shape()), &old.device());
        Param::from_mapped_value(id, new.set_require_grad(old.is_require_grad()), mapper)
    }
}

/// Takes the next numbers of an array.
fn next<'a>(rest: &mut &'a mut [f32], count: usize) -> &'a mut [f32] {
    let (next, after) = mem::take(rest).split_at_mut(count);
    *rest = after;
    next
}

#[cfg(test)]
mod tests {
    use burn::optim::{AdamConfig, GradientsParams};

    use super::*;
    use crate::agent::Shape;
    use crate::agent::burn::{BurnNetwork, PolicyNetwork, device, matrix};
    use crate::agent::{Reinforce, layers};
    use crate::rng::{Purpose, Stream};

    fn network() -> PolicyNetwork {
        let parameters = Reinforce { layers: vec![5, 3], ..Reinforce::default() };
        let stack = layers::policy(&parameters, Shape::of_four(2));
        let weights = layers::draw(&[stack], &mut Stream::new(3, Purpose::InitialWeights));
        PolicyNetwork::from_weights(&parameters, Shape::of_four(2), &weights, &device::training())
            .unwrap()
    }

    /// A loss whose gradient is large at first and small later.
    fn loss(network: &PolicyNetwork, step: usize) -> Tensor<1> {
        let inputs = (0..14).map(|i| ((i * 31 + step * 17) % 13) as f32 / 6.0 - 1.0).collect();
        let logits = network.forward(matrix(inputs, 7, &device::training()));
        logits.add_scalar(3.0).square().mean()
    }

    fn assert_close(ours: &PolicyNetwork, theirs: &PolicyNetwork) {
        let theirs = theirs.weights();
        for (name, ours) in ours.weights().tensors {
            for (ours, theirs) in ours.values.iter().zip(&theirs.tensors[&name].values) {
                assert!((ours - theirs).abs() < 2e-5, "{name}: {ours} is not {theirs}");
            }
        }
    }

    #[test]
    fn steps_are_those_of_burns_adam() {
        let mut theirs = network();
        let mut adam = AdamConfig::new().with_epsilon(1e-5).init();
        let mut ours = Trainer::with_epsilon(network(), 0.01, 1e-5);
        for step in 0..200 {
            let gradients = GradientsParams::from_grads(loss(&theirs, step).backward(), &theirs);
            theirs = adam.step(0.01, theirs, gradients);
            ours.step(&loss(ours.module(), step), None);
        }
        assert_close(ours.module(), &theirs);
        assert_close(ours.evaluated(), &theirs);
        assert!(numbers(loss(ours.module(), 0))[0] < 0.5 * numbers(loss(&network(), 0))[0]);
    }

    #[test]
    fn only_gradients_with_a_larger_norm_are_scaled() {
        // Adam's first step depends on the size of a gradient because of this epsilon.
        let trained = |most| {
            let mut trainer = Trainer::with_epsilon(network(), 0.01, 10.0);
            trainer.step(&loss(trainer.module(), 0), most);
            numbers(loss(trainer.module(), 0))[0]
        };
        assert_eq!(trained(None).to_bits(), trained(Some(1e6)).to_bits());
        assert!(trained(Some(0.1)) > trained(None));
        assert!(trained(Some(0.01)) > trained(Some(0.1)));
    }

    #[test]
    fn restored_trainers_and_modules_continue_to_the_same_bits() {
        let mut dqn = BurnDqn::of(network(), 0.01);
        let whole = &mut dqn.network;
        (0..20).for_each(|step| whole.step(&loss(whole.module(), step), None));
        dqn.copy_to_target();
        let mut bytes = Vec::new();
        dqn.save(&mut StateWriter::new(&mut bytes)).unwrap();

        let mut restored = BurnDqn::of(network(), 0.01);
        let mut rest = &bytes[..];
        restored.restore(&mut StateReader::new(&mut rest)).unwrap();
        let (mut whole, mut resumed) = (dqn.network, restored.network);
        assert_eq!(restored.target.weights(), whole.module().weights());
        for trainer in [&mut whole, &mut resumed] {
            (20..40).for_each(|step| trainer.step(&loss(trainer.module(), step), None));
        }
        assert_eq!(resumed.module().weights(), whole.module().weights());
        assert_ne!(restored.target.weights(), whole.module().weights());
    }
}
