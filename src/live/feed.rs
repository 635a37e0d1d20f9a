//! One picture after the other from any source. A live source is read by a thread of its own; the newest picture waits, older
//! ones that nobody took are dropped and counted. A live source that dies is opened again.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::error::{Error, Result};
use crate::live::source::{Named, Open, Shot, Source, name};

/// A live source silent for this long is reported.
const STALL: Duration = Duration::from_millis(1500);
/// Pause between attempts to open a lost source.
const RETRY: Duration = Duration::from_millis(300);

/// What happened next.
#[derive(Debug)]
pub enum Event {
    /// A picture, and when it came.
    Shot(Shot, Instant),
    /// No picture for this long.
    Stalled(Duration),
    /// The source was lost and is being opened again.
    Lost(String),
    /// It is there again.
    Back,
    /// There are no more pictures.
    Ended,
}

/// What a source has delivered so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Stats {
    /// Pictures received.
    pub received: u64,
    /// Of these, pictures that a newer one replaced before they were looked at.
    pub dropped: u64,
    /// How often the source was opened again.
    pub reconnects: u64,
}

/// A source being read.
pub struct Feed {
    inner: Inner,
}

enum Inner {
    Stored(Box<dyn Source>, Stats),
    Live { shared: Arc<Shared>, stop: Arc<AtomicBool>, thread: Option<JoinHandle<()>> },
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    newest: Option<(Shot, Instant)>,
    stats: Stats,
    /// Lost and back again, in order, not yet reported.
    news: Vec<Event>,
    /// When the last picture came (or the source was opened), and how often its silence has been reported since.
    last: Option<Instant>,
    reported: u32,
}

impl Shared {
    fn with<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        // A thread that panicked while it held the lock has at worst left a picture behind.
        let result = change(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner));
        self.changed.notify_all();
        result
    }
}

impl Feed {
    /// Opens a source: a device's number, a video file, a folder of pictures or an `http://` MJPEG stream.
    pub fn open(source: &str) -> Result<Self> {
        let inner = match name(source)? {
            Named::Stored(source) => Inner::Stored(source, Stats::default()),
            Named::Live(open) => {
                let shared = Arc::new(Shared::default());
                let stop = Arc::new(AtomicBool::new(false));
                let (theirs, flag) = (Arc::clone(&shared), Arc::clone(&stop));
                let thread = std::thread::Builder::new()
                    .name("pictures".into())
                    .spawn(move || keep_reading(&*open, &theirs, &flag))
                    .map_err(|e| Error::io("thread", "create", e))?;
                Inner::Live { shared, stop, thread: Some(thread) }
            }
        };
        Ok(Self { inner })
    }

    /// Whether pictures come of themselves.
    pub fn is_live(&self) -> bool {
        matches!(self.inner, Inner::Live { .. })
    }

    /// Counts so far.
    pub fn stats(&self) -> Stats {
        match &self.inner {
            Inner::Stored(_, stats) => *stats,
            Inner::Live { shared, .. } => shared.with(|s| s.stats),
        }
    }

    /// Drops a picture that already waits: the next one is taken after this call.
    pub fn freshen(&mut self) {
        if let Inner::Live { shared, .. } = &self.inner {
            shared.with(|s| s.stats.dropped += u64::from(s.newest.take().is_some()));
        }
    }

    /// Waits for the next picture or for news of the source. A silent live source is reported again and again.
    pub fn wait(&mut self) -> Result<Event> {
        match &mut self.inner {
            Inner::Stored(source, stats) => Ok(match source.next()? {
                Some(shot) => {
                    stats.received += 1;
                    Event::Shot(shot, Instant::now())
                }
                None => Event::Ended,
            }),
            Inner::Live { shared, .. } => {
                let mut state = shared.state.lock().unwrap_or_else(PoisonError::into_inner);
                loop {
                    if !state.news.is_empty() {
                        return Ok(state.news.remove(0));
                    }
                    if let Some((shot, at)) = state.newest.take() {
                        return Ok(Event::Shot(shot, at));
                    }
                    let silent = state.last.get_or_insert_with(Instant::now).elapsed();
                    let patience = STALL * (state.reported + 1);
                    if silent >= patience {
                        state.reported += 1;
                        return Ok(Event::Stalled(silent));
                    }
                    state = shared
                        .changed
                        .wait_timeout(state, patience - silent)
                        .unwrap_or_else(PoisonError::into_inner)
                        .0;
                }
            }
        }
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        if let Inner::Live { stop, thread, .. } = &mut self.inner {
            stop.store(true, Ordering::Relaxed);
            // Its reads look at the flag ten times a second; a driver that hangs is left to the system.
            if let Some(thread) = thread.take() {
                let patience = Instant::now();
                while !thread.is_finished() && patience.elapsed() < Duration::from_millis(500) {
                    std::thread::sleep(Duration::from_millis(10));
                }
            }
        }
    }
}

/// The reading thread: opens, reads, opens again.
fn keep_reading(open: &Open, shared: &Shared, stop: &Arc<AtomicBool>) {
    let mut lost = false;
    while !stop.load(Ordering::Relaxed) {
        let reason = match open(Arc::clone(stop)) {
            Ok(mut source) => {
                let mut fresh = true;
                loop {
                    match source.next() {
                        Ok(Some(shot)) => shared.with(|s| {
                            if fresh && lost {
                                s.stats.reconnects += 1;
                                s.news.push(Event::Back);
                                lost = false;
                            }
                            fresh = false;
                            s.stats.received += 1;
                            let now = Instant::now();
                            (s.last, s.reported) = (Some(now), 0);
                            let old = s.newest.replace((shot, now));
                            s.stats.dropped += u64::from(old.is_some());
                        }),
                        Ok(None) => break "the stream has ended".to_owned(),
                        Err(e) => break e.to_string(),
                    }
                    if stop.load(Ordering::Relaxed) {
                        return;
                    }
                }
            }
            Err(e) => e.to_string(),
        };
        if !lost {
            lost = true;
            shared.with(|s| s.news.push(Event::Lost(reason)));
        }
        std::thread::sleep(RETRY);
    }
}
