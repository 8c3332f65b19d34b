//! A Linux program full of timers, which also tells how late they are.
//!
//!     timers SECONDS [storm|measure]
//!
//! `storm`: three threads, each with a timer of 20 kHz, of a kind of its own: a POSIX timer that
//! sends signals, a descriptor that is read, and sleeps of 50 us. In between they compute.
//! `measure`: sleeps to instants that lie 1 ms and a bit apart, as cyclictest does, and prints how much
//! later it woke up, once the kernel has settled. A storm prints how often each timer went off: one that makes no progress is none.
//! Both print a line of JSON.
//!
//! Exit status 0: the time is over; 1: a call has failed.

use std::io;
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// 20 kHz.
const PERIOD_NS: i64 = 50_000;
/// No divisor of a frame, so that all phases to it come up.
const SLEEP_NS: i64 = 1_000_000 + 37_000;
/// In the first half second after its start a kernel 6.12 is busy with its own several times, for 27 ms, also without a
/// storm and before tasks of any priority.
const SETTLING_NS: i64 = 600_000_000;

static SIGNALS: AtomicU64 = AtomicU64::new(0);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let time = arguments.first().and_then(|seconds| seconds.parse().ok()).map(Duration::from_secs);
    let done = match (time, arguments.get(1).map(String::as_str)) {
        (Some(time), Some("storm")) => storm(time),
        (Some(time), Some("measure")) => measure(time),
        _ => {
            eprintln!("usage: timers SECONDS storm|measure");
            return ExitCode::from(64);
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("timers: {error}");
            ExitCode::FAILURE
        }
    }
}

fn storm(time: Duration) -> io::Result<()> {
    let end = Instant::now() + time;
    let threads = [thread::spawn(move || signals(end)), thread::spawn(move || descriptor(end))];
    let mut counts = vec![sleeps(end)?];
    for thread in threads {
        counts.push(thread.join().map_err(|_| io::Error::other("a thread has died"))??);
    }
    let [sleeps, expirations, signals] = [counts[0], counts[2], counts[1]];
    println!(
        "timers: {{\"sleeps\": {sleeps}, \"signals\": {signals}, \"expirations\": {expirations}}}"
    );
    Ok(())
}

fn period() -> libc::itimerspec {
    let time = libc::timespec { tv_sec: 0, tv_nsec: PERIOD_NS };
    libc::itimerspec { it_interval: time, it_value: time }
}

extern "C" fn count(_: libc::c_int) {
    SIGNALS.fetch_add(1, Ordering::Relaxed);
}

/// A POSIX timer's signals, while the thread computes.
fn signals(end: Instant) -> io::Result<u64> {
    // SAFETY: the handler only adds to an atomic; all structures are live, and zero is a valid state
    // of those that the kernel fills in or that have more fields than are set.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        action.sa_sigaction = count as *const () as usize;
        action.sa_flags = libc::SA_RESTART;
        check(libc::sigaction(libc::SIGALRM, &raw const action, std::ptr::null_mut()))?;
        let mut event: libc::sigevent = std::mem::zeroed();
        event.sigev_notify = libc::SIGEV_THREAD_ID;
        event.sigev_signo = libc::SIGALRM;
        event.sigev_notify_thread_id = libc::syscall(libc::SYS_gettid) as i32;
        let mut timer: libc::timer_t = std::mem::zeroed();
        check(libc::timer_create(libc::CLOCK_MONOTONIC, &raw mut event, &raw mut timer))?;
        check(libc::timer_settime(timer, 0, &period(), std::ptr::null_mut()))?;
    }
    let mut number = 1u64;
    while Instant::now() < end {
        for _ in 0..10_000 {
            number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        }
        std::hint::black_box(number);
    }
    Ok(SIGNALS.load(Ordering::Relaxed))
}

/// A timer's descriptor, read again and again.
fn descriptor(end: Instant) -> io::Result<u64> {
    // SAFETY: takes no pointer.
    let timer = unsafe { libc::timerfd_create(libc::CLOCK_MONOTONIC, 0) };
    check(timer)?;
    // SAFETY: the structure is live, and the old value is not asked for.
    check(unsafe { libc::timerfd_settime(timer, 0, &period(), std::ptr::null_mut()) })?;
    let mut total = 0;
    while Instant::now() < end {
        let mut count = 0u64;
        // SAFETY: eight bytes are written into a live number.
        let read = unsafe { libc::read(timer, (&raw mut count).cast(), 8) };
        check(read as libc::c_int)?;
        total += count;
    }
    Ok(total)
}

fn sleeps(end: Instant) -> io::Result<u64> {
    let mut count = 0;
    while Instant::now() < end {
        thread::sleep(Duration::from_nanos(PERIOD_NS as u64));
        count += 1;
    }
    Ok(count)
}

fn now_ns() -> i64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: fills in a live structure; cannot fail for this clock.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    now.tv_sec * 1_000_000_000 + now.tv_nsec
}

fn measure(time: Duration) -> io::Result<()> {
    // As cyclictest: nothing of Linux's own comes before it.
    let priority = libc::sched_param { sched_priority: 80 };
    // SAFETY: the kernel reads a live structure.
    check(unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const priority) })?;
    let mut due = now_ns() + SLEEP_NS;
    let settled = due + SETTLING_NS;
    let end = due + i64::try_from(time.as_nanos()).unwrap_or(i64::MAX);
    let mut late = Vec::new();
    while due < end {
        let at = libc::timespec { tv_sec: due / 1_000_000_000, tv_nsec: due % 1_000_000_000 };
        // SAFETY: the time is live and normalised; no rest is asked for.
        let slept = unsafe {
            libc::clock_nanosleep(
                libc::CLOCK_MONOTONIC,
                libc::TIMER_ABSTIME,
                &raw const at,
                std::ptr::null_mut(),
            )
        };
        if slept != 0 {
            return Err(io::Error::from_raw_os_error(slept));
        }
        if due >= settled {
            late.push(now_ns() - due);
        }
        due += SLEEP_NS;
    }
    late.sort_unstable();
    let of = |permille: usize| late[(late.len() - 1) * permille / 1000];
    println!(
        "timers: {{\"late_ns\": {{\"min\": {}, \"p50\": {}, \"p99\": {}, \"max\": {}}}}}",
        of(0),
        of(500),
        of(990),
        of(1000)
    );
    Ok(())
}

fn check(result: libc::c_int) -> io::Result<()> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}
