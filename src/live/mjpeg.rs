//! MJPEG over HTTP: `multipart/x-mixed-replace`, as network cameras and mjpg-streamer send it.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::error::{Error, Result};
use crate::live::source::{Shot, Source};

/// How long a connection may take.
const CONNECT: Duration = Duration::from_secs(2);
/// A stream silent for this long is opened again.
const SILENCE: Duration = Duration::from_secs(4);
/// How often a waiting read looks whether it should stop.
const LOOK: Duration = Duration::from_millis(100);
/// The largest frame taken in, in bytes.
const MOST_BYTES: usize = 64 << 20;

/// An open stream.
pub(super) struct Stream {
    wire: Wire,
    boundary: Vec<u8>,
}

struct Address<'a> {
    host: &'a str,
    port: u16,
    path: &'a str,
}

impl Stream {
    /// Whether the URL can be meant.
    pub fn check(url: &str) -> Result<()> {
        address(url).map(|_| ())
    }

    /// Connects and reads the answer's head. Reads end where `stop` is set.
    pub fn open(url: &str, stop: Arc<AtomicBool>) -> Result<Self> {
        let Address { host, port, path } = address(url)?;
        let fail = |e: std::io::Error| lost(url, format!("no connection: {e}"));
        let mut last = lost(url, "the host's name has no address".into());
        let name = host.trim_start_matches('[').trim_end_matches(']');
        for place in (name, port).to_socket_addrs().map_err(fail)? {
            match TcpStream::connect_timeout(&place, CONNECT) {
                Ok(socket) => return Self::ask(url, host, path, socket, stop),
                Err(e) => last = fail(e),
            }
        }
        Err(last)
    }

    fn ask(
        url: &str,
        host: &str,
        path: &str,
        mut socket: TcpStream,
        stop: Arc<AtomicBool>,
    ) -> Result<Self> {
        let fail = |e: std::io::Error| lost(url, e.to_string());
        socket.set_read_timeout(Some(LOOK)).map_err(fail)?;
        socket.set_write_timeout(Some(CONNECT)).map_err(fail)?;
        // HTTP 1.0, so that the answer does not come in chunks.
        let request = format!("GET {path} HTTP/1.0\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        socket.write_all(request.as_bytes()).map_err(fail)?;
        let mut wire = Wire { url: url.to_owned(), socket, buffer: Vec::new(), at: 0, stop };
        let status = wire.line()?;
        if status.split(' ').nth(1) != Some("200") {
            return Err(lost(url, format!("answers '{status}'")));
        }
        let mut kind = String::new();
        loop {
            let line = wire.line()?;
            if line.is_empty() {
                break;
            }
            if let Some((name, value)) = line.split_once(':')
                && name.eq_ignore_ascii_case("content-type")
            {
                kind = value.trim().to_owned();
            }
        }
        let boundary = kind
            .split(';')
            .filter_map(|p| p.trim().split_once('='))
            .find(|(name, _)| name.eq_ignore_ascii_case("boundary"))
            .map(|(_, b)| b.trim_matches('"').trim_start_matches("--").to_owned());
        match boundary {
            Some(b) if kind.to_lowercase().starts_with("multipart/") && !b.is_empty() => {
                Ok(Self { wire, boundary: format!("--{b}").into_bytes() })
            }
            _ => Err(lost(url, format!("is no MJPEG stream but '{kind}'"))),
        }
    }
}

impl Source for Stream {
    fn next(&mut self) -> Result<Option<Shot>> {
        // Up to the boundary, then the part's own head.
        self.wire.until(&self.boundary)?;
        if self.wire.line()?.starts_with("--") {
            return Ok(None);
        }
        let mut length = None;
        loop {
            let line = self.wire.line()?;
            if line.is_empty() {
                break;
            }
            if let Some((name, value)) = line.split_once(':')
                && name.eq_ignore_ascii_case("content-length")
            {
                length = value.trim().parse::<usize>().ok();
            }
        }
        let bytes = match length {
            Some(n) => self.wire.take(n)?,
            None => self.wire.peek_until(&self.boundary)?,
        };
        Ok(Some(Shot::Encoded(bytes, None)))
    }
}

/// A socket read in whole lines and blocks, whatever pieces they come in.
struct Wire {
    url: String,
    socket: TcpStream,
    buffer: Vec<u8>,
    at: usize,
    stop: Arc<AtomicBool>,
}

impl Wire {
    /// Waits for more bytes.
    fn fill(&mut self) -> Result<()> {
        if self.at > 0 {
            self.buffer.drain(..self.at);
            self.at = 0;
        }
        if self.buffer.len() > MOST_BYTES {
            return Err(lost(&self.url, "sends a frame that does not end".into()));
        }
        let since = Instant::now();
        let mut piece = [0u8; 1 << 16];
        loop {
            if self.stop.load(Ordering::Relaxed) {
                return Err(lost(&self.url, "closed".into()));
            }
            match self.socket.read(&mut piece) {
                Ok(0) => return Err(lost(&self.url, "the stream has ended".into())),
                Ok(n) => {
                    self.buffer.extend_from_slice(&piece[..n]);
                    return Ok(());
                }
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    if since.elapsed() > SILENCE {
                        return Err(lost(&self.url, format!("silent for {} s", SILENCE.as_secs())));
                    }
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(lost(&self.url, e.to_string())),
            }
        }
    }

    /// Where `mark` begins in the buffer; waits for it.
    fn find(&mut self, mark: &[u8]) -> Result<usize> {
        let mut from = self.at;
        loop {
            let rest = &self.buffer[from..];
            if let Some(i) = rest.windows(mark.len()).position(|w| w == mark) {
                return Ok(from + i);
            }
            let tail = self.buffer.len().saturating_sub(mark.len() - 1).max(self.at) - self.at;
            self.fill()?;
            from = self.at + tail;
        }
    }

    fn line(&mut self) -> Result<String> {
        let end = self.find(b"\n")?;
        let line = String::from_utf8_lossy(&self.buffer[self.at..end]).trim_end().to_owned();
        self.at = end + 1;
        Ok(line)
    }

    /// Skips to behind `mark`.
    fn until(&mut self, mark: &[u8]) -> Result<()> {
        self.at = self.find(mark)? + mark.len();
        Ok(())
    }

    /// What comes before `mark`, which is left.
    fn peek_until(&mut self, mark: &[u8]) -> Result<Vec<u8>> {
        let end = self.find(mark)?;
        let bytes = self.buffer[self.at..end].to_vec();
        self.at = end;
        Ok(bytes)
    }

    fn take(&mut self, n: usize) -> Result<Vec<u8>> {
        if n > MOST_BYTES {
            return Err(lost(&self.url, format!("announces a frame of {n} bytes")));
        }
        while self.buffer.len() - self.at < n {
            self.fill()?;
        }
        let bytes = self.buffer[self.at..self.at + n].to_vec();
        self.at += n;
        Ok(bytes)
    }
}

fn address(url: &str) -> Result<Address<'_>> {
    let bad = || {
        Error::option(
            "SOURCE",
            format!("'{url}' is no address of a stream"),
            "write http://HOST:PORT/PATH",
        )
    };
    let rest = url.strip_prefix("http://").ok_or_else(bad)?;
    let (place, path) = match rest.find('/') {
        Some(i) => rest.split_at(i),
        None => (rest, "/"),
    };
    // Colons within brackets are a number's (`[::1]:8080`).
    let (host, port) =
        match place.rfind(':').filter(|at| place.rfind(']').is_none_or(|end| *at > end)) {
            Some(at) => (&place[..at], place[at + 1..].parse().map_err(|_| bad())?),
            None => (place, 80),
        };
    if host.is_empty() || host.contains(['@', ' ']) || path.contains(['\r', '\n', ' ']) {
        return Err(bad());
    }
    Ok(Address { host, port, path })
}

fn lost(url: &str, reason: String) -> Error {
    Error::measure(url, reason, "check the camera, its address and the network")
}
