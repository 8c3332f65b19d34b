//! Where a run writes to: its console, and files of results, which are opened before the run, since nothing can be
//! opened after its start.

use std::fs;
use std::io::{self, ErrorKind, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::Options;
use crate::outlet::{Outlet, StandardOutput, Trace};
use crate::run_error::RunError;
use crate::samples::Samples;
use crate::screen;

/// Room for what waits for the trace's file: some seconds of a partition at 1000 windows a second.
const TRACE_BYTES: usize = 4 << 20;

/// How long the end of a run waits for what it has to say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Patience {
    /// For a reader that takes nothing at all.
    stalled: Duration,
    /// For one that takes a little again and again.
    slow: Duration,
}

impl Patience {
    /// Waits for the reader of Takt's own output, if there is one.
    pub fn settle(self, console: &Outlet) {
        console.settle(self.stalled, self.slow);
    }

    /// Writes all of it to a file that does not wait.
    fn write(self, file: &mut fs::File, mut bytes: &[u8]) -> io::Result<()> {
        let end = Instant::now() + self.slow;
        while !bytes.is_empty() {
            match file.write(bytes) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => bytes = bytes.get(count..).unwrap_or_default(),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    let left = end.saturating_duration_since(Instant::now());
                    if left.is_zero() || !is_writable_within(file, self.stalled.min(left)) {
                        return Err(ErrorKind::TimedOut.into());
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// For the trace: a disk may take its time, also behind a signal.
    fn for_trace(self, is_on_disk: bool) -> Self {
        if is_on_disk { Self::LONG } else { self }
    }

    /// Somebody has sent a signal, and kills what does not end.
    pub const SHORT: Self =
        Self { stalled: Duration::from_millis(20), slow: Duration::from_millis(30) };
    pub const LONG: Self = Self { stalled: Duration::from_secs(1), slow: Duration::from_secs(5) };
}

/// All of it.
pub(super) struct Outputs {
    /// Where the screen is.
    pub console: Arc<Outlet>,
    /// Where every window is written to.
    pub trace: Option<TraceFile>,
    pub report: Option<Output>,
    pub samples: Option<Output>,
    pub patience: Patience,
}

/// Where a trace goes.
pub(super) struct TraceFile {
    pub outlet: Arc<Outlet>,
    path: PathBuf,
    is_on_disk: bool,
}

impl TraceFile {
    /// Whether it is a file on a disk, and nothing with a reader that may take nothing.
    fn is_on_disk(file: &fs::File) -> io::Result<bool> {
        file.metadata().map(|it| it.is_file())
    }
}

impl Outputs {
    /// Opens what the options ask for.
    pub(super) fn open(options: &Options, partitions: usize) -> Result<Self, RunError> {
        let create = |what, path: &Option<PathBuf>| {
            path.as_deref().map(|path| Output::create(what, path)).transpose()
        };
        let (report, samples) =
            (create("report", &options.report)?, create("samples", &options.samples)?);
        let trace = |path: &PathBuf| -> Result<_, RunError> {
            // What it was is gone.
            let file = fs::File::create(path).map_err(cannot_write("trace", path))?;
            let is_on_disk = TraceFile::is_on_disk(&file).map_err(cannot_write("trace", path))?;
            let outlet = Outlet::start("trace", options.seccomp, &[TRACE_BYTES], file)?;
            Ok(TraceFile { outlet: Arc::new(outlet), path: path.clone(), is_on_disk })
        };
        let trace = options.trace.as_ref().map(trace).transpose()?;
        let quotas = screen::quotas(partitions);
        let console = Outlet::start("console", options.seccomp, &quotas, StandardOutput::new())?;
        Ok(Self { console: Arc::new(console), trace, report, samples, patience: Patience::LONG })
    }

    /// Waits for the reader of Takt's own output, if there is one.
    pub(super) fn settle(&self) {
        self.patience.settle(&self.console);
    }

    /// Ends the trace and writes the samples, where there are any; returns how many events the trace's file has not got, and the
    /// first error. The samples are written also if the trace is not.
    pub(super) fn finish(
        &mut self,
        trace: Option<Trace>,
        samples: impl FnOnce() -> Samples,
    ) -> (u64, Result<(), RunError>) {
        let dropped = trace.as_ref().map_or(0, Trace::dropped);
        let traced = self.finish_trace(trace);
        let write = |file: Output| file.write(serde_json::to_string(&samples()), self.patience);
        let sampled = self.samples.take().map_or(Ok(()), write);
        (dropped, traced.and(sampled))
    }

    fn finish_trace(&self, trace: Option<Trace>) -> Result<(), RunError> {
        let (Some(trace), Some(file)) = (trace, &self.trace) else { return Ok(()) };
        let TraceFile { outlet, path, is_on_disk } = file;
        let failed = cannot_write("trace", path);
        let Patience { stalled, slow } = self.patience.for_trace(*is_on_disk);
        outlet.settle(stalled, slow);
        let ended = trace.finish();
        let settled = outlet.settle(stalled, slow);
        match outlet.take_error() {
            Some(error) => Err(failed(error)),
            None if !settled => Err(failed(io::ErrorKind::TimedOut.into())),
            None => ended.map_err(failed),
        }
    }
}

/// A file of results, opened while files can be. What is no file on a disk may have a reader that takes nothing: it is waited for
/// as long as that of Takt's own output.
pub(super) struct Output {
    what: &'static str,
    path: PathBuf,
    file: fs::File,
}

impl Output {
    /// Opens it; what it has stays there until it is written.
    fn create(what: &'static str, path: &Path) -> Result<Self, RunError> {
        let open = || {
            let file = fs::File::options().write(true).create(true).truncate(false).open(path)?;
            if file.metadata()?.is_file() {
                return Ok(file);
            }
            // Only now: to open it may be to wait for its reader. Opened again, since the setting belongs to what was opened, which
            // others may have too.
            let opened = format!("/proc/self/fd/{}", file.as_raw_fd());
            fs::File::options().write(true).custom_flags(libc::O_NONBLOCK).open(opened)
        };
        let file = open().map_err(cannot_write(what, path))?;
        Ok(Self { what, path: path.to_owned(), file })
    }

    pub(super) fn write(
        self,
        json: serde_json::Result<String>,
        patience: Patience,
    ) -> Result<(), RunError> {
        let Self { what, path, mut file } = self;
        let write = || {
            let mut json = json?;
            json.push('\n');
            if file.metadata()?.is_file() {
                file.set_len(0)?;
            }
            patience.write(&mut file, json.as_bytes())
        };
        write().map_err(cannot_write(what, &path))
    }
}

/// Whether a write would get on, or fail, before so much time has passed.
fn is_writable_within(file: &fs::File, time: Duration) -> bool {
    let mut descriptor = libc::pollfd { fd: file.as_raw_fd(), events: libc::POLLOUT, revents: 0 };
    let milliseconds = time.as_millis().try_into().unwrap_or(libc::c_int::MAX);
    // SAFETY: one live descriptor is read and written.
    let ready = unsafe { libc::poll(&raw mut descriptor, 1, milliseconds) };
    // A signal is none of the file's.
    ready > 0 || ready < 0 && io::Error::last_os_error().kind() == ErrorKind::Interrupted
}

fn cannot_write(what: &'static str, path: &Path) -> impl Fn(io::Error) -> RunError + use<> {
    let path = path.to_owned();
    move |source| RunError::Output { what, path: path.clone(), source }
}

#[cfg(test)]
mod tests {
    use takt_scheduler::time::{Timebase, Tsc, TscFrequency};

    use super::*;
    use crate::outlet::LaneWriter;

    #[test]
    fn samples_are_written_though_the_trace_cannot_be() {
        let path = std::env::temp_dir().join(format!("takt-samples-{}", std::process::id()));
        fs::write(&path, "what an older run has left\n").unwrap();
        let started = |sink| {
            let (outlet, work) = Outlet::new(&[4096], sink);
            std::thread::spawn(work);
            Arc::new(outlet)
        };
        let full = || fs::File::options().write(true).open("/dev/full").unwrap();
        let trace = started(full());
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let base = Timebase { epoch: Tsc(0), frequency };
        let lane = LaneWriter { outlet: trace.clone(), lane: 0 };
        let mut outputs = Outputs {
            console: started(full()),
            trace: Some(TraceFile { outlet: trace, path: "/dev/full".into(), is_on_disk: false }),
            report: None,
            samples: Some(Output::create("samples", &path).unwrap()),
            patience: Patience::LONG,
        };
        let samples = || Samples { schema_version: 2, partitions: Vec::new(), loads: Vec::new() };
        let (_, written) = outputs.finish(Some(Trace::new(lane, base, &[], &["normal"])), samples);
        let error = written.unwrap_err().to_string();
        assert!(error.starts_with("cannot write the trace to /dev/full: "), "{error}");
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(text, "{\"schema_version\":2,\"partitions\":[],\"loads\":[]}\n");
        fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_trace_to_a_reader_is_waited_for_as_all_else_is_and_one_to_a_disk_for_long() {
        let to = |path: &str| {
            let file = fs::File::options().write(true).open(path).unwrap();
            TraceFile::is_on_disk(&file).unwrap()
        };
        let path = std::env::temp_dir().join(format!("takt-trace-{}", std::process::id()));
        fs::write(&path, "").unwrap();
        assert_eq!(Patience::SHORT.for_trace(to(path.to_str().unwrap())), Patience::LONG);
        assert_eq!(Patience::SHORT.for_trace(to("/dev/null")), Patience::SHORT);
        fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_report_is_not_waited_for_where_its_reader_takes_nothing() {
        let path = std::env::temp_dir().join(format!("takt-report-{}", std::process::id()));
        let name = std::ffi::CString::new(path.to_str().unwrap()).unwrap();
        // SAFETY: a live string is read.
        assert_eq!(unsafe { libc::mkfifo(name.as_ptr(), 0o600) }, 0);
        let reader = fs::File::options().read(true).write(true).open(&path).unwrap();
        let write = |text: String| {
            let output = Output::create("report", &path).unwrap();
            output.write(Ok(text), Patience::SHORT)
        };
        write("short".into()).unwrap();
        // More than a pipe has room for.
        let error = write("x".repeat(1 << 20)).unwrap_err().to_string();
        assert!(error.contains("timed out"), "{error}");
        drop(reader);
        fs::remove_file(&path).unwrap();
    }
}
