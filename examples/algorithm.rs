//! An algorithm of your own: a linear softmax policy, trained by Burn, registered and run.
use jitai::*;

keys! {
    /// A linear softmax policy.
    struct Linear {
        /// episodes of training
        episodes: u32 = 300, in Kind::EPISODES;
        /// step size of the gradient
        learning_rate: f64 = 0.001, in Kind::PositiveReal { max: 1.0 };
    }
}
impl AlgorithmParameters for Linear {
    const NAME: &'static str = "linear";
    fn episodes(&self) -> u32 {
        self.episodes
    }
    fn start(&self, setting: &Setting) -> Result<Start, StartError> {
        let shape = [setting.observations().inputs(), Action::COUNT];
        let policy = Policy(WeightTensor::zeros(shape), self.learning_rate);
        let lanes = PhysicalActivity::new(setting.environment, setting.scenario, 1);
        let learner = ReinforceLearner::new(policy, &Reinforce::default(), lanes, setting.seed);
        Ok(Start::Learner(Box::new(learner)))
    }
    fn trained(
        &self,
        at: &Setting,
        from: &Weights,
        by: Actions,
    ) -> Result<Box<dyn Actor>, WeightsError> {
        let spec = at.observations();
        let policy = Policy(from.tensor("w", &[spec.inputs(), Action::COUNT])?.clone(), 0.0);
        Ok(Box::new(SoftmaxPolicy::new(policy, by, spec.observations())))
    }
}
/// Weights, [inputs, actions], and the step size.
#[derive(Clone)]
struct Policy(WeightTensor, f64);
impl ActionNetwork for Policy {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        let (device, weights) = (inference_device(), self.0.to_burn::<2>(&inference_device()));
        *out =
            WeightTensor::of_burn(observation_tensor(observations, &device).matmul(weights)).values;
    }
}
impl ReinforceEngine for Policy {
    type Network = Policy;
    fn update(&mut self, steps: &Trajectories) -> f32 {
        let device = training_device();
        let weights = self.0.to_burn::<2>(&device).require_grad();
        let logits = observation_tensor(&steps.observations, &device).matmul(weights.clone());
        let log_p = burn::tensor::activation::log_softmax(logits, 1);
        let returns = WeightTensor::column(&steps.returns_to_go).to_burn(&device);
        let loss = -(log_p.gather(1, action_tensor(&steps.actions, &device)) * returns).mean();
        let gradient = weights.grad(&loss.backward()).expect("the loss depends on the weights");
        self.0 = WeightTensor::of_burn(weights.inner() - gradient * self.1);
        loss.into_scalar()
    }
    fn network(&self) -> Policy {
        self.clone()
    }
    fn weights(&self) -> Weights {
        Weights::of([("w", self.0.clone())])
    }
}
impl Resumable for Policy {
    fn save(&self, out: &mut StateWriter<'_>) -> std::io::Result<()> {
        out.many(&self.0.values)
    }
    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.fill(&mut self.0.values, "weights")
    }
}
const MANIFEST: &str = "format = 1\nname = 'own'\nscenarios = ['P-H-D']\nseeds = 2\n\
    environment.sigma = 0.4\n[[agent]]\nname = 'own'\nalgorithm = 'linear'\n";
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    register::<Linear>()?;
    let manifests = [parse_manifest("own.toml", MANIFEST.as_bytes())?];
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("own.sqlite");
    run_manifests(&mut Store::open(&path)?, &manifests, Options::default(), |_| {})?;
    let jobs = jobs(&manifests[0]);
    let data = Reader::open(&path)?.data_set("own", jobs, DataParts::default(), |_| {})?;
    println!("mean return: {:.0}", summarise_arms(&data.jobs)[0].returns.mean()?);
    Ok(())
}
