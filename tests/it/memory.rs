//! What an answer takes of memory does not grow with it, whoever takes its batches and however slowly.

#![cfg(target_os = "linux")]

use crate::support::esker_ok;
use esker::query::Query;
use esker::store::{Limits, Snapshot, Store};
use std::fs;
use std::ops::ControlFlow;
use std::time::Duration;

/// A figure of this process, in MiB.
fn figure(name: &str) -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|l| l.starts_with(name)).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() >> 10
}

/// By how many MiB the process grows at most while somebody who is slower than the query takes its points, and how many
/// MiB these are.
fn peak(query: &Query, snapshot: &Snapshot) -> (u64, u64) {
    // The highest figure begins anew.
    fs::write("/proc/self/clear_refs", "5").unwrap();
    let before = figure("VmRSS");
    let mut bytes = 0;
    let sink = |batch: esker::points::Batch| {
        let of_point: usize = batch.attributes.iter().map(|a| a.ty.size()).sum();
        bytes += (batch.len() * (24 + of_point)) as u64;
        std::thread::sleep(Duration::from_millis(40));
        ControlFlow::Continue(())
    };
    query.run(snapshot, sink).unwrap();
    (figure("VmHWM").saturating_sub(before), bytes >> 20)
}

#[test]
fn an_answer_under_a_capacity_takes_the_memory_of_a_few_pieces() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", "terrain", "--points", "4M", "-o", &path("t.las")]);
    esker_ok(&["ingest", &path("t.esker"), &path("t.las")]);
    let snapshot = Store::open_with(path("t.esker"), Limits::once()).unwrap().snapshot().unwrap();
    // Whatever the machine has: an allocator keeps some of what each thread that took part has freed.
    let threads = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let of = |capacity| threads.install(|| peak(&Query::new().capacity(capacity), &snapshot));
    // What is there once for all is there before.
    of(200_000);
    let (some, few) = of(1_000_000);
    let (most, many) = of(3_990_000);
    println!("{few} MiB of points in {some} MiB, {many} in {most}");
    assert!(many > few + 80, "{few} and {many} MiB of points");
    assert!(most < some.max(16) + (many - few) / 4, "{few} MiB of points in {some} MiB, but {many} in {most}");
}
