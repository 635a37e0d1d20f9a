//! `pivotsight batch`: many pictures, resumable.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::Value;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::history;
use super::{Global, Outcome, Status, result, seconds};
use crate::batch::{self, Job, Meanwhile, Options, Progress, Rows, Summary, Watch, input};
use crate::camera::{Calibration, Identity};
use crate::error::{Error, Result};
use crate::output::{Document, write_whole};
use crate::store::keep::{self, Taken};

/// Measure many pictures into the folder given by --out; resumes after any interruption
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A folder, a quoted pattern ('shots/*.png'), a CSV manifest (columns image and optionally calib) or one picture
    input: String,
    /// Job file: measurement, calibration, limits
    #[arg(long, value_name = "JOB.toml")]
    job: PathBuf,
    /// Go on with what the folder given by --out holds
    #[arg(long)]
    resume: bool,
    /// With --resume: measure again what failed
    #[arg(long, requires = "resume")]
    retry_failed: bool,
    /// Say what would be measured, and measure nothing
    #[arg(long)]
    dry_run: bool,
    /// Threads (default: every core)
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    threads: usize,
    /// Go on measuring pictures as they come into the folder
    #[arg(long)]
    watch: bool,
    /// With --watch: a file unchanged for so long is complete
    #[arg(long, requires = "watch", value_name = "S", default_value_t = 1.0)]
    settle_s: f64,
    /// With --watch: end when nothing new came for so long (default: never)
    #[arg(long, requires = "watch", value_name = "S")]
    idle_s: Option<f64>,
}

/// What is printed.
#[derive(schemars::JsonSchema)]
#[serde(untagged)]
#[allow(dead_code)] // Only described.
pub enum Output {
    Done(Done),
    Plan(Plan),
}

/// What was measured.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Done {
    /// What it was measured with.
    calibration: Identity,
    #[serde(flatten)]
    summary: Summary,
}

/// What would be measured.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Plan {
    /// Always true.
    dry_run: bool,
    /// How many pictures.
    pictures: usize,
    /// The job as read.
    job: Job,
    /// The pictures.
    images: Vec<String>,
}

/// More threads than any machine has cores take minutes to start, or do not at all.
const MOST_THREADS: usize = 1024;

/// Runs the command.
pub fn run(args: &Args, global: &Global) -> Result<Outcome> {
    let job = Job::read(&args.job)?;
    global.reads(&args.job, [job.calib_path()])?;
    if args.dry_run {
        return dry_run(args, &job, global);
    }
    let Some(out) = global.out.clone() else {
        return Err(Error::option("--out", "is missing", "name a folder for the results"));
    };
    let watch = match args.watch {
        false => None,
        true => Some(Watch {
            settle: seconds("--settle-s", args.settle_s)?,
            idle: args.idle_s.map(|s| seconds("--idle-s", s)).transpose()?,
        }),
    };
    if args.threads > MOST_THREADS {
        let fix = format!("give {MOST_THREADS} at most; 0 takes every core");
        return Err(Error::option("--threads", format!("is {}", args.threads), fix));
    }
    let options = Options {
        input: args.input.clone(),
        out: out.to_path_buf(),
        threads: args.threads,
        resume: args.resume,
        retry_failed: args.retry_failed,
        watch,
    };
    let passed_over = input::passed_over(&args.input, &options.out, job.kind());
    passed_over.iter().for_each(|p| global.say(format!("warning: {p}")));
    let bar = Bar::new(global);
    let (_, calibration) = Calibration::identified(job.calib_path())?;
    let told = |summary: &Summary| {
        let done = Done { calibration: calibration.clone(), summary: summary.clone() };
        result("batch", &args.input, &doubts(summary), &done)
    };
    let summary_path = options.out.join("summary.json");
    let done = |summary: &Summary, rows: Rows| {
        write_whole(&summary_path, format!("{:#}\n", told(summary)).as_bytes())?;
        keep(args, &job, &options.out, rows, global);
        Ok(())
    };
    let meanwhile = Meanwhile {
        progress: &|p| bar.show(p),
        say: &|news| global.say(news),
        summary: &done,
        stop: &stopped_by_user(),
    };
    let summary = batch::run(&job, &options, meanwhile)?;
    bar.end();
    doubts(&summary).iter().for_each(|w| global.say(format!("warning: {w}")));
    failures(&summary).iter().for_each(|line| global.note(line));
    let json = told(&summary);
    let status = match &summary {
        s if s.failed + s.left > 0 => Status::SomeFailed,
        s if s.fail + s.undecided > 0 => Status::OutOfTolerance,
        _ => Status::Good,
    };
    Ok(Outcome { document: Some(Document::single(json, text(&summary))), status })
}

/// Keeps what was measured where the user keeps records: after each burst of a watched folder, so that records are as old as their pictures.
fn keep(
    args: &Args,
    job: &Job,
    out: &Path,
    rows: impl Iterator<Item = Result<Value>>,
    global: &Global,
) {
    let Some(path) = &global.records else { return };
    let (command, calib) = (job.command(), job.calib_path());
    // A folder that is watched may be empty by now: what was measured is kept all the same.
    let listed = matches!(global.taken, Some(Taken::File));
    let items = listed.then(|| input::list(&args.input, job.kind()).unwrap_or_default());
    let files: HashMap<String, PathBuf> =
        items.into_iter().flatten().map(|item| (item.name, item.path)).collect();
    let taken = |image: &str| {
        let file = files.get(image).map_or(Path::new(image), PathBuf::as_path);
        keep::time(global.taken, file)
    };
    let kept = keep::batch(path, command, out, &calib, taken, rows);
    history::told(global, kept);
}

/// Set by the first Ctrl-C, or the system's request to end; the second ends the program at once. A terminal that is closed ends it as ever, unless
/// it was told to go on (`nohup`).
fn stopped_by_user() -> Arc<AtomicBool> {
    const INTERRUPTED: i32 = 130;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // Where the system has no such thing the program ends as it always did: a batch can be resumed.
        let _ = flag::register_conditional_shutdown(signal, INTERRUPTED, Arc::clone(&stop));
        let _ = flag::register(signal, Arc::clone(&stop));
    }
    stop
}

fn dry_run(args: &Args, job: &Job, global: &Global) -> Result<Outcome> {
    job.prepare()?;
    let items = input::list(&args.input, job.kind())?;
    let plan = Plan {
        dry_run: true,
        pictures: items.len(),
        job: job.clone(),
        images: items.iter().map(|i| i.name.clone()).collect(),
    };
    let warnings: Vec<String> = input::not_there(&items).into_iter().collect();
    warnings.iter().for_each(|w| global.say(format_args!("warning: {w}")));
    let json = result("batch", &args.input, &warnings, &plan);
    let mut text = format!("would measure {} pictures\n", items.len());
    for item in items.iter().take(10) {
        let _ = writeln!(text, "  {}", item.name);
    }
    if items.len() > 10 {
        let _ = writeln!(text, "  … and {} more", items.len() - 10);
    }
    Ok(Outcome::good(Document::single(json, text)))
}

/// What the counts alone would hide.
fn doubts(s: &Summary) -> Vec<String> {
    let told = |n: usize, what: &str| {
        (n > 0).then(|| format!("{n} picture{} {what}", if n == 1 { "" } else { "s" }))
    };
    let copies = told(
        s.copies,
        "the same as another, byte for byte: the statistics count each as a measurement",
    );
    let gone = told(s.gone, "measured before and no longer there: the rows stay");
    let left = told(s.left, "not measured, as the batch was stopped: go on with --resume");
    copies.into_iter().chain(gone).chain(left).collect()
}

fn text(s: &Summary) -> String {
    let mut text = format!(
        "{} pictures: {} measured, {} failed ({} of them new)\n",
        s.pictures, s.measured, s.failed, s.new
    );
    if s.pass + s.fail + s.undecided > 0 {
        let _ =
            writeln!(text, "verdicts: {} pass, {} fail, {} undecided", s.pass, s.fail, s.undecided);
    }
    if !s.statistics.is_empty() {
        let width = s.statistics.iter().map(|c| c.column.len()).max().unwrap_or(0);
        let _ = writeln!(
            text,
            "\n{:width$} {:>7} {:>11} {:>10} {:>11} {:>11}",
            "", "n", "mean", "sd", "min", "max"
        );
        for c in &s.statistics {
            let v = &c.statistics;
            let sd = v.sd.map_or_else(|| "-".into(), |sd| format!("{sd:.5}"));
            let _ = writeln!(
                text,
                "{:width$} {:>7} {:>11.5} {sd:>10} {:>11.5} {:>11.5}",
                c.column, v.n, v.mean, v.min, v.max
            );
        }
    }
    let failures = failures(s);
    if !failures.is_empty() {
        let _ = writeln!(text, "\n{}", failures.join("\n"));
    }
    text.push('\n');
    for file in &s.files {
        let _ = writeln!(text, "wrote {}", file.display());
    }
    text
}

/// What was not measured, a line each.
fn failures(s: &Summary) -> Vec<String> {
    let named = s.failures.iter().map(|f| format!("FAILED {}: {}", f.image, f.reason));
    let more = s.failed.saturating_sub(s.failures.len());
    named.chain((more > 0).then(|| format!("… and {more} more, in the tables"))).collect()
}

/// The progress line: rewritten in place on a terminal, a new line every ten seconds elsewhere.
struct Bar<'g> {
    global: &'g Global,
    terminal: bool,
    begun: Instant,
    shown: Mutex<Option<Instant>>,
}

impl<'g> Bar<'g> {
    fn new(global: &'g Global) -> Self {
        Self {
            global,
            terminal: std::io::stderr().is_terminal(),
            begun: Instant::now(),
            shown: Mutex::new(None),
        }
    }

    fn show(&self, p: Progress) {
        let Ok(mut shown) = self.shown.try_lock() else { return };
        let every = Duration::from_millis(if self.terminal { 100 } else { 10_000 });
        if shown.unwrap_or(self.begun).elapsed() < every {
            return;
        }
        *shown = Some(Instant::now());
        let rate = p.done as f64 / self.begun.elapsed().as_secs_f64().max(1e-3);
        let left = ((p.total - p.done) as f64 / rate).round();
        let (minutes, seconds) = ((left / 60.0).floor(), left % 60.0);
        let line = format!(
            "{}/{} pictures, {:.1}/s, {minutes:.0}:{seconds:02.0} left, {} failed",
            p.done, p.total, rate, p.failed
        );
        if self.terminal && !self.global.quiet {
            eprint!("\r\x1b[K{line}");
        } else {
            self.global.say(line);
        }
    }

    fn end(&self) {
        if self.terminal && !self.global.quiet && self.shown.lock().is_ok_and(|s| s.is_some()) {
            eprintln!();
        }
    }
}
