//! The measurement, the same for every transport.

#![allow(unsafe_code)]

use std::io;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

use takt_tests::record::{number, record};

use crate::{BYTES, Ends, Receiving, Sending};

/// Messages before the first that counts.
const WARM_UP: usize = 100;

/// One-way times in ns.
#[derive(Debug)]
pub struct Times {
    pub median: u64,
    pub p99: u64,
}

/// What was measured of a transport.
#[derive(Debug)]
pub struct Measured {
    /// One thread sends and receives.
    pub alone: Times,
    /// CPU time of both operations, in ns for each message.
    pub cpu: u64,
    /// A thread sends, another one waits.
    pub two: Times,
}

/// Measures a transport.
pub fn measure((mut sending, mut receiving): Ends, count: usize) -> io::Result<Measured> {
    let (begin, begin_ticks) = (Instant::now(), tsc());
    let (alone, cpu) = one_thread(&mut *sending, &mut *receiving, count)?;
    let two = two_threads(&mut *sending, &mut *receiving, count)?;
    let ns_per_tick = begin.elapsed().as_nanos() as f64 / (tsc() - begin_ticks).max(1) as f64;
    let times = |ticks| times(ticks, ns_per_tick);
    Ok(Measured { alone: times(alone), cpu: cpu / count as u64, two: times(two) })
}

fn one_thread(
    sending: &mut dyn Sending,
    receiving: &mut dyn Receiving,
    count: usize,
) -> io::Result<(Vec<u64>, u64)> {
    let mut ticks = Vec::with_capacity(count);
    let mut buffer = [0; BYTES];
    let mut cpu = 0;
    for n in 0..WARM_UP + count {
        if n == WARM_UP {
            cpu = cpu_time()?;
        }
        let message = record(n as u64);
        let begin = tsc();
        sending.send(&message)?;
        receiving.receive(&mut buffer)?;
        let end = tsc();
        check(&buffer, n)?;
        if n >= WARM_UP {
            ticks.push(end - begin);
        }
    }
    Ok((ticks, cpu_time()? - cpu))
}

fn two_threads(
    sending: &mut dyn Sending,
    receiving: &mut dyn Receiving,
    count: usize,
) -> io::Result<Vec<u64>> {
    // The instant of each send, which the receiver compares with its own.
    let sent: Vec<AtomicUsize> = (0..WARM_UP + count).map(|_| AtomicUsize::new(0)).collect();
    let taken = AtomicUsize::new(0);
    thread::scope(|scope| {
        let receiver = scope.spawn(|| {
            let mut ticks = Vec::with_capacity(count);
            let mut buffer = [0; BYTES];
            let mut result = Ok(());
            for (n, sent) in sent.iter().enumerate() {
                result = receiving.receive(&mut buffer).and_then(|()| check(&buffer, n));
                let end = tsc();
                if n >= WARM_UP {
                    ticks.push(end - sent.load(Ordering::Acquire) as u64);
                }
                taken.store(n + 1, Ordering::Release);
                if result.is_err() {
                    break;
                }
            }
            // The sender must not wait for one that has given up.
            taken.store(usize::MAX, Ordering::Release);
            result.map(|()| ticks)
        });
        for (n, instant) in sent.iter().enumerate() {
            let message = record(n as u64);
            instant.store(tsc() as usize, Ordering::Release);
            sending.send(&message)?;
            while taken.load(Ordering::Acquire) <= n {
                thread::yield_now();
            }
        }
        receiver.join().unwrap_or_else(|_| Err(io::Error::other("the receiver has panicked")))
    })
}

fn check(message: &[u8], expected: usize) -> io::Result<()> {
    if number(message) == Some(expected as u64) {
        return Ok(());
    }
    let found = format!("message {expected} came as {:?}", number(message));
    Err(io::Error::new(io::ErrorKind::InvalidData, found))
}

fn times(mut ticks: Vec<u64>, ns_per_tick: f64) -> Times {
    ticks.sort_unstable();
    let at = |part: usize| {
        let place = (ticks.len() * part / 100).min(ticks.len().saturating_sub(1));
        (ticks.get(place).copied().unwrap_or(0) as f64 * ns_per_tick) as u64
    };
    Times { median: at(50), p99: at(99) }
}

fn tsc() -> u64 {
    // SAFETY: every x86-64 processor has the instruction, and it is not disabled here.
    unsafe { std::arch::x86_64::_rdtsc() }
}

/// CPU time of the process in ns, in its own code and in the kernel's.
fn cpu_time() -> io::Result<u64> {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the kernel writes to `time`, which lives through the call.
    match unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &raw mut time) } {
        0 => Ok((time.tv_sec * 1_000_000_000 + time.tv_nsec).cast_unsigned()),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_and_p99_are_those_of_the_sorted_times() {
        let times = times((1..=200).rev().collect(), 2.0);
        assert_eq!((times.median, times.p99), (202, 398));
    }

    #[test]
    fn a_wrong_message_ends_the_measurement_at_both_ends() {
        struct Mute;
        struct Wrong;
        impl Sending for Mute {
            fn send(&mut self, _: &[u8; BYTES]) -> io::Result<()> {
                Ok(())
            }
        }
        impl Receiving for Wrong {
            fn receive(&mut self, message: &mut [u8; BYTES]) -> io::Result<()> {
                *message = record(u64::MAX);
                Ok(())
            }
        }
        let error = one_thread(&mut Mute, &mut Wrong, 5).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidData);
        let error = two_threads(&mut Mute, &mut Wrong, 5).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidData);
    }
}
