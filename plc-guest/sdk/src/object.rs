//! Kernel objects and channel ports.
//!
//! Each has a number that `takt plc build` fills in when it has seen all declarations. It is read by
//! volatile accesses, because the compiler sees a zero there.

use core::ptr::read_volatile;

use crate::call::{Error, call};

/// The number, filled in by the tool.
#[repr(transparent)]
struct Number(u32);

impl Number {
    fn get(&self) -> u64 {
        // SAFETY: the reference is valid.
        unsafe { read_volatile(&raw const self.0) }.into()
    }
}

macro_rules! objects {
    ($($(#[$meta:meta])* $name:ident,)+) => {
        $(
            $(#[$meta])*
            #[repr(transparent)]
            pub struct $name(Number);

            impl $name {
                #[doc(hidden)]
                #[allow(clippy::new_without_default, reason = "only the macro makes one")]
                pub const fn new() -> Self {
                    Self(Number(0))
                }
            }
        )+
    };
}

objects! {
    /// Lets one task at a time into a critical section. Declared by [`semaphore!`](crate::semaphore).
    Semaphore,
    /// Holds messages in their order. Declared by [`queue!`](crate::queue).
    Queue,
    /// Holds the last value written. Declared by [`mailbox!`](crate::mailbox).
    Mailbox,
    /// 32 bits to wait for. Declared by [`flags!`](crate::flags).
    Flags,
    /// A channel port to read. Declared by [`port_in!`](crate::port_in).
    PortIn,
    /// A channel port to write. Declared by [`port_out!`](crate::port_out).
    PortOut,
}

fn number(n: &Number, call_number: u64, rest: [u64; 3]) -> Result<u64, Error> {
    // SAFETY: used for calls without pointers only.
    unsafe { call(call_number, [n.get(), rest[0], rest[1], rest[2]]) }
}

fn send(n: &Number, call_number: u64, bytes: &[u8]) -> Result<(), Error> {
    // SAFETY: the kernel reads the bytes.
    unsafe { call(call_number, [n.get(), bytes.as_ptr() as u64, bytes.len() as u64, 0]) }
        .map(|_| ())
}

fn receive(n: &Number, call_number: u64, bytes: &mut [u8], wait: u64) -> Result<u64, Error> {
    // SAFETY: the kernel writes into the buffer, which is exclusively borrowed.
    unsafe { call(call_number, [n.get(), bytes.as_mut_ptr() as u64, bytes.len() as u64, wait]) }
}

impl Semaphore {
    /// Runs `f` with the semaphore taken.
    ///
    /// # Errors
    /// The time-out (nanoseconds) is over, this task is more urgent than the ceiling, or it is freewheeling and has no budget.
    pub fn with<R>(&self, timeout: u64, f: impl FnOnce() -> R) -> Result<R, Error> {
        number(&self.0, 3, [timeout, 0, 0])?;
        let result = f();
        number(&self.0, 4, [0; 3])?;
        Ok(result)
    }
}

impl Queue {
    /// Puts a message in; never waits.
    ///
    /// # Errors
    /// The queue is full, or the message too long.
    pub fn send(&self, message: &[u8]) -> Result<(), Error> {
        send(&self.0, 5, message)
    }

    /// Takes the oldest message out and gives its length; waits up to `timeout` nanoseconds.
    ///
    /// # Errors
    /// No message came, or it does not fit.
    pub fn receive(&self, buffer: &mut [u8], timeout: u64) -> Result<usize, Error> {
        receive(&self.0, 6, buffer, timeout).map(|length| length as usize)
    }
}

impl Mailbox {
    /// Writes the value.
    ///
    /// # Errors
    /// It is too long.
    pub fn write(&self, value: &[u8]) -> Result<(), Error> {
        send(&self.0, 7, value)
    }

    /// Reads the value: gives its length, and whether it is new to this task.
    ///
    /// # Errors
    /// Nothing was written yet, or it does not fit.
    pub fn read(&self, buffer: &mut [u8]) -> Result<(usize, bool), Error> {
        let result = receive(&self.0, 8, buffer, 0)?;
        Ok(((result & 0xffff_ffff) as usize, result >> 32 & 1 == 1))
    }
}

impl Flags {
    /// Sets these bits.
    ///
    /// # Errors
    /// None in a program that the tool has built.
    pub fn set(&self, mask: u32) -> Result<(), Error> {
        number(&self.0, 9, [mask.into(), 0, 0]).map(|_| ())
    }

    /// Clears these bits.
    ///
    /// # Errors
    /// None in a program that the tool has built.
    pub fn clear(&self, mask: u32) -> Result<(), Error> {
        number(&self.0, 11, [mask.into(), 0, 0]).map(|_| ())
    }

    /// Waits up to `timeout` nanoseconds until one of these bits is set; gives those that are.
    ///
    /// # Errors
    /// The time is over.
    pub fn wait_any(&self, mask: u32, timeout: u64) -> Result<u32, Error> {
        number(&self.0, 10, [mask.into(), 0, timeout]).map(|bits| bits as u32)
    }

    /// Waits up to `timeout` nanoseconds until all of these bits are set.
    ///
    /// # Errors
    /// The time is over.
    pub fn wait_all(&self, mask: u32, timeout: u64) -> Result<(), Error> {
        number(&self.0, 10, [mask.into(), 1, timeout]).map(|_| ())
    }
}

impl PortIn {
    /// Reads a message and gives its length.
    ///
    /// # Errors
    /// There is none, or it does not fit.
    pub fn read(&self, buffer: &mut [u8]) -> Result<usize, Error> {
        receive(&self.0, 12, buffer, 0).map(|length| length as usize)
    }
}

impl PortOut {
    /// Writes a message.
    ///
    /// # Errors
    /// The channel is full, or the message too long.
    pub fn write(&self, message: &[u8]) -> Result<(), Error> {
        send(&self.0, 13, message)
    }
}
