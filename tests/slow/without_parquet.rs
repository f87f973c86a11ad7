//! A program that was built without Parquet files, by `make test-features`.

use crate::support::{Effort, Folder, manifest};

#[test]
fn parquet_is_refused_by_a_build_without_it_before_anything_is_written() {
    let folder = Folder::completed(&manifest("sweep", "0.6", "1", Effort::Trivial));
    let how = "cargo build --release --features parquet";
    folder.jitai(["query", "SELECT 1", "--format", "parquet"]).ended(2).says(how);
    folder.jitai(["export", "--out", "results", "--format", "parquet"]).ended(2).says(how);
    assert!(!folder.path("results").exists());
}
