//! Packing: assigns jobs to tasks.
//!
//! Jobs are assigned in descending order of time, each to the chunk with the least work so far, which
//! balances the chunks. Jobs of a task that died are packed separately, in smaller chunks; jobs of a
//! task that died twice get one chunk each. A job that crashes its tasks is therefore alone in its
//! third task.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// Number of pieces into which the jobs of a chunk are split after its task died.
const PIECES: usize = 8;

/// The properties of a job that matter for packing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Estimated time on one core.
    pub seconds: f64,
    /// Number of tasks that died with the job.
    pub deaths: u32,
    /// Identifies the chunk of the last of these tasks; jobs of one chunk share the number.
    pub died_in: usize,
}

/// Jobs in chunks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Packed {
    /// For each chunk, the indices of its jobs in the list, the longest job first.
    pub chunks: Vec<Vec<usize>>,
    /// Number of suspect jobs for which no chunk is left.
    pub deferred: usize,
}

/// Packs jobs into at most `most` chunks of about `seconds` of work each.
pub fn pack(loads: &[Load], seconds: f64, most: usize) -> Packed {
    let mut order: Vec<usize> = (0..loads.len()).collect();
    order.sort_by(|&one, &other| loads[other].seconds.total_cmp(&loads[one].seconds));
    let mut clean = Vec::new();
    let mut pieces: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    let mut alone = Vec::new();
    for job in order {
        match loads[job].deaths {
            0 => clean.push(job),
            1 => pieces.entry(loads[job].died_in).or_default().push(job),
            _ => alone.push(vec![job]),
        }
    }
    let mut suspects: Vec<Vec<usize>> = Vec::new();
    for jobs in pieces.into_values() {
        suspects.extend(deal(loads, &jobs, PIECES));
    }
    suspects.extend(alone);
    // The number of suspects is unlimited, so suspects that exceed the room are deferred.
    let room = most.saturating_sub(usize::from(!clean.is_empty()));
    let deferred = suspects.iter().skip(room).map(Vec::len).sum();
    suspects.truncate(room);
    let work: f64 = clean.iter().map(|&job| loads[job].seconds).sum();
    let wanted = (work / seconds).ceil().min(1e9) as usize;
    let mut chunks = deal(loads, &clean, wanted.clamp(1, (most - suspects.len()).max(1)));
    chunks.extend(suspects);
    Packed { chunks, deferred }
}

/// Assigns jobs, longest first, to at most `count` chunks, and drops empty chunks.
fn deal(loads: &[Load], jobs: &[usize], count: usize) -> Vec<Vec<usize>> {
    let count = count.min(jobs.len());
    let mut chunks: Vec<Vec<usize>> = vec![Vec::new(); count];
    // Work as bits: the bit patterns of non-negative floats have the order of the floats.
    let mut least: BinaryHeap<_> =
        (0..count).map(|chunk| Reverse((0_u64, 0_usize, chunk))).collect();
    for &job in jobs {
        let Some(Reverse((work, held, chunk))) = least.pop() else { break };
        let work = f64::from_bits(work) + loads[job].seconds.max(0.0);
        chunks[chunk].push(job);
        least.push(Reverse((work.to_bits(), held + 1, chunk)));
    }
    chunks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clean(seconds: &[f64]) -> Vec<Load> {
        seconds.iter().map(|&seconds| Load { seconds, deaths: 0, died_in: 0 }).collect()
    }

    fn work(loads: &[Load], chunk: &[usize]) -> f64 {
        chunk.iter().map(|&job| loads[job].seconds).sum()
    }

    #[test]
    fn every_job_is_in_one_chunk_and_chunks_are_alike_in_work() {
        let loads = clean(&(0..1000).map(|n| 1.0 + f64::from(n % 37)).collect::<Vec<_>>());
        let packed = pack(&loads, 600.0, 1001);
        let mut all: Vec<usize> = packed.chunks.concat();
        all.sort_unstable();
        assert_eq!(all, (0..1000).collect::<Vec<_>>());
        let works: Vec<f64> = packed.chunks.iter().map(|chunk| work(&loads, chunk)).collect();
        let total: f64 = loads.iter().map(|load| load.seconds).sum();
        assert_eq!(works.len(), (total / 600.0).ceil() as usize);
        let mean = total / works.len() as f64;
        assert!(works.iter().all(|work| (work / mean - 1.0).abs() < 0.02), "{works:?}");
        for chunk in &packed.chunks {
            assert!(chunk.is_sorted_by(|&a, &b| loads[a].seconds >= loads[b].seconds));
        }
    }

    #[test]
    fn a_job_longer_than_a_chunk_is_a_chunk() {
        let loads = clean(&[5000.0, 10.0, 10.0]);
        assert_eq!(pack(&loads, 900.0, 1001).chunks[0], [0]);
        let packed = pack(&loads, 900.0, 2);
        assert_eq!(packed.chunks, [vec![0], vec![1, 2]]);
    }

    #[test]
    fn there_are_at_most_as_many_chunks_as_an_array_has_tasks() {
        let loads = clean(&vec![100.0; 5000]);
        let packed = pack(&loads, 100.0, 1001);
        assert_eq!(packed.chunks.len(), 1001);
        assert!(packed.chunks.iter().all(|chunk| (4..=5).contains(&chunk.len())));
        assert_eq!(packed.deferred, 0);
    }

    #[test]
    fn jobs_without_work_are_packed_too() {
        let packed = pack(&clean(&[0.0; 7]), 900.0, 1001);
        assert_eq!(packed.chunks.len(), 1);
        assert_eq!(packed.chunks[0].len(), 7);
        assert_eq!(pack(&[], 900.0, 1001), Packed::default());
    }

    #[test]
    fn jobs_of_a_dead_task_come_in_smaller_pieces_and_then_alone() {
        let mut loads = clean(&[1.0; 30]);
        for load in &mut loads[..16] {
            *load = Load { deaths: 1, died_in: 3, ..*load };
        }
        for load in &mut loads[16..20] {
            load.deaths = 2;
        }
        let packed = pack(&loads, 900.0, 1001);
        let sizes: Vec<usize> = packed.chunks.iter().map(Vec::len).collect();
        assert_eq!(sizes, [10, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1]);
        assert!(packed.chunks[0].iter().all(|&job| loads[job].deaths == 0));
    }

    #[test]
    fn suspects_that_find_no_room_wait() {
        let mut loads = clean(&[1.0; 10]);
        for load in &mut loads[..8] {
            load.deaths = 2;
        }
        let packed = pack(&loads, 900.0, 4);
        let sizes: Vec<usize> = packed.chunks.iter().map(Vec::len).collect();
        assert_eq!((sizes, packed.deferred), (vec![2, 1, 1, 1], 5));
    }
}
