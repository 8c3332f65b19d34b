//! The handle of one port.

use std::ffi::c_char;
use std::slice;
use std::sync::Arc;
use std::time::Duration;

use takt_port::channel::Validity;
use takt_port::{
    CallError, Direction, Input, Kind, Output, Ports, Receiver, Sender, Start, Timeout,
};

use crate::code::{Code, Failure, finish};
use crate::message::Message;
use crate::ports::{PortsHandle, text};

/// A port that this process has taken.
#[derive(Debug)]
pub struct PortHandle {
    // Declared before what it borrows from, so that it is dropped first.
    end: End,
    _ports: Arc<Ports>,
    /// The process that took it. One that is forked has the handle and the lock too, but two would overwrite each
    /// other's messages.
    process: u32,
}

impl PortHandle {
    fn check_process(&self) -> Result<(), Failure> {
        if self.process == std::process::id() {
            return Ok(());
        }
        Err(Failure::argument("the port belongs to the process from which this one was forked"))
    }
}

#[derive(Debug)]
enum End {
    Output(Output<'static>),
    Input(Input<'static>),
    Sender(Sender<'static>),
    Receiver(Receiver<'static>),
}

impl End {
    fn name(&self) -> &'static str {
        match self {
            End::Output(_) => "a sampling source",
            End::Input(_) => "a sampling destination",
            End::Sender(_) => "a queuing source",
            End::Receiver(_) => "a queuing destination",
        }
    }

    fn refuse(&self, call: &str) -> Failure {
        Failure::mode(format!("{call} does not fit this port, which is {}", self.name()))
    }
}

fn open(ports: &Arc<Ports>, name: &str, start: Start) -> Result<PortHandle, Failure> {
    let owner = Arc::clone(ports);
    // SAFETY: `Ports` lies on the heap of the `Arc`, does not move, and is not changed. The handle keeps the
    // `Arc` for as long as the end that borrows from it, and drops the end first.
    let ports: &'static Ports = unsafe { &*Arc::as_ptr(&owner) };
    let port = ports.port(name)?;
    let end = match (port.kind, port.direction) {
        (Kind::Sampling { .. }, Direction::Source) => End::Output(ports.output(name, start)?),
        (Kind::Sampling { .. }, Direction::Destination) => End::Input(ports.input(name, start)?),
        (Kind::Queuing { .. }, Direction::Source) => End::Sender(ports.sender(name, start)?),
        (Kind::Queuing { .. }, Direction::Destination) => {
            End::Receiver(ports.receiver(name, start)?)
        }
    };
    Ok(PortHandle { end, _ports: owner, process: std::process::id() })
}

/// Negative numbers mean for ever.
fn timeout(ns: i64) -> Timeout {
    match u64::try_from(ns) {
        Ok(0) => Timeout::Zero,
        Ok(ns) => Timeout::Within(Duration::from_nanos(ns)),
        Err(_) => Timeout::Forever,
    }
}

/// Takes a port. `anew` is 0 to go on with what the owner before has left, and anything else to begin with an
/// empty channel.
///
/// # Safety
/// `ports` is null or an open handle; `name` is null or points to a text that ends with a zero; `port` is null or
/// points to room for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_port_open(
    ports: *const PortsHandle,
    name: *const c_char,
    anew: i32,
    port: *mut *mut PortHandle,
) -> Code {
    let start = if anew == 0 { Start::Attach } else { Start::Open };
    // SAFETY: null or an open handle.
    let ports = unsafe { ports.as_ref() };
    let opened = ports.ok_or_else(|| Failure::argument("the handle is null")).and_then(|ports| {
        if port.is_null() {
            return Err(Failure::argument("the place for the handle is null"));
        }
        // SAFETY: null or a text that ends with a zero.
        let handle = Box::new(open(&ports.0, unsafe { text(name) }?, start)?);
        // SAFETY: it is not null, so there is room for a pointer.
        unsafe { port.write(Box::into_raw(handle)) };
        Ok(())
    });
    finish(opened)
}

/// Lets go of a port. Null is allowed.
///
/// # Safety
/// `port` is null or a handle that has not been closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_port_close(port: *mut PortHandle) {
    if !port.is_null() {
        // SAFETY: the handle was made by `Box::into_raw` and is closed once.
        drop(unsafe { Box::from_raw(port) });
    }
}

/// Replaces the message of a sampling port. Never waits.
///
/// # Safety
/// `port` is null or an open handle; `bytes` is null or points to `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_port_write(
    port: *mut PortHandle,
    bytes: *const u8,
    length: usize,
) -> Code {
    // SAFETY: the same promise.
    finish(unsafe { outgoing(port, bytes, length) }.and_then(|(end, bytes)| match end {
        End::Output(output) => Ok(output.write(bytes).map_err(CallError::from)?),
        other => Err(other.refuse("takt_port_write")),
    }))
}

/// Sends a message through a queuing port, and waits for room.
///
/// # Safety
/// `port` is null or an open handle; `bytes` is null or points to `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_port_send(
    port: *mut PortHandle,
    bytes: *const u8,
    length: usize,
    timeout_ns: i64,
) -> Code {
    // SAFETY: the same promise.
    finish(unsafe { outgoing(port, bytes, length) }.and_then(|(end, bytes)| match end {
        End::Sender(sender) => Ok(sender.send(bytes, timeout(timeout_ns))?),
        other => Err(other.refuse("takt_port_send")),
    }))
}

/// Reads the newest message of a sampling port, which must be another one than that with the stamp `*known` if
/// `known` is not null. Waits for one so long. With a null `known` any message will do.
///
/// # Safety
/// `port` is null or an open handle; `buffer` is null or points to `capacity` bytes that may be written; `known` is
/// null or points to a stamp; `message` is null or points to room for one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_port_read(
    port: *mut PortHandle,
    buffer: *mut u8,
    capacity: usize,
    known: *const u64,
    timeout_ns: i64,
    message: *mut Message,
) -> Code {
    // SAFETY: null or a stamp.
    let known = unsafe { known.as_ref() }.map(|stamp| takt_port::channel::Tsc(*stamp));
    // SAFETY: the same promise.
    let result = unsafe { incoming(port, buffer, capacity, message) };
    finish(result.and_then(|(handle, buffer, message)| {
        let clock = handle._ports.clock();
        let End::Input(input) = &mut handle.end else {
            return Err(handle.end.refuse("takt_port_read"));
        };
        let sample = input.read_newer(buffer, known, timeout(timeout_ns))?;
        *message = Message {
            length: sample.bytes.len(),
            stamp: sample.stamp.0,
            age_ns: clock.nanoseconds(sample.age),
            valid: i32::from(sample.validity == Validity::Valid),
            overflowed: 0,
        };
        Ok(())
    }))
}

/// Takes the oldest message of a queuing port, and waits for one so long.
///
/// # Safety
/// `port` is null or an open handle; `buffer` is null or points to `capacity` bytes that may be written; `message` is
/// null or points to room for one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_port_receive(
    port: *mut PortHandle,
    buffer: *mut u8,
    capacity: usize,
    timeout_ns: i64,
    message: *mut Message,
) -> Code {
    // SAFETY: the same promise.
    let result = unsafe { incoming(port, buffer, capacity, message) };
    finish(result.and_then(|(handle, buffer, message)| {
        let End::Receiver(receiver) = &mut handle.end else {
            return Err(handle.end.refuse("takt_port_receive"));
        };
        let received = receiver.receive(buffer, timeout(timeout_ns))?;
        *message = Message {
            length: received.bytes.len(),
            stamp: received.stamp.0,
            age_ns: 0,
            valid: 1,
            overflowed: i32::from(received.overflowed),
        };
        Ok(())
    }))
}

/// # Safety
/// `port` is null or an open handle; `bytes` is null or points to `length` bytes.
unsafe fn outgoing<'a>(
    port: *mut PortHandle,
    bytes: *const u8,
    length: usize,
) -> Result<(&'a mut End, &'a [u8]), Failure> {
    // SAFETY: null or an open handle, which this thread alone uses.
    let port = unsafe { port.as_mut() }.ok_or_else(|| Failure::argument("the handle is null"))?;
    port.check_process()?;
    if bytes.is_null() {
        return Err(Failure::argument("the message is null"));
    }
    // SAFETY: it is not null, so it points to that many bytes.
    Ok((&mut port.end, unsafe { slice::from_raw_parts(bytes, length) }))
}

/// # Safety
/// `port` is null or an open handle; `buffer` is null or points to `capacity` bytes that may be written; `message` is
/// null or points to room for one.
unsafe fn incoming<'a>(
    port: *mut PortHandle,
    buffer: *mut u8,
    capacity: usize,
    message: *mut Message,
) -> Result<(&'a mut PortHandle, &'a mut [u8], &'a mut Message), Failure> {
    // SAFETY: null or an open handle, which this thread alone uses.
    let port = unsafe { port.as_mut() }.ok_or_else(|| Failure::argument("the handle is null"))?;
    port.check_process()?;
    if buffer.is_null() || message.is_null() {
        return Err(Failure::argument("the buffer or the place for the message is null"));
    }
    // SAFETY: it is not null; any bytes are a message.
    unsafe { message.write(Message::default()) };
    // SAFETY: neither is null, and the message has just been written.
    Ok(unsafe { (port, slice::from_raw_parts_mut(buffer, capacity), &mut *message) })
}
