//! A fit of 500 people with 200 decisions and 12 coefficients each, with 200 simulated pilots.

use std::fmt::Write;
use std::sync::atomic::AtomicBool;

use jitai::env::declared::Pilot;
use jitai::fit::{Check, Fit, Fitting};
use jitai::rng::{Purpose, Stream};

fn main() {
    divan::main();
}

const PEOPLE: usize = 500;
const DECISIONS: usize = 200;

fn model(draw: &str) -> String {
    format!(
        "format = 1\ntitle = \"a fit\"\ndecisions_per_day = 2\ndays = 100\n[replay]\ncolumns = [\"u\", \"v\", \"w\"]\n[linear]\n\
         base = {{ prefix = \"b_\", features = [\"u\", \"v\", \"w\", \"dose\", \"slot_now\", \"1\"] }}\n\
         gain = {{ prefix = \"g_\", features = [\"u\", \"v\", \"w\", \"dose\", \"1\"] }}\n[variables]\nslot_now = \"slot\"\n\
         dose = \"0.8 * default(dose[-1], 0) + default(action[-1], 0)\"\ny = {{ {draw} }}\n[roles]\noutcome = \"y\"\n\
         features = [\"u\", \"dose\"]\n[fit]\nperson = \"id\"\norder = \"t\"\naction = \"sent\"\nprobability = \"0.5\"\n\
         columns = {{ y = \"y\" }}\nmethod = \"map\"\n"
    )
}

fn data() -> String {
    let mut text = "id,t,sent,u,v,w,y\n".to_owned();
    let mut stream = Stream::new(1, Purpose::Environment);
    for person in 0..PEOPLE {
        for decision in 0..DECISIONS {
            let [u, v, w, y] = [0; 4].map(|_| stream.unit());
            let (sent, y) = (stream.below(2), (y * 4.0) as u32);
            writeln!(text, "p{person},{decision},{sent},{u:.4},{v:.4},{w:.4},{y}").unwrap();
        }
    }
    text
}

#[divan::bench(sample_count = 1, sample_size = 1, args = [
    "gaussian = [\"base + action * gain\", \"sd\"]",
    "poisson = { log_mean = \"base + action * gain\" }",
    "zero_inflated_poisson = [\"base\", \"base + action * gain\"]",
])]
fn with_simulated_pilots(bencher: divan::Bencher, draw: &str) {
    let (model, data, stop) = (model(draw), data(), AtomicBool::new(false));
    bencher.bench_local(|| {
        let pilot = Pilot::read(&model, data.as_bytes(), &|| false).unwrap();
        let mut ignore = |_, _| {};
        let mut fitting = Fitting { stop: &stop, progress: &mut ignore };
        let fit = Fit::new(&pilot, &mut fitting).unwrap();
        Check::new(&pilot, &fit, (1, 200), &mut fitting).unwrap()
    });
}
