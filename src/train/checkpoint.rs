//! Checkpoints: the saved state of an unfinished training, from which another process can continue.
//!
//! A checkpoint consists of a line that names its format, a line of JSON that identifies the job and the
//! code, the state of the training, and the SHA-256 of these bytes. A checkpoint is accepted only if its
//! digest matches and the same code wrote it. [`Checkpoints`] decides where checkpoints are kept and when
//! they are due.

use std::fmt;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::agent::{self, OutOfMemory, StartError};
use crate::job::{EstimateDeclaration, Job, RunnableJob, Versions};
use crate::state::{Resumable, StateError, StateReader, StateWriter};
use crate::train::training::Training;

/// The first line. The number is raised whenever the meaning of a state's bytes changes.
const FORMAT: &str = "jitai checkpoint 8\n";
/// The number of bytes of the SHA-256 at the end.
const SEAL: usize = 32;

/// The keeper of the checkpoints of one training.
pub trait Checkpoints {
    /// Whether a checkpoint should be written at the next opportunity; queried at every step.
    fn are_due(&self) -> bool;

    /// Passes the checkpoints of the job's earlier runs to `read`, starting with the most advanced, until it
    /// accepts one.
    fn resume(&self, read: &mut ReadCheckpoint<'_>);

    /// Stores the output of `write` completely or not at all. The training continues in either case.
    fn keep(&self, write: &mut WriteCheckpoint<'_>);
}

/// Resumes from a checkpoint, or returns why it was rejected.
pub type ReadCheckpoint<'a> =
    dyn FnMut(&mut dyn CheckpointFile) -> Result<Resumed, CheckpointError> + 'a;

/// Writes a checkpoint.
pub type WriteCheckpoint<'a> = dyn FnMut(&mut dyn Write) -> io::Result<()> + 'a;

/// The bytes of a checkpoint, as in a file.
pub trait CheckpointFile: Read + Seek {}

impl<T: Read + Seek> CheckpointFile for T {}

/// The point at which a training resumes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resumed {
    /// Training episodes finished.
    pub episode: u32,
    /// Working time before the checkpoint.
    pub worked: Duration,
}

/// A keeper that keeps no checkpoints.
#[derive(Clone, Copy, Debug)]
pub struct KeptNowhere;

impl Checkpoints for KeptNowhere {
    fn are_due(&self) -> bool {
        false
    }

    fn resume(&self, _: &mut ReadCheckpoint<'_>) {}

    fn keep(&self, _: &mut WriteCheckpoint<'_>) {}
}

/// Why a checkpoint is rejected.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// The file could not be read.
    #[error("cannot be read: {0}")]
    Read(#[from] io::Error),
    /// Bytes have changed or are missing.
    #[error("damaged")]
    Damaged,
    /// The checkpoint has the format of another release.
    #[error("written by another release of jitai")]
    OtherFormat,
    /// Different code wrote the checkpoint; its results may differ in their last bits.
    #[error("written by different code: {theirs}; this is {ours}")]
    OtherCode {
        /// The code that wrote it.
        theirs: String,
        /// The code of this program.
        ours: String,
    },
    /// The checkpoint belongs to another job.
    #[error("belongs to another job, {0}")]
    OtherJob(String),
    /// Its test has begun with other estimates.
    #[error("its test has begun without the estimates that the manifest declares")]
    OtherEstimates,
    /// There is not enough memory.
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
    /// The state does not fit the job.
    #[error(transparent)]
    State(#[from] StateError),
}

/// The header of a checkpoint.
#[derive(Debug, Serialize, Deserialize)]
struct Header {
    job_key: String,
    code: Code,
    episode: u32,
    seconds: f64,
    /// The canonical texts of the declared estimates.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    estimates: Vec<String>,
}

/// The code that determines the exact results of a training after a checkpoint.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Code {
    release: String,
    environment: u32,
    algorithm: u32,
    backend: String,
}

impl Code {
    fn of_this_program(job: &Job) -> Code {
        let Versions { environment, algorithm } = job.versions();
        Code {
            release: env!("CARGO_PKG_VERSION").to_owned(),
            environment,
            algorithm,
            backend: agent::backend_name().to_owned(),
        }
    }
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Code { release, environment, algorithm, backend } = self;
        write!(f, "jitai {release}, simulation {environment}, algorithm {algorithm}, {backend}")
    }
}

/// Writes a training as a checkpoint. `worked` is the working time in this process.
pub(super) fn write(
    training: &Training<'_>,
    worked: Duration,
    out: &mut dyn Write,
) -> io::Result<()> {
    let job = training.job();
    let header = Header {
        job_key: job.key().to_string(),
        code: Code::of_this_program(&job),
        episode: training.episodes(),
        seconds: (training.before() + worked).as_secs_f64(),
        estimates: training.estimated().iter().map(|one| one.canonical()).collect(),
    };
    let mut sealing = BufWriter::with_capacity(1 << 16, Sealing { out, seal: Sha256::new() });
    sealing.write_all(FORMAT.as_bytes())?;
    serde_json::to_writer(&mut sealing, &header)?;
    sealing.write_all(b"\n")?;
    training.save(&mut StateWriter::new(&mut sealing))?;
    let Sealing { out, seal } = sealing.into_inner().map_err(|error| error.into_error())?;
    out.write_all(&seal.finalize())
}

/// Reads the training from a checkpoint of the job, with these estimates.
///
/// **Errors**: the checkpoint is damaged, belongs to another job, or was written by other code.
pub(super) fn read<'j>(
    job: RunnableJob<'j>,
    declared: &[Arc<EstimateDeclaration>],
    file: &mut dyn CheckpointFile,
) -> Result<Training<'j>, CheckpointError> {
    let length = file.seek(SeekFrom::End(0))?;
    let sealed = length.checked_sub(SEAL as u64).ok_or(CheckpointError::Damaged)?;
    file.rewind()?;
    let mut start = [0; FORMAT.len()];
    file.read_exact(&mut start).map_err(|_| CheckpointError::Damaged)?;
    if start != FORMAT.as_bytes() {
        let of_ours = start.starts_with(b"jitai checkpoint ");
        return Err(if of_ours { CheckpointError::OtherFormat } else { CheckpointError::Damaged });
    }
    file.rewind()?;
    check_seal(file, sealed)?;
    file.seek(SeekFrom::Start(FORMAT.len() as u64))?;
    let mut from = BufReader::with_capacity(1 << 16, file.take(sealed - FORMAT.len() as u64));
    let mut line = Vec::new();
    from.read_until(b'\n', &mut line)?;
    let header: Header = serde_json::from_slice(&line).map_err(|_| CheckpointError::OtherFormat)?;
    let ours = Code::of_this_program(&job);
    if header.code != ours {
        let (theirs, ours) = (header.code.to_string(), ours.to_string());
        return Err(CheckpointError::OtherCode { theirs, ours });
    }
    if header.job_key != job.key().to_string() {
        return Err(CheckpointError::OtherJob(header.job_key));
    }
    let worked = Duration::try_from_secs_f64(header.seconds).unwrap_or_default();
    let mut training = Training::new(job).map_err(unstartable)?.after(worked);
    let written = header.estimates.iter();
    let written = written.map(|text| EstimateDeclaration::from_canonical(text).ok().map(Arc::new));
    training.estimate(&written.collect::<Option<Vec<_>>>().ok_or(CheckpointError::OtherFormat)?);
    training.restore(&mut StateReader::new(&mut from))?;
    if !from.fill_buf()?.is_empty() {
        return Err(CheckpointError::OtherFormat);
    }
    if training.estimate(declared) { Ok(training) } else { Err(CheckpointError::OtherEstimates) }
}

/// Why a job cannot go on whose agent cannot start.
fn unstartable(error: StartError) -> CheckpointError {
    match error {
        StartError::OutOfMemory(error) => error.into(),
        // An agent that has trained suits its environment.
        _ => CheckpointError::Damaged,
    }
}

/// Fails unless the first `sealed` bytes match the hash that follows them.
fn check_seal(file: &mut dyn CheckpointFile, sealed: u64) -> Result<(), CheckpointError> {
    let mut seal = Sha256::new();
    let mut left = sealed;
    let mut buffer = vec![0; 1 << 16];
    while left > 0 {
        let some = buffer.len().min(usize::try_from(left).unwrap_or(usize::MAX));
        file.read_exact(&mut buffer[..some])?;
        seal.update(&buffer[..some]);
        left -= some as u64;
    }
    let mut written = [0; SEAL];
    file.read_exact(&mut written)?;
    if written[..] == seal.finalize()[..] { Ok(()) } else { Err(CheckpointError::Damaged) }
}

/// A writer that hashes the bytes that pass through it.
struct Sealing<'a> {
    out: &'a mut dyn Write,
    seal: Sha256,
}

impl Write for Sealing<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.seal.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
