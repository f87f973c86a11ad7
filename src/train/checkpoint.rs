//! Checkpoints: a training under way, written down so that another process can go on with it.
//!
//! A checkpoint is a line that names its format, a line of JSON that says of what job and by what
//! code it is, the state of the training, and the SHA-256 of all that. It is taken for what it says
//! only if every byte is as it was written, and gone on with only by the code that made it. Where
//! checkpoints lie, and when they are due, is for [`Checkpoints`] to know.

use std::fmt;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::agent::{self, OutOfMemory};
use crate::plan::{Job, Versions};
use crate::state::{Resumable, StateError, StateReader, StateWriter};
use crate::train::training::Training;

/// The first line. The number is raised whenever the bytes of a state change their meaning.
const FORMAT: &str = "jitai checkpoint 2\n";
/// Bytes of the SHA-256 at the end.
const SEAL: usize = 32;

/// Whoever keeps the checkpoints of one training.
pub trait Checkpoints {
    /// Whether one should be made at the next occasion; asked at every step.
    fn are_due(&self) -> bool;

    /// Shows those that earlier runs of the job left to `read`, the furthest first, until it takes
    /// one.
    fn resume(&self, read: &mut ReadCheckpoint<'_>);

    /// Keeps what `write` writes, whole or not at all. A training goes on in either case.
    fn keep(&self, write: &mut WriteCheckpoint<'_>);
}

/// Takes over a checkpoint, or says why not.
pub type ReadCheckpoint<'a> =
    dyn FnMut(&mut dyn CheckpointFile) -> Result<Resumed, CheckpointError> + 'a;

/// Writes a checkpoint.
pub type WriteCheckpoint<'a> = dyn FnMut(&mut dyn Write) -> io::Result<()> + 'a;

/// The bytes of a checkpoint, as a file has them.
pub trait CheckpointFile: Read + Seek {}

impl<T: Read + Seek> CheckpointFile for T {}

/// Where a training goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resumed {
    /// Training episodes finished.
    pub episode: u32,
    /// What the training had taken before.
    pub worked: Duration,
}

/// A keeper that keeps nothing.
#[derive(Clone, Copy, Debug)]
pub struct KeptNowhere;

impl Checkpoints for KeptNowhere {
    fn are_due(&self) -> bool {
        false
    }

    fn resume(&self, _: &mut ReadCheckpoint<'_>) {}

    fn keep(&self, _: &mut WriteCheckpoint<'_>) {}
}

/// Why a checkpoint cannot be gone on with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// The system cannot read it.
    #[error("it cannot be read: {0}")]
    Read(#[from] io::Error),
    /// Some of its bytes are not as they were written, or missing.
    #[error("it is damaged")]
    Damaged,
    /// It has another format.
    #[error("another release of jitai made it")]
    OtherFormat,
    /// Other code made it, whose bits may differ.
    #[error("other code made it: {theirs}; this is {ours}")]
    OtherCode {
        /// What made it.
        theirs: String,
        /// What this is.
        ours: String,
    },
    /// It is of another job.
    #[error("it is of another job, {0}")]
    OtherJob(String),
    /// There is no memory for it.
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
    /// Its state does not fit the job.
    #[error(transparent)]
    State(#[from] StateError),
}

/// What a checkpoint says of itself.
#[derive(Debug, Serialize, Deserialize)]
struct Header {
    job_key: String,
    code: Code,
    episode: u32,
    seconds: f64,
}

/// What the bits that a training goes on to depend on.
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

/// Writes a training as a checkpoint, after so much time at work in this process.
pub(super) fn write(
    training: &Training<'_>,
    worked: Duration,
    out: &mut dyn Write,
) -> io::Result<()> {
    let job = training.job();
    let header = Header {
        job_key: job.key().to_string(),
        code: Code::of_this_program(job),
        episode: training.episodes(),
        seconds: (training.before() + worked).as_secs_f64(),
    };
    let mut sealing = BufWriter::with_capacity(1 << 16, Sealing { out, seal: Sha256::new() });
    sealing.write_all(FORMAT.as_bytes())?;
    serde_json::to_writer(&mut sealing, &header)?;
    sealing.write_all(b"\n")?;
    training.save(&mut StateWriter::new(&mut sealing))?;
    let Sealing { out, seal } = sealing.into_inner().map_err(|error| error.into_error())?;
    out.write_all(&seal.finalize())
}

/// The training that a checkpoint of the job holds.
///
/// **Errors**: it is damaged, or of another job, or made by other code.
pub(super) fn read<'j>(
    job: &'j Job,
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
    let ours = Code::of_this_program(job);
    if header.code != ours {
        let (theirs, ours) = (header.code.to_string(), ours.to_string());
        return Err(CheckpointError::OtherCode { theirs, ours });
    }
    if header.job_key != job.key().to_string() {
        return Err(CheckpointError::OtherJob(header.job_key));
    }
    let worked = Duration::try_from_secs_f64(header.seconds).unwrap_or_default();
    let mut training = Training::new(job)?.after(worked);
    training.restore(&mut StateReader::new(&mut from))?;
    if from.fill_buf()?.is_empty() { Ok(training) } else { Err(CheckpointError::OtherFormat) }
}

/// Fails unless the first `sealed` bytes have the hash that stands behind them.
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

/// Takes the hash of what it passes on.
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
