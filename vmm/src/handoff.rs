//! Passing things to or from a partition's thread, without a wait on that thread's side.
//!
//! The channels of the standard library give the processor away (`sched_yield`) where their two ends
//! meet in the middle of an operation. A deadline thread that does so loses the rest of its window
//! (`sched_yield(2)` ends its runtime until the next period), and the filter of a PLC's thread has no such
//! call: it would end Takt. So what such a thread gives or takes goes through a ring of rtrb: each operation
//! on it ends after a fixed number of steps, whatever the other end does.
//!
//! A thread of the ordinary class may wait at its end ([`Taker::wait`]). It is woken by the giver, at the
//! price of a system call there. A taker that only looks ([`Taker::take`]) is never woken.

use std::sync::atomic::{Ordering, fence};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{self, Thread};
use std::time::Duration;

use rtrb::{Consumer, Producer, RingBuffer};

/// The thread that waits at the taker's end, once it has done so.
type Waiter = Arc<OnceLock<Thread>>;

/// Makes both ends of a way for this many things at a time.
#[must_use]
pub fn handoff<T>(room: usize) -> (Giver<T>, Taker<T>) {
    let (things, taken) = RingBuffer::new(room);
    let waiter = Waiter::default();
    (Giver { things: Some(things), waiter: waiter.clone() }, Taker { things: taken, waiter })
}

/// The end that gives. When it is dropped, the taker gets what is on its way, and then nothing more.
pub struct Giver<T> {
    /// Until the end is dropped.
    things: Option<Producer<T>>,
    waiter: Waiter,
}

impl<T> Giver<T> {
    /// Gives a thing. It comes back if there is no room for it, or the taker is gone.
    ///
    /// # Errors
    /// The thing.
    pub fn give(&mut self, thing: T) -> Result<(), T> {
        match &mut self.things {
            Some(things) if !things.is_abandoned() => {
                things.push(thing).map_err(|rtrb::PushError::Full(thing)| thing)?;
            }
            _ => return Err(thing),
        }
        self.wake();
        Ok(())
    }

    /// True if the taker is gone.
    pub fn is_gone(&self) -> bool {
        self.things.as_ref().is_none_or(Producer::is_abandoned)
    }

    fn wake(&self) {
        // Pairs with the one in `wait`: either this sees the waiter, or the waiter sees the thing.
        fence(Ordering::SeqCst);
        if let Some(waiter) = self.waiter.get() {
            waiter.unpark();
        }
    }
}

impl<T> Drop for Giver<T> {
    fn drop(&mut self) {
        drop(self.things.take());
        self.wake();
    }
}

/// Locks what nothing that happens under the lock leaves half-done. Not on the path of a window.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Nothing comes any more: the giver is gone, and what it gave has been taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gone;

/// The end that takes.
pub struct Taker<T> {
    things: Consumer<T>,
    waiter: Waiter,
}

impl<T> Taker<T> {
    /// What has come, if anything has.
    ///
    /// # Errors
    /// [`Gone`].
    pub fn take(&mut self) -> Result<Option<T>, Gone> {
        // Before the look into the ring: a giver gives nothing after its end.
        let gone = self.things.is_abandoned();
        match self.things.pop() {
            Ok(thing) => Ok(Some(thing)),
            Err(_) if gone => Err(Gone),
            Err(_) => Ok(None),
        }
    }

    /// Waits for a thing, or until this is so, after which the thread is unparked. It is woken by no timer.
    ///
    /// # Errors
    /// [`Gone`].
    pub fn wait_unless(&mut self, over: impl Fn() -> bool) -> Result<Option<T>, Gone> {
        self.waiter.get_or_init(thread::current);
        fence(Ordering::SeqCst);
        loop {
            let taken = self.take()?;
            if taken.is_some() || over() {
                return Ok(taken);
            }
            thread::park();
        }
    }

    /// Waits for a thing, but no longer than this, if there is a limit. Only for a thread of the ordinary
    /// class, and always the same.
    ///
    /// # Errors
    /// [`Gone`].
    pub fn wait(&mut self, at_most: Option<Duration>) -> Result<Option<T>, Gone> {
        self.waiter.get_or_init(thread::current);
        fence(Ordering::SeqCst);
        loop {
            if let Some(thing) = self.take()? {
                return Ok(Some(thing));
            }
            match at_most {
                // A wake-up without a reason comes before the time is over, and does no harm.
                Some(time) => {
                    thread::park_timeout(time);
                    return self.take();
                }
                None => thread::park(),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_given_comes_once_and_in_order() {
        let (mut giver, mut taker) = handoff(2);
        assert_eq!(taker.take(), Ok(None));
        assert_eq!((giver.give(1), giver.give(2), giver.give(3)), (Ok(()), Ok(()), Err(3)));
        assert_eq!(
            (taker.take(), taker.take(), taker.take()),
            (Ok(Some(1)), Ok(Some(2)), Ok(None))
        );
    }

    #[test]
    fn the_last_thing_comes_before_the_end() {
        let (mut giver, mut taker) = handoff(1);
        giver.give(1).unwrap();
        drop(giver);
        assert_eq!((taker.take(), taker.take()), (Ok(Some(1)), Err(Gone)));
        assert_eq!(taker.wait(None), Err(Gone));
    }

    #[test]
    fn a_taker_that_is_gone_takes_nothing() {
        let (mut giver, taker) = handoff(1);
        drop(taker);
        assert_eq!(giver.give(1), Err(1));
    }

    #[test]
    fn a_taker_that_waits_gets_everything_and_then_the_end() {
        let (mut giver, mut taker) = handoff(1);
        let taken = thread::spawn(move || {
            let mut taken = Vec::new();
            while let Ok(Some(number)) = taker.wait(None) {
                taken.push(number);
            }
            taken
        });
        for number in 0..1_000 {
            while giver.give(number).is_err() {
                std::hint::spin_loop();
            }
        }
        drop(giver);
        assert_eq!(taken.join().unwrap(), (0..1_000).collect::<Vec<_>>());
    }
}
