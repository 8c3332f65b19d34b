//! Starting a PLC guest anew.
//!
//! Clearing and loading memory takes longer than a window. It is therefore done by the event
//! thread, while the partition's own thread waits and uses none of its windows; the others do not
//! notice. Only then the thread gets the word to reset its processor and go on.

use std::sync::mpsc::{Receiver, Sender, channel};

use crate::boot::StartMode;
use crate::boot::long_mode::Entry;
use crate::boot::plc::{PlcImage, PlcImageError};
use crate::memory::GuestMemory;

/// The word to a partition's thread that its guest has been loaded.
#[derive(Clone, Copy, Debug)]
pub struct Revival {
    /// How.
    pub mode: StartMode,
    /// Where it starts.
    pub entry: Entry,
}

/// What is needed to start a guest anew. When it is dropped, the thread that waits for it ends.
pub struct Restart {
    memory: GuestMemory,
    image: PlcImage,
    thread: Sender<Revival>,
}

impl Restart {
    /// For the guest of `image` in `memory`; the other part is for its thread.
    #[must_use]
    pub fn new(memory: GuestMemory, image: PlcImage) -> (Self, Receiver<Revival>) {
        let (thread, revivals) = channel();
        (Self { memory, image, thread }, revivals)
    }

    /// Loads the guest and lets its thread go on. The thread must have told of its end.
    ///
    /// # Errors
    /// If the image cannot be loaded, which then does not happen for the first time.
    pub fn start(&self, mode: StartMode) -> Result<(), PlcImageError> {
        let entry = self.image.reload(&self.memory, mode)?;
        // A thread that is gone has told of that too.
        let _ = self.thread.send(Revival { mode, entry });
        Ok(())
    }
}
