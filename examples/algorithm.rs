//! An algorithm of your own on Burn: REINFORCE with an entropy bonus, registered and run.
use burn::tensor::Tensor;
use jitai::algorithm::*;
use jitai::experiment::{self, Event, Options, Selection, Store};
use jitai::policy::{Choice, NetworkPolicy};
use jitai::results::{Parts, Reader, summarise_arms};
jitai::keys! {
    /// A policy gradient with an entropy bonus.
    struct EntropyBonus {
        /// episodes of training
        episodes: u32 = 300, in Kind::EPISODES;
        /// weight of the policy's entropy, in steps walked
        bonus: f64 = 100.0, in Kind::NON_NEGATIVE;
    }
}
impl PolicyGradient for EntropyBonus {
    fn shapes(&self, Shape { inputs, actions }: Shape) -> Vec<[usize; 2]> {
        vec![[inputs, 16], [16, actions]]
    }
    fn logits(&self, weights: &[Tensor<2>], observations: Tensor<2>) -> Tensor<2> {
        observations.matmul(weights[0].clone()).tanh().matmul(weights[1].clone())
    }
    fn loss(&self, log_p: Tensor<2>, taken: Tensor<2>, returns: Tensor<2>) -> Tensor<1> {
        let entropy = -(log_p.clone().exp() * log_p).sum_dim(1);
        -(taken * returns + entropy * self.bonus).mean()
    }
}
impl AlgorithmParameters for EntropyBonus {
    const NAME: &'static str = "entropy_bonus";
    fn episodes(&self) -> u32 {
        self.episodes
    }
    fn start(&self, at: &Task) -> Result<Start, StartError> {
        let policy = AutodiffPolicy::new(self.clone(), at.shape(), 0.01, at.seed);
        let reinforce = Reinforce::default();
        let learner = ReinforceLearner::new(policy, &reinforce, at.simulation(1), at.seed);
        Ok(Start::Learner(Box::new(learner)))
    }
    fn network(&self, shape: Shape, weights: &Weights) -> Result<NetworkPolicy, WeightsError> {
        let network = Box::new(AutodiffPolicy::trained(self.clone(), shape, weights)?);
        Ok(NetworkPolicy { network, choice: Choice::Softmax, architecture: None })
    }
}
const MANIFEST: &str = "format = 1\nname = 'own'\nscenarios = ['P-H-D']\nseeds = 2\n\
    environment.sigma = 0.4\n[[agent]]\nname = 'own'\nalgorithm = 'entropy_bonus'\n";
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    register_algorithm::<EntropyBonus>()?;
    let manifests = [experiment::parse("own.toml", MANIFEST.as_bytes())?];
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("own.sqlite");
    let (mut store, stop) = (Store::open(&path)?, false.into());
    let selection = Selection::new(&manifests, None)?;
    experiment::run(&mut store, &selection, Options::default(), &stop, &mut |_: Event<'_>| {})?;
    let jobs = experiment::jobs(&manifests[0]);
    let data = Reader::open(&path)?.data_set(&manifests[0].name, jobs, Parts::default())?;
    let mean = summarise_arms(&data.jobs)[0].returns.mean()?;
    assert!(mean > 1000.0, "mean return: {mean}");
    Ok(())
}
