//! Many pictures: measured on all cores, resumable after any kind of interruption, the same bytes out at any
//! number of threads.
//!
//! A batch's folder holds `batch.json` (what was asked), `results.jsonl` (a line a picture, written as results
//! come, sorted at the end), `results.csv`, `results.parquet`, `summary.json`, and `overlays` where the job asks for them.

mod folder;
pub mod input;
pub mod job;
pub mod journal;
mod keys;
pub mod limits;
mod run;
mod tables;
mod watch;

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

pub use input::Item;
pub use job::Job;
pub use run::{Measured, Progress, Statistics};

use crate::error::{Error, Result};
use crate::output::{create_folder, write_streamed};
use crate::uncertainty::Verdict;
use folder::{claim, is_ours_to_fill, keep_apart};
use journal::{Entry, Journal, unwritten};
use watch::State;

/// What to run and how.
#[derive(Debug, Clone)]
pub struct Options {
    /// A folder, a pattern, a CSV manifest or one file.
    pub input: String,
    /// Where results go.
    pub out: PathBuf,
    /// Threads; zero takes every core.
    pub threads: usize,
    /// Go on with what `out` holds.
    pub resume: bool,
    /// With `resume`: measure what failed again.
    pub retry_failed: bool,
    /// Wait for more pictures.
    pub watch: Option<Watch>,
}

/// How a folder is watched.
#[derive(Debug, Clone, Copy)]
pub struct Watch {
    /// A file unchanged for so long is complete.
    pub settle: Duration,
    /// End when nothing new came for so long; `None` never ends by itself.
    pub idle: Option<Duration>,
}

/// How a batch went.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Summary {
    /// Pictures with a row.
    pub pictures: usize,
    /// Of these, measured now; the others were there already.
    pub new: usize,
    /// Measured.
    pub measured: usize,
    /// Not measured; the rows say why.
    pub failed: usize,
    /// Byte for byte another picture of the batch; each has its row.
    pub copies: usize,
    /// Measured before, and not among the pictures now; their rows stay.
    pub gone: usize,
    /// Verdicts `pass`.
    pub pass: usize,
    /// Verdicts `fail`.
    pub fail: usize,
    /// Verdicts `undecided`.
    pub undecided: usize,
    /// Every measured length and angle.
    pub statistics: Vec<Column>,
    /// The files made.
    pub files: Vec<PathBuf>,
}

/// The statistics of one column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Column {
    /// The column's name.
    pub column: String,
    /// Over its rows.
    #[serde(flatten)]
    pub statistics: Statistics,
}

/// Measures everything `options.input` stands for. `progress` is called after every picture, `say` with what a user should
/// know meanwhile.
pub fn run(
    job: &Job,
    options: &Options,
    progress: &(dyn Fn(Progress) + Sync),
    say: &dyn Fn(String),
) -> Result<Summary> {
    let prepared = job.prepare()?;
    let identity = json!({
        "schema": "pivotsight.batch-job/1",
        "version": env!("CARGO_PKG_VERSION"),
        "input": options.input,
        "calib_sha256": prepared.calib_sha256(),
        "job": job,
    });
    let measure = |item: &Item| prepared.measure(item);
    let summary = run_with(options, job.kind(), &identity, &measure, progress, say)?;
    prepared.doubts().into_iter().for_each(|doubt| say(format!("warning: {doubt}")));
    Ok(summary)
}

fn run_with(
    options: &Options,
    kind: input::Kind,
    identity: &Value,
    measure: &(dyn Fn(&Item) -> Measured + Sync),
    progress: &(dyn Fn(Progress) + Sync),
    say: &dyn Fn(String),
) -> Result<Summary> {
    let out = &options.out;
    let listed = input::list(&options.input, kind);
    if options.watch.is_none() {
        // What holds nothing to measure is refused before anything is made.
        keep_apart(out, listed.as_deref().map_or(&[], |items| items))?;
        listed?;
    } else if let Ok(items) = listed {
        keep_apart(out, &items)?;
    }
    create_folder(out)?;
    // Whoever holds the journal says what the folder is for: two batches begun at once would mix their jobs.
    is_ours_to_fill(out)?;
    let mut journal = Journal::open(out.join("results.jsonl"), || claim(options, identity))?;
    let overlays = out.join(run::OVERLAYS);
    if identity["job"]["overlay"] == true {
        create_folder(&overlays)?;
    }
    if options.retry_failed {
        journal.forget(|entry| entry.failed);
    }
    let before = journal.entries().len();
    let journal = Mutex::new(journal);
    let threads = options.threads;
    let mut items;
    if let Some(watch) = options.watch {
        let (mut settling, mut last) = (watch::Settling::new(watch.settle), Instant::now());
        loop {
            items = match input::list(&options.input, kind) {
                Err(Error::File { .. }) => Vec::new(), // nothing there yet
                other => other?,
            };
            let idle = watch.idle.is_some_and(|idle| last.elapsed() >= idle);
            let (mut ready, mut growing) = (Vec::new(), false);
            for item in pending(&items, &journal) {
                match settling.state(&item.path) {
                    State::Complete => ready.push(item),
                    State::Growing => growing = true,
                    // Nothing more comes: it is a failure with its reason, not forgotten.
                    State::CutShort { .. } if idle => ready.push(item),
                    State::CutShort { news: false } => {}
                    State::CutShort { news: true } => say(format!(
                        "{}: its end is missing; waiting for it, {:.0} s at most",
                        item.path.display(),
                        settling.patience().as_secs_f64().ceil()
                    )),
                }
            }
            if !ready.is_empty() {
                run::run(&ready, &overlays, &journal, threads, measure, progress)?;
                finish(options, &items, &journal, before)?;
                last = Instant::now();
            } else if idle && !growing {
                break;
            }
            std::thread::sleep(watch.settle.min(Duration::from_millis(200)));
        }
    } else {
        items = input::list(&options.input, kind)?;
        run::run(&pending(&items, &journal), &overlays, &journal, threads, measure, progress)?;
    }
    let summary = finish(options, &items, &journal, before)?;
    let mut journal = journal.into_inner().unwrap_or_else(PoisonError::into_inner);
    let lines = sorted(options, &items, &journal);
    let results = out.join("results.jsonl");
    write_streamed(&results, |file| {
        use std::io::Write;
        let mut sink = std::io::BufWriter::new(file);
        for (_, entry) in &lines {
            let line = journal.line(*entry)?;
            sink.write_all(line.as_bytes()).map_err(|e| unwritten(&results, e))?;
        }
        sink.flush().map_err(|e| unwritten(&results, e))
    })?;
    Ok(summary)
}

/// The rows of a finished batch, in order.
pub fn rows(folder: &Path) -> Result<impl Iterator<Item = Result<Value>>> {
    use std::io::BufRead;
    let path = folder.join("results.jsonl");
    let file = std::fs::File::open(&path).map_err(|e| Error::io(&path, "read", e))?;
    Ok(std::io::BufReader::new(file).lines().map(move |line| {
        let line = line.map_err(|e| Error::io(&path, "read", e))?;
        serde_json::from_str(&line)
            .map_err(|e| Error::file(&path, format!("is damaged ({e})"), "start the batch again"))
    }))
}

fn lock(journal: &Mutex<Journal>) -> std::sync::MutexGuard<'_, Journal> {
    journal.lock().unwrap_or_else(PoisonError::into_inner)
}

fn pending<'i>(items: &'i [Item], journal: &Mutex<Journal>) -> Vec<&'i Item> {
    let journal = lock(journal);
    items.iter().filter(|item| !journal.entries().contains_key(&item.name)).collect()
}

/// The journal's entries in the order of the results: the manifest's, else by name.
fn sorted(options: &Options, items: &[Item], journal: &Journal) -> Vec<(String, Entry)> {
    let listed: HashSet<&str> = items.iter().map(|i| i.name.as_str()).collect();
    let mut gone: Vec<&str> =
        journal.entries().keys().map(String::as_str).filter(|n| !listed.contains(n)).collect();
    gone.sort_unstable();
    let mut names: Vec<&str> = items.iter().map(|i| i.name.as_str()).chain(gone).collect();
    if options.watch.is_some() {
        names.sort_unstable();
    }
    names
        .into_iter()
        .filter_map(|n| journal.entries().get(n).map(|entry| (n.to_owned(), *entry)))
        .collect()
}

/// Writes the tables and the summary of what the journal holds now.
fn finish(
    options: &Options,
    items: &[Item],
    journal: &Mutex<Journal>,
    before: usize,
) -> Result<Summary> {
    let mut journal = lock(journal);
    let lines = sorted(options, items, &journal);
    let mut row = |entry: Entry| -> Result<Value> {
        serde_json::from_str(&journal.line(entry)?).map_err(|e| {
            Error::file(
                options.out.join("results.jsonl"),
                format!("is damaged ({e})"),
                "start again",
            )
        })
    };
    let (mut columns, mut gather) = (tables::Columns::default(), run::Gather::default());
    let (mut contents, mut copies) = (HashSet::new(), 0);
    for (_, entry) in &lines {
        let value = row(*entry)?;
        if let Some(sha256) = value["sha256"].as_str() {
            copies += usize::from(!contents.insert(sha256.to_owned()));
        }
        columns.add(&value);
        gather.add(&value);
    }
    let path = |name: &str| options.out.join(name);
    columns.write_csv(&path("results.csv"), lines.iter().map(|l| row(l.1)))?;
    columns.write_parquet(&path("results.parquet"), lines.iter().map(|l| row(l.1)))?;
    let count = |f: &dyn Fn(&Entry) -> bool| lines.iter().filter(|l| f(&l.1)).count();
    let verdict = |v| count(&|e| e.verdict == Some(v));
    let failed = count(&|e| e.failed);
    let statistics =
        gather.finish().into_iter().map(|(column, statistics)| Column { column, statistics });
    let summary = Summary {
        pictures: lines.len(),
        new: lines.len().saturating_sub(before),
        measured: lines.len() - failed,
        failed,
        copies,
        gone: lines.len()
            - items.iter().filter(|i| journal.entries().contains_key(&i.name)).count(),
        pass: verdict(Verdict::Pass),
        fail: verdict(Verdict::Fail),
        undecided: verdict(Verdict::Undecided),
        statistics: statistics.collect(),
        files: ["results.jsonl", "results.csv", "results.parquet"].map(path).to_vec(),
    };
    Ok(summary)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fake(item: &Item) -> Measured {
        let n: u64 =
            item.name.trim_start_matches('p').trim_end_matches(".png").parse().unwrap_or(0);
        std::thread::sleep(Duration::from_micros(n * 7919 % 300));
        assert_ne!(n, 13, "a bug in the measurement");
        let result = match n % 10 {
            0 => Err(Error::measure(&item.name, "no ring", "look")),
            _ => Ok(json!({"distance_mm": n as f64 * 1e-3, "verdict": "pass"})
                .as_object()
                .cloned()
                .unwrap_or_default()),
        };
        Measured { sha256: None, result, overlays: Vec::new() }
    }

    fn go(
        input: &Path,
        out: &Path,
        threads: usize,
        resume: bool,
        watch: Option<Watch>,
    ) -> Result<Summary> {
        let options = Options {
            input: input.display().to_string(),
            out: out.to_owned(),
            threads,
            resume,
            retry_failed: false,
            watch,
        };
        run_with(&options, input::Kind::Pictures, &json!({"input": "x"}), &fake, &|_| {}, &|_| {})
    }

    fn pictures(folder: &Path, n: usize) {
        for i in 0..n {
            std::fs::write(folder.join(format!("p{i:03}.png")), b"BM-like bytes, not a picture")
                .unwrap();
        }
    }

    #[test]
    fn the_same_bytes_come_out_at_any_thread_count_and_after_any_cut() {
        let dir = tempfile::tempdir().unwrap();
        let input = dir.path().join("in");
        std::fs::create_dir(&input).unwrap();
        pictures(&input, 60);
        let read = |out: &Path| {
            ["results.jsonl", "results.csv", "results.parquet"]
                .map(|f| std::fs::read(out.join(f)).unwrap())
        };
        let one = dir.path().join("one");
        let summary = go(&input, &one, 1, false, None).unwrap();
        assert_eq!((summary.pictures, summary.failed, summary.pass), (60, 7, 53));
        let whole = read(&one);
        let four = dir.path().join("four");
        go(&input, &four, 4, false, None).unwrap();
        assert!(read(&four) == whole);
        for cut in (0..whole[0].len()).step_by(501) {
            std::fs::write(four.join("results.jsonl"), &whole[0][..cut]).unwrap();
            let summary = go(&input, &four, 2, true, None).unwrap();
            let kept = whole[0][..cut].iter().filter(|b| **b == b'\n').count();
            assert_eq!((summary.pictures, summary.new), (60, 60 - kept));
            assert!(read(&four) == whole, "cut at {cut}");
        }
        assert!(go(&input, &four, 1, false, None).unwrap_err().to_string().contains("--resume"));
    }

    #[test]
    fn a_watched_folder_is_measured_as_pictures_come() {
        let dir = tempfile::tempdir().unwrap();
        let (input, out) = (dir.path().join("in"), dir.path().join("out"));
        std::fs::create_dir(&input).unwrap();
        let watch =
            Watch { settle: Duration::from_millis(40), idle: Some(Duration::from_millis(900)) };
        let summary = std::thread::scope(|scope| {
            let run = scope.spawn(|| go(&input, &out, 2, false, Some(watch)));
            for n in [3, 6, 9] {
                std::thread::sleep(Duration::from_millis(150));
                pictures(&input, n);
            }
            run.join().unwrap().unwrap()
        });
        assert_eq!(summary.pictures, 9);
        let lines = std::fs::read_to_string(out.join("results.jsonl")).unwrap();
        assert_eq!(lines.lines().count(), 9);
    }
}
