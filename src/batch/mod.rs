//! Many pictures: measured on all cores, resumable after any kind of interruption, the same bytes out at any
//! number of threads.
//!
//! A batch's folder holds `batch.json` (what was asked), `results.jsonl` (a line a picture, written as results
//! come, sorted at the end), `results.csv`, `results.parquet`, `summary.json`, `overlays` where the job asks for them, and `burns.csv`
//! where a manifest tells how burns were made.

mod burns;
mod folder;
pub mod input;
pub mod job;
pub mod journal;
mod keys;
pub mod limits;
mod run;
mod summary;
mod tables;
mod watch;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use serde_json::{Value, json};

pub use input::Item;
pub use job::Job;
pub use run::{Measured, Progress};
pub use summary::Summary;

use crate::clock;
use crate::error::{Error, Result};
use crate::output::{create_folder, identity as place_of, write_streamed};
use folder::{claim, is_ours_to_fill, keep_apart};
use journal::{Journal, unwritten};

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

/// The rows of a batch, one after another.
pub type Rows<'r> = &'r mut dyn Iterator<Item = Result<Value>>;

/// What a batch tells and is told while it runs.
#[derive(Clone, Copy)]
pub struct Meanwhile<'m> {
    /// Called after every picture.
    pub progress: &'m (dyn Fn(Progress) + Sync),
    /// Called with what a user should know.
    pub say: &'m dyn Fn(String),
    /// Called with all rows when the tables are up to date: at the end, and after each burst of pictures in a watched folder.
    pub summary: &'m dyn Fn(&Summary, Rows) -> Result<()>,
    /// Set by whoever wants an early end: what is being measured is finished, the rest is left.
    pub stop: &'m AtomicBool,
}

impl Meanwhile<'_> {
    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Measures everything `options.input` stands for.
pub fn run(job: &Job, options: &Options, meanwhile: Meanwhile) -> Result<Summary> {
    let prepared = job.prepare()?;
    let identity = json!({
        "schema": "pivotsight.batch-job/1",
        "version": env!("CARGO_PKG_VERSION"),
        "input": options.input,
        "input_path": input::place(&options.input),
        "calib_sha256": prepared.calib_sha256(),
        "job": job,
        // Another batch in the same folder is another batch.
        "begun": format!("{} by {}", clock::utc(clock::now()), std::process::id()),
    });
    let measure = |item: &Item| prepared.measure(item);
    let summary = run_with(options, job.kind(), &identity, &measure, meanwhile)?;
    prepared.doubts().into_iter().for_each(|doubt| (meanwhile.say)(format!("warning: {doubt}")));
    Ok(summary)
}

fn run_with(
    options: &Options,
    kind: input::Kind,
    identity: &Value,
    measure: &(dyn Fn(&Item) -> Measured + Sync),
    meanwhile: Meanwhile,
) -> Result<Summary> {
    let out = &options.out;
    let listed = input::list(&options.input, kind);
    if options.watch.is_none() || !input::may_fill(&options.input) {
        // What holds nothing to measure is refused before anything is made.
        keep_apart(out, listed.as_deref().map_or(&[], |items| items))?;
        listed?;
    } else if let Ok(items) = listed {
        keep_apart(out, &items)?;
    }
    create_folder(out)?;
    // Whoever holds the journal says what the folder is for: two batches begun at once would mix their jobs.
    is_ours_to_fill(out)?;
    let results = out.join("results.jsonl");
    let until = std::fs::metadata(&results).and_then(|m| m.modified()).ok();
    let mut journal = Journal::open(&results, || claim(options, identity))?;
    let overlays = out.join(run::OVERLAYS);
    if identity["job"]["overlay"] == true {
        create_folder(&overlays)?;
    }
    if options.retry_failed {
        journal.forget(|_, entry| entry.failed);
    }
    let before = journal.entries().len();
    let journal = Mutex::new(journal);
    let measure_all =
        |items: &[&Item]| run::run(items, &overlays, &journal, options.threads, measure, meanwhile);
    let finish = |items: &[Item]| summary::written(options, items, &journal, before, meanwhile);
    let items = match options.watch {
        Some(watch) => {
            let folders = (options.input.as_str(), options.out.as_path());
            watch::folder(folders, kind, watch, meanwhile, &journal, |ready, items| {
                measure_all(ready).and_then(|()| finish(items)).map(drop)
            })?
        }
        None => {
            let items = input::list(&options.input, kind)?;
            let told = replaced(&items, &journal, until).into_iter().chain(input::doubt(&items));
            told.for_each(meanwhile.say);
            measure_all(&pending(&items, &journal))?;
            items
        }
    };
    let summary = finish(&items)?;
    let mut journal = journal.into_inner().unwrap_or_else(PoisonError::into_inner);
    let lines = summary::sorted(options, &items, &journal);
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

/// Which batch a folder is of: its place, and when it was begun.
pub fn which(folder: &Path) -> String {
    let told = std::fs::read(folder.join("batch.json")).ok();
    let told = told.and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
    let begun = told.and_then(|v| v["begun"].as_str().map(str::to_owned)).unwrap_or_default();
    format!("{} {begun}", place_of(folder).display())
}

/// The rows of a finished batch, in order.
pub fn rows(folder: &Path) -> Result<impl Iterator<Item = Result<Value>>> {
    use std::io::BufRead;
    let path = folder.join("results.jsonl");
    let file = std::fs::File::open(&path).map_err(|e| Error::io(&path, "read", e))?;
    Ok(std::io::BufReader::new(file).lines().map(move |line| {
        let line = line.map_err(|e| Error::io(&path, "read", e))?;
        serde_json::from_str(&line).map_err(|e| {
            Error::file(
                &path,
                format!("is damaged ({e})"),
                "go on with the batch: --resume mends it",
            )
        })
    }))
}

/// A word on pictures that are newer than their results.
fn replaced(items: &[Item], journal: &Mutex<Journal>, until: Option<SystemTime>) -> Option<String> {
    let (journal, until) = (lock(journal), until?);
    let changed = |item: &&Item| {
        journal.entries().contains_key(&item.name)
            && std::fs::metadata(&item.path).and_then(|m| m.modified()).is_ok_and(|t| t > until)
    };
    let mut newer = items.iter().filter(changed);
    let first = newer.next()?;
    Some(format!(
        "warning: {} of the pictures measured before ({}, for one) have changed since: their rows are of what was there then; measure them in another --out",
        1 + newer.count(),
        first.name
    ))
}

fn lock(journal: &Mutex<Journal>) -> std::sync::MutexGuard<'_, Journal> {
    journal.lock().unwrap_or_else(PoisonError::into_inner)
}

fn pending<'i>(items: &'i [Item], journal: &Mutex<Journal>) -> Vec<&'i Item> {
    let journal = lock(journal);
    items.iter().filter(|item| !journal.entries().contains_key(&item.name)).collect()
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
        go_until(usize::MAX, input, out, threads, resume, watch)
    }

    /// The same, told to end once so many are done.
    fn go_until(
        most: usize,
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
        let stop = AtomicBool::new(false);
        let meanwhile = Meanwhile {
            progress: &|p| stop.store(p.done >= most, Ordering::Relaxed),
            say: &|_| {},
            summary: &|_, _| Ok(()),
            stop: &stop,
        };
        run_with(&options, input::Kind::Pictures, &json!({"input": "x"}), &fake, meanwhile)
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
        let ended = dir.path().join("ended");
        let summary = go_until(20, &input, &ended, 2, false, None).unwrap();
        let done = summary.pictures;
        assert!((20..24).contains(&done) && summary.left == 60 - done, "{summary:?}");
        assert_eq!(go(&input, &ended, 2, true, None).unwrap().left, 0);
        assert!(read(&ended) == whole);
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
