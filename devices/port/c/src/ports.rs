//! The handle of all ports.

use std::ffi::{CStr, c_char};
use std::path::Path;
use std::sync::Arc;

use takt_port::{Direction, Kind, Ports};

use crate::code::{Code, Failure, finish};

/// The ports of this partition. Ports that were opened go on when this handle is closed.
#[derive(Debug)]
pub struct PortsHandle(pub(crate) Arc<Ports>);

/// Bytes of a name, with the zero at its end: the partition file has names of up to 32 characters.
const NAME_BYTES: usize = 33;

/// What the partition file says of a port.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Description {
    /// Its name, ending with a zero.
    pub name: [u8; NAME_BYTES],
    /// 1 if this partition sends, 2 if it receives.
    pub direction: u32,
    /// 1 for a sampling port, 2 for a queuing port.
    pub kind: u32,
    /// Longest message in bytes; a buffer to read into must have that many.
    pub maximum: usize,
    /// Messages that can wait; 1 for a sampling port.
    pub depth: u32,
    /// 1 if the channel has a doorbell.
    pub doorbell: u32,
    /// Age up to which a message is valid; 0 for a queuing port.
    pub refresh_ns: u64,
}

/// Reads a text of the caller's.
///
/// # Safety
/// `text` is null or points to bytes that end with a zero.
pub(crate) unsafe fn text<'a>(text: *const c_char) -> Result<&'a str, Failure> {
    if text.is_null() {
        return Err(Failure::argument("a text is null"));
    }
    // SAFETY: it is not null, and ends with a zero as the caller has promised.
    let text = unsafe { CStr::from_ptr(text) };
    text.to_str().map_err(|_| Failure::argument("a text is not UTF-8"))
}

/// Finds the ports on the PCI bus. Needs root.
///
/// # Safety
/// `ports` is null or points to room for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_ports_discover(ports: *mut *mut PortsHandle) -> Code {
    // SAFETY: the same promise.
    finish(unsafe { give(ports, || Ok(Ports::discover()?)) })
}

/// The ports of a function by its folder in sysfs.
///
/// # Safety
/// `folder` is null or points to a text that ends with a zero; `ports` is null or points to room for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_ports_open(
    folder: *const c_char,
    ports: *mut *mut PortsHandle,
) -> Code {
    // SAFETY: the same promise.
    let opened = || Ok(Ports::open(Path::new(unsafe { text(folder) }?))?);
    // SAFETY: the same promise.
    finish(unsafe { give(ports, opened) })
}

/// # Safety
/// `ports` is null or points to room for a pointer.
unsafe fn give(
    ports: *mut *mut PortsHandle,
    open: impl FnOnce() -> Result<Ports, Failure>,
) -> Result<(), Failure> {
    if ports.is_null() {
        return Err(Failure::argument("the place for the handle is null"));
    }
    let handle = Box::new(PortsHandle(Arc::new(open()?)));
    // SAFETY: it is not null, so there is room for a pointer.
    unsafe { ports.write(Box::into_raw(handle)) };
    Ok(())
}

/// Closes the handle. Null is allowed.
///
/// # Safety
/// `ports` is null or a handle that has not been closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_ports_close(ports: *mut PortsHandle) {
    if !ports.is_null() {
        // SAFETY: the handle was made by `Box::into_raw` and is closed once.
        drop(unsafe { Box::from_raw(ports) });
    }
}

/// How many ports there are; 0 for null.
///
/// # Safety
/// `ports` is null or an open handle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_ports_count(ports: *const PortsHandle) -> usize {
    // SAFETY: null or an open handle.
    unsafe { ports.as_ref() }.map_or(0, |ports| ports.0.list().len())
}

/// Describes a port by its place in the list, which begins with 0.
///
/// # Safety
/// `ports` is null or an open handle; `description` is null or points to room for one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn takt_ports_describe(
    ports: *const PortsHandle,
    index: usize,
    description: *mut Description,
) -> Code {
    // SAFETY: null or an open handle.
    let ports = unsafe { ports.as_ref() };
    let described =
        ports.ok_or_else(|| Failure::argument("the handle is null")).and_then(|ports| {
            let port = ports.0.list().get(index);
            let port = port.ok_or_else(|| Failure::argument("there is no port at this place"))?;
            if description.is_null() {
                return Err(Failure::argument("the place for the description is null"));
            }
            let mut name = [0; NAME_BYTES];
            let room = name.iter_mut().take(NAME_BYTES - 1);
            room.zip(port.name.bytes()).for_each(|(place, byte)| *place = byte);
            let (kind, depth, refresh_ns) = match port.kind {
                Kind::Sampling { refresh } => {
                    (1, 1, u64::try_from(refresh.as_nanos()).unwrap_or(u64::MAX))
                }
                Kind::Queuing { depth, .. } => (2, depth, 0),
            };
            let direction = match port.direction {
                Direction::Source => 1,
                Direction::Destination => 2,
            };
            let maximum = port.maximum as usize;
            let doorbell = u32::from(port.doorbell);
            let described =
                Description { name, direction, kind, maximum, depth, doorbell, refresh_ns };
            // SAFETY: it is not null, so there is room for a description.
            unsafe { description.write(described) };
            Ok(())
        });
    finish(described)
}
